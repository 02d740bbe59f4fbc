"""VoxelNet (Zhou and Tuzel, CVPR 2018)."""

from farfield.detectors.spec import DetectorSpec

KIND = DetectorSpec(
    name="voxelnet",
    paper="Zhou and Tuzel, CVPR 2018",
    config="farfield.detectors.voxelnet.network:VoxelNetConfig",
    network="farfield.detectors.voxelnet.network:VoxelNet",
)

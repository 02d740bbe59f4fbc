"""A fully sparse centre-based detector (after VoxelNeXt, CVPR 2023, and SAFDNet, CVPR 2024)."""

from farfield.detectors.spec import DetectorSpec

KIND = DetectorSpec(
    name="sparsecentre",
    paper="after VoxelNeXt, CVPR 2023, and SAFDNet, CVPR 2024",
    config="farfield.detectors.sparsecentre.network:SparseCentreConfig",
    network="farfield.detectors.sparsecentre.network:SparseCentre",
)

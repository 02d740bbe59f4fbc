"""PointPillars (Lang et al., CVPR 2019)."""

from farfield.detectors.spec import DetectorSpec

KIND = DetectorSpec(
    name="pointpillars",
    paper="Lang et al., CVPR 2019",
    config="farfield.detectors.pointpillars.network:PointPillarsConfig",
    network="farfield.detectors.pointpillars.network:PointPillars",
)

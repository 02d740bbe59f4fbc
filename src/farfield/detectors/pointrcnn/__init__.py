"""PointRCNN (Shi, Wang and Li, CVPR 2019)."""

from farfield.detectors.spec import DetectorSpec

KIND = DetectorSpec(
    name="pointrcnn",
    paper="Shi, Wang and Li, CVPR 2019",
    config="farfield.detectors.pointrcnn.network:PointRCNNConfig",
    network="farfield.detectors.pointrcnn.network:PointRCNN",
)

"""PointRCNN (Shi, Wang and Li, CVPR 2019)."""

from farfield.detectors.kinds import Kind

KIND = Kind(
    name="pointrcnn",
    paper="Shi, Wang and Li, CVPR 2019",
    config="farfield.detectors.pointrcnn.network:PointRCNNConfig",
    network="farfield.detectors.pointrcnn.network:PointRCNN",
)

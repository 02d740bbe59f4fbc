"""RTN and RTNH, the 4D radar networks of K-Radar (Paek, Kong and Wijaya, NeurIPS 2022)."""

from farfield.detectors.spec import DetectorSpec

_PAPER = "Paek, Kong and Wijaya (K-Radar), NeurIPS 2022"

RTN = DetectorSpec(
    name="rtn",
    paper=_PAPER,
    config="farfield.detectors.kradar.rtn:RTNConfig",
    network="farfield.detectors.kradar.rtn:RTN",
)
RTNH = DetectorSpec(
    name="rtnh",
    paper=_PAPER,
    config="farfield.detectors.kradar.rtnh:RTNHConfig",
    network="farfield.detectors.kradar.rtnh:RTNH",
)

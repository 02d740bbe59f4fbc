"""SECOND (Yan, Mao and Li, Sensors 2018)."""

from farfield.detectors.spec import DetectorSpec

KIND = DetectorSpec(
    name="second",
    paper="Yan, Mao and Li, Sensors 2018",
    config="farfield.detectors.second.network:SecondConfig",
    network="farfield.detectors.second.network:Second",
)

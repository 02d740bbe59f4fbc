"""A data set, a detector, a protocol and a training method of one's own for Farfield; importing it loads no torch."""

from farfield.detectors import DetectorSpec

KIND = DetectorSpec(
    name="mean-pillars",
    paper="example",
    config="farfield_example.detector:MeanPillarsConfig",
    network="farfield_example.detector:MeanPillars",
)
"""What the entry point names; the network is imported when it is asked for."""

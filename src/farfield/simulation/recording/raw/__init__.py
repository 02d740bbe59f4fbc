"""Raw recordings of simulated drives: streams with clocks of their own in ROS 2 bags, with the truth beside."""

from farfield.simulation.recording.raw.streams import RawRecorded, record_streams

__all__ = ["RawRecorded", "record_streams"]

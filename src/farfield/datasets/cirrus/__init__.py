"""Cirrus: reader, writer, mapping and labels of the two-pattern long-range LiDAR data set."""

from farfield.datasets.cirrus.labels import RawLabels
from farfield.datasets.cirrus.layout import Mapping, read_mapping
from farfield.datasets.cirrus.reader import Cirrus
from farfield.datasets.cirrus.writer import CirrusWriter

__all__ = ["Cirrus", "CirrusWriter", "Mapping", "RawLabels", "read_mapping"]

"""K-Radar: reader and writer of the 4D radar data set with its LiDARs, cameras and annotations."""

from farfield.datasets.kradar.labels import KRadarLabels
from farfield.datasets.kradar.reader import KRadar
from farfield.datasets.kradar.writer import KRadarWriter

__all__ = ["KRadar", "KRadarLabels", "KRadarWriter"]

"""ROS 2 bags (SQLite and MCAP) as a data set: clouds, images, transforms."""

from farfield.datasets.bags.reader import Bags

__all__ = ["Bags"]

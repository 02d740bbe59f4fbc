"""Dense depth maps of cameras from LiDAR sweeps, without learning."""

from farfield.depth.frames import frame_depth
from farfield.depth.maps import METHODS, DepthMap, depth_map

__all__ = ["METHODS", "DepthMap", "depth_map", "frame_depth"]

"""Dense depth maps of cameras from LiDAR sweeps, without learning."""

from farfield.depth.maps import METHODS, DepthMap, depth_map, frame_depth

__all__ = ["METHODS", "DepthMap", "depth_map", "frame_depth"]

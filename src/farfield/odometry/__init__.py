"""Odometry by registration of LiDAR sweeps: a track with its expected drift."""

"""What cameras and LiDARs give together: depth maps."""

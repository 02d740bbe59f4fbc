"""What cameras and LiDARs give together, and pictures that may be shown."""

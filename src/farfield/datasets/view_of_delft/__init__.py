"""View-of-Delft: LiDAR and 3+1D radar in KITTI's layout."""

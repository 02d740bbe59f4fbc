"""VoxelNet (Zhou and Tuzel, CVPR 2018)."""

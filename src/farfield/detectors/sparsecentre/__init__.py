"""A fully sparse centre-based detector (after VoxelNeXt, CVPR 2023, and SAFDNet, CVPR 2024)."""

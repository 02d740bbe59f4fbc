"""PointPillars (Lang et al., CVPR 2019)."""

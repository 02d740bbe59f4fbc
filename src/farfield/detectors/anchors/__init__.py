"""Anchors: their grid, their matching to boxes, and the head that VoxelNet, SECOND, PointPillars and RTNH share."""

"""Boxes, poses, cameras, exact rotated IoU, points in boxes. numpy only; float64 inside."""

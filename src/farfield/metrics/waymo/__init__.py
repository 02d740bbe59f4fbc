"""Waymo's detection metrics: AP and APH by level and range, and the longitudinal error tolerant LET-3D-AP."""

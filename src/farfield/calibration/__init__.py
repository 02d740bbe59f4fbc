"""Calibration of one sensor to another: residuals, robust solvers, sigma, and what the data cannot tell.

``problems`` states and solves any of them; ``registration`` is LiDAR to LiDAR, ``radar_lidar`` radar to LiDAR,
``pairs`` and ``edges`` LiDAR to camera, ``saving`` writes results and keeps what was there. No page, no torch.
"""

from farfield.calibration.problems import Parameter, Solution, solve

__all__ = ["Parameter", "Solution", "solve"]

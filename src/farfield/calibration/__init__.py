"""Calibration of one sensor to another: residuals, robust solvers, sigma, and what the data cannot tell.

``least_squares`` states and solves any of them; ``lidar_lidar``, ``radar_lidar``, ``camera_edges``, ``camera_pairs``
and ``boards`` are the solvers, ``jobs`` runs them on data sets, ``checking`` judges given calibrations, and ``saving``
writes results and keeps what was there. No page, no torch.
"""

from farfield.calibration.least_squares import Parameter, Solution, solve

__all__ = ["Parameter", "Solution", "solve"]

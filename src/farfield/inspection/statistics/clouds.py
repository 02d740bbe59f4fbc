"""How a sensor's returns spread over elevation and range, and how many of its shots come back."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float32, Int

FOCUS_DEG = -2.0
"""Focus of the Gaussian scan pattern that a fit to real Luminar sweeps supports; its own figure is not published."""
WITHIN_DEG = (2.0, 5.0, 10.0)
FAR_M = 8.0
"""Returns beyond it also count apart: nearer ones see their elevation shifted where several sensors were merged."""
ELEVATION_EDGES_DEG = np.linspace(-30.0, 30.0, 241)
RANGE_EDGES_M = np.linspace(0.0, 400.0, 81)


@dataclass(kw_only=True)
class CloudTally:
    """Counts over the clouds of one sensor or pattern. The sensor is taken to stand at the frame's origin.

    Args:
        focus_deg: Elevation about which the shares are also counted.
    """

    focus_deg: float = FOCUS_DEG
    frames: int = 0
    points: int = 0
    shots: int = 0
    points_of_shots: int = 0
    longest_m: float = 0.0
    elevation: Int[np.ndarray, " b"] = field(default_factory=lambda: np.zeros(len(ELEVATION_EDGES_DEG) - 1, np.int64))
    ranges: Int[np.ndarray, " b"] = field(default_factory=lambda: np.zeros(len(RANGE_EDGES_M) - 1, np.int64))
    far_points: int = 0
    within: Int[np.ndarray, "2 2 w"] = field(default_factory=lambda: np.zeros((2, 2, len(WITHIN_DEG)), np.int64))

    def add(self, points_m: Float32[np.ndarray, "n 3"], *, shots: int | None = None) -> None:
        """Count one cloud.

        Args:
            points_m: Its points; those at the origin, which mark missing returns, do not count.
            shots: How many shots the sensor fired, where that is known.
        """
        x, y, z = points_m.astype(np.float64).T
        range_m = np.sqrt(x * x + y * y + z * z)
        there = range_m > 0
        range_m = range_m[there]
        elevation_deg = np.degrees(np.arcsin(np.clip(z[there] / range_m, -1.0, 1.0)))
        self.frames += 1
        self.points += len(range_m)
        if shots:
            self.shots += int(shots)
            self.points_of_shots += len(range_m)
        self.longest_m = max(self.longest_m, float(range_m.max(initial=0.0)))
        self.elevation += np.histogram(elevation_deg, ELEVATION_EDGES_DEG)[0]
        self.ranges += np.histogram(range_m, RANGE_EDGES_M)[0]
        far = range_m > FAR_M
        self.far_points += int(far.sum())
        for row, centre_deg in enumerate((0.0, self.focus_deg)):
            for column, counted in enumerate((slice(None), far)):
                away_deg = np.abs(elevation_deg[counted] - centre_deg)
                self.within[row, column] += [int((away_deg < limit).sum()) for limit in WITHIN_DEG]

    def merge(self, other: "CloudTally") -> None:
        """Take in the counts over other clouds of the same sensor."""
        self.frames += other.frames
        self.points += other.points
        self.shots += other.shots
        self.points_of_shots += other.points_of_shots
        self.longest_m = max(self.longest_m, other.longest_m)
        self.elevation += other.elevation
        self.ranges += other.ranges
        self.far_points += other.far_points
        self.within += other.within

    def summary(self) -> dict[str, Any]:
        """Points, returned shots, shares by elevation, and both histograms."""
        shares = self.within / np.maximum([[self.points], [self.far_points]], 1)
        names = [f"{limit:g}" for limit in WITHIN_DEG]
        horizon, focus = ([dict(zip(names, part, strict=True)) for part in row] for row in shares.tolist())
        return {
            "frames": self.frames,
            "points_per_frame": self.points / max(self.frames, 1),
            "return_rate": self.points_of_shots / self.shots if self.shots else None,
            "longest_m": self.longest_m,
            "focus_deg": self.focus_deg,
            "share_of_horizon": horizon[0],
            "share_of_focus": focus[0],
            "far_m": FAR_M,
            "far_share_of_horizon": horizon[1],
            "far_share_of_focus": focus[1],
            "elevation": {"edges_deg": ELEVATION_EDGES_DEG.tolist(), "count": self.elevation.tolist()},
            "range": {"edges_m": RANGE_EDGES_M.tolist(), "count": self.ranges.tolist()},
        }

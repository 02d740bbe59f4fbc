"""Where the rows of a sensor point: the lines of the Luminar's two patterns, the beam tables of the Ousters."""

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from jaxtyping import Float

from farfield.errors import ConfigError
from farfield.vocabulary.patterns import PATTERNS


@dataclass(frozen=True)
class BeamTable:
    """The rows of a spinning sensor, from the highest down.

    Args:
        elevation_deg: Elevation of each row.
        offset_deg: By how much each row points to the right of the column's direction.
        origin_m: Distance of the beams' origin from the sensor's axis.
    """

    elevation_deg: tuple[float, ...]
    offset_deg: tuple[float, ...]
    origin_m: float

    @classmethod
    def table(
        cls, top_deg: float, bottom_deg: float, rows: int, cycle_deg: tuple[float, ...], origin_m: float
    ) -> "BeamTable":
        """Evenly spaced rows whose azimuth offsets repeat a cycle."""
        elevation = tuple(float(value) for value in np.linspace(top_deg, bottom_deg, rows))
        return cls(elevation, tuple(cycle_deg[row % len(cycle_deg)] for row in range(rows)), origin_m)

    def every_second(self) -> "BeamTable":
        """The rows 0, 2, 4..."""
        return BeamTable(self.elevation_deg[::2], self.offset_deg[::2], self.origin_m)


OS1_128_BEAMS = BeamTable.table(20.95, -21.82, 128, (4.21, 1.41, -1.40, -4.21), 0.0158)
OS2_128_BEAMS = BeamTable.table(10.76, -11.09, 128, (2.08, 0.70, -0.68, -2.05), 0.0138)
OS2_64_BEAMS = OS2_128_BEAMS.every_second()
HDL_64E_BEAMS = BeamTable(
    (*np.linspace(2.0, -8.7, 32).tolist(), *np.linspace(-9.2, -24.9, 32).tolist()), offset_deg=(0.0,) * 64, origin_m=0.0
)
"""The two blocks of 32 lasers of KITTI's Velodyne HDL-64E, the upper one denser, from +2.0 to -24.9 degrees.

Its data sheet gives the ends; where the blocks meet is read off the rings of KITTI's own sweeps, which scatter round
this table by 0.1 degrees.
"""


def line_elevations_deg(
    pattern: str, *, lines: int, edge_deg: float, focus_deg: float, sigma_deg: float
) -> Float[np.ndarray, " lines"]:
    """Elevations of the Luminar's scan lines, rising.

    The uniform pattern is equally spaced over the field of view; the Gaussian one takes the quantiles of a normal
    distribution around ``focus_deg`` that is cut off at the field's edges.

    Args:
        pattern: "gaussian" or "uniform".
        lines: How many.
        edge_deg: Half of the field of view.
        focus_deg: Middle of the Gaussian.
        sigma_deg: Its width.

    Raises:
        ConfigError: If the pattern is neither "gaussian" nor "uniform".
    """
    if pattern == "uniform":
        return np.linspace(-edge_deg, edge_deg, lines)
    if pattern != "gaussian":
        raise ConfigError(f"scan pattern: expected one of {', '.join(PATTERNS)}; got {pattern!r}")
    normal = NormalDist(focus_deg, sigma_deg)
    low, high = normal.cdf(-edge_deg), normal.cdf(edge_deg)
    shares = (np.arange(lines) + 0.5) / lines
    return np.array([normal.inv_cdf(low + share * (high - low)) for share in shares])

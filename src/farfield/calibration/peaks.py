"""Peaks of a radar's power from above, with their places within the cell."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from farfield.calibration.moments import SensorPair

LEAST_DB = 2.0
"""Over what is usual at that range: weaker echoes are no peaks."""
STRONG_DB = 7.0
"""What only an object gives; a weaker peak is one where something thin stands."""
_PEAK_M, _CELL_RAD = 0.9, np.radians(1.2)  # peaks are no nearer to one another
_DEPTH_M = 0.7  # half of what an echo spreads over along the beam
_LOBE_RAD, _LOBE_M = np.radians(2.5), 1.5  # the same across it, for what is as wide as a car
_THIN_RAD, _THIN_M = np.radians(1.0), 0.2  # and for a post
_LEAST_SHARE = 0.05  # of an echo's power: what lies below is noise
_LOBE_SHARE = 0.2  # of a wide echo's: side lobes, 10 to 13 dB down, and two of them together lie below
_MOVES, _STILL_RAD = 4, 1e-4


@dataclass(frozen=True, eq=False, kw_only=True)
class Peaks:
    """Radar peaks of one frame, in the radar's frame.

    Args:
        place_m: Means by power over the lobe of something as wide as a car, shape (n, 3).
        thin_m: Means over the beam of a post alone, shape (n, 3).
        power_db: Power of the strongest echo, shape (n,).
    """

    place_m: Float[np.ndarray, "n 3"]
    thin_m: Float[np.ndarray, "n 3"]
    power_db: Float[np.ndarray, " n"]


def find_peaks(moment: SensorPair) -> Peaks:
    """Local maxima of the radar's echoes with their places within the cell: means over the lobe, by power.

    The lobe is taken in range and azimuth, wide enough for its far side to count: a narrower window draws every echo
    to the middle of its cell, by up to 0.3 of one degree. Side lobes fall into it too, more on one side than on the
    other: counted, they draw a point by 0.15 degree (simulated array), so only what is stronger counts. A post's echo
    is as wide as the beam: a window of that width moves with its own mean until it rests, so that it is drawn nowhere
    and side lobes stay outside.
    """
    places, power = moment.echoes_m, moment.power_db
    top = _tops(places, power)
    lobes = _Lobes.of(places, power)
    wide, thin = np.zeros((len(top), 3)), np.zeros((len(top), 3))
    for row, i in enumerate(top):
        bearing, reach = float(np.arctan2(places[i, 1], places[i, 0])), float(np.linalg.norm(places[i]))
        near = max(reach, 1.0)
        wide[row] = lobes.mean(bearing, reach, max(_LOBE_RAD, _LOBE_M / near), _LOBE_SHARE)
        thin[row] = lobes.rest(bearing, reach, _THIN_RAD + _THIN_M / near)
    return Peaks(place_m=_flat(wide), thin_m=_flat(thin), power_db=power[top])


def _flat(polar: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Places of bearings, slant ranges and heights."""
    level = np.sqrt(np.maximum(polar[:, 1] ** 2 - polar[:, 2] ** 2, 0.0))
    return np.column_stack([level * np.cos(polar[:, 0]), level * np.sin(polar[:, 0]), polar[:, 2]])


@dataclass(frozen=True, eq=False)
class _Lobes:
    """Echoes by bearing.

    Args:
        polar: Bearing, slant range and height, shape (n, 3), bearings rising. The beam is 9 degrees tall: seen from
            above, an echo reaches nearer to the radar than it stands, by 0.1 m at 30 m; its slant range does not.
        power: Linear, over what is usual, shape (n,).
    """

    polar: Float[np.ndarray, "n 3"]
    power: Float[np.ndarray, " n"]

    @classmethod
    def of(cls, places_m: Float[np.ndarray, "n 3"], power_db: Float[np.ndarray, " n"]) -> "_Lobes":
        x, y, z = places_m.T
        polar = np.column_stack([np.arctan2(y, x), np.linalg.norm(places_m, axis=1), z])
        order = np.argsort(polar[:, 0], kind="stable")
        return cls(polar[order], 10 ** (power_db[order] / 10))

    def mean(self, bearing: float, reach_m: float, half_rad: float, lobe: float) -> Float[np.ndarray, " 3"]:
        """Mean bearing, range and height of the echoes in a window, by their power above noise.

        The bearing is that of the echoes above a share ``lobe`` of the strongest.
        """
        low, high = np.searchsorted(self.polar[:, 0], (bearing - half_rad, bearing + half_rad))
        inside = low + np.flatnonzero(np.abs(self.polar[low:high, 1] - reach_m) < _DEPTH_M)
        if not len(inside):
            return np.array([bearing, reach_m, 0.0])
        share = self.power[inside] / self.power[inside].max()
        weight = np.maximum(share[:, None] - np.array([lobe, _LEAST_SHARE, _LEAST_SHARE]), 0.0)
        return np.asarray((weight * self.polar[inside]).sum(axis=0) / weight.sum(axis=0))

    def rest(self, bearing: float, reach_m: float, half_rad: float) -> Float[np.ndarray, " 3"]:
        """The same where the window is centred on its own mean (mean shift, Fukunaga and Hostetler 1975)."""
        found = self.mean(bearing, reach_m, half_rad, _LEAST_SHARE)
        for _ in range(_MOVES - 1):
            last = found
            found = self.mean(float(last[0]), float(last[1]), half_rad, _LEAST_SHARE)
            if abs(found[0] - last[0]) < _STILL_RAD:
                break
        return found


def _tops(places_m: Float[np.ndarray, "n 3"], power_db: Float[np.ndarray, " n"]) -> Int[np.ndarray, " k"]:
    """Echoes that are the strongest of those around; of equal ones the first."""
    risen = np.flatnonzero(power_db > LEAST_DB)
    if not len(risen):
        return risen
    reach = np.hypot(places_m[risen, 0], places_m[risen, 1])
    radius = np.maximum(_PEAK_M, _CELL_RAD * reach)  # or each far cell would be its own maximum
    around = cKDTree(places_m[risen, :2]).query_ball_point(places_m[risen, :2], radius).tolist()
    best = np.lexsort((np.arange(len(risen)), -power_db[risen]))
    rank = np.empty(len(risen), dtype=int)
    rank[best] = np.arange(len(risen))
    first: Bool[np.ndarray, " m"] = np.array([rank[near].min() for near in around]) == rank
    return risen[first]

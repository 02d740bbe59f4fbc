"""Statistics of a radar's range-azimuth power map: floor, echoes by range, side lobes, leakage, roll-off.

The map is the mean of linear power over Doppler and elevation, in dB. One public picture of a real K-Radar frame has a
floor of 109.1 dB from 15 to 107 m with a spread of 0.30 dB over cells, side lobes 0.5 / 0.8 / 1.2 / 2.0 / 4.2 dB above
it (quantiles 5 to 95 % of the strongest object's azimuth row), leakage 42 to 50 dB above it below 0.5 m, and -5 dB at
110 to 114 m. Of its cells 0.6, 9.1, 0.2, 0.0, 0.6 and 0.4 % rise 2 dB above the floor in the bands of ``RAISED_M``.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from farfield.radar.axes import KRADAR_AXES, POWER_UNIT
from farfield.radar.products import moments

FLOOR_M = (15.0, 107.0)
OBJECTS_M = (20.0, 107.0)
ZONES_M = {
    "leakage_db": (0.0, 0.4),
    "ring_db": (1.0, 5.0),
    "dip_db": (6.0, 11.0),
    "rolloff_db": (110.0, 114.0),
    "wrap_db": (116.0, np.inf),
}
ROW_QUANTILES = (5, 25, 50, 75, 95)
RAISED_M = ((6, 12), (12, 20), (20, 30), (30, 45), (45, 75), (75, 107))
RAISED_DB = 2.0
_GAUSS_OF_MAD = 1.4826


def power_map_db(radar: Mapping[str, Any]) -> Float[np.ndarray, "r a"] | None:
    """The range-azimuth map of a frame's radar: mean over Doppler and elevation, 10 log10 of file units.

    Args:
        radar: Products by name. ``polar3d`` (2, range, azimuth, elevation) is preferred to ``tesseract`` (Doppler,
            range, elevation, azimuth), since it is smaller; both on K-Radar's axes.

    Returns:
        The map in dB, or None where the frame has neither.
    """
    if "polar3d" in radar:
        power = np.asarray(radar["polar3d"])[0].astype(np.float64).mean(axis=2) * POWER_UNIT
    elif "tesseract" in radar:
        tensor = np.asarray(radar["tesseract"], dtype=np.float32)  # the real files hold float64
        power = moments(tensor, KRADAR_AXES).mean_power.mean(axis=1, dtype=np.float64)
    else:
        return None
    return 10.0 * np.log10(np.maximum(power, 1e-30))


def map_statistics(
    power_db: Float[np.ndarray, "r a"], range_m: Float[np.ndarray, " r"] = KRADAR_AXES.range_m
) -> dict[str, Any]:
    """Floor, spread, side lobes and the near and far edges of one range-azimuth map.

    Args:
        power_db: Map in dB.
        range_m: Range of its rows.

    Returns:
        ``floor_db`` and ``floor_std_db`` (median, and spread from the median absolute deviation, over 15 to 107 m, so
        that objects do not count); ``peak_db`` above the floor and ``peak_m`` of the strongest cell from 20 to 107 m;
        ``row_quantiles_db`` of its azimuth row above the floor; medians above the floor near 0 m (``leakage_db``), at 1
        to 5 m, 6 to 11 m, 110 to 114 m and beyond 116 m; and by range, such as "12-20", the share of cells that rise 2
        dB above the floor (``raised_share``). None where the map has no such range.
    """
    floor_cells = power_db[_between(range_m, FLOOR_M)]
    floor_db = float(np.median(floor_cells))
    spread_db = _GAUSS_OF_MAD * float(np.median(np.abs(floor_cells - floor_db)))
    rows = np.flatnonzero(_between(range_m, OBJECTS_M))
    peak_row, _ = np.unravel_index(np.argmax(power_db[rows]), power_db[rows].shape)
    row_db = power_db[rows[peak_row]] - floor_db
    statistics: dict[str, Any] = {
        "floor_db": floor_db,
        "floor_std_db": spread_db,
        "peak_db": float(row_db.max()),
        "peak_m": float(range_m[rows[peak_row]]),
        "row_quantiles_db": {str(q): float(np.percentile(row_db, q)) for q in ROW_QUANTILES},
    }
    for name, zone_m in ZONES_M.items():
        cells = power_db[_between(range_m, zone_m)]
        statistics[name] = float(np.median(cells) - floor_db) if cells.size else None
    statistics["raised_share"] = {}
    for low, high in RAISED_M:
        cells = power_db[(range_m >= low) & (range_m < high)]
        share = float((cells > floor_db + RAISED_DB).mean()) if cells.size else None
        statistics["raised_share"][f"{low}-{high}"] = share
    return statistics


def box_excess(
    power_db: Float[np.ndarray, "r a"], centre_m: Float[np.ndarray, "n 3"], floor_db: float
) -> Float[np.ndarray, " n"]:
    """How far the strongest cell at each object rises above the floor, in units of the floor: an SNR of the map.

    Args:
        power_db: Map in dB on K-Radar's axes.
        centre_m: Centres of objects in the radar's frame.
        floor_db: The map's floor.

    Returns:
        Linear excess of the strongest cell within 1.4 m and 2 degrees, shape (n,); NaN where the centre lies outside
        15 to 107 m or the field of view.
    """
    axes = KRADAR_AXES
    range_m = np.linalg.norm(centre_m, axis=1)
    azimuth_deg = np.degrees(np.arctan2(centre_m[:, 1], centre_m[:, 0]))
    excess = np.full(len(centre_m), np.nan)
    inside = _between(range_m, FLOOR_M) & (np.abs(azimuth_deg) <= axes.azimuth_deg[-1])
    for index in np.flatnonzero(inside):
        row = round(float(range_m[index]) / axes.range_step_m)
        column = round(float(azimuth_deg[index] - axes.azimuth_deg[0]))
        patch = power_db[row - 3 : row + 4, max(column - 2, 0) : column + 3]
        excess[index] = 10.0 ** ((patch.max() - floor_db) / 10.0) - 1.0
    return excess


def _between(range_m: np.ndarray, zone_m: tuple[float, float]) -> np.ndarray:
    return (range_m >= zone_m[0]) & (range_m <= zone_m[1])


def exponential_ratio(tensor: np.ndarray) -> float:
    """Median over mean power of single cells, range by range from 60 to 107 m, the median of the ranges.

    Noise of a single look is exponential, whose ratio is ln 2 = 0.693.
    """
    rows = np.flatnonzero(_between(KRADAR_AXES.range_m, (60.0, FLOOR_M[1])))
    cells = tensor[:, rows[::4]]
    return float(np.median([np.median(part) / part.mean(dtype=np.float64) for part in np.moveaxis(cells, 1, 0)]))


@dataclass(kw_only=True)
class RadarTally:
    """Statistics of each frame's map, the first map, and the mean range profile."""

    per_frame: list[dict[str, Any]] = field(default_factory=list)
    cell_ratios: list[float] = field(default_factory=list)
    first_map_db: np.ndarray | None = None
    profile_db: np.ndarray | None = None

    @property
    def frames(self) -> int:
        """Frames that had a radar map."""
        return len(self.per_frame)

    def add(self, radar: Mapping[str, Any]) -> tuple[np.ndarray, float] | None:
        """Take in one frame's radar; returns its map and floor in dB, or None where it has none."""
        power_db = power_map_db(radar)
        if power_db is None:
            return None
        statistics = map_statistics(power_db)
        above_db = np.median(power_db, axis=1) - statistics["floor_db"]
        if self.profile_db is None:
            self.first_map_db, self.profile_db = power_db.astype(np.float32), np.zeros(len(above_db))
        self.profile_db += above_db
        self.per_frame.append(statistics)
        if "tesseract" in radar and not self.cell_ratios:  # one frame tells, and a tensor is 260 MB
            self.cell_ratios.append(exponential_ratio(radar["tesseract"]))
        return power_db, statistics["floor_db"]

    def merge(self, other: "RadarTally") -> None:
        """Take in other frames."""
        if other.profile_db is not None:
            if self.profile_db is None:
                self.first_map_db, self.profile_db = other.first_map_db, np.zeros_like(other.profile_db)
            self.profile_db = self.profile_db + other.profile_db
        self.per_frame += other.per_frame
        self.cell_ratios += other.cell_ratios

    def summary(self) -> dict[str, Any] | None:
        """The median over frames of every statistic, or None without radar."""
        if not self.per_frame:
            return None
        first = self.per_frame[0]
        middle = {
            name: {key: _median([frame[name][key] for frame in self.per_frame]) for key in value}
            if isinstance(value, dict)
            else _median([frame[name] for frame in self.per_frame])
            for name, value in first.items()
        }
        return {"frames": self.frames, **middle, "cell_median_to_mean": _median(self.cell_ratios)}

    def arrays(self) -> dict[str, np.ndarray]:
        """``map_db`` of the first frame; ``profile_db``, the frames' mean of each range's median above the floor."""
        if self.profile_db is None or self.first_map_db is None:
            return {}
        return {
            "map_db": self.first_map_db,
            "profile_db": self.profile_db / self.frames,
            "range_m": KRADAR_AXES.range_m,
            "azimuth_deg": KRADAR_AXES.azimuth_deg,
        }


def _median(values: list[Any]) -> float | None:
    finite = [value for value in values if value is not None]
    return float(np.median(finite)) if finite else None

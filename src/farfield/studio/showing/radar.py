"""A radar's power from above and from the front, as maps in dB: polar where the data are, else in metres."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from farfield.annotation.fitting.ground import ground_ahead
from farfield.annotation.fitting.radar import peak_near
from farfield.frame import Frame
from farfield.geometry.poses import invert
from farfield.radar.axes import CUBE_SHAPE, CUBE_STEP_M, CUBE_X_M, CUBE_Y_M, CUBE_Z_M, KRADAR_AXES, OUTSIDE, POWER_UNIT
from farfield.radar.cells import RadarCells
from farfield.radar.views import bev_2d, bfs_2d, decibel, polar_views
from farfield.studio.messages.rows import Grid, LayerKind, Polar
from farfield.vocabulary.kradar import REGIONS_M

PRODUCTS = ("polar3d", "moments", "cube", "cells")
"""Of which maps are made, the first that is there."""


def product_of(radar: Mapping[str, Any]) -> str | None:
    """The product of which a frame's maps are made, or None; nothing is read."""
    return next((name for name in PRODUCTS if name in radar), None)


def axes_of(product: str, kind: LayerKind) -> tuple[Polar | None, Grid | None]:
    """Where the cells of a map lie; see :class:`~farfield.studio.messages.rows.Polar`."""
    if product in ("polar3d", "moments"):
        angles = [np.radians(axis) for axis in (KRADAR_AXES.azimuth_deg, KRADAR_AXES.elevation_deg)]
        plane = {"range_m": _axis(KRADAR_AXES.range_m), "azimuth_rad": _axis(angles[0])}
        return Polar(**plane, elevation_rad=_axis(angles[1])), None
    if kind == "bev":
        return None, Grid(x_m=_axis(CUBE_X_M), y_m=_axis(CUBE_Y_M))
    return None, Grid(y_m=_axis(CUBE_Y_M), z_m=_axis(CUBE_Z_M))


def _axis(values: Float[np.ndarray, " n"]) -> tuple[float, float, int]:
    return (float(values[0]), float(values[1] - values[0]), len(values)) if len(values) > 1 else (0.0, 1.0, 0)


@dataclass(frozen=True, eq=False)
class RadarPower:
    """A frame's power, ready to be seen from any side.

    Args:
        product: What it was read from.
        power: Polar over ``POWER_UNIT`` (range, azimuth, elevation), or the cube (z, y, x) in file units.
        doppler_m_s: Wrapped mean velocity of the polar cells, away from the radar; None where it is not there.
    """

    product: str
    power: Float[np.ndarray, "a b c"]
    doppler_m_s: Float[np.ndarray, "a b c"] | None = None

    @classmethod
    def read(cls, radar: Mapping[str, Any]) -> "RadarPower":
        """Read it.

        Raises:
            KeyError: If the frame has none of :data:`PRODUCTS`.
        """
        product = product_of(radar)
        if product is None:
            raise KeyError(f"the frame has no radar product of {', '.join(PRODUCTS)}")
        values: Any = radar[product]
        if product == "polar3d":
            power, doppler_m_s = (np.ascontiguousarray(channel, dtype=np.float32) for channel in values[:2])
            return cls(product, power, doppler_m_s)
        if product == "moments":
            unit = np.float32(1 / POWER_UNIT)
            return cls(product, np.ascontiguousarray(values.mean_power_63.transpose(0, 2, 1)) * unit)
        return cls(product, _cube(values) if product == "cells" else np.asarray(values, dtype=np.float32))

    @property
    def polar(self) -> bool:
        """Whether its cells are range, azimuth and elevation."""
        return self.product in ("polar3d", "moments")

    def from_above(self) -> Float[np.ndarray, "_ _"]:
        """BEV-2D in dB: polar (range, azimuth), of a cube (y, x) over the heights of K-Radar's wide region."""
        if self.polar:
            return decibel(polar_views(self.power, "mean").bird, unit=1.0)
        low, high = REGIONS_M["wide"][4:]
        return decibel(bev_2d(self.power[(low <= CUBE_Z_M) & (high > CUBE_Z_M)], "mean"))

    def from_front(self, low_m: float = 0.0, high_m: float = float("inf")) -> Float[np.ndarray, "_ _"]:
        """BFS-2D in dB: the strongest cell between two ranges; polar (elevation, azimuth), of a cube (z, y).

        Args:
            low_m: Range, of a cube x, from which on.
            high_m: Up to which.
        """
        steps = KRADAR_AXES.range_m if self.polar else CUBE_X_M
        half = (KRADAR_AXES.range_step_m if self.polar else CUBE_STEP_M) / 2
        rows = np.flatnonzero((steps >= low_m - half) & (steps <= high_m + half))
        if not len(rows):
            rows = np.array([int(np.abs(steps - (low_m + min(high_m, 1e6)) / 2).argmin())])
        part = slice(int(rows[0]), int(rows[-1]) + 1)
        if self.polar:
            return decibel(polar_views(self.power[part], "max").front, unit=1.0)
        return decibel(bfs_2d(np.ascontiguousarray(self.power[:, :, part]), "max").front)

    def near(self, at_xy: tuple[float, float], reach_m: float) -> "RadarBlock":
        """The cells about a place, at all heights.

        Args:
            at_xy: The place in the radar's own axes, x and y, metres.
            reach_m: How far the cells reach from it, along and across the line of sight (of a cube, along x and y).

        Returns:
            No cell where the radar has none there.
        """
        x, y = at_xy
        if not self.polar:
            axes = {"z_m": CUBE_Z_M, "y_m": CUBE_Y_M, "x_m": CUBE_X_M}
            parts = [np.arange(len(CUBE_Z_M)), _within(CUBE_Y_M, y, reach_m), _within(CUBE_X_M, x, reach_m)]
        else:
            range_m = float(np.hypot(x, y))
            turn_rad = np.pi if range_m <= reach_m else float(np.arcsin(reach_m / range_m))
            angles_rad = np.radians(KRADAR_AXES.azimuth_deg)
            elevations_rad = np.radians(KRADAR_AXES.elevation_deg)
            axes = {"range_m": KRADAR_AXES.range_m, "azimuth_rad": angles_rad, "elevation_rad": elevations_rad}
            parts = [
                _within(KRADAR_AXES.range_m, range_m, reach_m),
                _within(angles_rad, float(np.arctan2(y, x)), turn_rad),
                np.arange(len(elevations_rad)),
            ]
        if any(len(part) < 2 for part in parts):
            parts = [part[:0] for part in parts]
        cut = np.ix_(*parts)
        level_db = decibel(np.ascontiguousarray(self.power[cut]), unit=1.0 if self.polar else POWER_UNIT)
        doppler_m_s = None if self.doppler_m_s is None else self.doppler_m_s[cut]
        return RadarBlock(
            {name: _axis(axis[part]) for (name, axis), part in zip(axes.items(), parts, strict=True)},
            level_db,
            doppler_m_s,
        )

    def peak_near(self, at_xy: tuple[float, float], *, reach_m: float = 1.5) -> tuple[float, float] | None:
        """The strongest echo within reach of a place, both in the radar's own axes; None where there is none."""
        if self.polar:
            return peak_near(self.power.max(axis=2), at_xy, KRADAR_AXES, reach_m=reach_m)
        level = self.power.max(axis=0)
        y, x = np.meshgrid(CUBE_Y_M, CUBE_X_M, indexing="ij")
        near = (level > 0) & (np.hypot(x - at_xy[0], y - at_xy[1]) <= reach_m)
        if not near.any():
            return None
        row, column = np.unravel_index(int(np.argmax(np.where(near, level, OUTSIDE))), level.shape)
        return float(CUBE_X_M[column]), float(CUBE_Y_M[row])


@dataclass(frozen=True, eq=False)
class RadarBlock:
    """Some of a radar's cells in three dimensions.

    Args:
        axes: First value, step and count of each axis, in the order of the arrays' axes: range, azimuth and elevation
            (m and rad), or z, y and x (m), all in the radar's own axes.
        level_db: Power, NaN where there is none.
        doppler_m_s: Wrapped mean velocity of the cells, away from the radar, or None.
    """

    axes: Mapping[str, tuple[float, float, int]]
    level_db: Float[np.ndarray, "a b c"]
    doppler_m_s: Float[np.ndarray, "a b c"] | None


def _within(axis: Float[np.ndarray, " n"], middle: float, reach: float) -> Int[np.ndarray, " m"]:
    """Numbers of an axis' cells about a value."""
    return np.flatnonzero(np.abs(axis - middle) <= reach)


def in_radar(frame: Frame, at_xy: tuple[float, float]) -> tuple[float, float]:
    """A place of the frame in its radar's own axes; the same numbers where it is not known how the radar stands."""
    pose = frame_T_radar_of(frame)
    if pose is None:
        return at_xy
    x, y = (invert(pose) @ np.array([*at_xy, pose[2, 3], 1.0]))[:2].tolist()
    return x, y


def frame_T_radar_of(frame: Frame) -> Float[np.ndarray, "4 4"] | None:
    """How the radar of a frame's maps stands, or None."""
    product = product_of(frame.radar)
    return None if product is None else frame.sensors[product].frame_T_sensor


def ground_z_m(frame: Frame, at_xy: tuple[float, float]) -> float | None:
    """Height of the ground at a place, by what the LiDAR sees before it; None without points."""
    if not frame.clouds:
        return None
    pose = frame_T_radar_of(frame)
    ego_m = (0.0, 0.0) if pose is None else (float(pose[0, 3]), float(pose[1, 3]))
    ground = ground_ahead(frame.cloud().points_m, at_xy, ego_m)
    return ground.z_m(*at_xy) if ground.cells else None


def snapped(frame: Frame, power: Callable[[], RadarPower], at: tuple[float, ...]) -> tuple[float, ...]:
    """The radar's peak nearest to a press, in the frame's coordinates; the press itself where there is none.

    Args:
        frame: The frame.
        power: Gives its power, where it is needed.
        at: The press, x and y, metres.
    """
    pose = frame_T_radar_of(frame)
    if pose is None:
        return at
    peak = power().peak_near(in_radar(frame, (at[0], at[1])))
    if peak is None:
        return at
    x, y = (pose @ np.array([*peak, 0.0, 1.0]))[:2].tolist()
    return x, y


def _cube(cells: RadarCells) -> Float[np.ndarray, "150 400 250"]:
    cube = np.full(CUBE_SHAPE, OUTSIDE, dtype=np.float32)
    cube.ravel()[cells.index] = cells.power * np.float32(POWER_UNIT)
    return cube

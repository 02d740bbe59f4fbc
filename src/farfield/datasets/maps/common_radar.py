"""Radar clouds of any data set in one form: power over the floor at its range, Doppler and height with a flag each.

Two radars differ in unit, floor, resolution and columns. What a network that is to go from one to the other reads:
position, power in units of 20 dB over the median of its range in the training set (from -1 to 4), Doppler or 0,
whether Doppler and height are known; of several points in one cell the strongest.
"""

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar, Literal

import numpy as np
from jaxtyping import Float, Float32, Int
from pydantic import BaseModel, ConfigDict, Field

from farfield.datasets.frame_maps import Earlier
from farfield.errors import ConfigError, DatasetError
from farfield.frame import Cloud, Frame, Key, Lazy

UNIT_DB, LIMITS = 20.0, (-1.0, 4.0)
BIN_M = 5.0
FLAGS = ("has_doppler", "has_height")
_FEWEST = 20  # values of a range bin that its median is taken of


class CommonRadarSettings(BaseModel):
    """Settings of :class:`CommonRadar`; see there."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    floor_db: tuple[float, ...] = Field(min_length=1)
    spread_db: tuple[float, ...] = ()
    column: str = "power"
    unit: Literal["linear", "db"] = "linear"
    db_per_one: float = Field(1.0, gt=0)
    doppler: bool = True
    height: bool = True
    cell_m: float | None = Field(None, gt=0)
    drop_doppler: float = Field(0.0, ge=0, le=1)
    cloud: str = "radar"
    format: str = ""


@dataclass(frozen=True, kw_only=True)
class CommonRadar:
    """A radar cloud with the columns ``power``, ``doppler_m_s``, ``has_doppler`` and ``has_height``.

    Args:
        floor_db: Median of the power in every ``BIN_M`` of range, shape (bins,): :func:`floor_of` takes it.
        spread_db: Median absolute deviation beside it, for the record.
        column: The cloud's column of power.
        unit: Whether that is linear or in decibels.
        db_per_one: Decibels of one unit of a column in decibels.
        doppler: Whether the cloud's ``doppler_m_s`` is read; without it there is none.
        height: Whether z is read; without it z is 0.
        cell_m: Keep the strongest point of each cube of this side alone; None keeps all.
        drop_doppler: Share of the frames whose Doppler is left out, drawn by their names.
        cloud: The cloud.
        format: Data sets whose frames can be seen so, by name; all if empty.
    """

    name: ClassVar[str] = "common_radar"
    Settings: ClassVar[type[BaseModel]] = CommonRadarSettings
    keeps_annotation: ClassVar[bool] = True
    frames_before: ClassVar[int] = 0
    floor_db: tuple[float, ...]
    spread_db: tuple[float, ...] = ()
    column: str = "power"
    unit: Literal["linear", "db"] = "linear"
    db_per_one: float | int = 1.0
    doppler: bool = True
    height: bool = True
    cell_m: float | int | None = None
    drop_doppler: float | int = 0.0
    cloud: str = "radar"
    format: str = ""

    def settings(self) -> Mapping[str, Any]:
        """All settings."""
        return CommonRadarSettings(
            **{name: getattr(self, name) for name in CommonRadarSettings.model_fields}
        ).model_dump(mode="json")

    def moved_poses(self, world_T_frame: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 4 4"]:
        """The poses as they are."""
        return world_T_frame

    def fits(self, dataset: Any) -> bool:
        """Whether a data set is of the format that the floor was taken of."""
        return not self.format or bool(dataset.name == self.format)

    def __call__(self, frame: Frame, earlier: Earlier) -> Frame:
        """The frame with its radar cloud so."""
        del earlier
        if self.cloud not in frame.clouds:
            raise DatasetError(
                f"common_radar: expected a cloud {self.cloud!r}; frame {frame.key} has {list(frame.clouds)}"
            )
        load = partial(self._seen, frame)
        return replace(
            frame,
            clouds=Lazy(
                {name: load if name == self.cloud else partial(frame.clouds.__getitem__, name) for name in frame.clouds}
            ),
        )

    def _seen(self, frame: Frame) -> Cloud:
        return self.of_cloud(frame.clouds[self.cloud], frame.key)

    def of_cloud(self, cloud: Cloud, key: Key = ("", "")) -> Cloud:
        """A cloud in the common form.

        Args:
            cloud: With the column of power, and ``doppler_m_s`` if that is read.
            key: The frame's name, which decides whether its Doppler is left out.
        """
        power = self.decibels(cloud)
        range_m = np.linalg.norm(cloud.points_m, axis=1)
        rows = np.minimum((range_m / BIN_M).astype(np.int64), len(self.floor_db) - 1)
        value = np.clip((power - np.array(self.floor_db)[rows]) / UNIT_DB, *LIMITS).astype(np.float32)
        points = cloud.points_m.astype(np.float32)
        points = points if self.height else points * np.array([1, 1, 0], dtype=np.float32)
        draw = int.from_bytes(hashlib.sha256("\0".join(key).encode()).digest()[:4], "big")  # uniform below 2^32
        has_doppler = self.doppler and draw >= float(self.drop_doppler) * 2**32
        doppler = cloud.column("doppler_m_s") if has_doppler else np.zeros(len(points), dtype=np.float32)
        selected = np.arange(len(points)) if self.cell_m is None else strongest(points, value, float(self.cell_m))
        flags = {
            name: np.full(len(selected), float(on), dtype=np.float32)
            for name, on in zip(FLAGS, (has_doppler, self.height), strict=True)
        }
        columns = {
            "power": value[selected],
            "doppler_m_s": np.nan_to_num(doppler[selected]).astype(np.float32),
            **flags,
        }
        return Cloud(points[selected], None, columns)

    def decibels(self, cloud: Cloud) -> Float[np.ndarray, " n"]:
        """A cloud's power in decibels, of a scale of its own, shape (n,)."""
        value = cloud.column(self.column).astype(np.float64)
        if self.unit == "db":
            return np.asarray(value * float(self.db_per_one))
        return np.asarray(10 * np.log10(np.maximum(value, 1e-12)))

    def fitted(self, frames: Iterable[Frame], *, reach_m: float | int = 120.0) -> "CommonRadar":
        """The same with the floor of some frames: median and deviation of the power by range, over all their points.

        Take frames whose clouds hold all cells, else the floor is that of what was kept; a bin of too few points has
        its neighbours'.

        Args:
            frames: Frames of the training set.
            reach_m: Range of the last bin.

        Raises:
            ConfigError: If they hold hardly any point.
        """
        power_by_bin: list[list[Float[np.ndarray, " k"]]] = [[] for _ in range(round(float(reach_m) / BIN_M))]
        for frame in frames:
            cloud = frame.clouds[self.cloud]
            power = self.decibels(cloud)
            rows = (np.linalg.norm(cloud.points_m, axis=1) / BIN_M).astype(np.int64)
            for row in np.unique(rows[rows < len(power_by_bin)]):
                power_by_bin[row].append(power[rows == row])
        values = [np.concatenate(values_db) if values_db else np.zeros(0) for values_db in power_by_bin]
        bins = np.array([row for row, values_db in enumerate(values) if len(values_db) >= _FEWEST])
        if not len(bins):
            raise ConfigError(
                f"common_radar: expected at least {_FEWEST} points in some {BIN_M:g} m of range, got none"
            )
        middle = np.array([np.median(values[row]) for row in bins])
        spread = np.array([np.median(np.abs(values[row] - m)) for row, m in zip(bins, middle, strict=True)])
        every = np.arange(len(values))
        floor, beside = (np.interp(every, bins, values_db).round(3) for values_db in (middle, spread))
        return replace(self, floor_db=tuple(map(float, floor)), spread_db=tuple(map(float, beside)))


def strongest(
    points_m: Float32[np.ndarray, "n 3"], value: Float32[np.ndarray, " n"], cell_m: float
) -> Int[np.ndarray, " k"]:
    """Rows of the strongest point in every cube of a raster: the mean would lose small objects."""
    cell = np.floor(points_m / cell_m).astype(np.int64)
    cell -= cell.min(axis=0, initial=0)
    along_x, along_y, along_z = cell.T
    _, width, height = cell.max(axis=0, initial=0) + 1
    number = (along_x * width + along_y) * height + along_z
    order = np.lexsort((-value, number))
    return np.sort(order[np.unique(number[order], return_index=True)[1]])

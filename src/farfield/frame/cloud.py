"""Point clouds with named columns."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, Num, Shaped

from farfield.errors import ConfigError, DatasetError
from farfield.geometry.boxes import Boxes, points_in_boxes
from farfield.geometry.poses import transform_points
from farfield.registry import display_html, named

_PLACE = ("x_m", "y_m", "z_m")
RADAR_COLUMNS = ("power", "doppler", "rcs")
"""How the columns begin that a radar's clouds have and a LiDAR's have not."""


@dataclass(frozen=True, eq=False)
class Cloud:
    """A point cloud with whatever columns its file had.

    Args:
        points_m: x, y, z in metres, shape (n, 3); kept as float32.
        intensity: Return strength in [0, 1], shape (n,), kept as float32; None where it is not known, and for a radar,
            whose power or cross-section is a column of its own.
        extra: Further columns by name, each of shape (n,): ``ring``, ``time_ns``, ``power``, ``doppler_m_s``...
        missing: Rows of the file that had no place, as organised clouds mark a direction without return; left out.

    Raises:
        ValueError: If columns differ in length, points have no three numbers or an intensity lies outside [0, 1].
    """

    points_m: Num[np.ndarray, "n 3"]
    intensity: Num[np.ndarray, " n"] | None = None
    extra: Mapping[str, Shaped[np.ndarray, " n"]] = field(default_factory=dict)
    missing: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "points_m", np.asarray(self.points_m, dtype=np.float32))
        if self.points_m.ndim != 2 or self.points_m.shape[1] != 3:
            raise ValueError(
                f"Cloud.points_m: expected shape (n, 3), got {self.points_m.shape}; Cloud.of takes rows of more columns"
            )
        if self.intensity is not None:
            object.__setattr__(self, "intensity", np.asarray(self.intensity, dtype=np.float32))
        columns = [*self.extra.values(), *([] if self.intensity is None else [self.intensity])]
        if any(len(column) != len(self.points_m) for column in columns):
            raise ValueError(f"Cloud: expected columns of equal length, got {len(self.points_m)} points")
        if self.intensity is not None and not ((self.intensity >= 0) & (self.intensity <= 1)).all():
            raise ValueError(
                f"Cloud: expected intensities in [0, 1], got {self.intensity.min():g} to {self.intensity.max():g}; "
                "scale them, or give a radar's power as a column of extra"
            )

    @classmethod
    def of(cls, rows: Shaped[np.ndarray, "n columns"]) -> "Cloud":
        """A cloud of an array, its columns taken as those of a file: x, y, z, then intensity, then what they show.

        Intensities up to 255 or 65535 are brought to [0, 1]; where there are but three columns they are 0.

        Args:
            rows: Shape (n, 3) or wider.

        Raises:
            ConfigError: If the array has another shape.
            DatasetError: If coordinates are not finite.
        """
        cloud: Cloud = named("farfield.datasets.cloud_files:cloud_of_rows")(np.asarray(rows))
        return cloud

    @classmethod
    def from_file(cls, path: Path | str) -> "Cloud":
        """Read a cloud file: .pcd, .bin, .npy, .xyz or .ffcloud; see ``farfield.datasets.cloud_files.read_cloud``.

        Raises:
            FarfieldError: If there is no such file, its suffix is unknown or it is damaged.
        """
        if not Path(path).is_file():
            raise DatasetError(f"{path}: expected a cloud file, found none there")
        cloud: Cloud = named("farfield.datasets.cloud_files:read_cloud")(Path(path))
        return cloud

    @property
    def kind(self) -> Literal["lidar", "radar"]:
        """A radar's if it has a radar's columns and no intensity, else a LiDAR's."""
        of_radar = any(name.startswith(RADAR_COLUMNS) for name in self.extra)
        return "radar" if of_radar and self.intensity is None else "lidar"

    def __len__(self) -> int:
        return len(self.points_m)

    def __repr__(self) -> str:
        reach_m = np.hypot(self.points_m[:, 0], self.points_m[:, 1])
        reach = f" to {reach_m[np.isfinite(reach_m)].max(initial=0.0):.0f} m" if len(self) else ""
        return f"Cloud({len(self):,} points{reach}; {', '.join(self.columns)})"

    def _repr_html_(self) -> str | None:
        """What a notebook shows: the cloud from above."""
        return display_html("cloud", self)

    def __getitem__(self, index: slice | Bool[np.ndarray, " n"] | Int[np.ndarray, " k"]) -> "Cloud":
        intensity = None if self.intensity is None else self.intensity[index]
        return Cloud(self.points_m[index], intensity, {k: v[index] for k, v in self.extra.items()})

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns that :meth:`column` gives."""
        return (*_PLACE, *(() if self.intensity is None else ("intensity",)), *self.extra)

    def column(self, name: str) -> Float32[np.ndarray, " n"]:
        """One column as float32, shape (n,): ``x_m``, ``y_m``, ``z_m``, ``intensity`` or one of ``extra``.

        ``lag_s``, the age of a point's sweep, is zero where the cloud does not have it; so is the intensity of a
        LiDAR's cloud that has none, with a warning.

        Raises:
            ConfigError: If the cloud has no such column.
        """
        if name in _PLACE:
            return self.points_m[:, _PLACE.index(name)]
        if name == "intensity" and self.intensity is not None:
            return self.intensity
        if name in self.extra:
            return self.extra[name].astype(np.float32, copy=False)
        if name == "lag_s":
            return np.zeros(len(self), dtype=np.float32)
        if name == "intensity" and self.kind == "lidar":
            warnings.warn(
                "The cloud has no intensity: it is read as 0. A detector that learnt with intensities finds less so; "
                "Cloud(points_m, intensity) gives them.",
                stacklevel=2,
            )
            return np.zeros(len(self), dtype=np.float32)
        raise ConfigError(
            f"Expected a cloud with the column {name!r}; it has {', '.join(self.columns)}. Take a detector that does "
            "not read it, or data that have it."
        )

    @classmethod
    def concatenate(cls, parts: "list[Cloud]") -> "Cloud":
        """Join clouds; only the columns that all of them have are kept."""
        shared = set.intersection(*(set(part.extra) for part in parts)) if parts else set()
        strengths = [part.intensity for part in parts if part.intensity is not None]
        return cls(
            np.concatenate([part.points_m for part in parts]),
            np.concatenate(strengths) if len(strengths) == len(parts) else None,
            {name: np.concatenate([part.extra[name] for part in parts]) for name in sorted(shared)},
        )

    def transform(self, target_T_source: Float[np.ndarray, "4 4"]) -> "Cloud":
        """Move all points rigidly into another frame."""
        moved = transform_points(target_T_source, self.points_m.astype(np.float64)).astype(np.float32)
        return Cloud(moved, self.intensity, self.extra)

    def in_boxes(self, boxes: Boxes, *, margin_m: float = 0.0) -> list[Int[np.ndarray, " _"]]:
        """Indices of the points inside each box, one array a box."""
        return points_in_boxes(self.points_m, boxes, margin_m=margin_m)

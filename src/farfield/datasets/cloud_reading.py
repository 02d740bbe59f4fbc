"""How the cloud files of a data set are read: one number of columns, one full scale, one unit of times for all."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cached_property, partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from farfield.errors import ConfigError, FarfieldError
from farfield.files.clouds import names_of
from farfield.files.intensities import intensity_scale_of
from farfield.files.point_times import PointTimeColumn, PointTimes, check_point_times, point_time_column
from farfield.frame import Cloud
from farfield.frame.cloud import (
    CloudSettings,
    columns_shown,
    named_columns,
    points_of,
    read_cloud,
    read_columns,
    returned,
)

_LOOKED_AT = 8


class CloudReading:
    """Reads the clouds of one data set alike.

    What is not given is decided by some of the files, spread from the first to the last, when a cloud is first read:
    a scale or a unit of its own for each file would make one sweep darker or longer than the next.

    Args:
        paths: All files, in the order of time.
        bin_columns: Columns of ``.bin`` files; None takes what the largest of the first ones shows.
        intensity_scale: Value that stands for full reflectance; None decides.
        point_times: Unit of the points' times.
        stamps_ns: Time of each file since 1970; None where they are not known.
        usual_columns: Columns of the format's ``.bin`` files, taken where the numbers do not show them.
        usual_scale: The format's full scale, taken where the columns are as usual.

    Raises:
        ConfigError: If the scale is not positive, or the unit is none.
    """

    def __init__(
        self,
        paths: Sequence[Path],
        *,
        bin_columns: int | None = None,
        intensity_scale: float | int | None = None,
        point_times: PointTimes = "auto",
        stamps_ns: Sequence[int | None] = (),
        usual_columns: int | None = None,
        usual_scale: float | None = None,
    ) -> None:
        if intensity_scale is not None and not 0 < intensity_scale < np.inf:
            raise ConfigError(f"intensity_scale: expected a positive number, got {intensity_scale!r}")
        check_point_times(point_times)
        self.bin_columns = bin_columns or columns_shown(paths[:_LOOKED_AT]) or usual_columns
        is_usual = usual_scale is not None and self.bin_columns == usual_columns
        self.intensity_scale = usual_scale if intensity_scale is None and is_usual else intensity_scale
        self.point_times = point_times
        rows = np.unique(np.linspace(0, max(len(paths) - 1, 0), _LOOKED_AT).astype(int)).tolist()
        self.samples = tuple(paths[row] for row in rows if paths)
        times = [time for time in stamps_ns if time is not None]
        steps = [later - earlier for earlier, later in pairwise(times) if later > earlier]
        self.period_ns = float(np.median(steps)) if steps and len(times) == len(paths) else None

    @cached_property
    def settings(self) -> CloudSettings:
        """What all clouds share, by the sampled files; damaged ones are reported when they are read."""
        samples = {}
        for path in self.samples:
            with suppress(FarfieldError, OSError):
                columns = read_columns(path, bin_columns=self.bin_columns)
                samples[path] = points_of(path, columns) if isinstance(columns, np.ndarray) else columns
        rows = [rows for rows in samples.values() if isinstance(rows, np.ndarray)]
        counts = {part.shape[1] for part in rows}
        row_names = {count: names_of(np.concatenate([p for p in rows if p.shape[1] == count])) for count in counts}
        strengths, units = [], []
        for path, columns in samples.items():
            with suppress(FarfieldError):
                named = named_columns(path, columns, row_names)
                if not {"x", "y", "z"} <= set(named):
                    continue
                valid = returned(path, np.column_stack([named[axis] for axis in "xyz"]))
                strengths.append(named.get("intensity", np.zeros(len(valid), np.float32))[valid])
                name = point_time_column(named)
                if name is not None and self.point_times == "auto":
                    units.append(PointTimeColumn(name, named[name][valid], path, None, self.period_ns).unit())
        return CloudSettings(
            intensity_scale=intensity_scale_of(strengths) if self.intensity_scale is None else self.intensity_scale,
            point_times=self.point_times,
            usual_unit=next((unit for unit in units if unit is not None), None),
            row_names=row_names,
            period_ns=self.period_ns,
        )

    @property
    def scale(self) -> float:
        """Value that stands for full reflectance."""
        scale = self.settings.intensity_scale if self.intensity_scale is None else self.intensity_scale
        return 1.0 if scale is None else float(scale)

    def __call__(self, path: Path, stamp_ns: int | None = None) -> Cloud:
        """Read one cloud.

        Args:
            path: The file.
            stamp_ns: Its time since 1970.

        Raises:
            FarfieldError: As :func:`~farfield.frame.cloud.read_cloud` does.
        """
        return read_cloud(path, self.settings.at(stamp_ns), bin_columns=self.bin_columns)

    def loader(self, path: Path, stamp_ns: int | None = None) -> Callable[[], Cloud]:
        """What reads one cloud when it is called."""
        return partial(self, path, stamp_ns)

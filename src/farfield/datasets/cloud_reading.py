"""How the cloud files of a data set are read: one number of columns, one full scale, one unit of times for all."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cached_property, partial
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Shaped

from farfield.errors import ConfigError, DatasetError, FarfieldError, FileFormatError, MissingExtraError
from farfield.files.clouds import names_of
from farfield.files.intensities import intensity_scale_of
from farfield.files.las import las_middle, read_las
from farfield.files.map_coordinates import MAP_SUFFIXES, NEAREST_M, Origin, less_origin, origin_of
from farfield.files.point_times import UNITS_NS, PointTimeColumn, PointTimes, check_point_times, point_time_column
from farfield.frame import Cloud
from farfield.frame.cloud import CloudSettings, columns_shown, read_cloud, read_columns
from farfield.frame.cloud_columns import Columns, RowNames, checked_names, named_columns, points_of, returned

_LOOKED_AT = 8
_UNREADABLE = (FileFormatError, DatasetError, ConfigError, MissingExtraError, OSError)  # not so a lack of memory


class CloudReading:
    """Reads the clouds of one data set alike.

    What is not given is decided by some of the files, spread from the first to the last, when a cloud is first read:
    a scale or a unit of its own for each file would make one sweep darker or longer than the next.

    LAS and LAZ clouds of a map lose one origin, that of the first. Those of a survey that lie more than 10 km from it
    lose the middle of their own box, where the data set gives their frames the pose of :meth:`world_T_frame`, by which
    they stay in one piece; they are refused elsewhere, and so are clouds in coordinates of their own among those of a
    map.

    Args:
        paths: All files, in the order of time.
        bin_columns: Columns of ``.bin`` files; None takes what the largest of the first ones shows.
        column_names: Names of the columns of all files that name none (``.bin``, ``.npy``, ``.xyz``); empty names them
            by what they hold.
        intensity_scale: Value that stands for full reflectance; None decides.
        point_times: Unit of the points' times.
        stamps_ns: Time of each file since 1970; None where they are not known.
        usual_columns: Columns of the format's ``.bin`` files, taken where the numbers do not show them.
        usual_scale: The format's full scale, taken where the columns are as usual.
        posed: Whether the frames take the poses of :meth:`world_T_frame`.

    Raises:
        ConfigError: If the scale is not positive, the unit is none, or the names cannot be those of columns.
    """

    def __init__(
        self,
        paths: Sequence[Path],
        *,
        bin_columns: int | None = None,
        column_names: Sequence[str] = (),
        intensity_scale: float | int | None = None,
        point_times: PointTimes = "auto",
        stamps_ns: Sequence[int | None] = (),
        usual_columns: int | None = None,
        usual_scale: float | None = None,
        posed: bool = False,
    ) -> None:
        if intensity_scale is not None and not 0 < intensity_scale < np.inf:
            raise ConfigError(f"intensity_scale: expected a positive number, got {intensity_scale!r}")
        check_point_times(point_times)
        self.column_names = checked_names(column_names) if column_names else ()
        self.bin_columns = bin_columns or len(self.column_names) or columns_shown(paths[:_LOOKED_AT]) or usual_columns
        is_usual = usual_scale is not None and self.bin_columns == usual_columns
        self.intensity_scale = usual_scale if intensity_scale is None and is_usual else intensity_scale
        self.scale_source = "given" if intensity_scale else "the format's" if is_usual else "decided from the data"
        self.point_times, self.posed = point_times, posed
        self.maps = tuple(path for path in paths if path.suffix.lower() in MAP_SUFFIXES)
        rows = np.unique(np.linspace(0, max(len(paths) - 1, 0), _LOOKED_AT).astype(int)).tolist()
        self.samples = tuple(paths[row] for row in rows if paths)
        times = [time for time in stamps_ns if time is not None]
        steps = [later - earlier for earlier, later in pairwise(times) if later > earlier]
        self.period_ns = float(np.median(steps)) if steps and len(times) == len(paths) else None

    @property
    def settings(self) -> CloudSettings:
        """What all clouds share, by the sampled files; damaged ones are reported when they are read."""
        return self._decided[0]

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What was decided from LAS and LAZ clouds and shows in none of them: a sentence each."""
        if not self.maps:
            return ()
        sentences = list(self._decided[1])
        alike = len(self.maps) - len(self.far)
        if alike > 1 and any(self.settings.origin_m or ()):
            sentences.append(f"{self.maps[0].parent}: {alike} clouds of a map lose that origin alike")
        if self.far and self.posed:
            path, (x_m, y_m, z_m) = next(iter(self.far.items()))
            sentences.append(
                f"{len(self.far)} of {len(self.maps)} clouds lie more than 10 km from that origin and lose the middle "
                f"of their own box, such as {path}: ({x_m:.0f}, {y_m:.0f}, {z_m:.0f}) m; the frames' poses say where "
                "all stand from the first"
            )
        return tuple(sentences)

    @cached_property
    def far(self) -> Mapping[Path, Origin]:
        """The middle in whole metres of the clouds of a map that lie more than 10 km from the origin of all."""
        middles = {path: self._far(path) for path in self.maps} if any(self.settings.origin_m or ()) else {}
        return {path: middle for path, middle in middles.items() if middle is not None and _on_map(middle)}

    def _far(self, path: Path) -> Origin | None:
        """The middle of a cloud's box that lies more than 10 km from the origin of all; None where it does not."""
        origin_m = self.settings.origin_m
        with suppress(*_UNREADABLE):
            middle_m = las_middle(path)
            if origin_m is not None and middle_m is not None and np.linalg.norm(middle_m - origin_m) > NEAREST_M:
                x_m, y_m, z_m = np.rint(middle_m).tolist()
                return (x_m, y_m, z_m)
        return None

    def _origin_of(self, path: Path) -> Origin | None:
        """What is subtracted from a cloud of a map.

        Raises:
            DatasetError: If it is not of the map of the others, or far from them where frames have no poses.
        """
        origin_m, middle_m = self.settings.origin_m, self._far(path)
        if origin_m is None or middle_m is None:
            return origin_m
        names = {True: "coordinates of a map", False: "coordinates near the sensor"}
        is_map = _on_map(middle_m)
        if any(origin_m) != is_map:
            raise DatasetError(
                f"{path}: expected {names[not is_map]}, as the first readable cloud beside it has, got "
                f"{names[is_map]}, about {middle_m} m: how they lie to one another is not told. Open them apart, in "
                "folders of their own"
            )
        if not self.posed:
            raise DatasetError(
                f"{path}: expected clouds within 10 km of {origin_m} m, the origin of all clouds beside it, got one "
                f"about {middle_m} m. Open it apart, in a folder of its own"
            )
        return middle_m

    def world_T_frame(self, path: Path) -> Float64[np.ndarray, "4 4"] | None:
        """Where a cloud's frame stands from that of the first, shape (4, 4); None where all share one origin."""
        if not self.maps or not self.far:
            return None
        pose, origin_m = np.eye(4), self.settings.origin_m
        if path in self.far and origin_m is not None:
            pose[:3, 3] = np.subtract(self.far[path], origin_m)
        return pose

    @cached_property
    def _decided(self) -> tuple[CloudSettings, tuple[str, ...]]:
        """The settings, and the notes on them.

        The first cloud of a map that can be read decides the origin of all, whichever is opened first: a drive stays
        in one piece.
        """
        samples: dict[Path, Columns | Shaped[np.ndarray, "n c"]] = {}
        sentences: list[str] = []
        origin_m: Origin | None = None
        for path in self.samples:
            with suppress(*_UNREADABLE):
                if path.suffix.lower() not in MAP_SUFFIXES:
                    columns = read_columns(path, bin_columns=self.bin_columns)
                    if isinstance(columns, np.ndarray) and not self.column_names:
                        columns = points_of(path, columns)
                    samples[path] = columns
                    continue
                cloud = read_las(path)
                own_m, words = origin_of(path, cloud)
                words = words if origin_m is None else cloud.remarks
                has_unit = self.point_times in UNITS_NS  # what gps_time counts in: then nothing is left as it is
                sentences += [sentence for sentence in words if not (has_unit and "gps_time" in sentence)]
                origin_m = own_m if origin_m is None else origin_m
                is_near = np.linalg.norm(np.subtract(own_m, origin_m)) <= NEAREST_M
                samples[path] = less_origin(cloud.columns, origin_m if is_near else own_m)
        rows = [rows for rows in samples.values() if isinstance(rows, np.ndarray)]
        counts = {part.shape[1] for part in rows}
        row_names: RowNames = self.column_names or {
            count: names_of(np.concatenate([p for p in rows if p.shape[1] == count])) for count in counts
        }
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
        settings = CloudSettings(
            intensity_scale=intensity_scale_of(strengths) if self.intensity_scale is None else self.intensity_scale,
            point_times=self.point_times,
            usual_unit=next((unit for unit in units if unit is not None), None),
            row_names=row_names,
            period_ns=self.period_ns,
            origin_m=origin_m,
        )
        return settings, tuple(sentences)

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
            FarfieldError: As :func:`~farfield.frame.cloud.read_cloud` does, or if the cloud is not of the others' map.
        """
        settings = self.settings.at(stamp_ns)
        if path.suffix.lower() in MAP_SUFFIXES:
            settings = replace(settings, origin_m=self._origin_of(path))
        return read_cloud(path, settings, bin_columns=self.bin_columns)

    def loader(self, path: Path, stamp_ns: int | None = None) -> Callable[[], Cloud]:
        """What reads one cloud when it is called."""
        return partial(self, path, stamp_ns)


def _on_map(place_m: Origin) -> bool:
    return float(np.linalg.norm(place_m)) > NEAREST_M

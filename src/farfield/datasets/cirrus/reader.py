"""Read Cirrus (Wang et al., "Cirrus: A Long-range Bi-pattern LiDAR Dataset", ICRA 2021) as frames."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from farfield.datasets.base import Dataset, Indices, Poses, all_known, drive_poses
from farfield.datasets.calibration import CALIBRATION_NAMES, usable_cameras
from farfield.datasets.cirrus.labels import RawLabels, annotation_from_labels, read_labels
from farfield.datasets.cirrus.layout import (
    CirrusFiles,
    Mapping,
    Xyz,
    expectation,
    find_parts,
    index_frames,
    read_mapping,
    time_of,
)
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.files.images import read_image
from farfield.files.intensities import intensity_scale_of, scaled_intensity
from farfield.files.remote_paths import as_path
from farfield.frame import Annotation, Camera, Cloud, Constant, Frame, Lazy, Sensor, camera_sensor
from farfield.frame.cloud import read_rows
from farfield.frame.cloud_columns import returned
from farfield.geometry.poses import unrigid
from farfield.vocabulary.patterns import PATTERNS

# Sweeps: one .xyz file as a cloud.


def read_columns(path: Path, root: Path, pattern: str, settings: Xyz) -> dict[str, np.ndarray]:
    """Columns of a cloud by the mapping's names, in the file's own units.

    Args:
        path: The file.
        root: Folder that holds the cache folder.
        pattern: ``"gaussian"`` or ``"uniform"``.
        settings: Names of the columns, and how they are separated.
    """
    names = getattr(settings.columns, pattern)
    count = None if len(names) in (5, 8) else len(names)
    columns = read_rows(path, root, columns=count, delimiter=settings.delimiter)
    names = (*names, *(f"extra{number}" for number in range(len(names) - 4, len(columns) - 4)))
    keep = len(columns) if settings.on_extra_columns == "keep" else 4
    return dict(list(zip(names, columns, strict=False))[:keep])


class IntensityScale:
    """Value that stands for full reflectance, by pattern: given, or decided from a few files at the first access.

    Args:
        files: Files (and the roots of their caches) to decide from, by pattern.
        settings: The mapping's settings.
    """

    def __init__(self, files: dict[str, tuple[tuple[Path, Path], ...]], settings: Xyz) -> None:
        self.files, self.settings = files, settings

    @cached_property
    def by_pattern(self) -> dict[str, float]:
        """The scales."""
        return {name: self._of(name) for name in self.files}

    def __call__(self) -> dict[str, float]:
        """The scales, as a loader gives them."""
        return self.by_pattern

    def _of(self, pattern: str) -> float:
        if self.settings.intensity_scale != "auto":
            return float(self.settings.intensity_scale)
        read = (read_columns(path, root, pattern, self.settings) for path, root in self.files[pattern])
        return intensity_scale_of([columns["intensity"] for columns in read])


@dataclass(frozen=True)
class CirrusSweep:
    """One sweep on disk; called, it reads its cloud.

    Args:
        path: The file.
        root: Folder that holds the cache folder.
        pattern: ``"gaussian"`` or ``"uniform"``.
        settings: The mapping's settings.
        scale: The value that stands for full reflectance.
    """

    path: Path
    root: Path
    pattern: str
    settings: Xyz
    scale: IntensityScale

    def columns(self) -> dict[str, np.ndarray]:
        """Its columns in the file's own units."""
        return read_columns(self.path, self.root, self.pattern, self.settings)

    def __call__(self) -> Cloud:
        """Read it; intensity is brought to 0..1.

        Raises:
            FileFormatError: If the file is damaged or its intensity exceeds the scale.
        """
        columns = self.columns()
        points = np.stack([columns[axis] for axis in "xyz"], axis=1).astype(np.float32)
        valid = returned(self.path, points)
        columns = {name: column[valid] for name, column in columns.items()}
        scale = self.scale.by_pattern[self.pattern]
        strength = scaled_intensity(self.path, columns["intensity"], scale)
        extra = {name: column for name, column in columns.items() if name not in ("x", "y", "z", "intensity")}
        return Cloud(points[valid], strength, extra, int((~valid).sum()))


class Cirrus(Dataset):
    """Cirrus in its public layout, in the authors' internal layout, or in one that a mapping file describes.

    Frames carry clouds ``"gaussian"`` and ``"uniform"`` (where there is one), image ``"camera"``, and boxes on the
    Gaussian clock. ``frame_id`` is the time in nanoseconds as the file name has it; sequences are segments recovered
    from pauses.

    Cirrus draws boxes round what the cloud shows: the annotation's ``extent`` is ``"visible"``. ``full_boxes`` and
    ``details["point_count_uniform"]`` are there where the file gives them. Where the two LiDARs stand is not known.
    ``frame.metadata`` holds ``files``, ``pair_dt_ms`` (uniform minus Gaussian), ``camera_dt_ms`` and
    ``intensity_scale``.

    Args:
        root: One ``Cirrus_dataset<N>``, a folder of several, or the authors' ``dataset``.
        mapping: Mapping file, or its content; see :mod:`farfield.datasets.cirrus.layout`.
        pairing: ``"nearest"`` in time or in ``"order"``; overrides the mapping.
        max_dt_ms: Sweeps farther apart are not paired; overrides the mapping.
        intensity_scale: Value that stands for full reflectance; overrides the mapping.

    Raises:
        DatasetError: If the folder holds no clouds in the layout.
        ConfigError: If the mapping is wrong.
    """

    name = "cirrus"
    view_options = ("labels_at", "whole_bodies")

    def __init__(
        self,
        root: Path | str,
        *,
        mapping: Mapping | Path | str | None = None,
        pairing: Literal["nearest", "order"] | None = None,
        max_dt_ms: float | int | None = None,
        intensity_scale: float | int | None = None,
    ) -> None:
        self.root = as_path(root)
        settings = mapping if isinstance(mapping, Mapping) else read_mapping(mapping) if mapping else Mapping()
        changes = {"mode": pairing, "max_dt_ms": max_dt_ms}
        changes = {name: value for name, value in changes.items() if value is not None}
        self.mapping = settings.model_copy(update={"pairing": settings.pairing.model_copy(update=changes)})
        if intensity_scale is not None:
            if not 0 < intensity_scale < np.inf:
                raise ConfigError(f"intensity_scale: expected a positive number, got {intensity_scale!r}")
            xyz = self.mapping.xyz.model_copy(update={"intensity_scale": float(intensity_scale)})
            self.mapping = self.mapping.model_copy(update={"xyz": xyz})
        self.split_file = Path(self.mapping.splits.file)
        self.parts = find_parts(self.root, self.mapping)
        if not self.parts:
            raise DatasetError(f"{self.root}: expected Cirrus clouds, found none. {expectation(self.mapping)}")
        self.entries: Sequence[CirrusFiles] = index_frames(self.root, self.parts, self.mapping)
        self.sequences = tuple(entry.sequence for entry in self.entries)
        self.frame_ids = tuple(entry.key.stem for entry in self.entries)

    def files(self, index: int) -> Sequence[Path]:
        """List the files of frame ``index``."""
        entry = self.entries[index]
        return [path for path in (entry.gaussian, entry.uniform, entry.camera, entry.labels) if path]

    def _times_of(self, indices: Indices) -> Indices | None:
        return all_known(time_of(self.entries[index].key) for index in indices)

    def _poses_of(self, indices: Indices) -> Poses | None:
        return drive_poses(lambda index: _pose(self.raw_labels(index)), indices)

    def frame(self, index: int) -> Frame:
        """Build frame ``index``."""
        entry = self.entries[index]
        paths = {"gaussian": entry.gaussian, "uniform": entry.uniform, "camera": entry.camera}
        present = {name: path for name, path in paths.items() if path is not None}
        times = {name: time_of(path) for name, path in present.items()}
        raw = self.raw_labels(index)
        image = {} if entry.camera is None else {"camera": partial(read_image, entry.camera)}
        return Frame(
            sequence=entry.sequence,
            frame_id=entry.key.stem,
            time_ns=time_of(entry.key),
            clouds=Lazy({name: self._sweep(index, name) for name in PATTERNS if name in present}),
            images=Lazy(image),
            cameras=self.cameras,
            sensors=self._sensors(times),
            load_annotation=None if raw is None else partial(annotation_from_labels, raw, self.mapping.labels),
            world_T_frame=_pose(raw),
            conditions=_conditions(raw),
            metadata=Lazy(self._metadata(index, entry)),
        )

    def annotation(self, index: int) -> Annotation | None:
        """What was annotated in frame ``index``."""
        raw = self.raw_labels(index)
        return None if raw is None else annotation_from_labels(raw, self.mapping.labels)

    def has_annotation(self, index: int) -> bool:
        """Whether there is a label file of frame ``index``."""
        return self.entries[index].labels is not None

    def raw_labels(self, index: int) -> RawLabels | None:
        """Read the annotations of frame ``index`` as the file has them; None where there are none."""
        path = self.entries[index].labels
        return None if path is None else read_labels(path, self.mapping.labels)

    def _sensors(self, times: dict[str, int | None]) -> dict[str, Sensor]:
        lidars = {name: Sensor(kind="lidar", time_ns=times[name]) for name in PATTERNS if name in times}
        cameras = {name: camera_sensor(self.cameras.get(name)) for name in self.cameras}
        if "camera" in times:
            cameras["camera"] = camera_sensor(self.cameras.get("camera"), times["camera"])
        return lidars | cameras

    def _metadata(self, index: int, entry: CirrusFiles) -> dict[str, Callable[[], Any]]:
        return {
            "files": Constant([str(path) for path in self.files(index)]),
            "pair_dt_ms": Constant(entry.pair_dt_ms),
            "camera_dt_ms": Constant(entry.camera_dt_ms),
            "intensity_scale": self._scale,
        }

    def _sweep(self, index: int, pattern: str) -> CirrusSweep:
        entry = self.entries[index]
        path = entry.gaussian if pattern == "gaussian" else entry.uniform
        if path is None:
            raise KeyError(f"frame {entry.key.stem} has no {pattern} sweep")
        return CirrusSweep(path, entry.part.root, pattern, self.mapping.xyz, self._scale)

    def cloud(self, index: int, pattern: str) -> Cloud:
        """Read one sweep of frame ``index``; intensity is brought to 0..1.

        Raises:
            FileFormatError: If the file is damaged or its intensity exceeds the scale.
        """
        return self._sweep(index, pattern)()

    @property
    def intensity_scale(self) -> dict[str, float]:
        """Value that stands for full reflectance, by pattern: given, or decided from up to three files."""
        return self._scale.by_pattern

    @cached_property
    def _scale(self) -> IntensityScale:
        files = {}
        for name in PATTERNS:
            have = [(path, e.part.root) for e in self.entries if (path := getattr(e, name)) is not None]
            if have:
                files[name] = tuple(dict.fromkeys((have[0], have[len(have) // 2], have[-1])))
        return IntensityScale(files, self.mapping.xyz)

    @cached_property
    def calibration_file(self) -> Path | None:
        """The calibration: the one that the mapping names, or one of the usual names in the root or the first part."""
        if self.mapping.calib.file is not None:
            path = self.root / self.mapping.calib.file
            if not path.is_file():
                raise DatasetError(f"{path}: expected the calibration file that the mapping names, found none")
            return path
        candidates = [folder / name for folder in (self.root, self.parts[0].root) for name in CALIBRATION_NAMES]
        return next((path for path in candidates if path.is_file()), None)

    @cached_property
    def cameras(self) -> dict[str, Camera]:
        """Cameras by name; empty without a calibration file, or with one that cannot be used (:attr:`notes`)."""
        return self._calibration[0]

    @property
    def notes(self) -> tuple[str, ...]:
        """What of the calibration cannot be used."""
        return self._calibration[1]

    @cached_property
    def _calibration(self) -> tuple[dict[str, Camera], tuple[str, ...]]:
        inverse = self.mapping.calib.convention == "cam_to_lidar"
        return usable_cameras(self.calibration_file, inverse=inverse)


def _conditions(raw: RawLabels | None) -> dict[str, str]:
    value = None if raw is None else raw.root.get("conditions")
    if not isinstance(value, dict):
        return {}
    return {str(name): str(text) for name, text in value.items()}


def _pose(raw: RawLabels | None) -> Any:
    value = None if raw is None else raw.root.get("world_T_lidar")
    if value is None:
        return None
    try:
        matrix = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        matrix = np.zeros(0)
    assert raw is not None
    if fault := unrigid(matrix):
        raise FileFormatError(raw.path, where="world_T_lidar", expected="a rigid motion, 4 x 4", got=fault)
    return matrix

"""Read K-Radar as frames.

Paek et al., "K-Radar: 4D Radar Object Detection for Autonomous Driving in Various Weather Conditions", NeurIPS 2022.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from farfield.datasets.base import Dataset
from farfield.datasets.kradar.index import Entry, find_file, find_sequences, index_sequence, radar_geometry
from farfield.datasets.kradar.labels import KRadarLabels, read_labels
from farfield.datasets.kradar.layout import (
    CAMERAS,
    EYES,
    INDEX_NAMES,
    LABEL_TREES,
    LIDARS,
    RADAR_PRODUCTS,
    RIGHT_EYE,
    SEQUENCE_SPLIT,
    SPLIT_FOLDER,
    index_name,
    os2_T_radar,
    product_path,
)
from farfield.datasets.kradar.products import read_eye, read_lidar, read_radar
from farfield.datasets.kradar.radar_cloud import RadarView, in_radar_frame, with_radar_cloud
from farfield.datasets.kradar.record import FrameRecord, read_record, record_path
from farfield.datasets.kradar.sequence_files import camera_path, odometry_path, quarters
from farfield.datasets.kradar.texts import read_camera, read_description, read_lines, read_odometry, read_times
from farfield.errors import ConfigError, DatasetError
from farfield.frame import Camera, Frame, Lazy

_CALIBRATIONS = ("resources/cam_calib/calib_seq_v2", "cam_calib/calib_seq_v2", "calib_seq_v2", "cam_calib", "calib_seq")


@dataclass(frozen=True, kw_only=True)
class _Shared:
    """Conditions, times of files by name, poses by frame and cameras of a sequence."""

    conditions: dict[str, str]
    times: dict[str, int]
    poses: dict[int, Float[np.ndarray, "4 4"]]
    cameras: dict[str, Camera]


class KRadar(Dataset):
    """K-Radar, or whatever part of it was downloaded. Coordinates are the os2-64's: x forward, y left, z up.

    Frames are those that are annotated; without annotations, those with a LiDAR or radar file. ``frame_id`` is
    ``<radar>_<os2-64>``. What a frame has depends on the files that are there:

    - clouds ``os2-64`` and ``os1-128``, without missing returns. The os1-128's cloud is in its own sensor's frame: no
      official calibration between the two exists; ``metadata["os2_T_os1"]`` gives it where the writer knew it.
    - cloud ``radar``: the radar's strongest cells as points, intensity their power over 1e13 (linear), extra column
      ``doppler_m_s`` where it is known; see :mod:`~farfield.datasets.kradar.radar_cloud`.
    - radar ``tesseract``, ``cube``, ``polar3d``, ``sparse``, ``cells`` in the radar's frame
      (``metadata["os2_T_radar"]``), angles, y and z rising to the left and up; see
      :func:`~farfield.datasets.kradar.products.write_radar`.
    - images ``cam-front`` (left eye), ``cam-front-right``, likewise ``cam-left``, ``cam-right``, ``cam-rear``, and
      their cameras.
    - full boxes with Cirrus' class names; ``metadata`` has ``raw_label``, ``availability``, ``from_above`` (see
      :class:`~farfield.datasets.kradar.labels.KRadarLabels`), ``indices`` and ``files``.

    Args:
        root: A folder with the sequences ``1`` to ``58`` or with separate downloads such as ``rdr_polar_3d``.
        roots: Further such folders, for a set that is spread over several disks.
        labels: ``"v2.1"``, ``"v2.0"``, ``"v1.1"`` or ``"v1.0"``; None takes the newest that a sequence has.
        reference: ``"os2-64"``, or ``"radar"`` for frames in the radar's coordinates, as K-Radar's own tools train and
            score: boxes, clouds, cameras and poses are moved. The os1-128 keeps its own.
        radar_rate: Share of all cells of a cube that the cloud ``radar`` holds before it is cropped; 1 for every cell.
        radar_region: Where it is cropped: ``"narrow"``, ``"wide"`` or ``"cube"``.
        radar_over: Whether that share is of ``"all"`` cells, as published, or of the ``"valid"`` ones in the field of
            view.

    Raises:
        DatasetError: If there is nothing of K-Radar, or no annotation of the version asked for.
        ConfigError: If an argument is not one of those possible.
    """

    name = "kradar"
    split_file = SEQUENCE_SPLIT

    def __init__(
        self,
        root: Path | str,
        *,
        roots: Iterable[Path | str] = (),
        labels: str | None = None,
        reference: str = "os2-64",
        radar_rate: float | int = 0.1,
        radar_region: str = "wide",
        radar_over: str = "all",
    ) -> None:
        if labels is not None and labels not in LABEL_TREES:
            raise ConfigError(f"KRadar: expected labels to be one of {', '.join(LABEL_TREES)}; got {labels!r}")
        if reference not in ("os2-64", "radar"):
            raise ConfigError(f"KRadar: expected reference os2-64 or radar, got {reference!r}")
        self.reference = reference
        self.radar_view = RadarView(rate=radar_rate, region=radar_region, over=radar_over)
        self.root = Path(root)
        self.roots = (self.root, *map(Path, roots))
        self._geometry = {name: radar_geometry(self.roots, name) for name in find_sequences(self.roots)}
        versions = tuple(LABEL_TREES) if labels is None else (labels,)
        self.entries: Sequence[Entry] = [
            entry
            for name, (difference, _, _) in self._geometry.items()
            for entry in index_sequence(self.roots, name, versions, difference)
            if labels is None or entry.label is not None
        ]
        if not self.entries:
            wanted = "files of K-Radar" if labels is None else f"annotations {labels}"
            looked = "<sequence>/os2-64/*.pcd, <sequence>/radar_zyx_cube/*.mat, <sequence>/info_label/*.txt, ..."
            raise DatasetError(f"{self.root}: expected {wanted}, found none. Looked for {looked}")
        self.sequences = tuple(entry.sequence for entry in self.entries)
        self.frame_ids = tuple(entry.stem for entry in self.entries)
        self._shared: dict[str, _Shared] = {}

    def labels(self, index: int) -> KRadarLabels | None:
        """Read the annotations of frame ``index``; None where there are none."""
        path = self.entries[index].label
        return None if path is None else read_labels(path)

    def files(self, index: int) -> Sequence[Path]:
        """List the files of frame ``index`` that are there."""
        entry = self.entries[index]
        found = [entry.label, self._record_path(entry), *self._paths(entry, self._indices(entry)).values()]
        return [path for path in found if path is not None]

    def frame(self, index: int) -> Frame:
        """Build frame ``index``."""
        entry = self.entries[index]
        raw, record, shared = self.labels(index), self._record(entry), self._of_sequence(entry.sequence)
        indices = self._indices(entry, raw, record)
        paths = self._paths(entry, indices)
        times = _times(shared.times, paths, record)
        time_ns = times.get("os2-64", raw.time_ns if raw is not None else None)
        radar = Lazy({name: partial(read_radar, paths[name], name) for name in RADAR_PRODUCTS if name in paths})
        frame = Frame(
            sequence=entry.sequence,
            frame_id=entry.stem,
            time_ns=time_ns,
            clouds=Lazy(_clouds(paths, record)),
            images=Lazy(_eyes(paths)),
            cameras=shared.cameras,
            annotation=None if raw is None else lambda: raw.boxes,
            world_T_lidar=self._pose(index, record),
            times_ns=times,
            conditions=shared.conditions,
            radar=radar,
            reference="os2-64",
            metadata=Lazy(self._metadata(index, raw, record, indices)),
        )
        os2_T_radar = self._os2_T_radar(index)
        if self.reference == "radar":
            frame = in_radar_frame(frame, os2_T_radar)
        return with_radar_cloud(frame, self.radar_view, np.eye(4) if self.reference == "radar" else os2_T_radar)

    def benchmark_split(self, name: str) -> Dataset:
        """K-Radar's own ``train`` or ``test``: quarters of every sequence in turn.

        The list ``resources/split/<name>.txt`` decides where it is there. Neighbouring quarters are one drive, so
        scores come out too good; ``split()`` keeps sequences whole.

        Raises:
            ConfigError: If there is no such part.
        """
        if name not in ("train", "test"):
            raise ConfigError(f"benchmark_split: expected train or test, got {name!r}")
        path = find_file(self.roots, SPLIT_FOLDER / f"{name}.txt")
        if path is not None:
            keys = {tuple(line.removesuffix(".txt").split(",")) for line in read_lines(path)}
        else:
            stems: dict[str, list[str]] = {}
            for sequence, stem in self.keys:
                stems.setdefault(sequence, []).append(stem)
            keys = set(quarters(stems)[name])
        return self.select([index for index, key in enumerate(self.keys) if key in keys])

    def _indices(
        self, entry: Entry, raw: KRadarLabels | None = None, record: FrameRecord | None = None
    ) -> dict[str, int]:
        """Indices of a frame's files: the record's, the annotation's, or what the name says."""
        raw = read_labels(entry.label) if raw is None and entry.label is not None else raw
        record = self._record(entry) if record is None else record
        known = dict(raw.indices) if raw is not None else {}
        known |= record.indices if record is not None else {}
        known |= {"radar": entry.radar, "os2-64": entry.lidar}
        return {"os1-128": entry.lidar} | {name: known[name] for name in INDEX_NAMES if name in known}

    def _paths(self, entry: Entry, indices: dict[str, int]) -> dict[str, Path]:
        found = {
            product: find_file(self.roots, product_path(product, entry.sequence, indices[index_name(product)]))
            for product in (*RADAR_PRODUCTS, *LIDARS, *CAMERAS)
            if index_name(product) in indices
        }
        return {product: path for product, path in found.items() if path is not None}

    def _record_path(self, entry: Entry) -> Path | None:
        return find_file(self.roots, record_path(entry.sequence, entry.stem))

    def _record(self, entry: Entry) -> FrameRecord | None:
        path = self._record_path(entry)
        return None if path is None else read_record(path)

    def _of_sequence(self, sequence: str) -> "_Shared":
        """What the frames of a sequence share, read at the first access."""
        if sequence not in self._shared:
            description = find_file(self.roots, Path(sequence, "description.txt"))
            times: dict[str, int] = {}
            for sensor in (*LIDARS, *CAMERAS):
                path = find_file(self.roots, Path(sequence, "time_info", f"{sensor}.txt"))
                times |= read_times(path) if path is not None else {}
            self._shared[sequence] = _Shared(
                conditions={} if description is None else read_description(description),
                times=times,
                poses=self._read_poses(sequence),
                cameras=self._read_cameras(sequence),
            )
        return self._shared[sequence]

    def _read_poses(self, sequence: str) -> dict[int, Float[np.ndarray, "4 4"]]:
        """Poses by frame, if the file has one for each annotated frame."""
        path = find_file(self.roots, odometry_path(sequence))
        members = [index for index, entry in enumerate(self.entries) if entry.sequence == sequence and entry.label]
        poses = np.zeros((0, 4, 4)) if path is None else read_odometry(path)
        return dict(zip(members, poses, strict=True)) if len(poses) == len(members) else {}

    def _read_cameras(self, sequence: str) -> dict[str, Camera]:
        cameras = {}
        for name, number in EYES.items():
            file = Path(*camera_path(sequence, number).parts[-2:])
            places = (find_file(self.roots, Path(place) / file) for place in _CALIBRATIONS)
            path = next((place for place in places if place is not None), None)
            if path is not None:
                cameras[name] = read_camera(path)
        return cameras

    def _pose(self, index: int, record: FrameRecord | None) -> Float[np.ndarray, "4 4"] | None:
        known = record.pose("world_T_lidar") if record is not None else None
        return self._of_sequence(self.sequences[index]).poses.get(index) if known is None else known

    def _os2_T_radar(self, index: int) -> Float[np.ndarray, "4 4"]:
        _, x_m, y_m = self._geometry[self.sequences[index]]
        return os2_T_radar() if x_m is None or y_m is None else os2_T_radar(x_m, y_m)

    def _metadata(
        self, index: int, raw: KRadarLabels | None, record: FrameRecord | None, indices: dict[str, int]
    ) -> dict[str, Callable[[], Any]]:
        known: dict[str, Callable[[], Any]] = {
            "files": lambda: [str(path) for path in self.files(index)],
            "indices": lambda: indices,
            "box_protocol": lambda: "full",
            "os2_T_radar": lambda: self._os2_T_radar(index),
        }
        if raw is not None:
            known |= {"raw_label": lambda: raw.raw_label, "from_above": lambda: raw.from_above}
        if raw is not None and len(raw.availability) == len(raw.boxes):
            known["availability"] = lambda: list(raw.availability)
        if record is not None and record.os2_T_os1 is not None:
            known["os2_T_os1"] = lambda: record.pose("os2_T_os1")
        return known


def _eyes(paths: dict[str, Path]) -> dict[str, Callable[[], Any]]:
    present = [name for name in CAMERAS if name in paths]
    eyes = [(name + suffix, paths[name], bool(suffix)) for name in present for suffix in ("", RIGHT_EYE)]
    return {name: partial(read_eye, path, right) for name, path, right in eyes}


def _clouds(paths: dict[str, Path], record: FrameRecord | None) -> dict[str, Callable[[], Any]]:
    first_ns = record.first_shot_ns if record is not None else {}
    names = [name for name in LIDARS if name in paths]
    return {name: partial(read_lidar, paths[name], name, first_ns=first_ns.get(name, 0)) for name in names}


def _times(of_files: dict[str, int], paths: dict[str, Path], record: FrameRecord | None) -> dict[str, int]:
    times = {name: of_files[path.name] for name, path in paths.items() if path.name in of_files}
    if record is not None:
        times |= {"os2-64": record.time_ns} | record.times_ns
    return times

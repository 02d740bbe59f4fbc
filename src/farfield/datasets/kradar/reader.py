"""Read K-Radar as frames.

Paek et al., "K-Radar: 4D Radar Object Detection for Autonomous Driving in Various Weather Conditions", NeurIPS 2022.
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from farfield.datasets.base import Dataset, Indices, Poses, all_known, all_poses
from farfield.datasets.kradar.index import (
    FileIndex,
    KRadarFiles,
    find_sequences,
    index_sequence,
    only_sequence,
    radar_geometry,
    with_disks,
)
from farfield.datasets.kradar.label_table import LabelTable, read_label_table
from farfield.datasets.kradar.labels import KRadarLabels, annotation_of, read_labels
from farfield.datasets.kradar.layout import (
    CAMERAS,
    INDEX_NAMES,
    LABEL_TREES,
    LIDARS,
    RADAR_PRODUCTS,
    RIGHT_EYE,
    SEQUENCE_SPLIT,
    SPLIT_FOLDER,
    UNREAD,
    index_name,
    os2_T_radar,
    product_path,
)
from farfield.datasets.kradar.products import read_eye, read_lidar, read_moments, read_radar
from farfield.datasets.kradar.radar_cloud import RADAR_CLOUD, RadarView
from farfield.datasets.kradar.radar_pose import (
    matching_path,
    os2_T_radar_from,
    read_matching,
    read_os2_T_os1,
    sequence_yaw_rad,
)
from farfield.datasets.kradar.sequence import RELEASES, SequenceFacts, annotated_poses, dash_image, read_sequence
from farfield.datasets.kradar.texts import TimedTable, read_lines
from farfield.datasets.kradar.writer import FrameRecord, quarters, read_record, record_path
from farfield.datasets.maps import none_before
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.files.remote_paths import as_path
from farfield.frame import Annotation, Camera, Constant, Frame, Key, Lazy, Sensor, camera_sensor
from farfield.jobs import HERE, JobOptions

_USUAL_VIEW = RadarView()
MOMENTS = "moments"
"""What a tesseract gives while it is read, see :class:`~farfield.radar.products.Moments`."""


class KRadar(Dataset):
    """K-Radar, or whatever part of it was downloaded. Coordinates are the os2-64's: x forward, y left, z up.

    Frames are those that are annotated; without annotations, those with a LiDAR or radar file. ``frame_id`` is
    ``<radar>_<os2-64>``. What a frame has depends on the files that are there:

    - clouds ``os2-64`` and ``os1-128``, without missing returns. The os1-128's cloud keeps its own sensor's axes: no
      official calibration between the two exists; ``sensors["os1-128"].frame_T_sensor`` is known where the writer knew
      it or ``farfield calibrate lidar-lidar`` wrote it.
    - cloud ``radar``: the radar's strongest cells as points, column ``power`` their power over 1e13 (linear),
      ``doppler_m_s`` where it is known; see :mod:`~farfield.datasets.kradar.radar_cloud`.
    - radar ``tesseract``, ``cube``, ``polar3d``, ``sparse``, ``cells`` on the radar's axes
      (``sensors["radar"].frame_T_sensor`` places it), angles, y and z rising to the left and up; see
      :func:`~farfield.datasets.kradar.products.write_radar`.
    - images ``cam-front`` (left eye), ``cam-front-right``, likewise ``cam-left``, ``cam-right``, ``cam-rear``, and
      their cameras.
    - an annotation of full boxes with Cirrus' class names, ``visibility`` (``R``, ``L`` or ``L1``), ``original_label``,
      ``version`` and, in ``unboxed["from_above"]``, the objects without a height.
    - ``indices`` of the sensors' files, by the names in :data:`~farfield.datasets.kradar.layout.INDEX_NAMES`.
    - image ``cam-dash``, the dashboard camera's (extra ``video``); ``metadata["video"]``, the path of its film.
    - ``metadata["gps"]``, ``gps_local``, ``imu``, ``imu_2``, the measurement nearest in time.
    - conditions from ``description.txt``; without it those that are published of a real sequence, as
      ``metadata["conditions_from"]`` says.

    Args:
        root: A folder with the sequences ``1`` to ``58``, with disks (``dir_1to20``...) or with separate downloads such
            as ``rdr_polar_3d``; or one sequence's own, such as ``dir_1to20/1``.
        roots: Further such folders, for a set that is spread over several disks.
        labels: ``"v2.1"``, ``"v2.0"``, ``"v1.1"`` or ``"v1.0"``; None takes the newest that a sequence has.
        calibration: Release of the camera calibrations, ``"v2"`` or ``"v1"``; None takes the newest that there is.

    ``open_dataset`` has further options, which become maps (:attr:`~farfield.datasets.base.Dataset.maps`):

    - ``reference``: ``"os2-64"``, or ``"radar"`` for frames in the radar's coordinates, as K-Radar's own tools train
      and score: boxes, clouds, cameras and poses are moved. The os1-128 keeps its own.
    - ``radar_rate``: share of cells that the cloud ``radar`` holds, 0.1 if left out; 1 for every cell.
    - ``radar_region``: where it is cropped: ``"narrow"``, ``"wide"`` (if left out) or ``"cube"``.
    - ``radar_over``: whether that share is of ``"all"`` cells of the cube before it is cropped, as published for the
      wide region (benchmark v2.0), of the ``"valid"`` ones in the field of view, or of the cells of the ``"region"``,
      as published for the corridor (benchmark v1.0).

    Raises:
        DatasetError: If there is nothing of K-Radar, or no annotation of the version asked for.
        ConfigError: If an argument is not one of those possible.
    """

    name = "kradar"
    split_file = SEQUENCE_SPLIT
    protocol = "kradar"
    references = ("os2-64", "radar")
    view_options = ("reference", "radar_rate", "radar_region", "radar_over")

    def __init__(
        self,
        root: Path | str,
        *,
        roots: Iterable[Path | str] = (),
        labels: str | None = None,
        calibration: str | None = None,
    ) -> None:
        if labels is not None and labels not in LABEL_TREES:
            raise ConfigError(f"KRadar: expected labels to be one of {', '.join(LABEL_TREES)}; got {labels!r}")
        if calibration is not None and calibration not in RELEASES:
            raise ConfigError(f"KRadar: expected calibration to be one of {', '.join(RELEASES)}; got {calibration!r}")
        self.calibration = calibration
        self.root = as_path(root)
        self.roots = with_disks((self.root, *map(Path, roots)))
        self._files = FileIndex(self.roots)
        only = only_sequence(self.root)
        names = [name for name in find_sequences(self.roots) if only in ("", name)]
        self._geometry = {name: radar_geometry(self.roots, name) for name in names}
        self._yaw_rad = {name: sequence_yaw_rad(self._files, name) for name in self._geometry}
        versions = tuple(LABEL_TREES) if labels is None else (labels,)
        self.entries: Sequence[KRadarFiles] = [
            entry
            for name, (difference, _, _) in self._geometry.items()
            for entry in index_sequence(self.roots, name, versions, difference)
            if labels is None or entry.label is not None
        ]
        if not self.entries:
            missing = "files of K-Radar" if labels is None else f"annotations {labels}"
            looked = "<sequence>/os2-64/*.pcd, <sequence>/radar_zyx_cube/*.mat, <sequence>/info_label/*.txt, ..."
            raise DatasetError(f"{self.root}: expected {missing}, found none. Looked for {looked}")
        self.sequences = tuple(entry.sequence for entry in self.entries)
        self.frame_ids = tuple(entry.stem for entry in self.entries)
        self._shared: dict[str, tuple[SequenceFacts, dict[int, Float[np.ndarray, "4 4"]]]] = {}

    @property
    def notes(self) -> tuple[str, ...]:
        """Folders of disks that are not read, and why."""
        return tuple(
            f"{name}/ is not read: {why}"
            for name, why in UNREAD.items()
            if any((root / sequence / name).is_dir() for root in self.roots for sequence in self._geometry)
            or any((root / name).is_dir() for root in self.roots)
        )

    def labels(self, index: int) -> KRadarLabels | None:
        """Read the annotations of frame ``index``; None where there are none."""
        path = self.entries[index].label
        return None if path is None else read_labels(path, self.entries[index].version or "")

    def annotation(self, index: int) -> Annotation | None:
        """What was annotated in frame ``index``."""
        raw = self.labels(index)
        return None if raw is None else annotation_of(raw, self.entries[index].version or "")

    def has_annotation(self, index: int) -> bool:
        """Whether there is a label file of frame ``index``."""
        return self.entries[index].label is not None

    def label_table(self, bulk: JobOptions = HERE) -> LabelTable:
        """Read the annotations of all frames at once, in a fraction of the time; see :class:`LabelTable`."""
        return read_label_table(self.entries, bulk)

    def of_sequence(self, sequence: str) -> SequenceFacts:
        """What the frames of a sequence share, read at the first access.

        Raises:
            FileFormatError: If a file is damaged.
        """
        return self._of_sequence(sequence)[0]

    def frame_difference(self, sequence: str) -> int:
        """Radar index minus LiDAR index of a sequence, as its calibration says; the published one without it."""
        return self._geometry[sequence][0]

    def calibrated(self, sequence: str) -> bool:
        """Whether the sequence's own ``calib_radar_lidar.txt`` says where its radar stands."""
        return self._geometry[sequence][1] is not None

    def files(self, index: int) -> Sequence[Path]:
        """List the files of frame ``index`` that are there."""
        entry = self.entries[index]
        paths = [entry.label, self._record_path(entry), *self._paths(entry, self._indices(entry)).values()]
        return [path for path in paths if path is not None]

    def frame(self, index: int) -> Frame:
        """Build frame ``index``."""
        entry = self.entries[index]
        raw, record, shared = self.labels(index), self._record(entry), self.of_sequence(entry.sequence)
        indices = self._indices(entry, raw, record)
        paths = self._paths(entry, indices)
        times = _times(shared.times_ns, paths, record)
        time_ns = times.get("os2-64", raw.time_ns if raw is not None else None)
        os2_T_radar = self._os2_T_radar(index)
        first_ns = record.first_shot_ns if record is not None else {}
        names = [name for name in LIDARS if name in paths]
        clouds = {name: partial(read_lidar, paths[name], name, first_ns=first_ns.get(name, 0)) for name in names}
        frame = Frame(
            sequence=entry.sequence,
            frame_id=entry.stem,
            time_ns=time_ns,
            clouds=Lazy(clouds),
            images=Lazy(_eyes(paths) | dash_image(shared.video, shared.times_ns, time_ns)),
            cameras=shared.cameras,
            load_annotation=None if raw is None else partial(annotation_of, raw, entry.version or ""),
            world_T_frame=self._pose(index, record),
            conditions=shared.conditions,
            indices=indices,
            radar=Lazy(_products(paths)),
            reference="os2-64",
            sensors=_sensors(paths, shared.cameras, times, os2_T_radar, self._os2_T_os1(entry.sequence, record)),
            metadata=Lazy(_files(entry, self._record_path(entry), paths) | _measured(shared, time_ns)),
        )
        return _USUAL_VIEW(frame, none_before)

    def benchmark_split(self, name: str) -> Dataset:
        """K-Radar's own ``train`` or ``test``, as ``split(name, by="benchmark")``: quarters of every sequence in turn.

        The list ``resources/split/<name>.txt`` decides where it is there. Neighbouring quarters are one drive, so
        scores come out too good; ``split()`` keeps sequences whole.

        Raises:
            ConfigError: If there is no such part.
        """
        return self.split(name, by="benchmark")

    def benchmark_keys(self, name: str) -> Set[Key]:
        """(sequence, frame) of the frames of ``train`` or ``test``, see :meth:`benchmark_split`."""
        if name not in ("train", "test"):
            raise ConfigError(f"benchmark_split: expected train or test, got {name!r}")
        path = self._files.find(SPLIT_FOLDER / f"{name}.txt")
        if path is not None:
            return read_split_list(path)
        stems: dict[str, list[str]] = {}
        for sequence, stem in self.keys:
            stems.setdefault(sequence, []).append(stem)
        return set(quarters(stems)[name])

    def _times_of(self, indices: Indices) -> Indices | None:
        return all_known(self._listed_time_ns(int(index)) for index in indices)

    def _listed_time_ns(self, index: int) -> int | None:
        """Time of the os2-64's sweep, from the frame's record or the sequence's list."""
        entry = self.entries[index]
        record = self._record(entry)
        listed = self.of_sequence(entry.sequence).times_ns
        return listed.get(product_path("os2-64", "", entry.lidar).name) if record is None else record.time_ns

    def _poses_of(self, indices: Indices) -> Poses | None:
        rows = (int(index) for index in indices)
        return all_poses(self._pose(index, self._record(self.entries[index])) for index in rows)

    def split_parts(self) -> dict[str, list[str]]:
        """The sequences of each part: of ``splits/kradar_v1.json`` in the root, or else ours of the published set."""
        return super().split_parts() or split_of_sequences(self.sequences)

    def _indices(
        self, entry: KRadarFiles, raw: KRadarLabels | None = None, record: FrameRecord | None = None
    ) -> dict[str, int]:
        """Indices of a frame's files: the record's, the annotation's, or what the name says."""
        raw = read_labels(entry.label, entry.version or "") if raw is None and entry.label is not None else raw
        record = self._record(entry) if record is None else record
        indices = dict(raw.indices) if raw is not None else {}
        indices |= record.indices if record is not None else {}
        indices |= {"radar": entry.radar, "os2-64": entry.lidar}
        return {"os1-128": entry.lidar} | {name: indices[name] for name in INDEX_NAMES if name in indices}

    def _paths(self, entry: KRadarFiles, indices: dict[str, int]) -> dict[str, Path]:
        paths = {
            product: self._files.product(product, entry.sequence, indices[index_name(product)])
            for product in (*RADAR_PRODUCTS, *LIDARS, *CAMERAS)
            if index_name(product) in indices
        }
        return {product: path for product, path in paths.items() if path is not None}

    def _record_path(self, entry: KRadarFiles) -> Path | None:
        return self._files.find(record_path(entry.sequence, entry.stem))

    def _record(self, entry: KRadarFiles) -> FrameRecord | None:
        path = self._record_path(entry)
        return None if path is None else read_record(path)

    def _of_sequence(self, sequence: str) -> tuple[SequenceFacts, dict[int, Float[np.ndarray, "4 4"]]]:
        if sequence not in self._shared:
            facts = read_sequence(self._files, sequence, calibration=self.calibration)
            members = [index for index, entry in enumerate(self.entries) if entry.sequence == sequence and entry.label]
            self._shared[sequence] = facts, annotated_poses(facts, members)
        return self._shared[sequence]

    def _pose(self, index: int, record: FrameRecord | None) -> Float[np.ndarray, "4 4"] | None:
        pose = record.pose("world_T_lidar") if record is not None else None
        return self._of_sequence(self.sequences[index])[1].get(index) if pose is None else pose

    def _os2_T_os1(self, sequence: str, record: FrameRecord | None) -> Float[np.ndarray, "4 4"] | None:
        """As ``farfield calibrate lidar-lidar`` wrote it, or else as the writer knew it."""
        os2_T_os1 = read_os2_T_os1(self._files, sequence)
        return record.pose("os2_T_os1") if os2_T_os1 is None and record is not None else os2_T_os1

    def _os2_T_radar(self, index: int) -> Float[np.ndarray, "4 4"]:
        sequence = self.sequences[index]
        own = self._files.find(matching_path(sequence, self.frame_ids[index]))
        if own is not None:
            return read_matching(own).os2_T_radar
        _, x_m, y_m = self._geometry[sequence]
        if x_m is None or y_m is None:
            return os2_T_radar()
        yaw_rad = self._yaw_rad[sequence]
        return os2_T_radar_from(-x_m, -y_m, yaw_rad) if yaw_rad else os2_T_radar(x_m, y_m)


def _eyes(paths: dict[str, Path]) -> dict[str, Callable[[], Any]]:
    present = [name for name in CAMERAS if name in paths]
    eyes = [(name + suffix, paths[name], bool(suffix)) for name in present for suffix in ("", RIGHT_EYE)]
    return {name: partial(read_eye, path, right) for name, path, right in eyes}


def _products(paths: Mapping[str, Path]) -> dict[str, Callable[[], Any]]:
    """Loaders of the radar's products, and of a tesseract's moments, for which it is reduced while it is read."""
    loaders: dict[str, Callable[[], Any]] = {
        name: partial(read_radar, paths[name], name) for name in RADAR_PRODUCTS if name in paths
    }
    return loaders | ({MOMENTS: partial(read_moments, paths["tesseract"])} if "tesseract" in paths else {})


def _sensors(
    paths: dict[str, Path],
    cameras: Mapping[str, Camera],
    times: Mapping[str, int],
    os2_T_radar: Float[np.ndarray, "4 4"],
    os2_T_os1: Float[np.ndarray, "4 4"] | None,
) -> dict[str, Sensor]:
    """Where each sensor stands in the os2-64's coordinates, in which its own cloud and the radar's points are."""
    sensors = {"os2-64": Sensor(kind="lidar", frame_T_sensor=np.eye(4), time_ns=times.get("os2-64"))}
    if "os1-128" in paths:
        sensors["os1-128"] = Sensor(
            kind="lidar", frame_T_sensor=os2_T_os1, in_frame=False, time_ns=times.get("os1-128")
        )
    products = [name for name in RADAR_PRODUCTS if name in paths]
    taken_ns = next((times[name] for name in (RADAR_CLOUD, *products) if name in times), None)
    sensors[RADAR_CLOUD] = Sensor(kind="radar", frame_T_sensor=os2_T_radar, time_ns=taken_ns)
    for name in (*products, *([MOMENTS] if "tesseract" in products else [])):
        sensors[name] = Sensor(kind="radar", frame_T_sensor=os2_T_radar, in_frame=False, time_ns=times.get(name))
    for name in sorted({*_eyes(paths), *cameras}):
        sensors[name] = camera_sensor(cameras.get(name), times.get(name.removesuffix(RIGHT_EYE)))
    return sensors


def _files(entry: KRadarFiles, record: Path | None, paths: Mapping[str, Path]) -> dict[str, Callable[[], Any]]:
    return {"files": Constant([str(path) for path in (entry.label, record, *paths.values()) if path is not None])}


def _times(of_files: dict[str, int], paths: dict[str, Path], record: FrameRecord | None) -> dict[str, int]:
    times = {name: of_files[path.name] for name, path in paths.items() if path.name in of_files}
    if record is not None:
        times |= {"os2-64": record.time_ns} | record.times_ns
    return times


def _measured(shared: SequenceFacts, time_ns: int | None) -> dict[str, Callable[[], Any]]:
    """The film, where the conditions come from, and the GPS's and IMUs' measurements nearest to a frame."""
    loaders: dict[str, Callable[[], Any]] = {}
    if shared.conditions_from:
        loaders["conditions_from"] = Constant(shared.conditions_from)
    if shared.video is not None:
        loaders["video"] = Constant(str(shared.video))
    if time_ns is not None:
        loaders |= {name: partial(_nearest, shared.motion, name, time_ns) for name in shared.motion}
    return loaders


def _nearest(motion: Lazy, name: str, time_ns: int) -> dict[str, float] | None:
    table: TimedTable = motion[name]
    return table.nearest(time_ns)


# Splits: the official lists cut every sequence into quarters, train, test, train, test, so that neighbouring quarters
# are one drive 0.1 s apart, and there is no part for validation. Ours deals the 58 sequences out, about 68, 16 and 17 %
# of the frames, with every weather in train and test and every weather but overcast (two sequences) in val.

WHOLE_SEQUENCES: dict[str, tuple[int, ...]] = {
    "train": (
        *(1, 2, 3, 5, 6, 7, 11, 12, 13, 14, 15, 16, 18, 19, 20, 21, 24, 25, 27, 28, 30, 31, 32, 33, 34, 35, 36, 37),
        *(38, 40, 42, 44, 45, 47, 48, 52, 54, 56, 57, 58),
    ),
    "val": (8, 9, 17, 23, 39, 49, 50, 51, 55),
    "test": (4, 10, 22, 26, 29, 41, 43, 46, 53),
}
"""The published sequences by part: what ``whole_sequences`` gives for Table 5, written down so that it never moves."""

_LINE = re.compile(r"(\d{1,3})\s*,\s*(\d{5,9}_\d{5,9})(?:\.txt)?")


def split_of_sequences(sequences: Iterable[str]) -> dict[str, list[str]]:
    """The published sequences of a tree by part.

    Args:
        sequences: Names of the sequences that are there.

    Returns:
        ``train``, ``val`` and ``test``; nothing where a sequence is not a published one or a part would be empty.
    """
    part_of = {str(number): part for part, numbers in WHOLE_SEQUENCES.items() for number in numbers}
    parts: dict[str, list[str]] = {part: [] for part in WHOLE_SEQUENCES}
    for name in sorted(set(sequences), key=lambda name: (len(name), name)):
        if name not in part_of:
            return {}
        parts[part_of[name]].append(name)
    return parts if all(parts.values()) else {}


def read_split_list(path: Path) -> set[tuple[str, str]]:
    """Read an official list: (sequence, frame) of each line such as ``1,00033_00001.txt``.

    Raises:
        FileFormatError: If a line has another form.
    """
    keys = set()
    for number, line in enumerate(read_lines(path), start=1):
        match = _LINE.fullmatch(line)
        if match is None:
            expected = "a line such as 1,00033_00001.txt"
            raise FileFormatError(path, where=f"line {number}", expected=expected, got=repr(line[:80]))
        keys.add((match[1], match[2]))
    return keys

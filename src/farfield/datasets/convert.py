"""Write a data set in another's layout, for an annotation tool, or its ASCII clouds as a binary cache beside them."""

import csv
import io
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import ClassVar, Literal, get_args

import numpy as np
from jaxtyping import Int

from farfield.datasets.base import Dataset
from farfield.datasets.cirrus import Cirrus, CirrusWriter
from farfield.datasets.folder import Folder
from farfield.datasets.kitti.object import KittiWriter
from farfield.datasets.kradar.store import JOURNAL_NAME, StoreSettings, convert_to_store, verify_store
from farfield.datasets.labels.json_labels import DatumaroLabels, OpenLabels, SustechLabels, file_name
from farfield.datasets.splits import SPLIT_SHARES
from farfield.errors import ConfigError, DatasetError
from farfield.files.atomic import write_text
from farfield.files.boxes_csv import BoxRows, write_boxes_csv
from farfield.files.coordinates import camera_words, write_coordinates
from farfield.files.cuboids import Cuboid
from farfield.files.datumaro import format_datumaro
from farfield.files.images import write_image
from farfield.files.openlabel import format_openlabel
from farfield.files.pcd import write_pcd
from farfield.files.sustechpoints import format_calibration, format_sustechpoints
from farfield.frame import Boxes, Cloud, Frame, Key
from farfield.frame.cloud import CACHE_FOLDER, cache_path, is_fresh, write_rows_cache, xyz_columns
from farfield.jobs import HERE, JobJournal, JobOptions, Outcome, Unit, UnitResult, faults, run
from farfield.jobs.folders import locked, sweep_out

Target = Literal["kitti", "cirrus", "boxes-csv", "openlabel", "sustechpoints", "cvat", "cache", "radar-store"]
AnnotationTool = Literal["openlabel", "sustechpoints", "cvat"]
BoxSource = Literal["boxes", "full_boxes"]
TARGETS: tuple[str, ...] = get_args(Target)
_FIRST_NS = 1_600_000_000_000_000_000  # times for frames that have none: 0.1 s apart, sequences 10 s
_PAUSE_NS = 10_000_000_000


def convert(
    dataset: Dataset,
    target: Path | str | None = None,
    *,
    to: Target,
    boxes: BoxSource = "boxes",
    cloud: str | None = None,
    overwrite: bool = False,
    store: StoreSettings | None = None,
    bulk: JobOptions = HERE,
) -> Outcome:
    """Convert a data set. What was written before from unchanged sources, and is intact, is skipped.

    Args:
        dataset: The source.
        target: Folder to write into; for ``boxes-csv`` also a file ending in ``.csv``; for ``cache`` None.
        to: ``"kitti"``, ``"cirrus"``, ``"boxes-csv"``, ``"openlabel"``, ``"sustechpoints"``, ``"cvat"``, ``"cache"``
            or, of K-Radar, ``"radar-store"``.
        boxes: Which boxes to label: the frame's own or its annotation's ``full_boxes``.
        cloud: Which cloud is written (KITTI's velodyne, Cirrus's Gaussian files...); None takes the first.
        overwrite: Write everything anew.
        store: What a radar store keeps.
        bulk: How: workers, engine, progress.

    Returns:
        How many units (frames, sequences or clouds) were written, and how many stood there intact.

    Raises:
        ConfigError: If target and ``to`` do not fit.
        DatasetError: If the source lacks what the target needs.
        BulkError: If units killed their workers twice.
    """
    if to == "cache":
        if target is not None and Path(target).resolve() != dataset.root.resolve():
            raise ConfigError("convert: a cache stands beside its source; leave the target out with to='cache'")
        return _to_cache(dataset, overwrite, bulk)
    if target is None:
        raise ConfigError(f"convert: expected a target folder with to={to!r}, got none")
    target = Path(target)
    check_apart(target, dataset)
    if to == "radar-store":
        return convert_to_store(_kradar(dataset), target, store, overwrite=overwrite, bulk=bulk)
    if to != "boxes-csv" or target.suffix != ".csv":
        check_file_names(dataset, to)
    if to == "boxes-csv" and target.suffix == ".csv":  # one file of labels is written in seconds: nothing to resume
        target.parent.mkdir(parents=True, exist_ok=True)
        unit = Unit(target.name, parameters=(target.name, range(len(dataset))))
        return run(_ToCsv(dataset, target.parent, boxes), [unit], bulk)
    work = _work(dataset, target, to, boxes, cloud)
    journal = JobJournal(target / JOURNAL_NAME, work.setting, overwrite=overwrite)
    outcome = run(work, work.units(), bulk, journal=journal)
    if to == "kitti":
        _finish_kitti(dataset, target)
    return outcome


def verify(
    dataset: Dataset,
    target: Path | str,
    *,
    to: Target,
    boxes: BoxSource = "boxes",
    cloud: str | None = None,
    store: StoreSettings | None = None,
) -> list[str]:
    """Compare what a conversion wrote with its checksums and its source; nothing is written.

    Args:
        dataset: The source.
        target: The folder.
        to: As of :func:`convert`, and so the others.
        boxes: Which boxes were labelled.
        cloud: Which cloud was written.
        store: What a radar store keeps.

    Returns:
        What is wrong, one line a unit: not written, damaged or missing, of another source or with other settings.

    Raises:
        ConfigError: If the target has no journal to compare with.
        DatasetError: If nothing was converted there.
    """
    target = Path(target)
    if to == "radar-store":
        return verify_store(_kradar(dataset), target, store)
    work = _work(dataset, target, to, boxes, cloud)
    if not (target / JOURNAL_NAME).is_file():
        raise DatasetError(f"{target}: expected what `farfield convert --to {to}` wrote, found no {JOURNAL_NAME}")
    return faults(work.units(), JobJournal(target / JOURNAL_NAME, work.setting))


def check_apart(target: Path, data: Dataset) -> None:
    """Refuse to write over what is read: the data's folder, or one of its files.

    Args:
        target: What is going to be written.
        data: What is read; of many frames the files of a hundred are looked at, spread evenly.

    Raises:
        ConfigError: If they meet.
    """
    path = target.resolve()
    if data.stored and path == data.root.resolve():
        raise ConfigError(f"{target}: expected a folder beside the data, got their own: they would be written over")
    sample = range(0, len(data), max(1, len(data) // 100))
    sources = {Path(file).resolve() for index in sample for file in data.files(index)}
    if path in sources or (not target.suffix and path in {file.parent for file in sources}):
        raise ConfigError(
            f"{target}: expected another name, got that of data which are read: they would be written over"
        )


def check_file_names(dataset: Dataset, to: str) -> None:
    """Refuse names of sequences or frames that would share a file: a name of a file has no blanks or commas.

    Args:
        dataset: What is written.
        to: The layout; KITTI's, Cirrus' and the cache number their files or take the sources' own.

    Raises:
        DatasetError: If two names would share one.
    """
    if to not in ("boxes-csv", *get_args(AnnotationTool)):
        return
    names: list[tuple[str, ...]] = [(sequence,) for sequence in dict.fromkeys(dataset.sequences)]
    names += list(dict.fromkeys(dataset.keys)) if to in ("sustechpoints", "cvat") else []
    name_of_file: dict[tuple[str, ...], tuple[str, ...]] = {}
    for name in names:
        file = tuple(file_name(part).casefold() for part in name)
        twin = name_of_file.setdefault(file, name)
        if twin != name:
            raise DatasetError(
                f"{dataset.root}: expected names that differ as names of files, got {'/'.join(twin)!r} and "
                f"{'/'.join(name)!r}, which both become {'/'.join(file)}. Rename one of them."
            )


def _kradar(dataset: Dataset) -> Dataset:
    if dataset.name != "kradar":
        raise DatasetError(f"{dataset.root}: expected K-Radar with to='radar-store', got {dataset.name}")
    return dataset


def _work(
    dataset: Dataset, target: Path, to: str, boxes: BoxSource, cloud: str | None
) -> "_ToKitti | _ToCirrus | _ToCsv | ToolExport":
    if to == "kitti":
        return _ToKitti(dataset=dataset, target=target, boxes=boxes, cloud=cloud)
    if to == "cirrus":
        return _ToCirrus(dataset=dataset, target=target, boxes=boxes, cloud=cloud)
    if to == "boxes-csv" and target.suffix != ".csv":
        return _ToCsv(dataset, target, boxes)
    tool: AnnotationTool
    for tool in get_args(AnnotationTool):
        if to == tool:
            return ToolExport(dataset=dataset, target=target, to=tool, boxes=boxes, cloud=cloud)
    expected = f"expected to to be one of {', '.join(TARGETS)}"
    raise ConfigError(f"convert: {expected}, a folder where it is verified; got {to!r} and {target}")


def _to_cache(dataset: Dataset, overwrite: bool, bulk: JobOptions) -> Outcome:
    reader = dataset.unwrapped
    if isinstance(reader, Cirrus):
        columns, delimiter = reader.mapping.xyz.columns, reader.mapping.xyz.delimiter
        sources: list[tuple[Path, Path, int | None]] = [
            (getattr(entry, pattern), entry.part.root, len(getattr(columns, pattern)))
            for entry in (reader.entries[index] for index in dataset.origins)
            for pattern in ("gaussian", "uniform")
            if getattr(entry, pattern) is not None
        ]
    elif isinstance(reader, Folder):
        clouds = (reader.clouds[index] for index in dataset.origins)
        sources = [(path, dataset.root, xyz_columns(path)) for path in clouds if path.suffix.lower() == ".xyz"]
        delimiter = "auto"
    else:
        sources = []
        delimiter = "auto"
    if not sources:
        raise DatasetError(f"{dataset.root}: expected ASCII clouds (.xyz) to cache; the clouds are binary already")
    sources = list(dict.fromkeys(sources))
    missing = [source for source in sources if overwrite or not is_fresh(cache_path(source[0], source[1]), source[0])]
    folders = {root / CACHE_FOLDER for _, root, _ in missing}
    _sweep(folders)
    units = [Unit(str(source), (source,), (root, count)) for source, root, count in missing]
    try:
        outcome = run(_CloudCache(delimiter), units, bulk)
    finally:
        _sweep(folders)  # a worker that was killed left what it was at
    return Outcome(written=outcome.written, skipped=len(sources) - outcome.written)


def _sweep(folders: Iterable[Path]) -> None:
    for folder in folders:
        if folder.is_dir():
            sweep_out(folder)


@dataclass(frozen=True)
class _CloudCache:
    """Writes the cache of one cloud."""

    delimiter: str

    def __call__(self, unit: Unit) -> UnitResult:
        root, count = unit.parameters
        columns = None if count in (5, 8) else count
        folder = root / CACHE_FOLDER
        folder.mkdir(exist_ok=True)
        with locked(folder, shared=True):  # or another command would sweep out what is being written
            path = write_rows_cache(unit.sources[0], root, columns=columns, delimiter=self.delimiter)
        return UnitResult(files=(path,))


@dataclass(frozen=True, kw_only=True)
class _FrameConversion:
    """Writes frames of a data set in another layout; the unit's parameters are the frame's index.

    Args:
        dataset: The frames.
        target: Folder to write into.
        boxes: Which boxes to label.
        cloud: Which cloud to write.
    """

    dataset: Dataset
    target: Path
    boxes: BoxSource
    cloud: str | None
    to: ClassVar[str]
    memory_bytes = 500_000_000

    def units(self) -> list[Unit]:
        """One a frame."""
        keys = enumerate(self.dataset.keys)
        return [Unit("/".join(key), tuple(self.dataset.files(index)), index) for index, key in keys]

    @property
    def setting(self) -> str:
        """What decides the files besides their sources."""
        return f"{self.to} {self.boxes} {self.cloud} {self.dataset.name}{views(self.dataset)}"


class _ToKitti(_FrameConversion):
    to = "kitti"

    def units(self) -> list[Unit]:
        """One a frame; the number names its files."""
        return [replace(unit, name=f"{unit.parameters:06d}/{unit.name}") for unit in super().units()]

    def __call__(self, unit: Unit) -> UnitResult:
        index, frame = unit.parameters, self.dataset[unit.parameters]
        boxes, occlusion = boxes_of(frame, self.boxes), _occlusion(frame)
        paths = KittiWriter(self.target).write(index, frame, cloud=self.cloud, boxes=boxes, occlusion=occlusion)
        return UnitResult(files=tuple(paths.values()))


def _occlusion(frame: Frame) -> Int[np.ndarray, " n"] | None:
    """How far each box is hidden, as the labels say: 0 to 2, 3 where they do not know it."""
    details = {} if frame.annotation is None else frame.annotation.details
    if "occlusion" not in details:
        return None
    values = np.asarray(details["occlusion"]).astype(np.int64)
    return np.where((values >= 0) & (values < 3), values, 3)


def _finish_kitti(dataset: Dataset, target: Path) -> None:
    """Write what belongs to all frames."""
    table = io.StringIO()
    rows = ((f"{index:06d}", *key) for index, key in enumerate(dataset.keys))
    csv.writer(table, lineterminator="\n").writerows([("number", "sequence", "frame"), *rows])
    write_text(target / "frames.csv", table.getvalue())
    first = dataset[0]
    named = next((name for name in first.cameras if name in first.images), next(iter(first.cameras), ""))
    write_coordinates(target / "training" / "label_2", camera_words(named, first.reference))
    _write_image_sets(dataset, target)


def _write_image_sets(dataset: Dataset, target: Path) -> None:
    """Carry the split over as KITTI's usual lists: the parts a file names, else those of three or more sequences."""
    named = dataset.split_parts()
    if not named and len(set(dataset.split_units())) < len(SPLIT_SHARES):
        return
    number = {key: index for index, key in enumerate(dataset.keys)}
    (target / "ImageSets").mkdir(exist_ok=True)
    for name in (part for part in SPLIT_SHARES if part in (named or SPLIT_SHARES)):
        rows = [f"{number[key]:06d}\n" for key in dataset.split(name).keys]
        write_text(target / "ImageSets" / f"{name}.txt", "".join(rows))


class _ToCirrus(_FrameConversion):
    to = "cirrus"

    @cached_property
    def times(self) -> list[int]:
        return _times(self.dataset)

    def __call__(self, unit: Unit) -> UnitResult:
        frame = _as_cirrus(self.dataset[unit.parameters], self.times[unit.parameters], self.cloud)
        return UnitResult(files=tuple(CirrusWriter(self.target).write(frame, box_label_source=self.boxes).values()))


def _times(dataset: Dataset) -> list[int]:
    """A time for every frame: its name where that is one, else made up with a pause between sequences."""
    if all(name.isdigit() and 16 <= len(name) <= 19 for name in dataset.frame_ids):
        return [int(name) for name in dataset.frame_ids]
    order = {name: position for position, name in enumerate(dict.fromkeys(dataset.sequences))}
    return [_FIRST_NS + index * 100_000_000 + order[name] * _PAUSE_NS for index, name in enumerate(dataset.sequences)]


def _as_cirrus(frame: Frame, time_ns: int, cloud: str | None) -> Frame:
    """Give the chosen cloud the place of the Gaussian sweep; the first image becomes the camera's."""
    clouds = dict.fromkeys(frame.clouds)
    if cloud is not None or "gaussian" not in clouds:
        chosen = {"gaussian": frame.cloud(cloud)}
    else:
        chosen = {name: frame.clouds[name] for name in ("gaussian", "uniform") if name in clouds}
    camera = next(iter(frame.images), None)
    timed = frame.time_ns is not None  # made-up times are the frame's alone
    return replace(
        frame,
        time_ns=time_ns,
        clouds=chosen,
        images={} if camera is None else {"camera": frame.images[camera]},
        cameras={"camera": frame.cameras[camera]} if camera is not None and camera in frame.cameras else {},
        sensors=frame.sensors if timed else {name: replace(s, time_ns=None) for name, s in frame.sensors.items()},
    )


@dataclass(frozen=True)
class _ToCsv:
    """Writes the boxes of some frames into one file; the unit's parameters are its name and the frames' indices."""

    dataset: Dataset
    target: Path
    boxes: BoxSource

    @property
    def setting(self) -> str:
        """What decides the files besides their sources."""
        return f"boxes-csv {self.boxes} {self.dataset.name} with reference{views(self.dataset)}"

    def units(self) -> list[Unit]:
        """One a sequence."""
        groups: dict[str, list[int]] = {}
        for index, sequence in enumerate(self.dataset.sequences):
            groups.setdefault(sequence, []).append(index)
        files = self.dataset.files
        return [
            Unit(
                name,
                tuple(dict.fromkeys(file for index in indices for file in files(index))),
                (f"{file_name(name)}.csv", indices),
            )
            for name, indices in groups.items()
        ]

    def __call__(self, unit: Unit) -> UnitResult:
        name, indices = unit.parameters
        frames = (self.dataset.frame(index) for index in indices)
        reference = self.dataset[indices[0]].reference
        rows = box_rows(((frame.key, boxes_of(frame, self.boxes)) for frame in frames), reference=reference)
        write_boxes_csv(self.target / name, rows)
        return UnitResult(files=(self.target / name,))


def box_rows(frames: Iterable[tuple[Key, Boxes | None]], *, reference: str = "") -> BoxRows:
    """Join the boxes of frames, by (sequence, frame), to the rows of a CSV file; one without boxes leaves no row.

    Args:
        frames: The boxes of each frame.
        reference: Sensor in whose coordinates they stand; empty where not known.
    """
    filled = [(key, boxes) for key, boxes in frames if boxes is not None and len(boxes)]
    together = Boxes.concatenate([boxes for _, boxes in filled]) if filled else Boxes.empty()
    counts = [len(boxes) for _, boxes in filled]
    sequences, frame_ids = ([key[row] for key, _ in filled] for row in (0, 1))
    return BoxRows(
        sequence=np.repeat(np.array(sequences, dtype=np.str_), counts),
        frame=np.repeat(np.array(frame_ids, dtype=np.str_), counts),
        label=np.asarray(together.label),
        centre_m=together.centre_m,
        size_m=together.size_m,
        yaw_rad=together.yaw_rad,
        score=together.score,
        track_id=together.track_id,
        point_count=together.point_count,
        velocity_m_s=together.velocity_m_s,
        reference=np.full(len(together), reference) if reference else None,
    )


# Data sets as annotation tools take them: SUSTechPOINTS, CVAT (Datumaro), and OpenLABEL's boxes alone.


def views(dataset: Dataset) -> str:
    """What else decides how a data set is seen: its reader's options and its maps; empty where there are none."""
    recipe = {name: dataset.recipe.get(name) for name in ("options", "maps")}
    return f" {json.dumps(recipe, sort_keys=True, default=str)}" if any(recipe.values()) else ""


def boxes_of(frame: Frame, source: BoxSource) -> Boxes | None:
    """The boxes to label: the frame's own, or its annotation's ``full_boxes``.

    Raises:
        DatasetError: If the whole bodies are wanted and not known.
    """
    if source == "boxes" or frame.annotation is None:
        return frame.boxes
    if frame.annotation.full_boxes is None:
        raise DatasetError(f"frame {frame.key}: expected full_boxes in its annotation, which boxes='full_boxes' takes")
    return frame.annotation.full_boxes


def cuboids_of(boxes: Boxes | None, frame: str) -> list[Cuboid]:
    """Boxes as tools exchange them; the classes keep our names."""
    if boxes is None or not len(boxes):
        return []
    rows = np.column_stack([boxes.centre_m, boxes.size_m, boxes.yaw_rad]).tolist()
    tracks = [-1] * len(boxes) if boxes.track_id is None else boxes.track_id.tolist()
    return [
        Cuboid(frame=frame, label=str(label), box=tuple(row), track="" if track < 0 else str(track))
        for label, row, track in zip(np.asarray(boxes.label).tolist(), rows, tracks, strict=True)
    ]


@dataclass(frozen=True, kw_only=True)
class ToolExport:
    """Writes sequences of a data set for an annotation tool; a unit's parameters are the frames' indices.

    SUSTechPOINTS gets scenes with clouds (PCD), images, calibration and labels; CVAT clouds below ``point_clouds`` and
    one Datumaro file a sequence; OpenLABEL one file a sequence.

    Args:
        dataset: The frames.
        target: Folder to write into.
        to: The tool.
        boxes: Which boxes to label.
        cloud: Which cloud to write; None takes the first.
    """

    dataset: Dataset
    target: Path
    to: AnnotationTool
    boxes: BoxSource
    cloud: str | None
    memory_bytes = 500_000_000

    @property
    def setting(self) -> str:
        """What decides the files besides their sources."""
        return f"{self.to} {self.boxes} {self.cloud} {self.dataset.name}{views(self.dataset)}"

    def units(self) -> list[Unit]:
        """One a sequence; for SUSTechPOINTS, whose files are of one frame each, one a frame."""
        files = self.dataset.files
        if self.to == "sustechpoints":
            keys = enumerate(self.dataset.keys)
            return [Unit("/".join(key), tuple(files(index)), (index,)) for index, key in keys]
        groups: dict[str, list[int]] = {}
        for index, sequence in enumerate(self.dataset.sequences):
            groups.setdefault(sequence, []).append(index)
        return [
            Unit(name, tuple(dict.fromkeys(file for index in indices for file in files(index))), tuple(indices))
            for name, indices in groups.items()
        ]

    def __call__(self, unit: Unit) -> UnitResult:
        """Write one unit."""
        frames = [self.dataset.frame(index) for index in unit.parameters]
        if self.to == "sustechpoints":
            return UnitResult(files=tuple(path for frame in frames for path in self._scene_frame(frame)))
        names = [frame.frame_id if self.to == "openlabel" else file_name(frame.frame_id) for frame in frames]
        cuboids = [
            cuboid
            for frame, name in zip(frames, names, strict=True)
            for cuboid in cuboids_of(boxes_of(frame, self.boxes), name)
        ]
        if self.to == "openlabel":
            text = format_openlabel(cuboids, names, [frame.time_ns for frame in frames], system=frames[0].reference)
            return UnitResult(files=(_written(OpenLabels(self.target).path(frames[0].key), text),))
        path = _written(DatumaroLabels(self.target).path(frames[0].key), format_datumaro(cuboids, names))
        return UnitResult(files=(path, *self._clouds(frames, path.parents[1] / "point_clouds", names)))

    def _clouds(self, frames: Sequence[Frame], folder: Path, names: Sequence[str]) -> Iterable[Path]:
        for frame, name in zip(frames, names, strict=True):
            yield write_cloud(folder / f"{name}.pcd", frame.cloud(self.cloud))

    def _scene_frame(self, frame: Frame) -> list[Path]:
        label = SustechLabels(self.target).path(frame.key)
        scene, stem = label.parents[1], label.stem
        paths = [write_cloud(scene / "lidar" / f"{stem}.pcd", frame.cloud(self.cloud))]
        for name, camera in frame.cameras.items():
            if name in frame.images:
                path = scene / "camera" / file_name(name) / f"{stem}.jpg"
                path.parent.mkdir(parents=True, exist_ok=True)
                write_image(path, frame.images[name])
                calibration = format_calibration(camera.camera_T_lidar, camera.matrix)
                paths += [path, _written(scene / "calib" / "camera" / f"{file_name(name)}.json", calibration)]
        boxes = boxes_of(frame, self.boxes)
        if boxes is not None:
            paths.append(_written(label, format_sustechpoints(cuboids_of(boxes, stem))))
        label.parent.mkdir(parents=True, exist_ok=True)
        return paths


def write_cloud(path: Path, cloud: Cloud) -> Path:
    """Write a cloud as binary PCD with x, y, z and, where there is one, intensity."""
    path.parent.mkdir(parents=True, exist_ok=True)
    fields = {axis: column.astype(np.float32) for axis, column in zip("xyz", cloud.points_m.T, strict=True)}
    if cloud.intensity is not None:
        fields["intensity"] = cloud.intensity.astype(np.float32)
    write_pcd(path, fields)
    return path


def _written(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, text)
    return path

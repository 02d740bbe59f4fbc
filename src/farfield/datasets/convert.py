"""Write a data set in another's layout, for an annotation tool, or its ASCII clouds as a binary cache beside them."""

import csv
import io
import json
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import ClassVar, Literal, get_args

import numpy as np
from jaxtyping import Int

from farfield.datasets.base import Dataset
from farfield.datasets.cirrus import CirrusWriter
from farfield.datasets.cirrus.writer import CIRRUS_HOLDS
from farfield.datasets.cloud_caches import convert_to_cache
from farfield.datasets.coco import COCO_HOLDS, write_coco
from farfield.datasets.kitti.object import KITTI_HOLDS, KittiWriter
from farfield.datasets.kradar.store import (
    JOURNAL_NAME,
    STORE_HOLDS,
    StoreSettings,
    convert_to_store,
    store_losses,
    verify_store,
)
from farfield.datasets.labels.json_labels import file_name
from farfield.datasets.losses import ITEMS, Capacity, Loss, frame_losses, named_losses
from farfield.datasets.nuscenes.writer import NUSCENES_HOLDS, T4_HOLDS, SchemaExport
from farfield.datasets.openpcdet import OPENPCDET_HOLDS, OpenPcdetWriter
from farfield.datasets.splits import SPLIT_SHARES
from farfield.datasets.tool_export import (
    CVAT_HOLDS,
    LABELCLOUD_HOLDS,
    OPENLABEL_HOLDS,
    SUPERVISELY_HOLDS,
    SUSTECHPOINTS_HOLDS,
    XTREME1_HOLDS,
    AnnotationTool,
    BoxSource,
    ToolExport,
    boxes_of,
    cloud_bytes,
    spread,
    views,
)
from farfield.errors import ConfigError, DatasetError, FarfieldError
from farfield.files.atomic import write_text
from farfield.files.boxes_csv import BoxRows, write_boxes_csv
from farfield.files.coordinates import camera_words, write_coordinates
from farfield.files.outputs import check_outputs
from farfield.files.stamps import name_time_ns
from farfield.frame import Boxes, Frame, Key
from farfield.jobs import HERE, JobJournal, JobOptions, Outcome, Unit, UnitResult, faults, run
from farfield.jobs.folders import held

Target = Literal[
    "kitti",
    "openpcdet",
    "cirrus",
    "boxes-csv",
    "openlabel",
    "sustechpoints",
    "cvat",
    "supervisely",
    "xtreme1",
    "labelcloud",
    "nuscenes",
    "t4",
    "coco",
    "cache",
    "radar-store",
]
TARGETS: tuple[str, ...] = get_args(Target)
BOXES_CSV_HOLDS = Capacity(
    title="boxes as CSV",
    holds=frozenset({"names", "tracks", "velocities", "scores", "point counts"}),
    one_cloud=False,
    reasons={
        **dict.fromkeys(("clouds", "images", "cameras", "radar"), "boxes alone are written"),
        "empty frames": "a row is a box",
    },
)
CACHE_HOLDS = Capacity(title="a cache", holds=frozenset(ITEMS))
CAPACITIES: Mapping[str, Capacity] = {
    "kitti": KITTI_HOLDS,
    "openpcdet": OPENPCDET_HOLDS,
    "cirrus": CIRRUS_HOLDS,
    "boxes-csv": BOXES_CSV_HOLDS,
    "openlabel": OPENLABEL_HOLDS,
    "sustechpoints": SUSTECHPOINTS_HOLDS,
    "cvat": CVAT_HOLDS,
    "supervisely": SUPERVISELY_HOLDS,
    "xtreme1": XTREME1_HOLDS,
    "labelcloud": LABELCLOUD_HOLDS,
    "nuscenes": NUSCENES_HOLDS,
    "t4": T4_HOLDS,
    "coco": COCO_HOLDS,
    "cache": CACHE_HOLDS,
    "radar-store": STORE_HOLDS,
}
"""What each target of :func:`convert` holds."""
LOSSES_NAME = ".farfield_losses.jsonl"
"""The record of what a conversion lost, beside its journal: one line a loss."""
_FIRST_NS = 1_600_000_000_000_000_000  # times for frames that have none: 0.1 s apart, sequences 10 s
_PAUSE_NS = 10_000_000_000
_APART_NS = 1_000_000_000  # readers begin a new drive after a longer pause


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
    announce: Callable[[Loss], None] | None = None,
) -> Outcome:
    """Convert a data set. What was written before from unchanged sources, and is intact, is skipped.

    Args:
        dataset: The source.
        target: Folder to write into; for ``boxes-csv`` also a file ending in ``.csv``; for ``cache`` None.
        to: ``"kitti"``, ``"openpcdet"``, ``"cirrus"``, ``"boxes-csv"``, ``"openlabel"``, ``"sustechpoints"``,
            ``"cvat"``, ``"supervisely"``, ``"xtreme1"``, ``"labelcloud"``, ``"nuscenes"``, ``"t4"``, ``"cache"`` or, of
            K-Radar, ``"radar-store"``.
        boxes: Which boxes to label: the frame's own or its annotation's ``full_boxes``.
        cloud: Which cloud is written (KITTI's velodyne, Cirrus's Gaussian files...); None takes the first.
        overwrite: Write everything anew.
        store: What a radar store keeps.
        bulk: How: workers, engine, progress.
        announce: Is told each loss of :func:`losses` before anything is written.

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
        return convert_to_cache(dataset, overwrite, bulk)
    if target is None:
        raise ConfigError(f"convert: expected a target folder with to={to!r}, got none")
    target = Path(target)
    check_apart(target, dataset, beside=True)
    lost = losses(dataset, to, boxes=boxes, cloud=cloud, store=store)
    if announce is not None:
        for loss in lost:
            announce(loss)
    if to == "radar-store":
        outcome = convert_to_store(_kradar(dataset), target, store, overwrite=overwrite, bulk=bulk)
        _record(target, lost)
        return outcome
    if to != "boxes-csv" or target.suffix != ".csv":
        check_file_names(dataset, to)
    _check_clouds(dataset, to)
    if to == "coco":
        if target.suffix != ".json" or target.is_dir():
            raise ConfigError(f"{target}: expected the name of a file ending in .json with to='coco'")
        with held(target, file=True):
            write_coco(dataset, target)
        return Outcome(written=1)
    if to == "boxes-csv" and target.suffix == ".csv":  # one file of labels is written in seconds: nothing to resume
        unit = Unit(target.name, parameters=(target.name, range(len(dataset))))
        with held(target, file=True):
            return run(_ToCsv(dataset, target.parent, boxes), [unit], bulk)
    numbered = to in ("kitti", "openpcdet")
    image_sets = _image_sets(dataset) if numbered else {}  # reads the lists before the work
    work = _work(dataset, target, to, boxes, cloud)
    with held(target):
        journal = JobJournal(target / JOURNAL_NAME, work.setting, overwrite=overwrite)
        outcome = run(work, work.units(), bulk, journal=journal)
        _record(target, lost)
        if numbered:
            _finish_numbered(dataset, target, image_sets)
        if to == "kitti":
            _finish_kitti(dataset, target)
        if isinstance(work, SchemaExport | ToolExport):
            work.finish()
    return outcome


def losses(
    dataset: Dataset,
    to: Target,
    *,
    boxes: BoxSource = "boxes",
    cloud: str | None = None,
    store: StoreSettings | None = None,
) -> tuple[Loss, ...]:
    """What a conversion would lose, by up to five frames that are spread over the set; nothing is written.

    Args:
        dataset: The source; its maps count.
        to: As of :func:`convert`, and so the others.
        boxes: Which boxes are labelled.
        cloud: Which cloud is written.
        store: What a radar store keeps.

    Returns:
        A line for each kind of thing that the frames have and the target's files do not hold; of frames that cannot be
        read none, which the conversion says.
    """
    if to == "radar-store":
        return store_losses(store or StoreSettings())
    lost, times_ns = [], _times(dataset) if to == "cirrus" else None
    for index in spread(dataset) if to != "cache" else ():
        with suppress(FarfieldError):  # said where the frame is converted
            frame = dataset[index]
            time_ns = frame.time_ns if times_ns is None else times_ns[index]
            lost.append(frame_losses(frame, CAPACITIES[to], cloud=cloud, boxes=boxes, time_ns=time_ns))
    named = named_losses(lost, CAPACITIES[to])
    if to == "nuscenes" or to == "t4":
        return (*named, *SchemaExport(dataset=dataset, target=dataset.root, boxes=boxes, to=to).left_out())
    return named


def _record(target: Path, lost: Iterable[Loss]) -> None:
    """Keep what was lost beside the journal."""
    rows = ({"item": loss.item, "names": list(loss.names), "text": str(loss)} for loss in lost)
    write_text(target / LOSSES_NAME, "".join(json.dumps(row) + "\n" for row in rows))


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


def check_apart(target: Path, data: Dataset, *, beside: bool = False) -> None:
    """Refuse to write over what is read: the data's folder, or one of its files.

    Args:
        target: What is going to be written.
        data: What is read; of many frames the files of a hundred are looked at, spread evenly.
        beside: Whether it must not stand within the data's folder, nor around it.

    Raises:
        ConfigError: If they meet.
    """
    path = target.resolve()
    if data.stored:
        as_file = {"target": target} if target.suffix and not target.is_dir() else {}
        check_outputs((data.root,), files=as_file, folders={} if as_file else {"target": target}, apart=beside)
    sample = range(0, len(data), max(1, len(data) // 100))
    sources = {Path(file).resolve() for index in sample for file in data.files(index)}
    if path in sources or (not target.suffix and path in {file.parent for file in sources}):
        raise ConfigError(
            f"{target}: expected another name, got that of data which are read: they would be written over"
        )


def _check_clouds(dataset: Dataset, to: Target) -> None:
    """Refuse labels alone where the target holds clouds.

    Raises:
        DatasetError: If none of some frames has a cloud.
    """
    if not CAPACITIES[to].one_cloud or not len(dataset):
        return
    for index in spread(dataset):
        try:
            if dataset[index].clouds:
                return
        except FarfieldError:  # said where the frame is converted
            return
    raise DatasetError(
        f"{dataset.root}: expected clouds, which {CAPACITIES[to].title} hold, got labels alone. Write them with "
        "--to boxes-csv or --to openlabel"
    )


def check_file_names(dataset: Dataset, to: str) -> None:
    """Refuse names of sequences or frames that would share a file: a name of a file has no blanks or commas.

    Args:
        dataset: What is written.
        to: The layout; KITTI's, Cirrus' and the cache number their files or take the sources' own.

    Raises:
        DatasetError: If two names would share one.
    """
    if to not in ("boxes-csv", "nuscenes", "t4", *get_args(AnnotationTool)):
        return
    names: list[tuple[str, ...]] = [(sequence,) for sequence in dict.fromkeys(dataset.sequences)]
    names += list(dict.fromkeys(dataset.keys)) if to in get_args(AnnotationTool) and to != "openlabel" else []
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
) -> "_ToKitti | _ToCirrus | _ToCsv | ToolExport | SchemaExport":
    if to in ("kitti", "openpcdet"):
        numbered = _ToKitti if to == "kitti" else _ToOpenPcdet
        return numbered(dataset=dataset, target=target, boxes=boxes, cloud=cloud)
    if to == "cirrus":
        return _ToCirrus(dataset=dataset, target=target, boxes=boxes, cloud=cloud)
    if to == "boxes-csv" and target.suffix != ".csv":
        return _ToCsv(dataset, target, boxes)
    if to == "nuscenes" or to == "t4":
        return SchemaExport(dataset=dataset, target=target, boxes=boxes, to="nuscenes" if to == "nuscenes" else "t4")
    tool: AnnotationTool
    for tool in get_args(AnnotationTool):
        if to == tool:
            return ToolExport(dataset=dataset, target=target, to=tool, boxes=boxes, cloud=cloud)
    expected = f"expected to to be one of {', '.join(TARGETS)}"
    raise ConfigError(f"convert: {expected}, a folder where it is verified; got {to!r} and {target}")


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

    @cached_property
    def disk_bytes(self) -> float:
        """What a frame takes on the disk at least: its points."""
        return cloud_bytes(self.dataset, self.cloud)

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


class _ToOpenPcdet(_ToKitti):
    to = "openpcdet"

    def __call__(self, unit: Unit) -> UnitResult:
        frame = self.dataset[unit.parameters]
        boxes = boxes_of(frame, self.boxes)
        paths = OpenPcdetWriter(self.target).write(unit.parameters, frame, cloud=self.cloud, boxes=boxes)
        return UnitResult(files=tuple(paths.values()))


def _finish_numbered(dataset: Dataset, target: Path, image_sets: Mapping[str, str]) -> None:
    """Write which frame a number is of, and the lists of the parts."""
    table = io.StringIO()
    rows = ((f"{index:06d}", *key) for index, key in enumerate(dataset.keys))
    csv.writer(table, lineterminator="\n").writerows([("number", "sequence", "frame"), *rows])
    write_text(target / "frames.csv", table.getvalue())
    for name, text in image_sets.items():
        (target / "ImageSets").mkdir(exist_ok=True)
        write_text(target / "ImageSets" / f"{name}.txt", text)


def _finish_kitti(dataset: Dataset, target: Path) -> None:
    """Say in which axes the labels stand."""
    first = dataset[0]
    write_coordinates(target / "training" / "label_2", camera_words(first.front_camera or "", first.reference))


def _image_sets(dataset: Dataset) -> dict[str, str]:
    """The split as KITTI's usual lists: the parts a file names, else those of three or more sequences."""
    named = dataset.split_parts()
    if not named and len(set(dataset.split_units())) < len(SPLIT_SHARES):
        return {}
    number = {key: index for index, key in enumerate(dataset.keys)}
    return {
        part: "".join(f"{number[key]:06d}\n" for key in dataset.split(part).keys)
        for part in SPLIT_SHARES
        if part in (named or SPLIT_SHARES)
    }


class _ToCirrus(_FrameConversion):
    to = "cirrus"

    @cached_property
    def times(self) -> list[int]:
        return _times(self.dataset)

    @property
    def setting(self) -> str:
        """What decides the files besides their sources."""
        return super().setting + (" own times" if self.times == _own_times(self.dataset) else "")

    def __call__(self, unit: Unit) -> UnitResult:
        frame = _as_cirrus(self.dataset[unit.parameters], self.times[unit.parameters], self.cloud)
        return UnitResult(files=tuple(CirrusWriter(self.target).write(frame, box_label_source=self.boxes).values()))


def _times(dataset: Dataset) -> list[int]:
    """A time for every frame: its name where that is one, its own, else made up with a pause between sequences."""
    times_ns = [time_ns for name in dataset.frame_ids if (time_ns := name_time_ns(name)) is not None]
    if len(times_ns) == len(dataset):
        return times_ns
    if own := _own_times(dataset):
        return own
    order = {name: position for position, name in enumerate(dict.fromkeys(dataset.sequences))}
    return [_FIRST_NS + index * 100_000_000 + order[name] * _PAUSE_NS for index, name in enumerate(dataset.sequences)]


def _own_times(dataset: Dataset) -> list[int]:
    """The drives' times; empty where one is not known, cannot name a file, or drives do not lie apart in time."""
    times_ns = np.full(len(dataset), -1, dtype=np.int64)
    spans = []
    for drive in dataset.drives():
        if drive.times_ns is None or not len(drive.times_ns):
            return []
        times_ns[drive.indices] = drive.times_ns
        spans.append((int(drive.times_ns.min()), int(drive.times_ns.max())))
    listed: list[int] = times_ns.tolist()
    apart = all(after[0] - before[1] > _APART_NS for before, after in pairwise(sorted(spans)))
    named = all(name_time_ns(str(time_ns)) == time_ns for time_ns in listed)
    return listed if apart and named and len(set(listed)) == len(listed) else []


def _as_cirrus(frame: Frame, time_ns: int, cloud: str | None) -> Frame:
    """Give the chosen cloud the place of the Gaussian sweep; the image ahead becomes the camera's."""
    clouds = dict.fromkeys(frame.clouds)
    if cloud is not None or "gaussian" not in clouds:
        chosen = {"gaussian": frame.cloud(cloud)}
    else:
        chosen = {name: frame.clouds[name] for name in ("gaussian", "uniform") if name in clouds}
    camera = frame.front_camera if frame.front_camera in frame.images else next(iter(frame.images), None)
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

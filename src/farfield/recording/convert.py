"""Write a data set in another's layout, or its ASCII clouds as a binary cache beside them."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from farfield.datasets.base import Dataset
from farfield.datasets.cirrus import Cirrus, CirrusWriter
from farfield.datasets.cloud_files import cache_path, is_fresh, write_rows_cache
from farfield.datasets.folder import Folder
from farfield.datasets.journal import Journal
from farfield.datasets.kitti.writer import KittiWriter
from farfield.datasets.kradar.store import StoreSettings, convert_to_store
from farfield.errors import ConfigError, DatasetError
from farfield.files.atomic import write_text
from farfield.files.boxes_csv import BoxRows, write_boxes_csv
from farfield.frame import Boxes, Frame

TARGETS = ("kitti", "cirrus", "boxes-csv", "cache", "radar-store")
Target = Literal["kitti", "cirrus", "boxes-csv", "cache", "radar-store"]
BoxSource = Literal["boxes", "full_boxes"]
Progress = Callable[[int, int], None]
_FIRST_NS = 1_600_000_000_000_000_000  # times for frames that have none: 0.1 s apart, sequences 10 s
_PAUSE_NS = 10_000_000_000


@dataclass
class Outcome:
    """How many units (frames, sequences or clouds) were written, and how many stood there intact."""

    written: int = 0
    skipped: int = 0


def convert(
    dataset: Dataset,
    target: Path | str | None = None,
    *,
    to: Target,
    boxes: BoxSource = "boxes",
    cloud: str | None = None,
    overwrite: bool = False,
    store: StoreSettings | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> Outcome:
    """Convert a data set. What was written before from unchanged sources, and is intact, is skipped.

    Args:
        dataset: The source.
        target: Folder to write into; for ``boxes-csv`` also a file ending in ``.csv``; for ``cache`` None.
        to: ``"kitti"``, ``"cirrus"``, ``"boxes-csv"``, ``"cache"`` or, of K-Radar, ``"radar-store"``.
        boxes: Which boxes to label: the frame's own or its annotation's ``full_boxes``.
        cloud: Which cloud KITTI's velodyne and Cirrus's Gaussian files get; None takes the first.
        overwrite: Write everything anew.
        store: What a radar store keeps.
        workers: Processes that convert, for ``radar-store``.
        progress: Called with the number of units done and the number of all.

    Raises:
        ConfigError: If target and ``to`` do not fit.
        DatasetError: If the source lacks what the target needs.
    """
    step = progress or (lambda _done, _all: None)
    if to == "cache":
        if target is not None and Path(target).resolve() != dataset.root.resolve():
            raise ConfigError("convert: a cache stands beside its source; leave the target out with to='cache'")
        return _to_cache(dataset, overwrite, step)
    if target is None:
        raise ConfigError(f"convert: expected a target folder with to={to!r}, got none")
    if to == "boxes-csv":
        return _to_csv(dataset, Path(target), boxes, overwrite, step)
    if to == "kitti":
        return _to_kitti(dataset, Path(target), boxes, cloud, overwrite, step)
    if to == "cirrus":
        return _to_cirrus(dataset, Path(target), boxes, cloud, overwrite, step)
    if to == "radar-store":
        if dataset.name != "kradar":
            raise DatasetError(f"{dataset.root}: expected K-Radar with to='radar-store', got {dataset.name}")
        return Outcome(
            *convert_to_store(dataset, Path(target), store, overwrite=overwrite, workers=workers, progress=step)
        )
    raise ConfigError(f"convert: expected to to be one of {', '.join(TARGETS)}; got {to!r}")


def _to_cache(dataset: Dataset, overwrite: bool, step: Progress) -> Outcome:
    reader = dataset.unwrapped
    if isinstance(reader, Cirrus):
        sources = [
            (getattr(entry, pattern), entry.part.root, len(getattr(reader.mapping.xyz.columns, pattern)))
            for entry in (reader.entries[index] for index in dataset.origins)
            for pattern in ("gaussian", "uniform")
            if getattr(entry, pattern) is not None
        ]
        delimiter = reader.mapping.xyz.delimiter
    elif isinstance(reader, Folder):
        clouds = (reader.clouds[index] for index in dataset.origins)
        sources = [(path, dataset.root, 5) for path in clouds if path.suffix == ".xyz"]
        delimiter = "auto"
    else:
        sources = []
        delimiter = "auto"
    if not sources:
        raise DatasetError(f"{dataset.root}: expected ASCII clouds (.xyz) to cache; the clouds are binary already")
    sources = list(dict.fromkeys(sources))
    outcome = Outcome()
    for number, (source, root, count) in enumerate(sources, start=1):
        if is_fresh(cache_path(source, root), source) and not overwrite:
            outcome.skipped += 1
        else:
            write_rows_cache(source, root, columns=None if count in (5, 8) else count, delimiter=delimiter)
            outcome.written += 1
        step(number, len(sources))
    return outcome


def _boxes_of(frame: Frame, source: BoxSource) -> Boxes | None:
    if source == "boxes" or frame.annotation is None:
        return frame.boxes
    if frame.annotation.full_boxes is None:
        raise DatasetError(f"frame {frame.key}: expected full_boxes in its annotation, which boxes='full_boxes' takes")
    return frame.annotation.full_boxes


def _each(
    units: Iterable[tuple[str, Sequence[Path], Callable[[], Sequence[Path]]]],
    total: int,
    journal: Journal,
    setting: str,
    step: Progress,
) -> Outcome:
    """Write units that the journal does not have."""
    outcome = Outcome()
    for number, (unit, sources, write) in enumerate(units, start=1):
        if journal.has(unit, sources, setting):
            outcome.skipped += 1
        else:
            journal.add(unit, sources, setting, write())
            outcome.written += 1
        step(number, total)
    return outcome


def _to_kitti(
    dataset: Dataset, target: Path, boxes: BoxSource, cloud: str | None, overwrite: bool, step: Progress
) -> Outcome:
    writer, journal = KittiWriter(target), Journal(target, overwrite=overwrite)
    write = partial(_write_kitti, writer, dataset, boxes, cloud)
    units = (("/".join(key), dataset.files(index), partial(write, index)) for index, key in enumerate(dataset.keys))
    outcome = _each(units, len(dataset), journal, f"kitti {boxes} {cloud} {dataset.name}", step)
    lines = [f"{index:06d},{sequence},{frame}" for index, (sequence, frame) in enumerate(dataset.keys)]
    write_text(target / "frames.csv", "\n".join(["number,sequence,frame", *lines]) + "\n")
    _write_image_sets(dataset, target)
    return outcome


def _write_kitti(
    writer: KittiWriter, dataset: Dataset, boxes: BoxSource, cloud: str | None, index: int
) -> Sequence[Path]:
    frame = dataset[index]
    return list(writer.write(index, frame, cloud=cloud, boxes=_boxes_of(frame, boxes)).values())


def _write_image_sets(dataset: Dataset, target: Path) -> None:
    """Carry the split over as KITTI's usual lists; a set of fewer than three sequences has no split."""
    if len(set(dataset.split_units())) < 3:
        return
    number = {key: index for index, key in enumerate(dataset.keys)}
    (target / "ImageSets").mkdir(exist_ok=True)
    for name in ("train", "val", "test"):
        rows = [f"{number[key]:06d}\n" for key in dataset.split(name).keys]
        write_text(target / "ImageSets" / f"{name}.txt", "".join(rows))


def _to_cirrus(
    dataset: Dataset, target: Path, boxes: BoxSource, cloud: str | None, overwrite: bool, step: Progress
) -> Outcome:
    writer, journal = CirrusWriter(target), Journal(target, overwrite=overwrite)
    write = partial(_write_cirrus, writer, dataset, _times(dataset), boxes, cloud)
    units = (("/".join(key), dataset.files(index), partial(write, index)) for index, key in enumerate(dataset.keys))
    return _each(units, len(dataset), journal, f"cirrus {boxes} {cloud} {dataset.name}", step)


def _write_cirrus(
    writer: CirrusWriter, dataset: Dataset, times: Sequence[int], boxes: BoxSource, cloud: str | None, index: int
) -> Sequence[Path]:
    frame = _as_cirrus(dataset[index], times[index], cloud)
    return list(writer.write(frame, box_label_source=boxes).values())


def _times(dataset: Dataset) -> list[int]:
    """A time for every frame: its name where that is one, else made up with a pause between sequences."""
    if all(name.isdigit() and 16 <= len(name) <= 19 for name in dataset.frame_ids):
        return [int(name) for name in dataset.frame_ids]
    order = {name: place for place, name in enumerate(dict.fromkeys(dataset.sequences))}
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


def _to_csv(dataset: Dataset, target: Path, boxes: BoxSource, overwrite: bool, step: Progress) -> Outcome:
    write = partial(_write_csv, dataset, boxes)
    if target.suffix == ".csv":  # one file of labels is written in seconds: nothing to resume
        target.parent.mkdir(parents=True, exist_ok=True)
        write(target, range(len(dataset)))
        step(1, 1)
        return Outcome(written=1)
    groups: dict[str, list[int]] = {}
    for index, sequence in enumerate(dataset.sequences):
        groups.setdefault(sequence, []).append(index)
    units = [
        (
            name,
            list(dict.fromkeys(file for index in indices for file in dataset.files(index))),
            partial(write, target / f"{_file_name(name)}.csv", indices),
        )
        for name, indices in groups.items()
    ]
    return _each(units, len(units), Journal(target, overwrite=overwrite), f"boxes-csv {boxes} {dataset.name}", step)


def _write_csv(dataset: Dataset, boxes: BoxSource, path: Path, indices: Sequence[int]) -> Sequence[Path]:
    frames = (dataset.frame(index) for index in indices)
    write_boxes_csv(path, box_rows((frame, _boxes_of(frame, boxes)) for frame in frames))
    return [path]


def _file_name(sequence: str) -> str:
    return "".join(letter if letter.isalnum() or letter in "-_." else "_" for letter in sequence).lstrip(".") or "_"


def box_rows(frames: Iterable[tuple[Frame, Boxes | None]]) -> BoxRows:
    """Join the boxes of frames to the rows of a CSV file; a frame without boxes leaves no row."""
    filled = [(frame, boxes) for frame, boxes in frames if boxes is not None and len(boxes)]
    together = Boxes.concatenate([boxes for _, boxes in filled]) if filled else Boxes.empty()
    counts = [len(boxes) for _, boxes in filled]
    sequences, frame_ids = ([frame.key[place] for frame, _ in filled] for place in (0, 1))
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
    )

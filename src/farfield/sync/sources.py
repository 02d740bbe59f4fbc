"""Where a recording's stamps stand: lists of a known form, KITTI raw's folders, or a data set that we read."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Int64

from farfield.datasets import Dataset, open_dataset
from farfield.errors import DatasetError
from farfield.files.bags import Bag, is_bag
from farfield.files.clock_logs import is_clock_log
from farfield.files.radiate import read_times
from farfield.files.stamps import StampList, Unit, read_stamps, recognise_stamps
from farfield.frame import Drive
from farfield.vocabulary.counts import count_of

Stamp = Literal["header", "log"]
LISTS = (".txt", ".csv")
LOGS = (".txt", ".log")


@dataclass(frozen=True, eq=False, kw_only=True)
class StampSource:
    """One stream's stamps.

    Args:
        blocks: Reads them, block by block.
        labels: The messages' names in their order; None: counted from 0.
        note: How the stamps are read, in words, where that was guessed or is not obvious.
        arrived_ns: When each message was recorded, by the clock of the computer, where both are known, shape (n,).
        sensor: Whose messages these are, where a message has several stamps (start, middle and end of a turn), each a
            stream of its own: a row of one is that row of the others. Empty where a stream stands for itself.
    """

    blocks: Callable[[], Iterator[Int64[np.ndarray, " _"]]]
    labels: Sequence[str] | None = None
    note: str = ""
    arrived_ns: Int64[np.ndarray, " n"] | None = None
    sensor: str = ""


@dataclass(frozen=True, eq=False, kw_only=True)
class RecordedStreams:
    """Streams that ran at the same time.

    Args:
        name: Name of the drive, or of the folder.
        streams: The streams.
        logs: Logs of clocks that were kept by two-way exchanges.
    """

    name: str
    streams: Mapping[str, StampSource]
    logs: tuple[Path, ...] = field(default=())


def recordings(root: Path | str, *, unit: Unit = "auto", stamp: Stamp = "header") -> list[RecordedStreams]:
    """Find the recordings in a folder: KITTI raw's drives, lists of stamps, or the drives of a data set.

    Args:
        root: The folder.
        unit: Unit of numbers that do not say theirs.
        stamp: Which stamps of a bag's messages count: those of their headers, or when they were recorded.

    Raises:
        DatasetError: If there is none, or none whose times are known.
    """
    root = Path(root).expanduser()
    if is_bag(root) or (root.is_dir() and any(map(is_bag, root.iterdir()))):
        return [_of_bag(path, stamp) for path in ([root] if is_bag(root) else sorted(filter(is_bag, root.iterdir())))]
    if not root.is_dir():
        raise DatasetError(
            f"{root}: expected a folder of stamps or a data set's, found {'a file' if root.exists() else 'nothing'}."
        )
    from_folders = _kitti_raw(root, unit) or _lists(root, unit)
    if from_folders:
        return from_folders
    data = open_dataset(root)
    drives = [recording for drive in data.drives() if (recording := _of_drive(data, drive)) is not None]
    if not drives:
        raise DatasetError(
            f"{root}: a data set of the format {data.name}, but nothing in it says when its frames were taken. Give a "
            "folder of lists of stamps, one a stream (see farfield sync --help)."
        )
    return drives


def _kitti_raw(root: Path, unit: Unit) -> list[RecordedStreams]:
    """Drives with ``<stream>/timestamps.txt``; a lidar has the start, the middle and the end of its turns."""
    paths = [path for depth in ("*", "*/*", "*/*/*") for path in root.glob(f"{depth}/timestamps*.txt")]
    drives: dict[Path, dict[str, StampSource]] = {}
    for path in sorted(paths):
        part = path.stem.removeprefix("timestamps").lstrip("_")
        name = path.parent.name + (f"/{part}" if part else "")
        if (stamps := recognise_stamps(path, unit=unit)) is not None:
            drives.setdefault(path.parent.parent, {})[name] = replace(
                _source(stamps, path.parent / "data"), sensor=path.parent.name
            )
    return [
        RecordedStreams(name=folder.resolve().name, streams=streams, logs=_logs(folder))
        for folder, streams in drives.items()
    ]


def _lists(root: Path, unit: Unit) -> list[RecordedStreams]:
    """Lists in the folder itself, or in each of its folders, one a stream; a recording has two or more."""
    for folders in ([root], sorted(path for path in root.iterdir() if path.is_dir())):
        streams_of = [(folder, _lists_in(folder, unit)) for folder in folders]
        several = [(folder, streams) for folder, streams in streams_of if len(streams) > 1]
        if several:
            return [
                RecordedStreams(name=folder.resolve().name, streams=streams, logs=_logs(folder))
                for folder, streams in several
            ]
    return []


def _lists_in(folder: Path, unit: Unit) -> dict[str, StampSource]:
    streams = {}
    for path in sorted(folder.iterdir()):
        if path.suffix in LISTS and path.is_file():
            stamps = recognise_stamps(path, unit=unit)
            if stamps is not None:
                streams[path.stem] = _source(stamps)
    return streams


def _source(stamps: StampList, data: Path | None = None) -> StampSource:
    """A list as a stream; its messages are named as the files in ``data`` where there are as many as stamps."""
    labels: list[str] | None = None
    if stamps.form == "radiate":
        labels = [f"{number:06d}" for number in read_times(stamps.path)]
    elif data is not None and data.is_dir():  # lost messages have a number and no line
        stems = sorted({path.stem for path in data.iterdir() if path.is_file()})
        labels = stems if len(stems) == sum(map(len, read_stamps(stamps))) else None
    note = f"unit taken as {stamps.unit}, by the size of the first number" if stamps.guessed else ""
    note = "local time without a zone, taken as UTC" if stamps.form == "date" and not stamps.zoned else note
    return StampSource(blocks=partial(read_stamps, stamps), labels=labels, note=note)


def _logs(folder: Path) -> tuple[Path, ...]:
    paths = sorted(path for path in folder.iterdir() if path.suffix in LOGS and path.is_file())
    return tuple(path for path in paths if is_clock_log(path))


def _of_bag(path: Path, stamp: Stamp) -> RecordedStreams:
    """Topics whose messages have a stamp of their own; the others by the time of recording, which is said.

    Fixed transforms are no stream: they are said once, for all times.
    """
    bag = Bag(path)
    names = [topic.name for topic in bag.topics if topic.name.strip("/") != "tf_static"]
    stamps = bag.stamps(names) if names else {}
    streams = {}
    for topic, topic_stamps in stamps.items():
        if len(topic_stamps.log_ns):
            times = topic_stamps.log_ns if topic_stamps.header_ns is None or stamp == "log" else topic_stamps.header_ns
            order = np.argsort(times, kind="stable")  # a bag is in the order of recording
            misordered = int((np.diff(times) < 0).sum())
            note = "no stamp of its own: times of recording" if topic_stamps.header_ns is None else ""
            note = (
                f"{count_of(misordered, 'stamp is', 'stamps are')} earlier than the one recorded before; taken in order"
                if misordered
                else note
            )
            streams[topic] = StampSource(
                blocks=partial(iter, [times[order]]),
                labels=[str(row) for row in order] if misordered else None,
                note=note,
                arrived_ns=None if times is topic_stamps.log_ns else topic_stamps.log_ns[order],
            )
    return RecordedStreams(name=path.stem if path.is_file() else path.resolve().name, streams=streams)


def _of_drive(data: Dataset, drive: Drive) -> RecordedStreams | None:
    """Times of a drive's frames and of the sensors that are at hand for each of them."""
    streams: dict[str, StampSource] = {}
    if drive.times_ns is not None:
        labels = [key[1] for key in drive.keys]
        streams["frames"] = StampSource(blocks=partial(iter, [drive.times_ns]), labels=labels)
    times: dict[str, list[int]] = {}
    labels_of: dict[str, list[str]] = {}
    for index, key in zip(drive.indices.tolist(), drive.keys, strict=True):
        for name, sensor in data[index].sensors.items():
            if sensor.time_ns is not None:
                times.setdefault(name, []).append(sensor.time_ns)
                labels_of.setdefault(name, []).append(key[1])
    for name, stamps in times.items():
        blocks = partial(iter, [np.array(stamps, dtype=np.int64)])
        streams[name] = StampSource(blocks=blocks, labels=labels_of[name])
    return RecordedStreams(name=drive.name, streams=streams) if streams else None

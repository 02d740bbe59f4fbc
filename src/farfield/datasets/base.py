"""What every data set offers: frames by index, drives known without reading, maps, selection, splits, a fingerprint."""

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from contextlib import suppress
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from jaxtyping import Float, Int

from farfield.datasets.frame_maps import MAPS, FrameMap, described
from farfield.datasets.splits import SPLIT_FILE, read_parts, split_indices
from farfield.errors import ConfigError, DatasetError, FarfieldError
from farfield.files.atomic import read_bytes
from farfield.files.remote_paths import as_path
from farfield.frame import Annotation, Drive, Frame, Key
from farfield.vocabulary.counts import count_of

if TYPE_CHECKING:
    from farfield.datasets.cloud_reading import CloudReading

Indices = Int[np.ndarray, " _"]
Poses = Float[np.ndarray, "_ 4 4"]


def by_sequence(sequences: Sequence[str]) -> dict[str, Indices]:
    """Indices of the frames of each sequence, in their order.

    >>> by_sequence(("a", "b", "a"))
    {'a': array([0, 2]), 'b': array([1])}
    """
    members: dict[str, list[int]] = {}
    for index, sequence in enumerate(sequences):
        members.setdefault(sequence, []).append(index)
    return {name: np.array(indices, dtype=np.int64) for name, indices in members.items()}


def before_each(drives: Iterable[Indices], count: int) -> Indices:
    """Index of the frame before each of ``count`` frames in its drive, -1 where there is none."""
    before = np.full(count, -1, dtype=np.int64)
    for indices in drives:
        before[indices[1:]] = indices[:-1]
    return before


def all_known(times_ns: Iterable[int | None]) -> Indices | None:
    """Times as an array; None where one is not known."""
    times = list(times_ns)
    return None if None in times else np.array(times, dtype=np.int64)


def all_poses(poses: Iterable[Float[np.ndarray, "4 4"] | None]) -> Poses | None:
    """Poses as an array; None where one is not known."""
    listed = list(poses)
    present = [pose for pose in listed if pose is not None]
    return np.stack(present).astype(np.float64) if present and len(present) == len(listed) else None


def drive_poses(pose_of: Callable[[int], Float[np.ndarray, "4 4"] | None], indices: Indices) -> Poses | None:
    """Poses of a drive's frames, each read from its file; None where one has none.

    None too where a file is damaged, which is said when its frame is read. The first frame's is read alone first.

    Args:
        pose_of: Reads that of one frame.
        indices: The drive's indices, in the order of time.
    """
    with suppress(FarfieldError, OSError):
        if len(indices) and pose_of(int(indices[0])) is not None:
            return all_poses(pose_of(int(index)) for index in indices)
    return None


def selected_rows(indices: Indices, positions: Mapping[int, Sequence[int]]) -> tuple[Indices, Indices]:
    """Rows of a drive that were selected, and their indices in the selection.

    Args:
        indices: The drive's indices in the whole data set.
        positions: Where in the selection an index of the whole data set stands.
    """
    pairs = [(row, position) for row, index in enumerate(indices.tolist()) for position in positions.get(index, ())]
    rows, own = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    return rows, own


def cut_drive(drive: Drive, rows: Indices, indices: Indices) -> Drive:
    """Some rows of a drive, with their indices in another data set."""
    return replace(
        drive,
        indices=indices,
        keys=tuple(drive.keys[row] for row in rows),
        times_ns=None if drive.times_ns is None else drive.times_ns[rows],
        world_T_frame=None if drive.world_T_frame is None else drive.world_T_frame[rows],
    )


def mapped_drive(drive: Drive, function: FrameMap) -> Drive:
    """A drive as a map shows it: its poses where the map brings some, or says what becomes of them."""
    poses_of = getattr(function, "poses_of", None)
    if poses_of is not None:
        return replace(drive, world_T_frame=poses_of(drive.keys))
    if drive.world_T_frame is None:
        return drive
    moved_poses = getattr(function, "moved_poses", None)
    return replace(drive, world_T_frame=None if moved_poses is None else moved_poses(drive.world_T_frame))


class Dataset(ABC):
    """Frames on disk. Indexing builds a :class:`Frame` whose clouds and images load when they are read.

    A reader's frames stand in its drives in the order of time.

    Attributes:
        name: Format, such as ``"cirrus"``.
        root: Folder that was opened.
        sequences: Sequence of every frame.
        frame_ids: Name of every frame within its sequence.
        protocol: The protocol that scores detections in it unless another is named.
        options: Options with which the reader was opened, as JSON takes them.
        references: Sensors in whose coordinates the frames can be seen, the reader's own first; empty where there is no
            choice.
        view_options: Further options of ``open_dataset`` that the format offers, which become maps.
        reading: How all clouds are read alike, where the reader decides that by some of them.
        stored: Whether the frames come from files, so that a fingerprint identifies them and a recipe can be replayed
            on them; False for frames that are in memory.
    """

    name: str
    root: Path
    sequences: tuple[str, ...]
    frame_ids: tuple[str, ...]
    split_file: Path = SPLIT_FILE
    protocol: str = "dds"
    options: Mapping[str, Any] = MappingProxyType({})
    references: tuple[str, ...] = ()
    view_options: tuple[str, ...] = ()
    reading: "CloudReading | None" = None
    stored: bool = True

    @abstractmethod
    def frame(self, index: int) -> Frame:
        """Build frame ``index``, 0 <= index < len(self)."""

    @abstractmethod
    def files(self, index: int) -> Sequence[Path]:
        """List the files that frame ``index`` is read from."""

    def measurement(self, index: int) -> int:
        """Number of what was measured in frame ``index`` among that of its files: views of one measurement share it."""
        return index

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What a reader took for granted or decided from the data: a sentence each, with the flag that overrules it."""
        return ()

    def annotation(self, index: int) -> Annotation | None:
        """What was annotated in frame ``index``, without its clouds; None where nothing was."""
        return self.frame(index).annotation

    def has_annotation(self, index: int) -> bool:
        """Whether frame ``index`` was annotated, without reading the annotation; an empty one was."""
        return self.frame(index).has_annotation

    def __len__(self) -> int:
        return len(self.sequences)

    def __getitem__(self, index: int) -> Frame:
        """Return one frame; negative indices count from the end.

        Raises:
            IndexError: If there is no such frame.
        """
        if not -len(self) <= index < len(self):
            raise IndexError(f"{self.root}: expected a frame index below {len(self)}, got {index}")
        return self.frame(int(index) % len(self))

    def __iter__(self) -> Iterator[Frame]:
        return (self.frame(index) for index in range(len(self)))

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({str(self.root)!r}: {count_of(len(self), 'frame')}, "
            f"{count_of(len(set(self.sequences)), 'sequence')})"
        )

    @property
    def keys(self) -> tuple[Key, ...]:
        """(sequence, frame) of every frame."""
        return tuple(zip(self.sequences, self.frame_ids, strict=True))

    def drives(self) -> tuple[Drive, ...]:
        """The drives, without building a frame; none where the frames are shuffled, as KITTI's object set's are.

        Times are given where they are known without reading every frame's files, poses where all frames of a drive
        have one.
        """
        keys = self.keys
        return tuple(
            Drive(
                name=name,
                indices=indices,
                keys=tuple(keys[index] for index in indices),
                times_ns=self._times_of(indices),
                world_T_frame=self._poses_of(indices),
            )
            for name, indices in self.drive_indices().items()
        )

    def posed_drives(self) -> tuple[Drive, ...]:
        """The drives; where a view of the frames leaves their poses open, these are read from the frames."""
        return tuple(
            drive
            if drive.world_T_frame is not None
            else replace(drive, world_T_frame=drive_poses(lambda index: self[index].world_T_frame, drive.indices))
            for drive in self.drives()
        )

    def drive_indices(self) -> Mapping[str, Indices]:
        """Indices of each drive's frames in the order of time: by sequence, unless a format knows better."""
        return by_sequence(self.sequences)

    def _times_of(self, indices: Indices) -> Indices | None:
        """Time of each of a drive's frames, where that is known cheaply."""
        del indices
        return None

    def _poses_of(self, indices: Indices) -> Poses | None:
        """Pose of each of a drive's frames, (n, 4, 4), read without building them; None where one has none."""
        del indices
        return None

    @cached_property
    def _index_before(self) -> Indices:
        """Index of the frame before each in its drive, -1 where there is none."""
        return before_each(self.drive_indices().values(), len(self))

    def _at(self, index: int, k: int) -> int | None:
        for _ in range(k):
            index = int(self._index_before[index])
            if index < 0:
                return None
        return index

    def before(self, index: int, k: int) -> Frame | None:
        """The k-th frame before frame ``index`` in its drive, k >= 0; None where there is none.

        Of a selection it is that of the whole data set.
        """
        earlier = self._at(index, k)
        return None if earlier is None else self.frame(earlier)

    def files_before(self, index: int, k: int) -> Sequence[Path]:
        """Files of the k-th frame before frame ``index`` in its drive; none where there is no such frame."""
        earlier = self._at(index, k)
        return () if earlier is None else self.files(earlier)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was left out or cannot be used of what the folder holds, one sentence each."""
        return ()

    @property
    def remarks(self) -> tuple[tuple[Literal["warning", "note"], str], ...]:
        """What to tell who opens the data: :attr:`notes` of the reader as warnings, its :attr:`assumptions` as notes.

        Of a damaged file, from which nothing can be assumed, what reads it tells.
        """
        reader = self.unwrapped
        try:
            assumptions = reader.assumptions
        except FarfieldError:
            assumptions = ()
        return (*(("warning", note) for note in reader.notes), *(("note", sentence) for sentence in assumptions))

    @property
    def unwrapped(self) -> "Dataset":
        """The reader under selections and maps."""
        return self

    @property
    def origins(self) -> tuple[int, ...]:
        """Index of every frame in :attr:`unwrapped`."""
        return tuple(range(len(self)))

    @property
    def maps(self) -> tuple[FrameMap, ...]:
        """The maps through which the frames are seen, in the order in which they are applied."""
        return ()

    @property
    def recipe(self) -> Mapping[str, Any]:
        """How the frames come about: ``format``, ``options`` of the reader and ``maps``, as JSON takes them."""
        reader = self.unwrapped
        return {
            "format": reader.name,
            "options": dict(reader.options),
            "maps": [described(function) for function in self.maps],
        }

    def select(self, indices: Sequence[int]) -> "Dataset":
        """Return the data set of some frames, in the order given."""
        return Subset(self, indices)

    def mapped(self, function: FrameMap) -> "Dataset":
        """Return the data set whose frames are seen through a map, such as :class:`~farfield.datasets.maps.Sweeps`."""
        return Mapped(self, function)

    def moved(self, target_T_frame: Float[np.ndarray, "4 4"]) -> "Dataset":
        """Return the data set with every frame (clouds, boxes, poses, cameras) moved rigidly into another frame."""
        return self.mapped(MAPS["move"](target_T_frame))

    def turned(self, yaw_deg: float | int) -> "Dataset":
        """Return the data set with every frame turned counter-clockwise about z, such as 180 to look backwards."""
        return self.mapped(MAPS["move"].turned(yaw_deg))

    def split_units(self) -> tuple[str, ...]:
        """Name what must not be torn apart by a split, one name a frame: its drive, or itself where it is in none."""
        units = list(self.frame_ids)
        for name, indices in self.drive_indices().items():
            for index in indices:
                units[index] = name
        return tuple(units)

    def split(self, name: str, *, by: str = "sequence") -> "Dataset":
        """Return the part ``"train"``, ``"val"`` or ``"test"``, about 70, 15 and 15 per cent of the frames.

        If ``splits/cirrus_v1.json`` stands in the root (``{"train": [sequence, ...], "val": [...], ...}``), it decides.
        Otherwise whole sequences are dealt out in the order of a hash of their names: the same on every machine.

        Args:
            name: The part; ``"time-train"``, ``"time-val"`` and ``"time-test"`` are parts ``by="time"``.
            by: ``"sequence"``, ``"time"`` to cut every sequence in time (neighbouring frames look alike, so scores come
                out too good: only for a single sequence), or ``"benchmark"`` for the parts that the format's authors
                published, where those tear sequences apart.

        Raises:
            ConfigError: If there is no such part.
            DatasetError: If there are fewer than three sequences to deal out, or no drives to cut in time.
        """
        return self.select(split_indices(self, name, by=by))

    def split_parts(self) -> dict[str, list[str]]:
        """The units of each part as a file of the data set gives them; empty where none does."""
        return read_parts(self.root / self.split_file, self.split_units())

    def benchmark_keys(self, name: str) -> Set[Key]:
        """(sequence, frame) of a part that the format's authors published.

        Raises:
            ConfigError: If there is no such part.
        """
        raise ConfigError(f"{self.root}: {self.name} has no parts {name!r} beside those of split(name).")

    def fingerprint(self, *, options: bool = True) -> str:
        """SHA-256 over the frames' names, their files' names and sizes, and the reader's options and the maps if any.

        Contents of the frames' files do not count; of an option that names a file its bytes do, not its place. Empty
        for frames in memory.

        Args:
            options: Whether the reader's options count; without them the same files have the same fingerprint.

        Raises:
            DatasetError: If a file of a frame is not there.
        """
        if not self.stored:
            return ""
        digest = hashlib.sha256()
        for index, key in enumerate(self.keys):
            digest.update("\0".join(key).encode())
            for path in self.files(index):
                digest.update(f"\0{path.name}\0{_size_of(path, key)}\n".encode(errors="surrogateescape"))
        if options and (chosen := _identified(self.unwrapped.options)):
            digest.update(b"options " + json.dumps(chosen, sort_keys=True).encode())
        if self.maps:
            digest.update(json.dumps([described(function) for function in self.maps], sort_keys=True).encode())
        return digest.hexdigest()


def _size_of(path: Path, key: Key) -> int:
    try:
        return path.stat().st_size
    except OSError as error:
        raise DatasetError(
            f"{path}: expected a file of frame {key}, got: {error.strerror}. Add it, or name the sequences whose files "
            f"are there in {SPLIT_FILE}"
        ) from error


_UNSET_OPTIONS: tuple[Any, ...] = (None, "", "auto", [], {})
_LONGEST_PATH = 256


def _identified(option: Any) -> Any:
    """Options without what is not set: of files the digests of their bytes, of folders, whose files count, nothing."""
    if isinstance(option, Mapping):
        entries = ((str(name), _identified(value)) for name, value in option.items())
        return {name: value for name, value in entries if value not in _UNSET_OPTIONS}
    if isinstance(option, list | tuple):
        return [value for value in map(_identified, option) if value not in _UNSET_OPTIONS]
    if isinstance(option, str) and len(option) < _LONGEST_PATH and ("/" in option or as_path(option).suffix):
        path = as_path(option)  # a word, such as of axes, names no file that happens to be called so
        if path.exists():
            return hashlib.sha256(read_bytes(path)).hexdigest() if path.is_file() else None
    return option


class Subset(Dataset):
    """Some frames of another data set, in a chosen order."""

    def __init__(self, parent: Dataset, indices: Sequence[int]) -> None:
        wrong = [index for index in indices if not -len(parent) <= index < len(parent)]
        if wrong:
            raise IndexError(f"{parent.root}: expected frame indices below {len(parent)}, got {wrong[0]}")
        self.parent, self.indices = parent, tuple(int(index) % len(parent) for index in indices)
        self.name, self.root, self.protocol = parent.name, parent.root, parent.protocol
        self.split_file, self.stored = parent.split_file, parent.stored
        self.options, self.references, self.view_options = dict(parent.options), parent.references, parent.view_options
        self.sequences = tuple(parent.sequences[index] for index in self.indices)
        self.frame_ids = tuple(parent.frame_ids[index] for index in self.indices)

    def frame(self, index: int) -> Frame:
        """Build frame ``index`` of the selection."""
        return self.parent.frame(self.indices[index])

    def files(self, index: int) -> Sequence[Path]:
        """List the files that frame ``index`` of the selection is read from."""
        return self.parent.files(self.indices[index])

    def measurement(self, index: int) -> int:
        """Number of what was measured in frame ``index`` of the selection."""
        return self.parent.measurement(self.indices[index])

    def annotation(self, index: int) -> Annotation | None:
        """What was annotated in frame ``index`` of the selection."""
        return self.parent.annotation(self.indices[index])

    def has_annotation(self, index: int) -> bool:
        """Whether frame ``index`` of the selection was annotated."""
        return self.parent.has_annotation(self.indices[index])

    def drives(self) -> tuple[Drive, ...]:
        """The drives' frames that were selected, in the order of time."""
        positions = self._positions()
        selected = ((drive, selected_rows(drive.indices, positions)) for drive in self.parent.drives())
        return tuple(cut_drive(drive, rows, own) for drive, (rows, own) in selected if len(rows))

    def drive_indices(self) -> Mapping[str, Indices]:
        """Indices of each drive's selected frames in the order of time."""
        positions = self._positions()
        own = {name: selected_rows(indices, positions)[1] for name, indices in self.parent.drive_indices().items()}
        return {name: indices for name, indices in own.items() if len(indices)}

    def _positions(self) -> dict[int, list[int]]:
        """Where each of the parent's indices stands in the selection."""
        positions: dict[int, list[int]] = {}
        for position, index in enumerate(self.indices):
            positions.setdefault(index, []).append(position)
        return positions

    def before(self, index: int, k: int) -> Frame | None:
        """The k-th frame before frame ``index`` in its drive of the whole data set."""
        return self.parent.before(self.indices[index], k)

    def files_before(self, index: int, k: int) -> Sequence[Path]:
        """Files of the k-th frame before frame ``index`` in its drive of the whole data set."""
        return self.parent.files_before(self.indices[index], k)

    @property
    def unwrapped(self) -> Dataset:
        """The reader under selections and maps."""
        return self.parent.unwrapped

    @property
    def origins(self) -> tuple[int, ...]:
        """Index of every frame in :attr:`unwrapped`."""
        below = self.parent.origins
        return tuple(below[index] for index in self.indices)

    @property
    def maps(self) -> tuple[FrameMap, ...]:
        """The maps through which the frames are seen."""
        return self.parent.maps

    def split_units(self) -> tuple[str, ...]:
        """Name what must not be torn apart, one name a frame."""
        units = self.parent.split_units()
        return tuple(units[index] for index in self.indices)

    def split_parts(self) -> dict[str, list[str]]:
        """The units of each part as a file of the whole data set gives them."""
        return self.parent.split_parts()

    def benchmark_keys(self, name: str) -> Set[Key]:
        """(sequence, frame) of a part that the format's authors published."""
        return self.parent.benchmark_keys(name)


class Mapped(Subset):
    """Another data set whose frames are seen through a map."""

    def __init__(self, parent: Dataset, function: FrameMap) -> None:
        super().__init__(parent, range(len(parent)))
        self.function = function

    def frame(self, index: int) -> Frame:
        """Build frame ``index``, seen through the map."""
        return self.function(self.parent.frame(index), partial(self.parent.before, index))

    def annotation(self, index: int) -> Annotation | None:
        """What was annotated in frame ``index``, seen through the map."""
        if getattr(self.function, "keeps_annotation", False):
            return self.parent.annotation(index)
        annotated = getattr(self.function, "annotated", None)
        if annotated is not None:
            annotation = self.parent.annotation(index)
            return None if annotation is None else annotated(annotation)
        return self.frame(index).annotation

    def has_annotation(self, index: int) -> bool:
        """Whether frame ``index``, seen through the map, was annotated."""
        if getattr(self.function, "keeps_annotation", False) or hasattr(self.function, "annotated"):
            return self.parent.has_annotation(index)
        return self.frame(index).has_annotation

    def drives(self) -> tuple[Drive, ...]:
        """The drives; their poses where the map says what becomes of them."""
        return tuple(mapped_drive(drive, self.function) for drive in self.parent.drives())

    def before(self, index: int, k: int) -> Frame | None:
        """The k-th frame before frame ``index``, seen through the map as well."""
        frame = self.parent.before(index, k)
        return None if frame is None else self.function(frame, partial(_further, self.parent, index, k))

    def files(self, index: int) -> Sequence[Path]:
        """List the files that frame ``index`` is read from, its own first."""
        return self.files_before(index, 0)

    def files_before(self, index: int, k: int) -> Sequence[Path]:
        """Files of the k-th frame before, with those that the map reads besides."""
        count = int(getattr(self.function, "frames_before", 0))
        own = self.parent.files(index) if k == 0 else self.parent.files_before(index, k)
        further = (path for step in range(1, count + 1) for path in self.parent.files_before(index, k + step))
        return list(dict.fromkeys((*own, *further))) if own else []

    @property
    def maps(self) -> tuple[FrameMap, ...]:
        """The maps through which the frames are seen, this one last."""
        return (*self.parent.maps, self.function)


def _further(parent: Dataset, index: int, k: int, step: int) -> Frame | None:
    return parent.before(index, k + step)

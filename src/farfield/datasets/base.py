"""What every data set offers: frames by index, sequences known without reading, selection, splits, a fingerprint."""

import copy
import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from farfield.errors import ConfigError, DatasetError
from farfield.frame import Frame, moved
from farfield.geometry.poses import pose_from_yaw

SPLIT_SHARES = {"train": 0.70, "val": 0.15, "test": 0.15}
SPLIT_FILE = Path("splits") / "cirrus_v1.json"


class Dataset(ABC):
    """Frames on disk. Indexing builds a :class:`Frame` whose clouds and images load when they are read.

    Attributes:
        name: Format, such as ``"cirrus"``.
        root: Folder that was opened.
        sequences: Sequence of every frame.
        frame_ids: Name of every frame within its sequence.
    """

    name: str
    root: Path
    sequences: tuple[str, ...]
    frame_ids: tuple[str, ...]
    split_file: Path = SPLIT_FILE

    @abstractmethod
    def frame(self, index: int) -> Frame:
        """Build frame ``index``, 0 <= index < len(self)."""

    @abstractmethod
    def files(self, index: int) -> Sequence[Path]:
        """List the files that frame ``index`` is read from."""

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
        return f"{type(self).__name__}({str(self.root)!r}: {len(self)} frames, {len(set(self.sequences))} sequences)"

    @property
    def keys(self) -> tuple[tuple[str, str], ...]:
        """(sequence, frame) of every frame."""
        return tuple(zip(self.sequences, self.frame_ids, strict=True))

    def select(self, indices: Sequence[int]) -> "Dataset":
        """Return the data set of some frames, in the order given."""
        return Subset(self, indices)

    def moved(self, target_T_lidar: Float[np.ndarray, "4 4"]) -> "Dataset":
        """Return the data set with every frame (clouds, boxes, poses, cameras) moved rigidly into another frame."""
        return Moved(self, target_T_lidar)

    def turned(self, yaw_deg: float | int) -> "Dataset":
        """Return the data set with every frame turned counter-clockwise about z, such as 180 to look backwards."""
        return self.moved(pose_from_yaw(float(np.deg2rad(yaw_deg))))

    def viewed(self, options: Mapping[str, Any]) -> "Dataset":
        """Return the data set seen as a reader with these options sees it, such as K-Radar's in the radar's frame.

        Args:
            options: Options of a reader; those that do not decide how frames look are passed over, all of them by a
                format that has no such options.
        """
        del options
        return self

    def split_units(self) -> tuple[str, ...]:
        """Name what must not be torn apart by a split, one name a frame: its sequence, unless a format knows better."""
        return self.sequences

    def split(self, name: str, *, by: str = "sequence") -> "Dataset":
        """Return the part ``"train"``, ``"val"`` or ``"test"``, about 70, 15 and 15 per cent of the frames.

        If ``splits/cirrus_v1.json`` stands in the root (``{"train": [sequence, ...], "val": [...], ...}``), it decides.
        Otherwise whole sequences are dealt out in the order of a hash of their names: the same on every machine.

        Args:
            name: The part.
            by: ``"sequence"``, or ``"time"`` to cut every sequence in time (neighbouring frames look alike, so scores
                come out too good: only for a single sequence).

        Raises:
            ConfigError: If there is no such part.
            DatasetError: If there are fewer than three sequences to deal out.
        """
        if by == "time":
            return self.select(_cut_in_time(self.sequences, name))
        if by != "sequence":
            raise ConfigError(f"split: expected by to be one of 'sequence', 'time', got {by!r}")
        parts = self._split_from_file() or deal_out(self.split_units(), root=self.root)
        if name not in parts:
            raise ConfigError(f"{self.root}: expected a split, one of {', '.join(parts)}; got {name!r}")
        chosen = set(parts[name])
        return self.select([index for index, unit in enumerate(self.split_units()) if unit in chosen])

    def _split_from_file(self) -> dict[str, list[str]]:
        path = self.root / self.split_file
        if not path.is_file():
            return {}
        try:
            parts = json.loads(path.read_text("utf-8"))
        except (ValueError, UnicodeDecodeError) as error:
            raise DatasetError(f"{path}: expected JSON such as {{'train': ['segment_00']}}, found: {error}") from error
        if not isinstance(parts, dict) or not all(isinstance(names, list) for names in parts.values()):
            raise DatasetError(f"{path}: expected an object of lists of sequence names, such as {{'train': [...]}}")
        missing = sorted({str(unit) for names in parts.values() for unit in names} - set(self.split_units()))
        if missing:
            raise DatasetError(f"{path}: names sequences that the data set lacks: {', '.join(missing[:5])}")
        return parts

    def fingerprint(self) -> str:
        """SHA-256 over the frames' names and their files' names and sizes (not their contents)."""
        digest = hashlib.sha256()
        for index, key in enumerate(self.keys):
            digest.update("\0".join(key).encode())
            for path in self.files(index):
                digest.update(f"\0{path.name}\0{path.stat().st_size}\n".encode())
        return digest.hexdigest()


class Subset(Dataset):
    """Some frames of another data set, in a chosen order."""

    def __init__(self, parent: Dataset, indices: Sequence[int]) -> None:
        wrong = [index for index in indices if not -len(parent) <= index < len(parent)]
        if wrong:
            raise IndexError(f"{parent.root}: expected frame indices below {len(parent)}, got {wrong[0]}")
        self.parent, self.indices = parent, tuple(int(index) % len(parent) for index in indices)
        self.name, self.root, self.split_file = parent.name, parent.root, parent.split_file
        self.sequences = tuple(parent.sequences[index] for index in self.indices)
        self.frame_ids = tuple(parent.frame_ids[index] for index in self.indices)

    def frame(self, index: int) -> Frame:
        """Build frame ``index`` of the selection."""
        return self.parent.frame(self.indices[index])

    def files(self, index: int) -> Sequence[Path]:
        """List the files that frame ``index`` of the selection is read from."""
        return self.parent.files(self.indices[index])

    def viewed(self, options: Mapping[str, Any]) -> "Dataset":
        """The same frames of the parent seen with these options."""
        parent = self.parent.viewed(options)
        if parent is self.parent:
            return self
        other = copy.copy(self)
        other.parent = parent
        return other

    def split_units(self) -> tuple[str, ...]:
        """Name what must not be torn apart, one name a frame."""
        units = self.parent.split_units()
        return tuple(units[index] for index in self.indices)

    def _split_from_file(self) -> dict[str, list[str]]:
        return self.parent._split_from_file()


class Moved(Subset):
    """Another data set whose frames are moved rigidly."""

    def __init__(self, parent: Dataset, target_T_lidar: Float[np.ndarray, "4 4"]) -> None:
        super().__init__(parent, range(len(parent)))
        self.target_T_lidar = np.asarray(target_T_lidar, dtype=np.float64)

    def frame(self, index: int) -> Frame:
        """Build frame ``index``, moved."""
        return moved(super().frame(index), self.target_T_lidar)

    def fingerprint(self) -> str:
        """SHA-256 of the parent's fingerprint and the motion."""
        return hashlib.sha256(self.parent.fingerprint().encode() + self.target_T_lidar.tobytes()).hexdigest()


def deal_out(units: Sequence[str], *, root: Path) -> dict[str, list[str]]:
    """Deal whole units out to train, val and test by the hash of their names, near the shares asked for.

    Args:
        units: Unit of every frame.
        root: Named in the error.

    Raises:
        DatasetError: If there are fewer than three units.
    """
    names, counts = np.unique(np.asarray(units, dtype=np.str_), return_counts=True)
    if len(names) < 3:
        raise DatasetError(
            f"{root}: a split keeps sequences whole and needs at least 3, found {len(names)}. Give the parts in "
            f"{SPLIT_FILE}, take frames with select(), or cut in time with split(name, by='time')."
        )
    order = sorted(range(len(names)), key=lambda i: hashlib.sha256(str(names[i]).encode()).digest())
    parts: dict[str, list[str]] = {"train": [], "val": [], "test": []}
    for part in ("val", "test"):
        taken, aim = 0, SPLIT_SHARES[part] * counts.sum()
        left_for_others = 1 if part == "test" else 2
        while len(order) > left_for_others and (not parts[part] or taken + counts[order[0]] / 2 < aim):
            taken += counts[order[0]]
            parts[part].append(str(names[order.pop(0)]))
    parts["train"] = [str(names[i]) for i in order]
    return parts


def _cut_in_time(sequences: Sequence[str], name: str) -> list[int]:
    if name not in SPLIT_SHARES:
        raise ConfigError(f"split: expected one of {', '.join(SPLIT_SHARES)}, got {name!r}")
    before = sum(list(SPLIT_SHARES.values())[: list(SPLIT_SHARES).index(name)])
    chosen: list[int] = []
    for sequence in dict.fromkeys(sequences):
        members = [index for index, other in enumerate(sequences) if other == sequence]
        first, last = (round(len(members) * share) for share in (before, before + SPLIT_SHARES[name]))
        chosen += members[first:last]
    return chosen

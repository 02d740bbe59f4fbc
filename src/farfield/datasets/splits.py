"""Assign frames to train, val and test, whole units together: from a file, by a hash of their names, or cut in time."""

import hashlib
from collections.abc import Iterable, Mapping, Sequence, Set
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Int

from farfield.errors import ConfigError, DatasetError, did_you_mean, plain
from farfield.files.atomic import read_bytes
from farfield.files.json_text import plain_json
from farfield.files.stand_ins import check_itself
from farfield.frame import Key

SPLIT_SHARES = {"train": 0.70, "val": 0.15, "test": 0.15}
SPLIT_FILE = Path("splits") / "cirrus_v1.json"


@runtime_checkable
class Splittable(Protocol):
    """What a split needs to know of a data set."""

    @property
    def root(self) -> Path:
        """Its folder."""

    @property
    def keys(self) -> tuple[Key, ...]:
        """(sequence, frame) of every frame."""

    def drive_indices(self) -> Mapping[str, Int[np.ndarray, " _"]]:
        """Indices of each drive's frames in the order of time."""

    def split_units(self) -> tuple[str, ...]:
        """What must not be torn apart, one name a frame."""

    def split_parts(self) -> dict[str, list[str]]:
        """The units of each part as a file gives them."""

    def benchmark_keys(self, name: str) -> Set[Key]:
        """The frames of a published part."""


def split_indices(data: Splittable, name: str, *, by: str = "sequence") -> list[int]:
    """Indices of the frames of a part; see :meth:`farfield.datasets.base.Dataset.split`.

    Args:
        data: The data set.
        name: The part: ``"train"``, ``"val"``, ``"test"``, or, cut in time, ``"time-train"``...
        by: ``"sequence"``, ``"time"`` or ``"benchmark"``.

    Raises:
        ConfigError: If there is no such part.
        DatasetError: If there are fewer than three units to assign, or no drives to cut in time.
    """
    if name.startswith("time-") and by == "sequence":  # as one word, for files and flags
        name, by = name.removeprefix("time-"), "time"
    if by == "time":
        drives = data.drive_indices()
        if not drives and len(data.keys):
            raise DatasetError(f"{data.root}: cannot be cut in time, its frames are shuffled. Split by 'sequence'.")
        return cut_in_time(drives.values(), name)
    if by == "benchmark":
        members = data.benchmark_keys(name)
        return [index for index, key in enumerate(data.keys) if key in members]
    if by != "sequence":
        raise ConfigError(f"split: expected by to be one of 'sequence', 'time', 'benchmark', got {by!r}")
    units = data.split_units()
    parts = data.split_parts() or assign_splits(units, root=data.root)
    if name not in parts:
        raise ConfigError(
            f"{data.root}: expected a split, one of {', '.join(parts)}; got {name!r}.{did_you_mean(name, parts)}"
        )
    chosen = set(parts[name])
    return [index for index, unit in enumerate(units) if unit in chosen]


def assign_splits(units: Sequence[str], *, root: Path) -> dict[str, list[str]]:
    """Assign whole units to train, val and test by the hash of their names, near the shares 70, 15 and 15 %.

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
            f"{SPLIT_FILE}, take frames with select(), or cut each sequence in time: split(name, by='time') "
            "in Python, split: time-train (time-val, time-test) in an experiment, --split time-val on the command line."
        )
    order = sorted(range(len(names)), key=lambda i: hashlib.sha256(str(names[i]).encode()).digest())
    parts: dict[str, list[str]] = {"train": [], "val": [], "test": []}
    for part in ("val", "test"):
        frames = 0
        target = SPLIT_SHARES[part] * counts.sum()
        left_for_others = 1 if part == "test" else 2
        while len(order) > left_for_others and (not parts[part] or frames + counts[order[0]] / 2 < target):
            frames += counts[order[0]]
            parts[part].append(str(names[order.pop(0)]))
    parts["train"] = [str(names[i]) for i in order]
    return parts


def cut_in_time(drives: Iterable[Int[np.ndarray, " n"]], name: str) -> list[int]:
    """Indices of one part where every drive is cut in time.

    Args:
        drives: The indices of each drive's frames in the order of time.
        name: The part.

    Raises:
        ConfigError: If there is no such part.
    """
    if name not in SPLIT_SHARES:
        raise ConfigError(f"split: expected one of {', '.join(SPLIT_SHARES)}, got {name!r}")
    before = sum(list(SPLIT_SHARES.values())[: list(SPLIT_SHARES).index(name)])
    chosen: list[int] = []
    for members in drives:
        first, last = (round(len(members) * share) for share in (before, before + SPLIT_SHARES[name]))
        chosen += members[first:last].tolist()
    return chosen


def read_parts(path: Path, units: Iterable[str]) -> dict[str, list[str]]:
    """Read a split file, ``{"train": [unit, ...], "val": [...], ...}``; empty where there is none.

    Args:
        path: The file.
        units: Units that the data set has.

    Raises:
        DatasetError: If it is another file, or names units that the data set lacks.
    """
    if not path.is_file():
        return {}
    check_itself(path)
    try:
        parts = plain_json(read_bytes(path, max_bytes=1 << 26))
    except ValueError as error:
        raise DatasetError(
            f"{path}: expected JSON such as {{'train': ['segment_00']}}, found: {plain(error)}"
        ) from error
    if not isinstance(parts, dict) or not all(isinstance(names, list) for names in parts.values()):
        raise DatasetError(f"{path}: expected an object of lists of sequence names, such as {{'train': [...]}}")
    odd = [unit for names in parts.values() for unit in names if not isinstance(unit, str)]
    if odd:
        raise DatasetError(f"{path}: expected names of sequences as texts, got {odd[0]!r}"[:200])
    part_of: dict[str, str] = {}
    for part in SPLIT_SHARES:
        for unit in parts.get(part, []):
            if part_of.setdefault(unit, part) != part:
                raise DatasetError(
                    f"{path}: expected each sequence in one of {', '.join(SPLIT_SHARES)}, got {unit!r} in "
                    f"{part_of[unit]} and in {part}: what is learnt from would be scored"
                )
    missing = sorted({str(unit) for names in parts.values() for unit in names} - set(units))
    if missing:
        raise DatasetError(f"{path}: names sequences that the data set lacks: {', '.join(missing[:5])}")
    return parts

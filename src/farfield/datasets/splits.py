"""Deal frames out to train, val and test, whole units together."""

import hashlib
import json
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Int

from farfield.errors import ConfigError, DatasetError, plain

SPLIT_SHARES = {"train": 0.70, "val": 0.15, "test": 0.15}
SPLIT_FILE = Path("splits") / "cirrus_v1.json"


def assign_splits(units: Sequence[str], *, root: Path) -> dict[str, list[str]]:
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
            f"{SPLIT_FILE}, take frames with select(), or cut each sequence in time: split(name, by='time') "
            "in Python, split: time-train (time-val, time-test) in an experiment, --split time-val on the command line."
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
    try:
        parts = json.loads(path.read_text("utf-8"))
    except (ValueError, UnicodeDecodeError) as error:
        raise DatasetError(
            f"{path}: expected JSON such as {{'train': ['segment_00']}}, found: {plain(error)}"
        ) from error
    if not isinstance(parts, dict) or not all(isinstance(names, list) for names in parts.values()):
        raise DatasetError(f"{path}: expected an object of lists of sequence names, such as {{'train': [...]}}")
    missing = sorted({str(unit) for names in parts.values() for unit in names} - set(units))
    if missing:
        raise DatasetError(f"{path}: names sequences that the data set lacks: {', '.join(missing[:5])}")
    return parts

"""How many numbers a point has in a ``.bin`` file, which says nothing of it: decided from the numbers themselves.

Read with the right number, each column holds one kind of quantity; read with another, every column is a mixture of
several. So the mutual information between a value and the column that it falls into is largest at the right number, in
whatever order the points stand, and at its multiples: of those the smallest is taken whose repeated columns are alike.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32, Shaped

from farfield.errors import FileFormatError
from farfield.files.atomic import MAX_BYTES, read_bytes

POSSIBLE = (3, 4, 5, 6, 7, 8, 9, 10)
"""Numbers a point that are told apart."""

_BLOCK = 2520  # a multiple of all that are possible
_MOST_BLOCKS = 32
_LEAST_VALUES = 600
_BINS = 48
_FARTHEST_M = 1e4
_ALIKE = 0.1  # mean Kolmogorov distance of columns that hold the same quantity
_CLEAR = 0.05  # nats: what the best has to have, and to be ahead of one that is no divisor of it
_MOST_RINGS = 512


@dataclass(frozen=True)
class BinColumns:
    """What the columns of a ``.bin`` file are.

    Args:
        count: Numbers a point.
        names: A name a column: x, y, z, intensity, then what is recognised (``ring``, ``range_m``), else ``extra0``...
        likely: Whether the numbers themselves say so; else it is the format's usual count.
    """

    count: int
    names: tuple[str, ...]
    likely: bool

    def __str__(self) -> str:
        why = "by the numbers themselves" if self.likely else "too few numbers to tell: KITTI's layout is taken"
        return f"{self.count} columns a point ({', '.join(self.names)}), {why}"


def bin_columns(path: Path | str, *, max_bytes: int = MAX_BYTES) -> BinColumns:
    """Decide how many float32 a point has.

    Args:
        path: The file: rows of little-endian float32 without a header.
        max_bytes: Largest file that is accepted.

    Raises:
        FileFormatError: If no number of columns fits, or several fit alike.
    """
    data = read_bytes(path, max_bytes=max_bytes)
    values = np.frombuffer(data[: len(data) // 4 * 4], dtype="<f4")
    fitting = [count for count in POSSIBLE if len(data) % (4 * count) == 0 and len(data)]
    if not fitting:
        raise FileFormatError(
            path,
            where="the file's size",
            expected=f"a whole number of points of {POSSIBLE[0]} to {POSSIBLE[-1]} float32",
            found=f"{len(data)} bytes",
            mend="The file is truncated, or no table of float32.",
        )
    if len(values) < _LEAST_VALUES:
        return _usual(path, fitting, values)
    told = {count: _told(values, count) for count in fitting}
    best = max(told, key=lambda count: told[count])
    chosen = min(count for count in fitting if best % count == 0 and _repeats(values, count, best) < _ALIKE)
    rivals = [count for count in fitting if count % chosen and told[count] > told[chosen] - _CLEAR]
    if told[chosen] < _CLEAR or rivals:
        raise _doubt(path, [chosen, *rivals])
    rows = values.reshape(-1, chosen)
    if not _places(rows):
        raise _doubt(path, fitting)
    return BinColumns(chosen, names_of(rows), likely=True)


def _usual(path: Path | str, fitting: list[int], values: Float32[np.ndarray, " n"]) -> BinColumns:
    """Few numbers tell nothing: KITTI's four, where they fit and are places and a strength."""
    if 4 in fitting:
        rows = values.reshape(-1, 4)
        if _places(rows) and (rows[:, 3] >= 0).all():
            return BinColumns(4, names_of(rows), likely=False)
    raise _doubt(path, fitting)


def _doubt(path: Path | str, counts: list[int]) -> FileFormatError:
    return FileFormatError(
        path,
        where="the columns",
        expected="numbers that show how many a point has",
        found=f"what may be {' or '.join(str(count) for count in sorted(counts))} a point",
        mend="Say how many with --columns, in Python bin_columns=; or the file is truncated, or no table of float32.",
    )


def _told(values: Float32[np.ndarray, " n"], count: int) -> float:
    """Mutual information of value and column in nats, less what chance alone gives."""
    used = _spread(values[: len(values) // count * count]).astype(np.float64)
    edges = np.unique(np.quantile(used[np.isfinite(used)], np.linspace(0, 1, _BINS + 1)[1:-1]))
    places = np.searchsorted(edges, used, side="right")
    places[~np.isfinite(used)] = len(edges) + 1
    cells = np.tile(np.arange(count), len(used) // count) + count * places
    joint = np.bincount(cells, minlength=count * (len(edges) + 2)).reshape(-1, count) / len(used)
    independent = joint.sum(axis=1, keepdims=True) * joint.sum(axis=0)
    filled = joint > 0
    chance = (np.count_nonzero(joint.sum(axis=1)) - 1) * (count - 1) / (2 * len(used))
    return float((joint[filled] * np.log(joint[filled] / independent[filled])).sum()) - chance


def _repeats(values: Float32[np.ndarray, " n"], count: int, multiple: int) -> float:
    """How far the columns that a number of columns puts together differ: mean Kolmogorov distance, 0 to 1."""
    if count == multiple:
        return 0.0
    used = _spread(values[: len(values) // multiple * multiple]).reshape(-1, multiple // count, count)
    used = np.sort(np.where(np.isfinite(used), used, 0.0), axis=0)
    apart = [
        float(np.abs(_share(used[:, later, column], used[:, 0, column]) - _share(*[used[:, 0, column]] * 2)).max())
        for later in range(1, multiple // count)
        for column in range(count)
    ]
    return float(np.mean(apart))


def _share(ordered: Float32[np.ndarray, " n"], limits: Float32[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """Share of ordered values up to each limit."""
    return np.searchsorted(ordered, limits, side="right") / len(ordered)


def _spread(values: Float32[np.ndarray, " n"]) -> Float32[np.ndarray, " m"]:
    """Blocks of whole points from the whole file, at most some 80,000 numbers."""
    blocks = len(values) // _BLOCK
    if blocks <= _MOST_BLOCKS:
        return values
    chosen = np.linspace(0, blocks - 1, _MOST_BLOCKS).astype(np.int64)
    return values[: blocks * _BLOCK].reshape(blocks, _BLOCK)[chosen].reshape(-1)


def _places(rows: Float32[np.ndarray, "n c"]) -> bool:
    """Whether the first three columns can be places in metres: nearly all finite, and none beyond 10 km."""
    with np.errstate(invalid="ignore", over="ignore"):
        finite = np.isfinite(rows[:, :3]).all(axis=1)
        near = np.abs(rows[finite, :3]).max(initial=0.0) < _FARTHEST_M
    return bool(finite.any() and near)


def names_of(rows: Shaped[np.ndarray, "n c"]) -> tuple[str, ...]:
    """Names by what the columns hold, the first three being x, y and z.

    The fourth is ``intensity`` unless some of it is negative (``signal``); one that is equal to sqrt(x^2 + y^2 + z^2)
    is ``range_m``, and small whole numbers are a ``ring``; others are ``extra0``, ``extra1``... from the fifth on.
    """
    names = ["x", "y", "z", "intensity" if rows[:, 3:4].min(initial=0.0) >= 0 else "signal"][: rows.shape[1]]
    ranges = np.linalg.norm(rows[:, :3].astype(np.float64), axis=1)
    for number in range(4, rows.shape[1]):
        column = rows[:, number].astype(np.float64)
        if "range_m" not in names and _is_range(column, ranges):
            names.append("range_m")
        elif "ring" not in names and _is_ring(column):
            names.append("ring")
        else:
            names.append(f"extra{number - 4}")
    return tuple(names)


def _is_range(column: Float[np.ndarray, " n"], ranges: Float[np.ndarray, " n"]) -> bool:
    known = np.isfinite(column) & np.isfinite(ranges)
    return bool(known.any() and np.median(np.abs(column - ranges)[known]) < 1e-2 and ranges[known].max() > 1)


def _is_ring(column: Float[np.ndarray, " n"]) -> bool:
    whole = np.isfinite(column).all() and bool((column == np.rint(column)).all())
    return bool(
        whole and column.min() >= 0 and 2 < len(np.unique(column)) <= _MOST_RINGS and column.max() < _MOST_RINGS
    )

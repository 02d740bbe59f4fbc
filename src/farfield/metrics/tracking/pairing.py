"""One-to-one pairs of rows and columns, of many groups at once."""

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment


def best_pairs(
    row: Int[np.ndarray, " p"],
    column: Int[np.ndarray, " p"],
    gain: Float[np.ndarray, " p"],
    group: Int[np.ndarray, " p"],
) -> Int[np.ndarray, " k"]:
    """Choose pairs, no row and no column twice, whose gains have the largest sum.

    Rows and columns without rivals are paired at once, the others by the Hungarian method, group by group.

    Args:
        row: Row of each possible pair; a number stands for one row of all groups.
        column: Column of each, likewise.
        gain: What a pair adds to the sum, above 0; a pair that is not listed adds 0.
        group: Group of each pair, such as its frame, rising.

    Returns:
        Places of the chosen pairs, rising.
    """
    if not len(row):
        return np.zeros(0, dtype=np.int64)
    alone = (np.bincount(row)[row] == 1) & (np.bincount(column)[column] == 1)
    chosen = [np.flatnonzero(alone)]
    rest = np.flatnonzero(~alone)
    if len(rest):
        cuts = np.flatnonzero(np.diff(group[rest])) + 1
        chosen += [_hungarian(row, column, gain, part) for part in np.split(rest, cuts)]
    return np.sort(np.concatenate(chosen))


def _hungarian(
    row: Int[np.ndarray, " p"],
    column: Int[np.ndarray, " p"],
    gain: Float[np.ndarray, " p"],
    part: Int[np.ndarray, " q"],
) -> Int[np.ndarray, " k"]:
    """The best of the pairs that stand at some places."""
    low_row, low_column = row[part].min(), column[part].min()
    shape = (int(row[part].max() - low_row) + 1, int(column[part].max() - low_column) + 1)
    place = np.full(shape, -1)
    place[row[part] - low_row, column[part] - low_column] = part
    worth = np.where(place >= 0, gain[place], 0.0)
    chosen = place[linear_sum_assignment(worth, maximize=True)]
    return chosen[chosen >= 0]


def greedy_pairs(
    row: Int[np.ndarray, " p"], column: Int[np.ndarray, " p"], order: Int[np.ndarray, " p"]
) -> Int[np.ndarray, " k"]:
    """Choose pairs one after the other, each whose row and column are still free.

    Args:
        row: Row of each possible pair.
        column: Column of each.
        order: Places of the pairs in the order in which they may choose.

    Returns:
        Places of the chosen pairs, rising.
    """
    rows: set[int] = set()
    columns: set[int] = set()
    chosen = []
    for place, a, b in zip(order.tolist(), row[order].tolist(), column[order].tolist(), strict=True):
        if a not in rows and b not in columns:
            rows.add(a)
            columns.add(b)
            chosen.append(place)
    return np.sort(np.array(chosen, dtype=np.int64))

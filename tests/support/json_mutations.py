"""JSON trees changed in one place, as a hand, another program or another version of ours would change them."""

import copy
import json
from collections.abc import Iterator
from typing import Any

import numpy as np

_NASTY: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1.5, 10**30, 1e308, float("nan"), float("inf")),
    *("", "x", "nan", "0-70", [], [None], ["x"], [[1.0, 2.0]], [1.0], {}, {"x": 1}, {"x": None}, {"0": {"x": []}}),
)


def mutations(trees: list[Any], count: int, rng: np.random.Generator) -> Iterator[bytes]:
    """So many texts, each of one tree with one place changed, every eighth with a few bytes changed instead.

    Args:
        trees: JSON values; the trees that were not changed are none of the texts.
        count: Number of texts.
        rng: Source of the changes.
    """
    for number in range(count):
        tree = copy.deepcopy(trees[number % len(trees)])
        if number % 8 == 7:
            data = bytearray(json.dumps(tree).encode())
            for position in rng.integers(len(data), size=3):
                data[position] = int(rng.integers(256))
            yield bytes(data)
        else:
            for _ in range(int(rng.integers(1, 4))):
                _change(tree, rng)
            yield json.dumps(tree).encode()


def _change(tree: Any, rng: np.random.Generator) -> None:
    """Change one place: replaced, left out, renamed, put into a list, or another place's value."""
    slots = list(_slots(tree))
    if not slots:
        return
    depth = int(rng.integers(1, 5))  # a leaf picked evenly is a point of a curve nearly always
    near = [slot for slot in slots if slot[2] <= depth]
    holder, key, _ = near[int(rng.integers(len(near)))]
    kind = int(rng.integers(6))
    if kind <= 2:
        holder[key] = copy.deepcopy(_NASTY[int(rng.integers(len(_NASTY)))])
    elif kind == 3:
        del holder[key]
    elif kind == 4:
        other, other_key, _ = near[int(rng.integers(len(near)))]
        holder[key] = copy.deepcopy(other[other_key])
    elif isinstance(holder, dict):
        holder[f"{key}x"] = holder.pop(key)
    else:
        holder[key] = [holder[key]]


def _slots(node: Any, depth: int = 1) -> Iterator[tuple[Any, Any, int]]:
    """Every place of a tree: what holds it, its key, how deep it stands."""
    pairs = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, value in list(pairs):
        yield node, key, depth
        yield from _slots(value, depth + 1)

"""Usual sizes of a data set's classes, from its own boxes."""

from collections.abc import Iterable, Mapping

import numpy as np

from farfield.annotation.checking.contract import SizeRange
from farfield.datasets.labels import BoxLabel

FEWEST = 200
"""Of fewer boxes, the 0.5 and 99.5 per cent points say nothing."""
PARTS = (0.5, 99.5)
ROOM = 0.1
"""Limits stand so much beyond those points: else one box in a hundred of a sound set is found, on each axis."""


def size_ranges(labels: Iterable[BoxLabel], presets: Mapping[str, SizeRange]) -> dict[str, SizeRange]:
    """Sizes by class: those of the presets, with the limits and medians of the boxes where there are enough.

    Args:
        labels: Boxes of the data set, or of a part of it.
        presets: What is taken for usual where nothing else is known.
    """
    by_class: dict[str, list[tuple[float, float, float]]] = {}
    for label in labels:
        if min(label.box[3:6]) > 0 and np.isfinite(label.box[3:6]).all():
            by_class.setdefault(label.label, []).append(label.box[3:6])
    found = dict(presets)
    for name, sizes in by_class.items():
        if len(sizes) >= FEWEST:
            low, high = np.percentile(sizes, PARTS, axis=0)
            types = found[name].types if name in found else ()
            found[name] = SizeRange(
                usual=_three(np.median(sizes, axis=0)),
                low=_three((1 - ROOM) * low),
                high=_three((1 + ROOM) * high),
                types=types,
            )
    return found


def _three(values: np.ndarray) -> tuple[float, float, float]:
    length, width, height = values.tolist()
    return length, width, height

"""One of two data sets that are set side by side: its statistics as plain data, and how they are counted."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from farfield.bulk import HERE, Bulk, Done, Unit, blocks, values
from farfield.datasets.base import Dataset
from farfield.errors import FarfieldError
from farfield.frame.provenance import SIMULATION_FILE, is_simulated
from farfield.inspection.statistics import Statistics
from farfield.vocabulary.kradar import OUSTER_LINES
from farfield.vocabulary.patterns import PATTERNS

_BLOCK = 1  # frame that is counted at a time: sums are those of one frame after the other, whoever counts


@dataclass(frozen=True)
class Side:
    """One of the two data sets.

    Args:
        name: What figures and table call it.
        summary: Its figures: ``farfield.inspection.statistics.Statistics.summary()``.
        arrays: Its arrays: ``Statistics.arrays()``.
        path: Where it was read from.
    """

    name: str
    summary: Mapping[str, Any]
    arrays: Mapping[str, Mapping[str, np.ndarray]] = field(default_factory=dict)
    path: str = ""

    @property
    def simulated(self) -> bool:
        """Whether the data calls itself simulated."""
        return bool(self.summary.get("simulated"))

    @property
    def title(self) -> str:
        """The name, and "simulated" where that is known."""
        return f"{self.name} (simulated)" if self.simulated else self.name


@dataclass(frozen=True)
class _Counting:
    """Counts a block of frames, of ``count`` that are spread evenly over the data."""

    data: Dataset
    count: int
    settings: Mapping[str, Any]
    memory_bytes = 800_000_000

    def __call__(self, unit: Unit) -> Done:
        statistics = Statistics(**self.settings)
        for place in unit.parameters:
            statistics.add(self.data[place * len(self.data) // self.count])
        return Done(value=statistics)


def side_of(data: Dataset, name: str, frames: int = 0, bulk: Bulk = HERE, **settings: Any) -> Side:
    """Count the clouds, boxes and radar of a data set.

    Args:
        data: The data set.
        name: What figures and table call it.
        frames: Frames to read, spread evenly; 0 reads all.
        bulk: Who counts.
        **settings: Of :class:`~farfield.inspection.statistics.Statistics`.
    """
    count = len(data) if frames == 0 else min(frames, len(data))
    settings = {"shots": shots_of(data.root), **settings}
    statistics = Statistics(**settings)
    for done in values(_Counting(data, count, settings), blocks(count, _BLOCK), bulk):
        statistics.merge(done.value)
    summary = statistics.summary()
    if summary["simulated"] is None and is_simulated(data.root):
        summary["simulated"] = True
    return Side(name, summary, statistics.arrays(), str(data.root))


def has_sensors(data: Dataset) -> bool:
    """Whether the first, the middle or the last frame has a cloud or a radar product."""
    for index in {0, len(data) // 2, len(data) - 1} if len(data) else ():
        try:
            frame = data[index]
        except (FarfieldError, OSError):
            continue
        if frame.clouds or frame.radar:
            return True
    return False


def shots_of(root: Path) -> dict[str, int]:
    """Shots a frame by cloud, from the settings that ``farfield simulate`` leaves beside its frames; else nothing."""
    for folder in (root, root.absolute().parent):
        try:
            preset = json.loads((folder / SIMULATION_FILE).read_text("utf-8"))["preset"]
            shots = preset.get("lidar", preset)
            lines, columns = int(shots["lines"]), int(shots["columns"])
        except (OSError, ValueError, LookupError, TypeError, AttributeError):
            continue
        rows = dict.fromkeys(PATTERNS, lines) | OUSTER_LINES
        return {name: count * columns for name, count in rows.items()}
    return {}

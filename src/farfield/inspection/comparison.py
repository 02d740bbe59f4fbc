"""One of two data sets that are set side by side: its statistics as plain data, and how they are counted."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from farfield.datasets.base import Dataset
from farfield.errors import ConfigError, FarfieldError
from farfield.files.json_text import read_json
from farfield.frame.provenance import SIMULATION_FILE, is_simulated
from farfield.inspection.statistics import Statistics
from farfield.inspection.statistics.background import BackgroundSample, ToldApart, tell_apart
from farfield.jobs import HERE, JobOptions, Unit, UnitResult, blocks, values
from farfield.vocabulary.kradar import OUSTER_LINES
from farfield.vocabulary.patterns import PATTERNS

_BLOCK = 1  # frame that is counted at a time: sums are those of one frame after the other, whoever counts


@dataclass(frozen=True)
class ComparedDataset:
    """One of the two data sets.

    Args:
        name: What figures and table call it.
        summary: Its figures: ``farfield.inspection.statistics.Statistics.summary()``.
        arrays: Its arrays: ``Statistics.arrays()``.
        path: Where it was read from.
        background: Samples of the roadside by cloud.
    """

    name: str
    summary: Mapping[str, Any]
    arrays: Mapping[str, Mapping[str, np.ndarray]] = field(default_factory=dict)
    path: str = ""
    background: Mapping[str, Sequence[BackgroundSample]] = field(default_factory=dict)

    @property
    def simulated(self) -> bool:
        """Whether the data calls itself simulated."""
        return bool(self.summary.get("simulated"))

    @property
    def title(self) -> str:
        """The name, and "simulated" where that is known."""
        return f"{self.name} (simulated)" if self.simulated else self.name


@dataclass(frozen=True)
class _BlockCounting:
    """Counts a block of frames, of ``count`` that are spread evenly over the data."""

    data: Dataset
    count: int
    settings: Mapping[str, Any]
    memory_bytes = 800_000_000

    def __call__(self, unit: Unit) -> UnitResult:
        statistics = Statistics(**self.settings)
        for number in unit.parameters:
            statistics.add(self.data[number * len(self.data) // self.count])
        return UnitResult(value=statistics)


def count_dataset(
    data: Dataset, name: str, frames: int = 0, bulk: JobOptions = HERE, **settings: Any
) -> ComparedDataset:
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
    for counted in values(_BlockCounting(data, count, settings), blocks(count, _BLOCK), bulk):
        statistics.merge(counted.value)
    summary = statistics.summary()
    if summary["simulated"] is None and is_simulated(data.root):
        summary["simulated"] = True
    samples = {name: tally.samples for name, tally in statistics.background.items()}
    return ComparedDataset(name, summary, {**statistics.arrays(), **_sweeps(data)}, str(data.root), samples)


_SWEEP_POINTS = 40_000


def _sweeps(data: Dataset) -> dict[str, dict[str, np.ndarray]]:
    """The clouds of the middle frame from above, thinned alike everywhere: ``sweep/NAME`` with ``xy_m``, (n, 2)."""
    if not len(data):
        return {}
    try:
        frame = data[len(data) // 2]
        xy_m = {name: frame.cloud(name).points_m[:, :2] for name in frame.clouds}
    except (FarfieldError, OSError):
        return {}
    steps = {name: -(-len(points) // _SWEEP_POINTS) for name, points in xy_m.items()}
    return {f"sweep/{name}": {"xy_m": points[:: max(steps[name], 1)]} for name, points in xy_m.items()}


def pair_clouds(
    sides: Sequence[ComparedDataset], clouds: Mapping[str, str] | None = None
) -> tuple[tuple[ComparedDataset, ComparedDataset], list[tuple[str, str]]]:
    """Two sides whose clouds stand beside one another under one name.

    Args:
        sides: Both.
        clouds: For clouds of the first side those of the second; the others are left out. Without it clouds of one name
            are paired, and where no name is in both, the first cloud with the first.

    Returns:
        The sides, a pair of two names called ``"first : second"``, and the pairs.

    Raises:
        ConfigError: If a side has no such cloud.
    """
    first, second = sides
    first_clouds, second_clouds = (list(side.summary.get("clouds", {})) for side in (first, second))
    pairs = dict(clouds) if clouds else {name: name for name in first_clouds if name in second_clouds}
    if not pairs and first_clouds and second_clouds:
        pairs = {first_clouds[0]: second_clouds[0]}
    for side, present, required in ((first, first_clouds, pairs), (second, second_clouds, pairs.values())):
        missing = next((name for name in required if name not in present), None)
        if missing is not None:
            raise ConfigError(f"clouds: {side.name} has no cloud {missing!r}; it has {', '.join(present) or 'none'}")
    common = {(a, b): a if a == b else f"{a} : {b}" for a, b in pairs.items()}
    renamed = (
        _with_clouds(first, {a: name for (a, _), name in common.items()}, alone=bool(clouds)),
        _with_clouds(second, {b: name for (_, b), name in common.items()}, alone=bool(clouds)),
    )
    return renamed, list(pairs.items())


@dataclass(frozen=True, kw_only=True)
class ToldApartClouds:
    """How well the roadsides of two data sets are told apart, by cloud that both have.

    Args:
        apart: The two data sets.
        floor: The second of them and a third, of another road and perhaps another sensor: what differs among real sets
            anyway; empty where there is no third.
        floor_name: What the third is called.
    """

    apart: Mapping[str, ToldApart] = field(default_factory=dict)
    floor: Mapping[str, ToldApart] = field(default_factory=dict)
    floor_name: str = ""

    def to_json(self) -> dict[str, Any]:
        """All of it as JSON values."""
        tree: dict[str, Any] = {"clouds": {name: result.to_json() for name, result in self.apart.items()}}
        if self.floor:
            floor = {name: result.to_json() for name, result in self.floor.items()}
            tree |= {"floor": {"name": self.floor_name, "clouds": floor}}
        return tree


def told_apart(sides: Sequence[ComparedDataset], floor: ComparedDataset | None = None) -> ToldApartClouds:
    """How well the roadsides of two data sets are told apart.

    Args:
        sides: Both; of one alone nothing is told.
        floor: A third, to which the second is held: its cloud of the same name, else its first.
    """
    if len(sides) != 2:
        return ToldApartClouds()
    first, second = (side.background for side in sides)
    pairs = {name: (first[name], second[name]) for name in first if name in second}
    third = {} if floor is None else {name: floor.background.get(name) or _first(floor.background) for name in pairs}
    return ToldApartClouds(
        apart=_told({name: tell_apart(*pair) for name, pair in pairs.items()}),
        floor=_told({name: tell_apart(second[name], samples) for name, samples in third.items()}),
        floor_name="" if floor is None else floor.name,
    )


def _told(results: Mapping[str, ToldApart | None]) -> dict[str, ToldApart]:
    return {name: result for name, result in results.items() if result is not None}


def _first(background: Mapping[str, Sequence[BackgroundSample]]) -> Sequence[BackgroundSample]:
    return next(iter(background.values()), ())


def _with_clouds(side: ComparedDataset, names: Mapping[str, str], *, alone: bool) -> ComparedDataset:
    """A side with some clouds under other names, and perhaps only those."""
    clouds = {names.get(n, n): c for n, c in side.summary.get("clouds", {}).items() if n in names or not alone}
    arrays = {}
    for key, array in side.arrays.items():
        kind, slash, name = key.partition("/")
        if not slash or name in names or not alone:
            arrays[f"{kind}{slash}{names.get(name, name)}"] = array
    background = {names.get(n, n): samples for n, samples in side.background.items() if n in names or not alone}
    return replace(side, summary={**side.summary, "clouds": clouds}, arrays=arrays, background=background)


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
            preset = read_json(folder / SIMULATION_FILE)["preset"]
            shots = preset.get("lidar", preset)
            lines, columns = int(shots["lines"]), int(shots["columns"])
        except (FarfieldError, OSError, ValueError, LookupError, TypeError, AttributeError):
            continue
        rows = dict.fromkeys(PATTERNS, lines) | OUSTER_LINES
        return {name: count * columns for name, count in rows.items()}
    return {}

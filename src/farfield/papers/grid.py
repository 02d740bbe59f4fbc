"""The declared grid of experiments that feeds a paper's tables: runs, data sets, and what each budget makes of them."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, model_serializer, model_validator

from farfield.papers.claims.schema import BUDGETS, Budget, DeclaredModel, declared_path, read_declared
from farfield.vocabulary.conditions import Side, World

_FOLDER = Path(__file__).resolve().parent
LEAST_STEPS = 200
"""Steps below which no run is trained: its scores would say nothing of a method."""
LEAST_SEEDS = 3
"""Seeds below which no shipped budget goes."""

Tree = dict[str, Any]


class SimulatedSet(DeclaredModel):
    """A data set that is simulated for the grid."""

    preset: str
    sequences: int = Field(ge=1)
    frames: int = Field(ge=1, description="frames of each sequence")
    seed: int = Field(ge=0, description="sets of different seeds share no road")
    sensors: str | None = Field(None, description="what is written, by commas; the preset's own if left out")
    weather: str | None = None
    stride_s: float | None = Field(None, gt=0, le=1)
    traffic: Side | None = Field(None, description="on which side it keeps; the preset's own if left out")
    world: World | None = Field(None, description="what stands beside and on the roads; the preset's own if left out")

    @model_serializer(mode="wrap")
    def _without_default_side(self, serialize: Callable[[Any], Tree]) -> Tree:
        """All settings; side and world only where they are set, so that hashes of older sets stay."""
        late = ("traffic", "world")
        return {name: value for name, value in serialize(self).items() if name not in late or value is not None}


class RealSet(DeclaredModel):
    """Where a data set is taken from if the user has real data."""

    of: Literal["data", "source"] = Field("data", description="the folder given as data or as the other device")
    split: str = Field("", description="its train, val or test part; all of it if empty")


class GridStream(DeclaredModel):
    """What a stream of a training reads."""

    set: str
    clouds: tuple[str, ...] = Field(min_length=1)
    part: tuple[float, float] = (0.0, 1.0)
    options: Tree = Field(default_factory=dict, description="options of the data set's reader")


class GridRun(DeclaredModel):
    """A training of the grid, once a seed."""

    words: str
    streams: dict[str, GridStream] = Field(min_length=1)
    method: Tree = Field(default_factory=lambda: {"name": "supervised"})
    network: str = Field("grid", description="one of the budget's networks")
    batch: float = Field(1.0, gt=0, description="frames a step over those of a run of one pattern")
    start: str = Field("", description="the run, of the same seed, whose weights it starts from")
    scored: tuple[str, ...] = Field((), description="clouds that it is scored on besides those that claims name")
    tables: tuple[str, ...] = Field((), description="tables that show it besides those of the claims")
    augmentation: Tree = Field(default_factory=dict)
    least_budget: Budget | None = Field("laptop", description="smallest budget that runs it; null: those that name it")


class Score(DeclaredModel):
    """How runs are scored: a protocol, its settings, and what it calls the parts that claims name."""

    protocol: str
    settings: Tree = Field(default_factory=dict)
    bins_m: dict[str, dict[str, tuple[float, float]]] = Field(
        default_factory=dict, description="range of each part by table; those of the first stand for tables not named"
    )

    @property
    def tables(self) -> tuple[str, ...]:
        """Tables with ranges of their own; one without a name where there are none."""
        return tuple(self.bins_m) or ("",)

    def table(self, name: str) -> str:
        """The table whose ranges hold in another table."""
        return name if name in self.bins_m else self.tables[0]

    def edges_m(self, table: str) -> tuple[float, ...]:
        """Rising edges of the ranges of a table; none where it has no ranges."""
        return tuple(sorted({edge for span in self.bins_m.get(table, {}).values() for edge in span}))

    def parts(self, table: str) -> dict[str, str]:
        """What the protocol's result calls the parts: ``{"near": "0-70"}``."""
        return {name: f"{low:g}-{high:g}" for name, (low, high) in self.bins_m.get(table, {}).items()}

    def settings_of(self, table: str) -> Tree:
        """Settings of the protocol with the ranges of a table."""
        edges_m = self.edges_m(table)
        return {**self.settings, **({"range_bins_m": edges_m} if edges_m else {})}


class BudgetSettings(DeclaredModel):
    """What a budget makes of the grid."""

    words: str
    scaled: bool = Field(True, description="whether window, network or schedule are smaller than the paper's")
    seeds: int = Field(ge=1)
    steps: int = Field(ge=1)
    least_steps: int = Field(LEAST_STEPS, ge=1, description="steps are never lowered below this")
    steps_of: dict[str, int] = Field(default_factory=dict, description="steps of the runs of a network, if others")
    batch: int = Field(2, ge=1, description="frames a step of a run of one pattern")
    core_minutes: float | None = Field(None, gt=0, description="what the whole is to take at most")
    without: tuple[str, ...] = Field((), description="runs that this budget leaves out")
    only: tuple[str, ...] = Field((), description="the only runs that it has; all of its size if empty")
    sets: dict[str, SimulatedSet]
    scored_on: tuple[str, ...] = Field(("val",), description="sets on whose frames all runs are scored")
    statistics_on: tuple[str, ...] = Field(("val",), description="sets whose statistics are taken")
    networks: dict[str, Tree]
    method: dict[str, Tree] = Field(default_factory=dict, description="settings of methods that depend on the window")
    augmentation: dict[str, Tree] = Field(
        default_factory=dict, description="the same of changes, for the runs that name them"
    )
    training: Tree = Field(default_factory=dict)
    score: Score
    replicates: int = Field(1000, ge=2, description="draws of the sequences")

    def steps_for(self, network: str) -> int:
        """Steps of the runs of a network."""
        return self.steps_of.get(network, self.steps)

    def lowered(self, share: float | int) -> "BudgetSettings":
        """The same with fewer steps, rounded down to tens, never below ``least_steps`` nor above what they were."""
        steps_of = {network: self._lowered(steps, share) for network, steps in self.steps_of.items()}
        return self.model_copy(update={"steps": self._lowered(self.steps, share), "steps_of": steps_of})

    def _lowered(self, steps: int, share: float | int) -> int:
        fewer = int(steps * share)
        fewer -= fewer % 10 if fewer > 10 else 0
        return min(steps, max(min(self.least_steps, steps), fewer))


class ExperimentGrid(DeclaredModel):
    """A file of a grid."""

    paper: Literal["cirrus", "kradar"]
    real: dict[str, RealSet]
    augmentation: Tree = Field(default_factory=dict)
    training: Tree = Field(default_factory=dict)
    aliases: dict[str, str] = Field(default_factory=dict)
    runs: dict[str, GridRun]
    budgets: dict[str, BudgetSettings]

    @model_validator(mode="after")
    def _check_names(self) -> "ExperimentGrid":
        for name, run in self.runs.items():
            if run.start and (run.start not in self.runs or self.runs[run.start].start):
                raise ValueError(f"{name}: expected to start from a run that starts from none; got {run.start!r}")
        for name, budget in self.budgets.items():
            _check_budget(self, name, budget)
        return self

    def sets_of(self, budget: str) -> tuple[str, ...]:
        """The sets that a budget's runs learn from, are scored on, or whose statistics are taken."""
        settings = self.budgets[budget]
        learnt = {stream.set for run in self.runs_of(budget).values() for stream in run.streams.values()}
        needed = {*learnt, *settings.scored_on, *settings.statistics_on}
        return tuple(name for name in settings.sets if name in needed)

    def runs_of(self, budget: str) -> dict[str, GridRun]:
        """The runs that a budget has."""
        chosen, order = self.budgets[budget], (*BUDGETS, budget)
        size = order.index(budget)
        if chosen.only:
            return {name: run for name, run in self.runs.items() if name in chosen.only}
        return {
            name: run
            for name, run in self.runs.items()
            if run.least_budget is not None and order.index(run.least_budget) <= size and name not in chosen.without
        }


def _check_budget(grid: ExperimentGrid, name: str, budget: BudgetSettings) -> None:
    for run_name, run in grid.runs_of(name).items():
        if run.network not in budget.networks:
            raise ValueError(f"budget {name}, run {run_name}: expected a network among {', '.join(budget.networks)}")
        if any(stream.set not in budget.sets for stream in run.streams.values()):
            raise ValueError(f"budget {name}, run {run_name}: expected a set among {', '.join(budget.sets)}")
    missing = [set_name for set_name in (*budget.scored_on, *budget.statistics_on) if set_name not in budget.sets]
    if missing:
        raise ValueError(f"budget {name}: expected sets among {', '.join(budget.sets)}; got {', '.join(missing)}")
    if unknown := sorted({*budget.only, *budget.without} - set(grid.runs)):
        raise ValueError(f"budget {name}: expected runs among {', '.join(grid.runs)}; got {', '.join(unknown)}")
    if min(budget.steps, *budget.steps_of.values(), budget.steps) < budget.least_steps:
        raise ValueError(f"budget {name}: expected at least {budget.least_steps} steps of every run")


def load_grid(name_or_path: str | Path) -> ExperimentGrid:
    """Read a grid: a shipped one by the paper's name, or a file.

    Raises:
        ConfigError: If there is no such file.
        FileFormatError: If it declares something that is not there.
    """
    return read_declared(declared_path(name_or_path, "grid", _FOLDER), ExperimentGrid, "a declared grid")[0]


def merge_trees(*trees: Mapping[str, Any]) -> Tree:
    """Trees of settings laid over one another: groups are joined, what stands in a later one wins."""
    result: Tree = {}
    for tree in trees:
        for key, value in tree.items():
            before = result.get(key)
            both = isinstance(before, Mapping) and isinstance(value, Mapping)
            result[key] = merge_trees(before, value) if both else value  # type: ignore[arg-type]
    return result

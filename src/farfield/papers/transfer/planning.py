"""What the table of transfer will cost on this machine: in each world frames simulated, steps taken, frames scored."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from farfield.experiments.plan import Plan
from farfield.experiments.schema import experiment_of
from farfield.papers.transfer.declared import TransferRun, TransferTable, experiment_tree, runs_of
from farfield.papers.transfer.running import TransferTask, WorldSets
from farfield.training.method import LABELLED
from farfield.training.report import TrainingReport

STEPS = 6
_FRAMES = 2


@dataclass(frozen=True, kw_only=True)
class TransferCost:
    """Seconds of a core in one world.

    Args:
        frame_s: To simulate and write a frame.
        step_s: To take a step.
        score_s: To score a frame.
    """

    frame_s: float
    step_s: float
    score_s: float


@dataclass
class _StepTimes(TrainingReport):
    """Notes the time of the process at each step."""

    at_s: list[float] = field(default_factory=list)

    def step(self, step: int, losses: dict[str, float]) -> None:
        """Note it."""
        del step, losses
        self.at_s.append(time.process_time())


def measured(table: TransferTable) -> dict[str, TransferCost]:
    """The cost of each world that has data of its own, measured on a few frames of it.

    Args:
        table: The table.
    """
    with TemporaryDirectory() as folder:
        return {
            name: _measured(small_table(table, name), Path(folder) / name)
            for name, world in table.worlds.items()
            if not world.of
        }


def small_table(table: TransferTable, world: str) -> TransferTable:
    """A table of one row in one world, of two frames and a few steps.

    Args:
        table: The table.
        world: Its name.
    """
    given = table.worlds[world].model_dump()
    for part in ("train", "val"):
        given[part] |= {"sequences": 1, "frames": _FRAMES}
    changes = {
        "worlds": {world: given},
        "rows": {world: {"words": world, "world": world}},
        "shares": (1.0,),
        "comparisons": (),
        "replicates": 2,
        "floor_frames": 1,
        "training": {**table.training, "steps": STEPS},
    }
    return TransferTable.model_validate(table.model_dump() | changes)


def _measured(table: TransferTable, folder: Path) -> TransferCost:
    folder.mkdir()
    sets = WorldSets(table, folder / "data", folder / "floors.json")
    simulating_s = _spent(sets.provide, workers=1, progress=iter, report=None)
    ((run,),) = [wave for wave in runs_of(table, (0,)) if wave]
    clock = _StepTimes()
    tree = experiment_tree(table, run, data=sets.path(run.row, "train"), start=None)
    data = {LABELLED: sets.seen(run.row, "train")}
    Plan(experiment_of(tree), folder / run.folder, data=data).run(clock)
    gaps = sorted(b - a for a, b in zip(clock.at_s, clock.at_s[1:], strict=False))
    doing = TransferTask(sets, folder)
    scoring_s = _spent(doing.score, run, folder / run.folder)
    return TransferCost(frame_s=simulating_s / (2 * _FRAMES), step_s=gaps[len(gaps) // 2], score_s=scoring_s / _FRAMES)


def _spent(work: Callable[..., object], *given: Any, **named: Any) -> float:
    began = time.process_time()
    work(*given, **named)
    return time.process_time() - began


def core_seconds(table: TransferTable, costs: dict[str, TransferCost], runs: list[TransferRun]) -> tuple[float, float]:
    """Seconds of a core to simulate the worlds, and to train and score the runs.

    Args:
        table: The table.
        costs: Of each world that has data of its own.
        runs: The runs.
    """
    simulating, training = 0.0, 0.0
    for name, cost in costs.items():
        world = table.worlds[name]
        simulating += cost.frame_s * sum(each.sequences * each.frames for each in (world.train, world.val))
    for run in runs:
        row = table.rows[run.row]
        cost, val = costs[table.worlds[row.world].of or row.world], table.worlds[row.world].val
        steps = table.training["steps"] if row.steps is None else row.steps
        training += cost.step_s * (steps + row.reestimate_batches) + cost.score_s * val.sequences * val.frames
    return simulating, training


def outline(table: TransferTable, seeds: tuple[int, ...] | None = None) -> list[str]:
    """What will be done, and what it will cost on this machine: measured in a minute or two, in a folder of its own.

    Args:
        table: The table.
        seeds: Those of the table unless given.
    """
    waves = runs_of(table, seeds)
    runs = [run for wave in waves for run in wave]
    costs = measured(table)
    lines = [
        f"{len(runs)} runs of {table.training['steps']} steps, {len(waves[0])} of them to start from",
        *(
            f"  {table.worlds[name].words}: {cost.frame_s:.2f} s to simulate a frame, {cost.step_s:.2f} s a step of "
            f"{table.training['batch_size']} frames, {cost.score_s:.2f} s to score a frame"
            for name, cost in costs.items()
        ),
        f"{'row':<84}{'seeds':>6}  frames to learn from",
    ]
    for name, row in table.rows.items():
        frames = ", ".join(f"{table.frames_of(name, share):,} ({100 * share:g} %)" for share in table.shares_of(name))
        said = f"{row.words} ({table.worlds[row.world].words})"
        lines.append(f"{said[:83]:<84}{len({run.seed for run in runs}):>6}  {frames}")
    simulating, training = (each / 3600 for each in core_seconds(table, costs, runs))
    lines.append(
        f"about {simulating + training:.1f} core-hours: {simulating:.1f} to simulate, {training:.1f} to train and score"
    )
    return lines

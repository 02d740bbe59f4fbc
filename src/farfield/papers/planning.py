"""What a grid costs on this machine, measured on a few steps and frames, and which of its claims it can decide.

The plan comes before anything is run: some steps of each kind of run, some frames of each network and some simulated
frames are timed, the steps are lowered until all fits into the minutes, and the power of each comparison says whether
it can be decided.
"""

import shutil
import statistics
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

from farfield.datasets import Dataset
from farfield.detectors.runtime import Detector
from farfield.errors import ConfigError
from farfield.evaluation import detect
from farfield.experiments.plan import Plan
from farfield.experiments.schema import DataConfig, Experiment, MethodConfig
from farfield.jobs import JobOptions, Unit, UnitResult, values
from farfield.papers.grid import BudgetSettings, SimulatedSet
from farfield.papers.jobs import TrainingJob
from farfield.papers.locations import DataLocation, simulate
from farfield.papers.prospects import PowerEstimate
from farfield.papers.running import quiet
from farfield.training.report import TrainingReport
from farfield.vocabulary.counts import count_of

STEPS = 20
"""Steps of each trial."""
SMALL_BATCH = 2
"""Frames a step of one pattern with which trials are made."""
_SEQUENCES = 3  # of a set that is only measured on
_FRAMES, _FEW_FRAMES, _SLOW_FRAME_S = 6, 2, 0.5  # detected in; fewer where one takes so long
_GLANCE = 2  # steps that show whether there is time for more
_PATIENCE_S, _PATIENCE_OF_ALL_S = 60.0, 240.0  # for the steps of the trial of a kind, and of all kinds
_SETTLED = 8  # steps until the allocator and the caches have settled

SCORING_S = 12.0
"""Core seconds that scoring a run on a cloud takes besides detecting, with its draws."""
PAGE_S = 60.0
RESERVE = 0.08
"""Share of the minutes that a plan leaves where the fewest steps let it: rates are measured to a few percent,
checkpoints take their time, and a command that is killed loses the steps since the last one."""
_SHARES = tuple(share / 100 for share in range(100, 0, -1))


@dataclass(frozen=True, kw_only=True)
class RunRate:
    """How long a kind of run takes a core of this machine, with as many of them at a time as there are workers.

    On the CPU it is the processor's time, which other programs hardly bear on; on a GPU that of the clock on the wall.

    Args:
        step_s: Seconds a step.
        begin_s: Seconds before the first step.
        frame_s: Seconds a frame that is detected in.
    """

    step_s: float
    begin_s: float
    frame_s: float


@dataclass(frozen=True, kw_only=True)
class GridCost:
    """Core minutes of a grid, by what they go into.

    Args:
        simulating: Frames that are not there yet, those that only the page shows among them.
        training: Steps, and what comes before the first.
        scoring: Detecting in the frames that are scored, figures with their draws, the page.
    """

    simulating: float
    training: float
    scoring: float

    @property
    def core_minutes(self) -> float:
        """All of it."""
        return self.simulating + self.training + self.scoring


@dataclass(frozen=True, kw_only=True)
class GridPlan:
    """The plan of a grid.

    Args:
        budget: Name of the budget.
        steps_share: Share of the declared steps that is taken.
        steps: Steps by network.
        jobs: Number of trainings.
        rows: Number of runs a seed.
        seeds: Number of seeds.
        cost: What it costs.
        workers: Processes.
        outlooks: Which claims can be decided, one a comparison.
        paces: Measured rate of each kind of job.
        simulating_s: Measured core seconds a frame by set.
    """

    budget: str
    steps_share: float
    steps: Mapping[str, int]
    jobs: int
    rows: int
    seeds: int
    cost: GridCost
    workers: int
    outlooks: tuple[PowerEstimate, ...] = ()
    paces: Mapping[str, RunRate] = field(default_factory=dict)
    simulating_s: Mapping[str, float] = field(default_factory=dict)

    @property
    def minutes(self) -> float:
        """Minutes on so many workers, each with a core of its own."""
        return self.cost.core_minutes / self.workers

    def to_json(self) -> dict[str, Any]:
        """All of it as JSON values; :func:`outline_of` reads it."""
        return {**asdict(self), "core_minutes": self.cost.core_minutes, "minutes": self.minutes}


def outline_of(tree: Mapping[str, Any]) -> GridPlan:
    """Read a plan of JSON values."""
    fields = {name: value for name, value in tree.items() if name not in ("core_minutes", "minutes")}
    fields["cost"] = GridCost(**tree["cost"])
    fields["outlooks"] = tuple(PowerEstimate(**outlook) for outlook in tree["outlooks"])
    return GridPlan(**{**fields, "paces": rates_of(tree)})


def rates_of(tree: Mapping[str, Any]) -> dict[str, RunRate]:
    """The measured rates of a plan of JSON values."""
    return {kind: RunRate(**rate) for kind, rate in tree["paces"].items()}


def cost_of(
    jobs: Sequence[TrainingJob],
    steps_share: float,
    settings: BudgetSettings,
    rates: Mapping[str, RunRate],
    simulating_s: Mapping[str, float],
    frames_scored: int,
    *,
    beside_s: float = 0.0,
) -> GridCost:
    """Core minutes of jobs with a share of the budget's steps.

    Args:
        jobs: The jobs.
        steps_share: Share of the declared steps.
        settings: The budget.
        rates: The rate of each kind of job.
        simulating_s: Core seconds a frame of each set that is to be simulated.
        frames_scored: Number of frames on which each job is scored.
        beside_s: Core seconds that simulating takes besides: frames that the page alone shows.
    """
    lowered = settings.lowered(steps_share)
    training = sum(rates[job.kind].begin_s + lowered.steps_for(job.network) * rates[job.kind].step_s for job in jobs)
    scoring = sum(len(job.clouds) * (frames_scored * rates[job.kind].frame_s + SCORING_S) for job in jobs)
    sets = settings.sets
    simulating = beside_s + sum(
        seconds * sets[name].sequences * sets[name].frames for name, seconds in simulating_s.items()
    )
    return GridCost(simulating=simulating / 60, training=training / 60, scoring=(scoring + PAGE_S) / 60)


def fit_steps(
    jobs: Sequence[TrainingJob],
    settings: BudgetSettings,
    rates: Mapping[str, RunRate],
    simulating_s: Mapping[str, float],
    frames_scored: int,
    core_minutes: float | None,
    *,
    beside_s: float = 0.0,
) -> tuple[float, GridCost]:
    """The largest share of the declared steps whose cost fits with a reserve, or the least, and that cost.

    Seeds and rows are never fewer.

    Args:
        jobs: As of :func:`cost_of`, and so the next four.
        settings: The budget.
        rates: The rate of each kind of job.
        simulating_s: Core seconds a frame.
        frames_scored: Number of frames.
        core_minutes: Limit of the cost; None for no limit.
        beside_s: As of :func:`cost_of`.

    Raises:
        ConfigError: If it does not fit with the fewest steps either.
    """
    cost = GridCost(simulating=0.0, training=0.0, scoring=0.0)
    for share in _SHARES:
        cost = cost_of(jobs, share, settings, rates, simulating_s, frames_scored, beside_s=beside_s)
        least = settings.lowered(share) == settings.lowered(_SHARES[-1])
        if core_minutes is None or cost.core_minutes <= core_minutes * (1.0 if least else 1.0 - RESERVE):
            return share, cost
        if least:
            break
    parts = f"simulating {cost.simulating:.0f}, training {cost.training:.0f}, scoring {cost.scoring:.0f}"
    raise ConfigError(
        f"minutes: expected at least {cost.core_minutes:.0f} core minutes, "
        f"which {count_of(len(jobs), 'run')} take on this machine "
        f"with the fewest steps, {settings.least_steps} ({parts}); got {core_minutes:.0f}. Runs with fewer steps say "
        "nothing of a method. Give more --minutes, more --workers or another --budget."
    )


def described(outline: GridPlan) -> list[str]:
    """A plan in lines: runs, steps, minutes, and which claims can be decided."""
    cost = outline.cost
    steps = ", ".join(f"{network} {steps}" for network, steps in outline.steps.items())
    lowered = f" ({outline.steps_share:.0%} of those declared)" if outline.steps_share < 1 else ""
    lines = [
        f"budget {outline.budget}: {count_of(outline.rows, 'run')} x "
        f"{count_of(outline.seeds, 'seed')}, {count_of(outline.jobs, 'training')}; "
        f"steps: {steps}{lowered}",
        "cost: not measured, for all trainings are done"
        if not cost.core_minutes
        else f"cost on this machine: {cost.core_minutes:.0f} core minutes (simulating {cost.simulating:.0f}, training "
        f"{cost.training:.0f}, scoring {cost.scoring:.0f}) = {outline.minutes:.0f} minutes with "
        f"{count_of(outline.workers, 'worker')}",
    ]
    by_claim: dict[str, list[str]] = {}
    for estimate in outline.outlooks:
        by_claim.setdefault(estimate.claim, []).append(estimate.words)
    lines += ["can be decided, if the paper's differences are true:"]
    lines += [f"  {claim}: {', '.join(words)}" for claim, words in by_claim.items()]
    return lines


# Measuring: a few steps, detections and simulated frames

Clocks = tuple[float, float]
"""The processor's time of this process, and that of the wall, seconds."""


def _clocks() -> Clocks:
    return time.process_time(), time.perf_counter()


class StepClock(TrainingReport):
    """Notes when steps were done."""

    def __init__(self) -> None:
        self.began, self.times = _clocks(), list[Clocks]()

    def step(self, step: int, losses: dict[str, float]) -> None:
        """Note the moment."""
        del step, losses
        self.times.append(_clocks())

    def rate(self, which: int, frame_s: float) -> RunRate:
        """The rate by one of both clocks."""
        began, times = self.began[which], [clocks[which] for clocks in self.times]
        settled = times[max(0, min(_SETTLED, len(times) // 2, len(times) - 2)) :]
        steps = [later - earlier for earlier, later in pairwise(settled)]
        step_s = statistics.mean(steps) if steps else times[0] - began
        return RunRate(step_s=step_s, begin_s=max(times[0] - began - step_s, 0.0), frame_s=frame_s)


OpenFrames = Callable[[TrainingJob], Mapping[str, Dataset]]
"""Frames of a job's streams that are not opened by its experiment."""


def no_frames(job: TrainingJob) -> Mapping[str, Dataset]:
    """None: all are opened by the experiment."""
    del job
    return {}


@dataclass(frozen=True)
class _SpeedTrial:
    """Takes some steps of a job in a folder that is removed afterwards; the unit's parameters are the job."""

    folder: Path
    steps: int
    batch_share: float
    patience_s: float = _PATIENCE_S
    frames: OpenFrames = no_frames

    memory_bytes, own_process = 4_000_000_000, True

    def __call__(self, unit: Unit) -> UnitResult:
        job: TrainingJob = unit.parameters
        quiet()
        rate = self._rate(job, self.folder / unit.name, min(_GLANCE, self.steps))
        if self.steps > _GLANCE and rate.step_s * self.steps <= self.patience_s:
            rate = self._rate(job, self.folder / unit.name, self.steps)
        return UnitResult(value=replace(rate, step_s=rate.step_s / self.batch_share))

    def _rate(self, job: TrainingJob, folder: Path, steps: int) -> RunRate:
        shutil.rmtree(folder, ignore_errors=True)
        experiment, frames = trial_experiment(job.experiment, steps, self.batch_share), self.frames(job)
        clock = StepClock()
        detector = Detector.load(Plan(experiment, folder, data=frames).run(clock))
        which = 0 if detector.device.type == "cpu" else 1
        rate = clock.rate(which, _frame_s(detector, experiment, job, frames, which))
        shutil.rmtree(folder, ignore_errors=True)
        return rate


def trial_experiment(experiment: Experiment, steps: int, batch_share: float = 1.0) -> Experiment:
    """An experiment of a few steps, in this process, that needs no other run's weights and takes all of its data.

    Args:
        experiment: The experiment.
        steps: Its steps.
        batch_share: Share of its batch that is taken.
    """
    method = {name: value for name, value in experiment.method.model_dump().items() if name != "start"}
    method["name"] = "supervised" if method["name"] == "continued" else method["name"]
    data = experiment.data
    groups = data if isinstance(data, dict) else {"": data}
    groups = {name: group.model_copy(update={"part": (0.0, 1.0)}) for name, group in groups.items()}
    training = {"steps": steps, "workers": 0, "batch_size": round(experiment.training.batch_size * batch_share)}
    changes: dict[str, Any] = {
        "method": MethodConfig.model_validate(method),
        "data": groups if isinstance(data, dict) else groups[""],
        "training": experiment.training.model_copy(update=training),
    }
    return experiment.model_copy(update=changes)


def _frame_s(
    detector: Detector, experiment: Experiment, job: TrainingJob, frames: Mapping[str, Dataset], which: int
) -> float:
    """Seconds to read a frame and detect in it, by one of both clocks."""
    groups = experiment.data if isinstance(experiment.data, dict) else {"": experiment.data}
    config: DataConfig = groups.get("target", next(iter(groups.values())))
    data = next(iter(frames.values()), None)
    if data is None:
        data = DataLocation(path=config.path, split=config.split or "", options=config.options).open()
    cloud = next(cloud for cloud in (*job.clouds, *config.clouds) if cloud in data[0].clouds)
    for count in (_FEW_FRAMES, _FRAMES):
        first, began = data.select(range(min(count, len(data)))), _clocks()[which]
        detect(detector, first, cloud=cloud, annotated_only=True)
        frame_s = (_clocks()[which] - began) / len(first)
        if frame_s > _SLOW_FRAME_S:
            break
    return frame_s


def patience_s(kinds: int) -> float:
    """Seconds that the steps of a trial may take where so many kinds are tried: all of them at most four minutes."""
    return min(_PATIENCE_S, _PATIENCE_OF_ALL_S / max(kinds, 1))


def measure(
    jobs: Sequence[TrainingJob],
    folder: Path,
    options: JobOptions,
    *,
    steps: int = STEPS,
    batch_share: float = 1.0,
    frames: OpenFrames = no_frames,
    report: Callable[[str], object] | None = None,
) -> dict[str, RunRate]:
    """The rate of every kind of job.

    Where steps take long only two are taken. Large batches are measured by a part of them: the time of a step is
    taken to grow with its frames, which is so on a CPU and too much on a GPU.

    Args:
        jobs: The jobs; the first of each kind is tried.
        folder: Where they may write meanwhile.
        options: Workers, as many at a time as later, and progress.
        steps: Steps of each trial.
        batch_share: Share of each batch.
        frames: Gives the frames of a job that its experiment does not open.
        report: Called with a line before it begins.
    """
    kinds = {job.kind: job for job in reversed(jobs)}
    if report is not None and kinds:
        report(f"measuring {count_of(steps, 'step')} of each kind of run: {len(kinds)}")
    units = [Unit(kind, parameters=job) for kind, job in sorted(kinds.items())]
    results = values(_SpeedTrial(folder, steps, batch_share, patience_s(len(units)), frames), units, options)
    return {unit.name: result.value for unit, result in zip(units, results, strict=True)}


def trial_set(simulated: SimulatedSet) -> SimulatedSet:
    """A few frames of a set: enough to measure on."""
    fewer = {"sequences": min(_SEQUENCES, simulated.sequences), "frames": min(2, simulated.frames)}
    return simulated.model_copy(update=fewer)


def measure_simulating(
    locations: Mapping[str, DataLocation],
    needed: Collection[str],
    folder: Path,
    *,
    progress: Callable[[Iterable[int]], Iterable[int]] = iter,
) -> tuple[dict[str, float], dict[str, DataLocation]]:
    """Simulate a few frames of each kind of set, on one core.

    Args:
        locations: The sets.
        needed: Those of which some frames are needed later.
        folder: Where the frames are put; empty, for frames that are there already would seem to cost nothing.
        progress: Shows the frames that are left.

    Returns:
        Core seconds a frame of every simulated set, and the locations of the small sets beside the user's own.
    """
    seconds: dict[str, float] = {}  # sets of one preset and sensors take equally long
    small = {name: location for name, location in locations.items() if location.simulated is None}
    kinds: dict[str, str] = {}
    for name, location in sorted(locations.items(), key=partial(_needed_first, needed)):
        if location.simulated is None:
            continue
        trial = trial_set(location.simulated)
        kind = kinds[name] = f"{trial.preset} {trial.sensors}"
        if kind in seconds and name not in needed:
            continue
        small[name] = replace(location, path=folder / name, simulated=trial)
        simulate_trial = partial(simulate, workers=1, progress=progress, time=location.time)
        if kind not in seconds:  # what a process makes once is no frame's
            simulate_trial(trial.model_copy(update={"sequences": 1, "frames": 1}), folder / f"{name}-first")
        began = time.process_time()
        simulate_trial(trial, small[name].path)
        seconds[kind] = (time.process_time() - began) / (trial.sequences * trial.frames)
    return {name: seconds[kinds[name]] for name in locations if name in kinds}, small


def _needed_first(needed: Collection[str], item: tuple[str, Any]) -> tuple[bool, str]:
    return item[0] not in needed, item[0]

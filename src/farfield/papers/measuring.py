"""Measure before planning: some steps of each kind of run, some frames of each network, some simulated frames."""

import shutil
import statistics
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

from farfield.datasets import Dataset
from farfield.detectors.runtime import Detector
from farfield.evaluation import detect
from farfield.experiments.plan import Plan
from farfield.experiments.schema import DataConfig, Experiment, MethodConfig
from farfield.jobs import JobOptions, Unit, UnitResult, values
from farfield.papers.grid import SimulatedSet
from farfield.papers.jobs import TrainingJob
from farfield.papers.places import DataLocation, simulate
from farfield.papers.running import quiet
from farfield.training.report import TrainingReport

STEPS = 20
"""Steps of each trial."""
SMALL_BATCH = 2
"""Frames a step of one pattern with which trials are made."""
_SEQUENCES = 3  # of a set that is only measured on
_FRAMES, _FEW_FRAMES, _SLOW_FRAME_S = 6, 2, 0.5  # detected in; fewer where one takes so long
_GLANCE = 2  # steps that show whether there is time for more
_PATIENCE_S, _PATIENCE_OF_ALL_S = 60.0, 240.0  # for the steps of the trial of a kind, and of all kinds
_SETTLED = 8  # steps until the allocator and the caches have settled


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


Moment = tuple[float, float]
"""The processor's time of this process, and that of the wall, seconds."""


def _now() -> Moment:
    return time.process_time(), time.perf_counter()


class StepClock(TrainingReport):
    """Notes when steps were done."""

    def __init__(self) -> None:
        self.began, self.times = _now(), list[Moment]()

    def step(self, step: int, losses: dict[str, float]) -> None:
        """Note the moment."""
        del step, losses
        self.times.append(_now())

    def pace(self, which: int, frame_s: float) -> RunRate:
        """The pace by one of both clocks."""
        began, times = self.began[which], [moment[which] for moment in self.times]
        settled = times[max(0, min(_SETTLED, len(times) // 2, len(times) - 2)) :]
        steps = [later - earlier for earlier, later in pairwise(settled)]
        step_s = statistics.mean(steps) if steps else times[0] - began
        return RunRate(step_s=step_s, begin_s=max(times[0] - began - step_s, 0.0), frame_s=frame_s)


@dataclass(frozen=True)
class _SpeedTrial:
    """Takes some steps of a job in a folder that is removed afterwards; the unit's parameters are the job."""

    folder: Path
    steps: int
    batch_share: float
    patience_s: float = _PATIENCE_S

    memory_bytes, own_process = 4_000_000_000, True

    def __call__(self, unit: Unit) -> UnitResult:
        job: TrainingJob = unit.parameters
        quiet()
        pace = self._pace(job, self.folder / unit.name, min(_GLANCE, self.steps))
        if self.steps > _GLANCE and pace.step_s * self.steps <= self.patience_s:
            pace = self._pace(job, self.folder / unit.name, self.steps)
        return UnitResult(value=replace(pace, step_s=pace.step_s / self.batch_share))

    def _pace(self, job: TrainingJob, folder: Path, steps: int) -> RunRate:
        shutil.rmtree(folder, ignore_errors=True)
        experiment, clock = short(job.experiment, steps, self.batch_share), StepClock()
        detector = Detector.load(Plan(experiment, folder).run(clock))
        which = 0 if detector.device.type == "cpu" else 1
        pace = clock.pace(which, _frame_s(detector, experiment, job, which))
        shutil.rmtree(folder, ignore_errors=True)
        return pace


def short(experiment: Experiment, steps: int, batch_share: float = 1.0) -> Experiment:
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
    whole = {name: group.model_copy(update={"part": (0.0, 1.0)}) for name, group in groups.items()}
    training = {"steps": steps, "workers": 0, "batch_size": round(experiment.training.batch_size * batch_share)}
    changes: dict[str, Any] = {
        "method": MethodConfig.model_validate(method),
        "data": whole if isinstance(data, dict) else whole[""],
        "training": experiment.training.model_copy(update=training),
    }
    return experiment.model_copy(update=changes)


def _frame_s(detector: Detector, experiment: Experiment, job: TrainingJob, which: int) -> float:
    """Seconds to read a frame and detect in it, by one of both clocks."""
    groups = experiment.data if isinstance(experiment.data, dict) else {"": experiment.data}
    config: DataConfig = groups.get("target", next(iter(groups.values())))
    data = DataLocation(path=config.path, split=config.split or "", options=config.options).opened()
    cloud = next(cloud for cloud in (*job.clouds, *config.clouds) if cloud in data[0].clouds)
    for count in (_FEW_FRAMES, _FRAMES):
        first, began = _first(data, count), _now()[which]
        detect(detector, first, cloud=cloud, annotated_only=True)
        frame_s = (_now()[which] - began) / len(first)
        if frame_s > _SLOW_FRAME_S:
            break
    return frame_s


def patience_s(kinds: int) -> float:
    """Seconds that the steps of a trial may take where so many kinds are tried: all of them at most four minutes."""
    return min(_PATIENCE_S, _PATIENCE_OF_ALL_S / max(kinds, 1))


def _first(data: Dataset, count: int) -> Dataset:
    return data.select(range(min(count, len(data))))


def measure(
    jobs: Sequence[TrainingJob],
    folder: Path,
    bulk: JobOptions,
    *,
    steps: int = STEPS,
    batch_share: float = 1.0,
    said: Callable[[str], object] | None = None,
) -> dict[str, RunRate]:
    """The pace of every kind of job.

    Where steps take long only two are taken. Large batches are measured by a part of them: the time of a step is
    taken to grow with its frames, which is so on a CPU and too much on a GPU.

    Args:
        jobs: The jobs; the first of each kind is tried.
        folder: Where they may write meanwhile.
        bulk: Who does it: as many at a time as later.
        steps: Steps of each trial.
        batch_share: Share of each batch.
        said: Called with a line before it begins.
    """
    kinds = {job.kind: job for job in reversed(jobs)}
    if said is not None and kinds:
        said(f"measuring {steps} steps of each kind of run: {len(kinds)}")
    units = [Unit(kind, parameters=job) for kind, job in sorted(kinds.items())]
    found = values(_SpeedTrial(folder, steps, batch_share, patience_s(len(units))), units, bulk)
    return {unit.name: done.value for unit, done in zip(units, found, strict=True)}


def little(wanted: SimulatedSet) -> SimulatedSet:
    """A few frames of a set: enough to measure on."""
    return wanted.model_copy(update={"sequences": min(_SEQUENCES, wanted.sequences), "frames": min(2, wanted.frames)})


def measure_simulating(
    places: Mapping[str, DataLocation],
    needed: Collection[str],
    folder: Path,
    *,
    progress: Callable[[Iterable[int]], Iterable[int]] = iter,
) -> tuple[dict[str, float], dict[str, DataLocation]]:
    """Simulate a few frames of each kind of set, on one core.

    Args:
        places: The sets.
        needed: Those of which some frames are needed later.
        folder: Where the frames are put; empty, for frames that are there already would seem to cost nothing.
        progress: Shows the frames that are left.

    Returns:
        Core seconds a frame of every simulated set, and the places of the small sets beside the user's own.
    """
    seconds: dict[str, float] = {}  # sets of one preset and sensors take as long
    small = {name: place for name, place in places.items() if place.simulated is None}
    simulated = {name: place.simulated for name, place in places.items() if place.simulated is not None}
    for name, whole in sorted(simulated.items(), key=partial(_needed_first, needed)):
        wanted, kind = little(whole), f"{whole.preset} {whole.sensors}"
        if kind in seconds and name not in needed:
            continue
        small[name] = DataLocation(path=folder / name, simulated=wanted, options=places[name].options)
        if kind not in seconds:  # what a process makes once is no frame's
            one = wanted.model_copy(update={"sequences": 1, "frames": 1})
            simulate(one, folder / f"{name}-first", workers=1, progress=progress)
        began = time.process_time()
        simulate(wanted, small[name].path, workers=1, progress=progress)
        seconds[kind] = (time.process_time() - began) / (wanted.sequences * wanted.frames)
    return {name: seconds.get(f"{each.preset} {each.sensors}", 0.0) for name, each in simulated.items()}, small


def _needed_first(needed: Collection[str], item: tuple[str, Any]) -> tuple[bool, str]:
    return item[0] not in needed, item[0]

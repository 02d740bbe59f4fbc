"""Training in rounds: a teacher's pseudo boxes teach for a fixed number of steps, then its student is the teacher."""

import os
import statistics
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from farfield.adaptation.pseudo_labels import levels, scores_of, split_by_score, threshold_text
from farfield.datasets import Dataset
from farfield.errors import ConfigError, FarfieldError
from farfield.experiments.adapting.options import AdaptationOptions, CalibratedThresholds
from farfield.experiments.adapting.source import TrainingHistory
from farfield.experiments.plan import Plan
from farfield.experiments.schema import DataConfig, Experiment, experiment_of
from farfield.frame import Boxes, Key
from farfield.training.report import TrainingReport
from farfield.vocabulary.counts import count_of

if TYPE_CHECKING:
    from farfield.detectors.runtime import Detector
    from farfield.simulation.recording.options import Recording

_SHARE, _MOST, _LEAST = 0.25, 1000, 100  # of the source's steps, and the bounds of that
_FEWEST = 20  # steps of a round
_RARE = 20  # confident pseudo-labels of a class in the whole target
_MEASURED = 6
_MARGIN = 0.9  # of the time that is left
_SOUNDED = 5  # frames of which the points' heights are compared
_INHERITED = ("batch_size", "weight_decay", "gradient_clip", "min_points", "far_sampling", "far_from_m")


def steps_wanted(choices: AdaptationOptions, learnt: TrainingHistory) -> int:
    """Steps of a round, where time sets no limit."""
    total = choices.steps or min(_MOST, max(_LEAST, round(_SHARE * learnt.steps)))
    return max(1, total // choices.rounds)


def steps_in(seconds: float, step_s: float, choices: AdaptationOptions, most: int) -> int:
    """Steps of a round for which the time suffices.

    Raises:
        ConfigError: If it suffices for fewer than 20, or than ``most``: so few move a network's statistics and teach
            it next to nothing, which makes it worse.
    """
    fitting = int(_MARGIN * seconds / step_s / choices.rounds)
    least = min(most, _FEWEST)
    if fitting < least:
        raise ConfigError(
            f"--minutes: expected enough for {count_of(least, 'step')} in each "
            f"of {choices.rounds} rounds; of {choices.minutes:g} "
            f"minutes {max(seconds, 0):.0f} s are left for training, and a step takes {step_s:.1f} s. Give more "
            "minutes, or fewer --frames and --source-frames."
        )
    return min(most, fitting)


def check_minutes(
    choices: AdaptationOptions, sweep_s: float, sweeps: int, frame_s: float, simulated: int, most: int
) -> None:
    """See that the minutes can suffice, before the work: what is left for training counts later.

    Args:
        choices: What was chosen.
        sweep_s: Time in which the detector searches a sweep, seconds; other processes at best halve it.
        sweeps: Sweeps that are searched, in all.
        frame_s: Time in which a source frame is simulated by one core, seconds.
        simulated: Frames that are to be simulated.
        most: Steps of a round, where time sets no limit.

    Raises:
        ConfigError: If even searching, simulating and the fewest steps that are worth it would last longer.
    """
    steps = min(most, _FEWEST)
    least_s = 0.5 * sweep_s * sweeps + frame_s * simulated / (os.cpu_count() or 1) + sweep_s * steps * choices.rounds
    if least_s <= 60 * choices.minutes:
        return
    work = f"{count_of(simulated, 'frame')} to simulate, {count_of(sweeps, 'sweep')} to search"
    raise ConfigError(
        f"--minutes: expected enough for {work} and {count_of(steps, 'step')} "
        f"in each of {choices.rounds} rounds, about "
        f"{least_s / 60:.2g} minutes or more on this machine; got {choices.minutes:g}. Give more minutes, or fewer "
        "--frames, --source-frames or --rounds."
    )


def simulated_frame_s(recording: "Recording") -> float:
    """Time in which this machine simulates a frame whose road is made already, seconds."""
    from farfield.simulation.sequence import simulate_frame

    clock_s = []
    for index in sorted({0, min(1, recording.plan[0] - 1)}):
        begun = time.perf_counter()
        simulate_frame(recording.preset, seed=recording.seed, sequence=0, index=index, sensors=recording.sensors)
        clock_s.append(time.perf_counter() - begun)
    return clock_s[-1] if len(clock_s) > 1 else 0.0  # a first frame also makes its road


def experiment_of_round(
    start: Path | str,
    detector: "Detector",
    learnt: TrainingHistory,
    data: Mapping[str, DataConfig],
    calibration: CalibratedThresholds,
    choices: AdaptationOptions,
    number: int,
    boxes: Mapping[Key, Boxes],
) -> Experiment:
    """The training of a round.

    Args:
        start: Weights to go on from: the round's teacher.
        detector: The detector that is adapted.
        learnt: What it learnt from.
        data: Settings of the streams ``source``, ``target``, ``labels`` where labelled sweeps teach, and ``donors``
            where simulated road users in the sweeps do.
        calibration: Thresholds and steps.
        choices: What was chosen.
        number: Number of the round, from 1.
        boxes: What the round's teacher detected in the target.
    """
    training = {name: learnt.training[name] for name in _INHERITED if name in learnt.training}
    training |= {"learning_rate": 0.5 * float(learnt.training.get("learning_rate", 2e-3)), "steps": calibration.steps}
    # as many of source and target; of labelled frames as many as of both; of donors as many as of one
    parts = 2 + 2 * ("labels" in data) + ("donors" in data)
    training["batch_size"] = max(parts, parts * (int(training.get("batch_size", 4)) // parts))
    lowest = float(detector.config.score_threshold)
    rare = dict.fromkeys(rare_classes(boxes, calibration), lowest)
    method: dict[str, Any] = {"positive": calibration.positive, "negative": {**calibration.negative, **rare}}
    method |= {name: True for name in ("labels", "donors") if name in data}
    if choices.whole_bodies and number == 1:  # the teacher still draws visible parts: the source's labels teach alone
        method["weight"] = 0.0
    tree: dict[str, Any] = {
        "name": f"round-{number}",
        "data": {name: config.model_dump(mode="json") for name, config in data.items()},
        "method": {"name": "teacher", "start": str(start), "norm": "per_domain", **method},
        "detector": detector.config.model_dump(mode="json"),
        "augmentation": dict(learnt.augmentation),
        "training": {**training, "seed": choices.seed + number},
    }
    return experiment_of(tree, choices.overrides, where="adapt")


class StepTimer(TrainingReport):
    """Measures steps; says nothing."""

    def __init__(self) -> None:
        self.times: list[float] = []

    def step(self, step: int, losses: dict[str, float]) -> None:
        """Look at the clock."""
        del step, losses
        self.times.append(time.perf_counter())

    @property
    def step_s(self) -> float:
        """Median time of a step; the first ones, which start the workers, do not count."""
        return statistics.median(np.diff(self.times[1:]).tolist())


def measured_step_s(experiment: Experiment, data: Mapping[str, Dataset], folder: Path) -> float:
    """Time of a training step on this machine, seconds: a few are taken, and what they wrote is removed."""
    clock = StepTimer()
    training = experiment.training.model_copy(update={"steps": _MEASURED})
    with tempfile.TemporaryDirectory(prefix=".measured-", dir=folder) as path:
        Plan(experiment.model_copy(update={"training": training}), Path(path), data).run(clock)
    return clock.step_s


def rare_classes(boxes: Mapping[Key, Boxes], calibration: CalibratedThresholds) -> tuple[str, ...]:
    """Classes with too few confident pseudo-labels in the target: what is detected of them is ignored.

    Were their boxes of middling score background, as those of other classes are, a round would unlearn them.
    """
    count = dict.fromkeys(calibration.positive, 0)
    for frame_boxes in boxes.values():
        for name in np.asarray(_confident(frame_boxes, calibration.positive).label):
            count[str(name)] += 1
    return tuple(name for name, number in count.items() if number < _RARE)


def pseudo_label_rates(boxes: Mapping[Key, Boxes], calibration: CalibratedThresholds) -> tuple[float, float]:
    """Confident pseudo-labels and ignored boxes a frame."""
    confident = ignored = 0
    for frame_boxes in boxes.values():
        parts = split_by_score(frame_boxes, calibration.positive, calibration.negative)
        confident, ignored = confident + len(parts.confident), ignored + len(parts.ignored)
    return confident / max(len(boxes), 1), ignored / max(len(boxes), 1)


def _confident(boxes: Boxes, positive: Mapping[str, float]) -> Boxes:
    """The boxes whose scores make them objects."""
    return boxes[scores_of(boxes) >= levels(dict(positive), boxes.label)]


@dataclass(frozen=True, eq=False)
class ConfidentBoxes(Mapping[Key, Boxes]):
    """The boxes whose scores make them objects, by frame, with their scores: those of a frame when it is asked for.

    Args:
        boxes: All boxes by frame; they may lie on the disk.
        positive: Score from which a box is an object, by class.
    """

    boxes: Mapping[Key, Boxes]
    positive: Mapping[str, float]

    def __getitem__(self, key: Key) -> Boxes:
        """Those of a frame."""
        return _confident(self.boxes[key], self.positive)

    def __iter__(self) -> Iterator[Key]:
        return iter(self.boxes)

    def __len__(self) -> int:
        return len(self.boxes)


def check_round(
    boxes: Mapping[Key, Boxes],
    calibration: CalibratedThresholds,
    number: int,
    data: Mapping[str, Dataset],
    clouds: Mapping[str, str],
) -> None:
    """See that a round has something to learn from.

    Args:
        boxes: What its teacher detected in the target.
        calibration: Thresholds.
        number: Number of the round, from 1.
        data: Frames of ``source`` and ``target``.
        clouds: Which cloud was searched in each.

    Raises:
        FarfieldError: If there is no pseudo box.
    """
    if pseudo_label_rates(boxes, calibration)[0]:
        return
    best = max((float(scores_of(frame_boxes).max()) for frame_boxes in boxes.values() if len(frame_boxes)), default=0.0)
    low = {name: _low_m(data[name], clouds[name]) for name in ("source", "target")}
    raise FarfieldError(
        f"adapt: round {number} has no pseudo box: in {count_of(len(boxes), 'frame')} of the target no score reaches "
        f"{threshold_text(calibration.positive)}; the best is {best:.2f}, and the source has "
        f"{calibration.source_rate:.1f} confident boxes a sweep. The lowest tenth of the points lies below "
        f"{low['target']:.1f} m in the target and {low['source']:.1f} m in the source: where these differ by more "
        "than half a metre, or the car looks along another axis, move the clouds into the coordinates that the "
        "detector learnt in. Else it does not see this sensor at all: take another detector, or label some sweeps and "
        "name their labels (--learn-from)."
    )


def _low_m(data: Dataset, cloud: str) -> float:
    """Height below which a tenth of the points of some frames lies."""
    numbers = np.unique(np.linspace(0, len(data) - 1, _SOUNDED).astype(int))
    z_m = np.concatenate([data[int(number)].cloud(cloud).points_m[:, 2] for number in numbers])
    z_m = z_m[np.isfinite(z_m)]
    return float(np.quantile(z_m, 0.1)) if len(z_m) else float("nan")

"""A training in stages, each kept in its folder, so that the same call goes on where it was killed.

Learn; collect what is taken for objects where none is; learn on with that pasted as background; calibrate the scores.
The settings with which it was begun stand in the folder: stages of two settings are not mixed.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from farfield.datasets import Dataset
from farfield.datasets.class_mapping import Classes
from farfield.detectors.runtime import Detector
from farfield.errors import ConfigError
from farfield.experiments.calibrating import calibrate_scores
from farfield.experiments.frames import held_out, open_frames, spread
from farfield.experiments.plan import Plan
from farfield.experiments.schema import DataConfig, Experiment
from farfield.files.atomic import write_text
from farfield.files.json_text import read_json
from farfield.simulation.recording import ensure
from farfield.training.checkpoints import flatten
from farfield.training.method import Stream
from farfield.training.negatives import mine, save_negatives
from farfield.training.report import TrainingReport
from farfield.vocabulary.classes import CLUTTER

FIRST, NEGATIVES, SECOND, DONE = "first", "negatives.json", "second", "calibration.txt"
"""What stands in the folder of a staged training, in this order; the weights are those of the second run."""
SETTINGS = "settings.json"
"""Holds the experiment and the stages with which the training was begun."""
_NAMED = 5  # settings in a message


@dataclass(frozen=True, kw_only=True)
class StagedTraining:
    """How a training is staged.

    Args:
        first: Share of the steps before false boxes are mined.
        clutter: Mined pieces of background pasted into a frame.
        mined_frames: Frames of each stream that are looked through.
        held_frames: Frames of each simulated stream that are learnt from by none of the runs, for the calibration.
        least_score: Score from which a false box counts.
    """

    first: float = 0.5
    clutter: int = 4
    mined_frames: int = 300
    held_frames: int = 60
    least_score: float = 0.2


def train_in_stages(
    experiment: Experiment, folder: Path, stages: StagedTraining | None = None, report: TrainingReport | None = None
) -> Path:
    """Train a detector in stages; called again with the same arguments, it goes on.

    Args:
        experiment: What to train, with data by stream; its ``training.start`` is that of the first run.
        folder: Receives the runs and what lies between them.
        stages: How it is staged.
        report: Is informed of the course.

    Returns:
        The path of the calibrated weights.

    Raises:
        ConfigError: If the experiment has fewer than two steps, or the folder holds stages of other settings.
        FileFormatError: If the file of the settings is damaged.
    """
    stages, report = stages or StagedTraining(), report or TrainingReport()
    steps, groups = experiment.training.steps, _groups(experiment)
    before = round(steps * stages.first)
    if not 0 < before < steps:
        raise ConfigError(f"{experiment.name}: expected at least two steps to train in stages, got {steps}.")
    _check_settings(folder, {"experiment": experiment.model_dump(mode="json"), "stages": asdict(stages)})
    weights = folder / SECOND / "weights.safetensors"
    if (folder / DONE).is_file():
        report.say(f"{weights}: done before, {(folder / DONE).read_text(encoding='utf-8').strip()}")
        return weights
    for config in groups.values():
        ensure(config.simulate, config.path, partial(report.reading, what="simulating"), report.say)
    # Learn, on all frames but some of each simulated stream
    learnt = _changed(experiment, f"{experiment.name}-first", steps=before)
    first = folder / FIRST / "weights.safetensors"
    if not first.is_file():
        Plan(learnt, folder / FIRST, data=_parts(learnt, stages)[0]).run(report)
    # Mine what is taken for objects
    negatives = folder / NEGATIVES
    if not negatives.is_file():
        save_negatives(negatives, _mined(first, learnt, stages, report))
    # Learn on, with that pasted beside the objects
    pasted = {**experiment.augmentation.pasted, CLUTTER: stages.clutter}
    start = {"weights": str(first), "freeze": ()}
    other = experiment.training.seed + 1  # the first half's batches are not drawn again
    further = _changed(experiment, experiment.name, steps=steps - before, start=start, negatives=negatives, seed=other)
    further = further.model_copy(update={"augmentation": experiment.augmentation.model_copy(update={"pasted": pasted})})
    if not weights.is_file():
        Plan(further, folder / SECOND, data=_parts(further, stages)[0]).run(report)
    # Calibrate on what was held out
    held = [
        (data.mapped(Classes(groups[name].aliases)), clouds[0])
        for name, data in _parts(further, stages)[1].items()
        if isinstance(clouds := groups[name].clouds, tuple)
    ]
    summary = calibrate_scores(weights, held) if held else "not calibrated: no frames of one cloud are held out"
    report.say(f"scores: {summary}")
    write_text(folder / DONE, f"{summary}\n")
    return weights


def _check_settings(folder: Path, settings: Mapping[str, Any]) -> None:
    """Write the settings into a new folder; refuse one that was begun with others."""
    path, anew = folder / SETTINGS, "Name another folder, or remove this one to begin anew."
    if path.is_file():
        before, now = dict(flatten(read_json(path))), dict(flatten(json.loads(json.dumps(settings))))
        names = sorted(name for name in {**before, **now} if before.get(name) != now.get(name))
        if names:
            changes = "; ".join(f"{name} was {before.get(name)!r}, is {now.get(name)!r}" for name in names[:_NAMED])
            raise ConfigError(f"{folder}: expected what was begun there, got other settings: {changes}. {anew}")
        return
    present = [name for name in (FIRST, NEGATIVES, SECOND, DONE) if (folder / name).exists()]
    if present:
        raise ConfigError(
            f"{folder}: expected the settings of its stages in {SETTINGS}, found {present[0]} without them: nothing "
            f"tells what it was trained with. {anew}"
        )
    folder.mkdir(parents=True, exist_ok=True)
    write_text(path, json.dumps(settings, indent=1) + "\n")


def _changed(experiment: Experiment, name: str, **training: Any) -> Experiment:
    """The experiment under a name, with other settings of its loop."""
    tree = experiment.model_dump(mode="json")
    tree["name"] = name
    tree["training"] |= {name: str(value) if isinstance(value, Path) else value for name, value in training.items()}
    return Experiment.model_validate(tree)


def _groups(experiment: Experiment) -> Mapping[str, DataConfig]:
    if isinstance(experiment.data, DataConfig):
        raise ConfigError(f"{experiment.name}: expected data of several streams by name, as of the method mixed.")
    return experiment.data


def _parts(experiment: Experiment, stages: StagedTraining) -> tuple[dict[str, Dataset], dict[str, Dataset]]:
    """Frames of each stream that are learnt from, and those of the simulated ones that are held out."""
    learnt: dict[str, Dataset] = {}
    held: dict[str, Dataset] = {}
    for name, config in _groups(experiment).items():
        data = open_frames(config, Stream(), experiment)
        if config.donors is None:
            learnt[name], part = held_out(data, min(stages.held_frames, len(data) // 5))
            held |= {} if part is None else {name: part}
        else:
            learnt[name] = data
    return learnt, held


def _mined(weights: Path, experiment: Experiment, stages: StagedTraining, report: TrainingReport) -> dict[str, Any]:
    """False boxes of each stream's frames."""
    mined = {}
    for name, data in _parts(experiment, stages)[0].items():
        clouds = _groups(experiment)[name].clouds
        detector = Detector.load(weights, cloud=clouds[0] if isinstance(clouds, tuple) else None)
        chosen = data.select(spread(len(data), stages.mined_frames))
        mined[name] = mine(detector, chosen, least_score=stages.least_score)
        count = sum(map(len, mined[name].values()))
        report.say(f"{name}: {count} false boxes in {len(chosen)} frames")
    return mined

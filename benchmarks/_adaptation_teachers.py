"""Teachers of adaptation.py: their thresholds, and the remedies that were tried where they closed no gap."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from farfield.detectors.runtime import Detector
from farfield.evaluation import as_trained, detect
from farfield.frame import Boxes, Cloud, Frame, Key
from farfield.metrics.score_calibration import thresholds_of
from farfield.papers.jobs import TrainingJob
from farfield.papers.locations import DataLocation
from farfield.papers.running import WEIGHTS
from farfield.training.config import WeatherConfig
from farfield.training.weather import draw_weather, holding, lay_over

_COLUMNS = ("x_m", "y_m", "z_m", "intensity")
_SEED = 1065


@dataclass(frozen=True, kw_only=True)
class Remedy:
    """What a row does otherwise than the plain teacher.

    Args:
        background: Whether boxes with a low score are background; else all that the teacher finds at all is ignored:
            what sleet hides half has a low score.
        laid: Thresholds are taken from source frames with weather laid over them, where scores are lower.
        times: So many times the steps.
    """

    background: bool = True
    laid: bool = False
    times: int = 1


REMEDIES: Mapping[str, Remedy] = {
    "teacher_unsure": Remedy(background=False),
    "teacher_laid": Remedy(background=False, laid=True),
    "teacher_long": Remedy(background=False, laid=True, times=4),
    "statistics_long": Remedy(background=False, laid=True, times=4),
    "continued_long": Remedy(times=4),
}


def remedy_of(job: TrainingJob) -> Remedy:
    """That of a job's row, by its name without the sensor."""
    return REMEDIES.get(job.runs[0].partition("_")[2], Remedy())


def thresholds(job: TrainingJob, runs: Path, val: DataLocation) -> dict[str, dict[str, float]]:
    """A teacher's thresholds, from what its start's detector finds in source frames."""
    weights, remedy = runs / job.start / WEIGHTS, remedy_of(job)
    detector, (cloud,) = Detector.load(weights), job.clouds
    if remedy.laid:
        config = WeatherConfig.model_validate(job.experiment.method.settings["strong"]["weather"])
        found, truth = _found_in_weather(detector, val, cloud, config)
    else:
        journal = weights.parent / f"found-val-{cloud}.jsonl"  # that of the scoring
        seen = detect(detector, val.open(), cloud=cloud, annotated_only=True, journal=journal)
        found, truth = dict(seen.boxes), {key: each.boxes for key, each in seen.annotations.items()}
    lowest = detector.config.score_threshold
    limits = thresholds_of(found, truth, detector.config.class_names, lowest=lowest)
    negative = limits.negative if remedy.background else dict.fromkeys(limits.negative, lowest)
    return {"positive": limits.positive, "negative": negative}


def _found_in_weather(
    detector: Detector, val: DataLocation, cloud: str, config: WeatherConfig
) -> tuple[dict[Key, Boxes], dict[Key, Boxes]]:
    """What is found, and what is to be found, in frames that each have one kind of weather laid over them."""
    data, found, truth = as_trained(val.open(), detector.info), {}, {}
    always = config.model_copy(update={"probability": 1.0})
    for number in range(len(data)):
        frame, rng = data[number], np.random.default_rng((_SEED, number))
        laid, boxes = draw_weather(always, rng), frame.boxes
        if laid is None or boxes is None:
            continue
        rows = np.column_stack([frame.cloud(cloud).column(name) for name in _COLUMNS])
        changed, kept = lay_over(rows, _COLUMNS, always, laid, rng)
        found[frame.key] = detector.with_cloud(cloud)(_with_cloud(frame, cloud, changed))
        truth[frame.key] = boxes[holding(rows[:, :3], rows[kept, :3], boxes)]
    return found, truth


def _with_cloud(frame: Frame, name: str, rows: np.ndarray) -> Frame:
    return replace(frame, clouds={name: Cloud(points_m=rows[:, :3], intensity=np.clip(rows[:, 3], 0, 1))})

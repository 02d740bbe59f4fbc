"""``farfield adapt``: self-training of a detector on unlabelled sweeps, from beginning to end, resumable.

The order of work: look at the detector and at one target frame; source frames, simulated if need be; thresholds from
the source's scores; search of the target; rounds of training, each with a fixed last step; search; weights and page.
What is done is kept in the folder, so that the same command goes on where it was killed, to the same bits. Labels of
the target, if there are any, decide nothing.
"""

import re
import shutil
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from farfield.datasets import Dataset, open_dataset
from farfield.errors import ConfigError
from farfield.experiments.adapting.job import PAGE, SCORES, WEIGHTS, AdaptationJob, AdaptationResult
from farfield.experiments.adapting.settings import SETTLED, choices_of
from farfield.experiments.adapting.source import FOLDER
from farfield.jobs import JobOptions
from farfield.training.report import TrainingReport

_OURS = re.compile(rf"{SETTLED}|{WEIGHTS}|{PAGE}|{SCORES}|{FOLDER}|round-\d+|\.(found|measured)-.*|\..*\.part")


def adapt(
    detector: str | Path,
    data: Path | str | Dataset,
    *,
    out: Path | str,
    source: Path | str | None = None,
    labels: Path | str | Dataset | None = None,
    bulk: JobOptions | None = None,
    report: TrainingReport | None = None,
    overwrite: bool = False,
    **choices: Any,
) -> AdaptationResult:
    """Adapt a detector to unlabelled sweeps by self-training.

    Args:
        detector: A bundled detector's name, a run's folder or a weights file.
        data: The sweeps: a data set's folder, or one that is open. Annotations are not looked at.
        out: Folder of the adaptation; called again with the same arguments, it goes on there.
        source: Labelled frames like those that the detector learnt from; by default they are simulated, from the preset
            that the weights' provenance names, without camera.
        labels: Labelled frames on which the detector is scored before and after, at the end: they decide nothing. Those
            that are learnt from do not count, so that the sweeps' own data set may be named.
        bulk: Who detects; this process unless given.
        report: Is informed of the course.
        overwrite: Begin anew; simulated source frames stay.
        **choices: See :class:`Choices`: ``frames``, ``source_frames``, ``clouds``, ``rounds``, ``steps``, ``minutes``,
            ``overrides``, ``whole_bodies``, ``seed``.

    Raises:
        ConfigError: If a choice does not fit, the weights do not say what they learnt from or cannot ignore boxes, no
            cloud suits the detector, the folder holds something else, or no labelled frame is left to score on.
        DatasetError: If there are no frames.
        FarfieldError: If there are no such weights, or a round yields no pseudo box.
    """
    folder = Path(out)
    job = _job(detector, data, folder, source, labels, bulk, report, choices)
    folder.mkdir(parents=True, exist_ok=True)
    if overwrite:
        clear(folder)
    return job.run()


def rehearsed(
    detector: str | Path,
    data: Path | str | Dataset,
    *,
    out: Path | str,
    source: Path | str | None = None,
    labels: Path | str | Dataset | None = None,
    **choices: Any,
) -> list[str]:
    """What :func:`adapt` would do, in lines, checked as far as it is before anything is written; writes nothing.

    Args:
        detector: As of ``adapt``, and so the others.
        data: The sweeps.
        out: Folder of the adaptation.
        source: Labelled frames.
        labels: Labelled frames to score on.
        **choices: See :class:`Choices`.

    Raises:
        ConfigError, DatasetError, FarfieldError: As ``adapt`` before it begins.
    """
    return _job(detector, data, Path(out), source, labels, None, None, choices).rehearsed()


def _job(
    detector: str | Path,
    data: Path | str | Dataset,
    folder: Path,
    source: Path | str | None,
    labels: Path | str | Dataset | None,
    bulk: JobOptions | None,
    report: TrainingReport | None,
    choices: Mapping[str, Any],
) -> AdaptationJob:
    """The work, checked; nothing is written."""
    began = time.monotonic()
    job = AdaptationJob(
        start=str(detector),
        given=None if source is None else Path(source),
        data=data if isinstance(data, Dataset) else open_dataset(data),
        folder=folder,
        choices=choices_of(choices),
        bulk=bulk or JobOptions(),
        report=report or TrainingReport(),
        began=began,
        labels=labels if labels is None or isinstance(labels, Dataset) else open_dataset(labels),
    )
    check_folder(folder)
    job.check()
    return job


def clear(folder: Path) -> None:
    """Remove what an adaptation left in its folder, but not the source frames that it simulated."""
    for path in folder.iterdir():
        if path.is_file():
            path.unlink()
        elif path.name != FOLDER:
            shutil.rmtree(path)


def check_folder(folder: Path) -> None:
    """See that a folder is an adaptation's, or empty, or absent: nothing else is written over or removed.

    Raises:
        ConfigError: If it holds something else.
    """
    names = {path.name for path in folder.iterdir()} if folder.exists() else set()
    strange = sorted(name for name in names if not _OURS.fullmatch(name))
    if WEIGHTS in names and SETTLED not in names:
        strange.append(WEIGHTS)
    if strange:
        raise ConfigError(
            f"{folder}: expected an empty or absent folder, or one that farfield adapt began; it holds "
            f"{', '.join(strange[:4])}. Name another folder with --out."
        )

"""The page of a run: from its folder, finished or not."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from farfield.adaptation.failure_modes import diagnose_log
from farfield.experiments.plan import LOG_NAME, logged
from farfield.experiments.schema import Experiment, load_experiment
from farfield.frame.provenance import environment
from farfield.pages.training_pages import CoursePage, write_course

PAGE_NAME = "course.html"


def is_run(folder: Path) -> bool:
    """Whether a folder is that of a training that has logged something."""
    return (folder / LOG_NAME).is_file() and (folder / "experiment.yaml").is_file()


def course_of(folder: Path, out: Path | None = None, *, title: str = "") -> Path:
    """Write the page of a run: curves of its log, failure modes that they show, settings.

    Args:
        folder: The run's folder, finished or not.
        out: The page; ``course.html`` in the folder unless given.
        title: Its title; the run's name unless given.

    Raises:
        ConfigError: If its experiment is not to be read.
    """
    experiment, rows = load_experiment(folder / "experiment.yaml"), logged(folder)
    adapting = experiment.method.name != "supervised"  # which has nothing that goes wrong so
    page = CoursePage(
        title=title or f"Training {experiment.name}",
        steps=experiment.training.steps,
        rows=rows,
        signs=tuple(diagnose_log(rows)) if adapting else (),
        settings=_settings(experiment),
    )
    return write_course(out or folder / PAGE_NAME, page)


def _settings(experiment: Experiment) -> dict[str, Any]:
    tree = experiment.model_dump(mode="json")
    groups: Mapping[str, Any] = tree["data"] if "path" not in tree["data"] else {"data": tree["data"]}
    data = {name: f"{one['path']}, {', '.join(map(str, one['clouds']))}" for name, one in groups.items()}
    method = {f"method.{name}": value for name, value in tree["method"].items()}
    training = {f"training.{name}": value for name, value in tree["training"].items() if value not in (None, {}, [])}
    return {"detector": tree["detector"]["name"], **data, **method, **training, **environment()}

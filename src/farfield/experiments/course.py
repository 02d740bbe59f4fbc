"""The page of a run: from its folder, finished or not."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from farfield.adaptation.failure_modes import diagnose_log
from farfield.errors import FileFormatError, plain
from farfield.experiments.plan import LOG_NAME, logged, taken_out_text
from farfield.experiments.schema import Experiment, load_experiment
from farfield.files.json_text import read_json
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
        title: Its title (default: the run's name).

    Raises:
        ConfigError: If its experiment is not to be read.
        FileFormatError: If its log or its provenance is damaged.
    """
    experiment, rows = load_experiment(folder / "experiment.yaml"), logged(folder)
    adapting = experiment.method.name != "supervised"  # which has nothing that goes wrong so
    page = CoursePage(
        title=title or f"Training {experiment.name}",
        steps=experiment.training.steps,
        rows=rows,
        signs=tuple(diagnose_log(rows)) if adapting else (),
        settings={**_settings(experiment), **_recorded(folder)},
    )
    return write_course(out or folder / PAGE_NAME, page)


def _recorded(folder: Path) -> dict[str, Any]:
    """Where it ran, which frames were validated on, and how many were taken out for that."""
    path = folder / "provenance.json"
    try:
        record = read_json(path) if path.is_file() else {}
        own = dict(record.get("environment") or {})
        return own | ({"validation": taken_out_text(record)} if record.get("held_out") else {})
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        fix = "Run the training's command again: it writes the file anew."
        expected = "the provenance of a training"
        raise FileFormatError(path, where="the file", expected=expected, got=plain(error), fix=fix) from error


def _settings(experiment: Experiment) -> dict[str, Any]:
    tree = experiment.model_dump(mode="json")
    groups: Mapping[str, Any] = tree["data"] if "path" not in tree["data"] else {"data": tree["data"]}
    data = {name: f"{one['path']}, {', '.join(map(str, one['clouds']))}" for name, one in groups.items()}
    method = {f"method.{name}": value for name, value in tree["method"].items()}
    training = {f"training.{name}": value for name, value in tree["training"].items() if value not in (None, {}, [])}
    return {"detector": tree["detector"]["name"], **data, **method, **training, **environment()}

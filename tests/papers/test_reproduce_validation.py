"""The rule that calls a curve of scores flat, and the curves of runs."""

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")

from tinygrid import tiny

from farfield.figures.training_plots import validation_curves
from farfield.papers.validation import FEW, FLAT, NOISY, RISING, course_of, validation_of

STEPS = list(range(50, 1201, 50))


def scores(gain: float, noise: float) -> list[float]:
    """A curve that rises steeply and then by ``gain`` over the last third, with alternating noise."""
    steps = np.asarray(STEPS, dtype=np.float64)
    late = np.clip((steps - 800) / 400, 0, 1)
    signs = np.where(np.arange(len(steps)) % 2 == 0, 1, -1)
    return (0.3 * np.clip(steps / 800, 0, 1) + gain * late + noise * signs).tolist()


@pytest.mark.parametrize(
    ("gain", "noise", "words"),
    [(0.0, 0.0, FLAT), (0.005, 0.0, FLAT), (0.05, 0.001, RISING), (0.0, 0.01, FLAT), (0.05, 0.1, NOISY)],
)
def test_a_curve_is_flat_where_its_gain_is_none_within_its_noise(gain: float, noise: float, words: str) -> None:
    course = course_of(STEPS, scores(gain, noise))
    assert course["words"] == words
    if not noise:
        assert course["gain"] == pytest.approx(gain, abs=1e-6)


def test_a_falling_curve_rises_no_more() -> None:
    assert course_of(STEPS, scores(-0.1, 0.001))["words"] == FLAT


@pytest.mark.parametrize("count", [0, 1, 3, 6])
def test_few_scores_say_nothing(count: int) -> None:
    course = course_of(STEPS[:count], [0.1] * count)
    assert course == {"gain": None, "interval": None, "words": FEW}


def test_curves_come_from_the_logs_of_runs_that_were_scored(tmp_path: Path) -> None:
    made = tiny(tmp_path)
    validation = {"every_steps": 50, "frames": 3}
    settings = made.settings.model_copy(update={"training": {**made.settings.training, "validation": validation}})
    grid = made.grid.model_copy(update={"budgets": {"laptop": settings}})
    with_scores = type(made)(grid=grid, claims=made.claims, out=tmp_path).jobs(made.locations)
    chosen = [job for job in with_scores if job.runs == ("gaussian",)]
    for job in chosen:
        folder = tmp_path / job.folder
        folder.mkdir()
        rows = [{"step": step, "validation": 0.3 + 0.01 * job.seed} for step in STEPS]
        lines = [json.dumps(row) for row in ({"step": 1, "loss": 2.0}, *rows)]
        (folder / "log.jsonl").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (curve,) = validation_of(with_scores, tmp_path)
    assert (curve["run"], curve["frames"], [side["seed"] for side in curve["seeds"]]) == ("gaussian", 3, [0, 1])
    assert curve["mean"]["steps"] == STEPS
    assert curve["mean"]["scores"] == pytest.approx([0.305] * len(STEPS))
    assert curve["mean"]["words"] == FLAT
    assert not validation_of(made.jobs(made.locations), tmp_path), "without validation there is no curve"
    figure = validation_curves({curve["run"]: [(side["steps"], side["scores"]) for side in curve["seeds"]]})
    assert len(figure.axes[0].lines) == 2

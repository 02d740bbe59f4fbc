"""Curves of a training's log, and the page that shows them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from farfield.figures.training_plots import RUN, CoursePanel, columns_of, courses, smoothed
from farfield.pages.training_pages import CoursePage, write_course

ROWS = [
    {"step": step, "time": 1.0, "learning_rate": 1e-3, "loss": 2.0 / step, "box": 1.0, "lambda": 0.1 * step}
    | ({"validation": 0.5, "rank_source": 9.0} if step % 2 == 0 else {})
    for step in range(1, 5)
]


def titles(figure: Any) -> list[str]:
    return [axes.get_title("left") for axes in figure.axes if axes.get_visible()]


def test_each_column_stands_in_one_panel() -> None:
    found = {panel.title: columns_of(ROWS, panel, RUN) for panel in RUN}
    assert found["losses"] == ["loss", "box"]
    assert {title for title, columns in found.items() if columns} == {
        "losses",
        "mean AP on held-out frames",
        "rank of the features",
        "lambda",
        "learning rate",
    }
    shown = [name for columns in found.values() for name in columns]
    assert sorted(shown) == sorted({"loss", "box", "validation", "rank_source", "lambda", "learning_rate"})
    assert set(titles(courses(ROWS, RUN))) == {title for title, columns in found.items() if columns}


def test_curves_are_what_was_logged() -> None:
    figure: Any = courses(ROWS, (CoursePanel("losses"), CoursePanel("mean AP", ("validation",))))
    by_label = {line.get_label(): line for axes in figure.axes for line in axes.get_lines()}
    np.testing.assert_allclose(by_label["loss"].get_ydata(), [2.0, 1.0, 2 / 3, 0.5])
    np.testing.assert_array_equal(by_label["validation"].get_xdata(), [2, 4])


def test_means_of_long_curves_lie_on_a_straight_line() -> None:
    steps = np.arange(1.0, 1001.0)
    at, means = smoothed(steps, 3 * steps + 1)
    assert len(at) == 50
    np.testing.assert_allclose(means, 3 * at + 1)


def test_values_that_are_no_numbers_are_gaps() -> None:
    figure: Any = courses([{"step": 1, "loss": 1.0}, {"step": 2, "loss": float("nan")}], RUN)
    assert len(figure.axes[0].get_lines()[0].get_xdata()) == 1


@pytest.mark.parametrize(("steps", "words"), [(4, "All 4 steps are done."), (9, "4 of 9 steps are done.")])
def test_the_page_says_how_far_it_is_and_what_is_wrong(tmp_path: Path, steps: int, words: str) -> None:
    page = CoursePage(title="run <x>", steps=steps, rows=ROWS, signs=["the rank falls"], settings={"detector": "y"})
    text = write_course(tmp_path / "course.html", page).read_text()
    assert words in text
    assert "the rank falls" in text
    assert "run &lt;x&gt;" in text
    assert 'src="http' not in text
    assert ("validation", "4", "0.5") in page.last
    assert ("loss", "4", "0.5") in page.last


def test_settings_are_in_words_and_guessing_is_named_where_it_is_drawn(tmp_path: Path) -> None:
    settings = {"training.start": {"weights": "x", "freeze": []}, "training.far_sampling": 0.0, "commit": None}
    page = CoursePage(title="run", steps=4, rows=ROWS, signs=[], settings=settings)
    text = write_course(tmp_path / "course.html", page).read_text()
    assert "<dd>weights: x, freeze: none</dd>" in text
    assert "<dd>0</dd>" in text
    assert "<dd>None</dd>" not in text
    assert "guessing" not in text
    two = [{**row, "held_accuracy": 0.6} for row in ROWS]
    page = CoursePage(title="run", steps=4, rows=two, signs=[], settings={})
    assert "Dashed: the accuracy of guessing." in write_course(tmp_path / "two.html", page).read_text()


def test_a_run_that_has_not_begun_has_a_page(tmp_path: Path) -> None:
    page = CoursePage(title="run", steps=9, rows=[], signs=[], settings={})
    text = write_course(tmp_path / "course.html", page).read_text()
    assert "0 of 9 steps are done." in text
    assert "Nothing is logged yet" in text

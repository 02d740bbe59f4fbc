"""The course of a training on one self-contained page: curves, what the log warns of, settings."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from farfield.figures.courses import RUN, Row, columns_of, courses
from farfield.figures.style import figure_uri
from farfield.files.atomic import write_text
from farfield.pages.template import PageImage, render_template

_LAST = 20  # losses are means over this part of the steps


@dataclass(frozen=True, kw_only=True)
class CoursePage:
    """Everything that the page shows.

    Args:
        title: Its title.
        steps: Steps that are wanted.
        rows: Rows of the log, by step.
        signs: Failure modes that it shows, one sentence each.
        settings: What was set, by name.
    """

    title: str
    steps: int
    rows: Sequence[Row]
    signs: Sequence[str]
    settings: Mapping[str, object]

    @property
    def headline(self) -> str:
        """How far it is."""
        done = int(self.rows[-1]["step"]) if self.rows else 0
        return f"All {self.steps} steps are done." if done >= self.steps else f"{done} of {self.steps} steps are done."

    @property
    def last(self) -> list[tuple[str, str, str]]:
        """Each figure at the end: its name, the step that it is of, its value."""
        losses = set(columns_of(self.rows, RUN[0], RUN))
        names = dict.fromkeys(name for panel in RUN for name in columns_of(self.rows, panel, RUN))
        return [self._last_of(name, mean=name in losses) for name in names]

    def _last_of(self, name: str, *, mean: bool) -> tuple[str, str, str]:
        having = [row for row in self.rows if name in row]
        values = [row[name] for row in having][-max(1, len(having) // _LAST) :] if mean else [having[-1][name]]
        return name.replace("_", " "), str(having[-1]["step"]), f"{sum(values) / len(values):.4g}"


def write_course(path: Path, page: CoursePage) -> Path:
    """Write the page, all or nothing.

    Args:
        path: The HTML file.
        page: What it shows.
    """
    figure = courses(page.rows, RUN)
    course = None
    if figure is not None:
        course = PageImage(
            figure_uri(figure),
            "Curves of the losses and of what else was logged over the steps",
            "Every logged step; of long curves the mean of fifty stretches is drawn over the single steps. A dashed "
            "line is what chance gives. docs/adaptation.md says how to read what a method logs.",
            "The course of the training",
        )
    write_text(path, render_template("course.html", page=page, course=course))
    return path

"""Curves of what a training logged over its steps, and what an adaptation changed."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from farfield.figures.birds_eye import draw_birdseye, draw_legend, fitting_window
from farfield.figures.style import INK, MUTED, PATTERNS, house_style, new_figure
from farfield.frame import Boxes, Frame, Key

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Row = Mapping[str, float | int]
"""A row of a ``log.jsonl``: the step, and figures by name."""

_DASHES = ("-", (0, (4, 2)), (0, (1, 1.5)))
_SMOOTHED = 200  # rows of a curve, above which its running mean is drawn over it
_MEANS = 50  # of so many windows
_FEW = 4  # curves whose names find room beside them


class CoursePanel(NamedTuple):
    """What one panel shows.

    Attributes:
        title: Its title.
        starts: Names of its columns begin so; none for all that no other panel shows.
        level: A value worth a line, such as that of chance.
        bottom: Lowest value shown; None for what the curves have.
    """

    title: str
    starts: tuple[str, ...] = ()
    level: float | None = None
    bottom: float | None = 0.0


_DOMAINS = (
    CoursePanel("gradient at the shared features", ("gradient_",)),
    CoursePanel("rank of the features", ("rank_",)),
    CoursePanel("variance of the features", ("variance_",)),
    CoursePanel(
        "accuracy between the domains", ("discriminator_accuracy", "held_accuracy", "probe_accuracy"), 0.5, bottom=None
    ),
)
ADAPTATION = (
    CoursePanel("loss of source and pseudo boxes", ("source_", "target_")),
    CoursePanel("boxes of the teacher a frame", ("pseudo_boxes", "ignored_boxes")),
    *_DOMAINS,
)
"""Panels of an adaptation's rounds."""
RUN = (
    CoursePanel("losses"),
    CoursePanel("mean AP on held-out frames", ("validation",)),
    CoursePanel("loss on held-out frames", ("held_loss_",)),
    *_DOMAINS,
    CoursePanel("proxy distance of the domains", ("proxy_distance",)),
    CoursePanel("lambda", ("lambda",)),
    CoursePanel("occupied cells, share", ("occupied",)),
    CoursePanel("cells of each domain", ("cells_of_",)),
    CoursePanel("near objects of a mixture", ("n_eff", "local_objects")),
    CoursePanel("pairs", ("pairs",)),
    CoursePanel("boxes of the teacher a frame", ("pseudo_boxes", "ignored_boxes")),
    CoursePanel("learning rate", ("learning_rate",)),
)
"""Panels of any training."""
_NOT_DRAWN = ("step", "time", "round")


def validation_curves(runs: Mapping[str, Sequence[tuple[Sequence[int], Sequence[float]]]]) -> "Figure":
    """Scores on held-out frames over the steps, a panel a run and a line a seed; the last third of the steps is shaded.

    Args:
        runs: Of each run, by title, steps and scores (0 to 1) of each seed; at least one run.
    """
    columns = min(3, len(runs))
    rows = -(-len(runs) // columns)
    with house_style():
        figure = new_figure(10.6, 0.5 + 2.3 * rows)
        panels = figure.subplots(rows, columns, squeeze=False, sharey=True).ravel()
        for axes in panels[len(runs) :]:
            axes.set_axis_off()
        for axes, (title, seeds) in zip(panels, runs.items(), strict=False):
            axes.grid(visible=True)
            for index, (steps, scores) in enumerate(seeds):
                dashes = _DASHES[index % len(_DASHES)]
                axes.plot(steps, scores, color=PATTERNS[0], ls=dashes, lw=1.4, marker="o", ms=2.2)
            end = max((steps[-1] for steps, _ in seeds), default=0)
            axes.axvspan(end * 2 / 3, end, color=MUTED, alpha=0.1, lw=0)
            axes.set_title(title)
            axes.set(xlabel="steps", ylim=(0, None))
        for row in range(rows):
            panels[row * columns].set_ylabel("mean AP on held-out frames")
    return figure


def courses(rows: Sequence[Row], panels: Sequence[CoursePanel]) -> "Figure | None":
    """What was logged over the steps; None where nothing of it was.

    Args:
        rows: Of a log, by step; of several rounds with the steps counted through and ``round``.
        panels: What to draw; those without a column are left out.
    """
    drawn = [(panel, columns_of(rows, panel, panels)) for panel in panels]
    drawn = [(panel, columns) for panel, columns in drawn if columns]
    if not drawn:
        return None
    lines = -(-len(drawn) // 2)
    with house_style():
        figure = new_figure(11.0, 0.3 + 2.7 * lines)
        grid = figure.subplots(lines, 2, squeeze=False).reshape(-1)
        for axes in grid[len(drawn) :]:
            axes.set_visible(False)
        for axes, (panel, columns) in zip(grid, drawn, strict=False):
            _draw_panel(axes, rows, panel, columns)
    return figure


def has_level(rows: Sequence[Row], panels: Sequence[CoursePanel]) -> bool:
    """Whether a panel that is drawn has a line of its own at some value."""
    return any(panel.level is not None and bool(columns_of(rows, panel, panels)) for panel in panels)


def columns_of(rows: Sequence[Row], panel: CoursePanel, panels: Sequence[CoursePanel]) -> list[str]:
    """Columns of the log that a panel shows, in their order."""
    names = [name for name in dict.fromkeys(name for row in rows for name in row) if name not in _NOT_DRAWN]
    if panel.starts:
        return [name for name in names if name.startswith(panel.starts)]
    others = tuple(start for other in panels for start in other.starts)
    return [name for name in names if not name.startswith(others)]


def _draw_panel(axes: "Axes", rows: Sequence[Row], panel: CoursePanel, columns: Sequence[str]) -> None:
    for index, name in enumerate(columns):
        having = [row for row in rows if name in row and np.isfinite(row[name])]
        steps, values = (np.array([row[key] for row in having], dtype=np.float64) for key in ("step", name))
        colour, dash = PATTERNS[index % len(PATTERNS)], _DASHES[index // len(PATTERNS) % len(_DASHES)]
        label = name.replace("_", " ")
        if len(values) > _SMOOTHED:
            axes.plot(steps, values, lw=0.5, alpha=0.25, color=colour)
            steps, values = smoothed(steps, values)
        axes.plot(steps, values, lw=1.3, marker="." if len(values) < 12 else "", color=colour, ls=dash, label=label)
    last_steps = {row.get("round", 1): row["step"] for row in rows}
    for end in list(last_steps.values())[:-1]:  # of all rounds but the last
        axes.axvline(end, color=INK, lw=0.8, ls=(0, (1, 3)))
    if panel.level is not None:
        axes.axhline(panel.level, color=MUTED, lw=0.8, ls=(0, (3, 3)))
    axes.set(title=panel.title, xlabel="step", xlim=(0, 1.02 * max(row["step"] for row in rows)))
    if panel.bottom is not None:
        axes.set_ylim(panel.bottom, None)
    many = len(columns) > _FEW
    if many:
        low, high = axes.get_ylim()
        axes.set_ylim(low, high + 0.4 * (high - low))  # room for the names
    axes.grid(visible=True)
    axes.legend(fontsize=7, ncols=2 if many else 1, loc="upper right" if many else "best")


def smoothed(steps: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means of neighbouring rows at their mean steps, fifty windows in all."""
    parts = [np.array_split(column, _MEANS) for column in (steps, values)]
    means = [np.array([part.mean() for part in column]) for column in parts]
    return means[0], means[1]


# The figures of an adaptation: scores before and after, and frames that changed.

_BEFORE, _AFTER = MUTED, PATTERNS[0]
_EDGES = np.linspace(0.0, 1.0, 41)


def _of_class(boxes: Mapping[Key, Boxes], name: str) -> np.ndarray:
    """Scores of all boxes of a class, shape (n,)."""
    parts = [
        frame_boxes.score[np.asarray(frame_boxes.label) == name]
        for frame_boxes in boxes.values()
        if frame_boxes.score is not None
    ]
    return np.concatenate([np.zeros(0), *parts])


def score_histograms(
    before: Mapping[Key, Boxes],
    after: Mapping[Key, Boxes],
    classes: Sequence[str],
    positive: Mapping[str, float],
    negative: Mapping[str, float],
) -> "Figure":
    """Histograms of scores, a panel a class.

    Args:
        before: Scored boxes by frame.
        after: The same frames' boxes after.
        classes: Which classes.
        positive: Threshold above which boxes are sure, by class.
        negative: Threshold below which they are background.
    """
    columns = min(len(classes), 2)
    lines = -(-len(classes) // columns)
    with house_style():
        figure = new_figure(5.3 * columns, 0.5 + 2.5 * lines)
        panels = figure.subplots(lines, columns, squeeze=False).reshape(-1)
        for axes in panels[len(classes) :]:
            axes.set_visible(False)
        for axes, name in zip(panels, classes, strict=False):
            for boxes, colour, label in ((before, _BEFORE, "before"), (after, _AFTER, "after")):
                count = np.histogram(_of_class(boxes, name), _EDGES)[0] / max(len(boxes), 1)
                axes.stairs(count, _EDGES, color=colour, lw=1.6, label=label)
            for level in (negative[name], positive[name]):
                axes.axvline(level, color=INK, lw=0.8, ls=(0, (3, 3)))
            axes.set_yscale("symlog", linthresh=0.1)
            axes.set(xlim=(0, 1), ylim=(0, None), title=name.replace("_", " "), xlabel="score", ylabel="boxes a sweep")
            axes.grid(visible=True)
        handles, names = panels[0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside lower center", ncols=2)
    return figure


def boxes_before_and_after(frame: Frame, cloud: str, before: Boxes, after: Boxes) -> "Figure":
    """A frame from above twice: with the boxes before, and with those after.

    Args:
        frame: The frame.
        cloud: Which of its clouds.
        before: Boxes found before.
        after: Boxes found after.
    """
    points = frame.cloud(cloud)
    window = fitting_window(points, before, after)
    with house_style():
        figure = new_figure(11.0, 0.9 + 2 * (0.35 + 10.0 * (window[3] - window[2]) / (window[1] - window[0])))
        for axes, boxes, title in zip(figure.subplots(2, 1), (before, after), ("before", "after"), strict=True):
            draw_birdseye(axes, points, annotated=frame.boxes, predicted=boxes, window_m=window, line_width=0.9)
            axes.set_title(title)
        draw_legend(figure, annotated=frame.boxes is not None)
    return figure

"""The figures of an adaptation: scores before and after, and frames that changed."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from farfield.figures.birds_eye import draw_birdseye, draw_legend, fitting_window
from farfield.figures.style import INK, MUTED, PATTERNS, house_style, new_figure
from farfield.frame import Boxes, Frame, Key

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BEFORE, _AFTER = MUTED, PATTERNS[0]
_EDGES = np.linspace(0.0, 1.0, 41)


def _of_class(boxes: Mapping[Key, Boxes], name: str) -> np.ndarray:
    """Scores of all boxes of a class, shape (n,)."""
    parts = [each.score[np.asarray(each.label) == name] for each in boxes.values() if each.score is not None]
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
        for axes, boxes, word in zip(figure.subplots(2, 1), (before, after), ("before", "after"), strict=True):
            draw_birdseye(axes, points, annotated=frame.boxes, predicted=boxes, window_m=window, line_width=0.9)
            axes.set_title(word)
        draw_legend(figure, annotated=frame.boxes is not None)
    return figure

"""What a notebook shows of a frame, a cloud, boxes, a detector and a result: its one line, a picture, a table."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from farfield.evaluation.report_data import returns_word
from farfield.figures.birds_eye import Window, birdseye, draw_birdseye, fit_window, overview
from farfield.figures.plots import precision_recall
from farfield.figures.style import INK, MUTED, figure_uri, house_style, new_figure
from farfield.frame import Cloud, Frame
from farfield.frame.image_marks import image_marks
from farfield.geometry.boxes import Boxes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from farfield.metrics.result import Result

_DPI = 90
_ROWS = 10
_CLASSES = "classes at their usual size"
_NOTHING = np.zeros((0, 3), dtype=np.float32)


def cloud_html(cloud: Cloud) -> str:
    """A cloud from above; words alone where it is empty."""
    if not len(cloud):
        return _words(cloud)
    figure = overview(cloud, window_m=fit_window(cloud.points_m), point=returns_word(cloud.kind), rings_m=())
    return _words(cloud) + _picture(figure, "The cloud seen from above")


def boxes_html(boxes: Boxes) -> str:
    """Boxes from above, and the first of them as a table."""
    if not len(boxes):
        return _words(boxes)
    window = fit_window(np.vstack([boxes.corners_m().reshape(-1, 3), np.zeros((1, 3))]))
    annotated, predicted = (boxes, None) if boxes.score is None else (None, boxes)
    figure = overview(Cloud(_NOTHING), annotated=annotated, predicted=predicted, window_m=window, rings_m=())
    return _words(boxes) + _picture(figure, "The boxes seen from above") + _table(boxes)


def frame_html(frame: Frame) -> str:
    """A frame's first cloud from above with what was annotated, or its first image where it has no cloud."""
    if frame.clouds:
        return _words(frame) + _picture(birdseye(frame, window_m="fit"), "The frame seen from above")
    if frame.images:
        from farfield.figures.camera import camera_picture

        name = next(iter(frame.images))
        marks = image_marks(frame)
        figure = camera_picture(
            frame.images[name],
            frame.cameras.get(name),
            annotated=frame.boxes,
            marks=marks if marks is not None and marks.camera == name else None,
        )
        return _words(frame) + _picture(figure, f"The image of the camera {name}")
    return _words(frame)


def result_html(result: "Result") -> str:
    """A result's table, and its curves where it has some."""
    text = f"{_words(result)}<pre>{escape(str(result))}</pre>"
    if not result.curves:
        return text
    return text + _picture(precision_recall({result.label: result.to_json()}), "Precision over recall")


def detector_html(detector: Any) -> str:
    """Where a detector looks, from above, with its classes' usual sizes drawn to scale.

    Args:
        detector: A :class:`farfield.detectors.runtime.Detector`.
    """
    return _words(detector) + _picture(_looks(detector), "Where the detector looks, seen from above")


def _looks(detector: Any) -> "Figure":
    config = detector.config
    reach_m, half_m = float(detector.reach_m), float(config.grid.half_width_m)
    window: Window = (-0.03 * reach_m, 1.03 * reach_m, -1.15 * half_m, 1.15 * half_m)
    usual = _usual(config)
    with house_style():
        figure = new_figure(9.0, 1.1 + 8.2 * (window[3] - window[2]) / (window[1] - window[0]))
        axes = figure.add_subplot()
        rings = [ring for ring in (20.0, 50.0, 100.0, 150.0, 200.0, 250.0) if ring < reach_m]
        draw_birdseye(axes, Cloud(_NOTHING), annotated=usual, window_m=window, rings_m=rings)
        axes.plot([0, reach_m, reach_m, 0, 0], [-half_m, -half_m, half_m, half_m, -half_m], color=INK, lw=1.4, zorder=3)
        axes.set_title(f"{detector.name} looks {reach_m:g} m ahead and {half_m:g} m to each side")
        axes.text(
            0.02 * reach_m,
            -0.9 * half_m,
            _CLASSES if usual is not None else f"classes: {', '.join(detector.class_names)}",
            color=MUTED,
            fontsize=7.5,
        )
    return figure


def _usual(config: Any) -> Boxes | None:
    """A box of each class at its usual size, one above the other; None where the settings name no sizes."""
    sizes: Mapping[str, Sequence[float]] = getattr(config, "sizes_m", None) or {
        name: anchor.size_m for name, anchor in getattr(config, "anchors", {}).items()
    }
    if not sizes:
        return None
    half_m, count = float(config.grid.half_width_m), len(sizes)
    y_m = [half_m * (0.8 - 1.6 * (row + 0.5) / count) for row in range(count)]
    centre_m = np.column_stack([np.full(count, 0.1 * float(config.reach_m)), y_m, np.zeros(count)])
    return Boxes(
        centre_m=centre_m, size_m=np.array([*sizes.values()], dtype=float), yaw_rad=np.zeros(count), label=[*sizes]
    )


def _words(shown: Any) -> str:
    return f"<div><code>{escape(repr(shown))}</code></div>"


def _picture(figure: "Figure", what: str) -> str:
    return f'<img style="max-width:100%" alt="{escape(what)}" src="{figure_uri(figure, "png", dpi=_DPI)}">'


def _table(boxes: Boxes) -> str:
    """The first boxes, the surest first where they have scores."""
    order = np.arange(len(boxes)) if boxes.score is None else np.argsort(-boxes.score, kind="stable")
    columns = boxes.columns()
    head = "".join(f"<th>{escape(name)}</th>" for name in columns)
    rows = ""
    for row in order[:_ROWS]:
        values = [column[row] for column in columns.values()]
        cells = [f"{value:.2f}" if isinstance(value, np.floating) else escape(str(value)) for value in values]
        rows += f"<tr>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>"
    more = f"<p>and {len(boxes) - _ROWS} more</p>" if len(boxes) > _ROWS else ""
    return f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>{more}"

"""Bird's-eye pictures: points, annotated and predicted boxes on a grid of metres, forward to the right."""

import textwrap
from collections.abc import Collection, Sequence
from importlib import import_module
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from jaxtyping import Bool, Float

from farfield.evaluation.report_data import VEHICLES, kind_of, of_classes, returns_word, shown_predictions
from farfield.figures.style import ANNOTATED, INK, MUTED, POINT, PREDICTED, figure_bytes, house_style, new_figure
from farfield.frame import Cloud, Frame
from farfield.geometry.boxes import Boxes
from farfield.metrics.centre.matching import found_by
from farfield.vocabulary.counts import count_of
from farfield.vocabulary.scores import SHOWN_SCORE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["birdseye", "draw_birdseye", "figure_bytes", "overview", "show_frame", "zooms"]

Window = tuple[float, float, float, float]
_POINT_DPI = 110  # pixels an inch of the points
_TALLEST_IN, _NARROWEST_IN, _TITLE_LETTERS_AN_INCH = 8.0, 3.0, 11.5
WINDOW_M: Window = (0.0, 250.0, -50.0, 50.0)
RANGES_M = (70.0, 150.0, 250.0)
_NEAR_RINGS_M = (20.0, 40.0, 60.0, 80.0)
STREET_M: Window = (-45.0, 45.0, -30.0, 22.0)
SHORT_WINDOW_M: Window = (0.0, 120.0, -30.0, 30.0)
ZOOMS_M: tuple[tuple[str, Window], ...] = (
    ("near: 0 to 70 m", (0.0, 70.0, -35.0, 35.0)),
    ("mid: 70 to 150 m", (70.0, 150.0, -40.0, 40.0)),
    ("far: 150 to 250 m", (150.0, 250.0, -50.0, 50.0)),
)


def draw_birdseye(
    axes: "Axes",
    cloud: Cloud,
    *,
    annotated: Boxes | None = None,
    predicted: Boxes | None = None,
    labels: Collection[str] | None = None,
    window_m: Window = WINDOW_M,
    rings_m: Sequence[float] = RANGES_M,
    point_size: float = 0.5,
    line_width: float = 1.1,
) -> None:
    """Draw one cloud from above: x (forward) to the right, y (left) upwards.

    Args:
        axes: Where to draw.
        cloud: The points.
        annotated: Annotated boxes, or None where there are none.
        predicted: Predicted boxes.
        labels: Classes that the detector was asked for; annotated boxes of other classes are drawn in grey.
        window_m: x from, x to, y from, y to.
        rings_m: Ranges to mark by arcs.
        point_size: Marker area of a point, in square points.
        line_width: Line width of boxes, in points.
    """
    x_from, x_to, y_from, y_to = window_m
    _draw_grid(axes, window_m)
    draw_rings(axes, window_m, rings_m)
    _draw_points(axes, cloud.points_m[in_window(cloud.points_m, window_m)], window_m, point_size)
    if annotated is not None:
        counts = of_classes(annotated, labels)
        draw_boxes(axes, annotated[~counts], MUTED, line_width=0.7 * line_width, order=3)
        draw_boxes(axes, annotated[counts], ANNOTATED, line_width=1.9 * line_width, order=4)
    if predicted is not None:
        draw_boxes(axes, predicted, PREDICTED, line_width=line_width, order=5)
        draw_tags(axes, predicted[in_window(predicted.centre_m, window_m)], PREDICTED, window_m)
    elif annotated is not None:
        draw_tags(axes, annotated[in_window(annotated.centre_m, window_m)], ANNOTATED, window_m)
    if x_from <= 0 <= x_to and y_from <= 0 <= y_to:
        axes.plot([0], [0], marker=">", color=INK, markersize=6, zorder=6, clip_on=False)
    axes.set(xlim=(x_from, x_to), ylim=(y_from, y_to), aspect="equal")
    place_names(axes)


def place_names(axes: "Axes") -> None:
    """Put the axes' names at fixed places: to find them, matplotlib measures every number beside the axes."""
    from matplotlib.transforms import ScaledTranslation

    move = axes.get_figure(root=True).dpi_scale_trans  # type: ignore[union-attr]
    axes.xaxis.set_label_coords(0.5, 0.0, axes.transAxes + ScaledTranslation(0, -0.24, move))
    axes.yaxis.set_label_coords(0.0, 0.5, axes.transAxes + ScaledTranslation(-0.36, 0, move))


def _draw_points(axes: "Axes", points_m: Float[np.ndarray, "n 3"], window_m: Window, point_size: float) -> None:
    """Points as one picture of their number a pixel, which takes a tenth of the time of markers."""
    from matplotlib.colors import to_rgb

    x_from, x_to, y_from, y_to = window_m
    rectangle = axes.get_position()
    width = axes.get_figure(root=True).get_figwidth() * rectangle.width * _POINT_DPI  # type: ignore[union-attr]
    pixel_m = max((x_to - x_from) / max(width, 1.0), 1e-6)
    shape = max(round((x_to - x_from) / pixel_m), 1), max(round((y_to - y_from) / pixel_m), 1)
    count, _, _ = np.histogram2d(points_m[:, 0], points_m[:, 1], bins=shape, range=((x_from, x_to), (y_from, y_to)))
    size = max(round(point_size**0.5 * _POINT_DPI / 72), 1)
    spread = np.zeros_like(count)
    for across, up in np.ndindex(size, size):
        spread[across:, up:] += count[: shape[0] - across, : shape[1] - up]
    picture = np.zeros((shape[1], shape[0], 4), dtype=np.uint8)
    picture[..., :3] = np.round(255 * np.array(to_rgb(POINT)))
    picture[..., 3] = np.round(255 * (1.0 - 0.25 ** np.minimum(spread.T, 4.0)))
    axes.imshow(
        picture, origin="lower", extent=(x_from, x_to, y_from, y_to), interpolation="none", aspect="auto", zorder=2
    )


def _draw_grid(axes: "Axes", window_m: Window) -> None:
    from matplotlib.collections import LineCollection

    x_from, x_to, y_from, y_to = window_m
    step_m = 20.0 if x_to - x_from <= 120 else 50.0
    axes.set_xticks(_multiples(x_from, x_to, step_m))
    axes.set_yticks(_multiples(y_from, y_to, step_m))
    lines = [[(x, y_from), (x, y_to)] for x in _multiples(x_from, x_to, 10.0)]
    lines += [[(x_from, y), (x_to, y)] for y in _multiples(y_from, y_to, 10.0)]
    grid = LineCollection(lines, colors="#e9edf1", linewidths=0.7, alpha=0.55, zorder=0.5)
    axes.add_collection(grid, autolim=False)
    axes.grid(visible=True)
    axes.set_xlabel("x forward (m)")
    axes.set_ylabel("y left (m)")


def _multiples(low: float, high: float, step: float) -> Float[np.ndarray, " n"]:
    return np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step


def draw_rings(axes: "Axes", window_m: Window, rings_m: Sequence[float], *, colour: str = INK) -> None:
    """Mark ranges by dotted arcs with their metres."""
    angle_rad = np.linspace(-np.pi, np.pi, 721)
    x_from, x_to, y_from, y_to = window_m
    for ring_m in rings_m:
        axes.plot(
            ring_m * np.cos(angle_rad), ring_m * np.sin(angle_rad), color=colour, lw=0.8, ls=(0, (1, 3)), zorder=2.5
        )
        label_y = min(y_to - 0.035 * (y_to - y_from), 0.7 * ring_m)  # on the arc, ahead to the left
        label_x = np.sqrt(max(ring_m**2 - label_y**2, 0.0))
        if x_from < label_x < x_to and y_from < label_y < y_to:
            axes.annotate(
                f"{ring_m:g} m",
                (label_x, label_y),
                xytext=(-4, 0),
                textcoords="offset points",
                ha="right",
                va="center",
                fontsize=7.5,
                color=INK,
                bbox={"boxstyle": "square,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.8},
                zorder=6,
            )


def draw_boxes(axes: "Axes", boxes: Boxes, colour: str, *, line_width: float, order: int, dashes: Any = "-") -> None:
    """Draw box outlines from above, with a tick from the centre to the front that shows the heading."""
    from matplotlib.collections import LineCollection, PolyCollection

    if not len(boxes):
        return
    corners = boxes.bev_corners_m()
    edge = PolyCollection(
        list(corners), facecolor="none", edgecolor=colour, linewidth=line_width, linestyle=dashes, zorder=order
    )
    front = (corners[:, 0] + corners[:, 3]) / 2
    heading = LineCollection(
        list(np.stack([boxes.centre_m[:, :2], front], axis=1)), colors=colour, linewidths=line_width, zorder=order
    )
    for artist in (edge, heading):
        axes.add_collection(artist, autolim=False)


def draw_legend(
    figure: "Figure",
    *,
    others: bool = False,
    annotated: bool = True,
    predicted: bool = True,
    point: str = "point",
    rings: bool = True,
) -> None:
    """Put one legend under a figure's panels; ``point`` is what a dot is."""
    from matplotlib.lines import Line2D

    entries = [Line2D([], [], color=POINT, marker=".", ls="none", ms=5, label=point)]
    if annotated:
        entries += [Line2D([], [], color=ANNOTATED, lw=2.2, label="annotated")]
    if predicted:
        entries += [Line2D([], [], color=PREDICTED, lw=1.3, label="predicted")]
    if others:
        entries += [Line2D([], [], color=MUTED, lw=1.0, label="annotated, class not asked for")]
    if rings:
        entries += [Line2D([], [], color=INK, lw=0.9, ls=(0, (1, 3)), label="range")]
    entries += [Line2D([], [], color=INK, marker=">", ls="none", ms=6, label="sensor")]
    loc: Any = "lower center" if figure.get_layout_engine() is None else "outside lower center"
    figure.legend(handles=entries, loc=loc, ncols=len(entries), handlelength=1.6)


def _leave_room(figure: "Figure", *, above_in: float, below_in: float = 0.75) -> None:
    width, height = figure.get_size_inches()
    figure.subplots_adjust(
        left=0.6 / width, right=1 - 0.15 / width, bottom=below_in / height, top=1 - above_in / height, wspace=0.16
    )


def overview(
    cloud: Cloud,
    *,
    annotated: Boxes | None = None,
    predicted: Boxes | None = None,
    labels: Collection[str] | None = None,
    window_m: Window = WINDOW_M,
    rings_m: Sequence[float] = RANGES_M,
    point: str = "point",
    title: str = "",
) -> "Figure":
    """The whole window in one picture; arguments as in :func:`draw_birdseye`, ``point`` is what a dot is."""
    with house_style():
        x_from, x_to, y_from, y_to = window_m
        slope = max((y_to - y_from) / max(x_to - x_from, 1e-3), 1e-3)
        wide_in = max(min(10.2, _TALLEST_IN / slope), _NARROWEST_IN)
        slope = min(slope, _TALLEST_IN / wide_in)
        title = textwrap.fill(title, int(_TITLE_LETTERS_AN_INCH * wide_in), break_on_hyphens=False)
        above_in = 0.35 + 0.17 * title.count("\n") if title else 0.1
        figure = new_figure(wide_in + 0.8, 0.85 + above_in + wide_in * slope, fixed=True)
        _leave_room(figure, above_in=above_in)
        axes = figure.add_subplot()
        draw_birdseye(
            axes,
            cloud,
            annotated=annotated,
            predicted=predicted,
            labels=labels,
            window_m=window_m,
            rings_m=rings_m,
            line_width=0.9,
        )
        if title:
            axes.set_title(title)
        draw_legend(
            figure,
            others=annotated is not None and not of_classes(annotated, labels).all(),
            annotated=annotated is not None,
            predicted=predicted is not None,
            point=point,
            rings=len(rings_m) > 0,
        )
    return figure


def street(frame: Frame, predicted: Boxes, *, window_m: Window = STREET_M) -> "Figure":
    """A street all around a sensor with its annotated vehicles and those predicted.

    Args:
        frame: An annotated frame.
        predicted: Predicted boxes of all classes.
        window_m: x from, x to, y from, y to.
    """
    title = f"{frame.sequence}, {frame.frame_id}: a real sweep"
    vehicles = predicted[of_classes(predicted, VEHICLES)]
    return overview(
        frame.cloud(),
        annotated=frame.boxes,
        predicted=vehicles,
        labels=VEHICLES,
        window_m=window_m,
        rings_m=(30.0,),
        title=title,
    )


def zooms(
    cloud: Cloud,
    *,
    annotated: Boxes | None = None,
    predicted: Boxes | None = None,
    labels: Collection[str] | None = None,
    windows_m: Sequence[tuple[str, Window]] = ZOOMS_M,
    rings_m: Sequence[float] = RANGES_M,
) -> "Figure":
    """Near, mid and far side by side, each with its own scale; arguments as in :func:`draw_birdseye`."""
    with house_style():
        figure = new_figure(11.0, 4.0, fixed=True)
        _leave_room(figure, above_in=0.35, below_in=0.5)
        for number, (name, window_m) in enumerate(windows_m, 1):
            axes = figure.add_subplot(1, len(windows_m), number)
            draw_birdseye(
                axes,
                cloud,
                annotated=annotated,
                predicted=predicted,
                labels=labels,
                window_m=window_m,
                rings_m=rings_m,
                point_size=1.2 + 0.02 * window_m[0],
                line_width=1.1,
            )
            axes.set_title(name)
            axes.set_ylabel("y left (m)" if number == 1 else "")
    return figure


def birdseye(
    frame: Frame,
    predictions: Boxes | None = None,
    *,
    cloud: str | None = None,
    labels: Collection[str] | None = None,
    window_m: Window | Literal["crop", "fit"] = "crop",
    shown_score: float = SHOWN_SCORE,
) -> "Figure":
    """Draw a frame from above with its annotated boxes and a detector's predictions.

    Args:
        frame: The frame.
        predictions: Predicted boxes.
        cloud: Which cloud; None takes the first.
        labels: Classes that the detector was asked for; others are drawn in grey.
        window_m: x from, x to, y from, y to; ``"fit"`` shows all points, ``"crop"`` the sensor, the boxes and all
            points but the outermost.
        shown_score: Predicted boxes of a lower score are left out, which the title says.
    """
    predictions, left_out = shown_predictions(predictions, shown_score)
    points = frame.cloud(cloud)
    if window_m == "crop":
        window = cropped_window(points, frame.boxes, predictions)
    else:
        window = fit_window(points.points_m) if window_m == "fit" else window_m
    title = f"{frame.sequence}, {frame.frame_id}" + (f", {cloud}" if cloud else "")
    if predictions is not None and frame.boxes is not None:
        annotated = frame.boxes[of_classes(frame.boxes, labels)]
        annotated = annotated[in_window(annotated.centre_m, window)]
        num_found = int((found_by(predictions, annotated) >= 0).sum())
        title += f": {num_found} of {count_of(len(annotated), 'annotated object')} within 2 m of a box of any class"
    title += f"; {left_out}" if left_out else ""
    point = returns_word(kind_of(frame, cloud))
    return overview(
        points,
        annotated=frame.boxes,
        predicted=predictions,
        labels=labels,
        window_m=window,
        rings_m=RANGES_M if max(map(abs, window)) > RANGES_M[0] + 30 else _NEAR_RINGS_M,
        point=point,
        title=title,
    )


def fitting_window(cloud: Cloud, *boxes: Boxes | None, edges_m: Sequence[float] = RANGES_M) -> Window:
    """The window to the outermost range edge, or one of 120 m where neither points nor boxes reach beyond."""
    reach_m = min(max(edges_m, default=WINDOW_M[1]), WINDOW_M[1])
    farthest = [float(np.percentile(cloud.points_m[:, 0], 99.8))] if len(cloud) else []
    farthest += [float(part.centre_m[:, 0].max()) for part in boxes if part is not None and len(part)]
    if reach_m > SHORT_WINDOW_M[1] and max(farthest, default=reach_m) > SHORT_WINDOW_M[1]:
        return WINDOW_M[0], reach_m, *WINDOW_M[2:]
    return SHORT_WINDOW_M[0], min(reach_m, SHORT_WINDOW_M[1]), *SHORT_WINDOW_M[2:]


def zoom_windows(edges_m: Sequence[float] = RANGES_M) -> tuple[tuple[str, Window], ...]:
    """A window for each range bin, named; none where there are too many or the outermost is near enough as it is."""
    edges = [0.0, *edges_m]
    if len(edges) not in (3, 4, 5) or edges[-1] <= SHORT_WINDOW_M[1] or edges[-1] > WINDOW_M[1]:
        return ()
    titles = ("near: ", "mid: ", "far: ") if len(edges) == 4 else ("",) * 4
    half_m = (35.0, 40.0, 50.0, 50.0)
    return tuple(
        (f"{title}{low:g} to {high:g} m", (low, high, -half, half))
        for title, half, (low, high) in zip(titles, half_m, pairwise(edges), strict=False)
    )


def filled_zooms(cloud: Cloud, *boxes: Boxes | None, edges_m: Sequence[float] = RANGES_M) -> list[tuple[str, Window]]:
    """Those of the zooms that hold boxes or at least twenty points."""
    centres = [part.centre_m for part in boxes if part is not None]
    return [
        (name, window_m)
        for name, window_m in zoom_windows(edges_m)
        if in_window(cloud.points_m, window_m).sum() >= 20 or any(in_window(c, window_m).any() for c in centres)
    ]


def fit_window(points_m: Float[np.ndarray, "n 3"]) -> Window:
    """The window that shows all points, in whole tens of metres."""
    if not len(points_m):
        return WINDOW_M
    low, high = points_m[:, :2].min(axis=0), points_m[:, :2].max(axis=0)
    low, high = np.floor(low / 10) * 10, np.ceil(high / 10) * 10
    return float(low[0]), float(max(high[0], low[0] + 10)), float(low[1]), float(max(high[1], low[1] + 10))


def cropped_window(cloud: Cloud, *boxes: Boxes | None) -> Window:
    """The window of the sensor, the boxes and all points but a few of the outermost, in whole tens of metres."""
    corners_m = [part.bev_corners_m().reshape(-1, 2) for part in boxes if part is not None and len(part)]
    points_m = cloud.points_m[np.isfinite(cloud.points_m[:, :2]).all(axis=1), :2]
    edges_m = [np.percentile(points_m, share, axis=0) for share in _CROPPED] if len(points_m) else []
    if not corners_m and not edges_m:
        return WINDOW_M
    shown_m = np.concatenate([np.zeros((1, 2)), *corners_m, *(edge[None] for edge in edges_m)])
    shown_m = shown_m[np.isfinite(shown_m).all(axis=1)].clip(-_FARTHEST_SHOWN_M, _FARTHEST_SHOWN_M)
    return fit_window(np.column_stack([shown_m, np.zeros(len(shown_m))]))


_FARTHEST_SHOWN_M = 500.0
_CROPPED = (0.5, 99.5)  # per cent of a cloud's points, along each axis


def in_window(points_m: Float[np.ndarray, "n 3"], window_m: Window) -> Bool[np.ndarray, " n"]:
    """Which points lie in a window, seen from above, shape (n,)."""
    x, y = points_m[:, 0], points_m[:, 1]
    return (x >= window_m[0]) & (x <= window_m[1]) & (y >= window_m[2]) & (y <= window_m[3])


def show_frame(
    frame: Frame,
    predictions: Boxes | None = None,
    *,
    cloud: str | None = None,
    window_m: Window | Literal["crop", "fit"] = "crop",
    shown_score: float = SHOWN_SCORE,
) -> "Figure":
    """Draw a frame from above and, where matplotlib has a window or a notebook, show it.

    Args:
        frame: The frame.
        predictions: Predicted boxes.
        cloud: Which cloud; None takes the first.
        window_m: As in :func:`birdseye`.
        shown_score: Predicted boxes of a lower score are left out, which the title says.

    Returns:
        The figure; ``figure.savefig("frame.png", dpi=150)`` writes it.
    """
    from matplotlib.backends.registry import BackendFilter, backend_registry

    figure = birdseye(frame, predictions, cloud=cloud, window_m=window_m, shown_score=shown_score)
    pyplot: Any = import_module("matplotlib.pyplot")  # its types hide the one function that adopts a figure
    if pyplot.get_backend().lower() in backend_registry.list_builtin(BackendFilter.INTERACTIVE):
        pyplot.new_figure_manager_given_figure(max(pyplot.get_fignums(), default=0) + 1, figure).show()
    return figure


# Words beside the boxes of a picture: class and score.

_MOST_TAGS = 80  # in one picture
_TAG_PT, _LETTER = 6.5, 0.58  # size of a tag's letters in points, and a letter's mean width as a share of it


def tags_of(boxes: Boxes) -> list[str]:
    """Class and, where there is one, score of each box, such as ``"vehicle 0.87"``."""
    if boxes.score is None:
        return [str(label) for label in boxes.label]
    return [f"{label} {score:.2f}" for label, score in zip(boxes.label, boxes.score, strict=True)]


def draw_tags(axes: "Axes", boxes: Boxes, colour: str, window_m: Window) -> None:
    """Class and score beside boxes seen from above, the surest or else the nearest first, where none covers another.

    A tag stands at one of its box's four corners; where each would cover another tag, the box has none.
    """
    order = np.argsort(boxes.range_m if boxes.score is None else -boxes.score, kind="stable")[:_MOST_TAGS]
    corners = boxes.bev_corners_m()
    tags = Tags(axes, window_m)
    for row, tag in zip(order, tags_of(boxes[order]), strict=True):
        (left, bottom), (right, top) = corners[row].min(axis=0), corners[row].max(axis=0)
        wide, high = tags.size(tag)
        tags.draw(tag, ((right, top), (right, bottom - high), (left - wide, top), (left - wide, bottom - high)), colour)


class Tags:
    """Words in a picture of which none covers another.

    Args:
        axes: Where they are drawn.
        window: What the axes show, in the axes' units: x from, x to, y lowest, y highest.
        halo: Colour around the letters.
    """

    def __init__(self, axes: "Axes", window: Window, halo: str = "white") -> None:
        self.axes, self.window, self.halo = axes, window, halo
        width_in = axes.get_figure(root=True).get_figwidth() * axes.get_position().width  # type: ignore[union-attr]
        self.point = (window[1] - window[0]) / max(72 * width_in, 1.0)
        self.taken: list[Window] = []

    def size(self, tag: str) -> tuple[float, float]:
        """About how wide and high a tag is, in the axes' units."""
        return (_LETTER * len(tag) + 0.3) * _TAG_PT * self.point, 1.15 * _TAG_PT * self.point

    def draw(self, tag: str, corners: Sequence[tuple[float, float]], colour: str) -> None:
        """Draw a tag where it covers no other, or nowhere.

        Args:
            tag: The words.
            corners: Where its corner of least x and y may be, the best first.
            colour: The words' colour.
        """
        from matplotlib.patheffects import withStroke

        wide, high = self.size(tag)
        x_from, x_to, y_from, y_to = self.window
        for x, y in corners:
            inside = x_from <= x and x + wide <= x_to and y_from <= y and y + high <= y_to
            covers = any(x < b and x + wide > a and y < d and y + high > c for a, b, c, d in self.taken)
            if inside and not covers:
                self.taken.append((x, x + wide, y, y + high))
                self.axes.text(
                    x + self.point,
                    y + high / 2,
                    tag,
                    fontsize=_TAG_PT,
                    color=colour,
                    va="center",
                    clip_on=True,
                    zorder=6,
                    path_effects=[withStroke(linewidth=1.6, foreground=self.halo, alpha=0.8)],
                )
                return

"""Camera pictures with points and boxes projected into them."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, UInt8

from farfield.figures.style import POINT, house_style, new_figure
from farfield.figures.tags import tags_of
from farfield.geometry.boxes import Boxes
from farfield.geometry.cameras import Camera
from farfield.vocabulary.classes import CLASS_COLOURS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_EDGES = ((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7))
_STEPS = 9  # an edge is bent by distortion, so it is drawn through so many points


def box_lines(boxes: Boxes, camera: Camera) -> list[Float[np.ndarray, "steps 2"]]:
    """Project the twelve edges of each box; edges that leave the picture are cut where they do.

    Args:
        boxes: Boxes in the frame that the camera's pose refers to.
        camera: A calibrated camera.

    Returns:
        Polylines in pixels, each of shape (steps, 2).
    """
    if not len(boxes):
        return []
    corners = boxes.corners_m()
    start, end = corners[:, [a for a, _ in _EDGES]], corners[:, [b for _, b in _EDGES]]
    share = np.linspace(0.0, 1.0, _STEPS)[:, None]
    along = start[:, :, None] + (end - start)[:, :, None] * share
    pixels, _, visible = camera.project(along.reshape(-1, 3))
    shape = (-1, _STEPS)
    return [
        line[seen]
        for line, seen in zip(pixels.reshape(*shape, 2), visible.reshape(shape), strict=True)
        if seen.sum() >= 2
    ]


def camera_picture(
    image: UInt8[np.ndarray, "height width 3"],
    camera: Camera | None,
    *,
    annotated: Boxes | None = None,
    predicted: Boxes | None = None,
    points_m: Float[np.ndarray, "n 3"] | None = None,
    title: str = "",
) -> "Figure":
    """Draw an image with projected points and boxes, in a colour a class (Cirrus, Figure 5); else the image alone.

    Args:
        image: Shape (height, width, 3), uint8.
        camera: Its calibration, or None: then nothing is projected.
        annotated: Annotated boxes, drawn solid.
        predicted: Predicted boxes, dashed where there are annotated ones too.
        points_m: Points in the frame of the boxes, shape (n, 3), drawn in a colour by range.
        title: Title.
    """
    height, width = image.shape[:2]
    with house_style():
        figure = new_figure(11.0, 11.0 * height / width + (0.3 if title else 0.0))
        axes = figure.add_subplot()
        axes.imshow(image, interpolation="antialiased")
        if camera is not None:
            if points_m is not None:
                _draw_points(axes, points_m, camera)
            for boxes, line_width in ((annotated, 2.0), (predicted, 1.2)):
                if boxes is not None:
                    style = "dashed" if boxes is predicted and annotated is not None else "solid"
                    _draw_boxes(axes, boxes, camera, line_width, style, tagged=boxes is predicted or predicted is None)
        axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))
        axes.set_axis_off()
        if title:
            axes.set_title(title)
    return figure


def _draw_points(axes: "Axes", points_m: Float[np.ndarray, "n 3"], camera: Camera) -> None:
    pixels, _, visible = camera.project(points_m)
    range_m = np.hypot(points_m[:, 0], points_m[:, 1])[visible]
    seen = pixels[visible]
    axes.scatter(seen[:, 0], seen[:, 1], c=range_m, s=1.2, cmap="viridis_r", linewidths=0, zorder=1)


def _draw_boxes(axes: "Axes", boxes: Boxes, camera: Camera, line_width: float, style: str, *, tagged: bool) -> None:
    from matplotlib.collections import LineCollection

    labels = np.asarray(boxes.label)
    for name in dict.fromkeys(labels.tolist()):
        of_class, colour = boxes[labels == name], CLASS_COLOURS.get(name, POINT)
        lines = LineCollection(box_lines(of_class, camera), colors=colour, linewidths=line_width, linestyles=style)
        axes.add_collection(lines)
        if tagged:
            _draw_tags(axes, of_class, camera, colour)


def _draw_tags(axes: "Axes", boxes: Boxes, camera: Camera, colour: str) -> None:
    """Class and score above each box that is seen."""
    if not len(boxes):
        return
    pixels, _, visible = camera.project(boxes.corners_m().reshape(-1, 3))
    for place, seen, words in zip(pixels.reshape(-1, 8, 2), visible.reshape(-1, 8), tags_of(boxes), strict=True):
        if seen.any():
            left, top = place[seen].min(axis=0)
            axes.text(left, top - 2, words, color=colour, fontsize=6.5, va="bottom", clip_on=True)

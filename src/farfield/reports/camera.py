"""Camera pictures with boxes projected into them."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, UInt8

from farfield.geometry.boxes import Boxes
from farfield.geometry.cameras import Camera
from farfield.reports.style import ANNOTATED, PREDICTED, house_style, new_figure
from farfield.reports.tags import tags_of

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
    title: str = "",
) -> "Figure":
    """Draw an image with projected boxes; without a calibration the image alone.

    Args:
        image: Shape (height, width, 3), uint8.
        camera: Its calibration, or None.
        annotated: Annotated boxes.
        predicted: Predicted boxes.
        title: Title.
    """
    from matplotlib.collections import LineCollection

    height, width = image.shape[:2]
    with house_style():
        figure = new_figure(11.0, 11.0 * height / width + (0.3 if title else 0.0))
        axes = figure.add_subplot()
        axes.imshow(image, interpolation="antialiased")
        for boxes, colour, line_width in ((annotated, ANNOTATED, 2.0), (predicted, PREDICTED, 1.2)):
            if camera is not None and boxes is not None:
                axes.add_collection(LineCollection(box_lines(boxes, camera), colors=colour, linewidths=line_width))
                if boxes is predicted or predicted is None:
                    _draw_tags(axes, boxes, camera, colour)
        axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))
        axes.set_axis_off()
        if title:
            axes.set_title(title)
    return figure


def _draw_tags(axes: "Axes", boxes: Boxes, camera: Camera, colour: str) -> None:
    """Class and score above each box that is seen."""
    if not len(boxes):
        return
    pixels, _, visible = camera.project(boxes.corners_m().reshape(-1, 3))
    for place, seen, words in zip(pixels.reshape(-1, 8, 2), visible.reshape(-1, 8), tags_of(boxes), strict=True):
        if seen.any():
            left, top = place[seen].min(axis=0)
            axes.text(left, top - 2, words, color=colour, fontsize=6.5, va="bottom", clip_on=True)

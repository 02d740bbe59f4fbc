"""Words beside the boxes of a picture: class and score."""

from typing import TYPE_CHECKING

import numpy as np

from farfield.geometry.boxes import Boxes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MOST_TAGS = 80  # in one picture


def tags_of(boxes: Boxes) -> list[str]:
    """Class and, where there is one, score of each box, such as ``"vehicle 0.87"``."""
    if boxes.score is None:
        return [str(label) for label in boxes.label]
    return [f"{label} {score:.2f}" for label, score in zip(boxes.label, boxes.score, strict=True)]


def draw_tags(axes: "Axes", boxes: Boxes, colour: str) -> None:
    """Class and score beside each box seen from above; of very many beside the surest, or else the nearest."""
    order = np.argsort(boxes.range_m if boxes.score is None else -boxes.score, kind="stable")[:_MOST_TAGS]
    corners = boxes.bev_corners_m()
    for row, words in zip(order, tags_of(boxes[order]), strict=True):
        right, top = corners[row].max(axis=0)
        axes.annotate(
            words,
            (right, top),
            xytext=(1.5, 0.5),
            textcoords="offset points",
            fontsize=6.5,
            color=colour,
            annotation_clip=True,
            clip_on=True,
            zorder=6,
        )

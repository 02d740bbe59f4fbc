"""A radar frame's power from above, with boxes."""

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from farfield.evaluation.objects import of_classes
from farfield.figures.birds_eye import draw_boxes, draw_rings
from farfield.figures.style import house_style, new_figure
from farfield.geometry.boxes import Boxes
from farfield.radar.grid import CUBE_STEP_M, CUBE_X_M, CUBE_Y_M

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

_OTHERS = "#adb5bd"
ANNOTATED_ON_MAP, PREDICTED_ON_MAP = "#3ddbd9", "#ffd43b"
"""Colours of boxes that stand out from the map's dark ground."""
SECOND = "#ff8cc6"
"""Colour of a second detector's boxes on a map."""
_DETECTOR_COLOURS = (("yellow", PREDICTED_ON_MAP), ("pink", SECOND))
_MAP_ASIDE_M = 40.0


def power_map(
    power_db: Float[np.ndarray, "y x"],
    *,
    annotated: Boxes | None = None,
    predicted: Boxes | Mapping[str, Boxes] | None = None,
    labels: Collection[str] | None = None,
    rings_m: Sequence[float] = (),
) -> "Figure":
    """Draw the power, x (forward) to the right and y (left) upwards.

    Args:
        power_db: What :func:`farfield.evaluation.sensing.power_from_above` gives.
        annotated: Annotated boxes.
        predicted: Predicted boxes; of two detectors by the clouds that they read.
        labels: Classes that were asked for; annotated boxes of others are grey.
        rings_m: Ranges to mark by arcs; the outermost ends the picture.
    """
    reach_m = min(max(rings_m, default=CUBE_X_M[-1]), float(CUBE_X_M[-1]))
    sets = predicted if isinstance(predicted, Mapping) else {} if predicted is None else {"": predicted}
    with house_style():
        figure = new_figure(11.0, 0.9 + 9.6 * 2 * _MAP_ASIDE_M / (1.12 * reach_m))
        axes = figure.add_subplot()
        shown = draw_power(axes, power_db)
        window = (0.0, reach_m, -_MAP_ASIDE_M, _MAP_ASIDE_M)
        draw_rings(axes, window, rings_m, colour="white")
        if annotated is not None:
            asked = of_classes(annotated, labels)
            draw_boxes(axes, annotated[~asked], _OTHERS, line_width=0.8, order=3)
            draw_boxes(axes, annotated[asked], ANNOTATED_ON_MAP, line_width=1.8, order=4)
        for place, (boxes, (_, colour)) in enumerate(zip(sets.values(), _DETECTOR_COLOURS, strict=False)):
            draw_boxes(axes, boxes, colour, line_width=1.0, order=5 + place)
        axes.set(xlim=window[:2], ylim=window[2:], xlabel="x forward (m)", ylabel="y left (m)")
        axes.set_title("; ".join(["Blue-green: annotated", *_legend_words(list(sets))]))
        figure.colorbar(shown, ax=axes, label="mean power, dB", shrink=0.8, pad=0.02)
    return figure


def draw_power(axes: "Axes", power_db: Float[np.ndarray, "y x"]) -> "AxesImage":
    """Draw the power of K-Radar's cube as an image in metres."""
    half = CUBE_STEP_M / 2
    extent = (CUBE_X_M[0] - half, CUBE_X_M[-1] + half, CUBE_Y_M[0] - half, CUBE_Y_M[-1] + half)
    inside = power_db[np.isfinite(power_db)]
    low, high = np.percentile(inside, [20.0, 99.8]) if inside.size else (0.0, 1.0)
    axes.set_facecolor("black")
    return axes.imshow(
        power_db, origin="lower", extent=extent, cmap="magma", vmin=low, vmax=max(high, low + 6.0), aspect="equal"
    )


def _legend_words(clouds: Sequence[str]) -> list[str]:
    """Whose predictions have which colour."""
    return [
        f"{word}: predicted{f' from {cloud}' if cloud else ''}"
        for cloud, (word, _) in zip(clouds, _DETECTOR_COLOURS, strict=False)
    ]

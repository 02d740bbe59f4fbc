"""A radar's power from above, with the annotated boxes: of its products, or of its points where there are no others."""

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from farfield.errors import DatasetError
from farfield.figures.birds_eye import draw_boxes, fitting_window
from farfield.figures.radar_picture import cube_extent, power_levels
from farfield.figures.style import ANNOTATED, PREDICTED, RULE, house_style, new_figure
from farfield.frame import Boxes, Frame
from farfield.radar.grid import CUBE_X_M, CUBE_Y_M
from farfield.radar.views import PRODUCTS, radar_views

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

POWER_COLOURS = "magma"
_ON_DARK = "#3ddbd9"  # annotated boxes on a map
_STRENGTHS = {"rcs_dbsm": "RCS, dBsm", "power": "power, dB over 1e13", "snr_db": "SNR, dB"}


def radar_map(frame: Frame, predictions: Boxes | None = None) -> "Figure":
    """Draw a radar's power from above.

    K-Radar's products are drawn as the mean power over the heights of its wide region (BEV-2D), in dB over 1e13; of a
    frame without them the points of its first radar cloud, by their strength.

    Args:
        frame: A frame; with products, in the radar's coordinates.
        predictions: Predicted boxes.

    Raises:
        DatasetError: If the frame has nothing of a radar, or is in another sensor's coordinates.
    """
    if frame.radar and frame.reference != "radar" and any(name in frame.radar for name in PRODUCTS):
        raise DatasetError(
            f"frame {frame.key}: expected the radar's coordinates, got {frame.reference}'s. "
            "Open the data set with reference='radar'"
        )
    views = radar_views(frame.radar) if frame.radar else None
    with house_style():
        figure = new_figure(10.5, 6.0)
        axes = figure.add_subplot()
        axes.set_facecolor(RULE)
        if views is None:
            drawn, what, made_of = _points(axes, frame)
        else:
            drawn, what = _image(axes, views.bird_db), "mean power over height, dB over 1e13"
            made_of = " and ".join(views.products)
        outline = ANNOTATED if views is None else _ON_DARK
        for boxes, colour in ((frame.boxes, outline), (predictions, PREDICTED)):
            if boxes is not None:
                draw_boxes(axes, boxes, colour, line_width=1.2, order=4)
        figure.colorbar(drawn, ax=axes, location="right", label=what, shrink=0.9)
        said = ", ".join(word.replace("_", " ") for word in frame.conditions.values())
        axes.set(xlabel="x ahead (m)", ylabel="y left (m)", aspect="equal")
        axes.set_title("; ".join(filter(None, [f"{frame.sequence}, {frame.frame_id}", said, f"from {made_of}"])))
    return figure


def _image(axes: "Axes", bird_db: Float[np.ndarray, "y x"]) -> Any:
    low, high = power_levels(bird_db)
    extent = cube_extent(CUBE_X_M, CUBE_Y_M)
    filled = np.isfinite(bird_db)
    drawn = axes.imshow(bird_db, origin="lower", extent=extent, cmap=POWER_COLOURS, vmin=low, vmax=high)
    ahead, aside = CUBE_X_M[filled.any(axis=0)], CUBE_Y_M[filled.any(axis=1)]
    if len(ahead) and len(aside):  # cells of a region leave the rest of the cube empty
        axes.set(xlim=(max(ahead[0], 0.0), ahead[-1]), ylim=(aside[0], aside[-1]))
    return drawn


def _points(axes: "Axes", frame: Frame) -> tuple[Any, str, str]:
    """The points of the first radar cloud, coloured by their strength."""
    name = next((n for n in frame.clouds if n in frame.sensors and frame.sensors[n].kind == "radar"), None)
    if name is None:
        there = ", ".join([*frame.radar, *frame.clouds, *frame.images]) or "nothing"
        raise DatasetError(
            f"frame {frame.key}: there is no radar: expected one of {', '.join(PRODUCTS)} or a radar's cloud, found "
            f"{there}"
        )
    cloud = frame.cloud(name)
    column = next((each for each in _STRENGTHS if each in cloud.columns), "z_m")
    values = cloud.column(column)
    if column == "power":
        values = 10 * np.log10(np.maximum(values, 1e-9))
    x, y, _ = cloud.points_m.T
    drawn = axes.scatter(x, y, c=values, s=9, cmap=POWER_COLOURS, linewidths=0)
    left, right, low, high = fitting_window(cloud, frame.boxes)
    axes.set(xlim=(left, right), ylim=(low, high))
    return drawn, _STRENGTHS.get(column, "height, m"), f"the cloud {name}"

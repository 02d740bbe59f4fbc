"""Crops of lost objects: each from above, from the side, and in the camera's picture where there is one."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from farfield.figures.camera import box_lines
from farfield.figures.style import ANNOTATED, PREDICTED, house_style, new_figure
from farfield.frame import Boxes, Frame
from farfield.geometry.boxes import box_coordinates_m

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ABOUT_M, _ACROSS = 6.0, 4


def lost_gallery(frames: Mapping[tuple[str, str], Frame], objects: Sequence[Mapping[str, Any]], cloud: str) -> "Figure":
    """Draw lost objects, a column each: from above, from the side, in the first camera that sees them.

    Args:
        frames: Their frames by (sequence, frame).
        objects: Rows of :class:`farfield.evaluation.lost.Lost`.
        cloud: Name of the cloud that was read.
    """
    across, down = min(len(objects), _ACROSS), -(-len(objects) // _ACROSS)
    with house_style():
        figure = new_figure(2.9 * across, 6.4 * down)
        grid = figure.subplots(3 * down, across, squeeze=False, height_ratios=[1.5, 0.8, 1.1] * down)
        for axes in grid.ravel():
            axes.set_axis_off()
        for number, row in enumerate(objects):
            top, column = 3 * (number // across), number % across
            frame, box = frames[row["sequence"], row["frame"]], box_of(row)
            colour = PREDICTED if row["kind"] == "false" else ANNOTATED
            points = frame.cloud(cloud if cloud in frame.clouds else next(iter(frame.clouds))).points_m
            _from_above(grid[top, column], points, box, colour)
            _from_the_side(grid[top + 1, column], points, box, colour)
            _in_camera(grid[top + 2, column], frame, box, colour)
            counted = f", {row['points']:.0f} points" if "points" in row else ""
            score = f" {row['score']:.2f}" if "score" in row else ""
            grid[top, column].set_title(
                f"{row['kind']}{score}: {row['label']}\n{row['range_m']:.0f} m{counted}", fontsize=8
            )
    return figure


def box_of(row: Mapping[str, Any]) -> Boxes:
    """The box of a row."""
    return Boxes(
        centre_m=np.array([[row["x_m"], row["y_m"], row["z_m"]]], dtype=np.float64),
        size_m=np.array([[row["length_m"], row["width_m"], row["height_m"]]], dtype=np.float64),
        yaw_rad=np.radians([float(row["yaw_deg"])]),
        label=str(row["label"]),
    )


def _from_above(axes: "Axes", points: Any, box: Boxes, colour: str) -> None:
    x, y = box.centre_m[0, :2]
    about_m = _ABOUT_M + float(box.size_m[0, :2].max()) / 2
    near = points[(np.abs(points[:, 0] - x) < about_m) & (np.abs(points[:, 1] - y) < about_m)]
    axes.scatter(near[:, 0], near[:, 1], s=2, c=near[:, 2], cmap="viridis", linewidths=0)
    corners = box.bev_corners_m()[0]
    axes.plot(*corners[[0, 1, 2, 3, 0]].T, color=colour, lw=1.4)
    axes.set(xlim=(x - about_m, x + about_m), ylim=(y - about_m, y + about_m), aspect="equal")


def _from_the_side(axes: "Axes", points: Any, box: Boxes, colour: str) -> None:
    own = box_coordinates_m(points, box, 0)
    length, width, height = box.size_m[0]
    near = own[(np.abs(own[:, 1]) < width / 2 + 0.5) & (np.abs(own[:, 0]) < length / 2 + 3) & (np.abs(own[:, 2]) < 4)]
    axes.scatter(near[:, 0], near[:, 2], s=2, c=near[:, 2], cmap="viridis", linewidths=0)
    along, up = np.array([1, 1, -1, -1, 1]) * length / 2, np.array([1, -1, -1, 1, 1]) * height / 2
    axes.plot(along, up, color=colour, lw=1.4)
    axes.set(xlim=(-length / 2 - 3, length / 2 + 3), ylim=(-height / 2 - 1, height / 2 + 1.5), aspect="equal")


def _in_camera(axes: "Axes", frame: Frame, box: Boxes, colour: str) -> None:
    for name, camera in frame.cameras.items():
        lines = box_lines(box, camera) if name in frame.images else []
        if not lines:
            continue
        image = frame.images[name]
        pixels = np.concatenate(lines)
        middle, half = pixels.mean(axis=0), max(60.0, 0.8 * float(np.ptp(pixels, axis=0).max()))
        left, right = max(0, int(middle[0] - half)), min(image.shape[1], int(middle[0] + half))
        top, bottom = max(0, int(middle[1] - half)), min(image.shape[0], int(middle[1] + half))
        if right <= left or bottom <= top:
            continue
        axes.imshow(image[top:bottom, left:right], extent=(left, right, bottom, top))
        for line in lines:
            axes.plot(*line.T, color=colour, lw=0.9)
        axes.set(xlim=(left, right), ylim=(bottom, top))
        return

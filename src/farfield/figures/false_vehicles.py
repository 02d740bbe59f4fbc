"""False vehicles of a detector: how many over the recall of pasted cars, and what each was taken from."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64

from farfield.evaluation.donor_trial import RECALL, DonorTrial, FalseVehicle
from farfield.figures.style import INK, MUTED, PREDICTED, house_style, new_figure
from farfield.frame import Boxes, Frame
from farfield.geometry.boxes import points_in_boxes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ACROSS, _ABOUT_M = 6, 6.0
_MOST_FALSE = 20.0


def false_vehicle_curves(trials: Mapping[str, Mapping[str, DonorTrial]]) -> "Figure":
    """False vehicles a sweep over the recall of pasted cars.

    Args:
        trials: By set of sweeps, a panel each, and in it by detector.
    """
    across = min(len(trials), 3)
    down = -(-len(trials) // across)
    with house_style():
        figure = new_figure(11.0 if across > 1 else 8.0, 0.7 + 3.2 * down)
        panels = figure.subplots(down, across, squeeze=False).ravel()
        for axes, (title, by_detector) in zip(panels, trials.items(), strict=False):
            highest = 1.0
            for name, trial in by_detector.items():
                _, recall, false = trial.curve()
                axes.step(recall, false, where="post", label=name)
                highest = max(highest, float(false.max(initial=0)))
            axes.axvline(RECALL, color=MUTED, lw=0.8)
            top = min(1.1 * highest, _MOST_FALSE)
            axes.set(title=title, xlim=(0, 1), ylim=(0, top), xlabel="recall of pasted cars", ylabel="false a sweep")
            axes.grid(visible=True)
        for axes in panels[len(trials) :]:
            axes.set_visible(False)
        handles, names = panels[0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside lower center", ncols=3)
    return figure


def false_vehicle_gallery(frames: Mapping[int, Frame], false: Sequence[FalseVehicle]) -> "Figure":
    """False vehicles, each from above and below that from the side, in the sweep without its annotated objects.

    Args:
        frames: The sweeps by row, in the sensor's axes.
        false: The false vehicles.
    """
    down, across = -(-len(false) // _ACROSS), min(len(false), _ACROSS)
    with house_style():
        figure = new_figure(2.6 * across, 4.4 * down)
        grid = figure.subplots(2 * down, across, squeeze=False, height_ratios=[1.5, 1.0] * down)
        for axes in grid.ravel():
            axes.set_axis_off()
        for number, one in enumerate(false):
            row, column = 2 * (number // across), number % across
            _draw(grid[row, column], grid[row + 1, column], frames[one.sweep], one)
    return figure


def _draw(above: "Axes", beside: "Axes", frame: Frame, one: FalseVehicle) -> None:
    points = _without_objects(frame)
    x, y, z = one.box.centre_m[0]
    near = points[(np.abs(points[:, 0] - x) < _ABOUT_M) & (np.abs(points[:, 1] - y) < _ABOUT_M)]
    corners = one.box.corners_m()[0]
    ground = corners[np.argsort(corners[:, 2])[:4], :2]
    ground = ground[np.argsort(np.arctan2(*(ground - ground.mean(axis=0)).T))]
    for axes, up in ((above, 1), (beside, 2)):
        axes.scatter(near[:, 0], near[:, up], s=1.5, c=near[:, 2], cmap="viridis", linewidths=0)
        axes.set_aspect("equal")
    above.plot(*ground[[0, 1, 2, 3, 0]].T, color=PREDICTED, lw=1.2)
    half_m, left, right = one.box.size_m[0, 2] / 2, ground[:, 0].min(), ground[:, 0].max()
    beside.plot(
        [left, right, right, left, left], [z - half_m, z - half_m, z + half_m, z + half_m, z - half_m], color=PREDICTED
    )
    above.set(xlim=(x - _ABOUT_M, x + _ABOUT_M), ylim=(y - _ABOUT_M, y + _ABOUT_M))
    beside.set(xlim=(x - _ABOUT_M, x + _ABOUT_M), ylim=(z - 3, z + 5))
    above.set_title(f"score {one.score:.2f}, {np.hypot(x, y):.0f} m, {one.points} points", fontsize=8, color=INK)


def _without_objects(frame: Frame) -> Float64[np.ndarray, "n 3"]:
    points = frame.cloud().points_m.astype(np.float64)
    stays = np.ones(len(points), dtype=bool)
    boxes = frame.boxes if frame.boxes is not None else Boxes.empty()
    if len(boxes):
        stays[np.concatenate(points_in_boxes(points, boxes, margin_m=0.2))] = False
    return points[stays]

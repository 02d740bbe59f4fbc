"""Sweeps of two data sets from above on one scale, and the time that their reach leaves (Cirrus, Figure 2)."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from farfield.figures.style import INK, MUTED, SIDES, house_style, new_figure
from farfield.inspection.side import ComparedDataset

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SPEED_MPH = 75.0
"""The speed of the Cirrus paper's example, at which 250, 120 and 70 m leave 7.5, 3.5 and 2 s."""
_MPH_M_S = 0.44704
_REACHED_SHARE = 0.999


def effective_range_m(cloud: Mapping[str, Any]) -> float | None:
    """Range within which 99.9 % of a cloud's returns lie, metres; None without returns.

    The farthest return is one echo of a bridge; a share of all returns is what a detector can live on.
    """
    count = np.asarray(cloud["range"]["count"], dtype=np.float64)
    edges = np.asarray(cloud["range"]["edges_m"], dtype=np.float64)
    if not count.sum():
        return None
    share = np.concatenate([[0.0], np.cumsum(count) / count.sum()])
    return float(np.interp(_REACHED_SHARE - 1e-9, share, edges))


def reaction_s(range_m: float, *, speed_m_s: float = SPEED_MPH * _MPH_M_S) -> float:
    """Seconds until what is seen at a range is reached.

    >>> [round(reaction_s(each), 1) for each in (250.0, 120.0, 70.0)]
    [7.5, 3.6, 2.1]
    """
    return range_m / speed_m_s


def from_above(sides: Sequence[ComparedDataset]) -> "Figure | None":
    """One sweep of each cloud, rings every 50 m, its effective range as a dashed ring."""
    panels = [
        (side, name, colour)
        for side, colour in zip(sides, SIDES, strict=False)
        for name in side.summary["clouds"]
        if f"sweep/{name}" in side.arrays
    ]
    if not panels:
        return None
    reaches = [effective_range_m(side.summary["clouds"][name]) for side, name, _ in panels]
    window_m = max([50.0, *(1.1 * reach for reach in reaches if reach)])
    across = min(len(panels), 4)
    down = -(-len(panels) // across)
    with house_style():
        figure = new_figure(11.0, 11.0 / across * down + 0.3)
        grid = figure.subplots(down, across, squeeze=False).ravel()
        for axes in grid[len(panels) :]:
            axes.set_axis_off()
        for axes, (side, name, colour), reach in zip(grid, panels, reaches, strict=False):
            points = side.arrays[f"sweep/{name}"]["xy_m"]
            axes.scatter(points[:, 1], points[:, 0], s=0.25, c=colour, linewidths=0, rasterized=True)
            for ring in np.arange(50.0, window_m, 50.0):
                axes.add_patch(_circle(ring, MUTED, "-", 0.4))
            if reach:
                axes.add_patch(_circle(reach, INK, (0, (4, 2)), 1.0))
            axes.set(xlim=(window_m, -window_m), ylim=(-window_m, window_m), aspect="equal")  # y points left
            axes.set(xlabel="y (m)", ylabel="x (m)")
            axes.set_title(_sweep_title(side, name, reach))
    return figure


def _sweep_title(side: ComparedDataset, name: str, reach: float | None) -> str:
    told = f"{side.title}, {name}"
    return told if reach is None else f"{told}\n{reach:.0f} m: {reaction_s(reach):.1f} s at {SPEED_MPH:.0f} mph"


def _circle(radius: float, colour: str, dash: Any, width: float) -> Any:
    from matplotlib.patches import Circle

    return Circle((0.0, 0.0), radius, fill=False, ec=colour, ls=dash, lw=width)

"""The sensors of a car from above and from the left, each with its axes (Cirrus' Figure 3)."""

from typing import TYPE_CHECKING

import numpy as np

from farfield.figures.style import INK, MUTED, PATTERNS, house_style, new_figure
from farfield.inspection.placement import RigPlacement, SensorPlacement

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_AXES = (("x", "#c92a2a"), ("y", "#2b8a3e"), ("z", "#1864ab"))
_KINDS = {"lidar": PATTERNS[0], "radar": PATTERNS[3], "camera": PATTERNS[1]}
_MOST_NAMES = 2


def placement_figure(found: RigPlacement | None) -> "Figure | None":
    """Draw the sensors; None where fewer than two have a known place.

    Args:
        found: As :func:`farfield.inspection.placement.placement` gives it.
    """
    if found is None or len(found.sensors) < 2:
        return None
    places = np.array([each.frame_T_sensor[:3, 3] for each in found.sensors])
    size = max(float(np.ptp(places, axis=0).max()), 0.5)
    with house_style():
        figure = new_figure(11.0, 4.6)
        above, beside = figure.subplots(1, 2)
        _draw_sensors(above, found, (1, 0), size, mirrored=True)
        _draw_sensors(beside, found, (0, 2), size, mirrored=False)
        above.set(title="From above, ahead is up", xlabel="y, left (m)", ylabel="x, forward (m)")
        beside.set(title="From the right, ahead is to the right", xlabel="x, forward (m)", ylabel="z, up (m)")
        handles = [above.plot([], [], color=colour, label=name)[0] for name, colour in _AXES]
        figure.legend(handles=handles, loc="outside lower center", ncols=3, title="axes of each sensor")
    return figure


def _draw_sensors(
    axes: "Axes", found: RigPlacement, across_up: tuple[int, int], size: float, *, mirrored: bool
) -> None:
    rows = list(across_up)
    axes.scatter(0, 0, marker="+", s=60, color=MUTED, linewidths=0.8)
    taken: list[np.ndarray] = []
    for each in found.sensors:
        at = each.frame_T_sensor[rows, 3]
        for number, (_, colour) in enumerate(_AXES):
            end = at + 0.18 * size * each.frame_T_sensor[rows, number]
            if np.linalg.norm(end - at) > 0.02 * size:
                arrow = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.2}
                axes.annotate("", (float(end[0]), float(end[1])), (float(at[0]), float(at[1])), arrowprops=arrow)
        axes.scatter(at[0], at[1], s=26, color=_KINDS[each.kind], zorder=3)
        lower = sum(bool(np.linalg.norm(at - other) < 0.15 * size) for other in taken)
        taken.append(at)
        place, below = (float(at[0]), float(at[1])), (6, -10 - 11 * lower)
        axes.annotate(_sensor_name(each), place, below, textcoords="offset points", fontsize=7.5, color=INK)
    spread = np.array([each.frame_T_sensor[rows, 3] for each in found.sensors] + [np.zeros(2)])
    middle, reach = (spread.min(axis=0) + spread.max(axis=0)) / 2, 0.5 * size + 0.35 * size
    low, high = middle - reach, middle + reach
    axes.set_xlim(*((high[0], low[0]) if mirrored else (low[0], high[0])))
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    axes.grid(True)


def _sensor_name(each: SensorPlacement) -> str:
    shown = ", ".join(each.names[:_MOST_NAMES]) + (", ..." if len(each.names) > _MOST_NAMES else "")
    x, y, z = each.frame_T_sensor[:3, 3]
    return f"{shown} ({x:.2f}, {y:.2f}, {z:.2f})"

"""The sensors of a car from above and from the left (Cirrus' Figure 3); a calibration before and after."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, UInt8

from farfield.figures.style import INK, MUTED, PATTERNS, house_style, new_figure
from farfield.geometry.cameras import Camera
from farfield.inspection.placement import RigPlacement

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_AXES = (("x", "#c92a2a"), ("y", "#2b8a3e"), ("z", "#1864ab"))
_KINDS = {"lidar": PATTERNS[0], "radar": PATTERNS[3], "camera": PATTERNS[1]}
_MOST_NAMES = 2


def placement_figure(placement: RigPlacement | None) -> "Figure | None":
    """Draw the sensors; None where fewer than two have a known place.

    Args:
        placement: As :func:`farfield.inspection.placement.placement` gives it.
    """
    if placement is None or len(placement.sensors) < 2:
        return None
    positions_m = np.array([sensor.frame_T_sensor[:3, 3] for sensor in placement.sensors])
    size = max(float(np.ptp(positions_m, axis=0).max()), 0.5)
    with house_style():
        figure = new_figure(11.0, 4.6)
        above, beside = figure.subplots(1, 2)
        _draw_sensors(above, placement, (1, 0), size, mirrored=True)
        _draw_sensors(beside, placement, (0, 2), size, mirrored=False)
        above.set(title="From above, ahead is up", xlabel="y, left (m)", ylabel="x, forward (m)")
        beside.set(title="From the right, ahead is to the right", xlabel="x, forward (m)", ylabel="z, up (m)")
        handles = [above.plot([], [], color=colour, label=name)[0] for name, colour in _AXES]
        figure.legend(handles=handles, loc="outside lower center", ncols=3, title="axes of each sensor")
    return figure


def _draw_sensors(
    axes: "Axes", placement: RigPlacement, across_up: tuple[int, int], size: float, *, mirrored: bool
) -> None:
    rows = list(across_up)
    axes.scatter(0, 0, marker="+", s=60, color=MUTED, linewidths=0.8)
    drawn_at: list[np.ndarray] = []
    for sensor in placement.sensors:
        at = sensor.frame_T_sensor[rows, 3]
        for number, (_, colour) in enumerate(_AXES):
            end = at + 0.18 * size * sensor.frame_T_sensor[rows, number]
            if np.linalg.norm(end - at) > 0.02 * size:
                arrow = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.2}
                axes.annotate("", (float(end[0]), float(end[1])), (float(at[0]), float(at[1])), arrowprops=arrow)
        axes.scatter(at[0], at[1], s=26, color=_KINDS[sensor.kind], zorder=3)
        lower = sum(bool(np.linalg.norm(at - other) < 0.15 * size) for other in drawn_at)
        drawn_at.append(at)
        anchor, below = (float(at[0]), float(at[1])), (6, -10 - 11 * lower)
        shown = ", ".join(sensor.names[:_MOST_NAMES]) + (", ..." if len(sensor.names) > _MOST_NAMES else "")
        x, y, z = sensor.frame_T_sensor[:3, 3]
        text = f"{shown} ({x:.2f}, {y:.2f}, {z:.2f})"
        axes.annotate(text, anchor, below, textcoords="offset points", fontsize=7.5, color=INK)
    spread = np.array([sensor.frame_T_sensor[rows, 3] for sensor in placement.sensors] + [np.zeros(2)])
    middle, half_m = (spread.min(axis=0) + spread.max(axis=0)) / 2, 0.5 * size + 0.35 * size
    low, high = middle - half_m, middle + half_m
    axes.set_xlim(*((high[0], low[0]) if mirrored else (low[0], high[0])))
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    axes.grid(True)


# Pictures of a calibration before and after: edges in the image, both sensors from above.

_SCALE = 4
_BEFORE, _AFTER = (255, 64, 64), (64, 255, 64)


def camera_calibration_picture(
    picture: UInt8[np.ndarray, "height width 3"], edges_m: Float[np.ndarray, "n 3"], before: Camera, after: Camera
) -> UInt8[np.ndarray, "2*height width 3"]:
    """A picture twice, one above the other, with the LiDAR's depth edges: red before, green after.

    Args:
        picture: Shape (height, width, 3).
        edges_m: Depth edges of its sweep in the LiDAR's frame, shape (n, 3).
        before: The camera before the calibration.
        after: The camera after it.
    """
    halves = [_draw_edges(picture, camera, edges_m, ink) for camera, ink in ((before, _BEFORE), (after, _AFTER))]
    return np.concatenate(halves)


def _draw_edges(
    picture: UInt8[np.ndarray, "height width 3"],
    camera: Camera,
    points_m: Float[np.ndarray, "n 3"],
    ink: tuple[int, int, int],
) -> UInt8[np.ndarray, "height width 3"]:
    image = (picture * 0.7).astype(np.uint8)
    pixels, _, visible = camera.project(points_m)
    column, row = np.clip(pixels[visible].round().astype(int), 0, [image.shape[1] - 2, image.shape[0] - 2]).T
    for down in (0, 1):
        for right in (0, 1):
            image[row + down, column + right] = ink
    return image


FromAbove = tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "h w"]]
"""The LiDAR's points in the radar's frame, shape (n, 2), and the radar's power over what is usual, in dB, in cells of
0.4 m from x = 0 and centred on y = 0, x along the first axis."""


def radar_calibration_picture(before: FromAbove, after: FromAbove) -> UInt8[np.ndarray, "rows columns 3"]:
    """A frame's radar power (blue) under the LiDAR's points, from above; before left, after right."""
    halves = [_draw_from_above(*view, ink) for view, ink in ((before, _BEFORE), (after, _AFTER))]
    return np.concatenate([halves[0], np.full((len(halves[0]), 8, 3), 255, np.uint8), halves[1]], axis=1)


def _draw_from_above(
    points_m: Float[np.ndarray, "n 2"], power_db: Float[np.ndarray, "h w"], ink: tuple[int, int, int]
) -> UInt8[np.ndarray, "rows columns 3"]:
    power = np.clip(power_db / 25.0, 0.0, 1.0)
    image = np.zeros((*(_SCALE * np.array(power.shape)), 3), dtype=np.uint8)
    image[..., 2] = np.kron(255 * power, np.ones((_SCALE, _SCALE))).astype(np.uint8)
    image[..., 1] = image[..., 2] // 2
    cell = np.floor(points_m * _SCALE / 0.4).astype(int) + np.array([0, image.shape[1] // 2])
    inside = ((cell >= 0) & (cell < image.shape[:2])).all(axis=1)
    image[cell[inside, 0], cell[inside, 1]] = ink
    return image[::-1, ::-1].copy()  # ahead is up, left is left

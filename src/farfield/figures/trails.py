"""Tracks from above: the trail of each, in the world where there are poses."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from farfield.figures.style import INK, MUTED, figure_bytes, house_style, new_figure, picture_kind
from farfield.files.atomic import write_bytes
from farfield.frame.drive import Key
from farfield.metrics.detections import Detections
from farfield.metrics.frames import frame_order
from farfield.vocabulary.counts import count_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_SEQUENCES = 12
STANDING_M = 2.0
_COLOURS = ("#0b6e99", "#c2255c", "#2b8a3e", "#e67700", "#5f3dc4", "#846358", "#087f5b", "#a61e4d")

Trail = Float[np.ndarray, "n 2"]


def trails_of(tracks: Detections) -> dict[str, dict[int, Trail]]:
    """Places of each track in the order of time, by sequence and identity.

    Returns:
        x and y in the world where the sequence has poses, else in the sensor's own coordinates.
    """
    poses = _poses(tracks)
    positions: dict[str, dict[int, list[np.ndarray]]] = {}
    for key in sorted(tracks.boxes, key=frame_order):
        boxes = tracks.boxes[key]
        boxes = boxes.transform(poses[key]) if key in poses else boxes
        of_sequence = positions.setdefault(key[0], {})
        for row, name in enumerate([] if boxes.track_id is None else boxes.track_id.tolist()):
            of_sequence.setdefault(name, []).append(boxes.centre_m[row, :2])
    return {key: {name: np.array(track) for name, track in trails.items()} for key, trails in positions.items()}


def _poses(tracks: Detections) -> Mapping[Key, Float[np.ndarray, "4 4"]]:
    return {
        key: drive.world_T_frame[number]
        for drive in tracks.drives
        if drive.world_T_frame is not None
        for number, key in enumerate(drive.keys)
    }


def trails_picture(tracks: Detections) -> "Figure":
    """Draw the trails of the first sequences from above, a panel each: a line a track, a dot where it was last seen.

    Tracks that stay within :data:`STANDING_M` are a square. The sensor's own path is dashed where there are poses, and
    places are counted from its start, a triangle; without poses that is where the sensor stands.
    """
    trails, poses = trails_of(tracks), _poses(tracks)
    shown = list(trails)[:MOST_SEQUENCES]
    columns = min(3, max(len(shown), 1))
    rows = -(-max(len(shown), 1) // columns)
    with house_style():
        figure = new_figure(4.6 * columns + 1.5, 4.2 * rows + 0.4)
        for index, name in enumerate(shown):
            axes = figure.add_subplot(rows, columns, index + 1)
            keys = sorted((key for key in tracks.boxes if key[0] == name), key=frame_order)
            path = np.array([poses[key][:2, 3] for key in keys if key in poses]).reshape(-1, 2)
            _draw(axes, trails[name], path)
            axes.set_title(
                f"{name or 'tracks'}: {count_of(len(trails[name]), 'track')}, {count_of(len(keys), 'frame')}"
            )
        if len(trails) > len(shown):
            figure.suptitle(
                f"the first {len(shown)} of {count_of(len(trails), 'sequence')}", x=0.01, ha="left", color=MUTED
            )
    return figure


def _draw(axes: "Axes", trails: Mapping[int, np.ndarray], path: Trail) -> None:
    from matplotlib import patheffects
    from matplotlib.lines import Line2D

    start = path[0] if len(path) else np.zeros(2)
    for name, trail in trails.items():
        colour, relative_m = _COLOURS[name % len(_COLOURS)], trail - start
        if np.ptp(trail, axis=0).max() < STANDING_M:
            axes.plot(*relative_m[-1:].T, color=colour, marker="s", markersize=2.2, alpha=0.8, linestyle="none")
            continue
        axes.plot(*relative_m.T, color=colour, linewidth=1.1, alpha=0.85, solid_capstyle="round")
        axes.plot(
            *relative_m[-1:].T, color=colour, marker="o", markersize=3.4, markeredgecolor="white", markeredgewidth=0.4
        )
    if len(path):
        around = [patheffects.withStroke(linewidth=3.2, foreground="white")]
        axes.plot(
            *(path - start).T, color=INK, linewidth=1.6, linestyle="--", label="sensor", zorder=5, path_effects=around
        )
    axes.plot(0, 0, color=INK, marker="^", markersize=6, zorder=6, linestyle="none")
    axes.margins(0.03)
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(visible=True)
    axes.set_xlabel("x from the sensor's start, in the world, m" if len(path) else "x ahead of the sensor, m")
    axes.set_ylabel("y, m")
    handles = [
        *axes.get_lines()[-2 if len(path) else -1 :],
        Line2D([], [], color=MUTED, marker="s", markersize=2.2, linestyle="none"),
        Line2D([], [], color=MUTED, marker="o", markersize=3.4, linewidth=1.1),
    ]
    names = [*(["the sensor's path"] if len(path) else []), "sensor at the start" if len(path) else "sensor"]
    axes.legend(handles, [*names, "stands", "moves; the dot is its end"], loc="best", framealpha=0.85)


def write_trails(path: Path | str, tracks: Detections) -> None:
    """Write the trails from above as SVG, PNG or JPEG, by the file's name.

    Raises:
        ConfigError: If it has another ending.
    """
    path = Path(path)
    kind = picture_kind(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, figure_bytes(trails_picture(tracks), kind))

"""Tracks from above: the trail of each, in the world where there are poses."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from farfield.errors import ConfigError
from farfield.files.atomic import write_bytes
from farfield.frame.drive import Key
from farfield.metrics.detections import Detections
from farfield.metrics.frames import frame_order
from farfield.reports.style import INK, MUTED, Kind, figure_bytes, house_style, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_SEQUENCES = 12
_COLOURS = ("#0b6e99", "#c2255c", "#2b8a3e", "#e67700", "#5f3dc4", "#846358", "#087f5b", "#a61e4d")
_KINDS: dict[str, Kind] = {".svg": "svg", ".png": "png", ".jpg": "jpg"}

Trail = Float[np.ndarray, "n 2"]


def trails_of(tracks: Detections) -> dict[str, dict[int, Trail]]:
    """Places of each track in the order of time, by sequence and identity.

    Returns:
        x and y in the world where the sequence has poses, else in the sensor's own coordinates.
    """
    poses = _poses(tracks)
    found: dict[str, dict[int, list[np.ndarray]]] = {}
    for key in sorted(tracks.boxes, key=frame_order):
        boxes = tracks.boxes[key]
        boxes = boxes.transform(poses[key]) if key in poses else boxes
        of_sequence = found.setdefault(key[0], {})
        for row, name in enumerate([] if boxes.track_id is None else boxes.track_id.tolist()):
            of_sequence.setdefault(name, []).append(boxes.centre_m[row, :2])
    return {key: {name: np.array(each) for name, each in trails.items()} for key, trails in found.items()}


def _poses(tracks: Detections) -> Mapping[Key, Float[np.ndarray, "4 4"]]:
    return {
        key: drive.world_T_frame[number]
        for drive in tracks.drives
        if drive.world_T_frame is not None
        for number, key in enumerate(drive.keys)
    }


def trails_picture(tracks: Detections) -> "Figure":
    """Draw the trails of the first sequences from above, a panel each: a line a track, a dot where it was last seen.

    The sensor's own path is dashed where there are poses; without them the sensor stands at the cross.
    """
    trails, poses = trails_of(tracks), _poses(tracks)
    shown = list(trails)[:MOST_SEQUENCES]
    columns = min(3, max(len(shown), 1))
    rows = -(-max(len(shown), 1) // columns)
    with house_style():
        figure = new_figure(4.6 * columns + 1.5, 4.2 * rows + 0.4)
        for place, name in enumerate(shown):
            axes = figure.add_subplot(rows, columns, place + 1)
            keys = sorted((key for key in tracks.boxes if key[0] == name), key=frame_order)
            path = np.array([poses[key][:2, 3] for key in keys if key in poses]).reshape(-1, 2)
            _draw(axes, trails[name], path)
            axes.set_title(f"{name or 'tracks'}: {len(trails[name])} tracks, {len(keys)} frames")
        if len(trails) > len(shown):
            figure.suptitle(f"the first {len(shown)} of {len(trails)} sequences", x=0.01, ha="left", color=MUTED)
    return figure


def _draw(axes: "Axes", trails: Mapping[int, np.ndarray], path: Trail) -> None:
    for name, trail in trails.items():
        colour = _COLOURS[name % len(_COLOURS)]
        axes.plot(*trail.T, color=colour, linewidth=1.3, solid_capstyle="round")
        axes.plot(*trail[-1:].T, color=colour, marker="o", markersize=3)
    if len(path):
        axes.plot(*path.T, color=INK, linewidth=1.0, linestyle="--", label="sensor")
        axes.legend(loc="upper left")
    else:
        axes.plot(0, 0, color=INK, marker="+", markersize=8)
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(visible=True)
    where = "in the world" if len(path) else "ahead of the sensor"
    axes.set_xlabel(f"x {where}, m")
    axes.set_ylabel("y, m")


def check_picture(path: Path) -> None:
    """Refuse a picture whose kind is not known.

    Raises:
        ConfigError: If the file's name does not end with .svg, .png or .jpg.
    """
    if path.suffix.lower() not in _KINDS:
        raise ConfigError(f"picture: expected a name that ends with {', '.join(_KINDS)}, got {path.name}")


def picture_kind(path: Path) -> Kind:
    """The kind of a picture by its name.

    Raises:
        ConfigError: If the name does not end with .svg, .png or .jpg.
    """
    check_picture(path)
    return _KINDS[path.suffix.lower()]


def write_trails(path: Path | str, tracks: Detections) -> None:
    """Write the trails from above as SVG, PNG or JPEG, by the file's name.

    Raises:
        ConfigError: If it has another ending.
    """
    path = Path(path)
    kind = picture_kind(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, figure_bytes(trails_picture(tracks), kind))

"""Odometry as one self-contained page: the tracks from above, with the drift to expect."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from farfield.figures.style import (
    ANNOTATED,
    INK,
    MUTED,
    PREDICTED,
    figure_bytes,
    figure_uri,
    house_style,
    new_figure,
    picture_kind,
)
from farfield.files.atomic import write_bytes, write_text
from farfield.odometry.drift import way_m
from farfield.odometry.drives import OdometryTrack
from farfield.pages.template import PageImage, render_template
from farfield.vocabulary.counts import count_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_TRACKS = 12
HEADS = ("drive", "sweeps", "way, m", "drift a 100 m", "%", "turn a 100 m", "lost", "matched", "residual, m")


def write_odometry(
    folder: Path | str, tracks: Sequence[OdometryTrack], *, title: str, picture: Path | None = None
) -> None:
    """Write ``odometry.json`` and ``odometry.html`` beside the poses, and a picture if one is wanted.

    Args:
        folder: The folder of the poses.
        tracks: The tracks.
        title: Title of the page.
        picture: SVG, PNG or JPEG.

    Raises:
        ConfigError: If the picture's name has another ending.
    """
    folder = Path(folder)
    content = {"tracks": [track.to_json() for track in tracks]}
    write_text(folder / "odometry.json", json.dumps(content, indent=2, allow_nan=False) + "\n")
    drawn = tracks_picture(tracks)
    shown = PageImage(
        figure_uri(drawn),
        "The track of each drive from above",
        "A tick each 100 m. The dashed line is the track that was found backwards, laid on the first pose: how far the "
        "two part is how far either drifts, times the root of 2. Orange: sweeps that fit nowhere, or along a direction "
        "that nothing observes.",
        "Tracks from above",
    )
    rows = [row(track) for track in tracks]
    page = render_template("odometry.html", title=title, tracks=tracks, heads=HEADS, rows=rows, pictures=[shown])
    write_text(folder / "odometry.html", page)
    if picture is not None:
        picture.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(picture, figure_bytes(drawn, picture_kind(picture)))


def row(track: OdometryTrack) -> tuple[str, ...]:
    """A row of the table, under :data:`HEADS`, as words."""
    drift = track.drift
    drift_texts = ("", "", "")
    if drift is not None:
        drift_m = 100 * drift.place_m / drift.stretch_m
        drift_texts = (f"{drift_m:.2f} m", f"{drift.place_percent:.2f}", f"{drift.turn_deg_per_100m:.3f}°")
    facts = (f"{track.facts['median_matched']:.2f}", f"{track.facts['median_residual_m']:.3f}")
    return (
        track.name,
        f"{len(track.table):,}",
        f"{track.way_m:,.1f}",
        *drift_texts,
        f"{track.table.lost.sum():,}",
        *facts,
    )


def tracks_picture(tracks: Sequence[OdometryTrack]) -> "Figure":
    """Draw the first tracks from above, a panel each."""
    shown = list(tracks)[:MOST_TRACKS]
    columns = min(3, max(len(shown), 1))
    rows = -(-max(len(shown), 1) // columns)
    with house_style():
        figure = new_figure(4.8 * columns + 1.0, 3.9 * rows + 0.5)
        for number, track in enumerate(shown):
            _draw(figure.add_subplot(rows, columns, number + 1), track)
        if len(tracks) > len(shown):
            figure.suptitle(
                f"the first {len(shown)} of {count_of(len(tracks), 'drive')}", x=0.01, ha="left", color=MUTED
            )
    return figure


def _draw(axes: "Axes", track: OdometryTrack) -> None:
    poses = track.table.world_T_frame
    xy_m = poses[:, :2, 3]
    if track.backward is not None:
        axes.plot(*track.backward.world_T_frame[:, :2, 3].T, color=MUTED, lw=1.0, ls="--", label="found backwards")
    axes.plot(*xy_m.T, color=ANNOTATED, lw=1.6, label="track")
    way = way_m(poses)
    ticks = np.searchsorted(way, np.arange(100.0, way[-1], 100.0))
    x_extent_m, y_extent_m = np.ptp(xy_m, axis=0)
    axes.plot(*xy_m[ticks].T, color=ANNOTATED, ls="", marker="|" if x_extent_m >= y_extent_m else "_", markersize=9)
    axes.plot(*xy_m[:1].T, color=INK, ls="", marker="o", markersize=4, label="start")
    doubtful = track.table.lost | np.array([bool(name) for name in track.table.blind])
    if doubtful.any():
        axes.plot(*xy_m[doubtful].T, color=PREDICTED, ls="", marker=".", markersize=5, label="not observed")
    drift = track.drift
    drift_text = "drift not known" if drift is None else f"expected drift {drift.place_percent:.2f} %"
    axes.set_title(f"{track.name}: {track.way_m:,.0f} m, {drift_text}")
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(visible=True)
    axes.legend(loc="best")
    axes.set_xlabel("x from the first sweep, m")
    axes.set_ylabel("y, m")

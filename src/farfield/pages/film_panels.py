"""The panels of a film's picture: a cloud or a radar's power from above, a camera; drawn in milliseconds, by pillow."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw

from farfield.figures.camera import box_lines
from farfield.figures.style import ANNOTATED, PREDICTED
from farfield.frame import Cloud
from farfield.geometry.boxes import Boxes
from farfield.geometry.cameras import Camera
from farfield.radar.grid import CUBE_STEP_M, CUBE_X_M, CUBE_Y_M

Colour = tuple[int, int, int]
Picture = UInt8[np.ndarray, "height width 3"]
GROUND, RING, WORDS = (14, 18, 23), (52, 62, 74), (205, 213, 222)
_TRACKS = ("#56b4e9", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#f0e442", "#7fd1ff", "#ffffff")
_HEIGHTS_M = (-2.5, 4.0)
_RINGS_M = (25.0, 50.0, 100.0, 150.0, 200.0, 250.0)
_BEHIND = 0.25  # share of a view from above that lies behind the sensor


@dataclass(frozen=True, eq=False)
class DrawnBoxes:
    """Boxes of one kind in one frame.

    Args:
        boxes: In the frame's coordinates.
        predicted: Whether a detector or tracker made them.
        trails: Places of each track that is seen here, oldest first, in the frame's coordinates, by identity.
    """

    boxes: Boxes
    predicted: bool
    trails: dict[int, Float[np.ndarray, "n 3"]] = field(default_factory=dict)

    def colour(self, row: int) -> str:
        """Of a box: its track's, else its kind's."""
        track = -1 if self.boxes.track_id is None else int(self.boxes.track_id[row])
        if track >= 0:
            return track_colour(track)
        return PREDICTED if self.predicted else ANNOTATED


def track_colour(track: int) -> str:
    """The colour that a track keeps through the film."""
    return _TRACKS[track % len(_TRACKS)]


@dataclass(frozen=True)
class PanelView:
    """A window seen from above, ahead upwards.

    Args:
        width: Pixels.
        height: Pixels.
        reach_m: How far ahead it shows.
        behind: How much of the height lies behind the sensor.
    """

    width: int
    height: int
    reach_m: float | int
    behind: float = _BEHIND

    @property
    def scale(self) -> float:
        """Pixels a metre."""
        return self.height * (1 - self.behind) / self.reach_m

    def pixels(self, points_m: Float[np.ndarray, "n _"]) -> Float[np.ndarray, "n 2"]:
        """Column and row of places."""
        column = self.width / 2 - points_m[:, 1] * self.scale
        row = self.height * (1 - self.behind) - points_m[:, 0] * self.scale
        return np.stack([column, row], axis=1)


def cloud_panel(cloud: Cloud, drawn: Sequence[DrawnBoxes], view: PanelView) -> Image.Image:
    """A cloud from above, coloured by height, with boxes and trails."""
    canvas = np.full((view.height, view.width, 3), GROUND, dtype=np.uint8)
    order = np.argsort(cloud.points_m[:, 2], kind="stable")  # the highest on top
    points = cloud.points_m[order]
    columns, rows = np.floor(view.pixels(points)).astype(np.int64).T
    seen = (columns >= 0) & (columns < view.width - 1) & (rows >= 0) & (rows < view.height - 1)
    low, high = _HEIGHTS_M
    shade = np.clip((points[seen, 2] - low) / (high - low) * 255, 0, 255).astype(np.uint8)
    for right, down in ((0, 0), (1, 0), (0, 1), (1, 1)) if len(points) < 60_000 else ((0, 0),):
        canvas[rows[seen] + down, columns[seen] + right] = _colour_table("viridis")[shade]
    return _with_boxes(canvas, drawn, view)


def radar_panel(bird_db: Float[np.ndarray, "y x"], drawn: Sequence[DrawnBoxes], view: PanelView) -> Image.Image:
    """A radar's power from above (BEV-2D), with boxes and trails given in the radar's coordinates."""
    columns, rows = np.meshgrid(np.arange(view.width), np.arange(view.height))
    x = (view.height * (1 - view.behind) - rows) / view.scale
    y = (view.width / 2 - columns) / view.scale
    at = [np.rint((value - axis[0]) / CUBE_STEP_M).astype(np.int64) for value, axis in ((y, CUBE_Y_M), (x, CUBE_X_M))]
    inside = (at[0] >= 0) & (at[0] < bird_db.shape[0]) & (at[1] >= 0) & (at[1] < bird_db.shape[1])
    level = np.where(inside, bird_db[np.where(inside, at[0], 0), np.where(inside, at[1], 0)], np.nan)
    known = bird_db[np.isfinite(bird_db)]
    low, high = np.percentile(known, [20.0, 99.8]) if known.size else (0.0, 1.0)
    shade = np.nan_to_num((level - low) / max(high - low, 1e-6) * 255, nan=0.0).clip(0, 255).astype(np.uint8)
    canvas = np.where(np.isfinite(level)[..., None], _colour_table("magma")[shade], np.array(GROUND, dtype=np.uint8))
    return _with_boxes(canvas, drawn, view)


def camera_panel(
    image: Picture, camera: Camera | None, drawn: Sequence[DrawnBoxes], size: tuple[int, int]
) -> Image.Image:
    """A camera's picture as large as fits, with boxes where there is a calibration."""
    shown = Image.fromarray(image)
    share = min(size[0] / shown.width, size[1] / shown.height)
    shown = shown.resize((max(1, round(shown.width * share)), max(1, round(shown.height * share))))
    pen = ImageDraw.Draw(shown)
    for each in drawn if camera is not None else ():
        for row in range(len(each.boxes)):
            for line in box_lines(each.boxes[row : row + 1], camera) if camera is not None else ():
                pen.line([tuple(place) for place in (line * share).tolist()], fill=each.colour(row), width=1)
    panel = Image.new("RGB", size, GROUND)
    panel.paste(shown, ((size[0] - shown.width) // 2, (size[1] - shown.height) // 2))
    return panel


def _with_boxes(canvas: Picture, drawn: Sequence[DrawnBoxes], view: PanelView) -> Image.Image:
    panel = Image.fromarray(canvas)
    pen = ImageDraw.Draw(panel)
    for ring in (each for each in _RINGS_M if each <= 1.4 * view.reach_m):
        (x, y), radius = view.pixels(np.zeros((1, 2)))[0], ring * view.scale
        pen.ellipse([x - radius, y - radius, x + radius, y + radius], outline=RING)
        pen.text((x + 3, y - radius + 1), f"{ring:g} m", fill=RING)
    for each in drawn:
        for track, trail in each.trails.items():
            if len(trail) > 1:
                pen.line([tuple(place) for place in view.pixels(trail).tolist()], fill=track_colour(track), width=1)
        for row in range(len(each.boxes)):
            _outline(pen, each.boxes[row : row + 1], view, each.colour(row), dashed=each.predicted)
    return panel


def _outline(pen: Any, box: Boxes, view: PanelView, colour: str, *, dashed: bool) -> None:
    """A box from above with its heading; predicted ones are dashed, as in the studio."""
    length, width = box.size_m[0, :2] / 2
    cos, sin = np.cos(box.yaw_rad[0]), np.sin(box.yaw_rad[0])
    local = np.array([[length, width], [length, -width], [-length, -width], [-length, width], [length, width]])
    ahead = np.array([[0.0, 0.0], [length + 1.0, 0.0]])
    turn = np.array([[cos, sin], [-sin, cos]])
    for line in (local, ahead):
        places = view.pixels(line @ turn + box.centre_m[0, :2])
        for start, end in pairwise(places):
            parts = max(2, round(np.hypot(*(end - start)) / 4)) if dashed else 1
            for part in range(0, parts, 2):
                a, b = start + (end - start) * part / parts, start + (end - start) * (part + 1) / parts
                pen.line([tuple(a.tolist()), tuple(b.tolist())], fill=colour, width=2)


@lru_cache(maxsize=4)
def _colour_table(name: str) -> UInt8[np.ndarray, "256 3"]:
    from matplotlib import colormaps

    return (colormaps[name](np.arange(256))[:, :3] * 255).round().astype(np.uint8)

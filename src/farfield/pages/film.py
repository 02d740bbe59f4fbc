"""A drive as a film: every sensor, the boxes, the tracks with their trails; made without a browser.

Each picture is a unit of work: it is written whole, kept in a folder beside the film until that stands, and not made
again when an interrupted film is begun anew.
"""

import shutil
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw, ImageFont

from farfield.datasets.base import Dataset
from farfield.errors import ConfigError
from farfield.figures.camera import box_lines
from farfield.figures.style import ANNOTATED, PREDICTED
from farfield.files import videos
from farfield.files.atomic import move_into_place, open_atomic
from farfield.files.images import write_animation
from farfield.frame import Boxes, Cloud, Drive, Frame, Key
from farfield.geometry.cameras import Camera
from farfield.geometry.poses import invert
from farfield.jobs import HERE, JobJournal, JobOptions, Unit, UnitResult, run
from farfield.jobs.folders import held
from farfield.radar.axes import CUBE_STEP_M, CUBE_X_M, CUBE_Y_M
from farfield.radar.views import PRODUCTS, bird_db
from farfield.vocabulary.counts import count_of
from farfield.vocabulary.scores import SHOWN_SCORE

# The panels of a film's picture: a cloud or a radar's power from above, a camera; drawn in milliseconds, by pillow.

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
    inside = (columns >= 0) & (columns < view.width - 1) & (rows >= 0) & (rows < view.height - 1)
    low, high = _HEIGHTS_M
    shade = np.clip((points[inside, 2] - low) / (high - low) * 255, 0, 255).astype(np.uint8)
    for right, down in ((0, 0), (1, 0), (0, 1), (1, 1)) if len(points) < 60_000 else ((0, 0),):
        canvas[rows[inside] + down, columns[inside] + right] = _colour_table("viridis")[shade]
    return _with_boxes(canvas, drawn, view)


def radar_panel(bird_db: Float[np.ndarray, "y x"], drawn: Sequence[DrawnBoxes], view: PanelView) -> Image.Image:
    """A radar's power from above (BEV-2D), with boxes and trails given in the radar's coordinates."""
    columns, rows = np.meshgrid(np.arange(view.width), np.arange(view.height))
    x = (view.height * (1 - view.behind) - rows) / view.scale
    y = (view.width / 2 - columns) / view.scale
    at = [np.rint((value - axis[0]) / CUBE_STEP_M).astype(np.int64) for value, axis in ((y, CUBE_Y_M), (x, CUBE_X_M))]
    inside = (at[0] >= 0) & (at[0] < bird_db.shape[0]) & (at[1] >= 0) & (at[1] < bird_db.shape[1])
    level = np.where(inside, bird_db[np.where(inside, at[0], 0), np.where(inside, at[1], 0)], np.nan)
    finite_db = bird_db[np.isfinite(bird_db)]
    low, high = np.percentile(finite_db, [20.0, 99.8]) if finite_db.size else (0.0, 1.0)
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
    for kind in drawn if camera is not None else ():
        for row in range(len(kind.boxes)):
            for line in box_lines(kind.boxes[row : row + 1], camera) if camera is not None else ():
                pen.line([tuple(pixel) for pixel in (line * share).tolist()], fill=kind.colour(row), width=1)
    panel = Image.new("RGB", size, GROUND)
    panel.paste(shown, ((size[0] - shown.width) // 2, (size[1] - shown.height) // 2))
    return panel


def _with_boxes(canvas: Picture, drawn: Sequence[DrawnBoxes], view: PanelView) -> Image.Image:
    panel = Image.fromarray(canvas)
    pen = ImageDraw.Draw(panel)
    for ring in (kind for kind in _RINGS_M if kind <= 1.4 * view.reach_m):
        (x, y), radius = view.pixels(np.zeros((1, 2)))[0], ring * view.scale
        pen.ellipse([x - radius, y - radius, x + radius, y + radius], outline=RING)
        pen.text((x + 3, y - radius + 1), f"{ring:g} m", fill=RING)
    for kind in drawn:
        for track, trail in kind.trails.items():
            if len(trail) > 1:
                pen.line([tuple(pixel) for pixel in view.pixels(trail).tolist()], fill=track_colour(track), width=1)
        for row in range(len(kind.boxes)):
            _outline(pen, kind.boxes[row : row + 1], view, kind.colour(row), dashed=kind.predicted)
    return panel


def _outline(pen: Any, box: Boxes, view: PanelView, colour: str, *, dashed: bool) -> None:
    """A box from above with its heading; predicted ones are dashed, as in the studio."""
    length, width = box.size_m[0, :2] / 2
    cos, sin = np.cos(box.yaw_rad[0]), np.sin(box.yaw_rad[0])
    local = np.array([[length, width], [length, -width], [-length, -width], [-length, width], [length, width]])
    ahead = np.array([[0.0, 0.0], [length + 1.0, 0.0]])
    turn = np.array([[cos, sin], [-sin, cos]])
    for line in (local, ahead):
        pixels = view.pixels(line @ turn + box.centre_m[0, :2])
        for start, end in pairwise(pixels):
            parts = max(2, round(np.hypot(*(end - start)) / 4)) if dashed else 1
            for part in range(0, parts, 2):
                a, b = start + (end - start) * part / parts, start + (end - start) * (part + 1) / parts
                pen.line([tuple(a.tolist()), tuple(b.tolist())], fill=colour, width=2)


@lru_cache(maxsize=4)
def _colour_table(name: str) -> UInt8[np.ndarray, "256 3"]:
    from matplotlib import colormaps

    return (colormaps[name](np.arange(256))[:, :3] * 255).round().astype(np.uint8)


# One picture of a film: a cloud large on the left, the other sensors beside it, words above.

SIZE = (1280, 720)
HEAD, TITLE, MAIN = 30, 18, 660
_MOST = 6

Panel = tuple[str, str]
"""Kind (``cloud``, ``radar``, ``camera``) and name."""


def panels_of(data: Dataset, drive: Drive) -> tuple[Panel, ...]:
    """What the frames of a drive have to show, the LiDAR that is shown large first; judged by its first frame."""
    frame = data[int(drive.indices[0])]
    sensors = {name: frame.sensors.get(name) for name in frame.clouds}
    in_frame = [name for name, sensor in sensors.items() if sensor is None or sensor.in_frame]
    radars = {name for name, sensor in sensors.items() if sensor is not None and sensor.kind != "lidar"}
    clouds = sorted(in_frame, key=radars.__contains__)  # LiDARs first
    held = {name for sensor in sensors.values() if sensor is not None for name in sensor.holds}
    radar = [("radar", "power from above")] if any(name in frame.radar for name in PRODUCTS) else []
    shown = [("cloud", name) for name in clouds if name not in held]
    return (*shown[:1], *[("camera", name) for name in frame.images], *radar, *shown[1:])[: _MOST + 1]


def film_picture(
    frame: Frame, panels: Sequence[Panel], drawn: Sequence[DrawnBoxes], *, reach_m: float | int
) -> Image.Image:
    """Draw a frame.

    Args:
        frame: The frame.
        panels: What stands where: the first large on the left.
        drawn: Its boxes.
        reach_m: How far ahead the views from above show.
    """
    image = Image.new("RGB", SIZE, (32, 38, 46))
    pen = ImageDraw.Draw(image)
    pen.text((10, 7), headline(frame, drawn), fill=WORDS, font=ImageFont.load_default(15))
    for (kind, name), (left, top, width, height) in zip(panels, panel_rectangles(len(panels)), strict=True):
        pen.text((left + 4, top + 1), name, fill=WORDS, font=ImageFont.load_default(12))
        size = (width, height - TITLE)
        image.paste(_panel(frame, kind, name, drawn, size, reach_m), (left, top + TITLE))
    return image


def panel_rectangles(count: int) -> list[tuple[int, int, int, int]]:
    """Left, top, width and height of each panel."""
    room = SIZE[1] - HEAD
    if count < 2:
        return [(0, HEAD, SIZE[0], room)][:count]
    columns = 1 if count - 1 <= 3 else 2
    rows = -(-(count - 1) // columns)
    width, height = (SIZE[0] - MAIN - 4) // columns, room // rows
    beside = [
        (MAIN + 4 + width * (k % columns), HEAD + height * (k // columns), width - 2, height) for k in range(count - 1)
    ]
    return [(0, HEAD, MAIN, room), *beside]


def headline(frame: Frame, drawn: Sequence[DrawnBoxes]) -> str:
    """Which frame it is, in which conditions, and what is drawn."""
    facts = [f"{frame.sequence} / {frame.frame_id}", *(str(value) for value in frame.conditions.values())]
    for kind_boxes in drawn:
        tracks = 0 if kind_boxes.boxes.track_id is None else len({int(t) for t in kind_boxes.boxes.track_id if t >= 0})
        kind = "predicted" if kind_boxes.predicted else "annotated"
        facts.append(f"{len(kind_boxes.boxes)} {kind}" + (f" ({count_of(tracks, 'track')})" if tracks else ""))
    return "    ".join(facts)


def _panel(
    frame: Frame, kind: str, name: str, drawn: Sequence[DrawnBoxes], size: tuple[int, int], reach_m: float | int
) -> Image.Image:
    if kind == "cloud" and name in frame.clouds:
        return cloud_panel(frame.cloud(name), drawn, PanelView(*size, reach_m))
    if kind == "camera" and name in frame.images:
        return camera_panel(np.asarray(frame.images[name]), frame.cameras.get(name), drawn, size)
    panel = _radar(frame, drawn, size, reach_m) if kind == "radar" else None
    if panel is None:
        panel = Image.new("RGB", size, GROUND)
        ImageDraw.Draw(panel).text((size[0] / 2, size[1] / 2), "nothing at this moment", fill=WORDS, anchor="mm")
    return panel


def _radar(
    frame: Frame, drawn: Sequence[DrawnBoxes], size: tuple[int, int], reach_m: float | int
) -> Image.Image | None:
    bird = bird_db(frame.radar)
    if bird is None:
        return None
    sensor = next((frame.sensors[name] for name in PRODUCTS if name in frame.sensors and name in frame.radar), None)
    if sensor is not None and not sensor.in_frame and sensor.frame_T_sensor is not None:
        sensor_T_frame = invert(sensor.frame_T_sensor)
        turn, offset = sensor_T_frame[:3, :3], sensor_T_frame[:3, 3]
        trails = [{track: trail @ turn.T + offset for track, trail in kind.trails.items()} for kind in drawn]
        drawn = [
            replace(kind, boxes=kind.boxes.transform(sensor_T_frame), trails=moved)
            for kind, moved in zip(drawn, trails, strict=True)
        ]
    return radar_panel(bird, drawn, PanelView(*size, reach_m, behind=0.03))


ANIMATED = (".gif", ".webp")
_VERSION = 1
_USUAL_HZ = 10.0


@dataclass(frozen=True)
class FilmSettings:
    """What a film shows.

    Args:
        reach_m: How far ahead the views from above show.
        rate_hz: Frames a second; 0 takes the drive's own rate, or 10 where its times are not known.
        trail_frames: How many frames back a track's trail reaches.
        score: Predictions below it are left out.
    """

    reach_m: float | int = 100.0
    rate_hz: float | int = 0.0
    trail_frames: int = 20
    score: float | int = SHOWN_SCORE

    def __post_init__(self) -> None:
        if not 5 <= self.reach_m <= 1000 or not 0 <= self.rate_hz <= 60 or self.trail_frames < 0:
            raise ConfigError(
                f"film: expected a reach from 5 to 1000 m, up to 60 frames a second and no negative trail, got {self}"
            )


@dataclass(frozen=True, eq=False)
class FilmWork:
    """Draws the pictures of one drive.

    Args:
        data: The data set.
        drive: The drive.
        folder: Where the pictures go.
        panels: What stands where, by name.
        predictions: Predicted boxes or tracks by (sequence, frame), in the data set's coordinates.
        settings: What the film shows.
    """

    data: Dataset
    drive: Drive
    folder: Path
    panels: tuple[tuple[str, str], ...]
    predictions: Mapping[Key, Boxes] | None = None
    settings: FilmSettings = field(default_factory=FilmSettings)

    def __call__(self, unit: Unit) -> UnitResult:
        """Draw the frame at a place of the drive."""
        number = int(unit.parameters)
        frame = self.data[int(self.drive.indices[number])]
        drawn = [kind for kind in (self._drawn(number, False), self._drawn(number, True)) if kind is not None]
        image = film_picture(frame, self.panels, drawn, reach_m=self.settings.reach_m)
        path = self.folder / f"{number:06d}.png"
        with open_atomic(path) as handle:
            image.save(handle, format="PNG", compress_level=1)
        return UnitResult(files=(path,))

    def _drawn(self, number: int, predicted: bool) -> DrawnBoxes | None:
        boxes = self._boxes(number, predicted)
        if boxes is None:
            return None
        return DrawnBoxes(boxes, predicted, self._trails(number, predicted, boxes))

    def _boxes(self, number: int, predicted: bool) -> Boxes | None:
        if not predicted:
            annotation = self.data.annotation(int(self.drive.indices[number]))
            return None if annotation is None else annotation.boxes
        boxes = None if self.predictions is None else self.predictions.get(self.drive.keys[number])
        return boxes if boxes is None or boxes.score is None else boxes[boxes.score >= self.settings.score]

    def _trails(self, number: int, predicted: bool, now: Boxes) -> dict[int, np.ndarray]:
        """Where the tracks of a frame were lately, in its coordinates; without poses in those of their own time."""
        shown = set() if now.track_id is None else {int(track) for track in now.track_id if track >= 0}
        positions: dict[int, list[np.ndarray]] = {track: [] for track in sorted(shown)}
        poses = self.drive.world_T_frame
        for earlier in range(max(0, number - self.settings.trail_frames), number + 1) if shown else ():
            boxes = self._boxes(earlier, predicted)
            if boxes is None or boxes.track_id is None:
                continue
            tracks = boxes.track_id.tolist()
            if poses is not None and earlier != number:
                boxes = boxes.transform(invert(poses[number]) @ poses[earlier])
            for row, track in enumerate(tracks):
                if track in positions:
                    positions[track].append(boxes.centre_m[row])
        return {track: np.array(trail) for track, trail in positions.items()}


def make_film(
    path: Path | str,
    data: Dataset,
    *,
    drive: str = "",
    predictions: Mapping[Key, Boxes] | None = None,
    settings: FilmSettings = FilmSettings(),
    bulk: JobOptions = HERE,
) -> int:
    """Write the film of a drive; gives the number of its frames.

    Args:
        path: .mp4, .mov, .m4v or .mkv (extra ``video``), .gif or .webp.
        data: The data set.
        drive: Name of the drive (default: the first one).
        predictions: Boxes to show beside the annotated ones; with identities they have trails.
        settings: What it shows.
        bulk: How the pictures are made.

    Raises:
        ConfigError: If the name has another ending, or there is no such drive.
        MissingExtraError: If a film's suffix needs PyAV and it is not installed.
    """
    path = Path(path)
    if path.suffix.lower() not in ANIMATED:
        videos.check_writing(path)
    chosen = drive_named(data, drive)
    folder = path.with_name(f".{path.name}.pictures")
    work = FilmWork(data, chosen, folder, panels_of(data, chosen), predictions, settings)
    units = [
        Unit(f"{number:06d}", sources=tuple(data.files(int(index))), parameters=number)
        for number, index in enumerate(chosen.indices)
    ]
    setting = repr((_VERSION, chosen.name, chosen.keys, work.panels, settings, _predictions_crc(predictions)))
    with held(path, file=True):
        run(work, units, bulk, journal=JobJournal(folder / ".journal.jsonl", setting=setting))
        _assemble(path, [folder / f"{number:06d}.png" for number in range(len(units))], rate_of(chosen, settings))
        shutil.rmtree(folder)
    return len(units)


def drive_named(data: Dataset, name: str) -> Drive:
    """A drive by its name; the first for nothing.

    Raises:
        ConfigError: If there is none of this name, or no frame at all.
    """
    drives = data.drives()
    match = next((drive for drive in drives if name in ("", drive.name)), None)
    if not drives:
        raise ConfigError("film: the frames of this data set are of no drive: they do not follow each other in time")
    if match is None:
        names = ", ".join(drive.name for drive in drives[:20])
        raise ConfigError(f"drive: expected one of {names}, got {name!r}")
    return match


def rate_of(drive: Drive, settings: FilmSettings) -> Fraction:
    """Frames a second: as set, else the drive's own, from 1 to 60."""
    rate = settings.rate_hz
    if not rate and drive.times_ns is not None and len(drive.times_ns) > 1:
        step_s = float(np.median(np.diff(drive.times_ns))) / 1e9
        rate = min(60.0, max(1.0, 1 / step_s)) if step_s > 0 else 0.0
    return Fraction(rate or _USUAL_HZ).limit_denominator(100)


def _assemble(path: Path, pictures: list[Path], rate: Fraction) -> None:
    if path.suffix.lower() in ANIMATED:
        animation = pictures[0].with_name(f"whole{path.suffix.lower()}")
        write_animation(animation, pictures, rate_hz=float(rate))
        move_into_place(animation, path)
        return
    videos.write_film(path, _read_pictures(pictures), range(len(pictures)), 1 / rate)


def _read_pictures(pictures: list[Path]) -> Iterator[np.ndarray]:
    for path in pictures:
        with Image.open(path, formats=("PNG",)) as image:
            yield np.asarray(image.convert("RGB"))


def _predictions_crc(predictions: Mapping[Key, Boxes] | None) -> int:
    """Tells predictions apart, so that a film is not finished with others than it was begun with."""
    if predictions is None:
        return 0
    parts = [str(sorted(predictions)).encode()]
    parts += [part.centre_m.tobytes() + part.yaw_rad.tobytes() for _, part in sorted(predictions.items())]
    return zlib.crc32(b"".join(parts))

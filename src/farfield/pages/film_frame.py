"""One picture of a film: a cloud large on the left, the other sensors beside it, words above."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from farfield.datasets.base import Dataset
from farfield.frame import Drive, Frame
from farfield.geometry.poses import invert
from farfield.pages.film_panels import GROUND, WORDS, DrawnBoxes, PanelView, camera_panel, cloud_panel, radar_panel
from farfield.radar.views import PRODUCTS, bird_db

SIZE = (1280, 720)
HEAD, TITLE, MAIN = 30, 18, 660
_MOST = 6

Panel = tuple[str, str]
"""Kind (``cloud``, ``radar``, ``camera``) and name."""


def panels_of(data: Dataset, drive: Drive) -> tuple[Panel, ...]:
    """What the frames of a drive have to show, the LiDAR that is shown large first; judged by its first frame."""
    frame = data[int(drive.indices[0])]
    placed = [name for name in frame.clouds if _stands(frame, name)]
    clouds = sorted(placed, key=partial(_order, frame))
    held = {name for other in frame.clouds for name in _holds(frame, other)}
    radar = [("radar", "power from above")] if any(name in frame.radar for name in PRODUCTS) else []
    shown = [("cloud", name) for name in clouds if name not in held]
    return (*shown[:1], *[("camera", name) for name in frame.images], *radar, *shown[1:])[: _MOST + 1]


def _stands(frame: Frame, name: str) -> bool:
    sensor = frame.sensors.get(name)
    return sensor is None or sensor.in_frame


def _holds(frame: Frame, name: str) -> tuple[str, ...]:
    sensor = frame.sensors.get(name)
    return () if sensor is None else tuple(sensor.holds)


def _order(frame: Frame, name: str) -> bool:
    """LiDARs before radars."""
    sensor = frame.sensors.get(name)
    return sensor is not None and sensor.kind != "lidar"


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
    whole = Image.new("RGB", SIZE, (32, 38, 46))
    pen = ImageDraw.Draw(whole)
    pen.text((10, 7), headline(frame, drawn), fill=WORDS, font=ImageFont.load_default(15))
    for (kind, name), (left, top, width, height) in zip(panels, panel_rectangles(len(panels)), strict=True):
        pen.text((left + 4, top + 1), name, fill=WORDS, font=ImageFont.load_default(12))
        size = (width, height - TITLE)
        whole.paste(_panel(frame, kind, name, drawn, size, reach_m), (left, top + TITLE))
    return whole


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
    said = [f"{frame.sequence} / {frame.frame_id}", *(str(value) for value in frame.conditions.values())]
    for each in drawn:
        tracks = 0 if each.boxes.track_id is None else len({int(t) for t in each.boxes.track_id if t >= 0})
        kind = "predicted" if each.predicted else "annotated"
        said.append(f"{len(each.boxes)} {kind}" + (f" ({tracks} tracks)" if tracks else ""))
    return "    ".join(said)


def _panel(
    frame: Frame, kind: str, name: str, drawn: Sequence[DrawnBoxes], size: tuple[int, int], reach_m: float | int
) -> Image.Image:
    draw: dict[str, Callable[[], Image.Image | None]] = {
        "cloud": lambda: _cloud(frame, name, drawn, size, reach_m),
        "camera": lambda: _camera(frame, name, drawn, size),
        "radar": lambda: _radar(frame, drawn, size, reach_m),
    }
    return draw[kind]() or _nothing(size)


def _nothing(size: tuple[int, int]) -> Image.Image:
    panel = Image.new("RGB", size, GROUND)
    ImageDraw.Draw(panel).text((size[0] / 2, size[1] / 2), "nothing at this moment", fill=WORDS, anchor="mm")
    return panel


def _cloud(
    frame: Frame, name: str, drawn: Sequence[DrawnBoxes], size: tuple[int, int], reach_m: float | int
) -> Image.Image | None:
    return cloud_panel(frame.cloud(name), drawn, PanelView(*size, reach_m)) if name in frame.clouds else None


def _camera(frame: Frame, name: str, drawn: Sequence[DrawnBoxes], size: tuple[int, int]) -> Image.Image | None:
    if name not in frame.images:
        return None
    return camera_panel(np.asarray(frame.images[name]), frame.cameras.get(name), drawn, size)


def _radar(
    frame: Frame, drawn: Sequence[DrawnBoxes], size: tuple[int, int], reach_m: float | int
) -> Image.Image | None:
    bird = bird_db(frame.radar)
    if bird is None:
        return None
    sensor = next((frame.sensors[name] for name in PRODUCTS if name in frame.sensors and name in frame.radar), None)
    if sensor is not None and not sensor.in_frame and sensor.frame_T_sensor is not None:
        drawn = [_moved(each, invert(sensor.frame_T_sensor)) for each in drawn]
    return radar_panel(bird, drawn, PanelView(*size, reach_m, behind=0.03))


def _moved(drawn: DrawnBoxes, pose: np.ndarray) -> DrawnBoxes:
    trails = {track: trail @ pose[:3, :3].T + pose[:3, 3] for track, trail in drawn.trails.items()}
    return replace(drawn, boxes=drawn.boxes.transform(pose), trails=trails)

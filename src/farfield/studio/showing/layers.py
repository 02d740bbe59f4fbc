"""What there is to show of a frame, without reading clouds or pictures, and pictures as the browser takes them.

A picture is the file's own bytes where it is one picture of few bytes, else a JPEG: a PNG of a camera takes four to ten
times the bytes of a JPEG that nobody can tell from it at the size in which it is shown; over a link of 20 Mbit/s one of
1 MB takes 0.4 s. Its own bytes are sent where they are asked for.
"""

import io
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from farfield.files.atomic import read_bytes
from farfield.files.images import read_image
from farfield.frame import Camera, Frame, Lazy, Sensor
from farfield.studio.messages.rows import CameraModel, Layer, LayerKind, SensorKind
from farfield.studio.showing.radar import axes_of, product_of

_TITLES = {"points": "", "bev": ", from above (BEV-2D)", "bfs": ", from the front (BFS-2D)", "image": ""}
RADAR_MAP = "radar"


def layers_of(frame: Frame, index: int, *, root: Path, sweeps: int = 1) -> tuple[Layer, ...]:
    """The layers of a frame: clouds, radar maps, pictures.

    Args:
        frame: The frame.
        index: Its number in the data set, for the links.
        root: Folder of the data set: files are named relative to it.
        sweeps: How many sweeps the clouds hold.
    """
    layers = [*_clouds(frame, sweeps), *_maps(frame), *_pictures(frame, root)]
    return tuple(
        replace(layer, id=number, url=_url(layer, index, number, sweeps)) for number, layer in enumerate(layers)
    )


def _url(layer: Layer, index: int, number: int, sweeps: int) -> str:
    if layer.kind == "image":
        return f"image/{index}/{number}"
    if layer.kind in ("bev", "bfs"):
        return f"radar/{index}/{layer.kind}"
    return f"layer/{index}/{number}" + (f"?sweeps={sweeps}" if sweeps > 1 else "")


def _clouds(frame: Frame, sweeps: int) -> Iterator[Layer]:
    for name in frame.clouds:
        sensor = frame.sensors.get(name)
        kind: SensorKind = "lidar" if sensor is None else sensor.kind
        yield _layer(frame, name, "points", kind, sensor, sweeps=sweeps if sensor is None or sensor.in_frame else 1)


def _maps(frame: Frame) -> Iterator[Layer]:
    product = product_of(frame.radar)
    if product is None:
        return
    kinds: tuple[LayerKind, ...] = ("bev", "bfs")
    for kind in kinds:
        polar, grid = axes_of(product, kind)
        yield _layer(frame, RADAR_MAP, kind, "radar", frame.sensors.get(product), polar=polar, grid=grid)


def _pictures(frame: Frame, root: Path) -> Iterator[Layer]:
    for name in frame.images:
        path, camera = file_of(frame, name), frame.cameras.get(name)
        shown = relative(path, root) if path is not None else ""
        model = None if camera is None else camera_model(camera)
        yield _layer(frame, name, "image", "camera", frame.sensors.get(name), camera=model, file=shown)


def _layer(
    frame: Frame, name: str, kind: LayerKind, sensor_kind: SensorKind, sensor: Sensor | None, **more: Any
) -> Layer:
    time_ns = None if sensor is None else sensor.time_ns
    lag_ms = None if time_ns is None or frame.time_ns is None else (time_ns - frame.time_ns) / 1e6
    pose = None if sensor is None or sensor.in_frame else sensor.frame_T_sensor
    return Layer(
        id=0,
        name=name,
        title=name + _TITLES[kind],
        kind=kind,
        sensor=sensor_kind,
        url="",
        frame_T_layer=None if pose is None else matrix(pose),
        placed=sensor is None or sensor.in_frame or pose is not None,
        time_ns=None if time_ns is None else str(time_ns),
        lag_ms=lag_ms,
        holds=() if sensor is None else sensor.holds,
        **more,
    )


def matrix(pose: np.ndarray) -> tuple[float, ...]:
    """A 4 x 4 matrix row by row."""
    return tuple(float(value) for value in np.asarray(pose).ravel())


def camera_model(camera: Camera) -> CameraModel:
    """A camera for the page."""
    return CameraModel(
        width_px=int(camera.width_px),
        height_px=int(camera.height_px),
        matrix=tuple(float(value) for value in camera.matrix.ravel()),
        distortion=tuple(float(value) for value in camera.distortion),
        camera_T_frame=matrix(camera.camera_T_lidar),
    )


def relative(path: Path, root: Path) -> str:
    """A file's name as the page may see it: never an absolute path."""
    try:
        return path.resolve().relative_to(root.resolve()).as_posix()
    except ValueError:
        return path.name


# Pictures

_MAX_BYTES = 64 << 20
_LARGE_BYTES = 200_000
"""Files of pictures that are larger are sent as JPEG where that takes at most half the bytes."""
_KINDS = {b"\xff\xd8\xff": "image/jpeg", b"\x89PN": "image/png"}


def file_of(frame: Frame, name: str) -> Path | None:
    """The file that holds just this picture, as it is shown; None where it is a part of one or made."""
    loader: Any = frame.images.loader(name) if isinstance(frame.images, Lazy) and name in frame.images else None
    plain = isinstance(loader, partial) and loader.func is read_image and len(loader.args) == 1 and not loader.keywords
    return Path(loader.args[0]) if plain else None


def picture(frame: Frame, name: str, *, exact: bool = False) -> tuple[bytes, str]:
    """Bytes and media type of a picture.

    Args:
        frame: The frame.
        name: The picture.
        exact: Every pixel as the file has it: nothing is made a JPEG for its size.

    Raises:
        KeyError: If the frame has no such picture.
        FileFormatError: If its file is damaged.
    """
    path = file_of(frame, name)
    if path is not None:
        data = bytes(read_bytes(path, max_bytes=_MAX_BYTES))
        kind = _KINDS.get(data[:3])
        if kind == "image/png" and not exact and len(data) > _LARGE_BYTES:
            smaller = as_jpeg(np.asarray(frame.images[name]))
            return (smaller, "image/jpeg") if len(smaller) <= len(data) / 2 else (data, kind)
        if kind is not None:
            return data, kind
    return as_jpeg(np.asarray(frame.images[name])), "image/jpeg"


def as_jpeg(image: np.ndarray, *, quality: int = 90) -> bytes:
    """An RGB image, shape (height, width, 3), as JPEG."""
    encoded = io.BytesIO()
    Image.fromarray(image).save(encoded, format="JPEG", quality=quality)
    return encoded.getvalue()

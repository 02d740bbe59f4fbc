"""Depth maps as 16-bit grey PNG in KITTI's convention, and beyond its end.

KITTI (depth devkit's readme): depth in metres = value / 256, and 0 means no value, so that the largest depth is
255.996 m. A map that goes on beyond it is written with another scale, which a text chunk of the file names; files
without that chunk have KITTI's.
"""

import io
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float32
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from farfield.errors import ConfigError, FileFormatError
from farfield.files.atomic import open_atomic, read_bytes
from farfield.files.limits import MAX_PIXELS

KITTI_SCALE = 256
"""Steps a metre in KITTI's files."""

FAR_SCALE = 128
"""Steps a metre where 255.996 m are not enough: 7.8 mm, to 511.992 m."""

_SCALE, _LARGEST = "depth_scale", 65535


@dataclass(frozen=True, eq=False)
class DepthImage:
    """What a depth file holds.

    Args:
        depth_m: Metres, NaN where there is no value, shape (height, width).
        scale: Steps a metre in the file.
        notes: Further text chunks of the file.
    """

    depth_m: Float32[np.ndarray, "height width"]
    scale: int = KITTI_SCALE
    notes: Mapping[str, str] = field(default_factory=dict)


def farthest_m(scale: int) -> float:
    """The largest depth that a scale can hold: 255.996 m with KITTI's."""
    return _LARGEST / scale


def write_depth(
    path: Path | str,
    depth_m: Float32[np.ndarray, "height width"],
    *,
    scale: int = KITTI_SCALE,
    notes: Mapping[str, str] | None = None,
) -> int:
    """Write a depth map, all or nothing; values are rounded to the nearest step.

    Args:
        path: The file.
        depth_m: Metres, NaN (or what is not positive) where there is no value, shape (height, width).
        scale: Steps a metre; the file says it in its text chunk ``depth_scale``.
        notes: Further text chunks, such as ``method`` or ``camera``.

    Returns:
        How many values lie beyond the scale's end; they are left out, for a clipped depth would be a wrong one.

    Raises:
        ConfigError: If the scale lies outside 1..65535, or the map is empty.
    """
    if not 1 <= scale <= _LARGEST:
        raise ConfigError(f"{path}: expected a scale of 1 to {_LARGEST} steps a metre, got {scale}")
    if depth_m.ndim != 2 or depth_m.size == 0:
        raise ConfigError(f"{path}: expected a depth map of shape (height, width), got {depth_m.shape}")
    valid = np.isfinite(depth_m) & (depth_m > 0)
    steps = np.rint(np.where(valid, depth_m, 0).astype(np.float64) * scale)
    beyond = steps > _LARGEST
    values = np.where(valid & ~beyond, np.maximum(steps, 1), 0).astype(np.uint16)  # 0 would say that nothing is there
    chunks = PngInfo()
    for name, text in {_SCALE: str(scale), "depth_unit": "metre", "none": "0", **(notes or {})}.items():
        chunks.add_text(name, text)
    encoded = io.BytesIO()
    Image.fromarray(values).save(encoded, format="PNG", pnginfo=chunks, compress_level=3)
    with open_atomic(path) as handle:
        handle.write(encoded.getbuffer())
    return int(beyond.sum())


def read_depth(path: Path | str, *, max_pixels: int = MAX_PIXELS) -> DepthImage:
    """Read a depth map: KITTI's, or one of another scale that its text chunk names.

    Args:
        path: The file.
        max_pixels: Largest width x height that is decoded.

    Raises:
        FileFormatError: If the file is no 16-bit grey PNG, is damaged, has too many pixels, or names no such scale.
    """
    data = io.BytesIO(read_bytes(path))
    try:
        with warnings.catch_warnings(action="ignore"), Image.open(data, formats=("PNG",)) as image:
            _check(path, image, max_pixels)
            values = np.array(image)
            texts = {str(name): str(text) for name, text in image.info.items() if isinstance(text, str)}
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        actual = f"{str(error)[:200]} ({len(data.getbuffer())} bytes)"
        raise FileFormatError(path, where="the image", expected="a whole 16-bit grey PNG", got=actual) from error
    scale = _scale_of(path, texts.pop(_SCALE, str(KITTI_SCALE)))
    depth = values.astype(np.float32) / np.float32(scale)
    depth[values == 0] = np.nan
    return DepthImage(depth, scale, texts)


def _check(path: Path | str, image: Image.Image, max_pixels: int) -> None:
    """Refuse what should not be decoded; Pillow has read the header only."""
    if image.width * image.height > max_pixels:
        expected, actual = f"at most {max_pixels} pixels", f"{image.width} x {image.height}"
        raise FileFormatError(path, where="the image header", expected=expected, got=actual)
    if image.mode != "I;16":
        expected, actual = "16-bit grey values (mode I;16)", f"mode {image.mode}"
        fix = "A depth map that was saved with 8 bits has lost its depths: write it anew."
        raise FileFormatError(path, where="the image header", expected=expected, got=actual, fix=fix)


def _scale_of(path: Path | str, text: str) -> int:
    if not (text.isascii() and text.isdecimal() and len(text) <= 5 and 1 <= int(text) <= _LARGEST):
        expected = f"a whole number from 1 to {_LARGEST}"
        raise FileFormatError(path, where=f"text chunk {_SCALE}", expected=expected, got=repr(text[:50]))
    return int(text)

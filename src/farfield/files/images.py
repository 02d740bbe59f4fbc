"""Camera images as arrays."""

import io
import struct
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageOps

from farfield.errors import ConfigError, FileFormatError
from farfield.files.atomic import open_atomic, read_bytes
from farfield.files.limits import MAX_PIXELS, MAX_SCANNED_PIXELS
from farfield.files.stand_ins import check_itself

_FORMATS = {".jpg": "JPEG", ".jpeg": "JPEG", ".png": "PNG"}


_SCAN = b"\xff\xda"  # begins each scan; within one a byte 0xff is followed by 0 or a restart


def read_image(
    path: Path | str, *, max_pixels: int = MAX_PIXELS, upright: bool = False
) -> UInt8[np.ndarray, "height width 3"]:
    """Read a JPEG or PNG image as RGB; grey values are repeated, transparency is dropped.

    Args:
        path: The file.
        max_pixels: Largest width x height that is decoded.
        upright: Turn it as its EXIF says; a camera of a data set is calibrated for the pixels as they are stored.

    Returns:
        Shape (height, width, 3), uint8.

    Raises:
        FileFormatError: If the file is no such image, is truncated, or has too many pixels.
    """
    data = io.BytesIO(read_bytes(path))
    return decode_image(data, path, max_pixels=max_pixels, upright=upright)


def decode_image(
    data: io.BytesIO, path: Path | str, *, max_pixels: int, upright: bool = False
) -> UInt8[np.ndarray, "height width 3"]:
    """Decode a JPEG or PNG that is in memory, as :func:`read_image` does.

    Args:
        data: The whole image.
        path: For error messages: where it came from.
        max_pixels: Largest width x height that is decoded.
        upright: Turn it as its EXIF says.
    """
    try:
        with warnings.catch_warnings(action="ignore"), Image.open(data, formats=("JPEG", "PNG")) as image:
            if image.width * image.height > max_pixels:  # Pillow has read the header only
                expected, actual = f"at most {max_pixels} pixels", f"{image.width} x {image.height}"
                raise FileFormatError(path, where="the image header", expected=expected, got=actual)
            scans = bytes(data.getbuffer()).count(_SCAN) if image.format != "PNG" else 1
            if scans * image.width * image.height > MAX_SCANNED_PIXELS:
                expected, actual = f"at most {MAX_SCANNED_PIXELS} pixels in all its scans", f"{scans} scans"
                raise FileFormatError(path, where="the image", expected=expected, got=actual)
            return _as_array(ImageOps.exif_transpose(image) if upright else image)
    except (OSError, SyntaxError, ValueError, KeyError, TypeError, struct.error, Image.DecompressionBombError) as error:
        actual = f"{str(error)[:200]} ({len(data.getbuffer())} bytes)"
        raise FileFormatError(path, where="the image", expected="a whole JPEG or PNG", got=actual) from error


def image_size(path: Path | str) -> tuple[int, int]:
    """Width and height of a JPEG or PNG as it is stored, from its header.

    Raises:
        FileFormatError: If the file is no such image.
    """
    check_itself(path)
    try:
        with warnings.catch_warnings(action="ignore"), Image.open(path, formats=("JPEG", "PNG")) as image:
            return image.size
    except (OSError, SyntaxError, ValueError, KeyError, TypeError, struct.error, Image.DecompressionBombError) as error:
        actual = str(error)[:200]
        raise FileFormatError(path, where="the image", expected="a JPEG or PNG", got=actual) from error


_STRIP_PIXELS = 1 << 24


def _as_array(image: Image.Image) -> UInt8[np.ndarray, "height width 3"]:
    """The picture in RGB, converted in strips: Pillow's copies take four bytes a pixel each."""
    rows = max(1, _STRIP_PIXELS // max(image.width, 1))
    if rows >= image.height:
        return np.array(_as_rgb(image))
    array = np.empty((image.height, image.width, 3), dtype=np.uint8)
    for top in range(0, image.height, rows):
        bottom = min(top + rows, image.height)
        array[top:bottom] = np.asarray(_as_rgb(image.crop((0, top, image.width, bottom))))
    return array


def _as_rgb(image: Image.Image) -> Image.Image:
    if image.mode.startswith("I"):  # 16-bit grey: keep the high byte, where convert() would saturate
        high = np.asarray(image).astype(np.uint32) >> 8
        return Image.fromarray(np.minimum(high, 255).astype(np.uint8)).convert("RGB")
    return image.convert("RGB")


def write_image(path: Path | str, array: UInt8[np.ndarray, "height width 3"], *, quality: int = 90) -> None:
    """Write an RGB image as JPEG or PNG, by the file's suffix, all or nothing.

    Args:
        path: The file to write: ``*.jpg``, ``*.jpeg`` or ``*.png``.
        array: Shape (height, width, 3), uint8.
        quality: JPEG quality from 1 to 95; without effect on PNG.

    Raises:
        ValueError: If the suffix or the array's shape or dtype is another.
    """
    kind = _FORMATS.get(Path(path).suffix.lower())
    if kind is None:
        raise ValueError(f"write_image: expected a file name ending in {', '.join(_FORMATS)}, got {Path(path).name!r}")
    if array.dtype != np.uint8 or array.ndim != 3 or array.shape[2] != 3 or array.size == 0:
        raise ValueError(f"write_image: expected uint8 of shape (height, width, 3), got {array.dtype} {array.shape}")
    encoded = io.BytesIO()
    Image.fromarray(array).save(encoded, format=kind, quality=quality)
    with open_atomic(path) as handle:
        handle.write(encoded.getbuffer())


def write_grey(path: Path | str, array: UInt8[np.ndarray, "height width"]) -> None:
    """Write a picture of one channel as PNG, all or nothing.

    Args:
        path: The file to write.
        array: Shape (height, width), uint8.
    """
    encoded = io.BytesIO()
    Image.fromarray(array).save(encoded, format="PNG")
    with open_atomic(path) as handle:
        handle.write(encoded.getbuffer())


# Animated pictures: GIF for everybody, WebP at a fifth of its size.

_MAX_PIXELS = 20_000_000


def write_animation(path: Path, pictures: Sequence[Path], *, rate_hz: float = 10.0) -> None:
    """Write an animated GIF or WebP, by the file's ending; all pictures take the size of the first.

    Args:
        path: The file.
        pictures: PNG files in order.
        rate_hz: Pictures a second. GIF counts in hundredths of a second.

    Raises:
        ConfigError: If there is no picture, or one is too large.
        FileFormatError: If one is damaged.
    """
    if not pictures:
        raise ConfigError("film: expected at least one picture, got none")
    images = _images(pictures)
    first = next(images)
    duration_ms = round(1000 / rate_hz)
    if path.suffix.lower() == ".gif":
        first = first.quantize(128)
        rest = (image.resize(first.size).quantize(128, palette=None) for image in images)
        first.save(path, "GIF", save_all=True, append_images=rest, duration=duration_ms, loop=0, optimize=False)
    else:
        rest = (image.resize(first.size) for image in images)
        first.save(path, "WEBP", save_all=True, append_images=rest, duration=duration_ms, loop=0, quality=80, method=2)


def _images(pictures: Sequence[Path]) -> Iterator[Image.Image]:
    for path in pictures:
        try:
            with Image.open(path, formats=("PNG",)) as image:
                if image.width * image.height > _MAX_PIXELS:
                    raise ConfigError(f"film: expected pictures of at most {_MAX_PIXELS} pixels, got {image.size}")
                yield image.convert("RGB")
        except (OSError, SyntaxError, ValueError) as error:
            expected, actual = "a whole PNG", str(error)[:100]
            raise FileFormatError(path.name, where="the image", expected=expected, got=actual) from error

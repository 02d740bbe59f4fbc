"""``sensor_msgs/msg/Image`` and ``CompressedImage`` as RGB."""

import io
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from farfield.errors import FileFormatError
from farfield.files.bags import guarded
from farfield.files.images import MAX_PIXELS, decode_image

CHANNELS = {"rgb8": (0, 1, 2), "bgr8": (2, 1, 0), "rgba8": (0, 1, 2), "bgra8": (2, 1, 0), "mono8": (0, 0, 0)}
_SIZES = {"rgb8": 3, "bgr8": 3, "rgba8": 4, "bgra8": 4, "mono8": 1}


def read_ros_image(message: Any, path: Path | str) -> UInt8[np.ndarray, "height width 3"]:
    """An ``Image`` of eight bits a channel as RGB, without the padding of its rows.

    Raises:
        FileFormatError: If its encoding is another, or its sizes contradict each other.
    """
    with guarded(path, "an image"):  # a damaged definition leaves fields out
        return _pixels(message, path)


def _pixels(message: Any, path: Path | str) -> UInt8[np.ndarray, "height width 3"]:
    height, width, step = int(message.height), int(message.width), int(message.step)
    encoding, data = str(message.encoding), np.asarray(message.data, dtype=np.uint8)
    if encoding not in CHANNELS:
        known = ", ".join(CHANNELS)
        raise FileFormatError(path, where="an image's encoding", expected=f"one of {known}", found=repr(encoding[:40]))
    row = width * _SIZES[encoding]
    if height * width > MAX_PIXELS or step < row or len(data) < (height - 1) * step + row or not height * width:
        found = f"{len(data)} bytes for {width} x {height} in rows of {step}"
        raise FileFormatError(path, where="an image", expected=f"rows of {row} bytes or more, all there", found=found)
    padded = np.zeros(height * step, dtype=np.uint8)
    padded[: min(len(data), len(padded))] = data[: len(padded)]
    pixels = padded.reshape(height, step)[:, :row].reshape(height, width, -1)
    return np.ascontiguousarray(pixels[:, :, list(CHANNELS[encoding])])


def read_ros_compressed(message: Any, path: Path | str) -> UInt8[np.ndarray, "height width 3"]:
    """A ``CompressedImage`` that holds a JPEG or a PNG as RGB.

    Raises:
        FileFormatError: If it holds something else, such as depth or video.
    """
    with guarded(path, "a compressed image"):
        kind, data = str(message.format), np.asarray(message.data, dtype=np.uint8).tobytes()
    if "compressedDepth" in kind:
        raise FileFormatError(
            path, where="a compressed image", expected="a JPEG or PNG", found=f"depth ({kind[:60]!r})"
        )
    return decode_image(io.BytesIO(data), path, max_pixels=MAX_PIXELS)

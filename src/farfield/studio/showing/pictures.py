"""A camera's picture as the browser takes it: the file's own bytes where it is one picture of few bytes, else a JPEG.

A PNG of a camera takes four to ten times the bytes of a JPEG that nobody can tell from it at the size in which it is
shown; over a link of 20 Mbit/s one of 1 MB takes 0.4 s. Its own bytes are sent where they are asked for.
"""

import io
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from farfield.files.atomic import read_bytes
from farfield.files.images import read_image
from farfield.frame import Frame, Lazy

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

"""The dashboard camera's film of a sequence: a file that is named, and its pictures where OpenCV is there."""

from collections.abc import Iterator, Sequence
from importlib import import_module
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from farfield.errors import ConfigError, FileFormatError

FOLDERS = ("cam-dash", "cam_dash")


def find_video(roots: Sequence[Path], sequence: str) -> Path | None:
    """The film of a sequence, ``<sequence>/cam-dash/*.mp4`` or ``<sequence>/cam-dash.mp4``, or None."""
    for root in roots:
        for name in FOLDERS:
            films = sorted((root / sequence).glob(f"{name}/*.mp4")) + sorted((root / sequence).glob(f"{name}*.mp4"))
            if films:
                return films[0]
    return None


def video_frames(path: Path, *, every: int = 1) -> Iterator[UInt8[np.ndarray, "height width 3"]]:
    """Pictures of a film, red first.

    Args:
        path: The film.
        every: Give each so-manieth picture.

    Raises:
        ConfigError: If OpenCV, which decodes it, is not installed.
        FileFormatError: If it cannot be opened.
    """
    try:
        cv2 = import_module("cv2")
    except ImportError as error:
        mend = "pip install opencv-python-headless"
        raise ConfigError(f"{path}: expected OpenCV, which decodes films, found none. Install it: {mend}") from error
    film = cv2.VideoCapture(str(path))
    try:
        if not film.isOpened():
            raise FileFormatError(path, where="the file", expected="a film that OpenCV opens", found="none")
        number = 0
        while film.grab():
            if number % every == 0:
                good, picture = film.retrieve()
                if good:
                    yield np.ascontiguousarray(picture[:, :, ::-1])
            number += 1
    finally:
        film.release()

"""The dashboard camera's film of a sequence, and the frame of it that was taken with a radar frame."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from farfield.files.videos import film_frame

DASH = "cam-dash"
FOLDERS = (DASH, "cam_dash")


def find_video(roots: Sequence[Path], sequence: str) -> Path | None:
    """The film of a sequence, ``<sequence>/cam-dash/*.mp4`` or ``<sequence>/cam-dash.mp4``, or None."""
    for root in roots:
        for name in FOLDERS:
            films = sorted((root / sequence).glob(f"{name}/*.mp4")) + sorted((root / sequence).glob(f"{name}*.mp4"))
            if films:
                return films[0]
    return None


def dash_image(video: Path | None, times_ns: Mapping[str, int], time_ns: int | None) -> dict[str, Callable[[], Any]]:
    """Loader of the dashboard camera's image of a frame; none without a film, stamps or PyAV.

    The film has no stamps of the car's clock: it is taken to begin with the first file of its sequence.

    Args:
        video: The film.
        times_ns: Times of the sequence's files.
        time_ns: Time of the frame.
    """
    if video is None or time_ns is None or not times_ns or find_spec("av") is None:
        return {}
    return {DASH: partial(film_frame, video, (time_ns - min(times_ns.values())) / 1e9)}

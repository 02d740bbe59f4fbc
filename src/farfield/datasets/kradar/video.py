"""The dashboard camera's film of a sequence: a file that is named, not decoded."""

from collections.abc import Sequence
from pathlib import Path

FOLDERS = ("cam-dash", "cam_dash")


def find_video(roots: Sequence[Path], sequence: str) -> Path | None:
    """The film of a sequence, ``<sequence>/cam-dash/*.mp4`` or ``<sequence>/cam-dash.mp4``, or None."""
    for root in roots:
        for name in FOLDERS:
            films = sorted((root / sequence).glob(f"{name}/*.mp4")) + sorted((root / sequence).glob(f"{name}*.mp4"))
            if films:
                return films[0]
    return None

"""What was covered in pictures, as one self-contained page: counts, and the doubtful cases after covering."""

import io
from base64 import b64encode
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from farfield.files.atomic import write_text
from farfield.files.images import read_image
from farfield.files.videos import film_frames, read_film
from farfield.pages.template import PageImage, render_template
from farfield.privacy import PictureSummary
from farfield.privacy.hits import FACE

_SHOWN, _SIDE_PX, _MARGIN = 40, 220, 2.0
HEADS = ("folder", "pictures", "faces", "number plates", "doubtful", "weak, left as they are", "pixels covered")


def write_privacy_page(path: Path, folder: Path, done: Sequence[PictureSummary], *, title: str) -> None:
    """Write the page, all or nothing.

    Args:
        path: The file.
        folder: Where the covered pictures stand: only these are shown, never an original.
        done: What became of each picture.
        title: Title of the page.
    """
    doubtful = [(each, row) for each in done for row in each.doubtful]
    doubtful.sort(key=_weakest_first)
    shown = [_thumbnail(folder, each, row) for each, row in doubtful[:_SHOWN]]
    weak = sorted(((each, row) for each in done for row in each.left), key=_strongest_first)
    page = render_template(
        "privacy.html",
        title=title,
        heads=HEADS,
        rows=table(done),
        pictures=shown,
        left=len(doubtful) - len(shown),
        weak=[_thumbnail(folder, each, row) for each, row in weak[:_SHOWN]],
        weaker=max(len(weak) - _SHOWN, 0),
    )
    write_text(path, page)


def table(done: Sequence[PictureSummary]) -> list[tuple[str, ...]]:
    """A row a folder of pictures, under :data:`HEADS`, and one of all."""
    folders: dict[str, list[PictureSummary]] = {}
    for each in done:
        folders.setdefault(Path(each.file).parent.as_posix(), []).append(each)
    rows = [_row(name, parts) for name, parts in folders.items()]
    return [*rows, _row("all", done)] if len(rows) > 1 else rows


def _row(name: str, done: Sequence[PictureSummary]) -> tuple[str, ...]:
    kinds = [row["kind"] for each in done for row in each.rows]
    doubtful = sum(len(each.doubtful) for each in done)
    share = float(np.mean([each.share for each in done]))
    counts = (len(done), kinds.count("face"), kinds.count("plate"), doubtful, sum(len(each.left) for each in done))
    return name, *(f"{count:,}" for count in counts), f"{share:.2%}"


def frame_of(path: Path, number: int) -> np.ndarray:
    """A frame of a covered film, shape (height, width, 3)."""
    return next(film_frames(read_film(path), number, number + 1))


def _weakest_first(item: tuple[PictureSummary, Mapping[str, Any]]) -> tuple[bool, float, str]:
    each, row = item
    return row["how"] != "found", float(row["score"]), each.file


def _strongest_first(item: tuple[PictureSummary, Mapping[str, Any]]) -> tuple[bool, float, str]:
    each, row = item
    return row["kind"] != FACE, -float(row["score"]), each.file


def _thumbnail(folder: Path, each: PictureSummary, row: Mapping[str, Any]) -> PageImage:
    """The surroundings of a box, cut from the covered picture."""
    from PIL import Image

    path = folder / each.file
    image = read_image(path) if each.frame is None else frame_of(path, each.frame)
    low, high = np.array(row["box_px"][:2]), np.array(row["box_px"][2:])
    half = max(float((high - low).max()), 16.0) / 2 * (1 + _MARGIN)
    middle = (low + high) / 2
    left, top = np.floor(middle - half).astype(int).clip(min=0)
    right, bottom = np.ceil(middle + half).astype(int)
    part = image[top:bottom, left:right]
    small = Image.fromarray(np.ascontiguousarray(part))
    small.thumbnail((_SIDE_PX, _SIDE_PX))
    data = io.BytesIO()
    small.save(data, format="JPEG", quality=85)
    uri = "data:image/jpeg;base64," + b64encode(data.getvalue()).decode()
    at = "" if each.frame is None else f", frame {each.frame}"
    words = f"{each.file}{at}: {row['kind']}, score {row['score']:.2f}, {row.get('how', 'not covered')}"
    return PageImage(uri, f"Surroundings of a {row['kind']}", words)

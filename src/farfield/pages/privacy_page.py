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
from farfield.privacy.image_boxes import FACE

_SHOWN = 40
_SIDE_PX, _MARGIN, _LEAST_PX = 528, 1.0, 132
"""Side of a shown cut, the surroundings on each side in sizes of the box, and the least side that is cut."""
_OUTLINE = (255, 140, 0)
HEADS = (
    "folder",
    "pictures and frames",
    "covers of faces",
    "covers of number plates",
    "covers in doubt",
    "weak boxes, left as they are",
    "pixels covered",
)


def write_privacy_page(path: Path, folder: Path, summaries: Sequence[PictureSummary], *, title: str) -> None:
    """Write the page, all or nothing.

    Args:
        path: The file.
        folder: Where the covered pictures stand: only these are shown, never an original.
        summaries: What became of each picture.
        title: Title of the page.
    """
    doubtful = [(summary, row) for summary in summaries for row in summary.doubtful]
    doubtful.sort(key=_weakest_first)
    shown = [_thumbnail(folder, summary, row) for summary, row in doubtful[:_SHOWN]]
    weak = sorted(((summary, row) for summary in summaries for row in summary.left), key=_strongest_first)
    page = render_template(
        "privacy.html",
        title=title,
        heads=HEADS,
        rows=table(summaries),
        pictures=shown,
        left=len(doubtful) - len(shown),
        weak=[_thumbnail(folder, summary, row) for summary, row in weak[:_SHOWN]],
        weaker=max(len(weak) - _SHOWN, 0),
    )
    write_text(path, page)


def table(summaries: Sequence[PictureSummary]) -> list[tuple[str, ...]]:
    """A row a folder of pictures, under :data:`HEADS`, and one of all."""
    folders: dict[str, list[PictureSummary]] = {}
    for summary in summaries:
        folders.setdefault(Path(summary.file).parent.as_posix(), []).append(summary)
    rows = [_row(name, parts) for name, parts in folders.items()]
    return [*rows, _row("all", summaries)] if len(rows) > 1 else rows


def _row(name: str, summaries: Sequence[PictureSummary]) -> tuple[str, ...]:
    kinds = [row["kind"] for summary in summaries for row in summary.rows]
    doubtful = sum(len(summary.doubtful) for summary in summaries)
    share = float(np.mean([summary.share for summary in summaries]))
    counts = (
        len(summaries),
        kinds.count("face"),
        kinds.count("plate"),
        doubtful,
        sum(len(summary.left) for summary in summaries),
    )
    return name, *(f"{count:,}" for count in counts), f"{share:.2%}"


def frame_of(path: Path, number: int) -> np.ndarray:
    """A frame of a covered film, shape (height, width, 3)."""
    return next(film_frames(read_film(path), number, number + 1))


def _weakest_first(item: tuple[PictureSummary, Mapping[str, Any]]) -> tuple[bool, float, str]:
    summary, row = item
    return row["how"] != "found", float(row["score"]), summary.file


def _strongest_first(item: tuple[PictureSummary, Mapping[str, Any]]) -> tuple[bool, float, str]:
    summary, row = item
    return row["kind"] != FACE, -float(row["score"]), summary.file


def _thumbnail(folder: Path, summary: PictureSummary, row: Mapping[str, Any]) -> PageImage:
    """The surroundings of a box, cut from the covered picture, and the box in them."""
    from PIL import Image, ImageDraw

    path = folder / summary.file
    image = read_image(path) if summary.frame is None else frame_of(path, summary.frame)
    low, high = np.array(row["box_px"][:2]), np.array(row["box_px"][2:])
    size = np.array(image.shape[1::-1])
    side = np.minimum(max(_LEAST_PX, int(np.ceil((high - low).max() * (1 + 2 * _MARGIN)))), size)
    left, top = np.clip(np.round((low + high - side) / 2), 0, size - side).astype(int)  # whole, also at an edge
    cut = Image.fromarray(np.ascontiguousarray(image[top : top + side[1], left : left + side[0]]))
    scale = _SIDE_PX / float(side.max())
    scale = float(int(scale)) if scale >= 1 else scale  # by whole numbers: pixels stay sharp
    cut = cut.resize(
        tuple(np.maximum(1, np.round(side * scale)).astype(int).tolist()),
        Image.Resampling.NEAREST if scale >= 1 else Image.Resampling.LANCZOS,
    )
    corners = np.concatenate([low - (left, top), high - (left, top)]) * scale + (-4, -4, 3, 3)
    ImageDraw.Draw(cut).rectangle(corners.tolist(), outline=_OUTLINE, width=3)
    data = io.BytesIO()
    cut.save(data, format="JPEG", quality=90)
    uri = "data:image/jpeg;base64," + b64encode(data.getvalue()).decode()
    at = "" if summary.frame is None else f", frame {summary.frame}"
    caption = f"{summary.file}{at}: {row['kind']}, score {row['score']:.2f}, {row.get('how', 'not covered')}"
    return PageImage(uri, f"Surroundings of a {row['kind']}", caption)

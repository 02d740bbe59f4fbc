"""Pictures with the free portrait that every installation has: Grace Hopper, among matplotlib's samples."""

from functools import lru_cache
from pathlib import Path

import numpy as np
from PIL import Image

HIDDEN, PICTURES, EVERY_BOX = 3, 8, 0.9
_FACE = np.array([166.0, 112.0, 366.0, 342.0])  # hair line to chin, ear to ear


@lru_cache(maxsize=1)
def hopper() -> Image.Image:
    from matplotlib.cbook import get_sample_data

    with get_sample_data("grace_hopper.jpg") as file:
        return Image.open(file).convert("RGB")


def portrait(face_px: int, *, width: int = 0, height: int = 0, left: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A picture with the portrait whose face is so high, and the face's box: left, top, right, bottom."""
    scale = face_px / (_FACE[3] - _FACE[1])
    small = hopper().resize((round(hopper().width * scale), round(hopper().height * scale)), Image.Resampling.BOX)
    width, height = max(width, small.width), max(height, small.height)
    canvas = Image.new("RGB", (width, height), (96, 104, 110))
    canvas.paste(small, (left, height - small.height))
    box = _FACE * scale + np.tile([left, height - small.height], 2)
    return np.array(canvas), box


def written(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(image).save(path)


def walk(folder: Path, pictures: int = PICTURES) -> list[np.ndarray]:
    """Pictures in which the portrait moves to the right; in one of them a post stands before the face."""
    boxes = []
    for number in range(pictures):
        image, box = portrait(40, width=260, height=130, left=6 * number)
        if number == HIDDEN:
            left, top, right, bottom = np.round(box).astype(int)
            image[top - 12 : bottom + 10, left - 12 : right + 12] = (70, 60, 52)
        written(folder / f"{number:02}.png", image)
        boxes.append(box)
    return boxes

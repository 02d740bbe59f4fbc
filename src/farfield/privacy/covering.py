"""Cover boxes of a picture so that nothing of what stood in them can be got back.

A Gaussian blur can be undone in part, and pixels of a plate in a known font can be read by trying strings (Revelio,
arXiv 2506.12344; Privacy Blur, arXiv 2512.16086). So ``fill`` takes nothing from inside, and the others keep a few
cells in sixteen levels, with noise whose seed is forgotten.
"""

from typing import Literal, get_args

import numpy as np
from jaxtyping import Bool, UInt8

from farfield.errors import ConfigError
from farfield.privacy.image_boxes import FACE, ImageBoxes

How = Literal["fill", "pixelate", "blur"]

_FACE_CELLS, _LEVELS, _NOISE = 6, 16, 8.0
_RING = 0.25  # of the longer side: how far around a box its colour is taken from
_GREY = 127
_Picture = UInt8[np.ndarray, "height width 3"]


def cover_boxes(image: _Picture, boxes: ImageBoxes, how: str, rng: np.random.Generator) -> _Picture:
    """The picture with its boxes covered.

    Args:
        image: RGB.
        boxes: What is to be covered, in its pixels.
        how: ``fill``: the mean colour around the box; ``pixelate``: at most six cells across a face and two of a plate;
            ``blur``: the same cells without edges.
        rng: Noise of the cells; whoever knows its seed can take the noise away, so forget it.

    Raises:
        ConfigError: If there is no such way.
    """
    if how not in get_args(How):
        raise ConfigError(f"covering: expected one of {', '.join(get_args(How))}; got {how!r}")
    result, mask = image.copy(), box_mask(boxes, image.shape[1], image.shape[0])
    for box, kind in zip(_pixel_bounds(boxes, image), boxes.kind, strict=True):
        left, top, right, bottom = box
        if how == "fill":
            result[top:bottom, left:right] = _ring_colour(image, mask, box)
        else:
            inside = image[top:bottom, left:right]
            result[top:bottom, left:right] = _noisy_cells(inside, str(kind), rng, smooth=how == "blur")
    return result


def box_mask(boxes: ImageBoxes, width: int, height: int) -> Bool[np.ndarray, "height width"]:
    """Which pixels of a picture lie in a box, those that it touches included."""
    mask = np.zeros((height, width), dtype=bool)
    for left, top, right, bottom in _pixel_bounds(boxes, mask):
        mask[top:bottom, left:right] = True
    return mask


def _pixel_bounds(boxes: ImageBoxes, image: np.ndarray) -> list[tuple[int, int, int, int]]:
    """Boxes in whole pixels: every pixel that they touch."""
    inside = boxes.within(image.shape[1], image.shape[0])
    if len(inside) != len(boxes):
        raise ConfigError("covering: expected boxes within the picture; cut them with within() first")
    low, high = np.floor(inside.box_px[:, :2]), np.ceil(inside.box_px[:, 2:])
    return [(int(left), int(top), int(right), int(bottom)) for left, top, right, bottom in np.column_stack([low, high])]


def _ring_colour(image: _Picture, mask: Bool[np.ndarray, "height width"], box: tuple[int, int, int, int]) -> np.ndarray:
    """Mean colour of what stands around a box and is not covered itself, shape (3,)."""
    left, top, right, bottom = box
    width_px = max(2, round(_RING * max(right - left, bottom - top)))
    rows = slice(max(top - width_px, 0), bottom + width_px)
    columns = slice(max(left - width_px, 0), right + width_px)
    ring = image[rows, columns][~mask[rows, columns]]
    return ring.mean(axis=0).round().astype(np.uint8) if len(ring) else np.full(3, _GREY, dtype=np.uint8)


def _noisy_cells(inside: _Picture, kind: str, rng: np.random.Generator, *, smooth: bool) -> _Picture:
    """Means of cells in few levels, with noise, drawn at the box's size."""
    from PIL import Image

    # 1. Few cells: six along the longer side of a face, one row of two on a plate.
    rows, columns = 1, min(2, inside.shape[1])
    if kind == FACE:
        cell_px = max(inside.shape[:2]) / _FACE_CELLS
        rows, columns = max(1, int(inside.shape[0] / cell_px)), max(1, int(inside.shape[1] / cell_px))
    means = np.array(Image.fromarray(inside).resize((columns, rows), Image.Resampling.BOX), dtype=np.float64)
    # 2. Few levels, and noise.
    step = 256 / _LEVELS
    noisy = np.floor(means / step) * step + step / 2 + rng.normal(0, _NOISE, means.shape)
    # 3. Back to the box's size.
    cells = Image.fromarray(noisy.clip(0, 255).round().astype(np.uint8))
    resampling = Image.Resampling.BICUBIC if smooth else Image.Resampling.NEAREST
    return np.array(cells.resize(inside.shape[1::-1], resampling))

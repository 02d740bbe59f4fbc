"""Cover boxes of a picture so that nothing of what stood in them can be got back.

A Gaussian blur can be undone in part, and pixels of a plate in a known font can be read by trying strings (Revelio,
arXiv 2506.12344; Privacy Blur, arXiv 2512.16086). So ``fill`` takes nothing from inside, and the others keep a few
cells in sixteen levels, with noise whose seed is forgotten.
"""

from typing import Literal, get_args

import numpy as np
from jaxtyping import Bool, UInt8

from farfield.errors import ConfigError
from farfield.privacy.hits import FACE, ImageBoxes

How = Literal["fill", "pixelate", "blur"]

_FACE_CELLS, _LEVELS, _NOISE = 6, 16, 8.0
_RING = 0.25  # of the longer side: how far around a box its colour is taken from
_GREY = 127
_Picture = UInt8[np.ndarray, "height width 3"]


def covered(image: _Picture, hits: ImageBoxes, how: str, rng: np.random.Generator) -> _Picture:
    """The picture with its boxes covered.

    Args:
        image: RGB.
        hits: What is to be covered, in its pixels.
        how: ``fill``: the mean colour around the box; ``pixelate``: at most six cells across a face and two of a plate;
            ``blur``: the same cells without edges.
        rng: Noise of the cells; whoever knows its seed can take the noise away, so forget it.

    Raises:
        ConfigError: If there is no such way.
    """
    if how not in get_args(How):
        raise ConfigError(f"covering: expected one of {', '.join(get_args(How))}; got {how!r}")
    result, mask = image.copy(), mask_of(hits, image.shape[1], image.shape[0])
    for box, kind in zip(_whole(hits, image), hits.kind, strict=True):
        left, top, right, bottom = box
        if how == "fill":
            result[top:bottom, left:right] = _around(image, mask, box)
        else:
            part = image[top:bottom, left:right]
            result[top:bottom, left:right] = _cells(part, _grid(part, str(kind)), rng, smooth=how == "blur")
    return result


def mask_of(hits: ImageBoxes, width: int, height: int) -> Bool[np.ndarray, "height width"]:
    """Which pixels of a picture lie in a box, those that it touches included."""
    mask = np.zeros((height, width), dtype=bool)
    for left, top, right, bottom in _whole(hits, mask):
        mask[top:bottom, left:right] = True
    return mask


def _whole(hits: ImageBoxes, image: np.ndarray) -> list[tuple[int, int, int, int]]:
    """Boxes in whole pixels: every pixel that they touch."""
    inside = hits.within(image.shape[1], image.shape[0])
    if len(inside) != len(hits):
        raise ConfigError("covering: expected boxes within the picture; cut them with within() first")
    low, high = np.floor(inside.box_px[:, :2]), np.ceil(inside.box_px[:, 2:])
    return [(int(left), int(top), int(right), int(bottom)) for left, top, right, bottom in np.column_stack([low, high])]


def _around(image: _Picture, mask: Bool[np.ndarray, "height width"], box: tuple[int, int, int, int]) -> np.ndarray:
    """Mean colour of what stands around a box and is not covered itself, shape (3,)."""
    left, top, right, bottom = box
    reach = max(2, round(_RING * max(right - left, bottom - top)))
    rows, columns = slice(max(top - reach, 0), bottom + reach), slice(max(left - reach, 0), right + reach)
    ring = image[rows, columns][~mask[rows, columns]]
    return ring.mean(axis=0).round().astype(np.uint8) if len(ring) else np.full(3, _GREY, dtype=np.uint8)


def _grid(part: _Picture, kind: str) -> tuple[int, int]:
    """Rows and columns of cells."""
    if kind != FACE:
        return 1, min(2, part.shape[1])
    cell = max(part.shape[:2]) / _FACE_CELLS
    return max(1, int(part.shape[0] / cell)), max(1, int(part.shape[1] / cell))


def _cells(part: _Picture, grid: tuple[int, int], rng: np.random.Generator, *, smooth: bool) -> _Picture:
    """Means of cells in few levels, with noise, drawn large."""
    from PIL import Image

    means = np.array(Image.fromarray(part).resize(grid[::-1], Image.Resampling.BOX), dtype=np.float64)
    step = 256 / _LEVELS
    noisy = np.floor(means / step) * step + step / 2 + rng.normal(0, _NOISE, means.shape)
    small = Image.fromarray(noisy.clip(0, 255).round().astype(np.uint8))
    large = small.resize(part.shape[1::-1], Image.Resampling.BICUBIC if smooth else Image.Resampling.NEAREST)
    return np.array(large)

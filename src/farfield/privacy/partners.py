"""The other eye of a stereo pair: what is covered in one picture, or half, is covered in the other too."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8

from farfield.privacy.hits import ImageBoxes, overlap

_ROWS, _COLUMNS = 0.02, 0.25  # how far off a partner may lie, over the picture's height and width
_ALIKE, _IOU = 0.6, 0.2
_LEAST_PX = 6
_Picture = UInt8[np.ndarray, "height width 3"]


class Partners(NamedTuple):
    """What the other picture lacks.

    Attributes:
        hits: Boxes to cover there besides.
        lost: Boxes of this picture whose partner was not found: hidden there, or outside of it.
    """

    hits: ImageBoxes
    lost: ImageBoxes


def partners(image: _Picture, hits: ImageBoxes, other: _Picture, known: ImageBoxes) -> Partners:
    """Find the partners of a picture's boxes in the other eye's, which are not among those known there.

    A partner lies in about the same rows and has the same looks: normalised correlation of at least 0.6.

    Args:
        image: This eye's picture, uncovered.
        hits: Its boxes.
        other: The other eye's, of the same size and time.
        known: The boxes that are covered there anyway.
    """
    found, rows, lost = list[np.ndarray](), list[int](), list[int]()
    for row in range(len(hits)):
        place = _place(image, hits.box_px[row].clip(min=0), other)
        if place is None:
            lost.append(row)
        elif not len(known) or overlap(place[None], known.box_px).max() < _IOU:
            found.append(place)
            rows.append(row)
    chosen = hits[np.array(rows, dtype=np.int64)]
    boxes = ImageBoxes(np.array(found).reshape(-1, 4), chosen.score, chosen.kind)
    return Partners(boxes, hits[np.array(lost, dtype=np.int64)])


def side_by_side(image: _Picture, hits: ImageBoxes) -> ImageBoxes:
    """What the halves of a picture that holds both eyes, left and right, lack of one another.

    Args:
        image: Both eyes' picture, uncovered; an odd column in the middle belongs to none.
        hits: Boxes of the whole picture; those that reach over the middle are in both eyes already.

    Returns:
        Boxes to cover besides, in the whole picture's pixels.
    """
    half = image.shape[1] // 2
    right = np.array([image.shape[1] - half, 0.0] * 2)
    eyes = (image[:, :half], image[:, -half:])
    middle = hits.box_px[:, [0, 2]].mean(axis=1) < image.shape[1] / 2
    parts = (hits[middle], replace(hits[~middle], box_px=hits[~middle].box_px - right))
    to_right = partners(eyes[0], parts[0], eyes[1], parts[1]).hits
    to_left = partners(eyes[1], parts[1], eyes[0], parts[0]).hits
    return ImageBoxes.joined([replace(to_right, box_px=to_right.box_px + right), to_left])


def _place(image: _Picture, box: np.ndarray, other: _Picture) -> np.ndarray | None:
    """Where the looks of a box are found in the other picture; None where nothing is alike."""
    import cv2

    left, top = np.floor(box[:2]).astype(int)
    right, bottom = np.ceil(box[2:]).astype(int)
    part = image[top:bottom, left:right]
    if min(part.shape[:2]) < _LEAST_PX or float(part.std()) < 1.0:
        return None
    height, width = other.shape[:2]
    up, side = max(2, round(_ROWS * height)), round(_COLUMNS * width)
    low = (max(0, top - up), max(0, left - side))
    region = other[low[0] : min(height, bottom + up), low[1] : min(width, right + side)]
    if region.shape[0] < part.shape[0] or region.shape[1] < part.shape[1]:
        return None
    scores = cv2.matchTemplate(np.ascontiguousarray(region), np.ascontiguousarray(part), cv2.TM_CCOEFF_NORMED)
    row, column = np.unravel_index(int(scores.argmax()), scores.shape)
    if not scores[row, column] >= _ALIKE:
        return None
    corner = np.array([low[1] + column, low[0] + row], dtype=float)
    return np.concatenate([corner, corner + np.array([right - left, bottom - top])])

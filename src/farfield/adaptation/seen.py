"""What a trained detector makes of frames: features of the cells that hold points, to be looked at or told apart."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int

from farfield.adaptation.cells import occupied, values_at, z_range_m
from farfield.detectors.inputs import Inputs, cloud_tensor
from farfield.detectors.runtime import Detector
from farfield.frame import Frame


@dataclass(frozen=True, eq=False, kw_only=True)
class OccupiedFeatures:
    """Features of occupied cells.

    Args:
        values: The features, shape (n, c).
        range_m: Distance of each cell's centre in the plane, shape (n,).
        frame: Number of the frame of each, shape (n,).
    """

    values: Float[np.ndarray, "n c"]
    range_m: Float[np.ndarray, " n"]
    frame: Int[np.ndarray, " n"]


@torch.no_grad()
def features_seen(
    detector: Detector, frames: Sequence[Frame], cloud: str, *, limit: int = 1000, seed: int = 0
) -> OccupiedFeatures:
    """The features that enter a detector's head, at cells that hold points.

    Args:
        detector: The detector; it has one input.
        frames: The frames.
        cloud: Which of their clouds to read.
        limit: Cells a frame at most, drawn at random.
        seed: Seed of the draw.
    """
    ((name, source),) = detector.network.inputs.items()
    rng, found = np.random.default_rng(seed), list[tuple[np.ndarray, np.ndarray]]()
    for frame in frames:
        points = cloud_tensor(frame.cloud(cloud), source.columns)
        inputs = Inputs({name: [points]}).to(detector.device)
        features = detector.network.encode(inputs)
        cells = occupied(features, inputs, z_range_m(detector.config))
        chosen = torch.from_numpy(np.sort(rng.permutation(len(cells))[:limit])).to(cells.row.device)
        values = values_at(features, cells[chosen]).float().cpu().numpy().astype(np.float64)
        found.append((values, cells[chosen].place_m.float().norm(dim=1).cpu().numpy().astype(np.float64)))
    return OccupiedFeatures(
        values=np.concatenate([values for values, _ in found]),
        range_m=np.concatenate([range_m for _, range_m in found]),
        frame=np.repeat(np.arange(len(found)), [len(values) for values, _ in found]),
    )

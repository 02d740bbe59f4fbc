"""Frames of one drive in the order of time."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

Key = tuple[str, str]
"""(sequence, frame): what pairs predictions with annotations."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Drive:
    """Frames of one drive in the order of time, known without building a frame.

    Args:
        name: Name of the drive.
        indices: The frames' indices in their data set, shape (n,).
        keys: (sequence, frame) of each.
        times_ns: Time of each, shape (n,), or None.
        world_T_frame: Pose of each frame's coordinates, shape (n, 4, 4), or None.
    """

    name: str
    indices: Int[np.ndarray, " n"]
    keys: tuple[Key, ...]
    times_ns: Int[np.ndarray, " n"] | None = None
    world_T_frame: Float[np.ndarray, "n 4 4"] | None = None

"""What annotation tools say of a frame, as an annotation."""

import hashlib
from collections.abc import Sequence

import numpy as np

from farfield.files.cuboids import Cuboid
from farfield.frame import Annotation, Boxes
from farfield.vocabulary.classes import CIRRUS_FROM_TOOLS, normalised_class


def annotation_of(cuboids: Sequence[Cuboid]) -> Annotation:
    """Boxes with our class names and tracks as numbers: whole numbers as they are, other names as stable ones."""
    rows = np.array([cuboid.box for cuboid in cuboids], dtype=np.float64).reshape(-1, 7)
    boxes = Boxes(
        centre_m=rows[:, :3],
        size_m=rows[:, 3:6],
        yaw_rad=rows[:, 6],
        label=[normalised_class(cuboid.label, CIRRUS_FROM_TOOLS) for cuboid in cuboids],
        track_id=np.array([_track(cuboid.track) for cuboid in cuboids], dtype=np.int64),
    )
    return Annotation(boxes=boxes, original_label=tuple(cuboid.label for cuboid in cuboids))


def _track(track: str) -> int:
    if not track:
        return -1
    if track.isascii() and track.isdigit() and len(track) < 18:
        return int(track)
    return int.from_bytes(hashlib.sha256(track.encode()).digest()[:7], "big")

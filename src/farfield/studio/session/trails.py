"""Trails: where the tracks of a frame were and will be, in the coordinates of the frame shown."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from farfield.frame import Drive
from farfield.geometry.poses import invert, transform_points
from farfield.studio.messages.rows import Trail

AROUND = 10
"""Frames before and after."""
Centres = Callable[[int], Sequence[tuple[int, float, float, float]]]
"""Track number and centre of each box of a frame that has one."""


def trails(name: str, drive: Drive, index: int, tracks: Sequence[int], centres: Centres) -> tuple[Trail, ...]:
    """The trails of some tracks.

    Args:
        name: Of the set, empty for annotations.
        drive: The drive that holds the frame; without poses its centres stay in their frames' own coordinates.
        index: The frame shown.
        tracks: Numbers of the tracks.
        centres: Gives the boxes of any frame.
    """
    place = int(np.flatnonzero(drive.indices == index)[0])
    wanted, found = set(tracks), {track: [] for track in tracks}  # type: ignore[var-annotated]
    for other in range(max(place - AROUND, 0), min(place + AROUND + 1, len(drive.indices))):
        frame = int(drive.indices[other])
        rows = [row for row in centres(frame) if row[0] in wanted]
        if rows:
            here = _seen_from(drive, place, other, np.array([row[1:] for row in rows]))
            for row, (x, y, z) in zip(rows, here.tolist(), strict=True):
                found[row[0]].append((frame, x, y, z))
    return tuple(Trail(set=name, track=track, points=tuple(points)) for track, points in found.items() if points)


def _seen_from(drive: Drive, place: int, other: int, centres_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    if drive.world_T_frame is None or place == other:
        return centres_m
    return transform_points(invert(drive.world_T_frame[place]) @ drive.world_T_frame[other], centres_m)

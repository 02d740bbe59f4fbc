"""Drives of a data set, of a selection of its frames, and as a map shows them."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from farfield.datasets.maps.contract import FrameMap
from farfield.frame import Drive

Indices = Int[np.ndarray, " _"]
Poses = Float[np.ndarray, "_ 4 4"]


def by_sequence(sequences: Sequence[str]) -> dict[str, Indices]:
    """Indices of the frames of each sequence, in their order.

    >>> by_sequence(("a", "b", "a"))
    {'a': array([0, 2]), 'b': array([1])}
    """
    members: dict[str, list[int]] = {}
    for index, sequence in enumerate(sequences):
        members.setdefault(sequence, []).append(index)
    return {name: np.array(indices, dtype=np.int64) for name, indices in members.items()}


def before_each(drives: Iterable[Indices], count: int) -> Indices:
    """Index of the frame before each of ``count`` frames in its drive, -1 where there is none."""
    before = np.full(count, -1, dtype=np.int64)
    for indices in drives:
        before[indices[1:]] = indices[:-1]
    return before


def all_known(times_ns: Iterable[int | None]) -> Indices | None:
    """Times as an array; None where one is not known."""
    times = list(times_ns)
    return None if None in times else np.array(times, dtype=np.int64)


def all_poses(poses: Iterable[Float[np.ndarray, "4 4"] | None]) -> Poses | None:
    """Poses as an array; None where one is not known."""
    found = list(poses)
    known = [pose for pose in found if pose is not None]
    return np.stack(known).astype(np.float64) if known and len(known) == len(found) else None


def gather(indices: Indices, places: Mapping[int, Sequence[int]]) -> tuple[Indices, Indices]:
    """Rows of a drive that were selected, and their indices in the selection.

    Args:
        indices: The drive's indices in the whole data set.
        places: Where in the selection an index of the whole data set stands.
    """
    pairs = [(row, place) for row, index in enumerate(indices.tolist()) for place in places.get(index, ())]
    return tuple(np.array([pair[side] for pair in pairs], dtype=np.int64) for side in (0, 1))  # type: ignore[return-value]


def cut(drive: Drive, rows: Indices, indices: Indices) -> Drive:
    """Some rows of a drive, with their indices in another data set."""
    return replace(
        drive,
        indices=indices,
        keys=tuple(drive.keys[row] for row in rows),
        times_ns=None if drive.times_ns is None else drive.times_ns[rows],
        world_T_frame=None if drive.world_T_frame is None else drive.world_T_frame[rows],
    )


def seen(drive: Drive, function: FrameMap) -> Drive:
    """A drive as a map shows it: its poses where the map brings some, or says what becomes of them."""
    poses_of = getattr(function, "poses_of", None)
    if poses_of is not None:
        return replace(drive, world_T_frame=poses_of(drive.keys))
    if drive.world_T_frame is None:
        return drive
    moved_poses = getattr(function, "moved_poses", None)
    return replace(drive, world_T_frame=None if moved_poses is None else moved_poses(drive.world_T_frame))

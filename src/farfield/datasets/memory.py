"""Frames that are in memory already, as a data set: what lies above the readers knows nothing else."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from farfield.datasets.base import Dataset
from farfield.datasets.drives import Indices, Poses, all_known, all_poses
from farfield.frame import Frame


class InMemory(Dataset):
    """A list of frames. It has no files, so nothing identifies it: its name, root and fingerprint are empty.

    Args:
        frames: The frames, each of its own (sequence, frame).
        in_order: Whether the frames of each sequence stand in the order of time, so that they are drives, of which
            sweeps can be stacked and tracks built; a plain list says nothing of it.
    """

    name = "memory"
    root = Path()
    stored = False

    def __init__(self, frames: Iterable[Frame], *, in_order: bool = False) -> None:
        self.frames, self.in_order = tuple(frames), in_order
        self.sequences = tuple(frame.sequence for frame in self.frames)
        self.frame_ids = tuple(frame.frame_id for frame in self.frames)

    def __repr__(self) -> str:
        return f"InMemory(frames: {len(self)}, sequences: {len(set(self.sequences))})"

    def frame(self, index: int) -> Frame:
        """Frame ``index``."""
        return self.frames[index]

    def files(self, index: int) -> Sequence[Path]:
        """No files."""
        del index
        return ()

    def drive_indices(self) -> dict[str, Indices]:
        """The sequences, where the frames stand in the order of time."""
        return dict(super().drive_indices()) if self.in_order else {}

    def _times_of(self, indices: Indices) -> Indices | None:
        return all_known(self.frames[index].time_ns for index in indices)

    def _poses_of(self, indices: Indices) -> Poses | None:
        return all_poses(self.frames[index].world_T_frame for index in indices)


def in_memory(frames: Dataset | Iterable[Frame], *, in_order: bool = False) -> Dataset:
    """Frames as a data set; a data set stays what it is.

    Args:
        frames: Frames in a list or another iterable, or a data set.
        in_order: As :class:`InMemory` takes it.

    >>> import numpy as np
    >>> in_memory([Frame.of(np.zeros((4, 3)))])
    InMemory(frames: 1, sequences: 1)
    """
    return frames if isinstance(frames, Dataset) else InMemory(frames, in_order=in_order)

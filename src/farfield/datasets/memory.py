"""Frames without a data set's folder, as a data set: those in memory, and single cloud files."""

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

from farfield.datasets.base import Dataset, Indices, Poses, all_known, all_poses
from farfield.datasets.cloud_reading import CloudReading
from farfield.errors import DatasetError
from farfield.files.atomic import readable
from farfield.files.point_times import PointTimes
from farfield.frame import Frame, Key


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


class CloudFiles(Dataset):
    """Single clouds as frames, each read when it is indexed and not kept; like frames in memory they have no drives.

    Args:
        paths: The files; a file's name is its frame's. Where two have one name, their folders are their sequences.
        bin_columns: Columns of ``.bin`` files; None takes what the largest of the first ones shows.
        column_names: Names of the columns of all files that name none, such as ``("x", "y", "z", "time")``.
        intensity_scale: Value that stands for full reflectance in all clouds; None decides by some of them.
        point_times: Unit of the points' times, where the files have any: ``s``, ``ms``, ``us``, ``ns``, or ``none`` to
            leave the column as it is; ``auto`` decides by the sweeps' period.

    Raises:
        DatasetError: If a file is named twice, or two cannot be told apart.
    """

    name = "files"
    reading: CloudReading
    root = Path()
    stored = False

    def __init__(
        self,
        paths: Sequence[Path],
        *,
        bin_columns: int | None = None,
        column_names: Sequence[str] = (),
        intensity_scale: float | int | None = None,
        point_times: PointTimes = "auto",
    ) -> None:
        self.paths = tuple(paths)
        self.reading = CloudReading(
            self.paths,
            bin_columns=bin_columns,
            column_names=column_names,
            intensity_scale=intensity_scale,
            point_times=point_times,
            posed=True,
        )
        alone = len({path.stem for path in self.paths}) == len(self.paths)
        self.sequences = tuple("files" if alone else readable(path.resolve().parent.name) for path in self.paths)
        self.frame_ids = tuple(readable(path.stem) for path in self.paths)
        double: Key | None = next((key for key, count in Counter(self.keys).items() if count > 1), None)
        if double is not None:
            same = ", ".join(str(path) for path, key in zip(self.paths, self.keys, strict=True) if key == double)
            raise DatasetError(f"{same}: expected each cloud once, and names or folders that differ; both are {double}")

    def frame(self, index: int) -> Frame:
        """Read cloud ``index``."""
        path = self.paths[index]
        return Frame.of(
            self.reading(path),
            sequence=self.sequences[index],
            frame_id=self.frame_ids[index],
            world_T_frame=self.reading.world_T_frame(path),
        )

    def _poses_of(self, indices: Indices) -> Poses | None:
        return all_poses(self.reading.world_T_frame(self.paths[int(index)]) for index in indices)

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What was decided from the clouds: the origin of a map's coordinates."""
        return self.reading.assumptions

    def files(self, index: int) -> tuple[Path, ...]:
        """The file of a frame."""
        return (self.paths[index],)

    def has_annotation(self, index: int) -> bool:
        """Never: a cloud file holds no boxes."""
        del index
        return False

    def drive_indices(self) -> dict[str, Indices]:
        """None: nothing says in which order they were taken."""
        return {}

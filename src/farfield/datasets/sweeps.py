"""Several sweeps a frame: the points of the frames before it, moved into its coordinates, with their age."""

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from farfield.datasets.base import Dataset, Moved, Subset
from farfield.errors import ConfigError, DatasetError
from farfield.frame import Cloud, Frame, Lazy
from farfield.geometry.poses import invert

LAG_COLUMN = "lag_s"


def stack_sweeps(dataset: Dataset, count: int) -> Dataset:
    """Return the data set with each cloud followed by those of the ``count - 1`` frames before it in its sequence.

    Earlier points are moved by the frames' poses, so that what stands still stays in place; what moves leaves a trail.
    Each point tells its sweep's age in the column ``lag_s``, 0 for the present one. The first frames of a sequence have
    fewer sweeps. Boxes and images are those of the present frame. Of a selection of frames, the frames before are those
    before in the whole data set.

    Args:
        dataset: Frames in the order of time within each sequence.
        count: Sweeps a frame; 1 changes nothing.

    Raises:
        ConfigError: If ``count`` is below 1.
        DatasetError: If the first frame has no pose or no time; reading a frame raises it for the others.
    """
    if count < 1:
        raise ConfigError(f"stack_sweeps: expected at least 1 sweep a frame, got {count}")
    if count == 1:
        return dataset
    if isinstance(dataset, Moved):
        return stack_sweeps(dataset.parent, count).moved(dataset.target_T_lidar)
    if type(dataset) is Subset:
        return stack_sweeps(dataset.parent, count).select(dataset.indices)
    return Sweeps(dataset, count)


def sweeps_of(dataset: Dataset) -> int:
    """Sweeps a frame of a data set that may have been stacked, selected from or moved."""
    while isinstance(dataset, Subset):
        if isinstance(dataset, Sweeps):
            return dataset.count
        dataset = dataset.parent
    return 1


class Sweeps(Subset):
    """Another data set whose clouds hold several sweeps; see :func:`stack_sweeps`."""

    def __init__(self, parent: Dataset, count: int) -> None:
        super().__init__(parent, range(len(parent)))
        self.count = count
        places: dict[str, list[int]] = {}
        self._before: list[tuple[int, ...]] = []
        for index, sequence in enumerate(parent.sequences):
            seen = places.setdefault(sequence, [])
            self._before.append(tuple(seen[:-count:-1]))
            seen.append(index)
        if len(parent):
            _checked(parent[0], parent.root)

    def frame(self, index: int) -> Frame:
        """Build frame ``index`` with the sweeps before it."""
        present = _checked(super().frame(index), self.root)
        earlier = [_checked(self.parent.frame(other), self.root) for other in self._before[index]]

        loaders = {name: partial(_stacked, present, earlier, name) for name in present.clouds}
        return replace(present, clouds=Lazy(loaders))

    def files(self, index: int) -> Sequence[Path]:
        """List the files that frame ``index`` is read from, the present frame's first."""
        return [path for other in (index, *self._before[index]) for path in self.parent.files(other)]

    def fingerprint(self) -> str:
        """SHA-256 of the parent's fingerprint and the number of sweeps."""
        return hashlib.sha256(f"{self.parent.fingerprint()} sweeps {self.count}".encode()).hexdigest()


def _checked(frame: Frame, root: Path) -> Frame:
    missing = [name for name, value in (("pose", frame.world_T_frame), ("time", frame.time_ns)) if value is None]
    if missing:
        raise DatasetError(
            f"{root}: several sweeps a frame need each frame's pose and time; frame {frame.key} has no "
            f"{' and no '.join(missing)}. Take one sweep (data.sweeps=1)."
        )
    return frame


def _stacked(present: Frame, earlier: Sequence[Frame], name: str) -> Cloud:
    """The present cloud, then the earlier ones that have this sensor, the youngest first."""
    assert present.world_T_frame is not None
    frame_T_world = invert(present.world_T_frame)
    parts = [_aged(present.clouds[name], 0.0)]
    for frame in earlier:
        if name in frame.clouds:
            assert frame.world_T_frame is not None
            lag_s = (_time_ns(present, name) - _time_ns(frame, name)) / 1e9
            parts.append(_aged(frame.clouds[name].transform(frame_T_world @ frame.world_T_frame), lag_s))
    return Cloud.concatenate(parts)


def _aged(cloud: Cloud, lag_s: float) -> Cloud:
    column = np.full(len(cloud), lag_s, dtype=np.float32)
    return Cloud(cloud.points_m, cloud.intensity, {**cloud.extra, LAG_COLUMN: column})


def _time_ns(frame: Frame, name: str) -> int:
    time_ns = frame.time_ns_of(name)
    assert time_ns is not None
    return time_ns

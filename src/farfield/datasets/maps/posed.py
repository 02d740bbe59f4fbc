"""Frames with poses from files beside the data, such as ``farfield odometry`` writes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict

from farfield.datasets.maps.contract import Earlier
from farfield.errors import ConfigError
from farfield.files.poses_csv import PoseTable, read_poses
from farfield.frame import Frame
from farfield.frame.drive import Key


class PosedSettings(BaseModel):
    """Settings of :class:`Posed`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    poses: Path


@dataclass(frozen=True)
class Posed:
    """Each frame with the pose that the files give it, in the place of its own; one that they do not have has none.

    A drive has poses if the files have all of its frames. Where no motion is known (after a pause in the recording),
    the poses after it are not to be compared with those before.

    Args:
        poses: A file of poses, or a folder of such (``*.csv``, or ``poses/*.csv``).

    Raises:
        ConfigError: When poses are first asked for, if there are none; or if a frame stands in other coordinates than
            those that its pose is of.
        FileFormatError: If a file is damaged.
    """

    name: ClassVar[str] = "posed"
    Settings: ClassVar[type[BaseModel]] = PosedSettings
    keeps_annotation: ClassVar[bool] = True
    poses: Path

    def settings(self) -> Mapping[str, Any]:
        """Where the poses stand."""
        return {"poses": str(self.poses)}

    def fits(self, dataset: Any) -> bool:
        """Whether the files have a frame of the data set."""
        try:
            return any(key in self._by_key for key in dataset.keys)
        except ConfigError:  # data of another machine
            return False

    def poses_of(self, keys: Sequence[Key]) -> Float[np.ndarray, "n 4 4"] | None:
        """Poses of the frames of a drive; None where one is not known."""
        rows = [self._by_key.get(key) for key in keys]
        known = [table.world_T_frame[row] for found in rows if found is not None for table, row in (found,)]
        return np.stack(known) if known and len(known) == len(keys) else None

    def moved_poses(self, world_T_frame: Float[np.ndarray, "n 4 4"]) -> None:
        """The drives' own poses are not those of the files."""
        del world_T_frame

    def __call__(self, frame: Frame, earlier: Earlier) -> Frame:
        """The frame with its pose."""
        del earlier
        found = self._by_key.get(frame.key)
        if found is None:
            return replace(frame, world_T_frame=None)
        table, row = found
        if table.reference != frame.reference:
            raise ConfigError(
                f"{self.poses}: expected poses of {frame.reference}, in whose coordinates frame {frame.key} stands; "
                f"they are of {table.reference}. Open the data with the reference that the odometry saw."
            )
        return replace(frame, world_T_frame=table.world_T_frame[row])

    @cached_property
    def tables(self) -> tuple[PoseTable, ...]:
        """The tables, one a drive."""
        if self.poses.is_dir():
            folder = self.poses / "poses" if (self.poses / "poses").is_dir() else self.poses
            paths = sorted(folder.glob("*.csv"))
        else:
            paths = [self.poses] if self.poses.is_file() else []
        if not paths:
            raise ConfigError(f"{self.poses}: expected poses, a .csv a drive; `farfield odometry DATA` writes them")
        return tuple(map(read_poses, paths))

    @cached_property
    def _by_key(self) -> Mapping[Key, tuple[PoseTable, int]]:
        return {
            (table.sequence, frame): (table, row) for table in self.tables for row, frame in enumerate(table.frames)
        }

    def __getstate__(self) -> dict[str, Any]:
        return {"poses": self.poses}

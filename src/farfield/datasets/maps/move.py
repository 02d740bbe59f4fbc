"""Move frames rigidly, such as by half a turn to look backwards."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict

from farfield.datasets.maps.contract import Earlier
from farfield.errors import ConfigError
from farfield.frame import Frame, moved
from farfield.geometry.poses import invert, pose_from_yaw

_Row = tuple[float, float, float, float]


class MoveSettings(BaseModel):
    """Settings of :class:`Move`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    target_T_frame: tuple[_Row, _Row, _Row, _Row]


@dataclass(frozen=True, eq=False)
class Move:
    """Every frame (clouds, boxes, poses, cameras) in other coordinates.

    Args:
        target_T_frame: Maps the frames' coordinates to the new ones, 4 x 4.

    Raises:
        ConfigError: If it is no rigid motion.
    """

    name: ClassVar[str] = "move"
    Settings: ClassVar[type[BaseModel]] = MoveSettings
    target_T_frame: Float[np.ndarray, "4 4"] | Sequence[Sequence[float]]

    def __post_init__(self) -> None:
        pose = np.asarray(self.target_T_frame, dtype=np.float64)
        if pose.shape != (4, 4) or not _is_rigid(pose):
            raise ConfigError(f"move: expected target_T_frame to be a rigid motion, 4 x 4 numbers; got {pose.tolist()}")
        object.__setattr__(self, "target_T_frame", pose)

    @classmethod
    def turned(cls, yaw_deg: float | int) -> "Move":
        """A turn counter-clockwise about z."""
        return cls(pose_from_yaw(float(np.deg2rad(yaw_deg))))

    @property
    def pose(self) -> Float[np.ndarray, "4 4"]:
        """The motion as an array."""
        return np.asarray(self.target_T_frame)

    def settings(self) -> Mapping[str, Any]:
        """The motion as rows of numbers."""
        return {"target_T_frame": self.pose.tolist()}

    def moved_poses(self, world_T_frame: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 4 4"]:
        """Poses of the moved frames."""
        return world_T_frame @ invert(self.pose)

    def __call__(self, frame: Frame, earlier: Earlier) -> Frame:
        """The frame, moved."""
        del earlier
        return moved(frame, self.pose)


def _is_rigid(pose: Float[np.ndarray, "4 4"]) -> bool:
    turn = pose[:3, :3]
    upright = np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) and np.linalg.det(turn) > 0
    return bool(np.isfinite(pose).all() and upright and np.array_equal(pose[3], [0.0, 0.0, 0.0, 1.0]))

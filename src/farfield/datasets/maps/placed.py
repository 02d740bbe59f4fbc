"""A cloud that is read in its sensor's own coordinates and placed in the frame's."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from farfield.frame import Cloud

_SAME = 1e-9


@dataclass(frozen=True, eq=False)
class TransformedCloud:
    """Loads a cloud and moves it once, however often the frame's coordinates were changed.

    Args:
        read: Reads the cloud in its sensor's coordinates.
        frame_T_sensor: Pose of the sensor in the frame's coordinates.
    """

    read: Callable[[], Cloud]
    frame_T_sensor: Float[np.ndarray, "4 4"]

    def __call__(self) -> Cloud:
        """The cloud in the frame's coordinates; as it was read where these are the sensor's."""
        cloud = self.read()
        if np.allclose(self.frame_T_sensor, np.eye(4), rtol=0, atol=_SAME):
            return cloud
        return cloud.transform(self.frame_T_sensor)

    def moved(self, target_T_frame: Float[np.ndarray, "4 4"]) -> "TransformedCloud":
        """The same cloud in other coordinates."""
        return replace(self, frame_T_sensor=target_T_frame @ self.frame_T_sensor)

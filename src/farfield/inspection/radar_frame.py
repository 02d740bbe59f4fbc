"""One radar frame looked at: its views, the straightened camera picture, the boxes, and how the radar itself moved."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Float64, UInt8

from farfield.datasets.base import Dataset
from farfield.datasets.kradar.undistortion import straighten, straightened_camera
from farfield.errors import ConfigError, DatasetError
from farfield.frame import Camera, Frame
from farfield.frame.provenance import is_simulated
from farfield.geometry.boxes import Boxes
from farfield.geometry.poses import invert
from farfield.radar.doppler import radar_velocity
from farfield.radar.views import PRODUCTS, RadarViews, radar_views
from farfield.vocabulary.kradar import KRADAR_ORIGIN_M

_LONGEST_S = 1.0  # frames farther apart say little about the velocity


@dataclass(frozen=True, eq=False, kw_only=True)
class RadarLook:
    """A frame in the radar's coordinates.

    Args:
        key: Sequence and frame.
        conditions: Road, time and weather.
        views: Power, Doppler and echoes.
        boxes: The annotated boxes, or None.
        image: The camera's picture, straightened where there is a calibration, or None.
        camera: The straightened picture's camera, or None.
        velocity_m_s: The radar's own velocity in its axes, or None where nothing says it.
        velocity_from: What says it, in words.
        simulated: Whether the data set is simulated.
    """

    key: tuple[str, str]
    conditions: dict[str, str]
    views: RadarViews
    boxes: Boxes | None = None
    image: UInt8[np.ndarray, "height width 3"] | None = None
    camera: Camera | None = None
    velocity_m_s: Float64[np.ndarray, "3"] | None = None
    velocity_from: str = ""
    simulated: bool = False

    @property
    def over_ground_m_s(self) -> Float[np.ndarray, " n"] | None:
        """Radial velocity of each echo less what a standing one would show; None where that is not known."""
        if self.views.echoes is None or self.velocity_m_s is None:
            return None
        return self.views.echoes.unwrapped(self.velocity_m_s).compensated_m_s


def look_at(
    data: Dataset,
    index: int,
    *,
    camera: str = "cam-front",
    speed_m_s: float | None = None,
    turn_deg_s: float = 0.0,
    **settings: Any,
) -> RadarLook:
    """Look at one frame of a data set.

    Args:
        data: The data set, in the radar's coordinates (``reference="radar"``).
        index: Which frame.
        camera: Name of the image beside it.
        speed_m_s: How fast the car drives; None takes it from the poses of the frames beside.
        turn_deg_s: How fast it turns to the left, with ``speed_m_s``.
        **settings: Of :func:`~farfield.radar.views.radar_views`.

    Raises:
        ConfigError: If there is no such frame, or a setting is none of those possible.
        DatasetError: If the frame has no radar product, or is in another sensor's coordinates.
    """
    if not 0 <= index < len(data):
        raise ConfigError(f"frame: expected a number from 0 to {len(data) - 1}, got {index}")
    frame = data[index]
    if frame.radar and frame.reference != "radar":
        fix = "Open the data set with reference='radar'"
        raise DatasetError(f"frame {frame.key}: expected the radar's coordinates, got {frame.reference}'s. {fix}")
    try:
        views = radar_views(frame.radar, **settings)
    except ValueError as error:
        raise ConfigError(str(error)) from error
    if views is None:
        present = ", ".join([*frame.radar, *frame.clouds, *frame.images]) or "nothing"
        raise DatasetError(f"frame {frame.key}: expected one of {', '.join(PRODUCTS)}, found {present}")
    image, straight = _picture(frame, camera)
    velocity, source = _velocity(data, index, frame, speed_m_s, turn_deg_s)
    return RadarLook(
        key=frame.key,
        conditions=dict(frame.conditions),
        views=views,
        boxes=frame.boxes,
        image=image,
        camera=straight,
        velocity_m_s=velocity,
        velocity_from=source,
        simulated=is_simulated(data.root),
    )


def _picture(frame: Frame, name: str) -> tuple[UInt8[np.ndarray, "height width 3"] | None, Camera | None]:
    """The image, straightened where its camera is known and of its size; (None, None) where there is no such image."""
    if name not in frame.images:
        return None, None
    image, camera = frame.images[name], frame.cameras.get(name)
    height, width = image.shape[:2]
    if camera is None or (camera.width_px and (camera.width_px, camera.height_px) != (width, height)):
        return image, None
    sized = replace(camera, width_px=width, height_px=height)
    try:
        return straighten(image, sized), straightened_camera(sized)
    except ValueError:  # a distortion that cannot be undone can still be projected with
        return image, sized


def _velocity(
    data: Dataset, index: int, frame: Frame, speed_m_s: float | None, turn_deg_s: float
) -> tuple[Float64[np.ndarray, "3"] | None, str]:
    if speed_m_s is not None:
        vehicle_T_radar = np.eye(4)
        vehicle_T_radar[:3, 3] = KRADAR_ORIGIN_M
        forward, turn = np.array([speed_m_s, 0.0, 0.0]), np.array([0.0, 0.0, np.radians(turn_deg_s)])
        return radar_velocity(forward, turn, vehicle_T_radar), f"{speed_m_s:g} m/s were given"
    for other in (index + 1, index - 1):
        if 0 <= other < len(data) and data.keys[other][0] == frame.sequence:
            velocity = _mean_velocity(frame, data[other])
            if velocity is not None:
                return velocity, f"from the poses of this frame and of {data.keys[other][1]}"
    return None, ""


def _mean_velocity(frame: Frame, other: Frame) -> Float64[np.ndarray, "3"] | None:
    """Mean velocity between two frames in the axes of the first; None where poses or times are missing."""
    if frame.world_T_frame is None or other.world_T_frame is None or frame.time_ns is None or other.time_ns is None:
        return None
    apart_s = (other.time_ns - frame.time_ns) / 1e9
    if not 0 < abs(apart_s) <= _LONGEST_S:
        return None
    moved_m = (invert(frame.world_T_frame) @ other.world_T_frame)[:3, 3]
    return np.asarray(moved_m / apart_s, dtype=np.float64)

"""What a camera without a calibration begins from: typed in, our own file, or points clicked in a model of the car.

A list of points clicked in a scanned model of the car (K-Radar, D.3) is CSV with the header ``name,x,y,z``, in whatever
coordinates and unit the model has. It needs ``lidar``, ``front`` and ``rear`` (one behind the other), ``left`` and
``right`` (side by side), and the sensors by name; ``<sensor> ahead``, a point along its view, says where it looks::

    name,x,y,z
    lidar,0.02,1.71,0.10
    front,0.01,0.55,2.31
    ...
    cam-front,0.06,1.66,0.22
    cam-front ahead,0.06,1.64,0.80
"""

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from farfield.datasets.calibration import read_intrinsics
from farfield.errors import ConfigError, FileFormatError
from farfield.files.atomic import read_bytes
from farfield.geometry.cameras import CAMERA_T_LIDAR_AXES, Camera
from farfield.geometry.poses import invert, pose

_MAX_BYTES = 1 << 20
_HEADER = ["name", "x", "y", "z"]
_NEEDED = ("lidar", "front", "rear", "left", "right")
_SQUARE = 0.35  # cosine: the two lines may be 70 to 110 degrees apart


@dataclass(frozen=True, kw_only=True)
class InitialGuess:
    """What a camera without a calibration begins from; each may be left out.

    Args:
        focal_px: A guessed focal length.
        intrinsics: Our file, as ``farfield calibrate board`` writes it.
        position_m: Where the lens stands in the LiDAR's coordinates.
        facing_deg: Where it looks, counter-clockwise from ahead.
        car: Points clicked in a model of the car, instead of the two.
    """

    focal_px: float | None = None
    intrinsics: Path | None = None
    position_m: tuple[float, float, float] | None = None
    facing_deg: float = 0.0
    car: Path | None = None

    @property
    def empty(self) -> bool:
        """Whether all of it is left out."""
        return self == InitialGuess()

    def camera(self, name: str, picture: tuple[int, ...], stored: Camera | None) -> Camera:
        """The camera to begin with; what is left out stays as the data set has it.

        Args:
            name: Name of the image.
            picture: Its shape.
            stored: The data set's own calibration.

        Raises:
            ConfigError: If there is no focal length, or the intrinsics are of pictures of another size.
        """
        camera_T_lidar = self._camera_T_lidar(name)
        if camera_T_lidar is None:
            camera_T_lidar = camera_at(np.zeros(3), yaw_rad=0.0) if stored is None else stored.camera_T_lidar
        if self.intrinsics is not None:
            cameras = read_intrinsics(self.intrinsics)
            camera = cameras.get(name) or next(iter(cameras.values()))
            if camera.width_px and (camera.width_px, camera.height_px) != picture[1::-1]:
                size = f"{camera.width_px} x {camera.height_px}"
                raise ConfigError(f"{self.intrinsics}: expected a picture of {picture[1]} x {picture[0]}, got {size}")
            return replace(camera, camera_T_lidar=camera_T_lidar, width_px=picture[1], height_px=picture[0])
        if self.focal_px is not None:
            if not 10 < self.focal_px < 1e5:
                raise ConfigError(f"--guess-focal: expected pixels, got {self.focal_px:g}")
            middle = (picture[1] - 1) / 2, (picture[0] - 1) / 2
            matrix = np.array([[self.focal_px, 0, middle[0]], [0, self.focal_px, middle[1]], [0, 0, 1.0]])
            return Camera(matrix=matrix, camera_T_lidar=camera_T_lidar, width_px=picture[1], height_px=picture[0])
        if stored is None:
            raise ConfigError(f"{name} has no calibration: give --guess-focal PIXELS and --pairs, or --intrinsics FILE")
        return replace(stored, camera_T_lidar=camera_T_lidar)

    def _camera_T_lidar(self, name: str) -> Float[np.ndarray, "4 4"] | None:
        """The pose by the clicked points or the position; None without either."""
        if self.car is not None:
            points = read_clicked(self.car)
            camera_T_lidar = camera_from_clicked(points, name)
            if camera_T_lidar is None:
                raise ConfigError(f"{self.car}: expected a point called {name}, got {', '.join(points)}")
            return camera_T_lidar
        if self.position_m is None:
            return None
        return camera_at(np.array(self.position_m), yaw_rad=float(np.radians(self.facing_deg)))


def camera_at(
    position_m: Float[np.ndarray, " 3"], *, yaw_rad: float = 0.0, pitch_rad: float = 0.0
) -> Float[np.ndarray, "4 4"]:
    """``camera_T_lidar`` of a camera that stands there and looks that way.

    Args:
        position_m: The lens in the LiDAR's coordinates.
        yaw_rad: Direction of view, counter-clockwise from ahead.
        pitch_rad: How far it looks down.
    """
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    low, level = np.sin(pitch_rad), np.cos(pitch_rad)
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1.0]]) @ np.array(
        [[level, 0, low], [0, 1, 0], [-low, 0, level]]
    )
    return CAMERA_T_LIDAR_AXES @ invert(pose(turn, np.asarray(position_m, dtype=np.float64)))


def read_clicked(path: Path, *, unit_m: float = 1.0) -> dict[str, Float[np.ndarray, " 3"]]:
    """Read clicked points.

    Args:
        path: The list.
        unit_m: Metres that one unit of the model is.

    Returns:
        Points in metres in the LiDAR's coordinates (x forward, y left, z up, the LiDAR at 0), by name.

    Raises:
        FileFormatError: If the list is another, lacks one of the five points, or these do not tell the directions.
    """
    points = _rows(path)
    missing = [name for name in _NEEDED if name not in points]
    if missing:
        raise FileFormatError(path, where="the names", expected=", ".join(_NEEDED), got=f"no {', '.join(missing)}")
    ahead, left = points["front"] - points["rear"], points["left"] - points["right"]
    lengths = float(np.linalg.norm(ahead)), float(np.linalg.norm(left))
    if min(lengths) < 1e-6 or abs(float(ahead @ left)) > _SQUARE * lengths[0] * lengths[1]:
        expected = "front - rear across left - right"
        raise FileFormatError(path, where="front, rear, left, right", expected=expected, got=f"{ahead}, {left}")
    x = ahead / lengths[0]
    z = np.cross(x, left)
    z /= np.linalg.norm(z)
    lidar_T_model = np.stack([x, np.cross(z, x), z]) * unit_m
    return {name: lidar_T_model @ (point - points["lidar"]) for name, point in points.items()}


def _rows(path: Path) -> dict[str, Float[np.ndarray, " 3"]]:
    """The list's points in the model's coordinates."""
    text = read_bytes(path, max_bytes=_MAX_BYTES).decode("utf-8-sig", errors="replace")
    rows = [[cell.strip() for cell in row] for row in csv.reader(io.StringIO(text)) if any(map(str.strip, row))]
    if not rows or [cell.lower() for cell in rows[0]] != _HEADER:
        raise FileFormatError(path, where="line 1", expected=",".join(_HEADER), got=repr(rows[:1])[:80])
    points: dict[str, np.ndarray] = {}
    for number, row in enumerate(rows[1:], 2):
        try:
            name, point = row[0].lower(), np.array([float(cell) for cell in row[1:]])
        except ValueError as error:
            raise FileFormatError(path, where=f"row {number}", expected="three numbers", got=str(error)) from None
        if point.shape != (3,) or not np.isfinite(point).all() or name in points:
            expected = "a new name and three finite numbers"
            raise FileFormatError(path, where=f"row {number}", expected=expected, got=repr(row)[:80])
        points[name] = point
    return points


def camera_from_clicked(points: Mapping[str, Float[np.ndarray, " 3"]], name: str) -> Float[np.ndarray, "4 4"] | None:
    """``camera_T_lidar`` of a sensor among clicked points; it looks ahead unless ``<name> ahead`` says otherwise."""
    position_m = points.get(name.lower())
    if position_m is None:
        return None
    view = points.get(f"{name.lower()} ahead", position_m + np.array([1.0, 0.0, 0.0])) - position_m
    level = float(np.hypot(view[0], view[1]))
    return camera_at(
        position_m, yaw_rad=float(np.arctan2(view[1], view[0])), pitch_rad=float(np.arctan2(-view[2], level))
    )

"""Calibrations that begin with nothing: a folder of pictures of a board; picked pairs and a guessed focal length."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from farfield.calibration.boards import Board, BoardCalibration, calibrate_board, find_board
from farfield.calibration.mounting import camera_at, camera_from_clicked, guessed_camera, read_clicked
from farfield.calibration.pairs import PairCalibration, calibrate_pairs
from farfield.datasets.base import Dataset
from farfield.datasets.calibration import read_calibration
from farfield.errors import ConfigError
from farfield.files.images import read_image
from farfield.geometry.boxes import Boxes
from farfield.geometry.cameras import Camera
from farfield.geometry.poses import transform_points

_SUFFIXES = (".png", ".jpg", ".jpeg")
_SPREAD = 0.2  # of the picture, and of the distance: picks nearer to one another tell little


def board_job(
    folder: Path, board: Board, progress: Callable[[Iterable[Path]], Iterable[Path]] = iter
) -> BoardCalibration:
    """Calibrate from all pictures of a folder; those without the board are named in ``left_out``.

    Raises:
        ConfigError: If there are too few.
    """
    paths = sorted(path for path in folder.glob("*") if path.suffix.lower() in _SUFFIXES)
    if not paths:
        raise ConfigError(f"{folder}: expected pictures of the board ({', '.join(_SUFFIXES)}), found none")
    seen = {path.name: find_board(read_image(path), board, path.name) for path in progress(paths)}
    found = calibrate_board([each for each in seen.values() if each is not None], board)
    return replace(
        found, left_out={name: "no board seen" for name, each in seen.items() if each is None} | found.left_out
    )


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
    def given(self) -> bool:
        """Whether there is anything."""
        return self != InitialGuess()

    def camera(self, name: str, picture: tuple[int, ...], known: Camera | None) -> Camera:
        """The camera to begin with; what is not given stays as the data set has it.

        Args:
            name: Name of the image.
            picture: Its shape.
            known: The data set's own calibration.

        Raises:
            ConfigError: If there is no focal length, or the intrinsics are of pictures of another size.
        """
        pose = self._pose(name)
        if pose is None:
            pose = camera_at(np.zeros(3), yaw_rad=0.0) if known is None else known.camera_T_lidar
        if self.intrinsics is not None:
            cameras = read_calibration(self.intrinsics)
            camera = cameras.get(name) or next(iter(cameras.values()))
            if camera.width_px and (camera.width_px, camera.height_px) != picture[1::-1]:
                size = f"{camera.width_px} x {camera.height_px}"
                raise ConfigError(f"{self.intrinsics}: expected a picture of {picture[1]} x {picture[0]}, got {size}")
            return replace(camera, camera_T_lidar=pose, width_px=picture[1], height_px=picture[0])
        if self.focal_px is not None:
            if not 10 < self.focal_px < 1e5:
                raise ConfigError(f"--guess-focal: expected pixels, got {self.focal_px:g}")
            return guessed_camera(picture[1], picture[0], self.focal_px, pose)
        if known is None:
            raise ConfigError(f"{name} has no calibration: give --guess-focal PIXELS and --pairs, or --intrinsics FILE")
        return replace(known, camera_T_lidar=pose)

    def _pose(self, name: str) -> Float[np.ndarray, "4 4"] | None:
        if self.car is not None:
            points = read_clicked(self.car)
            pose = camera_from_clicked(points, name)
            if pose is None:
                raise ConfigError(f"{self.car}: expected a point called {name}, got {', '.join(points)}")
            return pose
        if self.position_m is None:
            return None
        return camera_at(np.array(self.position_m), yaw_rad=float(np.radians(self.facing_deg)))


@dataclass(frozen=True, eq=False, kw_only=True)
class PairsJob:
    """A camera from picked pairs.

    Args:
        before: The camera at the start.
        found: What was found.
        picture: The picture in which pairs were picked.
        points_m: The frame's cloud.
        boxes: The frame's boxes.
        notes: What the picks do not tell.
    """

    before: Camera
    found: PairCalibration
    picture: UInt8[np.ndarray, "height width 3"]
    points_m: Float[np.ndarray, "n 3"]
    boxes: Boxes
    notes: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """Camera, sigma, and the residual of every pick in pixels."""
        camera = self.found.camera
        return {
            "kind": "lidar-camera",
            "from": "pairs",
            "camera_T_lidar": camera.camera_T_lidar.tolist(),
            "matrix": camera.matrix.tolist(),
            "distortion": camera.distortion.tolist(),
            **self.found.solution.to_json(),
            "residual_px": self.found.residual_px.round(2).tolist(),
            "left_out": np.flatnonzero(~self.found.inlier).tolist(),
            "notes": [*self.notes, *self.found.solution.unobserved],
        }


def pairs_job(
    data: Dataset,
    index: int,
    name: str,
    pairs: tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 2"]],
    start: Camera,
    *,
    focal: bool,
) -> PairsJob:
    """Solve a camera from pairs picked in one frame.

    Args:
        data: The data set.
        index: The frame.
        name: Name of the image.
        pairs: Points and pixels.
        start: Intrinsics to begin with.
        focal: Solve for the focal length too.
    """
    frame = data[index]
    found = calibrate_pairs(*pairs, start, focal=focal)
    return PairsJob(
        before=start,
        found=found,
        picture=frame.images[name],
        points_m=frame.cloud().points_m.astype(np.float64),
        boxes=Boxes.empty() if frame.boxes is None else frame.boxes,
        notes=spread_notes(*pairs, found.camera),
    )


def spread_notes(
    points_m: Float[np.ndarray, "n 3"], pixels: Float[np.ndarray, "n 2"], camera: Camera
) -> tuple[str, ...]:
    """Which picks to add: where in the picture, and at which distance, there are none."""
    u, v = (pixels / [max(camera.width_px, 1), max(camera.height_px, 1)]).T
    depth = np.log(np.maximum(transform_points(camera.camera_T_lidar, points_m)[:, 2], 0.1))
    lacks = [
        (u.min() > 0.5 - _SPREAD, "far left in the picture"),
        (u.max() < 0.5 + _SPREAD, "far right in the picture"),
        (np.ptp(v) < _SPREAD, "higher or lower in the picture"),
        (np.ptp(depth) < np.log(2.0), "at twice or half the distance"),
    ]
    return tuple(f"add a point {where}" for lacking, where in lacks if lacking)

"""What ``farfield calibrate`` is asked for, and the solver that answers: the options of every kind in one class."""

from dataclasses import dataclass, replace
from math import radians
from pathlib import Path
from typing import Literal

from farfield.calibration.boards import Board, BoardCalibration
from farfield.calibration.camera_pairs import calibrate_pairs, read_pairs
from farfield.calibration.initial_guess import InitialGuess
from farfield.calibration.jobs import (
    CameraJob,
    PairsJob,
    RadarJob,
    board_job,
    camera_job,
    choose_frames,
    lidars_job,
    pairs_job,
    radar_job,
    radar_start,
)
from farfield.calibration.lidar_lidar import Registration
from farfield.datasets.base import Dataset
from farfield.errors import ConfigError
from farfield.geometry.cameras import Camera

CalibrationKind = Literal["radar-lidar", "lidar-camera", "lidar-lidar", "board"]
KINDS = ("radar-lidar", "lidar-camera", "lidar-lidar", "board")


@dataclass(frozen=True, kw_only=True)
class CalibrationOptions:
    """How a sensor is calibrated: flags of ``farfield calibrate``, keywords of :func:`farfield.calibrate`.

    Args:
        sequence: Which one (default: the first).
        frames: How many frames to use, spread over the sequence; for the radar in runs of ten.
        camera: Name of the image (default: the first with a calibration).
        lidars: The clouds to register, the reference first.
        pairs: CSV of picked pairs (x_m,y_m,z_m,u_px,v_px): the camera begins from them.
        focal: With --pairs, solve for the focal length too (twelve pairs).
        guess_focal: Focal length in pixels to begin with, for a camera without calibration; solved for.
        intrinsics: What board wrote: its focal length and distortion are kept.
        position: Where the lens stands in the LiDAR's coordinates: x forward, y left, z up, metres.
        facing: Where it looks, degrees counter-clockwise from ahead.
        car: CSV of points clicked in a scanned model of the car (name,x,y,z), instead of --position and --facing.
        x: Start of the radar's x in metres, as K-Radar's file has it (default: the data set's own).
        y: Start of its y.
        yaw: Start of its yaw in degrees (default: the data set's own).
        frame_offset: Start of the radar frames to add to those that are paired.
        corners: Inner corners of the board in a row and in a column.
        square: Side of its squares in metres.
        charuco: It is a ChArUco board: markers in its white squares.

    Raises:
        ConfigError: If fewer than one frame is to be used.
    """

    sequence: str | None = None
    frames: int = 40
    camera: str | None = None
    lidars: tuple[str, str] = ("os2-64", "os1-128")
    pairs: Path | None = None
    focal: bool = False
    guess_focal: float | None = None
    intrinsics: Path | None = None
    position: tuple[float, float, float] | None = None
    facing: float = 0.0
    car: Path | None = None
    x: float | None = None
    y: float | None = None
    yaw: float | None = None
    frame_offset: int = 0
    corners: tuple[int, int] = (9, 6)
    square: float = 0.03
    charuco: bool = False

    def __post_init__(self) -> None:
        if self.frames < 1:
            raise ConfigError(f"--frames: expected one or more, got {self.frames}")

    @property
    def board(self) -> Board:
        """The board whose pictures are taken."""
        columns, rows = self.corners
        return Board(columns=columns, rows=rows, square_m=self.square, markers=self.charuco)

    @property
    def initial_guess(self) -> InitialGuess:
        """What a camera without a calibration begins from."""
        return InitialGuess(
            focal_px=self.guess_focal,
            intrinsics=self.intrinsics,
            position_m=self.position,
            facing_deg=self.facing,
            car=self.car,
        )

    @property
    def yaw_rad(self) -> float | None:
        """Start of the radar's yaw, where one is given."""
        return None if self.yaw is None else radians(self.yaw)


@dataclass(frozen=True, eq=False, kw_only=True)
class PicturedCamera:
    """A camera of a data set that is to be calibrated.

    Args:
        index: The first of the chosen frames that has its picture.
        name: Name of the image.
        stored: The data set's own calibration, if it has one.
        start: The camera to begin with.
    """

    index: int
    name: str
    stored: Camera | None
    start: Camera


def pictured_camera(data: Dataset, indices: list[int], options: CalibrationOptions) -> PicturedCamera:
    """The camera that the options name, and what its calibration begins from.

    Raises:
        ConfigError: If no chosen frame has such a picture, or there is nothing to begin from.
    """
    guess = options.initial_guess
    names: list[str] = []
    for index in indices:
        frame = data[index]
        names += [name for name in frame.images if not guess.empty or name in frame.cameras]
        if names and options.camera in (None, *names):
            break
    else:
        listed = ", ".join(dict.fromkeys(names)) or "no camera at all"
        raise ConfigError(f"--camera: expected one of {listed}; got {options.camera}")
    name = options.camera or names[0]
    stored = frame.cameras.get(name)
    start = stored if guess.empty else guess.camera(name, frame.images[name].shape, stored)
    posed = guess.intrinsics and (guess.car or guess.position_m)
    if start is None or (stored is None and options.pairs is None and not posed):
        raise ConfigError(f"{name} has no calibration: give --pairs, or --intrinsics with --car or --position")
    return PicturedCamera(index=index, name=name, stored=stored, start=start)


def solve(
    kind: CalibrationKind, data: Dataset | Path, options: CalibrationOptions
) -> RadarJob | CameraJob | PairsJob | Registration | BoardCalibration:
    """Solve where a sensor stands against the LiDAR, or a camera's intrinsics. Nothing is written.

    Args:
        kind: What against what; ``"board"``: intrinsics from pictures of a board.
        data: A data set; for ``"board"`` the folder of pictures.
        options: The options.

    Raises:
        ConfigError: If a choice is not possible, or the data set has no such sensor.
        DatasetError: If there is no such sequence, or no frame has both sensors.
    """
    if kind not in KINDS:
        raise ConfigError(f"kind: expected {', '.join(KINDS[:-1])} or {KINDS[-1]}, got {kind!r}")
    if isinstance(data, Path) != (kind == "board"):
        raise ConfigError(f"calibrate {kind}: expected {'a folder of pictures' if kind == 'board' else 'a data set'}")
    if isinstance(data, Path):
        return board_job(data, options.board)
    indices = choose_frames(data, options.sequence, options.frames, runs=kind == "radar-lidar")
    if kind == "radar-lidar":
        start = radar_start(data, indices[0], x_m=options.x, y_m=options.y, yaw_rad=options.yaw_rad)
        return radar_job(data, indices, replace(start, frames=options.frame_offset))
    if kind == "lidar-lidar":
        return lidars_job(data, indices, *options.lidars)
    camera = pictured_camera(data, indices, options)
    start_camera: Camera = camera.start
    if options.pairs is not None:
        pairs = read_pairs(options.pairs)
        if options.guess_focal is not None:  # nothing but pairs
            return pairs_job(data, camera.index, camera.name, pairs, start_camera, focal=True)
        start_camera = calibrate_pairs(*pairs, start_camera, focal=options.focal).camera
    return camera_job(data, indices, camera=camera.name, start=None if start_camera is camera.stored else start_camera)

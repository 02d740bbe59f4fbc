"""Intrinsics and distortion from pictures of a chessboard or a ChArUco board (Zhang, PAMI 2000, by OpenCV).

Minimised is the distance, in pixels, of all corners from their projections, over focal lengths, principal point, four
or five coefficients of distortion, and the board's pose in each picture. :func:`find_board` finds the corners,
:func:`calibrate_board` is the algorithm. A chessboard has to be seen whole; of a ChArUco board (a chessboard with
markers in its white squares) a part is enough, so that corners of the picture, where distortion shows, are reached.
Needs OpenCV.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any

import numpy as np
from jaxtyping import Float, Int, Shaped, UInt8
from scipy.spatial import cKDTree

from farfield.errors import ConfigError, MissingExtraError
from farfield.geometry.cameras import CAMERA_T_LIDAR_AXES, Camera

LEAST_PICTURES = 5
MARGIN_SQUARES = 1.0  # of white round a printed board
_LEAST_CORNERS = 8
_WORST = 3.0  # times the median error: a picture with a wrong corner
_DICTIONARY = "DICT_5X5_1000"
_MARKER = 0.72  # of a square's side
_WINDOW = 0.075  # of a square's side: markers begin at 0.14
_COEFFICIENTS = 5
_FIELDS = (6, 4)  # of the picture, in which corners are counted
_CRITERION = 2.0  # times the criterion's own: corners of one picture err together


@dataclass(frozen=True, kw_only=True)
class Board:
    """A flat board of squares.

    Args:
        columns: Inner corners in a row: one less than squares.
        rows: Inner corners in a column.
        square_m: Side of a square; sets the scale of the boards' poses alone, not of the intrinsics.
        markers: Whether it is a ChArUco board (5 x 5 markers of OpenCV's dictionary of 1,000, 0.72 of a square).
    """

    columns: int = 9
    rows: int = 6
    square_m: float = 0.03
    markers: bool = False

    def __post_init__(self) -> None:
        if min(self.columns, self.rows) < 2 or not 0 < self.square_m < 10:
            raise ConfigError(f"board: expected two or more inner corners each way and a side, got {self}")

    @property
    def corners_m(self) -> Float[np.ndarray, "n 3"]:
        """Inner corners on the board, row by row, shape (n, 3); z is 0."""
        y, x = np.mgrid[1 : self.rows + 1, 1 : self.columns + 1]
        return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]) * self.square_m

    def detector(self) -> Any:
        """OpenCV's description of the ChArUco board."""
        cv2 = opencv()
        markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, _DICTIONARY))
        size = (self.columns + 1, self.rows + 1)
        return cv2.aruco.CharucoBoard(size, self.square_m, _MARKER * self.square_m, markers)


@dataclass(frozen=True, eq=False, kw_only=True)
class Sighting:
    """The board in one picture.

    Args:
        name: The picture.
        corner: Numbers of the corners that are visible, shape (n,).
        pixels: Their pixels, shape (n, 2).
        size_px: Width and height of the picture.
    """

    name: str
    corner: Int[np.ndarray, " n"]
    pixels: Float[np.ndarray, "n 2"]
    size_px: tuple[int, int]


@dataclass(frozen=True, eq=False, kw_only=True)
class BoardCalibration:
    """Intrinsics of a camera from pictures of a board.

    Args:
        camera: Intrinsics and distortion; the pose is that of a camera that looks ahead.
        sigma: Standard deviations of fx, fy, cx, cy in pixels and of the five coefficients, shape (9,).
        error_px: Root mean square distance of each picture's corners from where the solution puts them.
        used: Names of the pictures used.
        left_out: Names of the others and why.
        covered: Share of the picture's 6 x 4 fields in which a corner was seen.
    """

    camera: Camera
    sigma: Float[np.ndarray, " 9"]
    error_px: Float[np.ndarray, " n"]
    used: tuple[str, ...]
    left_out: dict[str, str]
    covered: float

    @property
    def notes(self) -> tuple[str, ...]:
        """What the pictures do not tell well."""
        notes = []
        if self.covered < 0.75:
            notes.append(f"corners were seen in {self.covered:.0%} of the picture: distortion is a guess in the rest")
        if self.sigma[0] > 0.005 * self.camera.matrix[0, 0]:
            notes.append("the focal length is not known to 0.5 %: take pictures with the board tilted by 30 degrees")
        return tuple(notes)

    def to_json(self) -> dict[str, Any]:
        """Everything that was found."""
        names = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
        return {
            "kind": "board",
            "matrix": self.camera.matrix.tolist(),
            "distortion": self.camera.distortion.tolist(),
            "size_px": [self.camera.width_px, self.camera.height_px],
            "sigma": dict(zip(names, self.sigma.tolist(), strict=True)),
            "error_px": dict(zip(self.used, self.error_px.round(4).tolist(), strict=True)),
            "left_out": self.left_out,
            "covered": self.covered,
            "notes": list(self.notes),
        }


@dataclass(frozen=True, eq=False)
class _BoardSolution:
    matrix: Any
    distortion: Any
    sigma: Any
    error_px: Float[np.ndarray, " n"]
    sightings: list[Sighting] = field(default_factory=list)


def opencv() -> Any:
    """OpenCV.

    Raises:
        MissingExtraError: If it is not installed.
    """
    if find_spec("cv2") is None:
        raise MissingExtraError("opencv-python-headless", "privacy", "calibrating from pictures of a board")
    import cv2

    return cv2


def find_board(picture: UInt8[np.ndarray, "height width 3"], board: Board, name: str = "") -> Sighting | None:
    """Find the board's inner corners in a picture; None where it is not seen.

    Args:
        picture: RGB.
        board: The board.
        name: What to call the picture.
    """
    cv2 = opencv()
    grey = cv2.cvtColor(np.ascontiguousarray(picture), cv2.COLOR_RGB2GRAY)
    size = (picture.shape[1], picture.shape[0])
    if board.markers:
        corners, numbers, _, _ = cv2.aruco.CharucoDetector(board.detector()).detectBoard(grey)
        if numbers is None or len(numbers) < _LEAST_CORNERS:
            return None
        pixels = _refine_corners(grey, corners.reshape(-1, 2), _WINDOW)
        return Sighting(name=name, corner=numbers.ravel().astype(np.int64), pixels=pixels, size_px=size)
    flags = cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_NORMALIZE_IMAGE
    is_complete, corners = cv2.findChessboardCornersSB(grey, (board.columns, board.rows), flags=flags)
    if not is_complete:
        return None
    pixels = _refine_corners(grey, corners.reshape(-1, 2), 2 * _WINDOW)
    return Sighting(name=name, corner=np.arange(len(pixels)), pixels=pixels, size_px=size)


def _refine_corners(
    grey: UInt8[np.ndarray, "height width"], pixels: Shaped[np.ndarray, "n 2"], window: float
) -> Float[np.ndarray, "n 2"]:
    """Corners to a tenth of a pixel, in a window (in squares) that holds one corner and no marker's edge."""
    cv2 = opencv()
    apart = np.asarray(cKDTree(pixels).query(pixels, k=2)[0])
    square_px = float(np.median(apart[:, 1]))
    half = int(np.clip(round(window * square_px), 2, 6))
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)
    start = np.ascontiguousarray(pixels, dtype=np.float32).reshape(-1, 1, 2)
    return np.asarray(cv2.cornerSubPix(grey, start, (half, half), (-1, -1), stop).reshape(-1, 2), dtype=np.float64)


def calibrate_board(sightings: Iterable[Sighting], board: Board) -> BoardCalibration:
    """Solve for intrinsics and distortion.

    Pictures whose corners fit three times worse than the median picture's are left out, once.

    Args:
        sightings: The board in several pictures of one camera, tilted and in all parts of the picture.
        board: The board.

    Raises:
        ConfigError: If there are fewer than five, or of different sizes.
        MissingExtraError: If OpenCV is not there.
    """
    pictures = list(sightings)
    sizes = sorted({picture.size_px for picture in pictures})
    if len(pictures) < LEAST_PICTURES or len(sizes) != 1:
        got = f"{len(pictures)} of the sizes {sizes}" if len(sizes) > 1 else f"{len(pictures)}"
        raise ConfigError(f"board: expected {LEAST_PICTURES} or more pictures of one size with the board, got {got}")

    # 1. Solve with all pictures.
    solution = _solve(pictures, board)

    # 2. Leave out those with wrong corners, and solve again, if enough remain.
    median_px = np.median(solution.error_px)
    left_out = {
        picture.name: f"fits {error_px:.2f} px, the median picture {median_px:.2f} px"
        for picture, error_px in zip(pictures, solution.error_px, strict=True)
        if error_px > _WORST * median_px
    }
    if left_out and len(pictures) - len(left_out) >= LEAST_PICTURES:
        solution = _solve([picture for picture in pictures if picture.name not in left_out], board)
    else:
        left_out = {}

    # 3. The camera, its sigma, and where in the picture corners were.
    width, height = sizes[0]
    camera = Camera(
        matrix=np.asarray(solution.matrix, dtype=np.float64),
        distortion=np.asarray(solution.distortion, dtype=np.float64).ravel()[:_COEFFICIENTS],
        camera_T_lidar=CAMERA_T_LIDAR_AXES.copy(),
        width_px=width,
        height_px=height,
    )
    fields = [
        np.floor(picture.pixels / np.array(picture.size_px) * _FIELDS).clip(0, np.array(_FIELDS) - 1)
        for picture in solution.sightings
    ]
    return BoardCalibration(
        camera=camera,
        sigma=np.asarray(solution.sigma, dtype=np.float64).ravel()[: 4 + _COEFFICIENTS],
        error_px=solution.error_px,
        used=tuple(picture.name for picture in solution.sightings),
        left_out=left_out,
        covered=len(np.unique(np.concatenate(fields), axis=0)) / (_FIELDS[0] * _FIELDS[1]),
    )


def _solve(pictures: list[Sighting], board: Board) -> _BoardSolution:
    """Without k3, and with it where the corners ask for it (Bayesian information criterion)."""
    cv2 = opencv()
    corners_m = board.corners_m.astype(np.float32)
    objects = [corners_m[picture.corner] for picture in pictures]
    pixels = [picture.pixels.astype(np.float32).reshape(-1, 1, 2) for picture in pictures]
    fits = []
    for flags in (cv2.CALIB_FIX_K3, 0):
        rms, matrix, distortion, _, _, sigma, _, error = cv2.calibrateCameraExtended(
            objects, pixels, pictures[0].size_px, None, None, flags=flags
        )
        error_px = np.asarray(error, dtype=np.float64).ravel()
        fits.append((rms, _BoardSolution(matrix, distortion, sigma, error_px, pictures)))
    numbers = 2 * sum(len(picture.corner) for picture in pictures)
    gain = 2 * numbers * np.log(fits[0][0] / max(fits[1][0], 1e-12))
    return fits[int(gain > _CRITERION * np.log(numbers))][1]


def board_picture(board: Board, px_per_square: int = 100) -> UInt8[np.ndarray, "height width"]:
    """The board with a white margin of one square; 8 bit grey, for printing at ``board.square_m`` a square."""
    across, down = board.columns + 1, board.rows + 1
    if board.markers:
        size = (across * px_per_square, down * px_per_square)
        inner = np.asarray(board.detector().generateImage(size), dtype=np.uint8)
    else:
        y, x = np.mgrid[:down, :across]
        inner = np.kron(255 * ((x + y) % 2), np.ones((px_per_square, px_per_square))).astype(np.uint8)
    return np.pad(inner, round(MARGIN_SQUARES * px_per_square), constant_values=255)

"""Pictures of a calibration board as a camera of known calibration would see it."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, UInt8
from scipy import ndimage
from scipy.interpolate import RectBivariateSpline
from scipy.spatial.transform import Rotation

from farfield.calibration.boards import MARGIN_SQUARES, Board, board_picture
from farfield.errors import ConfigError
from farfield.geometry.cameras import Camera, undistort
from farfield.geometry.poses import invert, pose

_FINE_PX = 60  # of the board's own picture a square
_KNOTS_PX = 12


def render_board(
    camera: Camera,
    camera_T_board: Float[np.ndarray, "4 4"],
    board: Board,
    *,
    rng: np.random.Generator,
    noise: float = 2.0,
    blur_px: float = 0.5,
    fine: int = 2,
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw what a camera sees of a board: rays through the lens, several a pixel, light that falls off, noise.

    Args:
        camera: Intrinsics, distortion and size.
        camera_T_board: Maps the board's coordinates (z away from the camera) to the camera's; all of it lies ahead.
        board: The board.
        rng: Of the noise.
        noise: Its standard deviation in grey values.
        blur_px: The lens' blur.
        fine: Rays a pixel each way.
    """
    grey = np.full((camera.height_px, camera.width_px), 110.0)
    left, top, right, bottom = _outline(camera, camera_T_board, board)
    if left < right and top < bottom:
        columns = (np.arange((right - left) * fine) + 0.5) / fine - 0.5 + left
        rows = (np.arange((bottom - top) * fine) + 0.5) / fine - 0.5 + top
        inside = _texture(camera, camera_T_board, board, columns, rows)
        grey[top:bottom, left:right] = inside.reshape(bottom - top, fine, right - left, fine).mean(axis=(1, 3))
    light = 0.85 - 0.2 * np.linspace(-1, 1, camera.width_px) ** 2
    smooth = ndimage.gaussian_filter(30 + 0.75 * grey * light, blur_px)
    noisy = np.clip(np.rint(smooth + rng.normal(0, noise, smooth.shape)), 0, 255).astype(np.uint8)
    return np.repeat(noisy[:, :, None], 3, axis=2)


def _outline(camera: Camera, camera_T_board: Float[np.ndarray, "4 4"], board: Board) -> tuple[int, int, int, int]:
    """Columns and rows of the picture between which the board lies."""
    share = np.linspace(-MARGIN_SQUARES, 1.0, 12)
    x = share * (board.columns + 2)
    y = share * (board.rows + 2)
    ends = ((board.columns + 2.0), (board.rows + 2.0), -MARGIN_SQUARES)
    around = [np.column_stack([x, np.full(12, end)]) for end in (ends[1], ends[2])]
    around += [np.column_stack([np.full(12, end), y]) for end in (ends[0], ends[2])]
    rim_m = np.column_stack([np.concatenate(around) * board.square_m, np.zeros(48)])
    plain = replace(camera, camera_T_lidar=camera_T_board, width_px=0, height_px=0)
    pixels = plain.project(rim_m)[0]
    limit = np.array([camera.width_px, camera.height_px])
    low = np.clip(np.floor(np.nan_to_num(pixels, nan=-1e6).min(axis=0)), 0, limit).astype(int)
    high = np.clip(np.ceil(np.nan_to_num(pixels, nan=1e6).max(axis=0)) + 1, 0, limit).astype(int)
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def _texture(
    camera: Camera,
    camera_T_board: Float[np.ndarray, "4 4"],
    board: Board,
    columns: Float[np.ndarray, " n"],
    rows: Float[np.ndarray, " m"],
) -> Float[np.ndarray, "m n"]:
    """Grey value of the board, or of what is behind it, along the rays of a grid of pixels, shape (m, n).

    Where rays meet the board is smooth over the picture: traced every few pixels, and by splines between.
    """
    down, across = (np.linspace(a[0], a[-1], max(int((a[-1] - a[0]) / _KNOTS_PX), 4)) for a in (rows, columns))
    v, u = np.meshgrid(down, across, indexing="ij")
    image_plane = (np.column_stack([u.ravel(), v.ravel()]) - camera.matrix[:2, 2]) / np.diag(camera.matrix)[:2]
    rays = np.column_stack([undistort(image_plane, camera.distortion), np.ones(len(image_plane))])
    board_T_camera = invert(camera_T_board)
    towards, origin = rays @ board_T_camera[:3, :3].T, board_T_camera[:3, 3]
    range_m = -origin[2] / np.where(np.abs(towards[:, 2]) > 1e-3, towards[:, 2], 1e-3)
    cell = ((origin[:2] + towards[:, :2] * range_m[:, None]) / board.square_m + MARGIN_SQUARES) * _FINE_PX - 0.5
    cell = np.where((range_m > 0)[:, None], np.clip(cell, -1e4, 1e5), -1e4).reshape(*u.shape, 2)
    x, y = (RectBivariateSpline(down, across, cell[..., axis])(rows, columns).astype(np.float32) for axis in (0, 1))
    texture = board_picture(board, _FINE_PX).astype(np.float32)
    return np.asarray(ndimage.map_coordinates(texture, np.stack([y, x]), order=1, mode="constant", cval=110.0))


def board_poses(camera: Camera, board: Board, count: int, rng: np.random.Generator) -> list[Float[np.ndarray, "4 4"]]:
    """Poses of a board as a careful person holds it: into each corner of the picture in turn, tilted, all of it seen.

    Args:
        camera: The camera.
        board: The board.
        count: How many.
        rng: Draws tilts and distances.

    Returns:
        ``camera_T_board`` of each.
    """
    size = np.array([board.columns + 1, board.rows + 1]) * board.square_m
    ends = np.array([[0, 0], [1, 0], [0, 1], [1, 1]])
    limit = np.array([camera.width_px, camera.height_px])
    poses: list[np.ndarray] = []
    for _ in range(1000 * count):
        corner = len(poses) % 5  # the fifth: anywhere
        turn = Rotation.from_euler("xyz", rng.uniform([-40, -40, -15], [40, 40, 15]), degrees=True).as_matrix()
        edge = 0.03 + 0.94 * ends[corner] if corner < 4 else rng.uniform(0.1, 0.9, 2)
        pixel = (edge * (limit - 1))[None]
        ray = undistort((pixel - camera.matrix[:2, 2]) / np.diag(camera.matrix)[:2], camera.distortion)[0]
        range_m = rng.uniform(0.5, 1.3) * size[0] * camera.matrix[0, 0] / (0.6 * camera.width_px)
        held = np.append(ends[corner] * size, 0.0) if corner < 4 else np.append(size / 2, 0.0)
        camera_T_board = pose(turn, np.append(ray, 1.0) * range_m - turn @ held)
        posed = replace(camera, camera_T_lidar=camera_T_board)
        if posed.project(np.column_stack([ends * size, np.zeros(4)]))[2].all():
            poses.append(camera_T_board)
        if len(poses) == count:
            return poses
    raise ConfigError(f"board_poses: found {len(poses)} of {count} poses that show the whole board")

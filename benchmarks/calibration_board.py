"""Intrinsics and distortion from rendered pictures of a chessboard and a ChArUco board, whose truth is known.

python benchmarks/calibration_board.py --output benchmarks/results/calibration_board.txt
"""

import argparse
import time
from pathlib import Path

import numpy as np
from _board_rendering import board_poses, render_board
from _report import header, progress
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from farfield.calibration.boards import Board, calibrate_board, find_board
from farfield.geometry.cameras import Camera

LENSES = {
    "ZED 2i (K-Radar)": (567.7, 577.2, 628.7, 369.3, 1280, 720, (-0.0289, 0.0006, 0.0040, -0.0050, 0.0)),
    "1920 x 650 (Cirrus)": (1050.0, 1050.0, 962.0, 318.0, 1920, 650, (-0.30, 0.10, 0.0005, -0.0003, 0.0)),
    "barrel, k3": (420.0, 421.0, 318.0, 241.0, 640, 480, (-0.28, 0.09, 0.0004, -0.0006, -0.012)),
}


def camera_of(values: tuple) -> Camera:
    """A camera of the table."""
    fx, fy, cx, cy, width, height, distortion = values
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    return Camera(matrix=matrix, distortion=np.array(distortion), width_px=width, height_px=height)


def corner_error_px(found: Camera, truth: Camera) -> float:
    """Largest distance in the four corners between both cameras' pixels of one ray, after the best turn.

    A shifted principal point and a turned camera are the same to a first order, and extrinsics take it up.
    """
    u, v = np.meshgrid(np.linspace(0, truth.width_px - 1, 9), np.linspace(0, truth.height_px - 1, 9))
    pixels = np.column_stack([u.ravel(), v.ravel()])
    rays = truth.rays(pixels)

    left = least_squares(residuals, np.zeros(3), args=(found, rays, pixels)).fun.reshape(9, 9, 2)
    return float(np.linalg.norm(left[[0, 0, -1, -1], [0, -1, 0, -1]], axis=1).max())


def residuals(turn: np.ndarray, camera: Camera, rays: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Pixels of turned rays less those of the truth."""
    return np.nan_to_num(camera.project(rays @ Rotation.from_rotvec(turn).as_matrix().T)[0] - pixels, nan=99.0).ravel()


def row(truth: Camera, board: Board, pictures: int, seed: int) -> str:
    """One lens and one board."""
    rng, began = np.random.default_rng(seed), time.process_time()
    poses = board_poses(truth, board, pictures, rng)
    seen = [find_board(render_board(truth, at, board, rng=rng), board, str(i)) for i, at in enumerate(poses)]
    found = calibrate_board([each for each in seen if each is not None], board)
    focal = np.abs(np.diag(found.camera.matrix)[:2] / np.diag(truth.matrix)[:2] - 1).max()
    return (
        f"{len(found.used):3d}/{pictures:<3d} {focal:8.3%} {found.sigma[0] / truth.matrix[0, 0]:8.3%} "
        f"{corner_error_px(found.camera, truth):9.2f} {np.median(found.error_px):7.2f} {found.covered:8.0%} "
        f"{time.process_time() - began:6.1f}"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path)
    parser.add_argument("--pictures", type=int, default=20)
    options = parser.parse_args()
    lines = [header(), "", "Rendered pictures: blur 0.5 px, noise 2 grey values, light that falls off"]
    lines += ["lens                 board       seen     focal    sigma corner px  rms px  covered  CPU s"]
    print("\n".join(lines), flush=True)
    for name, values in progress(LENSES.items(), "lenses"):
        for markers in (False, True):
            text = row(camera_of(values), Board(markers=markers), options.pictures, seed=1)
            lines.append(f"{name:<20} {'ChArUco' if markers else 'chessboard':<10} {text}")
            print(lines[-1], flush=True)
            if options.output:
                options.output.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

"""Pair files that somebody changed: a camera with finite numbers, or an error of ours in words."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from whole import whole_or

from farfield.calibration.camera_pairs import calibrate_pairs, read_pairs, spread_notes
from farfield.calibration.initial_guess import camera_at
from farfield.errors import FarfieldError
from farfield.geometry.cameras import Camera

HEAD = "x_m,y_m,z_m,u_px,v_px"
MATRIX = np.array([[900.0, 0, 640], [0, 900, 360], [0, 0, 1]])
CAMERA = Camera(matrix=MATRIX, camera_T_lidar=camera_at(np.array([0.3, 0.1, -0.2])), width_px=1280, height_px=720)
NASTY = ("0", "-0.0", "1e9", "1e300", "1e-300", "nan", "inf", "-1", "5", "640", "360", "1e5", "0.3", "")


def picks(rng: np.random.Generator, count: int) -> np.ndarray:
    """Points in view of the camera with their pixels, as a hand picks them, shape (count, 5)."""
    points = np.column_stack([rng.uniform(4, 60, count), rng.uniform(-4, 4, count), rng.uniform(-2, 2, count)])
    pixels, _, _ = CAMERA.project(points)
    return np.column_stack([points, pixels + rng.normal(0, 1, pixels.shape)])


def changed(rng: np.random.Generator) -> str:
    """The text of a pair file after one to three slips."""
    table = picks(rng, int(rng.integers(6, 20)))
    for _ in range(int(rng.integers(1, 4))):
        _slip(table, rng)
    rows = [[f"{value:.6g}" for value in row] for row in table]
    if rng.random() < 0.5:
        rows[int(rng.integers(len(rows)))][int(rng.integers(5))] = NASTY[int(rng.integers(len(NASTY)))]
    return "\n".join([HEAD, *(",".join(row) for row in rows)]) + "\n"


def _slip(table: np.ndarray, rng: np.random.Generator) -> None:
    """All points alike, on a line, on a plane, behind the camera, in another unit, shuffled or swapped."""
    kind, column, row = int(rng.integers(14)), int(rng.integers(5)), int(rng.integers(len(table)))
    if kind == 0:
        table[:] = table[0]
    elif kind == 1:
        table[:, :3] = table[0, :3]
    elif kind == 2:
        table[:, 3:] = table[0, 3:]
    elif kind == 3:
        table[:, column] = table[row, column]
    elif kind == 4:
        table[:, :3] = table[0, :3] * np.linspace(1, 3, len(table))[:, None]
    elif kind == 5:
        table[:, 0] *= -1
    elif kind == 6:
        table[:, :3] *= float(10.0 ** rng.integers(-9, 10))
    elif kind == 7:
        table[:, 3:] *= float(10.0 ** rng.integers(-9, 10))
    elif kind == 8:
        table[:, 3:] = rng.permutation(table[:, 3:])
    elif kind == 9:
        table[:, 3:] = table[:, :2:-1]
    elif kind == 10:
        table[:, :3] = 0.0
    elif kind == 11:
        table[:, 3:] = 0.0
    elif kind == 12:
        table[:] = np.round(table, -1)
    else:
        table[row:] = table[row]


def outcome(text: str, path: Path, *, focal: bool, start: bool) -> str:
    """What comes of a file: a camera, ours, or the name of a fault."""
    path.write_text(text)
    try:
        pairs = read_pairs(path)
        result = calibrate_pairs(*pairs, CAMERA, focal=focal, from_nothing=not start)
        spread_notes(*pairs, result.camera)
        tree = result.solution.to_json()
    except FarfieldError:
        return "ours"
    except Exception as error:
        return f"{type(error).__name__}: {error}"[:120]
    numbers = [result.camera.camera_T_lidar, result.camera.matrix, result.solution.sigma, result.residual_px]
    numbers += [[row["value"], row["sigma"]] for row in tree["parameters"].values()]
    good = all(np.isfinite(np.asarray(array)).all() for array in numbers)
    return "camera" if good else "a camera with numbers that are not finite"


def tally(path: Path, count: int, seed: int) -> Counter[str]:
    rng = np.random.default_rng(seed)
    return Counter(
        outcome(changed(rng), path, focal=bool(rng.integers(2)), start=bool(rng.integers(2))) for _ in range(count)
    )


def test_changed_pair_files_give_a_camera_or_words(tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    counts = tally(tmp_path / "picks.csv", 150, 1)
    assert set(counts) == {"camera", "ours"}, counts


@pytest.mark.slow
def test_many_changed_pair_files(tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    counts = tally(tmp_path / "picks.csv", whole_or(3000, 600), 2)
    assert set(counts) == {"camera", "ours"}, counts

"""Odometry of a street whose surfaces and motion are known: poses, deskewing, what is not observed, resuming."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from blocks_of_houses import drive

from farfield.geometry.poses import exponential, logarithm
from farfield.odometry.drift import differences, drift_of
from farfield.odometry.drives import register_sweeps
from farfield.odometry.odometry import OdometrySweep
from farfield.odometry.surface_map import SurfaceMap, smallest_axis, voxel_rows


def _errors(found: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    """Largest errors of place in metres and of direction in degrees."""
    off = np.linalg.inv(true) @ found
    turn = np.degrees(np.linalg.norm(logarithm(off)[:, :3], axis=1))
    return float(np.linalg.norm(off[:, :3, 3], axis=1).max()), float(turn.max())


def test_a_known_motion_is_found_from_its_start() -> None:
    sweeps, true = drive(10)
    placed = register_sweeps(sweeps)
    place_m, turn_deg = _errors(placed.world_T_sensor, true)
    assert place_m < 0.05
    assert turn_deg < 0.15
    assert placed.begins.tolist() == [True] + [False] * 9
    assert not placed.lost.any()
    assert not any(placed.blind)
    # Backwards the same motion is found.
    back = register_sweeps(sweeps[::-1]).world_T_sensor[::-1]
    assert _errors(np.linalg.inv(back[0]) @ back, true)[0] < 0.06


def test_points_are_moved_to_the_sweeps_moment_where_their_times_are_known() -> None:
    sweeps, true = drive(8, skewed=True)
    kept = _errors(register_sweeps(sweeps).world_T_sensor, true)
    left = _errors(register_sweeps([replace(sweep, offset_s=None) for sweep in sweeps]).world_T_sensor, true)
    assert kept[0] < 0.05
    assert kept[0] < left[0] / 2


def test_a_corridor_is_named_as_not_observable_along_it() -> None:
    rng = np.random.default_rng(0)
    sweeps = []
    for number in range(5):
        u, wall = rng.uniform(-1, 1, 8000), rng.integers(0, 4, 8000)
        y = np.where(wall < 2, np.where(wall == 0, -4.0, 4.0), rng.uniform(-4, 4, 8000))
        z = np.where(wall < 2, rng.uniform(-1.7, 2.3, 8000), np.where(wall == 2, -1.7, 2.3))
        points = np.column_stack([60 * np.sign(u) * u**2, y, z]) + rng.normal(0, 0.02, (8000, 3))
        sweeps.append(OdometrySweep(points, 0.1 * number))
    placed = register_sweeps(sweeps)
    assert placed.blind == ("", *["x"] * 4)
    assert np.abs(placed.world_T_sensor[:, 1:3, 3]).max() < 0.02  # across it is observed
    assert np.abs(placed.world_T_sensor[:, 0, 3]).max() < 0.01  # along it nothing is made up


def test_empty_sweeps_are_lost_and_others_go_on() -> None:
    sweeps, true = drive(9)
    sweeps[4] = replace(sweeps[4], points_m=np.zeros((0, 3)))
    placed = register_sweeps(sweeps)
    assert placed.lost.tolist() == [number == 4 for number in range(9)]
    assert _errors(placed.world_T_sensor, true)[0] < 0.1
    nothing = register_sweeps([OdometrySweep(np.zeros((0, 3)), 0.1 * number) for number in range(3)])
    assert nothing.lost.tolist() == [False, True, True]
    assert len(register_sweeps([])) == 0
    np.testing.assert_array_equal(register_sweeps(sweeps[:1]).world_T_sensor, np.eye(4)[None])


def test_after_a_pause_a_new_map_begins() -> None:
    sweeps, _ = drive(6)
    late = [*sweeps[:3], *(replace(sweep, time_s=sweep.time_s + 30) for sweep in sweeps[3:])]
    assert register_sweeps(late).begins.tolist() == [True, False, False, True, False, False]


class _Interrupted:
    """Breaks off when a sweep is read."""

    def __init__(self, sweeps: Sequence[OdometrySweep], at: int) -> None:
        self.sweeps, self.at = sweeps, at

    def __len__(self) -> int:
        return len(self.sweeps)

    def __getitem__(self, index: int, /) -> OdometrySweep:
        if index == self.at:
            raise KeyboardInterrupt
        return self.sweeps[index]


def test_an_interrupted_drive_goes_on_to_the_same_numbers(tmp_path: Path) -> None:
    sweeps, _ = drive(9)
    whole = register_sweeps(sweeps)
    saved = tmp_path / "state.npz"
    with pytest.raises(KeyboardInterrupt):
        register_sweeps(_Interrupted(sweeps, 7), saved=saved, mark="one", every=3)
    assert saved.is_file()
    read = _Interrupted(sweeps, 5)  # sweeps before the saved one are not read again
    resumed = register_sweeps(read, saved=saved, mark="one", every=3)
    for name in ("world_T_sensor", "matched", "residual_m", "information", "lost", "begins"):
        np.testing.assert_array_equal(getattr(resumed, name), getattr(whole, name))
    with pytest.raises(KeyboardInterrupt):  # of another setting, it is not taken up
        register_sweeps(read, saved=saved, mark="another", every=100)
    saved.write_bytes(saved.read_bytes()[:500])  # nor where it is damaged
    with pytest.raises(KeyboardInterrupt):
        register_sweeps(read, saved=saved, mark="one", every=100)


def test_the_smallest_axis_is_that_of_an_eigendecomposition() -> None:
    rng = np.random.default_rng(0)
    spread = rng.normal(size=(500, 8, 3)) * rng.uniform(0.01, 2, (500, 1, 3))
    matrix = spread.transpose(0, 2, 1) @ spread
    least, middle, most, axis = smallest_axis(matrix)
    values, vectors = np.linalg.eigh(matrix)
    np.testing.assert_allclose(np.stack([least, middle, most], 1), values, atol=1e-8 * values.max())
    clear = values[:, 0] < 0.5 * values[:, 1]
    assert clear.sum() > 300
    np.testing.assert_allclose(np.abs((axis * vectors[:, :, 0]).sum(1))[clear], 1, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(smallest_axis(np.zeros((2, 3, 3)))[3], axis=1), 1)


def test_a_map_keeps_a_point_a_voxel_and_forgets_what_is_far() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-20, 20, (5000, 3)) * (1, 1, 0)
    rows = voxel_rows(points, 2.0)
    cells = np.unique(np.floor(points / 2.0), axis=0)
    assert len(rows) <= len(cells)
    assert len(rows) > 0.99 * len(cells)
    surfaces = SurfaceMap(0.5)
    surfaces.insert(points, np.zeros(3), 10.0)
    assert np.linalg.norm(surfaces.mean_m, axis=1).max() < 10
    near, voxels = surfaces.nearest(np.array([[1.0, 1.0, 0.2], [100.0, 0.0, 0.0]]), 1.0)
    assert near.tolist() == [0]
    np.testing.assert_allclose(np.abs(surfaces.normal[voxels[0]]), [0, 0, 1], atol=1e-6)


def _walked(rng: np.random.Generator, sigma: float) -> np.ndarray:
    """A track of 999 steps of a metre in a wide bend, each with an error of its own."""
    scale = np.array([1e-3, 1e-3, 1e-3, 1, 1, 1])
    steps = exponential(np.array([0, 0, 0.001, 1.0, 0, 0]) + sigma * rng.normal(size=(999, 6)) * scale)
    poses = [np.eye(4)]
    for each in steps:
        poses.append(poses[-1] @ each)
    return np.array(poses)


def test_drift_is_told_by_two_tracks_that_err_apart() -> None:
    rng = np.random.default_rng(0)
    true = _walked(rng, 0.0)
    told, real = [], []
    for _ in range(6):
        tracks = _walked(rng, 0.02), _walked(rng, 0.02)
        found = drift_of(*tracks, np.zeros(1000, dtype=bool))
        assert found is not None
        told.append(found.place_m)
        real += [np.sqrt((differences(true, track)[1] ** 2).mean()) for track in tracks]
    assert np.mean(told) == pytest.approx(np.mean(real), rel=0.25)
    assert drift_of(true[:5], true[:5], np.zeros(5, dtype=bool)) is None
    breaks = np.arange(1000) % 50 == 1
    assert drift_of(true, true, breaks) is None  # no stretch of 100 m goes over one

"""A track against known poses: errors that are known by construction."""

import numpy as np
import pytest

from farfield.errors import ConfigError
from farfield.odometry.accuracy import accuracy_json, accuracy_of, aligned


def straight(count: int, step_m: float = 1.0) -> np.ndarray:
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 0, 3] = step_m * np.arange(count)
    return poses


def turned(angle_rad: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(angle_rad), -np.sin(angle_rad)], [np.sin(angle_rad), np.cos(angle_rad)]]
    pose[:3, 3] = [100.0, -50.0, 3.0]
    return pose


def curve(rng: np.random.Generator, count: int = 200) -> np.ndarray:
    poses = [np.eye(4)]
    for _ in range(count - 1):
        step = turned(float(rng.normal(0, 0.05)))
        step[:3, 3] = [1.0, 0.0, float(rng.normal(0, 0.02))]
        poses.append(poses[-1] @ step)
    return np.array(poses)


def test_another_world_is_no_error(rng: np.random.Generator) -> None:
    known = curve(rng)
    accuracy = accuracy_of(turned(2.0) @ known, known)
    assert accuracy.ate_m.most < 1e-9
    assert accuracy.step_m.most < 1e-9
    assert max(one.place_percent for one in accuracy.by_length) < 1e-9


def test_a_scale_of_one_per_cent_is_one_per_cent_of_every_length() -> None:
    known = straight(301)
    accuracy = accuracy_of(straight(301, 1.01), known)
    assert [one.length_m for one in accuracy.by_length] == [10, 25, 50, 100, 200]
    assert [one.place_percent for one in accuracy.by_length] == pytest.approx([1.0] * 5)
    assert accuracy.step_m.mean == pytest.approx(0.01)
    ends = 0.01 * (np.arange(301) - 150)  # about the middle, to which alignment moves it
    assert accuracy.ate_m.rmse == pytest.approx(np.sqrt((ends**2).mean()))
    assert accuracy.ate_m.most == pytest.approx(1.5)


def test_a_step_s_turn_is_told_in_degrees() -> None:
    known = straight(100)
    poses = known.copy()
    poses[50:] = known[50] @ turned_about(np.radians(2.0)) @ np.linalg.inv(known[50]) @ known[50:]
    accuracy = accuracy_of(poses, known)
    assert accuracy.step_deg.most == pytest.approx(2.0)
    assert accuracy.step_deg.median == pytest.approx(0.0, abs=1e-9)


def turned_about(angle_rad: float) -> np.ndarray:
    pose = turned(angle_rad)
    pose[:3, 3] = 0
    return pose


def test_alignment_is_the_best_of_many(rng: np.random.Generator) -> None:
    known = curve(rng, 60)
    noisy = turned(1.0) @ known
    noisy[:, :3, 3] += rng.normal(0, 0.5, (60, 3))
    best = float(((aligned(noisy, known)[:, :3, 3] - known[:, :3, 3]) ** 2).sum())
    for angle in np.linspace(-0.02, 0.02, 5):
        other = turned_about(float(angle)) @ aligned(noisy, known)
        assert float(((other[:, :3, 3] - known[:, :3, 3]) ** 2).sum()) >= best - 1e-9


def test_no_step_goes_over_a_break_and_too_few_are_refused() -> None:
    known, poses = straight(40), straight(40)
    poses[20:, 1, 3] += 5.0
    breaks = np.zeros(40, dtype=bool)
    breaks[[0, 20]] = True
    assert accuracy_of(poses, known, breaks=breaks).step_m.most < 1e-9
    assert accuracy_of(poses, known).step_m.most == pytest.approx(5.0)
    assert "RPE 10 m" in str(accuracy_of(poses, known))
    assert accuracy_json(accuracy_of(poses, known))["ate_m"]["rmse"] > 0
    with pytest.raises(ConfigError, match="expected 3 poses"):
        accuracy_of(poses[:2], known[:2])

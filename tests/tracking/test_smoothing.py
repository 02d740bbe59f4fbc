"""Smoothing: the least squares of a whole track, smaller covariances, gaps, headings, and drives that are simulated."""

import numpy as np
import pytest

from farfield.geometry.boxes import Boxes
from farfield.metrics.detections import Detections
from farfield.tracking.offline import smooth_positions, smooth_tracks


def test_it_is_the_least_squares_of_the_whole_track() -> None:
    rng = np.random.default_rng(0)
    n, variance, white = 15, 0.05, 3.0
    step = np.r_[0.0, rng.uniform(0.05, 0.3, n - 1)]
    seen = np.cumsum(rng.normal(0, 1, (n, 1)), axis=0)
    seen[[4, 5, 9]] = np.nan
    # Unknowns: place and velocity of each frame. The acceleration of a step is one number: whitened rows of two.
    rows, values = [np.eye(2 * n)[1] / 1e3], [0.0]
    for k in range(n):
        if not np.isnan(seen[k, 0]):
            rows.append(np.eye(2 * n)[2 * k] / np.sqrt(variance))
            values.append(seen[k, 0] / np.sqrt(variance))
        if k:
            dt = step[k]
            q = white * np.array([[dt**4 / 4, dt**3 / 2], [dt**3 / 2, dt**2]]) + 1e-10 * np.eye(2)
            move = np.zeros((2, 2 * n))
            move[:, 2 * k - 2 : 2 * k], move[:, 2 * k : 2 * k + 2] = -np.array([[1, dt], [0, 1]]), np.eye(2)
            rows += list(np.linalg.inv(np.linalg.cholesky(q)) @ move)
            values += [0.0, 0.0]
    wanted = np.linalg.lstsq(np.array(rows), np.array(values), rcond=None)[0].reshape(n, 2)
    place, speed, _ = smooth_positions(seen, step, variance, white)
    np.testing.assert_allclose(place[:, 0], wanted[:, 0], atol=1e-4)
    np.testing.assert_allclose(speed[:, 0], wanted[:, 1], atol=1e-3)


def test_errors_and_covariances_fall() -> None:
    rng = np.random.default_rng(1)
    time = np.arange(60) * 0.1
    true = np.column_stack([10 + 8 * time + 0.3 * time**2, 2 * np.sin(0.3 * time)])
    seen = true + rng.normal(0, 0.2, true.shape)
    place, speed, covariance = smooth_positions(seen, np.full(60, 0.1), 0.04, 1.0)
    assert np.sqrt(((place - true) ** 2).mean()) < 0.75 * np.sqrt(((seen - true) ** 2).mean())
    assert (covariance[:, 0] <= 0.04).all()
    assert np.abs(speed[5:-5, 0] - (8 + 0.6 * time[5:-5])).max() < 1.0


def followed(xs: list[float | None], yaws: list[float] | None = None) -> Detections:
    boxes = {}
    for number, x in enumerate(xs):
        there = 0 if x is None else 1
        boxes["a", str(number)] = Boxes(
            centre_m=np.array([[x or 0.0, 0.0, 0.0]])[:there],
            size_m=np.array([[4.0 + 0.1 * (number % 2), 2.0, 1.5]])[:there],
            yaw_rad=np.array([yaws[number] if yaws else 0.0])[:there],
            label=["car"] * there,
            score=np.full(there, 0.5),
            track_id=np.zeros(there, dtype=np.int64),
        )
    return Detections(boxes=boxes, annotations={})


def test_gaps_are_filled_sizes_are_one_and_flips_are_mended() -> None:
    found = followed([10.0, 11.0, None, 13.0, 14.0, 15.0], [0.0, np.pi - 0.01, 0.0, 0.02, 0.01, -0.02])
    result = smooth_tracks(found)
    assert [len(boxes) for boxes in result.boxes.values()] == [1] * 6
    filled = result.boxes["a", "2"]
    assert filled.centre_m[0, 0] == pytest.approx(12.0, abs=0.05)
    assert filled.velocity_m_s is not None
    assert filled.velocity_m_s[0, 0] == pytest.approx(10.0, abs=0.5)
    sizes = np.array([boxes.size_m[0, 0] for boxes in result.boxes.values()])
    np.testing.assert_allclose(sizes, sizes[0])
    assert all(abs(boxes.yaw_rad[0]) < 0.1 for boxes in result.boxes.values())
    apart = smooth_tracks(followed([10.0, *[None] * 15, 11.0]))
    assert sum(map(len, apart.boxes.values())) == 2


def test_a_track_of_one_box_stays() -> None:
    result = smooth_tracks(followed([10.0]))
    assert result.boxes["a", "0"].centre_m.tolist() == [[10.0, 0.0, 0.0]]
    assert np.isnan(result.boxes["a", "0"].velocity_m_s).all()  # type: ignore[arg-type]

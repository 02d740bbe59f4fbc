"""Drivers: the car-following model against its equilibrium, lane changes that keep headway, signals that hold."""

import numpy as np
import pytest

from farfield.simulation.world.motion import STEP_S
from farfield.simulation.world.traffic import DriverSet, Signal, drive

ALONE = np.full((2, 1), -1)


def _drivers(progress: list[float], desired: list[float], lane: list[int], length: float = 4.5) -> DriverSet:
    n = len(progress)
    return DriverSet(
        progress_m=np.array(progress, dtype=float),
        lane=np.array(lane),
        length_m=np.full(n, length),
        desired_m_s=np.array(desired, dtype=float),
        headway_s=np.full(n, 1.8),
        standstill_m=np.full(n, 2.0),
        accelerate_m_s2=np.full(n, 1.0),
        brake_m_s2=np.full(n, 3.0),
        steady=np.zeros(n, dtype=bool),
    )


def test_free_vehicle_keeps_its_desired_speed() -> None:
    path = drive(_drivers([0.0], [30.0], [0]), ALONE, steps=200).progress_m
    np.testing.assert_allclose(np.diff(path[0]), 3.0, rtol=1e-9)


@pytest.mark.parametrize("pace", [8.0, 20.0])
def test_follower_settles_at_the_equilibrium_gap(pace: float) -> None:
    """s_e(v) = (s0 + v T) / sqrt(1 - (v / v0)^4) (Treiber et al., 2000, equation 5): s0 2 m, T 1.8 s, v0 30 m/s."""
    path = drive(_drivers([100.0, 0.0], [pace, 30.0], [0, 0]), ALONE, steps=6000).progress_m
    gap = path[0, -1] - path[1, -1] - 4.5
    assert gap == pytest.approx((2 + pace * 1.8) / np.sqrt(1 - (pace / 30) ** 4), rel=1e-3)
    assert (path[1, -1] - path[1, -2]) / STEP_S == pytest.approx(pace, rel=1e-4)


def test_no_rear_end_collision_even_behind_a_standing_vehicle() -> None:
    path = drive(_drivers([60.0, 20.0, 5.0], [0.01, 30.0, 33.0], [0, 0, 0]), ALONE, steps=600).progress_m
    assert (path[:2] - path[1:] > 4.5 + 0.99).all()
    assert (np.diff(path, axis=1) >= -1e-9).all()


def test_a_fast_vehicle_passes_a_slow_one_on_the_other_lane() -> None:
    beside = np.array([[1, -1], [-1, 0]])  # lane 1 lies to the left of lane 0
    result = drive(_drivers([60.0, 0.0], [15.0, 30.0], [0, 0]), beside, steps=600)
    assert result.progress_m[1, -1] > result.progress_m[0, -1]
    change = result.changes[0]
    assert (change.row, change.before, change.after) == (1, 0, 1)
    speed = np.diff(result.progress_m[1])[change.step] / STEP_S
    assert change.length_m / speed == pytest.approx(3.0, abs=0.6)


def test_nobody_changes_into_an_occupied_place() -> None:
    """A wall of slow vehicles side by side on the left keeps the fast one behind the slow one."""
    beside = np.array([[1, -1], [-1, 0]])
    left = [float(s) for s in range(-200, 600, 8)]
    drivers = _drivers([60.0, 0.0, *left], [8.0, 30.0, *([8.0] * len(left))], [0, 0, *([1] * len(left))])
    assert not any(change.row == 1 for change in drive(drivers, beside, steps=300).changes)


def test_lane_changes_keep_headway_in_both_lanes() -> None:
    """At every moment vehicles that share a lane, old or new, stay a metre apart."""
    rng = np.random.default_rng(5)
    start = np.concatenate([np.cumsum(rng.uniform(14, 60, 25)) for _ in range(3)])
    lane = np.repeat([0, 1, 2], 25)
    drivers = _drivers(start.tolist(), rng.uniform(16, 34, 75).tolist(), lane.tolist())
    result = drive(drivers, np.array([[1, 2, -1], [-1, 0, 1]]), steps=600)
    assert len(result.changes) > 10
    occupied = np.zeros((75, 600, 3), dtype=bool)
    occupied[np.arange(75), :, lane] = True
    for change in result.changes:
        away = result.progress_m[change.row] > change.start_m + change.length_m + 4.5 / 2
        occupied[change.row, change.step :, change.after] = True
        occupied[change.row, away & (np.arange(600) > change.step), change.before] = False
    closest = np.inf
    for step in range(600):
        for each in range(3):
            rows = np.sort(result.progress_m[occupied[:, step, each], step])
            closest = min(closest, float(np.diff(rows).min()) - 4.5)
    assert closest > 0.99


def test_a_red_signal_holds_and_a_green_one_lets_go() -> None:
    signal = Signal(lane=0, progress_m=200.0, shift_s=0.0, period_s=60.0, red_s=40.0)
    path = drive(_drivers([0.0, -15.0], [14.0, 14.0], [0, 0]), ALONE, steps=600, signals=[signal]).progress_m
    front = path[0] + 4.5 / 2
    assert (front[: int(40 / STEP_S)] < 200.0).all()
    assert front[int(39 / STEP_S)] > 190.0
    assert front[-1] > 230.0
    assert (path[0] - path[1] > 4.5 + 0.99).all()

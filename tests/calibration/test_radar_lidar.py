"""Radar to LiDAR on a made-up road: poles, parked and oncoming cars seen by both; a platoon that hides the time."""

from dataclasses import replace

import numpy as np
import pytest

from farfield.calibration.birds_eye_correlation import OccupancyMaps, PoseHypothesis, correlate
from farfield.calibration.radar_features import SensorPair, above_ground_m, find_peaks, find_targets
from farfield.calibration.radar_lidar import (
    _fold_time_offset,
    _least_cost,
    _match_and_solve,
    _search_peaks,
    appraise_radar,
    calibrate_radar,
    frame_matches,
)
from farfield.calibration.radar_matching import PARAMETERS, RadarEvidence, RadarPose
from farfield.errors import ConfigError, DatasetError

TRUTH = RadarPose(x_m=-2.5, y_m=0.4, z_m=0.7, yaw_rad=0.012, frames=1, time_offset_s=0.02)
EGO_M_S = 14.0


def road(rng: np.random.Generator, count: int, *, oncoming: bool = True) -> list[SensorPair]:
    """Thin posts beside the road, standing or coming towards; radar peaks at the true place of the true time."""
    posts = np.column_stack([rng.uniform(0, 160, 90), rng.uniform(-25, 25, 90)])
    speed = np.where((rng.random(90) < 0.4) & oncoming, -28.0, -EGO_M_S)
    sensor_pairs = []
    for number in range(count):
        lidar = _visible(posts + np.outer(speed * number * 0.1, [1, 0]))
        late = (number - TRUTH.frames) * 0.1 + TRUTH.time_offset_s
        echoes = _visible(posts + np.outer(speed * late, [1, 0]))
        cos, sin = np.cos(TRUTH.yaw_rad), np.sin(TRUTH.yaw_rad)
        echoes = echoes @ np.array([[cos, sin], [-sin, cos]]) + [TRUTH.x_m, TRUTH.y_m]
        echoes += rng.normal(0, 0.1, echoes.shape)
        points = np.repeat(lidar, 12, axis=0) + rng.normal(0, 0.02, (12 * len(lidar), 2))
        height = np.tile(np.linspace(-1.5, 0.5, 12), len(lidar))
        sensor_pairs.append(
            SensorPair(
                number=number + 7,
                points_m=np.column_stack([points, height]),
                lag_s=np.zeros(len(points)),
                echoes_m=np.column_stack([echoes, np.zeros(len(echoes))]),
                power_db=rng.uniform(15, 25, len(echoes)),
            )
        )
    return sensor_pairs


def _visible(places: np.ndarray) -> np.ndarray:
    return places[(places[:, 0] > 6) & (places[:, 0] < 65)]


def test_a_rough_start_is_brought_back() -> None:
    evidence = RadarEvidence.of(road(np.random.default_rng(0), 20))
    rng = np.random.default_rng(1)
    for _ in range(3):
        x, y = np.array([TRUTH.x_m, TRUTH.y_m]) + rng.uniform(-2, 2, 2)
        yaw, frames = TRUTH.yaw_rad + np.radians(rng.uniform(-3, 3)), TRUTH.frames + int(rng.integers(-3, 4))
        found = calibrate_radar(evidence, RadarPose(x_m=x, y_m=y, z_m=0.7, yaw_rad=yaw, frames=frames))
        assert found.pose.frames == TRUTH.frames
        error = found.pose.vector - TRUTH.vector
        assert (np.abs(error) < [0.15, 0.06, np.radians(0.1), 0.01]).all()
        assert (np.abs(error) < 3 * found.solution.sigma).all()
        assert found.residual["range_cells"] < 0.4
        assert any("z is not observed" in note for note in found.notes)


def test_a_solution_that_wrong_partners_hold_is_freed() -> None:
    evidence = RadarEvidence.of(road(np.random.default_rng(0), 12))
    guess = replace(TRUTH, time_offset_s=0.0, yaw_rad=0.0)
    turned = replace(TRUTH, yaw_rad=TRUTH.yaw_rad + np.radians(1.1), y_m=TRUTH.y_m - 0.6, time_offset_s=-0.03)
    known = _match_and_solve(evidence, TRUTH.vector, TRUTH.frames, guess, PARAMETERS, (0.8,))
    assert known is not None
    held = turned, known[0], replace(known[1], value=turned.vector)
    pose, _, solution = _search_peaks(evidence, held, guess)
    assert pose.vector == pytest.approx(solution.value)
    assert abs(pose.yaw_rad - TRUTH.yaw_rad) < np.radians(0.1)
    assert abs(pose.y_m - TRUTH.y_m) < 0.06


def test_no_whole_frame_stays_in_the_time_offset() -> None:
    """Radar frame n + 2 at 0.12 s is radar frame n + 1 at 0.02 s: one calibration, named by the nearest frame."""
    evidence = RadarEvidence.of(road(np.random.default_rng(0), 12))
    value = np.add(TRUTH.vector, [0.0, 0.0, 0.0, evidence.period_s])
    guess = replace(TRUTH, time_offset_s=0.0)
    found = _fold_time_offset(evidence, value, TRUTH.frames + 1, guess)
    assert found is not None
    assert found[0].frames == TRUTH.frames
    assert abs(found[0].time_offset_s - TRUTH.time_offset_s) < 0.01
    end = calibrate_radar(evidence, replace(guess, frames=TRUTH.frames + 3))
    assert (end.pose.frames, abs(end.pose.time_offset_s) <= evidence.period_s / 2) == (TRUTH.frames, True)


def test_frame_offsets_are_compared_in_the_frames_that_they_share() -> None:
    full_frame, nan = 90.0, np.nan  # one radar frame has many more peaks, and only the right offset uses it
    right, wrong, alone = [full_frame, 10.0, 11.0, nan], [nan, 12.0, 12.0, 13.0], [nan, nan, nan, 1.0]
    assert np.nanmean(wrong) < np.nanmean(right)
    assert _least_cost(np.array([right, wrong])) == 0
    assert _least_cost(np.array([wrong, right])) == 1
    assert _least_cost(np.array([right, alone])) == 0, "what shares no frame says nothing against it"


def test_a_rough_start_does_not_draw_the_solution() -> None:
    evidence = RadarEvidence.of(road(np.random.default_rng(0), 3))
    ends = []
    for sign in (-1, 1):
        off = replace(TRUTH, y_m=TRUTH.y_m + 2 * sign, yaw_rad=TRUTH.yaw_rad + np.radians(3) * sign, time_offset_s=0.0)
        found = _match_and_solve(evidence, TRUTH.vector, TRUTH.frames, off, PARAMETERS, (0.8, 0.8))
        assert found is not None
        ends.append(found[1].value)
    assert (np.abs(ends[1] - ends[0])[1:3] < [0.001, np.radians(0.01)]).all()


def test_a_platoon_hides_the_time_and_it_is_said() -> None:
    evidence = RadarEvidence.of(road(np.random.default_rng(2), 20, oncoming=False))
    found = calibrate_radar(evidence, RadarPose(x_m=-2.5, y_m=0.4, z_m=0.7, frames=1))
    assert any("cannot be told apart" in note for note in found.notes)
    assert found.solution.sigma[0] > 0.2


def test_maps_find_the_shift() -> None:
    sensor_pairs = road(np.random.default_rng(3), 12)
    best = correlate(OccupancyMaps(sensor_pairs), PoseHypothesis(frames=0, yaw_rad=0.0, x_m=-1.0, y_m=0.0, score=0.0))[
        0
    ]
    assert abs(best.x_m - TRUTH.x_m) < 2.0
    assert abs(best.y_m - TRUTH.y_m) < 0.5


def test_later_starts_find_what_earlier_ones_correlated() -> None:
    maps = OccupancyMaps(road(np.random.default_rng(3), 6))
    first = correlate(maps, PoseHypothesis(frames=0, yaw_rad=0.0, x_m=-1.0, y_m=0.0, score=0.0))
    known = dict(maps.summed)
    again = correlate(maps, PoseHypothesis(frames=0, yaw_rad=0.0, x_m=-1.9, y_m=0.3, score=0.0))
    assert maps.summed == known
    assert again[0].x_m == pytest.approx(first[0].x_m)
    with pytest.raises(ConfigError, match="at most 9 m"):
        correlate(maps, first[0], reach_m=12.0)


def test_targets_have_velocities_and_keep_their_numbers() -> None:
    targets = find_targets(road(np.random.default_rng(4), 8))
    known = np.isfinite(targets[1].velocity[:, 0])
    assert known.mean() > 0.5
    speeds = targets[1].velocity[known, 0] * 10
    assert {-28, -14} <= set(np.round(speeds / 14).astype(int) * 14)
    assert len(set(targets[0].track) & set(targets[1].track)) > 5


def test_peaks_are_placed_within_the_cell() -> None:
    echoes = np.array([[10.0, 0, 0], [10.4, 0, 0], [30.0, 2, 0]])
    moment = SensorPair(
        number=0, points_m=np.zeros((0, 3)), lag_s=np.zeros(0), echoes_m=echoes, power_db=np.array([20.0, 20.0, 15.0])
    )
    np.testing.assert_allclose(np.sort(find_peaks(moment).place_m[:, 0]), [10.2, 30.0])


def test_an_echo_between_two_cells_is_not_drawn_to_one() -> None:
    azimuth = np.radians(np.arange(-4.0, 5.0))
    power = 30 - 12 * ((np.degrees(azimuth) - 0.4) / 1.07) ** 2  # a beam of 1.07 degrees, half way to the next cell
    echoes = 70.0 * np.column_stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth])
    moment = SensorPair(number=0, points_m=np.zeros((0, 3)), lag_s=np.zeros(0), echoes_m=echoes, power_db=power)
    found = find_peaks(moment)
    strongest = found.place_m[np.argmax(found.power_db)]
    assert abs(np.degrees(np.arctan2(strongest[1], strongest[0])) - 0.4) < 0.1


def post(x: float, y: float, width: float = 0.6, top: float = 1.0) -> np.ndarray:
    across, up = np.meshgrid(np.linspace(-width / 2, width / 2, 8), np.linspace(-1.0, top, 8))
    return np.column_stack([np.full(64, x), y + across.ravel(), up.ravel()])


def still(number: int, *bodies: np.ndarray) -> SensorPair:
    points = np.concatenate(bodies)
    return SensorPair(
        number=number,
        points_m=points,
        lag_s=np.zeros(len(points)),
        echoes_m=np.zeros((0, 3)),
        power_db=np.zeros(0),
    )


def test_what_is_half_hidden_is_no_target() -> None:
    before = post(20.0, 0.0, width=1.8)
    hidden = post(40.0, 2.2, width=0.6)  # its right ends where the nearer body's left does, seen from here
    assert len(find_targets([still(0, before, hidden)])[0].place_m) == 1
    low = post(20.0, 0.0, width=1.8, top=-0.5)
    assert len(find_targets([still(0, low, hidden)])[0].place_m) == 2


def test_leading_traffic_is_one_object_in_later_runs() -> None:
    numbers = [*range(6), *range(50, 56)]
    found = find_targets([still(number, post(25.0, 0.5), post(31.0, -2.0)) for number in numbers])
    assert len({int(track) for each in found for track in each.track}) == 2


def test_height_is_above_the_slope() -> None:
    rng = np.random.default_rng(5)
    ground = rng.uniform([0, -20, 0], [60, 20, 0.02], (8000, 3))
    ground[:, 2] += 0.03 * ground[:, 0]
    pole = np.column_stack([np.full(20, 30.5), np.zeros(20), 0.9 + np.linspace(0.5, 2, 20)])
    height = above_ground_m(np.concatenate([ground, pole]))
    assert np.abs(height[:8000]).max() < 0.35
    assert (height[8000:] > 0.4).all()


def test_nothing_in_common_is_an_error() -> None:
    empty = SensorPair(
        number=0, points_m=np.zeros((0, 3)), lag_s=np.zeros(0), echoes_m=np.zeros((0, 3)), power_db=np.zeros(0)
    )
    with pytest.raises(DatasetError, match="both sensors see"):
        calibrate_radar(RadarEvidence.of([empty]), TRUTH)


def test_a_pose_is_appraised_as_it_stands() -> None:
    evidence = RadarEvidence.of(road(np.random.default_rng(0), 20))
    good, pairs = appraise_radar(evidence, TRUTH)
    assert good.pose == TRUTH
    assert good.residual["range_cm"] < 20
    assert len(pairs.track) == len(good.range_m)
    assert (good.solution.sigma[:2] < 0.1).all()
    off = RadarPose(x_m=TRUTH.x_m + 0.6, y_m=TRUTH.y_m, z_m=0.7, yaw_rad=TRUTH.yaw_rad, frames=1, time_offset_s=0.02)
    worse, _ = appraise_radar(evidence, off)
    assert np.median(worse.range_m) == pytest.approx(0.6, abs=0.2)
    lidar, radar = frame_matches(evidence, TRUTH, 12)
    assert len(lidar) > 10
    assert np.median(np.linalg.norm(lidar - radar, axis=1)) < 0.3
    assert len(frame_matches(evidence, TRUTH, 999)[0]) == 0
    with pytest.raises(DatasetError, match="move the cloud nearer"):
        appraise_radar(evidence, RadarPose(x_m=90.0, y_m=60.0, z_m=0.7))


class StopError(Exception):
    pass


def test_progress_grows_and_may_end_the_work() -> None:
    evidence = RadarEvidence.of(road(np.random.default_rng(0), 12))
    shares: list[float] = []
    calibrate_radar(evidence, TRUTH, frames=1, progress=shares.append)
    assert shares == sorted(shares)
    assert shares[0] < 0.1
    assert 0.5 < shares[-1] < 1

    with pytest.raises(StopError):
        calibrate_radar(evidence, TRUTH, progress=_stopped)


def _stopped(share: float) -> None:
    if share > 0.3:
        raise StopError

"""Planted errors of a camera and of a radar are found, none is claimed on correct data, and noise tells nothing."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage
from whole import whole_or

from farfield.calibration.camera_edges import SIGMAS_PX, EdgeViews, camera_difference, move_camera, refine_edges
from farfield.calibration.checking import (
    CLAIMED,
    _is_error,
    check_camera,
    check_radar,
    detectable_errors,
    equivalent_errors,
    frames_needed,
    information_distance,
    mahalanobis,
)
from farfield.calibration.radar_features import LidarTargets, SensorPair
from farfield.calibration.radar_lidar import SYSTEMATIC
from farfield.calibration.radar_matching import RadarEvidence, RadarPose
from farfield.geometry.cameras import Camera

CAMERA = Camera(matrix=np.array([[300.0, 0, 320], [0, 300.0, 180], [0, 0, 1]]), width_px=640, height_px=360)
POSE = RadarPose(x_m=-2.5, y_m=0.4, z_m=0.7)
FRAMES = 8


def marked_views(rng: np.random.Generator, cameras: list[Camera] | None) -> EdgeViews:
    """Points of each frame, and pictures with edges where a camera sees them; anywhere without cameras."""
    points = np.column_stack([rng.uniform(6, 30, 4800), rng.uniform(-20, 20, 4800), rng.uniform(-4, 5, 4800)])
    points = points[CAMERA.project(points)[2]][: 250 * FRAMES]
    frame, axis = np.arange(len(points)) % FRAMES, rng.integers(0, 2, len(points))
    marks = np.zeros((FRAMES, 2, 360, 640))
    for number in range(FRAMES):
        own = frame == number
        where = rng.uniform([0, 0], [639, 359], (int(own.sum()), 2))
        if cameras is not None:
            pixels, _, inside = cameras[number].project(points[own])
            where[inside] = pixels[inside]
        column, row = where.round().astype(int).clip(0, [639, 359]).T
        np.add.at(marks[number], (axis[own], row, column), 1.0)
    marks += rng.random(marks.shape) < 0.002
    levels = []
    for sigma in SIGMAS_PX:
        blurred = ndimage.gaussian_filter(marks, (0, 0, sigma, sigma))
        step = 2 if sigma >= 2 else 1
        levels.append((blurred / blurred.mean(axis=(2, 3), keepdims=True))[:, :, ::step, ::step].astype(np.float16))
    weight = 1.0 / np.bincount(frame)[frame]
    return EdgeViews(points_m=points, frame=frame, axis=axis, weight=weight, levels=tuple(levels))


@pytest.fixture(scope="module")
def steady() -> EdgeViews:
    return marked_views(np.random.default_rng(0), [CAMERA] * FRAMES)


def test_a_correct_camera_is_not_accused(steady: EdgeViews) -> None:
    found = check_camera(CAMERA, steady)
    assert found.verdict == "fits"
    assert not found.claimed
    assert found.degrees < 0.2


@pytest.mark.parametrize("delta", [[0, 0.0175, 0, 0, 0, 0], [0.012, 0, -0.012, 0, 0, 0], [0, 0, 0, 0.2, 0, 0]])
def test_a_planted_error_is_found_and_measured(steady: EdgeViews, delta: list[float]) -> None:
    found = check_camera(move_camera(CAMERA, np.array(delta)), steady)
    assert found.verdict == "off"
    assert found.evidence > 3
    assert found.degrees == pytest.approx(np.degrees(np.abs(delta[:3]).max()), abs=0.25)
    assert found.cm == pytest.approx(100 * np.abs(delta[3:]).max(), abs=8)


def test_a_camera_is_brought_to_what_some_frames_show(steady: EdgeViews) -> None:
    away = move_camera(CAMERA, np.array([0.0, 0.005, 0.0, 0.05, 0.0, 0.1]))
    found = camera_difference(refine_edges(away, steady, sigma=(0.03, 0.03, 0.03, 0.4, 0.4, 0.4)), CAMERA)
    assert np.abs(found[:3]).max() < np.radians(0.05)
    assert np.abs(found[3:]).max() < 0.02


def test_a_camera_that_moved_is_told_from_one_that_is_off() -> None:
    away = move_camera(CAMERA, np.array([0.0, 0.0175, 0, 0, 0, 0]))
    views = marked_views(np.random.default_rng(1), [CAMERA] * (FRAMES // 2) + [away] * (FRAMES // 2))
    found = check_camera(CAMERA, views)
    assert found.verdict == "moved"
    assert found.drift_degrees == pytest.approx(1.0, abs=0.2)


def test_edges_anywhere_tell_nothing() -> None:
    views = marked_views(np.random.default_rng(2), None)
    assert check_camera(CAMERA, views).verdict == "not told"
    assert check_camera(move_camera(CAMERA, np.array([0, 0.02, 0, 0, 0, 0])), views).verdict == "not told"


@pytest.mark.slow
def test_edges_anywhere_seldom_accuse_a_camera() -> None:
    """Of 60 checks of eight frames 12 did when eight were read like twenty.

    Which ones do hangs on the processor's rounding: 1 of these 60 on one machine, 2 on another. Of 180 more, whose
    seeds served for nothing else (100 to 189), 11 did: 6 %, 3 to 11 by the binomial's interval. 6 of 60 or fewer are
    to be expected of that rate 93 times of 100, of the former one (20 %) 3 times of 100.
    """
    claimed = 0
    for seed in range(checks := whole_or(30, 8)):
        views, turned = (
            marked_views(np.random.default_rng(seed), None),
            move_camera(CAMERA, np.array([0, 0.02, 0, 0, 0, 0])),
        )
        claimed += sum(check_camera(each, views).claimed for each in (CAMERA, turned))
    assert claimed <= (6 if checks == 30 else 2)


def test_few_frames_must_show_more() -> None:
    assert equivalent_errors(3.0, 20) == equivalent_errors(3.0, 100) == 3.0
    # Student's t: 3 of 19 degrees of freedom are as rare (0.37 %) as 3.73 of 7
    assert equivalent_errors(3.0, 8) == pytest.approx(3.73, abs=0.01)
    assert equivalent_errors(6.0, 6) > equivalent_errors(6.0, 8) > equivalent_errors(6.0, 19) > 6.0


def road(rng: np.random.Generator, turn_late: float = 0.0) -> RadarEvidence:
    """Posts, some of them coming towards, as LiDAR and radar see them; the radar turns half way if asked."""
    posts = np.column_stack([rng.uniform(0, 120, 70), rng.uniform(-25, 25, 70)])
    speed, sensor_pairs = np.where(rng.random(70) < 0.4, -28.0, -14.0), []
    for number in range(16):
        there = posts + np.outer(speed * number * 0.1, [1, 0])
        there = there[(there[:, 0] > 6) & (there[:, 0] < 65)]
        yaw = turn_late if number >= 8 else 0.0
        turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
        echoes = there @ turn + [POSE.x_m, POSE.y_m] + rng.normal(0, 0.1, there.shape)
        points = np.repeat(there, 12, axis=0) + rng.normal(0, 0.02, (12 * len(there), 2))
        heights = np.tile(np.linspace(-1.5, 0.5, 12), len(there))
        sensor_pairs.append(
            SensorPair(
                number=number,
                points_m=np.column_stack([points, heights]),
                lag_s=np.zeros(len(points)),
                echoes_m=np.column_stack([echoes, np.zeros(len(echoes))]),
                power_db=rng.uniform(15, 25, len(echoes)),
            )
        )
    return RadarEvidence.of(sensor_pairs)


def test_a_radars_errors_are_found() -> None:
    evidence = road(np.random.default_rng(3))
    assert check_radar(POSE, evidence, least=8).verdict == "fits"
    turned = check_radar(replace(POSE, yaw_rad=np.radians(1.0)), evidence, least=8)
    assert turned.verdict == "off"
    assert turned.degrees == pytest.approx(1.0, abs=0.2)
    aside = check_radar(replace(POSE, y_m=POSE.y_m - 0.3), evidence, least=8)
    assert aside.verdict == "off"
    assert aside.cm == pytest.approx(30, abs=8)


def test_few_frames_of_a_radar_are_not_judged() -> None:
    found = check_radar(replace(POSE, yaw_rad=np.radians(3.0)), road(np.random.default_rng(3)))
    assert found.verdict == "not told"
    assert found.needed >= 80


def test_a_dozen_objects_do_not_say_that_a_radar_fits() -> None:
    """Behind a truck that stays ahead: the same few objects in many frames."""
    evidence = road(np.random.default_rng(3))
    first = set(np.unique(np.concatenate([each.track for each in evidence.targets.values()]))[:12].tolist())
    few = {number: _only(each, first) for number, each in evidence.targets.items()}
    assert check_radar(POSE, evidence, least=8).verdict == "fits"
    assert check_radar(POSE, replace(evidence, targets=few), least=8).verdict == "not told"


def _only(targets: LidarTargets, tracks: set[int]) -> LidarTargets:
    kept = np.isin(targets.track, list(tracks))
    return LidarTargets(**{name: values[kept] for name, values in vars(targets).items()})


def test_a_radar_that_turned_during_the_drive_is_found() -> None:
    evidence = road(np.random.default_rng(4), turn_late=np.radians(2.0))
    found = check_radar(replace(POSE, yaw_rad=0.0), evidence, least=8)
    assert found.claimed


def test_too_little_tells_nothing(steady: EdgeViews) -> None:
    few = replace(steady, levels=tuple(level[:4] for level in steady.levels))
    assert check_camera(CAMERA, few).verdict == "not told"
    evidence = road(np.random.default_rng(5))
    assert check_radar(POSE, replace(evidence, peaks={})).verdict == "not told"


# What a check of a radar would find: y and yaw that err against each other, and how many frames it would take

AHEAD_M = 30.0


def covariance(aside_m: float, turn_rad: float) -> np.ndarray:
    """x and the place aside of objects 30 m ahead known to ``aside_m``, the turn about them to ``turn_rad``."""
    turns = np.array([[1, 0, 0], [0, 1, -AHEAD_M], [0, 0, 1.0]])
    return np.asarray(turns @ np.diag([aside_m**2, aside_m**2, turn_rad**2]) @ turns.T)


def test_a_shift_shows_where_the_objects_stand() -> None:
    known = covariance(0.03, np.radians(0.4))
    assert np.sqrt(known[1, 1]) > 0.2  # y alone would tell nothing
    assert mahalanobis(np.array([0.0, 0.2, 0.0]), known) > CLAIMED
    assert mahalanobis(np.array([0.0, -0.2, 0.2 / AHEAD_M]), known) < 1.0  # at the objects nothing moved
    assert detectable_errors(known).shift_m < 0.2


def test_what_is_found_lies_beyond_what_is_claimed() -> None:
    known = covariance(0.05, np.radians(0.2))
    found = detectable_errors(known)
    for away in np.linspace(0, 2 * np.pi, 12):
        change = found.shift_m * np.array([np.cos(away), np.sin(away), 0.0])
        assert mahalanobis(change, known) > CLAIMED + 1.6
    assert mahalanobis(np.array([0, 0, found.turn_rad]), known) > CLAIMED + 1.6


def test_more_frames_tell_what_few_do_not() -> None:
    systematic = np.diag(SYSTEMATIC[:3] ** 2)
    few = covariance(0.12, np.radians(0.5))
    assert not detectable_errors(systematic + few).enough
    needed = frames_needed(systematic + few, 24, systematic)
    assert needed > 24
    assert detectable_errors(systematic + few * 24 / needed).enough
    assert not detectable_errors(systematic + few * 24 / (needed - 1)).enough


def test_no_number_of_frames_undoes_what_is_systematic(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("farfield.calibration.checking.ASKED_M", 0.1)
    systematic = np.diag(SYSTEMATIC[:3] ** 2)
    assert frames_needed(systematic + covariance(0.1, np.radians(0.4)), 24, systematic) == 0


def test_a_shift_between_the_axes_is_as_large_as_along_one() -> None:
    """10 cm at 45 degrees are 7 along each axis, where 8 are no error: no less an error than 10 along one."""
    assert _is_error(np.array([0.07, 0.07, 0.0]), 1.0)
    assert not _is_error(np.array([0.05, 0.05, 0.0]), 1.0)
    assert _is_error(np.array([0.0, 0.0, np.radians(-0.4)]), 1.0)
    assert not _is_error(np.array([0.0, 0.0, np.radians(-0.4)]), 1.5)


# Normalised information distance on a drawn wall: least at the truth, one where nothing is in common

WALL_CAMERA = Camera(matrix=np.array([[300.0, 0, 160], [0, 300.0, 120], [0, 0, 1]]), width_px=320, height_px=240)


def wall(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A picture of 12-pixel patches, points on them, and the patches' grey seen by the LiDAR, squared and noisy."""
    grey = np.kron(rng.uniform(20, 235, (20, 27)), np.ones((12, 12)))[:, :320]
    pixels = rng.uniform([1, 1], [318, 238], (6000, 2))
    points = 20.0 * WALL_CAMERA.rays(pixels)
    column, row = np.floor(pixels).astype(int).T
    return grey.astype(np.uint8)[..., None].repeat(3, 2), points, grey[row, column] ** 2 + rng.normal(0, 30, 6000)


def test_it_is_least_at_the_truth() -> None:
    frames = [wall(np.random.default_rng(seed)) for seed in range(3)]
    columns = [list(each) for each in zip(*frames, strict=True)]
    right = information_distance(WALL_CAMERA, *columns)
    for turn in ([0.5, 0, 0], [-0.5, 0, 0], [0, 0.5, 0], [0, -0.5, 0]):
        assert (
            information_distance(move_camera(WALL_CAMERA, np.array([*np.radians(turn), 0, 0, 0])), *columns)
            > right + 0.01
        )


def test_nothing_in_common_is_one() -> None:
    picture, points, strength = wall(np.random.default_rng(0))
    assert information_distance(WALL_CAMERA, [picture], [-points], [strength]) == 1.0
    shuffled = np.random.default_rng(1).permutation(strength)
    assert information_distance(WALL_CAMERA, [picture], [points], [shuffled]) > 0.95

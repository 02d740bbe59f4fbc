"""Radial velocities: the plain filter of matrices, known answers, the ambiguity, and what they gain at long range."""

import numpy as np
import pytest

from farfield.errors import ConfigError
from farfield.frame.drive import Drive
from farfield.geometry.boxes import Boxes
from farfield.geometry.poses import pose_from_yaw
from farfield.metrics.detections import Detections
from farfield.tracking import TrackerSettings, track
from farfield.tracking.kalman import Tracks, covariance, radial_gaps, update_doppler
from farfield.tracking.tracker import DetectionBatch, TrackEngine

SPAN = 3.865
RADAR = TrackerSettings(
    range_sigma_m=0.3, azimuth_sigma_rad=np.radians(0.5), acceleration=1.0, gate=50.0, gate_sigmas=None, sure_score=None
)


def seen(place: np.ndarray, radial: np.ndarray | None, sensor: np.ndarray | None = None) -> DetectionBatch:
    """One detection a drive."""
    n = len(place)
    unit = np.column_stack([place / np.hypot(*place.T)[:, None], np.zeros(n)])
    moving = np.zeros((n, 3)) if sensor is None else sensor
    return DetectionBatch(
        drive=np.arange(n),
        boxes=np.column_stack([place, np.tile([0, 4, 2, 1.5, 0], (n, 1))]).astype(float),
        velocity_m_s=np.zeros((n, 2)),
        ray_m=place,
        score=np.ones(n),
        label=np.zeros(n, dtype=np.int64),
        source=np.arange(n),
        radial=None if radial is None else np.column_stack([unit, moving, radial]),
    )


def born(places: np.ndarray, settings: TrackerSettings = RADAR, *, doppler: np.ndarray | None = None) -> Tracks:
    engine = TrackEngine(settings, drives=len(places), labels=("car",), doppler=doppler is not None)
    engine.step(seen(places, doppler), np.full(len(places), 0.1), np.ones(len(places), dtype=bool))
    return engine.tracks


def test_the_coupled_filter_is_that_of_plain_matrices() -> None:
    rng = np.random.default_rng(0)
    settings, dt = RADAR.changed(initial_variance=0.5), 0.1
    engine = TrackEngine(settings, drives=1, labels=("car",), doppler=True)
    move = np.kron(np.eye(2), np.array([[1, dt], [0, 1]]))
    noise = np.kron(np.eye(2), settings.acceleration * np.array([[dt**4 / 4, dt**3 / 2], [dt**3 / 2, dt**2]]))
    state, p = np.zeros(4), np.diag([0.5, 100.0, 0.5, 100.0])
    for number in range(12):
        place = np.array([60 + 1.5 * number, 30 - 0.7 * number]) + rng.normal(0, 0.3, 2)
        speed = rng.normal(9, 0.1)
        shown = engine.step(seen(place[None], np.array([speed])), np.array([dt]), np.ones(1, dtype=bool))
        r = np.hypot(*place)
        u = place / r
        if number:
            state, p = move @ state, move @ p @ move.T + noise
            h = np.eye(4)[[0, 2]]
            turn = np.column_stack([u, [-u[1], u[0]]])
            polar = turn @ np.diag([0.3**2, (r * np.radians(0.5)) ** 2]) @ turn.T
            gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + polar)
            state, p = state + gain @ (place - h @ state), p - gain @ h @ p
        else:
            state = np.array([place[0], 0, place[1], 0])
        v = state[[1, 3]]
        row = np.empty(4)
        row[[0, 2]], row[[1, 3]] = (v - u * (u @ v)) / r, u
        gain = p @ row / (row @ p @ row + 0.01)
        state, p = state + gain * (speed - u @ v), p - np.outer(gain, row @ p)
        tracks = engine.tracks
        np.testing.assert_allclose(
            np.r_[tracks.position_m[0, :2], tracks.velocity[0, :2]], state[[0, 2, 1, 3]], atol=1e-8
        )
        np.testing.assert_allclose(covariance(tracks, np.array([0]))[0], p, atol=1e-8)
        assert len(shown) == 1


def test_one_measurement_gives_the_radial_velocity_and_leaves_the_other() -> None:
    tracks = born(np.array([[100.0, 0.0], [0.0, 80.0]]), doppler=np.array([-7.0, 5.0]))
    np.testing.assert_allclose(tracks.velocity[:, :2], [[-7, 0], [0, 5]], atol=1e-2)
    sure = 1 / (1 / 100 + 1 / 0.01)
    np.testing.assert_allclose(tracks.velocity_var[:, :2], [[sure, 100], [100, sure]], rtol=1e-6)
    unknown = born(np.array([[100.0, 0.0]]), doppler=np.array([np.nan]))
    assert unknown.velocity_var[0, 0] == 100


def test_the_sensors_own_velocity_is_taken_off() -> None:
    tracks = born(np.array([[100.0, 0.0]]))
    radial = np.array([[1.0, 0, 0, 20, 0, 0, -20]])
    update_doppler(tracks, np.array([0]), radial, np.array([100.0]), sigma_m_s=0.1)
    assert tracks.velocity[0, 0] == pytest.approx(0.0, abs=1e-9)


def test_innovations_are_wrapped_and_unsure_tracks_take_nothing() -> None:
    tracks, one, at = born(np.array([[100.0, 0.0]])), np.array([0]), np.array([100.0])
    wrapped = (10.3 + SPAN / 2) % SPAN - SPAN / 2
    radial = np.array([[1.0, 0, 0, 0, 0, 0, wrapped]])
    update_doppler(tracks, one, radial, at, sigma_m_s=0.1, span_m_s=SPAN)
    assert tracks.velocity[0, 0] == 0.0
    tracks.velocity[0, 0], tracks.velocity_var[0] = 9.6, 0.5
    update_doppler(tracks, one, radial, at, sigma_m_s=0.1, span_m_s=SPAN)
    assert tracks.velocity[0, 0] == pytest.approx(10.3, abs=0.05)
    # Half a span away counts upwards: the innovation lies in (-span/2, span/2].
    tracks.velocity[0, 0], tracks.velocity_var[0] = 0.0, 0.5
    update_doppler(tracks, one, np.array([[1.0, 0, 0, 0, 0, 0, -SPAN / 2]]), at, sigma_m_s=0.1, span_m_s=SPAN)
    assert tracks.velocity[0, 0] > 1.8


def velocity_errors(*, doppler: bool, trials: int = 400, updates: int = 20) -> np.ndarray:
    """Rms error of the velocity along the road after each update, targets at 60 to 240 m."""
    rng = np.random.default_rng(1)
    place = np.column_stack([rng.uniform(60, 240, trials), rng.uniform(-10, 10, trials)])
    speed = np.column_stack([rng.normal(0, 15, trials), rng.normal(0, 1, trials)])
    settings = RADAR.changed(initial_variance=0.3, initial_speed_variance=225.0, across_speed_m_s=3.0)
    engine = TrackEngine(settings, drives=trials, labels=("car",), doppler=doppler)
    errors = []
    for _ in range(updates):
        unit = place / np.hypot(*place.T)[:, None]
        across = np.column_stack([-unit[:, 1], unit[:, 0]])
        sideways = rng.normal(0, np.radians(0.5), (trials, 1)) * np.hypot(*place.T)[:, None]
        measured = place + rng.normal(0, 0.3, (trials, 1)) * unit + sideways * across
        radial = (unit * speed).sum(axis=1) + rng.normal(0, 0.1, trials)
        engine.step(seen(measured, radial if doppler else None), np.full(trials, 0.1), np.ones(trials, dtype=bool))
        assert len(engine.tracks) == trials
        errors.append(np.sqrt(np.mean((engine.tracks.velocity[:, 0] - speed[:, 0]) ** 2)))
        place = place + 0.1 * speed
    return np.array(errors)


def test_velocities_are_known_at_once_at_long_range() -> None:
    without, with_it = velocity_errors(doppler=False), velocity_errors(doppler=True)
    assert without[0] > 10
    assert without[2] > 1.5
    assert with_it[0] < 0.3
    assert (with_it[2:] <= 0.2).all()
    assert (with_it < without).all()


def test_a_standing_car_seen_by_a_moving_radar_stands() -> None:
    """Through :func:`track`: poses give the sensor's velocity, the details the radial one."""
    n, ego = 8, 2.0 * np.arange(8)
    boxes, details = {}, {}
    for number, x in enumerate(80 - ego):
        key = ("a", str(number))
        boxes[key] = Boxes(
            centre_m=np.array([[x, 0.0, 0.0]]),
            size_m=np.array([[4.0, 2.0, 1.5]]),
            yaw_rad=np.zeros(1),
            label="car",
            score=np.ones(1),
        )
        details[key] = {"doppler_m_s": np.array([-20.0]), "doppler_ray": np.array([[2.0, 0.0, 0.0]])}
    poses = np.stack([pose_from_yaw(0.0)] * n)
    poses[:, 0, 3] = ego
    drive = Drive(
        name="a",
        indices=np.arange(n),
        keys=tuple(boxes),
        times_ns=np.arange(n) * 100_000_000,
        world_T_frame=poses,
    )
    found = Detections(boxes=boxes, annotations={}, drives=(drive,), prediction_details=details)
    for part in track(found).boxes.values():
        assert part.velocity_m_s is not None
        np.testing.assert_allclose(part.velocity_m_s[:, :2], 0.0, atol=1e-6)
    bad = {key: {"doppler_m_s": np.zeros(3)} for key in boxes}
    with pytest.raises(ConfigError, match=r"doppler_m_s of predictions: expected shape \(1,\), got \(3,\)"):
        track(Detections(boxes=boxes, annotations={}, prediction_details=bad))


def test_pairs_of_other_radial_velocities_are_not_taken() -> None:
    """Two cars pass each other 150 m away, 1.5 m apart: their places alone do not tell them from each other."""
    settings = {
        "range_sigma_m": 0.3,
        "azimuth_sigma_rad": float(np.radians(0.5)),
        "min_hits": 1,
        "across_speed_m_s": 3.0,
    }
    switched = []
    for with_doppler in (True, False):
        rng = np.random.default_rng(3)
        boxes, details = {}, {}
        for frame in range(30):
            x = np.array([135.0 + frame, 165.0 - frame])
            place = np.column_stack([x, [0.0, 1.5], [0, 0]]) + np.column_stack(
                [rng.normal(0, 0.3, 2), rng.normal(0, 1.3, 2), np.zeros(2)]
            )
            key = ("a", f"{frame:03d}")
            boxes[key] = Boxes(
                centre_m=place, size_m=np.tile([4, 2, 1.5], (2, 1)), yaw_rad=np.zeros(2), label="car", score=np.ones(2)
            )
            details[key] = {"doppler_m_s": np.array([10.0, -10.0])} if with_doppler else {}
        followed = track(Detections(boxes=boxes, annotations={}, prediction_details=details), **settings)
        ids = [tuple(part.track_id[np.argsort(part.velocity_m_s[:, 0])].tolist()) for part in followed.boxes.values()]
        whole = [each for each in ids if len(each) == 2]
        switched.append(len(whole) < 30 or len({*whole[3:]}) > 1)
    assert switched[0] is False


def test_radial_gaps_are_wrapped_and_unknown_ones_pass() -> None:
    engine = TrackEngine(RADAR, drives=3, labels=("car",), doppler=True)
    place = np.array([[100.0, 0], [100, 0], [100, 0]])
    engine.step(seen(place, np.array([5.0, 5.0, 5.0])), np.zeros(3), np.ones(3, dtype=bool))
    tracks, rows = engine.tracks, np.arange(3)
    tracks.velocity_var[:] = 0.01
    radial = np.column_stack([np.tile([1.0, 0, 0, 0, 0, 0], (3, 1)), [5.0, 5.0 + SPAN, np.nan]])
    plain = radial_gaps(tracks, radial, rows, rows, sigma_m_s=0.1)
    assert plain[0] == pytest.approx(0.0, abs=0.5)
    assert plain[1] > 20
    assert plain[2] == 0.0
    wrapped = radial_gaps(tracks, radial, rows, rows, sigma_m_s=0.1, span_m_s=SPAN)
    assert wrapped[1] == pytest.approx(plain[0], abs=1e-6)
    tracks.velocity_var[:] = 100.0
    assert (radial_gaps(tracks, radial, rows, rows, sigma_m_s=0.1, span_m_s=SPAN) == 0).all()

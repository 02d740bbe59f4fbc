"""Frames: what they carry, that they repeat to the byte, and that boxes and points agree."""

from concurrent.futures import ProcessPoolExecutor
from functools import cache
from multiprocessing import get_context

import numpy as np
import pytest

from farfield.errors import ConfigError
from farfield.frame import Frame
from farfield.geometry.boxes import count_points_in_boxes
from farfield.geometry.iou import pairwise_iou
from farfield.geometry.poses import transform_points
from farfield.simulation import find_preset, simulate_frame, simulate_sequence
from farfield.simulation.bodies.actors import CLASSES
from farfield.simulation.frozen import frame_record
from farfield.simulation.labels import MARGIN_M
from farfield.simulation.rigs.drive import drive_of

SHORT = find_preset("cirrus-sim-ideal", duration_s=8.0)


@cache
def _frame(sequence: int, index: int) -> Frame:
    return simulate_frame(SHORT, seed=12, sequence=sequence, index=index)


@pytest.fixture(scope="module", params=[0, 1], ids=["highway", "urban"])
def frame(request: pytest.FixtureRequest) -> Frame:
    return _frame(request.param, 3)


def test_frame_carries_what_it_promises(frame: Frame) -> None:
    assert set(frame.clouds) == {"gaussian", "uniform"}
    assert frame.frame_id == str(frame.time_ns) == str(frame.sensors["gaussian"].time_ns)
    assert "camera" in frame.images
    assert len(frame.frame_id) == 19
    assert frame.conditions["weather"] == "normal"
    assert frame.conditions["road"] == ("highway" if frame.sequence.endswith("00") else "urban")
    assert frame.annotation.extent == "visible"
    for cloud in frame.clouds.values():
        assert cloud.points_m.dtype == cloud.intensity.dtype == np.float32
        assert 20_000 < len(cloud) < 60_032
        assert cloud.intensity.min() >= 0
        assert cloud.intensity.max() <= 1
        ranges = np.linalg.norm(cloud.points_m, axis=1)
        assert 150 < ranges.max() < 351
        assert set(np.unique(cloud.extra["ring"])) <= set(range(64))
    assert frame.boxes is not None
    assert len(frame.boxes) >= 5
    assert set(frame.boxes.label) <= set(CLASSES)


def test_ground_lies_two_metres_below_the_sensor(frame: Frame) -> None:
    points = frame.clouds["gaussian"].points_m
    near = points[(np.abs(points[:, 1]) < 1.2) & (points[:, 0] < 14) & (points[:, 2] < -1.0)]
    assert len(near) > 50
    assert np.median(near[:, 2]) == pytest.approx(-2.0, abs=0.2)


def _standing(frame: Frame) -> set[int]:
    """Road users of a frame that are at the same place of the world half a second later."""
    later = _frame(int(frame.sequence[-2:]), 4)
    places = []
    for each in (frame, later):
        full = each.annotation.full_boxes
        places.append(dict(zip(full.track_id, transform_points(each.world_T_frame, full.centre_m), strict=True)))
    return {
        track
        for track in places[0].keys() & places[1].keys()
        if np.linalg.norm(places[0][track] - places[1][track]) < 0.05
    }


def test_boxes_hold_the_points_they_count(frame: Frame) -> None:
    """Boxes hold the hits counted on their bodies (others may stray in): all where nothing moves during a sweep.

    Labels stand where the Gaussian points show a road user; the uniform sweep met it a few hundredths later or earlier.
    """
    boxes = frame.boxes
    assert boxes is not None
    still = _standing(frame)
    for name, share in (("gaussian", 0.9), ("uniform", 0.75)):
        counted = frame.annotation.details[f"point_count_{name}"]
        inside = count_points_in_boxes(frame.clouds[name].points_m, boxes, margin_m=0.01)
        assert np.minimum(inside, counted).sum() >= share * counted.sum()
        standing = np.array([track in still for track in boxes.track_id], dtype=bool)
        assert (inside >= np.floor(0.95 * counted) - 1)[standing].all()
    both = frame.annotation.details["point_count_gaussian"] + frame.annotation.details["point_count_uniform"]
    assert (both >= 5).all()
    assert (frame.annotation.details["point_count_gaussian"] >= 3).all()


def test_visible_boxes_lie_within_full_ones(frame: Frame) -> None:
    boxes, full = frame.boxes, frame.annotation.full_boxes
    assert boxes is not None
    np.testing.assert_array_equal(boxes.track_id, full.track_id)
    np.testing.assert_array_equal(boxes.yaw_rad, full.yaw_rad)
    assert (boxes.size_m <= full.size_m + 2 * MARGIN_M + 1e-9).all()
    cos, sin = np.cos(full.yaw_rad), np.sin(full.yaw_rad)
    offset = boxes.centre_m - full.centre_m
    local = np.stack(
        [offset[:, 0] * cos + offset[:, 1] * sin, offset[:, 1] * cos - offset[:, 0] * sin, offset[:, 2]], 1
    )
    assert (np.abs(local) + boxes.size_m / 2 <= full.size_m / 2 + MARGIN_M + 1e-9).all()
    assert np.prod(boxes.size_m, axis=1).sum() < 0.95 * np.prod(full.size_m, axis=1).sum()


def test_full_boxes_do_not_overlap_and_stand_on_the_road(frame: Frame) -> None:
    full = frame.annotation.full_boxes
    iou = pairwise_iou(full, full, kind="bev")
    np.fill_diagonal(iou, 0)
    assert iou.max() < 1e-6
    near = full.range_m < 40
    bottom = full.centre_m[near, 2] - full.size_m[near, 2] / 2
    np.testing.assert_allclose(bottom, -2.0, atol=0.5)


def test_gaussian_pattern_sees_more_of_far_objects(frame: Frame) -> None:
    assert frame.boxes is not None
    far = frame.boxes.range_m > 60
    gaussian, uniform = (frame.annotation.details[f"point_count_{name}"][far].sum() for name in ("gaussian", "uniform"))
    assert 1.6 < gaussian / uniform < 3.2  # lines are 2.4 times as dense at the focus, less off it


def _record(index: int) -> str:
    return frame_record(simulate_frame(SHORT, seed=11, sequence=1, index=index)).digest


def test_frames_repeat_in_any_order_and_in_other_processes() -> None:
    forward = [_record(index) for index in (0, 4)]
    drive_of.cache_clear()
    backward = [_record(index) for index in (4, 0)][::-1]
    assert forward == backward
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        assert pool.submit(_record, 4).result() == forward[1]
    assert len(set(forward)) == 2


def test_seed_and_sequence_make_other_worlds() -> None:
    frames = [
        simulate_frame("cirrus-sim-mini", seed=seed, sequence=sequence, index=0)
        for seed, sequence in ((0, 0), (0, 2), (1, 0))
    ]
    assert len({len(frame.clouds["gaussian"]) for frame in frames}) == 3
    assert len({frame.frame_id for frame in frames}) == 3


def test_tracks_persist_and_move() -> None:
    first, second = _frame(0, 3), _frame(0, 4)
    assert [each.key for each in simulate_sequence(SHORT, seed=12, sequence=0, frames=2, start=3)] == [
        first.key,
        second.key,
    ]
    assert first.boxes is not None
    assert second.boxes is not None
    shared = set(first.boxes.track_id) & set(second.boxes.track_id)
    assert len(shared) >= 5
    assert second.time_ns - first.time_ns == 500_000_000
    moved = second.world_T_frame[:3, 3] - first.world_T_frame[:3, 3]
    assert 0.2 < np.linalg.norm(moved) < 25


def test_a_later_uniform_sweep_sees_moving_bodies_elsewhere() -> None:
    """With 80 ms between the sweeps oncoming traffic leaves its boxes; with none it fills them."""
    inside = {}
    for offset in (0.0, 80.0):
        later = find_preset("cirrus-sim-highway", duration_s=8.0, uniform_offset_ms=(offset, offset))
        frame = simulate_frame(later, seed=11, sequence=3, index=3)
        full = frame.annotation.full_boxes
        oncoming = full[np.cos(full.yaw_rad) < 0]
        assert len(oncoming) >= 3
        assert frame.sensors["uniform"].time_ns - frame.sensors["gaussian"].time_ns == offset * 1e6
        counted = frame.annotation.details["point_count_uniform"][np.cos(full.yaw_rad) < 0].sum()
        held = count_points_in_boxes(frame.clouds["uniform"].points_m, oncoming, margin_m=0.05).sum()
        inside[offset] = held / counted
    assert inside[0.0] > 0.85  # a sweep takes 0.1 s itself
    assert inside[80.0] < 0.8 * inside[0.0]


def test_frames_beyond_the_sequence_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"within 0..8 s, got sequence 0, frame 17 at 8.5 s"):
        simulate_frame(SHORT, sequence=0, index=17)
    with pytest.raises(ConfigError, match="expected one of cirrus-sim"):
        find_preset("nowhere")


def test_returned_elevations_are_bell_shaped_like_real_ones() -> None:
    """Real sister-sensor frames: 0.31-0.32, 0.68-0.70, 0.95-0.96 of all points; open sky thins the upper lines."""
    shares = []
    for sequence in range(4):
        points = simulate_frame(SHORT, seed=3, sequence=sequence, index=0).clouds["gaussian"].points_m
        elevation = np.degrees(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])))
        shares.append([np.mean(np.abs(elevation + 2) < reach) for reach in (2, 5, 10)])
    off = np.abs(np.mean(shares, axis=0) - [0.315, 0.69, 0.955])
    assert (off < [0.07, 0.07, 0.03]).all()

"""Boxes: validation, selection, joining, rigid motion."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.geometry.boxes import Boxes, wrap_angle_rad
from farfield.geometry.poses import invert, pose, pose_from_yaw, rotation_from_quaternion, transform_points


def random_boxes(rng: np.random.Generator, n: int) -> Boxes:
    return Boxes(
        centre_m=rng.uniform(-250, 250, (n, 3)),
        size_m=rng.uniform(0.2, 20, (n, 3)),
        yaw_rad=rng.uniform(-10, 10, n),
        label=rng.choice(["vehicle", "pedestrian"], n),
        score=rng.random(n),
        track_id=np.arange(n),
        point_count=rng.integers(0, 100, n),
    )


def one(**changes: object) -> Boxes:
    values: dict[str, object] = {"centre_m": np.zeros((1, 3)), "size_m": np.ones((1, 3)), "yaw_rad": np.zeros(1)}
    return Boxes(**{**values, **changes})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"centre_m": np.zeros((1, 2))}, r"centre_m: expected shape \(1, 3\), got \(1, 2\)"),
        ({"yaw_rad": np.zeros(2)}, r"centre_m: expected shape \(2, 3\)"),
        ({"size_m": np.array([[1.0, 0.0, 1.0]])}, r"size_m: expected positive sizes, got .* in row 0"),
        ({"size_m": np.array([[1.0, -2.0, 1.0]])}, "size_m: expected positive"),
        ({"centre_m": np.array([[0.0, np.nan, 0.0]])}, "centre_m: expected finite numbers.*row 0"),
        ({"size_m": np.array([[1.0, np.inf, 1.0]])}, "size_m: expected finite"),
        ({"yaw_rad": np.array([np.nan])}, "yaw_rad: expected finite"),
        ({"score": np.array([np.nan])}, "score: expected finite"),
        ({"score": np.zeros(3)}, r"score: expected shape \(1,\), got \(3,\)"),
        ({"label": ["a", "b"]}, r"label: expected shape \(1,\), got \(2,\)"),
        ({"track_id": np.zeros(2, dtype=np.int64)}, "track_id: expected shape"),
    ],
)
@pytest.mark.usefixtures("without_shape_checks")
def test_invalid_boxes_are_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        one(**changes)


@pytest.mark.usefixtures("without_shape_checks")
def test_fractional_ids_are_refused_not_truncated() -> None:
    with pytest.raises(ValueError, match="track_id: expected whole numbers, got dtype float64"):
        one(track_id=np.array([1.5]))


def test_one_label_stands_for_all_and_numbers_become_float64() -> None:
    boxes = Boxes(centre_m=np.zeros((2, 3)), size_m=np.ones((2, 3)), yaw_rad=np.zeros(2), label="vehicle")
    assert boxes.label.tolist() == ["vehicle", "vehicle"]
    assert boxes.centre_m.dtype == boxes.size_m.dtype == boxes.yaw_rad.dtype == np.float64


@settings(deadline=None)
@given(st.floats(-1e6, 1e6))
def test_wrapped_angles_lie_in_the_half_open_interval_and_point_the_same_way(angle: float) -> None:
    wrapped = float(wrap_angle_rad(np.array([angle]))[0])
    assert -np.pi <= wrapped < np.pi
    np.testing.assert_allclose([np.cos(wrapped), np.sin(wrapped)], [np.cos(angle), np.sin(angle)], atol=1e-9)
    assert wrap_angle_rad(np.array([wrapped]))[0] == wrapped


@pytest.mark.parametrize(("angle", "expected"), [(np.pi, -np.pi), (-np.pi, -np.pi), (3 * np.pi, -np.pi), (0.1, 0.1)])
def test_wrapping_of_the_ends(angle: float, expected: float) -> None:
    assert wrap_angle_rad(np.array([angle]))[0] == expected


def test_just_below_minus_pi_never_gives_plus_pi() -> None:
    assert wrap_angle_rad(np.array([np.nextafter(-np.pi, -4.0)]))[0] < np.pi


@pytest.mark.parametrize(
    "index",
    [slice(2, 7, 2), np.array([3, 1, 1, -1]), np.arange(10) % 3 == 0, [0, 9], 4, -1, [], np.zeros(10, dtype=bool)],
    ids=str,
)
def test_selection_takes_the_same_rows_of_every_field(rng: np.random.Generator, index: object) -> None:
    boxes = random_boxes(rng, 10)
    rows = np.atleast_1d(np.arange(10)[np.zeros(0, dtype=np.intp) if isinstance(index, list) and not index else index])
    chosen = boxes[index]  # type: ignore[index]
    assert len(chosen) == len(rows)
    for name in ("centre_m", "size_m", "yaw_rad", "label", "score", "track_id", "point_count"):
        np.testing.assert_array_equal(getattr(chosen, name), getattr(boxes, name)[rows])


def test_iteration_gives_every_box_once(rng: np.random.Generator) -> None:
    boxes = random_boxes(rng, 3)
    assert [int(box.track_id[0]) for box in boxes] == [0, 1, 2]  # type: ignore[attr-defined]


def test_concatenation_keeps_order_and_long_labels(rng: np.random.Generator) -> None:
    boxes = random_boxes(rng, 9)
    renamed = boxes[4:].relabel({"vehicle": "wheeled_pedestrian"})
    joined = Boxes.concatenate([boxes[:4], Boxes.empty(scored=True), renamed])
    np.testing.assert_array_equal(joined.centre_m, boxes.centre_m)
    np.testing.assert_array_equal(joined.track_id, np.arange(9))
    assert joined.label.tolist() == [*boxes.label[:4].tolist(), *renamed.label.tolist()]


def test_concatenation_refuses_to_lose_or_invent_scores(rng: np.random.Generator) -> None:
    boxes = random_boxes(rng, 4)
    with pytest.raises(ValueError, match="score is present in some parts"):
        Boxes.concatenate([boxes, boxes.replace(score=None)])


def test_empty_sets() -> None:
    assert len(Boxes.empty()) == 0
    assert Boxes.empty().score is None
    assert Boxes.empty(scored=True).score is not None
    assert len(Boxes.concatenate([])) == 0
    assert Boxes.concatenate([Boxes.empty(scored=True)]).score is not None
    assert Boxes.empty().corners_m().shape == (0, 8, 3)
    assert Boxes.empty().transform(np.eye(4)).centre_m.shape == (0, 3)
    assert repr(Boxes.empty()) == "Boxes(0)"


def test_repr_counts_classes(rng: np.random.Generator) -> None:
    boxes = random_boxes(rng, 3).replace(label=["vehicle", "pedestrian", "vehicle"])
    assert repr(boxes) == "Boxes(3: 1 pedestrian, 2 vehicle)"


def test_corners_of_a_turned_box_by_hand() -> None:
    box = one(
        centre_m=np.array([[100.0, 50.0, 1.0]]), size_m=np.array([[4.0, 2.0, 1.0]]), yaw_rad=np.array([np.pi / 2])
    )
    front_left, rear_left, rear_right, front_right = box.bev_corners_m()[0]
    np.testing.assert_allclose(front_left, [99, 52], atol=1e-12)  # heading +y: left is -x
    np.testing.assert_allclose(rear_left, [99, 48], atol=1e-12)
    np.testing.assert_allclose(rear_right, [101, 48], atol=1e-12)
    np.testing.assert_allclose(front_right, [101, 52], atol=1e-12)
    np.testing.assert_allclose(box.corners_m()[0, :, 2], [0.5] * 4 + [1.5] * 4)


def test_corners_have_the_box_s_centre_extent_and_volume(rng: np.random.Generator) -> None:
    boxes = random_boxes(rng, 50)
    corners = boxes.corners_m()
    np.testing.assert_allclose(corners.mean(axis=1), boxes.centre_m, atol=1e-9)
    length = np.linalg.norm(corners[:, 0] - corners[:, 1], axis=1)
    width = np.linalg.norm(corners[:, 1] - corners[:, 2], axis=1)
    height = np.linalg.norm(corners[:, 4] - corners[:, 0], axis=1)
    np.testing.assert_allclose(np.stack([length, width, height], 1), boxes.size_m, atol=1e-9)
    np.testing.assert_allclose(length * width * height, boxes.volume_m3)


def test_range_is_measured_in_the_ground_plane() -> None:
    assert one(centre_m=np.array([[30.0, -40.0, 99.0]])).range_m.tolist() == [50.0]


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_transform_round_trip_under_random_turns_and_moves(seed: int) -> None:
    rng = np.random.default_rng(seed)
    boxes = random_boxes(rng, 5)
    target_T_source = pose_from_yaw(rng.uniform(-7, 7), rng.uniform(-1000, 1000, 3))
    back = boxes.transform(target_T_source).transform(invert(target_T_source))
    np.testing.assert_allclose(back.centre_m, boxes.centre_m, atol=1e-9)
    np.testing.assert_array_equal(back.size_m, boxes.size_m)
    np.testing.assert_allclose(wrap_angle_rad(back.yaw_rad - boxes.yaw_rad), 0, atol=1e-12)


def test_a_moved_box_has_moved_corners(rng: np.random.Generator) -> None:
    boxes = random_boxes(rng, 20)
    target_T_source = pose_from_yaw(2.0, (10.0, -300.0, 4.0))
    moved = transform_points(target_T_source, boxes.corners_m().reshape(-1, 3)).reshape(-1, 8, 3)
    np.testing.assert_allclose(boxes.transform(target_T_source).corners_m(), moved, atol=1e-9)


def test_roll_and_pitch_move_the_centre_and_keep_the_heading_seen_from_above(rng: np.random.Generator) -> None:
    boxes = random_boxes(rng, 30)
    quaternion = np.array([0.05, -0.04, 0.3, 0.9])
    target_T_source = pose(rotation_from_quaternion(quaternion), np.array([1.0, 2.0, 3.0]))
    moved = boxes.transform(target_T_source)
    np.testing.assert_allclose(moved.centre_m, transform_points(target_T_source, boxes.centre_m), atol=1e-9)
    tips = boxes.centre_m + np.stack([np.cos(boxes.yaw_rad), np.sin(boxes.yaw_rad), np.zeros(30)], axis=1)
    ahead = transform_points(target_T_source, tips) - moved.centre_m
    np.testing.assert_allclose(wrap_angle_rad(np.arctan2(ahead[:, 1], ahead[:, 0]) - moved.yaw_rad), 0, atol=1e-9)


def test_transform_keeps_labels_scores_and_ids(rng: np.random.Generator) -> None:
    boxes = random_boxes(rng, 4)
    moved = boxes.transform(pose_from_yaw(1.0))
    for name in ("label", "score", "track_id", "point_count"):
        np.testing.assert_array_equal(getattr(moved, name), getattr(boxes, name))


def test_velocities_turn_with_the_boxes_and_are_cut_with_them(without_shape_checks: None) -> None:
    boxes = Boxes(
        centre_m=np.zeros((2, 3)), size_m=np.ones((2, 3)), yaw_rad=np.zeros(2), velocity_m_s=[[1.0, 0.0], [np.nan, 0.0]]
    )
    turned = boxes.transform(pose_from_yaw(np.pi / 2))
    np.testing.assert_allclose(turned.velocity_m_s[0], [0.0, 1.0], atol=1e-12)
    assert np.isnan(turned.velocity_m_s[1]).any()
    assert boxes[[1]].velocity_m_s.shape == (1, 2)
    in_space = boxes.replace(velocity_m_s=np.array([[1.0, 2.0, 3.0], [0.0, 0.0, 1.0]]))
    np.testing.assert_allclose(in_space.transform(pose_from_yaw(np.pi)).velocity_m_s[0], [-1, -2, 3], atol=1e-12)
    assert boxes.plain().velocity_m_s is None
    with pytest.raises(ValueError, match="velocity_m_s: expected shape"):
        boxes.replace(velocity_m_s=np.zeros((2, 4)))


def test_infinite_velocities_are_refused() -> None:
    with pytest.raises(ValueError, match=r"velocity_m_s: expected finite numbers or NaN, got .* in row 0"):
        one(velocity_m_s=np.array([[np.inf, 0.0]]))


def test_joined_with_boxes_of_unknown_velocity_the_known_ones_stay(rng: np.random.Generator) -> None:
    still, driven = random_boxes(rng, 2), random_boxes(rng, 3).replace(velocity_m_s=rng.normal(0, 9, (3, 3)))
    joined = Boxes.concatenate([still, Boxes.empty(), driven])
    assert np.isnan(joined.velocity_m_s[:2]).all()
    np.testing.assert_array_equal(joined.velocity_m_s[2:], driven.velocity_m_s)
    flat = Boxes.concatenate([driven, driven.replace(velocity_m_s=driven.velocity_m_s[:, :2])])
    np.testing.assert_array_equal(flat.velocity_m_s, np.tile(driven.velocity_m_s[:, :2], (2, 1)))
    turned = joined.transform(pose_from_yaw(np.pi))
    np.testing.assert_allclose(turned.velocity_m_s[2:], driven.velocity_m_s * [-1, -1, 1], atol=1e-12)
    assert Boxes.concatenate([still, still]).velocity_m_s is None

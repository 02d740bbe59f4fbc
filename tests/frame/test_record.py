"""Cloud, Lazy and Frame."""

from typing import Any

import numpy as np
import pytest

from farfield.errors import ConfigError
from farfield.frame import Annotation, Boxes, Cloud, Frame, Lazy, Sensor, transform_frame
from farfield.geometry.poses import invert, pose_from_yaw


def cloud(rng: np.random.Generator, n: int = 6, **extra: np.ndarray) -> Cloud:
    return Cloud(rng.uniform(-50, 50, (n, 3)).astype(np.float32), rng.random(n).astype(np.float32), extra)


def forbidden() -> Any:
    raise AssertionError("was loaded")


@pytest.mark.usefixtures("without_shape_checks")
def test_columns_of_unequal_length_are_refused(rng: np.random.Generator) -> None:
    with pytest.raises(ValueError, match="columns of equal length, got 6 points"):
        cloud(rng, ring=np.zeros(5, dtype=np.int64))


@pytest.mark.parametrize("index", [slice(1, 4), np.array([5, 0]), np.arange(6) > 3], ids=["slice", "indices", "mask"])
def test_selection_takes_the_same_rows_of_every_column(rng: np.random.Generator, index: Any) -> None:
    whole = cloud(rng, ring=np.arange(6))
    part = whole[index]
    np.testing.assert_array_equal(part.points_m, whole.points_m[index])
    np.testing.assert_array_equal(part.intensity, whole.intensity[index])
    np.testing.assert_array_equal(part.extra["ring"], np.arange(6)[index])
    assert len(part) == len(part.points_m)


def test_joined_clouds_keep_the_columns_that_all_have(rng: np.random.Generator) -> None:
    a, b = cloud(rng, 3, ring=np.arange(3), time_ns=np.arange(3)), cloud(rng, 2, ring=np.arange(2))
    joined = Cloud.concatenate([a, b])
    assert list(joined.extra) == ["ring"]
    assert joined.extra["ring"].tolist() == [0, 1, 2, 0, 1]
    np.testing.assert_array_equal(joined.points_m, np.concatenate([a.points_m, b.points_m]))


def test_transform_moves_points_and_keeps_the_rest(rng: np.random.Generator) -> None:
    whole = cloud(rng, ring=np.arange(6))
    moved = whole.transform(pose_from_yaw(np.pi, (1.0, 2.0, 3.0)))
    np.testing.assert_allclose(moved.points_m, whole.points_m * [-1, -1, 1] + [1, 2, 3], atol=1e-5)
    assert moved.points_m.dtype == np.float32
    np.testing.assert_array_equal(moved.extra["ring"], np.arange(6))


def test_points_in_boxes_through_the_cloud() -> None:
    points = Cloud(np.array([[0, 0, 0], [9, 0, 0]], dtype=np.float32), np.zeros(2, dtype=np.float32))
    boxes = Boxes(centre_m=np.array([[9.0, 0, 0]]), size_m=np.ones((1, 3)), yaw_rad=np.zeros(1))
    assert [indices.tolist() for indices in points.in_boxes(boxes)] == [[1]]


def test_lazy_loads_once_and_only_what_is_asked_for() -> None:
    calls: list[str] = []
    lazy = Lazy({"a": lambda: calls.append("a") or 1, "b": forbidden})  # type: ignore[func-returns-value]
    assert list(lazy) == ["a", "b"]
    assert len(lazy) == 2
    assert "b" in lazy
    assert "c" not in lazy
    assert calls == []
    assert (lazy["a"], lazy["a"]) == (1, 1)
    assert calls == ["a"]
    assert repr(lazy) == "Lazy(a, b (not loaded))"
    with pytest.raises(KeyError, match="'c'; present: a, b"):
        lazy["c"]
    assert lazy.get("c") is None


def test_a_failed_load_is_tried_again() -> None:
    outcomes = iter([OSError("disk"), 7])

    def load() -> int:
        outcome = next(outcomes)
        if isinstance(outcome, OSError):
            raise outcome
        return outcome

    lazy = Lazy({"a": load})
    with pytest.raises(OSError, match="disk"):
        lazy["a"]
    assert lazy["a"] == 7


def test_frame_from_memory(rng: np.random.Generator) -> None:
    points, boxes = cloud(rng), Boxes.empty()
    frame = Frame.of(points, boxes, sequence="drive", time_ns=5)
    assert frame.key == ("drive", "0")
    assert frame.cloud() is points
    assert frame.cloud("lidar") is points
    assert frame.boxes is boxes
    assert Frame.of(points).boxes is None


def test_frame_of_several_clouds_from_memory(rng: np.random.Generator) -> None:
    lidar, radar = cloud(rng), Cloud(np.zeros((2, 3), np.float32), None, {"power": np.ones(2, np.float32)})
    frame = Frame.of(clouds={"top": lidar, "radar": radar}, boxes=Boxes.empty())
    assert frame.cloud("top") is lidar
    assert frame.cloud("radar") is radar
    assert {name: sensor.kind for name, sensor in frame.sensors.items()} == {"top": "lidar", "radar": "radar"}
    assert frame.reference == "lidar", "the first cloud's kind"
    assert frame.has_annotation
    for wrong in ({}, {"clouds": {}}, {"cloud": lidar, "clouds": {"a": lidar}}):
        with pytest.raises(ConfigError, match="one cloud, or clouds="):
            Frame.of(**wrong)


def test_boxes_are_loaded_once() -> None:
    calls: list[int] = []

    def load() -> Annotation:
        calls.append(1)
        return Annotation(boxes=Boxes.empty())

    frame = Frame(sequence="s", frame_id="1", load_annotation=load)
    assert frame.has_annotation
    assert calls == []
    assert frame.boxes is frame.boxes
    assert calls == [1]


def test_choosing_a_cloud_loads_no_other(rng: np.random.Generator) -> None:
    points = cloud(rng)
    frame = Frame(sequence="s", frame_id="1", clouds=Lazy({"gaussian": lambda: points, "uniform": forbidden}))
    assert frame.cloud() is points
    assert frame.cloud("gaussian") is points
    with pytest.raises(KeyError, match="has no cloud 'radar'; present: gaussian, uniform"):
        frame.cloud("radar")
    with pytest.raises(KeyError, match="present: none"):
        Frame(sequence="s", frame_id="1").cloud()


def posed(**sensors: Sensor) -> Frame:
    """A frame of one lidar point, two boxes of which one moves, and the sensors given."""
    points = Cloud(np.array([[10.0, 0, 0]], dtype=np.float32), np.zeros(1, dtype=np.float32))
    boxes = Boxes(
        centre_m=np.array([[10.0, 0, 0], [0, 5.0, 0]]),
        size_m=np.ones((2, 3)),
        yaw_rad=np.zeros(2),
        velocity_m_s=np.array([[3.0, 0, 0], [0, 0, 0]]),
    )
    known = {"lidar": Sensor(kind="lidar", frame_T_sensor=np.eye(4)), **sensors}
    return Frame.of(points, boxes, sensors=known, world_T_frame=pose_from_yaw(0.1, (5.0, 0.0, 0.0)))


def test_the_reference_never_lies_after_a_move() -> None:
    mounted = pose_from_yaw(0.2, (2.5, 0.0, -0.7))
    frame = posed(radar=Sensor(kind="radar", frame_T_sensor=mounted))
    turned = transform_frame(frame, pose_from_yaw(np.pi))
    assert (frame.reference, turned.reference, transform_frame(turned, pose_from_yaw(0.3)).reference) == (
        "lidar",
        "lidar'",
        "lidar'",
    )
    assert transform_frame(turned, pose_from_yaw(-np.pi)).reference == "lidar"
    assert transform_frame(frame, np.eye(4)).reference == "lidar"
    seen = transform_frame(frame, invert(mounted), reference="radar")
    assert (seen.reference, seen.reference_kind, turned.reference_kind) == ("radar", "radar", "lidar")
    assert seen.sensors["radar"].frame_T_sensor is not None
    assert np.array_equal(seen.sensors["radar"].frame_T_sensor, np.eye(4))  # exactly: its own data need no rounding
    with pytest.raises(ConfigError, match="in which radar stands at the origin, but it would stand at"):
        transform_frame(frame, mounted, reference="radar")


def test_a_name_without_a_pose_is_given_up_by_any_move() -> None:
    frame = Frame(sequence="s", frame_id="1", reference="ego", sensors={"lidar": Sensor(kind="lidar")})
    assert transform_frame(frame, pose_from_yaw(1.0)).reference == "ego'"
    assert transform_frame(frame, np.eye(4)).reference == "ego"


@pytest.mark.parametrize(
    ("sensors", "kind"),
    [
        ({"a": Sensor(kind="lidar"), "b": Sensor(kind="lidar")}, "lidar"),
        ({"a": Sensor(kind="lidar"), "b": Sensor(kind="radar")}, None),
        ({"a": Sensor(kind="lidar"), "b": Sensor(kind="radar", in_frame=False)}, "lidar"),
        ({}, None),
    ],
    ids=["all-alike", "mixed", "one-apart", "unknown"],
)
def test_the_kind_of_coordinates_that_name_no_sensor(sensors: Any, kind: str | None) -> None:
    clouds = Lazy({"a": forbidden, "b": forbidden})
    assert Frame(sequence="s", frame_id="1", reference="ego", sensors=sensors, clouds=clouds).reference_kind == kind


def test_velocities_poses_and_the_place_in_the_world_move_along() -> None:
    frame = posed()
    turned = transform_frame(frame, pose_from_yaw(np.pi / 2))
    assert turned.boxes is not None
    assert turned.boxes.velocity_m_s is not None
    assert turned.world_T_frame is not None
    np.testing.assert_allclose(turned.boxes.velocity_m_s[0], [0, 3, 0], atol=1e-12)
    np.testing.assert_allclose(turned.cloud().points_m, [[0, 10, 0]], atol=1e-6)
    np.testing.assert_allclose(turned.world_T_frame @ [0, 10, 0, 1], frame.world_T_frame @ [10, 0, 0, 1], atol=1e-9)


@pytest.mark.parametrize("value", [-0.1, 1.5, np.nan])
def test_an_intensity_outside_0_to_1_is_refused(value: float) -> None:
    with pytest.raises(ValueError, match=r"expected intensities in \[0, 1\]"):
        Cloud(np.zeros((1, 3), dtype=np.float32), np.array([value], dtype=np.float32))


def test_columns_by_name() -> None:
    points = np.arange(6, dtype=np.float32).reshape(2, 3)
    radar = Cloud(points, None, {"power": np.array([20.0, 30.0], np.float32), "scan": np.array([0, -1])})
    assert radar.columns == ("x_m", "y_m", "z_m", "power", "scan")
    np.testing.assert_array_equal(radar.column("y_m"), [1, 4])
    np.testing.assert_array_equal(radar.column("lag_s"), [0, 0])
    assert radar.column("scan").dtype == np.float32
    with pytest.raises(ConfigError, match=r"column 'intensity'; it has x_m, y_m, z_m, power, scan"):
        radar.column("intensity")
    assert Cloud.concatenate([radar, Cloud(points, np.ones(2, np.float32))]).intensity is None


def test_the_kind_of_a_cloud_from_memory_is_that_of_its_columns() -> None:
    points = np.zeros((1, 3), dtype=np.float32)
    assert Frame.of(Cloud(points, np.zeros(1, np.float32))).sensors["lidar"].kind == "lidar"
    radar = Frame.of(Cloud(points), name="radar")
    assert (radar.sensors["radar"].kind, radar.reference) == ("radar", "radar")
    assert not radar.has_annotation


def test_times_of_sensors_fall_back_on_the_frames() -> None:
    frame = Frame(sequence="s", frame_id="1", time_ns=5, sensors={"a": Sensor(kind="lidar", time_ns=7)})
    assert (frame.time_ns_of("a"), frame.time_ns_of("b")) == (7, 5)


def test_offsets_of_points_are_nanoseconds_or_refused() -> None:
    points = np.zeros((2, 3), np.float32)
    assert Cloud(points).offsets_s() is None
    assert Cloud(points, extra={"offset_ns": np.array([0, 10**8])}).offsets_s().tolist() == [0, 0.1]
    for wrong in (np.array([0.0, 1.7e18]), np.array([0.0, np.nan]), np.array([0, 2**64 - 1], np.uint64)):
        with pytest.raises(ConfigError, match="--point-times"):
            Cloud(points, extra={"time_ns": wrong}).offsets_s()

"""What a detector or a notebook gets of a frame cannot be changed in place; no map's places, no mirrors."""

import pickle

import numpy as np
import pytest

import farfield as ff
from farfield.errors import ConfigError
from farfield.frame import Annotation, Boxes, Cloud, Frame, Sensor, transform_frame
from farfield.geometry.poses import pose_from_yaw

UTM_M = np.array([691_000.0, 5_335_000.0, 500.0])


def _boxes(count: int = 6) -> Boxes:
    rng = np.random.default_rng(0)
    return Boxes(
        centre_m=rng.uniform(5, 60, (count, 3)) * [1, 0.5, 0],
        size_m=np.tile([4.5, 1.9, 1.6], (count, 1)),
        yaw_rad=rng.uniform(-3, 3, count),
        label="vehicle",
        score=np.full(count, 0.5),
        velocity_m_s=np.zeros((count, 2)),
        track_id=np.arange(count),
        point_count=np.arange(count),
    )


def _frame(number: int = 0) -> Frame:
    points = np.random.default_rng(number).uniform(-30, 30, (200, 3))
    points[:12] = np.repeat(_boxes().centre_m, 2, axis=0)
    cloud = Cloud(points, np.full(200, 0.5), {"ring": np.zeros(200, dtype=np.int64)})
    annotation = Annotation(
        boxes=_boxes(),
        moving=np.zeros(6, dtype=bool),
        details={"occlusion": np.zeros(6)},
        full_boxes=_boxes(),
    )
    image = np.zeros((4, 6, 3), dtype=np.uint8)
    return Frame.of(
        cloud,
        annotation,
        frame_id=str(number),
        images={"front": image},
        world_T_frame=np.eye(4),
        sensors={"lidar": Sensor(kind="lidar", frame_T_sensor=np.eye(4))},
    )


def _arrays(frame: Frame) -> dict[str, np.ndarray]:
    boxes, annotation, cloud = frame.boxes, frame.annotation, frame.cloud()
    assert boxes is not None
    assert annotation is not None
    assert annotation.full_boxes is not None
    names = ("centre_m", "size_m", "yaw_rad", "label", "score", "track_id", "point_count", "velocity_m_s")
    return {
        **{f"boxes.{name}": getattr(boxes, name) for name in names},
        "full_boxes": annotation.full_boxes.centre_m,
        "moving": annotation.moving,
        "details": annotation.details["occlusion"],
        "points": cloud.points_m,
        "intensity": cloud.intensity,
        "ring": cloud.extra["ring"],
        "image": frame.images["front"],
        "world": frame.world_T_frame,
        "sensor": frame.sensors["lidar"].frame_T_sensor,
    }  # type: ignore[dict-item]


@pytest.mark.parametrize("passed_on", [False, True], ids=["made", "unpickled"])
def test_the_arrays_of_a_frame_are_read_only(passed_on: bool) -> None:
    frame = pickle.loads(pickle.dumps(_frame())) if passed_on else _frame()
    writeable = [name for name, array in _arrays(frame).items() if array.flags.writeable]
    assert writeable == []


def test_the_caller_may_go_on_writing_into_arrays_of_their_own() -> None:
    centre_m, points_m = np.ones((1, 3)), np.ones((4, 3), dtype=np.float32)
    Boxes(centre_m=centre_m, size_m=np.ones((1, 3)), yaw_rad=np.zeros(1))
    Cloud(points_m)
    centre_m[0], points_m[0] = 2.0, 2.0
    assert centre_m.tolist() == [[2.0, 2.0, 2.0]]
    assert points_m[0].tolist() == [2.0, 2.0, 2.0]


def _cheat(frame: Frame) -> Boxes:
    """Moves the annotation onto its own boxes, which are wrong by 20 m, past every lock that numpy has."""
    boxes = frame.boxes
    assert boxes is not None
    for array in (boxes.centre_m, boxes.centre_m.base):
        if array is not None:
            array.setflags(write=True)
            array += 20.0
    return Boxes(
        centre_m=_boxes().centre_m + 20.0, size_m=boxes.size_m, yaw_rad=boxes.yaw_rad, label="vehicle", score=np.ones(6)
    )


def test_a_detector_that_moves_the_annotation_onto_its_boxes_scores_nothing() -> None:
    frames = [_frame(0), _frame(1)]
    result = ff.evaluate(_cheat, frames, region="none")
    assert result.figures["dds/0/map"] == 0.0
    result = ff.evaluate(_cheat, frames, region="none")  # nor does the first evaluation help the second
    assert result.figures["dds/0/map"] == 0.0


class _OneBuffer:
    """A detector that writes the boxes of every frame into one array."""

    def __init__(self) -> None:
        self.centre_m = np.zeros((6, 3))

    def __call__(self, frame: Frame) -> Boxes:
        boxes = frame.boxes
        assert boxes is not None
        self.centre_m[:] = boxes.centre_m + 100.0 * int(frame.frame_id)
        return boxes.replace(centre_m=self.centre_m)


def test_boxes_of_a_detector_that_reuses_its_buffer_stay_those_of_their_frame() -> None:
    detections = ff.detect(_OneBuffer(), [_frame(0), _frame(1)])
    first = detections.boxes["memory", "0"]
    np.testing.assert_array_equal(first.centre_m, _boxes().centre_m)


def test_points_in_boxes_are_counted_before_the_detector_gets_them() -> None:
    frame = _frame(0)
    counts = ff.detect(_oracle, [frame], cloud="lidar").annotations[frame.key].boxes.point_count
    cheated = ff.detect(_empties_the_cloud, [_frame(0)], cloud="lidar").annotations[frame.key].boxes.point_count
    np.testing.assert_array_equal(counts, cheated)


def _oracle(frame: Frame) -> Boxes:
    assert frame.boxes is not None
    return frame.boxes


def _empties_the_cloud(frame: Frame) -> Boxes:
    points = frame.cloud().points_m
    for array in (points, points.base):
        if array is not None:
            array.setflags(write=True)
            array += 1000.0
    return _oracle(frame)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_a_cloud_on_a_map_is_refused_wherever_it_comes_from(dtype: type) -> None:
    points = np.random.default_rng(0).uniform(-50, 50, (100, 3)) + UTM_M
    with pytest.raises(ValueError, match=r"Subtract where the sensor stood, in float64"):
        ff.Cloud(points.astype(dtype))
    points[:40] = 0.0  # no returns among them do not make them metres from the sensor
    with pytest.raises(ValueError, match=r"Subtract where the sensor stood, in float64"):
        ff.Cloud(points.astype(dtype))
    with pytest.raises(ValueError, match=r"Subtract where the sensor stood, in float64"):
        ff.Cloud(points - UTM_M).transform(pose_from_yaw(0.0, UTM_M))


MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])
SCALE = np.diag([2.0, 2.0, 2.0, 1.0])
NAN = pose_from_yaw(0.1, (np.nan, 0.0, 0.0))
SHEAR = np.eye(4) + np.eye(4, k=1) * [[0.1], [0], [0], [0]]
LAST_ROW = np.eye(4) + np.eye(4, k=-3)


@pytest.mark.parametrize(
    "motion", [MIRROR, SCALE, NAN, SHEAR, LAST_ROW], ids=["mirror", "scale", "nan", "shear", "row"]
)
def test_what_is_no_rigid_motion_moves_nothing(motion: np.ndarray) -> None:
    frame = _frame()
    assert frame.boxes is not None
    assert frame.annotation is not None
    for move in (
        lambda: transform_frame(frame, motion),
        lambda: frame.boxes.transform(motion),
        lambda: frame.cloud().transform(motion),
        lambda: frame.annotation.moved(motion),
    ):
        with pytest.raises(ConfigError, match="rigid motion"):
            move()


def _adds(frame: Frame) -> Boxes:
    frame.cloud().points_m[:, 2] += 1.0
    return _boxes()


def _sorts(frame: Frame) -> Boxes:
    frame.cloud().points_m.sort(axis=0)
    return _boxes()


def _adds_by_ufunc(frame: Frame) -> Boxes:
    np.add(frame.cloud().points_m, 1.0, out=frame.cloud().points_m)
    return _boxes()


def _replaces(frame: Frame) -> Boxes:
    frame.cloud().points_m = np.zeros((0, 3))  # type: ignore[misc]
    return _boxes()


@pytest.mark.parametrize("detector", [_adds, _sorts, _adds_by_ufunc, _replaces])
@pytest.mark.parametrize("run", [ff.detect, ff.evaluate])
def test_a_detector_that_writes_into_its_input_is_named(detector, run) -> None:
    with pytest.raises(ConfigError, match=rf"{detector.__name__}.*must not change what it gets.*\.copy\(\)") as caught:
        run(detector, [_frame()])
    assert caught.value.__cause__ is not None


def test_other_errors_of_a_detector_stay_as_they_are() -> None:
    with pytest.raises(ValueError, match="mine"):
        ff.detect(_fails, [_frame()])


def _fails(frame: Frame) -> Boxes:
    raise ValueError("mine")

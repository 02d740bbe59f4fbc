"""What every frame keeps, whoever made it: plain functions that can become part of farfield.testing."""

import itertools
import json
import pickle
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from farfield.datasets.base import Dataset
from farfield.datasets.maps import Coordinates
from farfield.datasets.recipes import replay
from farfield.errors import ConfigError
from farfield.frame import Boxes, Cloud, Frame, joined, moved
from farfield.geometry.poses import invert, pose_from_yaw, transform_points

AWAY = pose_from_yaw(0.7, (3.0, -2.0, 0.5))
MOST_BYTES = 200_000  # of a pickled frame: what it loads when it is read must not travel


def check_dataset(data: Dataset) -> None:
    """Check all frames of a (small) data set and that the set itself travels to another process."""
    assert pickle.loads(pickle.dumps(data)).keys == data.keys
    for frame in data:
        check_frame(frame)
    check_drives(data)
    check_views(data)


def check_drives(data: Dataset) -> None:
    """Drives and annotations that are known without frames are those of the frames, in the order of time."""
    for index, frame in enumerate(data):
        assert data.has_annotation(index) == frame.has_annotation
        assert_same(data.annotation(index), frame.annotation, atol=1e-9)
    for drive in data.drives():
        frames = [data[int(index)] for index in drive.indices]
        assert drive.keys == tuple(frame.key for frame in frames)
        assert {frame.sequence for frame in frames} == {drive.name}
        if drive.times_ns is not None:
            assert drive.times_ns.tolist() == [frame.time_ns for frame in frames]
            assert (np.diff(drive.times_ns) > 0).all(), f"{drive.name}: times do not grow"
        if drive.world_T_frame is not None:
            np.testing.assert_allclose(drive.world_T_frame, np.stack([frame.world_T_frame for frame in frames]))


def check_views(data: Dataset) -> None:
    """Maps travel to other processes, leave a recipe that gives the same again, and enter the fingerprint."""
    others = [name for name in data.references if name != data[0].reference]
    views = [data.moved(AWAY), *(data.mapped(Coordinates(name)) for name in others)]
    for seen in views:
        again = replay(data, json.loads(json.dumps(seen.recipe)))
        assert again.fingerprint() == pickle.loads(pickle.dumps(seen)).fingerprint()
        assert_same(again[0], seen[0])
        check_pickling(seen[0])
    assert len({seen.fingerprint() for seen in (data, *views)}) == 1 + len(views)


def check_frame(frame: Frame) -> None:
    """Check one frame."""
    check_sensors(frame)
    check_pickling(frame)
    check_annotation(frame)
    check_moving(frame)
    check_joining(frame)


def check_sensors(frame: Frame) -> None:
    """Each cloud, image, radar product and camera has its sensor; intensity is a LiDAR's and lies in [0, 1]."""
    named = [*frame.clouds, *frame.images, *frame.radar, *frame.cameras]
    assert set(named) <= set(frame.sensors), f"sensors: none of {set(named) - set(frame.sensors)}"
    for name in frame.clouds:
        lidar, intensity = frame.sensors[name].kind == "lidar", frame.clouds[name].intensity
        assert (intensity is not None) == lidar, f"{name}: intensity is a LiDAR's; a radar's power is a column of extra"
        assert intensity is None or (intensity.dtype == np.float32 and ((intensity >= 0) & (intensity <= 1)).all())
    for name, camera in frame.cameras.items():
        pose = frame.sensors[name].frame_T_sensor
        assert pose is not None, f"{name}: a calibrated camera's sensor has its pose"
        np.testing.assert_allclose(pose @ camera.camera_T_lidar, np.eye(4), atol=1e-9)
    for name in (*frame.images, *frame.radar):
        assert not frame.sensors[name].in_frame, f"{name}: images and radar products keep their sensor's axes"


def check_pickling(frame: Frame) -> None:
    """A frame survives pickling, read or not, and what it loads stays behind."""
    data = pickle.dumps(frame)
    assert len(data) < MOST_BYTES, f"{frame.key}: {len(data)} bytes"
    assert_same(pickle.loads(data), frame)
    assert len(pickle.dumps(frame)) < MOST_BYTES, "what was read travels along"


def check_annotation(frame: Frame) -> None:
    """Rows of the annotation are cut together, and known to be there without being read."""
    assert frame.has_annotation == (frame.annotation is not None)
    annotation = frame.annotation
    if annotation is None:
        return
    assert annotation.extent in ("full", "visible")
    order = np.arange(len(annotation))[::-1]
    turned = annotation[order]
    assert_same(turned[order], annotation)
    assert len(annotation[np.zeros(len(annotation), dtype=np.bool_)]) == 0
    for name, rows in annotation.details.items():
        assert len(turned.details[name]) == len(turned.boxes) == len(rows)


def check_moving(frame: Frame) -> None:
    """What is moved there and back is the same; ``reference`` names no sensor that stands elsewhere."""
    away = moved(frame, AWAY)
    assert away.reference == frame.reference + "'"
    assert away.reference_kind == frame.reference_kind
    back = moved(away, invert(AWAY), reference=frame.reference)
    assert_same(back, frame, atol=2e-4)
    for name, sensor in frame.sensors.items():
        if name in frame.clouds and not sensor.in_frame:
            assert_same(away.clouds[name], frame.clouds[name])
        if sensor.frame_T_sensor is not None:
            other = away.sensors[name].frame_T_sensor
            assert other is not None
            np.testing.assert_allclose(other, AWAY @ sensor.frame_T_sensor, atol=1e-9)
            assert_same(_seen(away.boxes, other), _seen(frame.boxes, sensor.frame_T_sensor), atol=1e-6)
    if frame.world_T_frame is not None and frame.boxes is not None:
        assert away.world_T_frame is not None
        assert away.boxes is not None
        placed = away.boxes.transform(away.world_T_frame)
        assert_same(placed.centre_m, frame.boxes.transform(frame.world_T_frame).centre_m, atol=1e-3)


def _seen(boxes: Boxes | None, frame_T_sensor: np.ndarray) -> np.ndarray:
    return transform_points(invert(frame_T_sensor), np.zeros((0, 3)) if boxes is None else boxes.centre_m)


def check_joining(frame: Frame) -> None:
    """Only clouds of one kind that stand in the frame and do not hold one another are joined."""
    for a, b in itertools.combinations(frame.clouds, 2):
        one, other = frame.sensors[a], frame.sensors[b]
        fit = one.kind == other.kind and one.in_frame and other.in_frame and a not in other.holds and b not in one.holds
        try:
            together = joined(frame, [a, b])
        except ConfigError:
            assert not fit, f"{a} and {b} were refused"
            continue
        assert fit, f"{a} and {b} were joined"
        assert_same(together, Cloud.concatenate([frame.clouds[a], frame.clouds[b]]))


def assert_same(a: Any, b: Any, *, atol: float = 0.0, where: str = "frame") -> None:
    """Compare two things, field by field, arrays by value; loaders are compared by what they load."""
    if isinstance(a, np.ndarray):
        assert isinstance(b, np.ndarray), where
        if a.dtype.kind == "f":
            np.testing.assert_allclose(a, b, rtol=0, atol=atol, err_msg=where)
        else:
            np.testing.assert_array_equal(a, b, err_msg=where)
    elif isinstance(a, Frame):
        for field in fields(a):
            name = "annotation" if field.name == "load_annotation" else field.name
            assert_same(getattr(a, name), getattr(b, name), atol=atol, where=f"{where}.{name}")
    elif is_dataclass(a) and not isinstance(a, type):
        assert type(a) is type(b), where
        for field in fields(a):
            assert_same(getattr(a, field.name), getattr(b, field.name), atol=atol, where=f"{where}.{field.name}")
    elif isinstance(a, Mapping):
        assert list(a) == list(b), where
        for key in a:
            assert_same(a[key], b[key], atol=atol, where=f"{where}[{key!r}]")
    elif isinstance(a, Sequence) and not isinstance(a, str):
        assert len(a) == len(b), where
        for row, (one, other) in enumerate(zip(a, b, strict=True)):
            assert_same(one, other, atol=atol, where=f"{where}[{row}]")
    else:
        assert a == b, where

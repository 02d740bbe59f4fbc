"""What every data set and every frame keep, whoever made them: plain functions that raise AssertionError."""

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
from farfield.frame import Boxes, Cloud, Frame, merge_clouds, transform_frame
from farfield.geometry.poses import invert, pose_from_yaw, transform_points

AWAY = pose_from_yaw(0.7, (3.0, -2.0, 0.5))
MOST_BYTES = 200_000  # of a pickled frame: what it loads when it is read must not travel


def check_dataset(data: Dataset) -> None:
    """Check a small data set: every frame, files, fingerprint, drives, and what maps show of it.

    Args:
        data: The data set, opened; all of its frames are read several times.

    Raises:
        AssertionError: If something does not hold; the message says what and how to fix it.
    """
    assert len(data), f"{data.root}: expected at least one frame to check"
    check_files(data)
    for frame in data:
        check_frame(frame)
    check_drives(data)
    check_views(data)


def check_files(data: Dataset) -> None:
    """The data set travels to another process, names its frames once each and the files that they are read from."""
    assert data.name, "expected the format's name in the attribute name"
    assert len(set(data.keys)) == len(data.keys), "expected each (sequence, frame_id) once; make frame_ids unique"
    again = pickle.loads(pickle.dumps(data))
    assert again.keys == data.keys, "expected a data set that pickles: keep paths and settings, no open files"
    for index, key in enumerate(data.keys):
        files = data.files(index)
        assert files, f"{key}: expected the files that the frame is read from, files() gives none"
        missing = [str(path) for path in files if not path.is_file()]
        assert not missing, f"{key}: files() names what is not there: {', '.join(missing)}"
        frame = data[index]
        assert frame.key == key, f"expected frame {index} to be {key}, as sequences and frame_ids say; got {frame.key}"
    assert again.fingerprint() == data.fingerprint(), "expected the same fingerprint again: files() must not vary"


def check_drives(data: Dataset) -> None:
    """Drives and annotations that are known without frames are those of the frames, in the order of time."""
    for index, frame in enumerate(data):
        assert data.has_annotation(index) == frame.has_annotation, (
            f"{frame.key}: has_annotation(index) and the frame's has_annotation differ"
        )
        assert_same(data.annotation(index), frame.annotation, atol=1e-9, where=f"{frame.key}: annotation(index)")
    for drive in data.drives():
        frames = [data[int(index)] for index in drive.indices]
        named = f"drive {drive.name}"
        assert drive.keys == tuple(frame.key for frame in frames), f"{named}: expected the keys of its frames"
        assert {frame.sequence for frame in frames} == {drive.name}, f"{named}: expected frames of that sequence alone"
        if drive.times_ns is not None:
            assert drive.times_ns.tolist() == [frame.time_ns for frame in frames], f"{named}: times are not the frames'"
            assert (np.diff(drive.times_ns) > 0).all(), f"{named}: times do not grow; order drive_indices() by time"
        if drive.world_T_frame is not None:
            for pose, frame in zip(drive.world_T_frame, frames, strict=True):
                assert_same(frame.world_T_frame, pose, atol=1e-7, where=f"{frame.key}: pose, which its drive has too")


def check_views(data: Dataset) -> None:
    """Maps travel to other processes, leave a recipe that gives the same again, and enter the fingerprint."""
    others = [name for name in data.references if name != data[0].reference]
    views = [data.moved(AWAY), *(data.mapped(Coordinates(name)) for name in others)]
    for view in views:
        again = replay(data, json.loads(json.dumps(view.recipe)))
        assert again.fingerprint() == pickle.loads(pickle.dumps(view)).fingerprint(), (
            "expected the fingerprint of a moved data set from its recipe; options must be what JSON holds"
        )
        assert_same(again[0], view[0], where="the frame by its recipe")
        check_pickling(view[0])
    marks = {view.fingerprint() for view in (data, *views)}
    assert len(marks) == 1 + len(views), "expected maps to change the fingerprint; do not override fingerprint()"


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
    assert set(named) <= set(frame.sensors), (
        f"{frame.key}: expected a Sensor for each cloud, image and camera; none of {set(named) - set(frame.sensors)}"
    )
    for name in frame.clouds:
        lidar, intensity = frame.sensors[name].kind == "lidar", frame.clouds[name].intensity
        assert (intensity is not None) == lidar, f"{name}: intensity is a LiDAR's; a radar's power is a column of extra"
        assert intensity is None or (intensity.dtype == np.float32 and ((intensity >= 0) & (intensity <= 1)).all()), (
            f"{name}: expected intensity as float32 in [0, 1]"
        )
    for name, camera in frame.cameras.items():
        pose = frame.sensors[name].frame_T_sensor
        assert pose is not None, f"{name}: a calibrated camera's sensor has its pose"
        np.testing.assert_allclose(
            pose @ camera.camera_T_lidar, np.eye(4), atol=1e-9, err_msg=f"{name}: take the sensor from camera_sensor()"
        )
    for name in (*frame.images, *frame.radar):
        assert not frame.sensors[name].in_frame, f"{name}: images and radar products keep their sensor's axes"


def check_pickling(frame: Frame) -> None:
    """A frame survives pickling, read or not, and what it loads stays behind."""
    data = pickle.dumps(frame)
    assert len(data) < MOST_BYTES, (
        f"{frame.key}: pickles to {len(data)} bytes; give Lazy functions that load instead of what they load"
    )
    assert_same(pickle.loads(data), frame, where="the pickled frame")
    assert len(pickle.dumps(frame)) < MOST_BYTES, f"{frame.key}: what was read travels along; load it with Lazy"


def check_annotation(frame: Frame) -> None:
    """Rows of the annotation are cut together, and known to be there without being read."""
    assert frame.has_annotation == (frame.annotation is not None), (
        f"{frame.key}: expected load_annotation=None where nothing was annotated, and an Annotation otherwise"
    )
    annotation = frame.annotation
    if annotation is None:
        return
    assert annotation.extent in ("full", "visible"), f"{frame.key}: expected extent 'full' or 'visible'"
    order = np.arange(len(annotation))[::-1]
    turned = annotation[order]
    assert_same(turned[order], annotation, where=f"{frame.key}: annotation, turned round twice")
    none = annotation[np.zeros(len(annotation), dtype=np.bool_)]
    assert len(none) == 0, f"{frame.key}: expected no row of an annotation cut by an empty mask"
    for name, rows in annotation.details.items():
        assert len(turned.details[name]) == len(turned.boxes) == len(rows), (
            f"{frame.key}: details[{name!r}]: expected a row a box; what has none belongs into unboxed"
        )


def check_moving(frame: Frame) -> None:
    """What is moved there and back is the same; ``reference`` names no sensor that stands elsewhere."""
    away = transform_frame(frame, AWAY)
    check_velocities(frame, away)
    assert away.reference == frame.reference + "'", f"{frame.key}: reference must name a sensor, without a '"
    assert away.reference_kind == frame.reference_kind, f"{frame.key}: reference must name one of the sensors"
    back = transform_frame(away, invert(AWAY), reference=frame.reference)
    assert_same(back, frame, atol=2e-4, where="the frame, moved and back")
    for name, sensor in frame.sensors.items():
        if name in frame.clouds and not sensor.in_frame:
            assert_same(away.clouds[name], frame.clouds[name], where=f"{name}, which keeps its own axes, moved")
        if sensor.frame_T_sensor is not None:
            other = away.sensors[name].frame_T_sensor
            assert other is not None, f"{name}: lost its pose when the frame moved"
            np.testing.assert_allclose(other, AWAY @ sensor.frame_T_sensor, atol=1e-9, err_msg=f"{name}: pose")
            own = _seen(frame.boxes, sensor.frame_T_sensor)
            assert_same(_seen(away.boxes, other), own, atol=1e-6, where=f"boxes as {name} sees them")
    if frame.world_T_frame is not None and frame.boxes is not None:
        assert away.world_T_frame is not None, f"{frame.key}: lost its pose when it moved"
        assert away.boxes is not None, f"{frame.key}: lost its boxes when it moved"
        world_boxes = frame.boxes.transform(frame.world_T_frame).centre_m
        assert_same(
            away.boxes.transform(away.world_T_frame).centre_m, world_boxes, atol=1e-3, where="boxes in the world"
        )


def check_velocities(frame: Frame, away: Frame) -> None:
    """Velocities turn with their boxes: along and across each heading they are the same wherever the frame stands.

    Args:
        frame: The frame.
        away: The frame in coordinates that stand level to its own.
    """
    if frame.annotation is None:
        return
    assert away.annotation is not None, f"{frame.key}: lost its annotation when it moved"
    for name in ("boxes", "full_boxes"):
        own, other = getattr(frame.annotation, name), getattr(away.annotation, name)
        assert_same(_driven(own), _driven(other), atol=1e-6, where=f"{frame.key}: velocities of {name}, moved")


def _driven(boxes: Boxes | None) -> np.ndarray:
    """Velocities along and across the headings, and up where they are known so, shape (n, 2 or 3)."""
    if boxes is None or boxes.velocity_m_s is None:
        return np.zeros((0, 2))
    x, y, *up = boxes.velocity_m_s.T
    cos, sin = np.cos(boxes.yaw_rad), np.sin(boxes.yaw_rad)
    return np.stack([x * cos + y * sin, y * cos - x * sin, *up], axis=1)


def _seen(boxes: Boxes | None, frame_T_sensor: np.ndarray) -> np.ndarray:
    return transform_points(invert(frame_T_sensor), np.zeros((0, 3)) if boxes is None else boxes.centre_m)


def check_joining(frame: Frame) -> None:
    """Only clouds of one kind that stand in the frame and do not hold one another are joined."""
    for a, b in itertools.combinations(frame.clouds, 2):
        one, other = frame.sensors[a], frame.sensors[b]
        fit = one.kind == other.kind and one.in_frame and other.in_frame and a not in other.holds and b not in one.holds
        try:
            together = merge_clouds(frame, [a, b])
        except ConfigError:
            assert not fit, (
                f"joined() refused {a} and {b}, though both stand in the frame: see kind, in_frame and holds"
            )
            continue
        assert fit, f"{a} and {b} were joined, though they do not fit together"
        both = Cloud.concatenate([frame.clouds[a], frame.clouds[b]])
        assert_same(together, both, where=f"{a} and {b} joined")


def assert_same(a: Any, b: Any, *, atol: float = 0.0, where: str = "frame") -> None:
    """Compare two things, field by field, arrays by value; loaders are compared by what they load."""
    if isinstance(a, np.ndarray):
        assert isinstance(b, np.ndarray), f"{where}: expected an array, got {type(b).__name__}"
        if a.dtype.kind == "f":
            np.testing.assert_allclose(a, b, rtol=0, atol=atol, err_msg=where)
        else:
            np.testing.assert_array_equal(a, b, err_msg=where)
    elif isinstance(a, Frame):
        for field in fields(a):
            name = "annotation" if field.name == "load_annotation" else field.name
            assert_same(getattr(a, name), getattr(b, name), atol=atol, where=f"{where}.{name}")
    elif is_dataclass(a) and not isinstance(a, type):
        assert type(a) is type(b), f"{where}: {type(a).__name__} and {type(b).__name__}"
        for field in fields(a):
            assert_same(getattr(a, field.name), getattr(b, field.name), atol=atol, where=f"{where}.{field.name}")
    elif isinstance(a, Mapping):
        assert list(a) == list(b), f"{where}: {list(a)} and {list(b)}"
        for key in a:
            assert_same(a[key], b[key], atol=atol, where=f"{where}[{key!r}]")
    elif isinstance(a, Sequence) and not isinstance(a, str):
        assert len(a) == len(b), f"{where}: {len(a)} and {len(b)} rows"
        for row, (one, other) in enumerate(zip(a, b, strict=True)):
            assert_same(one, other, atol=atol, where=f"{where}[{row}]")
    else:
        assert a == b, f"{where}: {a!r} and {b!r}"

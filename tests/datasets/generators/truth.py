"""What a generated tree holds, and how it is held against what a reader gives.

Everything stands in one world, in float64: where a reader puts the origin of its frames is its own business, as long as
``world_T_frame`` says so. Formats without poses have the frame's coordinates for a world.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

import farfield as ff
from farfield.errors import ConfigError


@dataclass(frozen=True, eq=False, kw_only=True)
class CloudTruth:
    """One sensor's points: where they are in the world at the time of measuring, with what columns.

    ``columns`` are those whose names are ours; ``held`` must stand in some column in one of several units; ``vectors``
    are of the world, and some columns must have their x and y along the frame's axes.
    """

    world_m: np.ndarray
    intensity: np.ndarray | None = None
    columns: dict[str, np.ndarray] = field(default_factory=dict)
    held: dict[str, Sequence[np.ndarray]] = field(default_factory=dict)
    vectors: dict[str, np.ndarray] = field(default_factory=dict)
    offsets_s: np.ndarray | None = None
    time_ns: int | None = None
    radar: bool = False
    tolerance_m: float = 2e-5
    any_order: bool = False

    def __len__(self) -> int:
        return len(self.world_m)


@dataclass(frozen=True, eq=False, kw_only=True)
class BoxTruth:
    """One box in the world, with its size as length, width, height."""

    track: str
    original: str
    ours: str | None
    centre_m: np.ndarray
    size_m: np.ndarray
    rotation: np.ndarray
    velocity_m_s: np.ndarray | None = None
    points: int | None = None
    attribute: str | None = None
    moving: bool | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class FrameTruth:
    """One frame: by which of its sensor's names each cloud goes, and where the vehicle is."""

    sequence: str | None
    frame_id: str | None
    time_ns: int | None
    clouds: dict[str, CloudTruth]
    boxes: Sequence[BoxTruth] | None
    world_T_ego: np.ndarray | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class Truth:
    """All frames of a tree in the order of sequence and time."""

    frames: Sequence[FrameTruth]
    tracked: bool = True
    has_velocity: bool = False
    numbered_classes: bool = False


def frame_pose(frame: Any, truth: FrameTruth) -> np.ndarray:
    """World of the truth to a reader's frame: by its own pose, which must be the vehicle's but for where it begins."""
    if truth.world_T_ego is None:
        return np.eye(4)
    pose = frame.world_T_frame
    assert pose is not None, "the format has poses, the frame has none"
    ego_T_frame = np.linalg.inv(truth.world_T_ego) @ pose
    assert ego_T_frame[0, 0] > 0.96, f"x of the frame is not forward: {ego_T_frame[:3, :3].round(3).tolist()}"
    assert ego_T_frame[2, 2] > 0.96, f"z of the frame is not up: {ego_T_frame[:3, :3].round(3).tolist()}"
    assert np.linalg.norm(ego_T_frame[:3, 3]) < 6, f"the frame begins {ego_T_frame[:3, 3]} m from the vehicle"
    return pose


def check_frame(frame: Any, truth: FrameTruth, whole: Truth) -> None:
    """Hold everything that a reader gives of one frame against the truth."""
    if truth.frame_id is not None:
        assert frame.frame_id == truth.frame_id
    if truth.sequence is not None:
        assert truth.sequence in frame.sequence, f"sequence {frame.sequence!r}, of {truth.sequence!r}"
    if truth.time_ns is not None:
        assert frame.time_ns == truth.time_ns, f"time {frame.time_ns} in place of {truth.time_ns}"
    world_T_frame = frame_pose(frame, truth)
    for name, cloud in truth.clouds.items():
        check_cloud(frame, name, cloud, world_T_frame)
    check_boxes(frame, truth, whole, world_T_frame)


def named_cloud(frame: Any, name: str, truth: CloudTruth) -> tuple[str, Any]:
    """A reader's cloud of a sensor: by its name, or by its number of points, which no other sensor has."""
    wanted = name.lower().replace("-", "_")
    for own in frame.clouds:
        if own.lower().replace("-", "_") == wanted:
            return own, frame.cloud(own)
    sizes = {own: len(frame.cloud(own)) for own in frame.clouds}
    matching = [own for own, size in sizes.items() if size == len(truth)]
    assert matching, f"no cloud {name} of {len(truth)} points; there are {sizes}"
    return matching[0], frame.cloud(matching[0])


def check_cloud(frame: Any, name: str, truth: CloudTruth, world_T_frame: np.ndarray) -> None:
    """Places, intensities, columns and times of one cloud."""
    own, cloud = named_cloud(frame, name, truth)
    assert len(cloud) == len(truth), f"{name}: {len(cloud)} points in place of {len(truth)}"
    sensor = frame.sensors[own]
    assert sensor.kind == ("radar" if truth.radar else "lidar"), f"{name} is a {sensor.kind}"
    points = cloud.points_m.astype(np.float64)
    if not sensor.in_frame:
        points = points @ sensor.frame_T_sensor[:3, :3].T + sensor.frame_T_sensor[:3, 3]
    expected = apply(np.linalg.inv(world_T_frame), truth.world_m)
    if truth.any_order:
        apart_m, order = cKDTree(points).query(expected)
        assert len(set(order.tolist())) == len(expected), f"{name}: {float(apart_m.max()):.6g} m from any of its points"
        points, cloud = points[order], cloud[order]
    near(points, expected, truth.tolerance_m, f"{name}: points")
    if truth.intensity is not None:
        assert cloud.intensity is not None, f"{name}: no intensity"
        near(cloud.intensity, truth.intensity, 1e-6, f"{name}: intensity")
    for column, values in truth.columns.items():
        assert column in cloud.extra, f"{name}: no column {column}; there are {cloud.columns}"
        near(np.asarray(cloud.extra[column], dtype=np.float64), values, 1e-5, f"{name}: {column}")
    rows = {column: np.asarray(values, dtype=np.float64) for column, values in cloud.extra.items() if values.ndim == 1}
    for what, units in truth.held.items():
        assert any(alike(row, unit) for row in rows.values() for unit in units), f"{name}: no {what} in {list(rows)}"
    for what, vectors in truth.vectors.items():
        turned = vectors @ (world_T_frame[:3, :3] if sensor.in_frame else world_T_frame[:3, :3] @ turn_of(sensor))
        for axis in (0, 1):
            present = any(alike(row, turned[:, axis]) for row in rows.values())
            assert present, f"{name}: {'xy'[axis]} of {what} is in none of {list(rows)}"
    if truth.offsets_s is not None:
        offsets = cloud.offsets_s()
        assert offsets is not None, f"{name}: no times of points; columns {cloud.columns}"
        near(offsets, truth.offsets_s, 2e-6, f"{name}: times of points")
    if truth.time_ns is not None:
        assert abs(frame.time_ns_of(own) - truth.time_ns) < 1000, f"{name}: {frame.time_ns_of(own)}, {truth.time_ns}"


def turn_of(sensor: Any) -> np.ndarray:
    """How a sensor's axes lie in the frame."""
    return np.asarray(sensor.frame_T_sensor)[:3, :3]


def alike(actual: np.ndarray, expected: np.ndarray) -> bool:
    """Whether a column holds what it has to."""
    return len(actual) == len(expected) and bool(np.allclose(actual, expected, rtol=1e-6, atol=2e-5))


def check_boxes(frame: Any, truth: FrameTruth, whole: Truth, world_T_frame: np.ndarray) -> None:
    """All of the boxes: places, sizes, headings, classes, counts of points, velocities, attributes."""
    if truth.boxes is None:
        assert frame.annotation is None
        return
    annotation = frame.annotation
    assert annotation is not None, "not annotated"
    boxes, expected = annotation.boxes, list(truth.boxes)
    assert len(boxes) == len(expected), f"{len(boxes)} boxes in place of {len(expected)}"
    frame_T_world = np.linalg.inv(world_T_frame)
    centres = apply(frame_T_world, np.array([box.centre_m for box in expected]).reshape(-1, 3))
    rows = [int(np.argmin(np.linalg.norm(boxes.centre_m - centre, axis=1))) for centre in centres]
    assert len(set(rows)) == len(rows), "two boxes of the truth lie nearest to one"
    for row, centre, box in zip(rows, centres, expected, strict=True):
        where = f"box {box.track}"
        near(boxes.centre_m[row], centre, 2e-5, f"{where}: centre")
        near(boxes.size_m[row], box.size_m, 1e-6, f"{where}: size")
        heading = frame_T_world[:3, :3] @ box.rotation[:, 0]
        turn = boxes.yaw_rad[row] - np.arctan2(heading[1], heading[0])
        near(np.mod(turn + np.pi, 2 * np.pi) - np.pi, 0.0, 1e-6, f"{where}: yaw")
        if annotation.original_label is not None:
            spelled = annotation.original_label[row]
            alike_words = box.original.lower() in spelled.lower() if whole.numbered_classes else spelled == box.original
            assert alike_words, f"{where}: {spelled!r} in place of {box.original!r}"
        if box.ours is not None:
            assert boxes.label[row] == box.ours, f"{where}: {box.original} is {boxes.label[row]}"
        if box.points is not None and boxes.point_count is not None:
            assert boxes.point_count[row] == box.points, f"{where}: {boxes.point_count[row]}, {box.points} points"
        if box.points is not None:
            assert boxes.point_count is not None, "no counts of points, though the format has them"
        if whole.has_velocity:
            assert boxes.velocity_m_s is not None, "no velocities"
            check_velocity(boxes.velocity_m_s[row], box, frame_T_world, where)
        if box.moving is not None:
            assert annotation.moving is not None, "nothing says what moves"
            assert bool(annotation.moving[row]) == box.moving, f"{where}: moving {annotation.moving[row]}"
        if box.attribute is not None:
            words = [str(value) for values in annotation.details.values() for value in np.atleast_1d(values[row])]
            assert any(box.attribute in word for word in words), f"{where}: no {box.attribute} in {words}"


def check_velocity(actual: np.ndarray, box: BoxTruth, frame_T_world: np.ndarray, where: str) -> None:
    """The velocity of a box, NaN where it is not known."""
    if box.velocity_m_s is None:
        assert np.isnan(actual[:2]).all(), f"{where}: velocity {actual}, which cannot be known"
        return
    moved = frame_T_world[:3, :3] @ box.velocity_m_s
    near(actual[:2], moved[:2], 1e-4, f"{where}: velocity")


def check_dataset(data: Any, truth: Truth) -> None:
    """Hold a whole data set against the truth: its frames, tracks, and its drives without building a frame."""
    assert len(data) == len(truth.frames), f"{len(data)} frames in place of {len(truth.frames)}"
    tracks: dict[tuple[str, str], set[int]] = {}
    for frame, expected in zip(data, truth.frames, strict=True):
        check_frame(frame, expected, truth)
        if truth.tracked and expected.boxes:
            assert frame.boxes.track_id is not None, "no tracks"
            centres = apply(
                np.linalg.inv(frame_pose(frame, expected)), np.array([box.centre_m for box in expected.boxes])
            )
            for centre, box in zip(centres, expected.boxes, strict=True):
                row = int(np.argmin(np.linalg.norm(frame.boxes.centre_m - centre, axis=1)))
                tracks.setdefault((expected.sequence or "", box.track), set()).add(int(frame.boxes.track_id[row]))
    assert all(len(numbers) == 1 for numbers in tracks.values()), f"a track with several numbers: {tracks}"
    by_sequence: dict[str, list[int]] = {}
    for (sequence, _), numbers in tracks.items():
        by_sequence.setdefault(sequence, []).extend(numbers)
    assert all(len(numbers) == len(set(numbers)) for numbers in by_sequence.values()), "two tracks with one number"
    check_drives(data, truth)


def check_drives(data: Any, truth: Truth) -> None:
    """Times and poses of the drives."""
    if any(frame.sequence is None for frame in truth.frames):
        return
    drives = data.drives()
    assert len(drives) == len({frame.sequence for frame in truth.frames}), f"drives {[drive.name for drive in drives]}"
    for drive in drives:
        frames = [truth.frames[index] for index in drive.indices]
        if all(frame.time_ns is not None for frame in frames):
            assert drive.times_ns is not None, "a drive without times"
            assert drive.times_ns.tolist() == [frame.time_ns for frame in frames]
        if all(frame.world_T_ego is not None for frame in frames):
            assert drive.world_T_frame is not None, "a drive without poses"
            for pose, index in zip(drive.world_T_frame, drive.indices, strict=True):
                near(pose, data[int(index)].world_T_frame, 1e-9, "pose of the drive")


def counted(points_m: np.ndarray, box: BoxTruth) -> int:
    """How many points of the world lie in a box, in float64."""
    local = (points_m - box.centre_m) @ box.rotation
    return int((np.abs(local) <= box.size_m / 2).all(axis=1).sum())


def apply(target_T_source: np.ndarray, points_m: np.ndarray) -> np.ndarray:
    """Move points rigidly."""
    return points_m @ target_T_source[:3, :3].T + target_T_source[:3, 3]


def near(actual: Any, expected: Any, tolerance: float, what: str) -> None:
    """Two arrays are alike to a tolerance, beside what float32 holds."""
    actual, expected = np.asarray(actual, dtype=np.float64), np.asarray(expected, dtype=np.float64)
    assert actual.shape == expected.shape, f"{what}: shape {actual.shape} in place of {expected.shape}"
    worst = float(np.abs(actual - expected).max(initial=0.0))
    np.testing.assert_allclose(actual, expected, rtol=2e-7, atol=tolerance, err_msg=f"{what}, apart by {worst:.6g}")


def published_part(data: Any, name: str) -> Any:
    """A part as the authors published it: by name where it keeps sequences whole, else as a benchmark's."""
    try:
        return data.split(name, by="benchmark")
    except ConfigError:
        return data.split(name)


def open_recognised(path: Any) -> Any:
    """Open a tree by what it holds alone."""
    return ff.open_dataset(path)

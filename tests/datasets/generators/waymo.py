"""Waymo Open Dataset v2: parquet components with range images, whose geometry is worked out here from the definition.

Source: the dataclasses and the range image conversion of waymo-open-dataset v2 (Apache-2.0).
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .scene import THINGS, Scene, Thing, pose_of, rotation_x, rotation_y, rotation_z, tiny_jpeg, visible
from .truth import BoxTruth, CloudTruth, FrameTruth, Truth, apply, counted

START_US = 1_553_629_304_740_114
SEGMENTS = {
    "1024360143612057520_3580_000_3600_000": Scene(31, (-5313.5, 2710.25, 41.5), 0.7),
    "10203656353524179475_7625_000_7645_000": Scene(32, (12_011.75, -8803.0, -12.25), -1.9),
}
LASERS = {  # laser name: vehicle_T_laser, rows, columns
    1: (pose_of(rotation_z(0.35) @ rotation_y(0.01), (1.43, 0.02, 2.18)), 24, 900),
    2: (pose_of(rotation_z(-0.02), (4.07, 0.1, 0.69)), 9, 130),
    3: (pose_of(rotation_z(1.6), (3.24, 1.02, 0.98)), 8, 120),
    4: (pose_of(rotation_z(-1.55) @ rotation_x(0.02), (3.24, -1.02, 0.98)), 8, 110),
    5: (pose_of(rotation_z(3.13), (-1.15, 0.01, 0.46)), 7, 100),
}
TYPES = {"car": (1, "vehicle"), "truck": (1, "vehicle"), "pedestrian": (2, "pedestrian"), "bicycle": (4, "bicycle")}
WORDS = {1: "vehicle", 2: "pedestrian", 3: "sign", 4: "cyclist"}


def write_waymo(root: Path, *, part: str = "validation", frames: int = 3) -> Truth:
    """Two segments in the tree of v2."""
    truths: list[FrameTruth] = []
    for segment, scene in sorted(SEGMENTS.items()):
        truths += write_segment(root / part, segment, scene, frames)
    return Truth(frames=truths, numbered_classes=True)


def write_segment(root: Path, segment: str, scene: Scene, frames: int) -> list[FrameTruth]:
    """All components of one segment."""
    rows: dict[str, list[dict[str, Any]]] = {}
    truths = []
    for number in range(frames):
        time_us = START_US + number * 100_013
        time_s = (time_us - START_US) * 1e-6
        keys = {"key.segment_context_name": segment, "key.frame_timestamp_micros": time_us}
        pose = scene.world_T_ego(time_s)
        rows.setdefault("vehicle_pose", []).append(
            {**keys, "[VehiclePoseComponent].world_from_vehicle.transform": pose.ravel().tolist()}
        )
        boxes = [upright(scene, thing, time_s, pose) for thing in visible(THINGS, number)]
        clouds, points = {}, []
        for laser in LASERS:
            cloud, row, pixel_poses = sweep(scene, laser, time_s, boxes, number)
            clouds[f"laser {laser}"] = cloud
            points.append(cloud.world_m)
            rows.setdefault("lidar", []).append({**keys, "key.laser_name": laser, **row})
            if pixel_poses is not None:
                rows.setdefault("lidar_pose", []).append({**keys, "key.laser_name": laser, **pixel_poses})
        world = np.concatenate(points)
        boxes = [BoxTruth(**{**vars(box), "points": counted(world, box)}) for box in boxes]
        for box in boxes:
            rows.setdefault("lidar_box", []).append({**keys, **box_row(box, pose)})
        rows.setdefault("camera_image", []).append(
            {
                **keys,
                "key.camera_name": 1,
                "[CameraImageComponent].image": tiny_jpeg(),
                "[CameraImageComponent].pose.transform": pose.ravel().tolist(),
                "[CameraImageComponent].pose_timestamp": time_us * 1e-6,
            }
        )
        truths.append(
            FrameTruth(
                sequence=segment, frame_id=None, time_ns=time_us * 1000, clouds=clouds, boxes=boxes, world_T_ego=pose
            )
        )
    rows["lidar_calibration"] = [calibration(segment, laser) for laser in LASERS]
    rows["camera_calibration"] = [camera_calibration(segment)]
    for component, listed in rows.items():
        write_table(root / component / f"{segment}.parquet", listed)
    return truths


def inclinations(laser: int) -> np.ndarray:
    """Of the rows, from the highest down: uneven for the top laser, from limits for the others."""
    rows = LASERS[laser][1]
    if laser == 1:
        return np.sort(np.concatenate([np.linspace(-0.02, 0.03, rows - 8), np.linspace(-0.3, -0.03, 8)]))[::-1]
    low, high = limits(laser)
    return (low + (np.arange(rows) + 0.5) / rows * (high - low))[::-1]


def limits(laser: int) -> tuple[float, float]:
    """Lowest and highest inclination."""
    return (-0.31, 0.04) if laser == 1 else (-1.1, 0.5)


def sweep(
    scene: Scene, laser: int, time_s: float, boxes: Sequence[BoxTruth], number: int
) -> tuple[CloudTruth, dict[str, Any], dict[str, Any] | None]:
    """One laser's two range images, and where each of their pixels is in the world."""
    vehicle_T_laser, height, width = LASERS[laser]
    random = np.random.default_rng([scene.seed, laser, number])
    azimuth = ((width - np.arange(width) - 0.5) / width * 2 - 1) * np.pi - np.arctan2(
        vehicle_T_laser[1, 0], vehicle_T_laser[0, 0]
    )
    up = inclinations(laser)[:, None]
    rays = np.stack(
        [np.cos(azimuth) * np.cos(up), np.sin(azimuth) * np.cos(up), np.broadcast_to(np.sin(up), (height, width))], -1
    )
    poses = np.broadcast_to(scene.world_T_ego(time_s), (height, width, 4, 4))
    held = None
    if laser == 1:
        late = (np.arange(width) / width - 0.5) * 0.1
        numbers = np.array([euler(scene.world_T_ego(time_s + seconds)) for seconds in late]).astype("f4")
        turned = np.array([from_euler(row.astype(np.float64)) for row in numbers])
        poses = np.broadcast_to(turned[None], (height, width, 4, 4))
        held = np.broadcast_to(numbers[None], (height, width, 6))
    origins = np.einsum("hwij,j->hwi", poses, vehicle_T_laser[:, 3])[..., :3]
    turns = poses[..., :3, :3] @ vehicle_T_laser[:3, :3]
    directions = np.einsum("hwij,hwj->hwi", turns, rays)
    ranges = np.where(random.uniform(size=(height, width)) < 0.04, random.uniform(40, 70, (height, width)), -1.0)
    for box in boxes:
        if box.track != "unseen car":
            entry = entered(origins, directions, box)
            ranges = np.where(np.isfinite(entry), entry, ranges)
    images, worlds, columns = {}, [], []
    for back in (1, 2):
        image = np.zeros((height, width, 4), "f4")
        image[..., 0] = (
            ranges
            if back == 1
            else np.where((ranges > 0) & (random.uniform(size=ranges.shape) < 0.2), ranges + 3.5, -1)
        )
        image[..., 1] = np.where(image[..., 0] > 0, random.uniform(0, 1, ranges.shape), 0)
        image[..., 2] = np.where(image[..., 0] > 0, random.uniform(0, 1.4, ranges.shape), 0)
        image[..., 3] = -1
        valid = image[..., 0] > 0
        images[back] = image
        worlds.append((origins + directions * image[..., :1].astype(np.float64))[valid])
        columns.append(image[valid])
    row = {}
    for back, image in images.items():
        row[f"[LiDARComponent].range_image_return{back}.values"] = image.ravel()
        row[f"[LiDARComponent].range_image_return{back}.shape"] = list(image.shape)
    pixel_poses = None
    if held is not None:
        pixel_poses = {
            "[LiDARPoseComponent].range_image_return1.values": np.ascontiguousarray(held).ravel(),
            "[LiDARPoseComponent].range_image_return1.shape": list(held.shape),
        }
    pixels = np.concatenate(columns).astype(np.float64)
    truth = CloudTruth(
        world_m=np.concatenate(worlds), held={"elongation": [pixels[:, 2]]}, any_order=True, tolerance_m=3e-4
    )
    return truth, row, pixel_poses


def entered(origins: np.ndarray, directions: np.ndarray, box: BoxTruth) -> np.ndarray:
    """How far along each ray a point within a box is, a little behind where it enters; NaN where it misses."""
    start = (origins - box.centre_m) @ box.rotation
    along = directions @ box.rotation
    half = box.size_m * 0.46
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.stack([(-half - start) / along, (half - start) / along])
    near, far = ends.min(0).max(-1), ends.max(0).min(-1)
    return np.where((near < far) & (near > 0), near + 0.3 * (far - near), np.nan)


def euler(pose: np.ndarray) -> list[float]:
    """Roll, pitch, yaw (turned about z, then y, then x), x, y, z."""
    r = pose[:3, :3]
    return [
        float(np.arctan2(r[2, 1], r[2, 2])),
        float(np.arcsin(-r[2, 0])),
        float(np.arctan2(r[1, 0], r[0, 0])),
        *pose[:3, 3].tolist(),
    ]


def from_euler(values: np.ndarray) -> np.ndarray:
    """The pose of these."""
    roll, pitch, yaw = values[:3]
    return pose_of(rotation_z(yaw) @ rotation_y(pitch) @ rotation_x(roll), values[3:])


def upright(scene: Scene, thing: Thing, time_s: float, pose: np.ndarray) -> BoxTruth:
    """A box that stands upright in the vehicle's own axes."""
    kind, ours = TYPES[thing.kind]
    heading = pose[:3, :3].T @ scene.rotation_of(thing)[:, 0]
    return BoxTruth(
        track=thing.track,
        original=WORDS[kind],
        ours=ours,
        centre_m=scene.centre_of(thing, time_s),
        size_m=np.array(thing.size_m),
        rotation=pose[:3, :3] @ rotation_z(np.arctan2(heading[1], heading[0])),
    )


def box_row(box: BoxTruth, pose: np.ndarray) -> dict[str, Any]:
    """A row of lidar_box."""
    centre = apply(np.linalg.inv(pose), box.centre_m)
    heading = pose[:3, :3].T @ box.rotation[:, 0]
    prefix = "[LiDARBoxComponent]"
    number = {word: kind for kind, word in WORDS.items()}[box.original]
    return {
        "key.laser_object_id": f"id {box.track}",
        **{f"{prefix}.box.center.{axis}": float(value) for axis, value in zip("xyz", centre, strict=True)},
        **{f"{prefix}.box.size.{axis}": float(value) for axis, value in zip("xyz", box.size_m, strict=True)},
        f"{prefix}.box.heading": float(np.arctan2(heading[1], heading[0])),
        f"{prefix}.type": number,
        f"{prefix}.num_lidar_points_in_box": box.points,
        f"{prefix}.num_top_lidar_points_in_box": 0,
        f"{prefix}.difficulty_level.detection": 2 if (box.points or 0) <= 5 else 0,
        f"{prefix}.difficulty_level.tracking": 0,
    }


def calibration(segment: str, laser: int) -> dict[str, Any]:
    """A row of lidar_calibration; the values of inclination rise, rows of the image fall."""
    prefix = "[LiDARCalibrationComponent]"
    low, high = limits(laser)
    return {
        "key.segment_context_name": segment,
        "key.laser_name": laser,
        f"{prefix}.extrinsic.transform": LASERS[laser][0].ravel().tolist(),
        f"{prefix}.beam_inclination.min": low,
        f"{prefix}.beam_inclination.max": high,
        f"{prefix}.beam_inclination.values": inclinations(laser)[::-1].tolist() if laser == 1 else None,
    }


def camera_calibration(segment: str) -> dict[str, Any]:
    """The front camera: its extrinsic has x ahead, y left, z up, as Waymo's cameras."""
    prefix = "[CameraCalibrationComponent]"
    lens = {"f_u": 12.0, "f_v": 12.0, "c_u": 8.0, "c_v": 6.0, "k1": 0.01, "k2": -0.1, "p1": 0.001, "p2": 0.0, "k3": 0.0}
    return {
        "key.segment_context_name": segment,
        "key.camera_name": 1,
        **{f"{prefix}.intrinsic.{name}": value for name, value in lens.items()},
        f"{prefix}.extrinsic.transform": pose_of(rotation_z(0.01), (1.54, -0.02, 2.11)).ravel().tolist(),
        f"{prefix}.width": 16,
        f"{prefix}.height": 12,
        f"{prefix}.rolling_shutter_direction": 2,
    }


def write_table(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Rows as parquet, a row group a few rows, with the types that v2 has."""
    import pyarrow as pa
    from pyarrow import parquet

    columns = {}
    for name in rows[0]:
        values = [row[name] for row in rows]
        columns[name] = pa.array(values, type_of(name, pa))
    path.parent.mkdir(parents=True, exist_ok=True)
    parquet.write_table(pa.table(columns), path, row_group_size=7)


def type_of(name: str, pa: Any) -> Any:
    """The type of a column."""
    if name == "key.segment_context_name" or name == "key.laser_object_id":
        return pa.string()
    if name == "key.frame_timestamp_micros":
        return pa.int64()
    if name.startswith("key.") or name.endswith((".type", ".detection", ".tracking", "_direction")):
        return pa.int8()
    if name.endswith(".image"):
        return pa.binary()
    if name.endswith(".shape"):
        return pa.list_(pa.int32())
    if "range_image" in name:
        return pa.list_(pa.float32())
    if name.endswith(("transform", "inclination.values")):
        return pa.list_(pa.float64())
    return pa.int32() if name.endswith(("_in_box", ".width", ".height")) else pa.float64()

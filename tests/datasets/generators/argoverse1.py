"""Argoverse 1's tracking set: PLY sweeps, a JSON of boxes a sweep, poses of the city.

Source: the loaders of argoverse-api (MIT).
"""

import json
import uuid
from pathlib import Path

import numpy as np

from .scene import Scene, pose_of, quaternion, rotation_z, strengths, tiny_jpeg
from .truth import CloudTruth, FrameTruth, Truth, apply

LOGS = {
    "c6911883-1843-3727-8eaa-41dc8cda8993": (Scene(71, (2573.25, 1205.5, 18.25), 1.0), "f4", True),
    "10b8dee6-778f-33e4-a946-d842d2d9c3d7": (Scene(72, (-411.5, 3307.75, -7.5), -2.7), "f8", False),
}
START_NS = 315_969_904_359_876_000
NAMES = {
    "car": ("VEHICLE", "vehicle"),
    "truck": ("LARGE_VEHICLE", "large_vehicle"),
    "bicycle": ("BICYCLE", "bicycle"),
    "pedestrian": ("PEDESTRIAN", "pedestrian"),
}


def write_argoverse1(root: Path, *, frames: int = 3) -> Truth:
    """Two logs: one with classes as objects and coordinates in float32, one with texts and float64."""
    truths = []
    for log, (scene, dtype, nested) in sorted(LOGS.items()):
        base = root / log
        for sub in ("lidar", "per_sweep_annotations_amodal", "poses", "ring_front_center"):
            (base / sub).mkdir(parents=True)
        (base / "city_info.json").write_text('{"city_name": "PIT"}')
        (base / "vehicle_calibration_info.json").write_text(json.dumps(calibration()))
        for number in range(frames):
            time_s, time_ns = number * 0.1, START_NS + number * 100_000_000
            pose = scene.world_T_ego(time_s)
            world = scene.points(number, time_s, 80, clutter=39)
            held = apply(np.linalg.inv(pose), world).astype(dtype)
            exact = apply(pose, held.astype(np.float64))
            intensity = strengths(len(held), number)
            lasers = np.arange(len(held)) % 32
            write_ply(base / f"lidar/PC_{time_ns}.ply", held, intensity, lasers)
            turned = {"rotation": quaternion(pose[:3, :3]), "translation": pose[:3, 3].tolist()}
            (base / f"poses/city_SE3_egovehicle_{time_ns}.json").write_text(json.dumps(turned))
            boxes = scene.boxes(number, time_s, NAMES)
            labels = []
            for box in boxes:
                centre = apply(np.linalg.inv(pose), box.centre_m)
                turn = quaternion(pose[:3, :3].T @ box.rotation)
                length, width, height = box.size_m.tolist()
                labels.append(
                    {
                        "center": dict(zip("xyz", centre.tolist(), strict=True)),
                        "rotation": dict(zip("wxyz", turn, strict=True)),
                        "length": length,
                        "width": width,
                        "height": height,
                        "track_label_uuid": str(uuid.uuid5(uuid.NAMESPACE_URL, box.track)),
                        "occlusion": 0,
                        "on_driveable_surface": False,
                        "key_frame": True,
                        "stationary": False,
                        "timestamp": time_ns,
                        "label_class": {"name": box.original} if nested else box.original,
                    }
                )
            name = f"per_sweep_annotations_amodal/tracked_object_labels_{time_ns}.json"
            (base / name).write_text(json.dumps(labels))
            (base / f"ring_front_center/ring_front_center_{time_ns + 7_000_000}.jpg").write_bytes(tiny_jpeg())
            cloud = CloudTruth(world_m=exact, intensity=intensity / 255, held={"laser": [lasers]})
            truths.append(
                FrameTruth(
                    sequence=log, frame_id=None, time_ns=time_ns, clouds={"lidar": cloud}, boxes=boxes, world_T_ego=pose
                )
            )
    return Truth(frames=truths)


def write_ply(path: Path, held: np.ndarray, intensity: np.ndarray, lasers: np.ndarray) -> None:
    """A binary PLY."""
    number = held.dtype.str[1:]
    table = np.zeros(
        len(held), [("x", f"<{number}"), ("y", f"<{number}"), ("z", f"<{number}"), ("intensity", "u1"), ("laser", "u1")]
    )
    table["x"], table["y"], table["z"] = held.T
    table["intensity"], table["laser"] = intensity, lasers
    word = {"f4": "float", "f8": "double"}[number]
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(held)}"]
    lines += [f"property {word} {axis}" for axis in "xyz"] + ["property uchar intensity", "property uchar laser_number"]
    path.write_bytes(("\n".join([*lines, "end_header"]) + "\n").encode() + table.tobytes())


def calibration() -> dict[str, object]:
    """One camera and the two LiDARs."""
    axes = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    mount = pose_of(rotation_z(0.01) @ axes, (1.63, 0.0, 1.4))
    placed = {
        "rotation": {"coefficients": quaternion(mount[:3, :3])},
        "translation": mount[:3, 3].tolist(),
    }
    lens = {
        "focal_length_x_px_": 12.0,
        "focal_length_y_px_": 12.0,
        "focal_center_x_px_": 8.0,
        "focal_center_y_px_": 6.0,
        "skew_": 0.0,
        "distortion_coefficients_": [-0.1, 0.05, 0.01],
        "vehicle_SE3_camera_": placed,
    }
    level = {"rotation": {"coefficients": [1.0, 0.0, 0.0, 0.0]}, "translation": [1.35, 0.0, 1.64]}
    return {
        "camera_data_": [{"key": "image_raw_ring_front_center", "value": lens}],
        "vehicle_SE3_down_lidar_": level,
        "vehicle_SE3_up_lidar_": level,
    }

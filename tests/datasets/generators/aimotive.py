"""aiMotive's multimodal data set: LAS or LAZ clouds, boxes and radar targets as JSON, all in the body's axes.

Source: what was measured on its sample files (their code has another licence and was not read).
"""

import json
import struct
from pathlib import Path

import numpy as np

from .scene import THINGS, Scene, pose_of, quaternion, rotation_z, strengths, tiny_jpeg
from .truth import BoxTruth, CloudTruth, FrameTruth, Truth, apply

DRIVE = "20220127-153512-00.18.45-00.19.00@Jarvis"
START_NS = 4_833_189_570_000
NAMES = {
    "car": ("CAR", "vehicle"),
    "truck": ("TRUCK", "large_vehicle"),
    "bicycle": ("BICYCLE", "bicycle"),
    "pedestrian": ("PEDESTRIAN", "pedestrian"),
}
RADARS = {
    "F_LRR_C": pose_of(rotation_z(0.01), (3.6, 0.05, 0.5)),
    "B_LRR_C": pose_of(rotation_z(np.pi - 0.02), (-1.0, -0.04, 0.6)),
}
CAMERAS = ("F_MIDLONGRANGECAM_CL", "B_MIDRANGECAM_C", "M_FISHEYE_L", "M_FISHEYE_R")


def write_aimotive(root: Path, *, packed: bool = False, frames: int = 3) -> Truth:
    """One drive.

    Args:
        root: The folder.
        packed: Whether the clouds are LAZ, for which laspy and lazrs are needed; else LAS.
        frames: Numbered from 33643.
    """
    base = root / "data" / "train" / "highway" / DRIVE
    scene = Scene(61, level=True, still=False)
    truths = []
    write_calibration(base / "sensor/calibration")
    for row in range(frames):
        number, time_s = 33_643 + row, row * 0.1
        body_T_world = np.linalg.inv(scene.world_T_ego(time_s))
        points = apply(body_T_world, scene.points(row, time_s, 70, clutter=73))
        path = base / f"dynamic/raw-revolutions/frame_{number:07d}.{'laz' if packed else 'las'}"
        cloud = write_las(path, points, START_NS + round(time_s * 1e9), row, packed=packed)
        boxes = [moved(box, body_T_world) for box in scene.boxes(row, time_s, NAMES)]
        write_boxes(base / f"dynamic/box/3d_body/frame_{number:07d}.json", boxes, START_NS + round(time_s * 1e9))
        clouds = {"lidar": cloud}
        for salt, name in enumerate(RADARS):
            target = base / f"sensor/radar/{name}/{name}_{number:07d}.json"
            clouds[name] = write_radar(target, name, points, 12 + 7 * salt, row)
        for name in CAMERAS:
            picture = base / f"sensor/camera/{name}/{name}_{number:07d}.jpg"
            picture.parent.mkdir(parents=True, exist_ok=True)
            picture.write_bytes(tiny_jpeg())
        truths.append(FrameTruth(sequence=DRIVE, frame_id=None, time_ns=None, clouds=clouds, boxes=boxes))
    return Truth(frames=truths)


def moved(box: BoxTruth, target_T_world: np.ndarray) -> BoxTruth:
    """A box in other coordinates."""
    turn = target_T_world[:3, :3]
    centre = apply(target_T_world, box.centre_m)
    return BoxTruth(**{**vars(box), "centre_m": centre, "rotation": turn @ box.rotation, "velocity_m_s": None})


def write_las(path: Path, points: np.ndarray, time_ns: int, salt: int, *, packed: bool) -> CloudTruth:
    """A cloud in LAS 1.2, point format 1, millimetres; times in nanoseconds."""
    count = len(points)
    table = np.zeros(
        count,
        [
            ("place", "<i4", 3),
            ("intensity", "<u2"),
            ("flags", "u1"),
            ("class", "u1"),
            ("angle", "i1"),
            ("user", "u1"),
            ("source", "<u2"),
            ("gps_time", "<f8"),
        ],
    )
    table["place"] = np.round(points * 1000)
    table["intensity"] = strengths(count, salt, 254)
    table["gps_time"] = time_ns - 50_000_000 + np.linspace(0, 100_249_000, count).round()
    exact = table["place"] * 0.001
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(las_header(count, exact) + table.tobytes())
    if packed:
        import laspy

        cloud = laspy.read(path.rename(path.with_suffix(".las")))
        cloud.write(path)
        path.with_suffix(".las").unlink()
    offsets = [(table["gps_time"] - time_ns) * factor for factor in (1, 1e-3, 1e-9)]
    held = {"times": [*offsets, table["gps_time"] - table["gps_time"].min(), table["gps_time"]]}
    return CloudTruth(world_m=exact, intensity=table["intensity"] / 255, held=held)


def las_header(count: int, places_m: np.ndarray, *, scale: float = 0.001) -> bytes:
    """The 227 bytes of LAS 1.2."""
    low, high = places_m.min(0), places_m.max(0)
    return struct.pack(
        "<4sHH16sBB32s32sHHHIIBHI5I12d",
        b"LASF",
        0,
        0,
        b"",
        1,
        2,
        b"OTHER",
        b"farfield tests",
        1,
        2022,
        227,
        227,
        0,
        1,
        28,
        count,
        count,
        0,
        0,
        0,
        0,
        scale,
        scale,
        scale,
        0.0,
        0.0,
        0.0,
        high[0],
        low[0],
        high[1],
        low[1],
        high[2],
        low[2],
    )


def write_boxes(path: Path, boxes: list[BoxTruth], time_ns: int) -> None:
    """The objects of a frame."""
    path.parent.mkdir(parents=True, exist_ok=True)
    objects = []
    for number, box in enumerate(boxes):
        entry: dict[str, object] = {
            "ActorName": f"{box.original}_{number}",
            "ObjectId": 100 + [thing.track for thing in THINGS].index(box.track),
            "ObjectType": box.original,
            "Occluded": number % 3,
            "Truncated": 0,
        }
        for axis, place, extent in zip("XYZ", box.centre_m, box.size_m, strict=True):
            entry[f"BoundingBox3D Origin {axis}"] = float(place)
            entry[f"BoundingBox3D Extent {axis}"] = float(extent)
            entry[f"Relative Velocity {axis}"] = 0.25
        for axis, value in zip("WXYZ", quaternion(box.rotation), strict=True):
            entry[f"BoundingBox3D Orientation Quat {axis}"] = value
        objects.append(entry)
    path.write_text(json.dumps({"CapturedObjects": objects, "Timestamp": str(time_ns)}))


def write_radar(path: Path, name: str, points: np.ndarray, count: int, salt: int) -> CloudTruth:
    """Targets of a radar at places of the LiDAR's."""
    random = np.random.default_rng([salt, count])
    local = apply(np.linalg.inv(RADARS[name]), points)
    ahead = local[(local[:, 0] > 5) & (np.abs(np.arctan2(local[:, 1], local[:, 0])) < 0.9)]
    chosen = ahead[random.choice(len(ahead), count, replace=False)]
    range_m = np.linalg.norm(chosen, axis=1)
    azimuth, elevation = np.arctan2(chosen[:, 1], chosen[:, 0]), np.arcsin(chosen[:, 2] / range_m)
    speed, rcs = random.uniform(-30, 30, count), random.uniform(0.15, 122, count)
    targets = [
        {"azimuth": a, "elevation": e, "range": r, "speed": s, "rcs": c, "power": 40.0 + n, "noise": 5.0}
        for n, (a, e, r, s, c) in enumerate(np.column_stack([azimuth, elevation, range_m, speed, rcs]).tolist())
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"id": name, "targets": targets}))
    held = {"speed": [speed], "cross-section": [rcs], "power": [40.0 + np.arange(count)]}
    return CloudTruth(world_m=apply(RADARS[name], chosen), held=held, radar=True)


def both_ways(pose: np.ndarray) -> dict[str, object]:
    """A pose and its inverse."""
    return {"RT_body_from_sensor": pose.tolist(), "RT_sensor_from_body": np.linalg.inv(pose).tolist()}


def write_calibration(folder: Path) -> None:
    """Of radars and cameras."""
    folder.mkdir(parents=True)
    sensors: dict[str, dict[str, object]] = {}
    for name, pose in RADARS.items():
        sensors[name] = {"sensor_type": "radar", "label": name, **both_ways(pose)}
        sensors[name]["custom_vars"] = {"rotate_objects_by_180_degree": name.startswith("B")}
    sensors["M_LIDAR_M"] = {
        "sensor_type": "lidar",
        "label": "M_LIDAR_M",
        "rpm": "nan",
        **both_ways(pose_of(rotation_z(np.pi / 2), (1.16, 0.0, 1.68))),
    }
    sensors["Imu0"] = {"sensor_type": "imu_ins", "label": "Imu0", "pos_meter": [0.0, 0.0, 0.0]}
    axes = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    for turn, name in zip((0.0, np.pi, np.pi / 2, -np.pi / 2), CAMERAS, strict=True):
        pose = pose_of(rotation_z(turn) @ axes, (1.5, 0.0, 1.4))
        sensors[name] = {
            "sensor_type": "camera",
            "label": name,
            **both_ways(pose),
            "model": "opencv_pinhole" if "RANGE" in name else "mei",
            **({} if "RANGE" in name else {"xi": 1.02}),
            "focal_length_px": [12.0, 12.0],
            "principal_point_px": [8.0, 6.0],
            "distortion_coeffs": [0.0] * 5,
            "image_resolution_px": [16, 12],
        }
    (folder / "calibration.json").write_text(json.dumps(sensors))

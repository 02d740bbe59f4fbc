"""Zenseact Open Dataset, single frames: structured arrays, GeoJSON boxes in the LiDAR's axes (x right, y forward).

Source: the data classes of zenseact/zod (MIT).
"""

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from .scene import THINGS, Scene, pose_of, quaternion, rotation_x, rotation_z, seen, strengths, tiny_jpeg, visible
from .truth import BoxTruth, CloudTruth, FrameTruth, Truth

START = datetime(2022, 2, 14, 13, 23, 32, 251875, UTC)
POINT = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("timestamp", "<i8"), ("intensity", "u1"), ("diode_index", "u1")]
)
EGO_T_LIDAR = pose_of(rotation_z(-np.pi / 2) @ rotation_x(0.008), (0.61, 0.02, 2.05))
EGO_T_CAMERA = pose_of(
    np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]) @ rotation_x(0.01), (1.9, 0.03, 1.41)
)
NAMES = {
    "car": ("Vehicle", "Car", "vehicle"),
    "truck": ("Vehicle", "Truck", "large_vehicle"),
    "bicycle": ("VulnerableVehicle", "Bicycle", "bicycle"),
    "pedestrian": ("Pedestrian", "Pedestrian", "pedestrian"),
}
FRAMES = {"000000": 51, "000013": 52, "099999": 53}


def stamp(time: datetime) -> str:
    """A time as file names and JSON have it."""
    return time.strftime("%Y-%m-%dT%H:%M:%S.%fZ")


def write_zod(root: Path, *, sweeps: bool = False) -> Truth:
    """Three single frames of as many days, with the lists beside them.

    Args:
        root: The folder.
        sweeps: Whether the truth has the sweeps before and after too; the files are the same.
    """
    infos, truths = {}, []
    for number, (name, seed) in enumerate(FRAMES.items()):
        scene = Scene(seed, (12.5 * number, -3.25, 0.5), 0.4 + 1.3 * number)
        info, listed = write_frame(root, name, scene, START + timedelta(days=3 * number), number)
        infos[name] = info
        truths += listed if sweeps else listed[1:2]
    names = list(FRAMES)
    for size in ("full", "mini"):
        listed = {"train": [infos[name] for name in names[:2]], "val": [infos[names[2]]]}
        (root / f"trainval-frames-{size}.json").write_text(json.dumps(listed))
        (root / "splits").mkdir(exist_ok=True)
        (root / f"splits/frames_{size}_train.txt").write_text("\n".join(names[:2]) + "\n")
        (root / f"splits/frames_{size}_val.txt").write_text(names[2] + "\n")
    return Truth(frames=truths, tracked=False, numbered_classes=True)


def write_frame(
    root: Path, name: str, scene: Scene, time: datetime, number: int
) -> tuple[dict[str, Any], list[FrameTruth]]:
    """One frame: three sweeps of which the middle one is annotated."""
    folder = root / "single_frames" / name
    for sub in ("camera_front_blur", "lidar_velodyne", "annotations"):
        (folder / sub).mkdir(parents=True)
    sweeps, truths = [], []
    boxes = write_objects(folder / "annotations/object_detection.json", scene, number)
    for step in (-1, 0, 1):
        taken = time + timedelta(microseconds=step * 100_051)
        world_T_ego = scene.world_T_ego(step * 0.100051)
        world = scene.points(number, step * 0.100051, 60, clutter=47 + step)
        held, exact = seen(world, world_T_ego @ EGO_T_LIDAR)
        table = np.zeros(len(held), POINT)
        table["x"], table["y"], table["z"] = held.T
        table["intensity"], table["diode_index"] = strengths(len(held), step + 5), np.arange(len(held)) % 128
        table["timestamp"] = np.linspace(-50_021, 49_033, len(held)).astype(np.int64)
        path = f"single_frames/{name}/lidar_velodyne/{name}_quebec_{stamp(taken)}.npy"
        np.save(root / path, table)
        sweeps.append({"filepath": path, "time": stamp(taken), "is_compensated": False})
        cloud = CloudTruth(
            world_m=exact,
            intensity=table["intensity"] / 255,
            offsets_s=table["timestamp"] * 1e-6,
            held={"diode": [table["diode_index"], 127 - table["diode_index"]]},
        )
        truths.append(
            FrameTruth(
                sequence=name,
                frame_id=None,
                time_ns=(taken - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(microseconds=1) * 1000,
                clouds={"velodyne": cloud},
                boxes=boxes if step == 0 else None,
                world_T_ego=world_T_ego,
            )
        )
    picture = f"single_frames/{name}/camera_front_blur/{name}_quebec_{stamp(time)}.jpg"
    (root / picture).write_bytes(tiny_jpeg(32, 18))
    write_motion(folder, scene, time)
    info = {
        "id": name,
        "start_time": sweeps[0]["time"],
        "end_time": sweeps[-1]["time"],
        "keyframe_time": stamp(time),
        **{f"{what}_path": f"single_frames/{name}/{what}.json" for what in ("calibration", "ego_motion", "metadata")},
        "oxts_path": f"single_frames/{name}/oxts.hdf5",
        "vehicle_data_path": None,
        "annotations": {
            "object_detection": {
                "filepath": f"single_frames/{name}/annotations/object_detection.json",
                "project": "object_detection",
            }
        },
        "camera_frames": {"front_blur": [{"filepath": picture, "time": stamp(time), "height": 18, "width": 32}]},
        "lidar_frames": {"velodyne": sweeps},
    }
    (folder / "info.json").write_text(json.dumps(info))
    return info, truths


def write_objects(path: Path, scene: Scene, number: int) -> list[BoxTruth]:
    """The annotated objects, two of them without a box in space, and one that is unclear."""
    world_T_lidar = scene.world_T_ego(0.0) @ EGO_T_LIDAR
    lidar_T_world = np.linalg.inv(world_T_lidar)
    features, boxes = [], []
    for row, thing in enumerate(visible(THINGS, number)):
        original, kind, ours = NAMES[thing.kind]
        rotation = lidar_T_world[:3, :3] @ scene.rotation_of(thing)
        centre = lidar_T_world[:3, :3] @ scene.centre_of(thing, 0.0) + lidar_T_world[:3, 3]
        turned = dict(zip(("qw", "qx", "qy", "qz"), quaternion(rotation), strict=True))
        features.append(
            feature(
                f"{row:08d}-0000",
                original,
                type=kind,
                unclear=False,
                occlusion_ratio="Light",
                with_rider="True" if thing.kind == "bicycle" else "False",
                traffic_content_visible="False",
                location_3d={"type": "Point", "coordinates": centre.tolist()},
                **{
                    f"size_3d_{name}": size
                    for name, size in zip(("length", "width", "height"), thing.size_m, strict=True)
                },
                **{f"orientation_3d_{name}": value for name, value in turned.items()},
            )
        )
        boxes.append(
            BoxTruth(
                track=thing.track,
                original=original,
                ours=ours,
                centre_m=scene.centre_of(thing, 0.0),
                size_m=np.array(thing.size_m),
                rotation=scene.rotation_of(thing),
            )
        )
    features.insert(2, feature("flat-0000", "TrafficSign", unclear=False, traffic_content_visible="True"))
    features.append(feature("flat-0001", "Vehicle", type="Car", unclear=False, occlusion_ratio="Heavy"))
    path.write_text(json.dumps(features))
    return boxes


def feature(identity: str, name: str, **properties: Any) -> dict[str, Any]:
    """One object as GeoJSON."""
    points = [[10.0, 4.0], [12.0, 3.0], [15.5, 6.0], [11.0, 9.0]]
    return {
        "type": "Feature",
        "geometry": {"type": "MultiPoint", "coordinates": points},
        "properties": {"annotation_uuid": identity, "class": name, **properties},
    }


def write_motion(folder: Path, scene: Scene, time: datetime) -> None:
    """Calibration, poses at 100 Hz and words about the frame."""
    steps = np.sort(np.append(np.round(np.arange(-0.2, 0.2001, 0.01), 2), (-0.100051, 0.100051)))
    poses = [scene.world_T_ego(step).tolist() for step in steps]
    motion = {
        "poses": poses,
        **{key: [[0.0, 0.0, 0.0]] * len(steps) for key in ("velocities", "accelerations", "angular_rates")},
        "timestamps": [time.timestamp() + float(step) for step in steps],
        "origin_lat_lon": [57.7, 11.9],
    }
    (folder / "ego_motion.json").write_text(json.dumps(motion))
    lens = {
        "lidar_extrinsics": EGO_T_LIDAR.tolist(),
        "extrinsics": EGO_T_CAMERA.tolist(),
        "intrinsics": [[16.0, 0.0, 15.5, 0.0], [0.0, 16.0, 8.5, 0.0], [0.0, 0.0, 1.0, 0.0]],
        "distortion": [0.01, -0.02, 0.003, -0.0004],
        "undistortion": [-0.01, 0.02, -0.003, 0.0004],
        "image_dimensions": [32, 18],
        "field_of_view": [120.0, 67.0],
    }
    (folder / "calibration.json").write_text(json.dumps({"FC": lens}))
    words = {"frame_id": folder.name, "time": stamp(time), "country_code": "SE", "scraped_weather": "rain"}
    words |= {"collection_car": "Hugin", "road_type": "city", "road_condition": "wet", "time_of_day": "day"}
    words |= {
        "num_lane_instances": 1,
        "num_vehicles": 4,
        "longitude": 11.9,
        "latitude": 57.7,
        "solar_angle_elevation": 9.0,
    }
    (folder / "metadata.json").write_text(json.dumps(words))

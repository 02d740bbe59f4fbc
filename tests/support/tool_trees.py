"""Small trees of annotation tools, by their published descriptions: one car in two frames, a person in the second.

labelCloud: https://ch-sa.github.io/labelCloud (conventions, setup), the whole file of the project's issue 1.
Supervisely: https://developer.supervisely.com/getting-started/supervisely-annotation-format/point-cloud-episodes.
Xtreme1: https://docs.xtreme1.io/xtreme1-docs (data annotation result, upload dataset, coordinate system).
OpenLABEL: ASAM OpenLABEL 1.0.0, cuboids, frames and streams.
Segments.ai: https://docs.segments.ai (label formats, sample formats, structure of the release file).
Scale: https://docs.scale.com/reference/data-types-and-the-frame-objects and lidar-callback-format.
"""

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from farfield.files.pcd import write_pcd
from farfield.geometry.poses import quaternion_from_rotation

NAMES = ("0007", "0008")
CAR, LATER, PERSON = (
    (12.0, 3.0, -0.8, 4.5, 1.9, 1.5, 0.3),
    (13.0, 3.3, -0.8, 4.5, 1.9, 1.5, 0.35),
    (20.0, -4.0, -0.7, 0.7, 0.6, 1.8, -1.2),
)
TRUTH = {"0007": [("Car", CAR, "a1")], "0008": [("Car", LATER, "a1"), ("Pedestrian", PERSON, "b2")]}
"""Class, x y z l w h yaw, and track of each box."""


def write_clouds(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    points = np.float32(np.random.default_rng(1).uniform([11, 2, -1], [14, 4, 0], (60, 3)))
    for name in NAMES:
        write_pcd(folder / f"{name}.pcd", {axis: points[:, i] for i, axis in enumerate("xyz")})


def put(path: Path, content: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=2))


def xyz(values: Sequence[float]) -> dict[str, float]:
    return dict(zip("xyz", values, strict=True))


def corners(box: Sequence[float], *, mirrored: bool = False) -> list[list[float]]:
    """Left back, left front, right front, right back of the bottom, then of the top; the length goes to the right."""
    x, y, z, length, width, height, yaw = box
    ahead, aside = np.array([math.cos(yaw), math.sin(yaw), 0]), np.array([-math.sin(yaw), math.cos(yaw), 0])
    rows = []
    for up in (-1, 1):
        for right, front in ((-1, -1), (-1, 1), (1, 1), (1, -1)):
            front = -front if mirrored else front
            rows.append([x, y, z] + (ahead * right * length + aside * front * width) / 2 + [0, 0, up * height / 2])
    return [row.tolist() for row in rows]


def write_labelcloud(root: Path, *, form: str = "centroid_rel", mirrored: bool = False) -> Path:
    write_clouds(root / "pointclouds")
    put(root / "labels" / "_classes.json", {"classes": []})
    for name, rows in TRUTH.items():
        objects: list[Any] = []
        for label, box, _ in rows:
            turn = box[6] if form == "centroid_rel" else math.degrees(box[6]) % 360
            sides = dict(zip(("length", "width", "height"), box[3:6], strict=True))
            places = {"centroid": xyz(box[:3]), "dimensions": sides, "rotations": xyz([0.0, 0.0, turn])}
            own = {"vertices": corners(box, mirrored=mirrored)} if form == "vertices" else places
            objects.append({"name": label} | own)
        head = {"folder": "pointclouds", "filename": f"{name}.pcd", "path": f"pointclouds/{name}.pcd"}
        put(root / "labels" / f"{name}.json", head | {"objects": objects})
    return root


def figure(number: int, box: Sequence[float], key: str, *, axes: str) -> dict[str, Any]:
    x, y, z, length, width, height, yaw = box
    own = axes == "supervisely"
    geometry = {
        "position": xyz([x, y, z]),
        "rotation": xyz([0, 0, yaw - math.pi / 2 if own else yaw]),
        "dimensions": xyz([width, length, height] if own else [length, width, height]),
    }
    return {"key": f"f{number}", "objectKey": key, "geometryType": "cuboid_3d", "geometry": geometry}


def write_supervisely(root: Path, *, listed: bool = True) -> Path:
    """A project with one episode, whose frames stand in another order than their names."""
    drive = root / "episode_1"
    write_clouds(drive / "pointcloud")
    put(root / "meta.json", {"classes": [], "tags": []})
    put(drive / "frame_pointcloud_map.json", {"0": "0008.pcd", "1": "0007.pcd"})
    keys = {track: label for rows in TRUTH.values() for label, _, track in rows}
    objects = [{"key": key, "classTitle": label, "tags": []} for key, label in keys.items()]
    frames = [
        {"index": i, "figures": [figure(10 * i + j, box, t, axes="supervisely") for j, (_, box, t) in enumerate(rows)]}
        for i, rows in enumerate((TRUTH["0008"], TRUTH["0007"]))
    ]
    episode = {"description": "", "key": "e", "tags": [], "objects": objects, "framesCount": 2, "frames": frames}
    put(drive / "annotation.json", [episode] if listed else episode)
    return root


def write_ann(root: Path, *, axes: str) -> Path:
    """A data set of single clouds, in Supervisely's axes or in CVAT's."""
    write_clouds(root / "ds0" / "pointcloud")
    for name, rows in TRUTH.items():
        objects = [{"key": t, "classTitle": label, "tags": [{"name": "seen", "value": "half"}]} for label, _, t in rows]
        figures = [figure(number, box, t, axes=axes) for number, (_, box, t) in enumerate(rows)]
        put(root / "ds0" / "ann" / f"{name}.pcd.json", {"description": "", "objects": objects, "figures": figures})
    return root


def write_xtreme1(root: Path, *, row_major: bool = False) -> Path:
    scene = root / "scene_1"
    write_clouds(scene / "lidar_point_cloud_0")
    pose = np.array([[0.0, -1, 0, 0.1], [0, 0, -1, 0.2], [1, 0, 0, 0.3], [0, 0, 0, 1]])
    for name, rows in TRUTH.items():
        objects: list[Any] = [{"type": "2D_RECT", "className": "Car", "contour": {"points": [{"x": 1, "y": 2}]}}]
        for label, box, track in rows:
            contour = {"pointN": 9, "points": [], "viewIndex": 0, "center3D": xyz(box[:3]), "size3D": xyz(box[3:6])}
            kind = {"id": "7", "name": "type", "type": "RADIO", "alias": "type", "value": "suv", "isLeaf": True}
            names = {"id": "0", "type": "3D_BOX", "classId": 1, "className": label, "trackId": track, "trackName": "2"}
            objects.append(names | {"classValues": [kind], "contour": contour | {"rotation3D": xyz([0, 0, box[6]])}})
        source = {"version": "1.0", "dataId": 1, "sourceName": "Ground Truth", "classificationValues": None}
        put(scene / "result" / f"{name}.json", [source | {"objects": objects}])
        inner = {"fx": 50.0, "fy": 51.0, "cx": 32.0, "cy": 24.0}
        outer = (pose if row_major else pose.T).ravel().tolist()
        sizes = {"width": 64, "height": 48}
        camera = {"cameraInternal": inner, "cameraExternal": outer, "rowMajor": row_major} | sizes
        put(scene / "camera_config" / f"{name}.json", [camera])
        (scene / "camera_image_0").mkdir(exist_ok=True)
        Image.new("RGB", (64, 48)).save(scene / "camera_image_0" / f"{name}.jpg")
    return root


def write_openlabel(root: Path) -> Path:
    write_clouds(root / "lidar")
    keys = {track: label for rows in TRUTH.values() for label, _, track in rows}
    frames: dict[str, Any] = {}
    for number, (name, rows) in enumerate(TRUTH.items()):
        held = {
            track: {
                "object_data": {
                    "cuboid": [
                        {
                            "name": "shape",
                            "val": [*box[:3], 0, 0, math.sin(box[6] / 2), math.cos(box[6] / 2), *box[3:6]],
                            "coordinate_system": "lidar",
                            "attributes": {"boolean": [{"name": "parked", "val": True}]},
                        }
                    ]
                }
            }
            for _, box, track in rows
        }
        streams = {"lidar": {"uri": f"lidar/{name}.pcd"}}
        properties = {"timestamp": f"1600000000.{number}5", "streams": streams}
        frames[str(number)] = {"frame_properties": properties, "objects": held}
    content = {
        "metadata": {"schema_version": "1.0.0"},
        "coordinate_systems": {"lidar": {"type": "sensor_cs", "parent": "", "children": []}},
        "objects": {key: {"name": key, "type": label} for key, label in keys.items()},
        "frames": frames,
    }
    put(root / "drive.json", {"openlabel": content})
    return root


def write_segments_ai(root: Path) -> Path:
    """A release of one sample; the car that took the clouds turns and drives, and the boxes stand in the world."""
    write_clouds(root / "clouds")
    frames, labels = [], []
    for number, (name, rows) in enumerate(TRUTH.items()):
        turn, place = 0.4 + number, np.array([500.0 + number, 200.0, 1.0])
        heading = {"qx": 0.0, "qy": 0.0, "qz": math.sin(turn / 2), "qw": math.cos(turn / 2)}
        pose = {"position": xyz(place.tolist()), "heading": heading}
        address = f"https://example.com/assets/{name}.pcd?signature=a/b"
        frames.append({"pcd": {"url": address, "type": "pcd"}, "name": name, "ego_pose": pose})
        world_R_cloud = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
        cuboids = []
        for label, box, track in rows:
            flat = world_R_cloud @ box[:2] + place[:2]
            cuboids.append(
                {
                    "id": 1,
                    "category_id": ("Car", "Pedestrian").index(label) + 1,
                    "type": "cuboid",
                    "position": xyz([*flat.tolist(), box[2] + place[2]]),
                    "dimensions": xyz(box[3:6]),
                    "yaw": math.remainder(box[6] + turn, 2 * math.pi),
                    "track_id": int(track, 16),
                    "is_keyframe": True,
                    "index": number,
                    "attributes": {"color": "red"},
                }
            )
        labels.append({"format_version": "0.2", "annotations": cuboids})
    categories = [{"id": 1, "name": "Car"}, {"id": 2, "name": "Pedestrian"}]
    held = {"label_status": "LABELED", "attributes": {"format_version": "0.2", "frames": labels}}
    sample = {"name": "drive", "attributes": {"frames": frames}, "labels": {"ground-truth": held}}
    task = {"name": "d", "task_type": "pointcloud-cuboid-sequence", "task_attributes": {"categories": categories}}
    put(root / "v1.json", {"name": "v1", "description": "", "dataset": task | {"samples": [sample]}})
    return root


SCALE_NS = 1541196976735462000


def write_scale(root: Path) -> Path:
    """A task of two frames; the car that took them turns and drives, and points and boxes stand in the world.

    A camera looks ahead from a metre in front of the device; its image lies beside the frames.
    """
    root.mkdir(parents=True, exist_ok=True)
    own = np.random.default_rng(1).uniform([11, 2, -1], [14, 4, 0], (60, 3))
    answer = []
    for number, (name, rows) in enumerate(TRUTH.items()):
        turn, place = 0.4 + number, np.array([500.0 + number, 200.0, 1.0])
        cos, sin = math.cos(turn), math.sin(turn)
        world_R_device = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1.0]])
        places = own @ world_R_device.T + place
        points = [
            {**xyz(point.tolist()), "i": row / 100, "d": row % 2, "t": SCALE_NS + number * 10**8 + row * 1000}
            for row, point in enumerate(places)
        ]
        ahead = world_R_device @ np.array([[0, 0, 1.0], [-1, 0, 0], [0, -1, 0]])
        x, y, z, w = quaternion_from_rotation(ahead).tolist()
        lens = {"camera_model": "brown_conrady", "fx": 20, "fy": 20, "cx": 16, "cy": 9, "skew": 0, "k1": 0.01}
        image = {
            "image_url": f"s3://bucket/task/image-front-{name}.png?signature=a/b",
            "position": xyz((place + world_R_device[:, 0]).tolist()),
            "heading": {"w": w, "x": x, "y": y, "z": z},
            "timestamp": SCALE_NS + number * 10**8 + 5,
        }
        frame = {
            "images": [image | lens],
            "points": points,
            "device_position": xyz(place.tolist()),
            "device_heading": {"w": math.cos(turn / 2), "x": 0, "y": 0, "z": math.sin(turn / 2)},
            "timestamp": SCALE_NS + number * 10**8,
        }
        (root / f"{name}.json").write_text(json.dumps(frame))
        Image.fromarray(np.full((18, 32, 3), number, np.uint8)).save(root / f"image-front-{name}.png")
        cuboids = []
        for label, box, track in rows:
            cuboids.append(
                {
                    "uuid": track,
                    "label": label,
                    "position": xyz((world_R_device @ box[:3] + place).tolist()),
                    "dimensions": xyz([box[4], box[3], box[5]]),
                    "yaw": math.remainder(box[6] + turn - math.pi / 2, 2 * math.pi),
                    "camera_used": 0,
                    "numberOfPoints": 60,
                    "stationary": label == "Pedestrian",
                    "attributes": {"color": "red"},
                }
            )
        answer.append({"cuboids": cuboids})
    put(root / "answer.json", answer)
    return root

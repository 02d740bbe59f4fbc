"""A tree of nuScenes' layout with random objects, and results for it; both sides of the comparison read the same files.

Written by the published schema (docs/schema_nuscenes.md of nuscenes-devkit), without farfield: all categories, racks,
attributes, objects that are seen once or across gaps, boxes without points, a car that tilts, sweeps between samples.
"""

import hashlib
import json
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

SCENES = ("scene-0103", "scene-0916")  # the devkit's split mini_val
START_US, SAMPLE_US, SWEEP_US = 1_533_151_603_547_590, 500_000, 50_000
CATEGORIES = {
    "movable_object.barrier": ("", (0.5, 2.0, 1.0)),
    "movable_object.trafficcone": ("", (0.4, 0.4, 1.1)),
    "movable_object.debris": ("", (1.0, 1.0, 0.4)),
    "static_object.bicycle_rack": ("", (3.0, 9.0, 1.5)),
    "vehicle.bicycle": ("cycle", (0.6, 1.7, 1.3)),
    "vehicle.motorcycle": ("cycle", (0.8, 2.1, 1.5)),
    "vehicle.bus.rigid": ("vehicle", (2.9, 11.0, 3.5)),
    "vehicle.car": ("vehicle", (1.9, 4.6, 1.7)),
    "vehicle.construction": ("vehicle", (2.8, 6.5, 3.2)),
    "vehicle.trailer": ("vehicle", (2.9, 12.0, 3.9)),
    "vehicle.truck": ("vehicle", (2.5, 7.0, 2.9)),
    "human.pedestrian.adult": ("pedestrian", (0.7, 0.7, 1.8)),
}
NAMES = {
    "movable_object.barrier": "barrier",
    "movable_object.trafficcone": "traffic_cone",
    "vehicle.bicycle": "bicycle",
    "vehicle.motorcycle": "motorcycle",
    "vehicle.bus.rigid": "bus",
    "vehicle.car": "car",
    "vehicle.construction": "construction_vehicle",
    "vehicle.trailer": "trailer",
    "vehicle.truck": "truck",
    "human.pedestrian.adult": "pedestrian",
}
ATTRIBUTES = {
    "vehicle": ("vehicle.moving", "vehicle.parked", "vehicle.stopped"),
    "cycle": ("cycle.with_rider", "cycle.without_rider"),
    "pedestrian": ("pedestrian.moving", "pedestrian.sitting_lying_down", "pedestrian.standing"),
}
SENSORS = {
    "LIDAR_TOP": ("lidar", [0.9437, 0.0, 1.8402], [0.7077955, -0.006492, 0.010646, -0.7063073], 0),
    "RADAR_FRONT": ("radar", [3.412, 0.0, 0.5], [0.9999984, 0.0, 0.0, 0.0017531], 21_000),
}
RADAR_FIELDS = (
    "x y z dyn_prop id rcs vx vy vx_comp vy_comp is_quality_valid ambig_state x_rms y_rms invalid_state pdh0 vx_rms "
    "vy_rms"
)
RADAR_HEADER = """# .PCD v0.7 - Point Cloud Data file format
VERSION 0.7
FIELDS {1}
SIZE 4 4 4 1 2 4 4 4 4 4 1 1 1 1 1 1 1 1
TYPE F F F I I F F F F F I I I I I I I I
COUNT 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1
WIDTH {0}
HEIGHT 1
VIEWPOINT 0 0 0 1 0 0 0
POINTS {0}
DATA binary
"""


def token(*words: object) -> str:
    """32 hexadecimal digits."""
    return hashlib.md5("/".join(map(str, words)).encode(), usedforsecurity=False).hexdigest()


def unit(rng: np.random.Generator, yaw_rad: float, tilt: float) -> list[float]:
    """A quaternion w x y z of a turn about z and a little roll and pitch."""
    values = np.array([np.cos(yaw_rad / 2), *rng.normal(0, tilt, 2), np.sin(yaw_rad / 2)])
    return (values / np.linalg.norm(values)).tolist()


def write_tree(root: Path, *, samples: int = 20, objects: int = 60, seed: int = 5) -> None:
    """Write tables, clouds and a map's picture below a folder."""
    rng = np.random.default_rng(seed)
    tables: dict[str, list[dict[str, Any]]] = {name: [] for name in ("ego_pose", "sample", "sample_data")}
    tables |= {name: [] for name in ("sample_annotation", "instance", "scene", "log")}
    tables["category"] = [{"token": token("c", name), "name": name, "description": ""} for name in CATEGORIES]
    names = [name for group in ATTRIBUTES.values() for name in group]
    tables["attribute"] = [{"token": token("a", name), "name": name, "description": ""} for name in names]
    levels = ("v0-40", "v40-60", "v60-80", "v80-100")
    tables["visibility"] = [
        {"token": str(number + 1), "level": level, "description": ""} for number, level in enumerate(levels)
    ]
    tables["sensor"] = [
        {"token": token("s", name), "channel": name, "modality": kind} for name, (kind, *_) in SENSORS.items()
    ]
    tables["calibrated_sensor"] = [
        {
            "token": token("cs", name),
            "sensor_token": token("s", name),
            "translation": place,
            "rotation": (np.array(turn) / np.linalg.norm(turn)).tolist(),
            "camera_intrinsic": [],
        }
        for name, (_, place, turn, _) in SENSORS.items()
    ]
    for number, scene in enumerate(SCENES):
        _write_scene(root, tables, scene, number, rng, samples, objects)
    logs = [row["token"] for row in tables["log"]]
    picture = {"token": token("map"), "category": "semantic_prior", "filename": "maps/one.png", "log_tokens": logs}
    tables["map"] = [picture]
    (root / "maps").mkdir(parents=True)
    (root / "maps" / "one.png").write_bytes(grey_png())
    (root / "v1.0-mini").mkdir()
    for name, rows in tables.items():
        (root / "v1.0-mini" / f"{name}.json").write_text(json.dumps(rows, indent=0))


def grey_png() -> bytes:
    """A picture of one pixel."""
    chunks = (b"IHDR" + struct.pack(">IIBBBBB", 1, 1, 8, 0, 0, 0, 0), b"IDAT" + zlib.compress(b"\0\x80"), b"IEND")
    body = b"".join(struct.pack(">I", len(c) - 4) + c + struct.pack(">I", zlib.crc32(c)) for c in chunks)
    return b"\x89PNG\r\n\x1a\n" + body


def _write_scene(
    root: Path,
    tables: dict[str, list[dict[str, Any]]],
    scene: str,
    number: int,
    rng: np.random.Generator,
    samples: int,
    objects: int,
) -> None:
    start_us = START_US + number * 60_000_000
    times = start_us + SAMPLE_US * np.arange(samples) + rng.integers(-3000, 3000, samples)
    times[samples // 2 :] += 1_400_000  # a gap across which velocities are not known
    place = np.array([410.0 + 900 * number, 1180.0, 0.0])
    keys = [token(scene, "sample", row) for row in range(samples)]
    log = token("log", scene)
    tables["log"].append(
        {"token": log, "logfile": "n", "vehicle": "n", "date_captured": "2018-08-01", "location": "singapore"}
    )
    tables["scene"].append(
        {
            "token": token(scene),
            "name": scene,
            "description": "Random objects",
            "log_token": log,
            "nbr_samples": samples,
            "first_sample_token": keys[0],
            "last_sample_token": keys[-1],
        }
    )
    for row, key in enumerate(keys):
        links = {"prev": keys[row - 1] if row else "", "next": keys[row + 1] if row + 1 < samples else ""}
        tables["sample"].append({"token": key, "timestamp": int(times[row]), "scene_token": token(scene), **links})
    for channel, (kind, *_, late_us) in SENSORS.items():
        _write_channel(root, tables, scene, channel, kind, times + late_us, keys, place, rng)
    for item in range(objects):
        _write_object(tables, f"{scene}/{item}", keys, place, rng)


def _write_channel(
    root: Path,
    tables: dict[str, list[dict[str, Any]]],
    scene: str,
    channel: str,
    kind: str,
    times: np.ndarray,
    keys: list[str],
    place: np.ndarray,
    rng: np.random.Generator,
) -> None:
    """Two sweeps before each key frame, each with a pose of its own."""
    entries = [(int(time - back * SWEEP_US), row, back == 0) for row, time in enumerate(times) for back in (2, 1, 0)]
    names = [token(scene, channel, time) for time, _, _ in entries]
    suffix = "pcd.bin" if kind == "lidar" else "pcd"
    for position, (time, row, is_key) in enumerate(entries):
        file = Path("samples" if is_key else "sweeps") / channel / f"{scene}__{channel}__{time}.{suffix}"
        (root / file).parent.mkdir(parents=True, exist_ok=True)
        (root / file).write_bytes(_lidar(rng) if kind == "lidar" else _radar(rng))
        way_m = 4e-6 * (time - times[0])
        tables["ego_pose"].append(
            {
                "token": token("pose", scene, channel, time),
                "timestamp": time,
                "translation": np.add(place, [way_m, 0.2 * way_m, 0.0]).tolist(),
                "rotation": unit(rng, 0.2 + 1e-3 * way_m, 0.004),
            }
        )
        tables["sample_data"].append(
            {
                "token": names[position],
                "sample_token": keys[row],
                "ego_pose_token": token("pose", scene, channel, time),
                "calibrated_sensor_token": token("cs", channel),
                "filename": file.as_posix(),
                "fileformat": suffix.split(".")[0],
                "width": 0,
                "height": 0,
                "timestamp": time,
                "is_key_frame": is_key,
                "prev": names[position - 1] if position else "",
                "next": names[position + 1] if position + 1 < len(names) else "",
            }
        )


def _lidar(rng: np.random.Generator) -> bytes:
    rows = np.column_stack([rng.uniform([-60, -60, -2], [60, 60, 3], (400, 3)), rng.integers(0, 256, 400)])
    return np.column_stack([rows, np.arange(400) % 32]).astype("<f4").tobytes()


def _radar(rng: np.random.Generator) -> bytes:
    count = int(rng.integers(3, 30))
    points = [
        struct.pack("<fffbhfffff8b", x, y, 0, 1, 3, 4.5, vx, vy, vx, vy, 1, 3, 19, 19, 0, 1, 16, 3)
        for x, y, vx, vy in rng.uniform([1, -40, -9, -9], [90, 40, 9, 9], (count, 4))
    ]
    return (
        RADAR_HEADER.format(count, RADAR_FIELDS).encode() + b"".join(points) + b"\n"
    )  # files of the set have a byte more


def _write_object(
    tables: dict[str, list[dict[str, Any]]], item: str, keys: list[str], place: np.ndarray, rng: np.random.Generator
) -> None:
    category = list(CATEGORIES)[int(rng.integers(len(CATEGORIES)))]
    group, size = CATEGORIES[category]
    rows = np.flatnonzero(rng.random(len(keys)) < rng.choice([0.15, 0.8]))
    if not len(rows):
        return
    start = place + np.array([*rng.uniform(-45, 45, 2), 0.8])
    speed, yaw_rad = rng.normal(0, 1.5, 2), rng.uniform(-np.pi, np.pi)
    names = [token("annotation", item, row) for row in rows]
    for position, row in enumerate(rows.tolist()):
        chosen = ATTRIBUTES.get(group, ())
        attribute = [token("a", chosen[int(rng.integers(len(chosen)))])] if chosen and rng.random() < 0.95 else []
        tables["sample_annotation"].append(
            {
                "token": names[position],
                "sample_token": keys[row],
                "instance_token": token("instance", item),
                "visibility_token": str(rng.integers(1, 5)),
                "attribute_tokens": attribute,
                "translation": np.add(start, [*(speed * 0.5 * row), 0.0]).tolist(),
                "size": (np.array(size) * rng.uniform(0.9, 1.1)).tolist(),
                "rotation": unit(rng, yaw_rad + 0.02 * row, 0.0),
                "prev": names[position - 1] if position else "",
                "next": names[position + 1] if position + 1 < len(names) else "",
                "num_lidar_pts": int(rng.integers(0, 6)),
                "num_radar_pts": int(rng.integers(0, 2)),
            }
        )
    tables["instance"].append(
        {
            "token": token("instance", item),
            "category_token": token("c", category),
            "nbr_annotations": len(names),
            "first_annotation_token": names[0],
            "last_annotation_token": names[-1],
        }
    )


def write_results(root: Path, path: Path, *, seed: int = 6) -> None:
    """Predictions for every sample: most annotated boxes with errors, and false ones; no score stands there twice."""
    rng = np.random.default_rng(seed)
    folder = root / "v1.0-mini"
    read = {name: json.loads((folder / f"{name}.json").read_text()) for name in ("sample", "sample_annotation")}
    category = {row["token"]: row["name"] for row in json.loads((folder / "category.json").read_text())}
    instances = json.loads((folder / "instance.json").read_text())
    name_of = {row["token"]: NAMES.get(category[row["category_token"]], "car") for row in instances}
    attributes = [name for group in ATTRIBUTES.values() for name in group]
    results: dict[str, list[dict[str, Any]]] = {row["token"]: [] for row in read["sample"]}
    for row in read["sample_annotation"]:
        for _ in range(int(rng.integers(0, 3))):
            shift = rng.normal(0, rng.choice([0.3, 1.0, 6.0]), 3) * [1, 1, 0.2]
            w, x, y, z = np.array(row["rotation"]) + rng.normal(0, 0.05, 4) * [1, 0, 0, 1]
            turn = np.array([w, x, y, z]) / np.linalg.norm([w, x, y, z])
            results[row["sample_token"]].append(
                {
                    "sample_token": row["sample_token"],
                    "translation": (np.array(row["translation"]) + shift).tolist(),
                    "size": (np.array(row["size"]) * rng.uniform(0.85, 1.15, 3)).tolist(),
                    "rotation": turn.tolist(),
                    "velocity": rng.normal(0, 1.5, 2).tolist(),
                    "detection_name": name_of[row["instance_token"]],
                    "detection_score": float(rng.uniform(0.05, 1) / (1 + np.linalg.norm(shift))),
                    "attribute_name": str(rng.choice(["", *attributes])),
                }
            )
    used = ("camera", "lidar", "radar", "map", "external")
    meta = {f"use_{name}": name == "lidar" for name in used}
    path.write_text(json.dumps({"meta": meta, "results": results}))

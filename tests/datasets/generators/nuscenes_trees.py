"""Trees of the nuScenes schema: nuScenes itself, MAN TruckScenes and Tier IV's T4.

Sources: docs/schema_nuscenes.md of the nuscenes-devkit, docs/schema_truckscenes.md of the truckscenes-devkit and
docs/schema/table.md of the t4-devkit, all Apache-2.0.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .nuscenes_vehicles import DIALECTS, Dialect, Mount
from .scene import THINGS, Scene, quaternion, seen, strengths, tiny_jpeg, visible
from .truth import CloudTruth, FrameTruth, Truth, counted

START_US = 1_532_402_927_647_951
RADAR_FIELDS = (
    "x y z dyn_prop id rcs vx vy vx_comp vy_comp is_quality_valid ambig_state x_rms y_rms invalid_state pdh0 vx_rms "
    "vy_rms"
)
RADAR_TYPES = ["f4"] * 3 + ["i1", "i2"] + ["f4"] * 5 + ["i1"] * 8
ATTRIBUTES = {"near car": "vehicle.moving", "cyclist": "cycle.with_rider", "far car": "vehicle.parked"}


@dataclass
class Rows:
    """The tables while they grow."""

    tables: dict[str, list[dict[str, Any]]] = field(default_factory=dict)

    def add(self, table: str, key: str, **fields: Any) -> str:
        """Add a row and give its token."""
        token = token_of(table, key)
        self.tables.setdefault(table, []).append({"token": token, **fields})
        return token


def token_of(table: str, key: str) -> str:
    """32 hexadecimal digits."""
    return hashlib.sha256(f"{table}/{key}".encode()).hexdigest()[:32]


def write_nuscenes(root: Path, *, dialect: str = "nuscenes", samples: int = 3) -> Truth:
    """A tree of one of the dialects.

    Args:
        root: The folder; of T4 the one that holds the data set's own.
        dialect: ``nuscenes``, ``truckscenes`` or ``t4``.
        samples: Key frames a scene, two a second.
    """
    kind, rows, frames = DIALECTS[dialect], Rows(), []
    base = root / "9f1c1e8e-0001" / "2" if dialect == "t4" else root
    shared = shared_rows(rows, kind)
    for number, (name, scene) in enumerate(kind.scenes.items()):
        frames += write_scene(base, rows, kind, name, scene, START_US + number * 90_000_000, samples, shared)
    folder = {"nuscenes": "v1.0-mini", "truckscenes": "v1.0-mini", "t4": "annotation"}[dialect]
    write_tables(base / folder, rows, kind)
    if dialect != "truckscenes":
        (base / "maps").mkdir(exist_ok=True)
        (base / "maps" / "53992ee3023e5494b90c316c183be829.png").write_bytes(b"")
    return Truth(frames=frames, has_velocity=True)


def shared_rows(rows: Rows, kind: Dialect) -> dict[str, str]:
    """What all scenes share: sensors, categories, attributes, visibilities; tokens by name."""
    tokens = {}
    for mount in kind.mounts:
        tokens[mount.channel] = rows.add("sensor", mount.channel, channel=mount.channel, modality=mount.modality)
    for index, (original, _) in enumerate(kind.names.values()):
        tokens[original] = rows.add("category", original, name=original, description="a kind", index=index)
    for name in ("vehicle.moving", "vehicle.parked", "cycle.with_rider", "pedestrian.moving"):
        tokens[name] = rows.add("attribute", name, name=name, description="a state")
    for index, level in enumerate(kind.visibility):
        row = {"token": str(index + 1), "level": level, "description": "how much is visible"}
        rows.tables.setdefault("visibility", []).append(row)
    return tokens


def write_scene(
    base: Path,
    rows: Rows,
    kind: Dialect,
    name: str,
    scene: Scene,
    start_us: int,
    samples: int,
    shared: Mapping[str, str],
) -> list[FrameTruth]:
    """One scene: its samples, the data of all sensors, the annotations."""
    stamps = [start_us + 500_000 * number for number in range(samples)]
    keys = [token_of("sample", f"{name}/{number}") for number in range(samples)]
    log = "" if kind.name == "truckscenes" else token_of("log", name)
    if log:
        captured = (
            {"date_captured": "2018-07-24"} if kind.name == "nuscenes" else {"data_captured": "2024-07-24-11-02-07"}
        )
        rows.add("log", name, logfile="n015", vehicle="n015", location="somewhere", **captured)
    weather = "weather.clear;area.highway;daytime.noon" if kind.name == "truckscenes" else "Parked truck, turn left"
    rows.add(
        "scene",
        name,
        name=name,
        description=weather,
        log_token=log,
        nbr_samples=samples,
        first_sample_token=keys[0],
        last_sample_token=keys[-1],
    )
    for number, stamp in enumerate(stamps):
        rows.add(
            "sample",
            f"{name}/{number}",
            timestamp=stamp,
            scene_token=token_of("scene", name),
            prev=keys[number - 1] if number else "",
            next=keys[number + 1] if number + 1 < samples else "",
        )
    clouds: list[dict[str, CloudTruth]] = [{} for _ in stamps]
    for salt, mount in enumerate(kind.mounts):
        write_sensor(base, rows, kind, name, scene, stamps, keys, mount, salt, shared, clouds)
    frames = []
    for number, stamp in enumerate(stamps):
        time_s = (stamp - start_us) * 1e-6
        lidar = np.concatenate([cloud.world_m for cloud in clouds[number].values() if not cloud.radar])
        boxes = scene.boxes(number, time_s, kind.names, lidar, attributes=ATTRIBUTES)
        frames.append(
            FrameTruth(
                sequence=name,
                frame_id=None,
                time_ns=stamp * 1000,
                clouds=clouds[number],
                boxes=boxes,
                world_T_ego=scene.world_T_ego(time_s),
            )
        )
    write_annotations(rows, kind, name, scene, keys, frames, shared)
    return frames


def write_sensor(
    base: Path,
    rows: Rows,
    kind: Dialect,
    name: str,
    scene: Scene,
    stamps: Sequence[int],
    keys: Sequence[str],
    mount: Mount,
    salt: int,
    shared: Mapping[str, str],
    clouds: list[dict[str, CloudTruth]],
) -> None:
    """All data of one sensor: key frames, and sweeps between them."""
    is_camera = mount.modality == "camera"
    calibrated = rows.add(
        "calibrated_sensor",
        f"{name}/{mount.channel}",
        sensor_token=shared[mount.channel],
        translation=[float(value) for value in mount.ego_T_sensor[:3, 3]],
        rotation=quaternion(mount.ego_T_sensor[:3, :3]),
        camera_intrinsic=[[12.6, 0.0, 8.1], [0.0, 12.6, 4.9], [0.0, 0.0, 1.0]] if is_camera else [],
        **({"camera_distortion": [0.01, -0.02, 0.001, 0.002, 0.003] if is_camera else []} if kind.name == "t4" else {}),
    )
    step = 500_000 // (kind.sweeps + 1)
    times = [
        (stamp - back * step + mount.late_us, number, back == 0)
        for number, stamp in enumerate(stamps)
        for back in range(kind.sweeps if number else 0, -1, -1)
    ]
    tokens = [token_of("sample_data", f"{name}/{mount.channel}/{time}") for time, _, _ in times]
    for row, (time_us, number, is_key) in enumerate(times):
        time_s = (time_us - stamps[0]) * 1e-6
        pose = scene.world_T_ego(time_s)
        suffix = {"camera": "jpg", "radar": "pcd", "lidar": "pcd.bin"}[mount.modality]
        if kind.name == "truckscenes" and not is_camera:
            suffix = "pcd"
        where = f"data/{mount.channel}/{row:05d}.{suffix}"
        if kind.name != "t4":
            folder = "samples" if is_key else "sweeps"
            where = f"{folder}/{mount.channel}/n015-2018-07-24__{mount.channel}__{time_us}.{suffix}"
        path = base / where
        path.parent.mkdir(parents=True, exist_ok=True)
        ego = rows.add(
            "ego_pose",
            f"{name}/{mount.channel}/{time_us}",
            timestamp=time_us,
            translation=[float(value) for value in pose[:3, 3]],
            rotation=quaternion(pose[:3, :3]),
        )
        rows.add(
            "sample_data",
            f"{name}/{mount.channel}/{time_us}",
            sample_token=keys[number],
            ego_pose_token=ego,
            calibrated_sensor_token=calibrated,
            filename=where,
            fileformat=suffix.split(".")[0] if not is_camera else "jpg",
            width=16 if is_camera else 0,
            height=12 if is_camera else 0,
            timestamp=time_us,
            is_key_frame=is_key,
            prev=tokens[row - 1] if row else "",
            next=tokens[row + 1] if row + 1 < len(tokens) else "",
            **({"is_valid": True, "info_filename": None} if kind.name == "t4" else {}),
        )
        if is_camera:
            path.write_bytes(tiny_jpeg())
            continue
        world = scene.points(number, time_s, salt + 10, clutter=mount.clutter)
        held, exact = seen(world, pose @ mount.ego_T_sensor)
        write = write_radar if mount.modality == "radar" else write_lidar
        truth = write(path, kind, held, exact, pose @ mount.ego_T_sensor, salt, time_us)
        if is_key:
            clouds[number][mount.channel] = truth


def write_lidar(
    path: Path, kind: Dialect, held: np.ndarray, exact: np.ndarray, world_T_sensor: np.ndarray, salt: int, time_us: int
) -> CloudTruth:
    """A sweep of a LiDAR."""
    del world_T_sensor
    count = len(held)
    intensity = strengths(count, salt)
    ring = np.full(count, -1) if kind.name == "t4" else np.arange(count) % 32
    columns = {"ring": ring.astype(np.float64)} if kind.name == "nuscenes" else {}
    if kind.name != "truckscenes":
        np.column_stack([held, intensity, ring]).astype("<f4").tofile(path)
        return CloudTruth(world_m=exact, intensity=intensity / 255, columns=columns, time_ns=time_us * 1000)
    table = np.zeros(count, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("timestamp", "<u8")])
    table["x"], table["y"], table["z"] = held.T
    table["intensity"], table["timestamp"] = intensity, time_us - 40_000 + np.arange(count) * 37
    path.write_bytes(pcd_header("x y z intensity timestamp", "4 4 4 4 8", "F F F F U", count) + table.tobytes())
    return CloudTruth(world_m=exact, intensity=intensity / 255, time_ns=time_us * 1000)


def write_radar(
    path: Path, kind: Dialect, held: np.ndarray, exact: np.ndarray, world_T_sensor: np.ndarray, salt: int, time_us: int
) -> CloudTruth:
    """Targets of a radar: 43 bytes each in nuScenes and T4, seven floats in TruckScenes."""
    random = np.random.default_rng([salt, time_us])
    count = len(held)
    rcs = random.uniform(-12, 31, count).astype("f4")
    if kind.name == "truckscenes":
        speed = random.uniform(-25, 25, (count, 3)).astype("f4")
        rows = np.column_stack([held, speed, rcs]).astype("<f4")
        path.write_bytes(
            pcd_header("x y z vrel_x vrel_y vrel_z rcs", " ".join("4" * 7), " ".join("F" * 7), count) + rows.tobytes()
        )
        vectors = {"relative velocity": speed.astype(np.float64) @ world_T_sensor[:3, :3].T}
    else:
        held = held.copy()
        names = RADAR_FIELDS.split()
        table = np.zeros(count, list(zip(names, ["<" + kind for kind in RADAR_TYPES], strict=True)))
        table["x"], table["y"], table["z"] = held.T
        speed = np.column_stack([random.uniform(-25, 25, (count, 2)), np.zeros(count)]).astype("f4")
        over_ground = np.column_stack([random.uniform(-9, 9, (count, 2)), np.zeros(count)]).astype("f4")
        table["vx"], table["vy"], table["vx_comp"], table["vy_comp"] = *speed[:, :2].T, *over_ground[:, :2].T
        table["rcs"], table["id"], table["dyn_prop"] = rcs, np.arange(count), np.arange(count) % 8
        table["is_quality_valid"], table["ambig_state"], table["invalid_state"] = (
            1,
            np.arange(count) % 5,
            np.arange(count) % 17,
        )
        table["x_rms"], table["y_rms"], table["pdh0"], table["vx_rms"], table["vy_rms"] = 19, 20, 1, 14, 15
        sizes = " ".join(kind[1] for kind in RADAR_TYPES)
        types = " ".join(kind[0].upper() for kind in RADAR_TYPES)
        path.write_bytes(pcd_header(RADAR_FIELDS, sizes, types, count) + table.tobytes() + b"\n")
        turn = world_T_sensor[:3, :3].T
        vectors = {
            "relative velocity": speed.astype(np.float64) @ turn,
            "velocity over ground": over_ground.astype(np.float64) @ turn,
        }
    return CloudTruth(world_m=exact, held={"cross-section": [rcs]}, vectors=vectors, time_ns=time_us * 1000, radar=True)


def pcd_header(fields: str, sizes: str, types: str, count: int) -> bytes:
    """The header as the radar's files have it."""
    ones = " ".join("1" for _ in fields.split())
    return (
        f"# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {fields}\nSIZE {sizes}\nTYPE {types}\n"
        f"COUNT {ones}\nWIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\nDATA binary\n"
    ).encode()


def write_annotations(
    rows: Rows,
    kind: Dialect,
    name: str,
    scene: Scene,
    keys: Sequence[str],
    frames: Sequence[FrameTruth],
    shared: Mapping[str, str],
) -> None:
    """Instances and their annotations, in a row of prev and next."""
    for thing in THINGS:
        numbers = [number for number in range(len(keys)) if thing in visible(THINGS, number)]
        tokens = [token_of("sample_annotation", f"{name}/{thing.track}/{number}") for number in numbers]
        if not numbers:
            continue
        instance = rows.add(
            "instance",
            f"{name}/{thing.track}",
            category_token=shared[kind.names[thing.kind][0]],
            nbr_annotations=len(numbers),
            first_annotation_token=tokens[0],
            last_annotation_token=tokens[-1],
            **({"instance_name": f"{name}::{thing.track}"} if kind.name == "t4" else {}),
        )
        for row, number in enumerate(numbers):
            box = next(box for box in frames[number].boxes or () if box.track == thing.track)
            radar = sum(counted(cloud.world_m, box) for cloud in frames[number].clouds.values() if cloud.radar)
            length, width, height = (float(value) for value in thing.size_m)
            extra: dict[str, Any] = {}
            if kind.name == "t4":
                velocity = None if thing.frames else [float(value) for value in scene.velocity_of(thing)]
                extra = {
                    "velocity": velocity,
                    "acceleration": None,
                    "automatic_annotation": False,
                    "autolabel_metadata": None,
                }
            rows.add(
                "sample_annotation",
                f"{name}/{thing.track}/{number}",
                sample_token=keys[number],
                instance_token=instance,
                visibility_token=str(1 + number % 4) if thing.points else "",
                attribute_tokens=[shared[ATTRIBUTES[thing.track]]] if thing.track in ATTRIBUTES else [],
                translation=[float(value) for value in box.centre_m],
                size=[width, length, height],
                rotation=quaternion(box.rotation),
                num_lidar_pts=box.points,
                num_radar_pts=radar,
                prev=tokens[row - 1] if row else "",
                next=tokens[row + 1] if row + 1 < len(tokens) else "",
                **extra,
            )


def write_tables(folder: Path, rows: Rows, kind: Dialect) -> None:
    """All tables as JSON, empty ones too."""
    folder.mkdir(parents=True, exist_ok=True)
    if kind.name == "truckscenes":
        motion = dict.fromkeys(
            ["vx", "vy", "vz", "ax", "ay", "az", "yaw", "pitch", "roll", "yaw_rate", "pitch_rate", "roll_rate"], 0.1
        )
        for table in ("ego_motion_cabin", "ego_motion_chassis"):
            rows.add(table, "0", timestamp=START_US, **motion)
    else:
        logs = [row["token"] for row in rows.tables["log"]]
        where = "maps/53992ee3023e5494b90c316c183be829.png"
        rows.add("map", "0", category="semantic_prior", filename=where, log_tokens=logs)
    for table, listed in rows.tables.items():
        (folder / f"{table}.json").write_text(json.dumps(listed, indent=0))

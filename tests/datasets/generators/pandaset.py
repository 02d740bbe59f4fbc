"""PandaSet: pickled frames of pandas, gzipped; clouds and cuboids in the world.

Sources: the documentation and geometry of the pandaset-devkit (Apache-2.0); OpenPCDet's reader (Apache-2.0) for the
axes of the LiDAR's pose: x right, y forward.
"""

import gzip
import json
import uuid
from pathlib import Path

import numpy as np

from .pickle_assembler import frame_pickle
from .scene import THINGS, Scene, pose_of, quaternion, rotation_z, strengths, tiny_jpeg, visible
from .truth import BoxTruth, CloudTruth, FrameTruth, Truth

START_S = 1_557_539_924.125
SIZES = {"0": 60, "1": 44}
NAMES = {
    "car": ("Car", "vehicle"),
    "truck": ("Semi-truck", "large_vehicle"),
    "bicycle": ("Bicycle", "bicycle"),
    "pedestrian": ("Pedestrian", "pedestrian"),
}
ROOF_M = (0.3, 0.1, 1.9)


def write_pandaset(root: Path, *, version: str = "1.0", frames: int = 3, apart: bool = False) -> Truth:
    """Two sequences.

    Args:
        root: The folder.
        version: Of pandas, whose layout the pickles have.
        frames: A sequence.
        apart: Whether the truth has the two LiDARs as two clouds, as a reader may give them; the files are the same.
    """
    truths = []
    for name, scene in {
        "001": Scene(21, (-213.375, 88.25, 1.125), 0.5),
        "139": Scene(22, (1402.5, -977.125, -3.5), -2.4),
    }.items():
        truths += write_sequence(root / name, name, scene, version, frames, apart=apart)
    return Truth(frames=truths)


def write_sequence(
    folder: Path, name: str, scene: Scene, version: str, frames: int, *, apart: bool
) -> list[FrameTruth]:
    """One sequence and its truth."""
    for sub in ("lidar", "annotations/cuboids", "annotations/semseg", "camera/front_camera", "meta"):
        (folder / sub).mkdir(parents=True)
    truths, poses, stamps = [], [], []
    for number in range(frames):
        time_s = number * 0.1
        world_T_ego = scene.world_T_ego(time_s)
        world_T_lidar = world_T_ego @ pose_of(rotation_z(-np.pi / 2), ROOF_M)  # x right, y forward
        poses.append(posed(world_T_lidar))
        stamps.append(START_S + time_s)
        parts = [scene.points(number, time_s, 30 + sensor, clutter=SIZES[str(sensor)]) for sensor in (0, 1)]
        world = np.concatenate(parts)
        device = np.repeat([0, 1], [len(part) for part in parts])
        intensity = strengths(len(world), number)
        offsets = np.linspace(-0.05, 0.049, len(world))
        table = {
            **dict(zip("xyz", world.T, strict=True)),
            "i": intensity.astype(np.float64),
            "t": START_S + time_s + offsets,
            "d": device,
        }
        save(folder / f"lidar/{number:02d}.pkl.gz", table, version)
        save(folder / f"annotations/semseg/{number:02d}.pkl.gz", {"class": np.arange(len(world)) % 42}, version)
        (folder / f"camera/front_camera/{number:02d}.jpg").write_bytes(tiny_jpeg())
        boxes = cuboids(folder / f"annotations/cuboids/{number:02d}.pkl.gz", scene, number, time_s, version)
        masks = {"pandar64": device == 0, "pandar_gt": device == 1} if apart else {"lidar": device >= 0}
        clouds = {
            key: CloudTruth(world_m=world[mask], intensity=intensity[mask] / 255, offsets_s=offsets[mask])
            for key, mask in masks.items()
        }
        truths.append(
            FrameTruth(
                sequence=name,
                frame_id=f"{number:02d}",
                time_ns=round((START_S + time_s) * 1e6) * 1000,
                clouds=clouds,
                boxes=boxes,
                world_T_ego=world_T_ego,
            )
        )
    for sub in ("lidar", "camera/front_camera"):
        (folder / sub / "poses.json").write_text(json.dumps(poses))
        (folder / sub / "timestamps.json").write_text(json.dumps(stamps))
    lens = {"fx": 12.0, "fy": 12.1, "cx": 8.0, "cy": 6.0}
    (folder / "camera/front_camera/intrinsics.json").write_text(json.dumps(lens))
    (folder / "meta/timestamps.json").write_text(json.dumps(stamps))
    gps = [{"lat": 37.3, "long": -122.0, "height": 5.0, "xvel": 1.0, "yvel": 2.0} for _ in stamps]
    (folder / "meta/gps.json").write_text(json.dumps(gps))
    return truths


def posed(pose: np.ndarray) -> dict[str, dict[str, float]]:
    """A pose as PandaSet writes it."""
    return {
        "position": dict(zip("xyz", pose[:3, 3].tolist(), strict=True)),
        "heading": dict(zip("wxyz", quaternion(pose[:3, :3]), strict=True)),
    }


def cuboids(path: Path, scene: Scene, number: int, time_s: float, version: str) -> list[BoxTruth]:
    """The cuboids of a frame; the near car, which drives in the view of both LiDARs, has two."""
    boxes = scene.boxes(number, time_s, NAMES)
    rows = []
    speeds = {thing.track: thing.speed_m_s for thing in visible(THINGS, number)}
    for box in boxes:
        twice = box.track == "near car"
        rows.append(row_of(scene, box, speeds[box.track] == 0, 0 if twice else -1, sibling=twice))
        if twice:  # a little later, by the other LiDAR
            late = BoxTruth(**{**vars(box), "centre_m": scene.centre_of(thing_of(box.track), time_s + 0.03)})
            rows.append(row_of(scene, late, False, 1, sibling=True))
    order = np.random.default_rng(number).permutation(len(rows))
    table = {}
    for key, value in rows[0].items():
        values = [rows[row][key] for row in order]
        if isinstance(value, str):
            table[key] = np.empty(len(rows), object)
            table[key][:] = values
        else:
            table[key] = np.array(values)
    save(path, table, version)
    return [
        BoxTruth(**{**vars(box), "track": box.track, "points": None, "moving": speeds[box.track] > 0}) for box in boxes
    ]


def thing_of(track: str) -> object:
    """An object by its name."""
    return next(thing for thing in THINGS if thing.track == track)


def row_of(scene: Scene, box: BoxTruth, stationary: bool, sensor: int, *, sibling: bool) -> dict[str, object]:
    """One cuboid: its x is the width, its y the length, and yaw 0 looks along the world's y."""
    heading = float(np.arctan2(box.rotation[1, 0], box.rotation[0, 0]))
    other = {0: 1, 1: 0, -1: -1}[sensor]
    length, width, height = (float(value) for value in box.size_m)
    return {
        "uuid": identity(box.track, sensor),
        "label": box.original,
        "yaw": float(np.mod(heading - np.pi / 2 + np.pi, 2 * np.pi) - np.pi),
        "stationary": stationary,
        "camera_used": 0,
        **{f"position.{axis}": float(value) for axis, value in zip("xyz", box.centre_m, strict=True)},
        **{"dimensions.x": width, "dimensions.y": length, "dimensions.z": height},
        "attributes.object_motion": "Parked" if stationary else "Moving",
        "cuboids.sibling_id": identity(box.track, other) if sibling else "-",
        "cuboids.sensor_id": sensor,
        "attributes.rider_status": "-",
        "attributes.pedestrian_behavior": "-",
        "attributes.pedestrian_age": "-",
    }


def identity(track: str, sensor: int) -> str:
    """The identity of an object for one LiDAR."""
    return str(uuid.uuid5(uuid.NAMESPACE_URL, f"{track}/{max(sensor, 0)}"))


def save(path: Path, columns: dict[str, np.ndarray], version: str) -> None:
    """A frame of pandas, gzipped."""
    path.write_bytes(gzip.compress(frame_pickle(columns, version), mtime=0))

"""Annotated drives as detections: of the real logs beside the project, and of simulated roads."""

import tarfile
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from farfield.datasets import open_dataset
from farfield.files.boreas import read_boreas_objects, read_boreas_poses
from farfield.files.radiate import read_times, read_tracks
from farfield.frame import Boxes
from farfield.frame.annotation import Annotation
from farfield.frame.drive import Drive, Key
from farfield.geometry.poses import invert
from farfield.metrics.detections import Detections

LONGEST_STEP_S = 1.0
"""A longer gap begins another drive."""


@dataclass(frozen=True, kw_only=True)
class Noise:
    """How annotated boxes become detections.

    Args:
        range_sigma_m: Error along the ray.
        azimuth_sigma_deg: Error across it.
        missed: Share that is not detected, near and at 250 m.
        false_alarms: Mean number a frame, spread evenly over the range.
        doppler_sigma_m_s: Error of the radial velocity; None for none.
        doppler_span_m_s: Span modulo which it is known.
        seed: Of all of it.
    """

    range_sigma_m: float = 0.3
    azimuth_sigma_deg: float = 0.5
    missed: tuple[float, float] = (0.05, 0.4)
    false_alarms: float = 0.5
    doppler_sigma_m_s: float | None = None
    doppler_span_m_s: float | None = None
    seed: int = 0


def from_frames(name: str, frames: list[tuple[str, int, Float[np.ndarray, "4 4"] | None, Boxes]]) -> Detections:
    """Annotated frames (name, time in nanoseconds, pose, boxes) as drives, cut at long gaps."""
    annotations: dict[Key, Annotation] = {}
    drives: list[Drive] = []
    times = np.array([time_ns for _, time_ns, _, _ in frames], dtype=np.int64)
    parts = np.split(np.arange(len(frames)), np.flatnonzero(np.diff(times) > LONGEST_STEP_S * 1e9) + 1)
    for number, part in enumerate(parts):
        sequence = name if len(parts) == 1 else f"{name}.{number}"
        keys = [(sequence, frames[row][0]) for row in part.tolist()]
        poses = [frames[row][2] for row in part.tolist()]
        known = [pose for pose in poses if pose is not None]
        drives.append(
            Drive(
                name=sequence,
                indices=part,
                keys=tuple(keys),
                times_ns=times[part],
                world_T_frame=np.stack(known) if len(known) == len(poses) else None,
            )
        )
        annotations |= {key: Annotation(boxes=frames[row][3]) for key, row in zip(keys, part.tolist(), strict=True)}
    return Detections(boxes={}, annotations=annotations, drives=tuple(drives))


def joined(parts: list[Detections]) -> Detections:
    """Several drives as one."""
    annotations = {key: a for part in parts for key, a in part.annotations.items()}
    return Detections(boxes={}, annotations=annotations, drives=tuple(d for part in parts for d in part.drives))


def argoverse2(root: Path) -> Detections:
    """The long log of Argoverse 2."""
    data = open_dataset(root / "argoverse2_tracks")
    (drive,) = data.drives()
    assert drive.times_ns is not None
    assert drive.world_T_frame is not None
    frames = []
    for place, index in enumerate(drive.indices.tolist()):
        annotation = data.annotation(index)
        assert annotation is not None
        time_ns = int(drive.times_ns[place])
        frames.append((drive.keys[place][1], time_ns, drive.world_T_frame[place], annotation.boxes))
    return from_frames("argoverse2", frames)


def boreas(root: Path) -> Detections:
    """Boreas' log: labels at 5 Hz, poses of the LiDAR."""
    folder = root / "boreas_objects"
    times, poses = read_boreas_poses(folder / "applanix" / "lidar_poses.csv")
    numbers: dict[str, int] = {}
    frames = []
    for path in sorted((folder / "labels_detection").glob("*.txt"), key=lambda each: int(each.stem)):
        found = read_boreas_objects(path)
        time_ns = int(path.stem) * 1000
        row = int(np.abs(times - time_ns).argmin())
        boxes = Boxes(
            centre_m=found.centre_m,
            size_m=found.size_m,
            yaw_rad=found.yaw_rad,
            label=list(found.label),
            track_id=np.array([numbers.setdefault(uuid, len(numbers)) for uuid in found.uuid], dtype=np.int64),
            point_count=found.point_count,
        )
        frames.append((path.stem, time_ns, poses[row], boxes))
    return from_frames("boreas", frames)


def radiate(root: Path) -> Detections:
    """RADIATE's sample in fog: all annotated turns of the radar at 4 Hz, without poses."""
    from farfield.datasets.radiate import annotation_of

    folder = root / "radiate" / "tiny_foggy"
    times = read_times(folder / "Navtech_Cartesian.txt")
    tracks = read_tracks(folder / "annotations" / "annotations.json")
    frames: list[Any] = []
    for number, time_ns in sorted(times.items()):
        boxes = annotation_of(tracks.of_frame(number), "cirrus").boxes
        frames.append((f"{number:06d}", time_ns, None, boxes))
    return from_frames("fog", frames)


def kradar(root: Path) -> Detections:
    """K-Radar's annotations (v2.1) of all 58 sequences, in the os2-64's coordinates, by the stamps of their headers."""
    with tempfile.TemporaryDirectory() as folder:
        with tarfile.open(root / "kradar" / "labels_v2_1.tar.gz") as archive:
            archive.extractall(folder, filter="data")
        return kradar_labels(Path(folder))


def kradar_labels(folder: Path) -> Detections:
    """The same of a folder of labels, of any version.

    Objects without a track (-1), and those whose track stands in the frame already, are left out.
    """
    table = open_dataset(folder).label_table()  # type: ignore[attr-defined]
    cuts = np.searchsorted(table.frame, np.arange(len(table.stem) + 1))
    parts = []
    for sequence in dict.fromkeys(table.sequence.tolist()):
        frames: list[Any] = []
        rows = np.flatnonzero((table.sequence == sequence) & (table.time_ns >= 0))
        for row in rows[np.argsort(table.time_ns[rows], kind="stable")].tolist():
            part = np.arange(cuts[row], cuts[row + 1])
            _, first = np.unique(table.track[part], return_index=True)
            part = part[np.sort(first)]
            part = part[table.track[part] >= 0]
            boxes = Boxes(
                centre_m=table.centre_m[part],
                size_m=table.size_m[part],
                yaw_rad=np.deg2rad(table.yaw_deg[part]),
                label=table.name[part].tolist(),
                track_id=table.track[part],
            )
            frames.append((str(table.stem[row]), int(table.time_ns[row]), None, boxes))
        parts.append(from_frames(str(sequence), frames))
    return joined(parts)


def split_identities(truth: Detections, *, longest_gap_s: float = 1.0, fastest_m_s: float = 70.0) -> Detections:
    """Annotated identities that begin anew where they are away for long, or jump further than anything moves.

    Some annotators use a number again for another object of the drive; no tracker can find out which.
    """
    annotations = dict(truth.annotations)
    for drive in truth.drives:
        assert drive.times_ns is not None
        last: dict[int, tuple[float, np.ndarray, int]] = {}
        names = 0
        for key, time_ns in zip(drive.keys, drive.times_ns.tolist(), strict=True):
            annotation = truth.annotations[key]
            boxes, now = annotation.boxes, time_ns / 1e9
            if boxes.track_id is None or not len(boxes):
                continue
            renamed = []
            for name, place in zip(boxes.track_id.tolist(), boxes.centre_m[:, :2], strict=True):
                before, there, number = last.get(name, (-np.inf, place, -1))
                gone = now - before > longest_gap_s
                if gone or np.hypot(*(place - there)) > 2 + fastest_m_s * (now - before):
                    number, names = names, names + 1
                last[name] = (now, place, number)
                renamed.append(number)
            annotations[key] = Annotation(boxes=boxes.replace(track_id=np.array(renamed, dtype=np.int64)))
    return replace(truth, annotations=annotations)


def class_identities(truth: Detections) -> Detections:
    """Identities of an annotated number and a class each: some annotators count the objects of each class anew."""
    names = sorted({str(name) for each in truth.annotations.values() for name in np.unique(each.boxes.label)})
    annotations = dict(truth.annotations)
    for key, annotation in truth.annotations.items():
        boxes = annotation.boxes
        if boxes.track_id is not None and len(boxes):
            number = np.array([names.index(str(name)) for name in boxes.label], dtype=np.int64)
            annotations[key] = Annotation(boxes=boxes.replace(track_id=boxes.track_id * len(names) + number))
    return replace(truth, annotations=annotations)


def identities(truth: Detections) -> int:
    """Number of annotated identities."""
    return len(
        {
            (key[0], name)
            for key, annotation in truth.annotations.items()
            if annotation.boxes.track_id is not None
            for name in annotation.boxes.track_id.tolist()
        }
    )


def simulated(road: str, *, sequence: int, frames: int, reach_m: float = 250.0, seed: int = 2026) -> Detections:
    """A simulated road at 10 Hz: the road users' whole boxes ahead within a range, with velocities over ground."""
    from farfield.simulation.labels import full_boxes
    from farfield.simulation.presets import find_preset
    from farfield.simulation.rigs.drive import drive_of

    drive = drive_of(find_preset("cirrus-sim-ideal", road=road, stride_s=0.1), seed, sequence)
    scene, out = drive.scene, []
    for index in range(frames):
        time_s = drive.time_s(index)
        world_T_lidar = scene.ego_pose(time_s) @ drive.mounting.ego_T_lidar
        place, yaw = scene.motion.at(time_s)
        others = slice(1, None)
        boxes = full_boxes(
            list(scene.actors)[others],
            place[others],
            yaw[others],
            scene.motion.velocity_m_s(time_s)[others],
            invert(world_T_lidar),
        )
        ahead = (boxes.centre_m[:, 0] > 2) & (boxes.range_m < reach_m)
        ahead &= np.abs(boxes.centre_m[:, 1]) < boxes.centre_m[:, 0]
        out.append((f"{index:04d}", round(time_s * 1e9), world_T_lidar, boxes[ahead]))
    return from_frames(f"{road}-{sequence}", out)


def detected(truth: Detections, noise: Noise | None) -> Detections:
    """Annotated boxes without their identities: as they are, or degraded.

    The random numbers of frames do not depend on whether radial velocities are measured, so that runs with and without
    them see the same detections.
    """
    boxes, details = {}, {}
    for drive in truth.drives:
        own = _sensor_velocities(drive)
        for place, key in enumerate(drive.keys):
            given = truth.annotations[key].boxes
            if noise is None:
                boxes[key] = given.replace(track_id=None, velocity_m_s=None, score=np.ones(len(given)))
                continue
            rng = np.random.default_rng((noise.seed, abs(hash_of(key))))
            boxes[key], details[key] = _degraded(given, noise, rng, own[place])
    return replace(truth, boxes=boxes, prediction_details=details)


def hash_of(key: Key) -> int:
    """A number of a frame's name that is the same in every process."""
    return int.from_bytes("/".join(key).encode(), "big") % (1 << 61)


def _sensor_velocities(drive: Drive) -> Float[np.ndarray, "n 3"]:
    """The sensor's velocity over ground along its own axes, 0 where it is not known."""
    if drive.world_T_frame is None or drive.times_ns is None or len(drive.keys) < 2:
        return np.zeros((len(drive.keys), 3))
    speed = np.gradient(drive.world_T_frame[:, :3, 3], drive.times_ns / 1e9, axis=0)
    return np.einsum("nij,ni->nj", drive.world_T_frame[:, :3, :3], speed)


def _degraded(
    given: Boxes, noise: Noise, rng: np.random.Generator, own_m_s: Float[np.ndarray, " 3"]
) -> tuple[Boxes, dict[str, np.ndarray]]:
    n = len(given)
    chance, along, across, blur = rng.random(n), rng.normal(size=n), rng.normal(size=n), rng.normal(size=n)
    false = int(rng.poisson(noise.false_alarms))
    range_m, bearing = rng.uniform(10, 250, false), rng.uniform(-0.6, 0.6, false)
    score, low = rng.uniform(0.6, 1.0, n), rng.uniform(0.1, 0.7, false)
    far = given.range_m / 250
    kept = chance >= noise.missed[0] + (noise.missed[1] - noise.missed[0]) * far
    unit = given.centre_m / np.maximum(np.linalg.norm(given.centre_m, axis=1, keepdims=True), 1e-9)
    side = np.column_stack([-unit[:, 1], unit[:, 0], np.zeros(n)])
    sigma_m = given.range_m * np.deg2rad(noise.azimuth_sigma_deg)
    place = given.centre_m + (noise.range_sigma_m * along)[:, None] * unit + (sigma_m * across)[:, None] * side
    clutter = np.column_stack([range_m * np.cos(bearing), range_m * np.sin(bearing), np.zeros(false)])
    usual = [4.5, 1.9, 1.6]
    name = given.label[0] if n else "vehicle"
    boxes = Boxes(
        centre_m=np.concatenate([place[kept], clutter]),
        size_m=np.concatenate([given.size_m[kept], np.tile(usual, (false, 1))]),
        yaw_rad=np.r_[given.yaw_rad[kept], np.zeros(false)],
        label=[*given.label[kept].tolist(), *[name] * false],
        score=np.r_[(score * (1 - 0.5 * far))[kept], low],
    )
    if noise.doppler_sigma_m_s is None or given.velocity_m_s is None:
        return boxes, {}
    radial = (unit * (given.velocity_m_s - own_m_s)).sum(axis=1) + noise.doppler_sigma_m_s * blur
    still = -(clutter / np.maximum(np.linalg.norm(clutter, axis=1, keepdims=True), 1e-9)) @ own_m_s
    measured = np.r_[radial[kept], still]
    if noise.doppler_span_m_s is not None:
        span = noise.doppler_span_m_s
        measured = np.mod(measured + span / 2, span) - span / 2
    return boxes, {"doppler_m_s": measured}

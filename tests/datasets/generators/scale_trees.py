"""Scale AI's LiDAR annotation: the frames as a customer uploads them and the cuboids that come back, all in the world.

Written from what Scale publishes alone. The stored copies of its pages that could be read end before their tables of
properties do; where they end counts as silence here. What they say:

- docs.scale.com/reference/data-types-and-the-frame-objects, scale.com/docs/api-reference/sensor-fusion-lidar-reference:
  a frame is one JSON file behind a URL. A Vector3 has x, y, z. A LidarPoint has x, y, z and, if the customer likes, i
  (0 to 1), d (a whole number from 0: which device), t (nanoseconds, a whole number of 1.5e18 in the example) and
  is_ground (false where it is absent). z is up; coordinates are taken as 32-bit floats.
- docs.scale.com/reference/lidar-callback-format (and callback-format-2, the older one): the response links to a file: a
  list over frames of {"cuboids": [...]}. A cuboid is its centre in the world, its dimensions and its yaw. The world is
  east, north, up; yaw 0 looks along <0, 1, 0> and grows counter-clockwise. Properties in the example: uuid (capital
  letters, the same in every frame for one object), camera_used, label, position, dimensions, yaw, distance_to_device,
  numberOfPoints, stationary, attributes. Its cars are 175.85 in x, 399.34 in y, 150.99 in z: y is the length.
- docs.scale.com/reference/lidarlinking-callback-format: the callback is {"response": {"annotations": {"url": ...}},
  "task_id": ..., "task": {...}}; answers stand in the order of the task's attachments.
- scale.com/docs/api-reference/sensor-fusion-lidar-tasks: a lidarannotation task needs attachments (URLs of frames,
  ordered by time), labels, attachment_type (json).
- scaleapi.github.io/scale-lidar-toolkit (load_raw_data/preparing, loading, structure, task_creation) and scale_lidar_io
  1.2.5 of PyPI (LICENSE Apache-2.0, classifier MIT): frames are uploaded in the world, points and cameras alike; a pose
  takes what the device measures into the world; headings are w, x, y, z; a frame has images, points, device_position,
  device_heading; points have four decimals; files are frame-ID.json and image-CAMERA-ID.jpg; an image has position,
  heading, image_url, camera_model (brown_conrady), fx, fy, cx, cy, skew, k1 to k6, p1, p2, lx, ly, xi, scale_factor,
  timestamp; a camera without calibration looks along the device's x; the proto's LidarFrame has a timestamp (double);
  the template has meters_per_unit.
- scaleapi/nucleus-python-client (MIT), nucleus/metrics/cuboid_utils.py: dimensions are width, length, height; by "the
  internal Scale convention" half a pi is added to yaw, after which the length lies along the heading.
  nucleus/camera_params.py: z of a camera's heading is its optical axis, its position is of the world. The docstring of
  nucleus' CuboidAnnotation calls x the length and y the width: of Nucleus, against its own metrics and the callback.

What none of them says, and what is decided here:

- Which axis of the device is forward: x, as the toolkit's cameras have it. Whether a device is the LiDAR: it is.
- The unit of a frame's and an image's timestamp: nanoseconds, as of t; a frame's is the begin of its turn.
- The unit of cuboids: that of the points, metres, with meters_per_unit 1. The range of yaw: from -pi to below pi.
- Which camera number is the first: 0, by the order of images; an object that no camera views has no camera_used.
- What distance_to_device runs between: the device and the cuboid's centre, in space.
- What a frame without objects holds: not written here; every frame has cuboids.
- Under which name the file of the answer is stored: annotations.json, with the callback or the task beside it.
- The fields of the task object but task_id: those that scaleapi-python-client (MIT) reads: type, status, params,
  response.

Names of frames are 9, 10, 11, so that only attachments, timestamps or counting put them in order.
"""

import json
import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .scene import Scene, pose_of, quaternion, rotation_z, strengths, tiny_jpeg
from .truth import BoxTruth, CloudTruth, FrameTruth, Truth, apply, counted

DRIVE = "drive_0042"
FRAME_IDS = (9, 10, 11)
TIMES_S = (0.0, 0.5, 1.0)
START_NS = 1_541_196_976_500_000_000  # it and half seconds after it are whole in float64
URL = f"https://customer-bucket.s3.amazonaws.com/scale/{DRIVE}"
RESULT = "https://scaleapi-results.s3.amazonaws.com/000003f0-a07c-11e8-891a-b1d8c6329c00"
LABELS = ("Car", "Pedestrian", "Cyclist")
SCENE = Scene(61, (212.5, -87.25, 1.9), 0.7)
OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # x right, y down, z forward
DEVICE_T_CAMERA = {
    "front": pose_of(OPTICAL, (1.1, 0.04, -0.35)),
    "left": pose_of(rotation_z(1.6) @ OPTICAL, (0.3, 0.6, -0.3)),
}
HALF_VIEW_RAD = 0.6
CLUTTER = {"ground": 47, "above": 24}


@dataclass(frozen=True)
class Road:
    """How an object drives: on a circle or straight on, upright, from where its bottom's middle is at time 0."""

    track: str
    label: str
    start_m: tuple[float, float, float]
    heading_rad: float
    size_m: tuple[float, float, float]
    speed_m_s: float
    turn_rad_s: float
    points: tuple[int, ...]
    attributes: Mapping[str, str]

    def heading_at(self, time_s: float) -> float:
        """Where it looks, counter-clockwise from the world's +x."""
        return self.heading_rad + self.turn_rad_s * time_s

    def centre_at(self, time_s: float) -> np.ndarray:
        """Where its centre is in the world."""
        start, end = self.heading_rad, self.heading_at(time_s)
        if self.turn_rad_s:
            radius = self.speed_m_s / self.turn_rad_s
            step = radius * np.array([np.sin(end) - np.sin(start), np.cos(start) - np.cos(end), 0.0])
        else:
            step = self.speed_m_s * time_s * np.array([np.cos(start), np.sin(start), 0.0])
        return np.add(self.start_m, (0.0, 0.0, self.size_m[2] / 2)) + step


ROADS = (
    Road(
        *("turning car", "Car", (228.0, -80.0, 0.05), 1.9, (4.42, 1.83, 1.51), 5.0, 0.5, (31, 28, 34)),
        {"signal": "Left", "doors": "Closed"},
    ),
    Road(
        *("passing car", "Car", (240.0, -52.0, 0.4), -2.3, (4.71, 1.94, 1.62), 8.0, 0.0, (13, 17, 19)),
        {"signal": "Off", "doors": "Closed"},
    ),
    Road(
        *("walker", "Pedestrian", (217.5, -78.5, 0.1), 2.6, (0.62, 0.71, 1.83), 0.0, 0.0, (0, 11, 0)),
        {"posture": "Standing"},
    ),
)


@dataclass(frozen=True)
class ScaleBox:
    """One cuboid as it is in the world; its heading is counter-clockwise from +x, between -pi and pi."""

    track: str
    label: str
    centre_m: tuple[float, float, float]
    length_m: float
    width_m: float
    height_m: float
    heading_rad: float
    points: int
    stationary: bool
    attributes: Mapping[str, str]

    def box_truth(self, ours: str | None) -> BoxTruth:
        """It as other trees have it."""
        return BoxTruth(
            track=self.track,
            original=self.label,
            ours=ours,
            centre_m=np.array(self.centre_m),
            size_m=np.array([self.length_m, self.width_m, self.height_m]),
            rotation=rotation_z(self.heading_rad),
            points=self.points,
            attribute=next(iter(self.attributes.values())),
            moving=not self.stationary,
        )


@dataclass(frozen=True, eq=False)
class ScaleFrame:
    """One frame: points of the world as its file has them, (n, 3) float64, and the columns beside them, (n,)."""

    frame_id: int
    time_ns: int
    world_T_device: np.ndarray
    points_m: np.ndarray
    intensity: np.ndarray
    device: np.ndarray
    times_ns: np.ndarray
    ground: np.ndarray
    boxes: tuple[ScaleBox, ...]


def wrapped(angle_rad: float) -> float:
    """An angle from -pi to below pi."""
    return float(np.mod(angle_rad + np.pi, 2 * np.pi) - np.pi)


def scale_frames() -> list[ScaleFrame]:
    """The frames of the drive in the order of time; always the same."""
    return [scale_frame(number, time_s) for number, time_s in enumerate(TIMES_S)]


def scale_frame(number: int, time_s: float) -> ScaleFrame:
    """One frame: points within the objects, on the ground and above it, and then what lies in every object."""
    random = np.random.default_rng([SCENE.seed, number])
    world_T_device = SCENE.world_T_ego(time_s)
    parts, solids = [], []
    for road in ROADS:
        if not road.points[number]:
            continue
        turn, centre = rotation_z(road.heading_at(time_s)), road.centre_at(time_s)
        body = random.uniform((-0.45, -0.45, -0.45), (0.45, 0.2, 0.35), (road.points[number], 3)) * road.size_m
        parts.append(body @ turn.T + centre)
        solids.append((centre, turn, np.add(road.size_m, 1.0)))
    objects = sum(len(part) for part in parts)
    low, high = np.array([-30.0, -30.0]), np.array([45.0, 30.0])
    for (bottom, top), count in zip(((-0.05, 0.05), (0.5, 4.0)), CLUTTER.values(), strict=True):
        lot = np.column_stack([random.uniform(low, high, (400, 2)), np.zeros(400)])
        lot = apply(pose_of(rotation_z(SCENE.heading_rad), SCENE.origin_m), lot)
        lot[:, 2] = random.uniform(bottom, top, 400)
        clear = np.ones(400, bool)
        for centre, turn, size in solids:  # half a metre off every object
            clear &= (np.abs((lot - centre) @ turn) > size / 2).any(axis=1)
        parts.append(lot[clear][:count])
    order = random.permutation(objects + sum(CLUTTER.values()))
    points = np.concatenate(parts).round(4)[order]
    time_ns = START_NS + round(time_s * 1e9)
    boxes = []
    for road in ROADS:
        if road.points[number]:
            box = ScaleBox(
                track=road.track,
                label=road.label,
                centre_m=tuple(road.centre_at(time_s).tolist()),
                length_m=road.size_m[0],
                width_m=road.size_m[1],
                height_m=road.size_m[2],
                heading_rad=wrapped(road.heading_at(time_s)),
                points=road.points[number],
                stationary=road.speed_m_s == 0,
                attributes=road.attributes,
            )
            assert counted(points, box.box_truth(None)) == box.points
            boxes.append(box)
    return ScaleFrame(
        frame_id=FRAME_IDS[number],
        time_ns=time_ns,
        world_T_device=world_T_device,
        points_m=points,
        intensity=(strengths(len(points), number) / 255).round(4),
        device=np.arange(len(points)) % 3 // 2,
        times_ns=time_ns + np.linspace(0, 99_840_000, len(points)).astype(np.int64),
        ground=(order >= objects) & (order < objects + CLUTTER["ground"]),
        boxes=tuple(boxes),
    )


def scale_truth(classes: Mapping[str, str] | None = None, *, apart: bool = False) -> Truth:
    """What the tree holds, for ``check_dataset``.

    Args:
        classes: Ours of Scale's labels, which are the customer's own words; others are not checked.
        apart: Whether a reader gives the points of every device as a cloud of its own; the files are the same.
    """
    frames = []
    for frame in scale_frames():
        masks = {f"lidar_{number}": frame.device == number for number in (0, 1)}
        clouds = {
            name: CloudTruth(
                world_m=frame.points_m[mask],
                intensity=frame.intensity[mask],
                offsets_s=(frame.times_ns[mask] - frame.time_ns) * 1e-9,
            )
            for name, mask in (masks if apart else {"lidar": frame.device >= 0}).items()
        }
        frames.append(
            FrameTruth(
                sequence=None,
                frame_id=None,
                time_ns=frame.time_ns,
                clouds=clouds,
                boxes=[box.box_truth((classes or {}).get(box.label)) for box in frame.boxes],
                world_T_ego=frame.world_T_device,
            )
        )
    return Truth(frames=frames)


def write_scale(root: Path, *, answer: str = "callback") -> Path:
    """One drive of three frames and its answer.

    Args:
        root: The folder in which the drive's own is made.
        answer: Whether the body of the ``callback`` or the ``task`` as the API gives it lies beside the annotations.

    Returns:
        The drive's folder.
    """
    folder = root / DRIVE
    folder.mkdir(parents=True)
    frames = scale_frames()
    for frame in frames:
        (folder / f"frame-{frame.frame_id}.json").write_text(json.dumps(frame_object(frame)))
        for camera in DEVICE_T_CAMERA:
            (folder / f"image-{camera}-{frame.frame_id}.jpg").write_bytes(tiny_jpeg())
    (folder / "annotations.json").write_text(json.dumps([cuboids(frame) for frame in frames]))
    task = task_object(frames)
    body = {"response": task["response"], "task_id": task["task_id"], "task": task}
    (folder / f"{answer}.json").write_text(json.dumps({"callback": body, "task": task}[answer]))
    return folder


def frame_object(frame: ScaleFrame) -> dict[str, Any]:
    """A frame as it is uploaded."""
    points = []
    for row, (x, y, z) in enumerate(frame.points_m.tolist()):
        point = {"x": x, "y": y, "z": z, "i": float(frame.intensity[row]), "d": int(frame.device[row])}
        point["t"] = int(frame.times_ns[row])
        points.append(point | ({"is_ground": True} if frame.ground[row] else {}))
    position, heading = pose_object(frame.world_T_device)
    images = [image_object(frame, camera) for camera in DEVICE_T_CAMERA]
    return {
        "images": images,
        "points": points,
        "device_position": position,
        "device_heading": heading,
        "timestamp": frame.time_ns,
    }


def image_object(frame: ScaleFrame, camera: str) -> dict[str, Any]:
    """A picture of a frame, with where in the world its camera is."""
    position, heading = pose_object(frame.world_T_device @ DEVICE_T_CAMERA[camera])
    return {
        "position": position,
        "heading": heading,
        "image_url": f"{URL}/image-{camera}-{frame.frame_id}.jpg",
        "camera_model": "brown_conrady",
        **{"fx": 12.0, "fy": 12.1, "cx": 8.0, "cy": 6.0, "skew": 0},
        **dict.fromkeys(("k1", "k2", "p1", "p2", "k3", "k4"), 0.0),
        "scale_factor": 1,
        "timestamp": frame.time_ns + 50_000_000,
    }


def pose_object(pose: np.ndarray) -> tuple[dict[str, float], dict[str, float]]:
    """A position and a heading."""
    position = dict(zip("xyz", pose[:3, 3].tolist(), strict=True))
    return position, dict(zip("wxyz", quaternion(pose[:3, :3]), strict=True))


def cuboids(frame: ScaleFrame) -> dict[str, Any]:
    """The answer to a frame; objects stand in another order in every one."""
    order = np.random.default_rng(frame.frame_id).permutation(len(frame.boxes))
    return {"cuboids": [cuboid(frame, frame.boxes[row]) for row in order]}


def cuboid(frame: ScaleFrame, box: ScaleBox) -> dict[str, Any]:
    """One object: its x is the width, its y the length, and yaw 0 looks along the world's y."""
    centre = np.array(box.centre_m)
    viewed = {}
    for number, pose in enumerate(DEVICE_T_CAMERA.values()):
        x, _, z = apply(np.linalg.inv(frame.world_T_device @ pose), centre[None])[0]
        if abs(np.arctan2(x, z)) < HALF_VIEW_RAD:
            viewed = {"camera_used": number}
    return {
        "uuid": str(uuid.uuid5(uuid.NAMESPACE_URL, f"{URL}/{box.track}")).upper(),
        **viewed,
        "label": box.label,
        "position": dict(zip("xyz", box.centre_m, strict=True)),
        "dimensions": {"x": box.width_m, "y": box.length_m, "z": box.height_m},
        "yaw": wrapped(box.heading_rad - np.pi / 2),
        "distance_to_device": round(float(np.linalg.norm(centre - frame.world_T_device[:3, 3])), 2),
        "numberOfPoints": box.points,
        "stationary": box.stationary,
        "attributes": dict(box.attributes),
    }


def task_object(frames: list[ScaleFrame]) -> dict[str, Any]:
    """The task when it is done: what was ordered, and where the answer lies."""
    choices = {"signal": ["Off", "Left", "Right"], "doors": ["Closed", "Open"], "posture": ["Standing", "Sitting"]}
    return {
        "task_id": "5967d6b572633603819b188d",
        "type": "lidarannotation",
        "status": "completed",
        "params": {
            "attachment_type": "json",
            "attachments": [f"{URL}/frame-{frame.frame_id}.json" for frame in frames],
            "labels": list(LABELS),
            "meters_per_unit": 1,
            "annotation_attributes": {
                name: {"type": "category", "description": f"Which {name}?", "choices": words}
                for name, words in choices.items()
            },
        },
        "response": {"annotations": {"url": RESULT}},
    }

"""The world of all generated trees: a car that turns left while it drives, and objects at ranges from 5 to 150 m.

Nothing in it is symmetrical: objects differ in kind, number of points, heading and side, their points fill but one part
of them, and the vehicle rolls and pitches a little. An axis, a sign, an order of sizes, a unit or a time that is read
wrong puts points elsewhere.
"""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from PIL import Image

from .truth import BoxTruth, CloudTruth, apply, counted

SPEED_M_S, TURN_RAD_S, ROLL_RAD, PITCH_RAD = 11.0, 0.15, 0.011, -0.017


@dataclass(frozen=True)
class Thing:
    """An object: where it is at time 0 relative to the vehicle, how it drives, and how many points it gets."""

    track: str
    kind: str
    place_m: tuple[float, float, float]
    yaw_rad: float
    size_m: tuple[float, float, float]
    speed_m_s: float
    points: int
    frames: tuple[int, ...] | None = None


THINGS = (
    Thing("walker", "pedestrian", (4.1, 2.9, 0.1), 2.3, (0.62, 0.71, 1.83), 1.3, 37),
    Thing("near car", "car", (16.0, -5.5, 0.0), 0.4, (4.42, 1.83, 1.51), 6.0, 52),
    Thing("truck behind", "truck", (-27.0, 9.0, 1.1), -0.7, (9.3, 2.61, 3.4), 9.0, 45),
    Thing("cyclist", "bicycle", (58.0, 15.0, 0.2), -2.9, (1.77, 0.63, 1.44), 4.0, 21),
    Thing("far car", "car", (96.0, -24.0, 0.3), 1.7, (4.71, 1.94, 1.62), 0.0, 12),
    Thing("far truck", "truck", (141.0, 44.0, 1.6), -1.2, (7.7, 2.4, 3.1), 12.0, 8),
    Thing("unseen car", "car", (33.0, 21.0, 0.0), 3.0, (4.1, 1.7, 1.4), 0.0, 0),
    Thing("once", "pedestrian", (9.0, 11.0, 0.1), -1.0, (0.7, 0.66, 1.71), 0.0, 9, (1,)),
)


def rotation_z(angle_rad: float) -> np.ndarray:
    """Turn about z, counter-clockwise."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def rotation_y(angle_rad: float) -> np.ndarray:
    """Turn about y."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def rotation_x(angle_rad: float) -> np.ndarray:
    """Turn about x."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def pose_of(rotation: np.ndarray, place_m: Sequence[float]) -> np.ndarray:
    """A rotation and a place as a matrix."""
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = rotation, place_m
    return made


def quaternion(rotation: np.ndarray) -> list[float]:
    """A rotation as w, x, y, z with w >= 0, of Shepperd's method."""
    m = rotation
    squares = np.array([1 + m[0, 0] + m[1, 1] + m[2, 2], *(1 + 2 * m[i, i] - np.trace(m) for i in range(3))])
    largest = int(np.argmax(squares))
    q = np.empty(4)
    q[largest] = squares[largest]
    if largest == 0:
        q[1:] = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    else:
        i = largest - 1
        j, k = (i + 1) % 3, (i + 2) % 3
        q[0], q[1 + j], q[1 + k] = m[k, j] - m[j, k], m[j, i] + m[i, j], m[k, i] + m[i, k]
    q /= np.linalg.norm(q)
    return [float(value) for value in (q if q[0] >= 0 else -q)]


@dataclass(frozen=True)
class Scene:
    """A drive through the world.

    Args:
        seed: Of the points.
        origin_m: Where in the world the vehicle is at time 0.
        heading_rad: Where it then looks.
        level: Whether the vehicle neither rolls nor pitches.
        still: Whether it stands.
    """

    seed: int = 7
    origin_m: tuple[float, float, float] = (1311.5, 987.25, 0.0)
    heading_rad: float = 0.9
    level: bool = False
    still: bool = False

    def world_T_ego(self, time_s: float) -> np.ndarray:
        """Where the vehicle is: it drives on a circle."""
        turn = 0.0 if self.still else TURN_RAD_S * time_s
        start, end = self.heading_rad, self.heading_rad + turn
        radius = SPEED_M_S / TURN_RAD_S
        step = radius * np.array([np.sin(end) - np.sin(start), np.cos(start) - np.cos(end), 0.0])
        tilt = np.eye(3) if self.level else rotation_y(PITCH_RAD) @ rotation_x(ROLL_RAD)
        return pose_of(rotation_z(end) @ tilt, np.array(self.origin_m) + step)

    def rotation_of(self, thing: Thing) -> np.ndarray:
        """How an object stands in the world: upright."""
        return rotation_z(self.heading_rad + thing.yaw_rad)

    def velocity_of(self, thing: Thing) -> np.ndarray:
        """How fast it drives in the world, along its heading."""
        return np.zeros(3) if self.still else self.rotation_of(thing)[:, 0] * thing.speed_m_s

    def centre_of(self, thing: Thing, time_s: float) -> np.ndarray:
        """Where its centre is; its bottom stands about the ground."""
        lifted = np.add(thing.place_m, (0.0, 0.0, thing.size_m[2] / 2))
        start = np.array(self.origin_m) + rotation_z(self.heading_rad) @ lifted
        return start + self.velocity_of(thing) * time_s

    def points(
        self, number: int, time_s: float, salt: int, *, clutter: int, things: Sequence[Thing] = THINGS
    ) -> np.ndarray:
        """Points of the world that a sensor measures in one frame, (n, 3) float64: those of the objects, then others.

        Args:
            number: Of the frame.
            time_s: When.
            salt: The sensor's own number, so that no two measure alike.
            clutter: How many more points there are, on the ground and far from the objects.
            things: The objects.
        """
        random = np.random.default_rng([self.seed, salt, round((time_s + 100) * 1e6)])
        parts = []
        for thing in visible(things, number):
            share = random.uniform((-0.12, -0.35, -0.4), (0.42, 0.1, 0.38), (thing.points, 3))
            body = share * np.array(thing.size_m)
            parts.append(body @ self.rotation_of(thing).T + self.centre_of(thing, time_s))
        far = random.uniform((-70, -60, -2.2), (120, 60, -1.9), (clutter, 3))
        far[:, 0] += np.where(np.hypot(far[:, 0], far[:, 1]) < 3, 9.0, 0.0)
        parts.append(apply(self.world_T_ego(time_s), far))
        return np.concatenate(parts)

    def boxes(
        self,
        number: int,
        time_s: float,
        names: Mapping[str, tuple[str, str | None]],
        points_m: np.ndarray | None = None,
        *,
        things: Sequence[Thing] = THINGS,
        attributes: Mapping[str, str] | None = None,
    ) -> list[BoxTruth]:
        """The objects of a frame.

        Args:
            number: Of the frame.
            time_s: When.
            names: The format's name and ours of every kind.
            points_m: The points that are counted, in the world.
            things: The objects.
            attributes: Those of the format by track.
        """
        boxes = []
        for thing in visible(things, number):
            box = partial(
                BoxTruth,
                track=thing.track,
                original=names[thing.kind][0],
                ours=names[thing.kind][1],
                centre_m=self.centre_of(thing, time_s),
                size_m=np.array(thing.size_m),
                rotation=self.rotation_of(thing),
                velocity_m_s=None if thing.frames else self.velocity_of(thing),
                attribute=(attributes or {}).get(thing.track),
            )
            boxes.append(box(points=None if points_m is None else counted(points_m, box())))
        return boxes


def visible(things: Sequence[Thing], number: int) -> list[Thing]:
    """The objects that are there in a frame."""
    return [thing for thing in things if thing.frames is None or number in thing.frames]


def seen(world_m: np.ndarray, world_T_sensor: np.ndarray, dtype: str = "f4") -> tuple[np.ndarray, np.ndarray]:
    """Points as a sensor's file holds them, and where these numbers are in the world."""
    held = apply(np.linalg.inv(world_T_sensor), world_m).astype(dtype)
    return held, apply(world_T_sensor, held.astype(np.float64))


def strengths(count: int, salt: int, top: int = 255) -> np.ndarray:
    """Whole intensities from 0 to a largest."""
    values = np.random.default_rng([41, salt, count]).integers(0, top + 1, count)
    values[:2] = 0, top
    return values


def cloud_truth(world_m: np.ndarray, **fields: object) -> CloudTruth:
    """A cloud with its fields."""
    return CloudTruth(world_m=world_m, **fields)  # type: ignore[arg-type]


def tiny_jpeg(width: int = 16, height: int = 12) -> bytes:
    """A picture, brighter to the right."""
    shades = np.tile(np.linspace(30, 220, width).astype(np.uint8)[None, :, None], (height, 1, 3))
    file = io.BytesIO()
    Image.fromarray(shades).save(file, format="JPEG")
    return file.getvalue()

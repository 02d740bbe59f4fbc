"""A drive with ground, cars and people in points, and annotations of it: clean, or with one planted defect."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from edited_drives import pose

from farfield.annotation.checking import CheckedFrame, CheckSettings, DetectorBox, NearbyTrack, SizeRange, TrackStep
from farfield.annotation.motion import TrackFrame, from_world, to_world, wrap_yaw
from farfield.annotation.surroundings import Surroundings
from farfield.datasets.labels import BoxLabel, Numbers

FRAMES, LIDAR_M = 12, 1.8
CLASSES = {
    "car": ((4.6, 1.9, 1.6), 12.0),
    "bus": ((11.0, 2.6, 3.2), 8.0),
    "pedestrian": ((0.75, 0.7, 1.75), 1.2),
    "bicycle": ((1.8, 0.65, 1.65), 4.0),
}
FASTEST = {"pedestrian": 4.0, "bicycle": 15.0}
SETTINGS = CheckSettings(
    sizes={
        name: SizeRange(
            usual=size,
            low=tuple(0.8 * s for s in size),
            high=tuple(1.25 * s for s in size),  # type: ignore[arg-type]
        )
        for name, (size, _) in CLASSES.items()
    },
    fastest_m_s=FASTEST,
)
Drawn = dict[int, dict[str, BoxLabel]]
"""Labels by frame and track."""


class CheckedDrive:
    """25 objects over 12 frames, their boxes with a careful hand's noise (3 cm, half a degree), sizes locked.

    Args:
        seed: Another drive for each.
    """

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.world = self._objects()
        self.moments = [TrackFrame(("a", f"{row:04d}"), row / 10, pose(row)) for row in range(FRAMES)]
        self.true: Drawn = {row: self._labels(row) for row in range(FRAMES)}
        self.drawn: Drawn = {row: {t: self._by_hand(b) for t, b in self.true[row].items()} for row in range(FRAMES)}
        self._around: dict[int, Surroundings] = {}

    def _objects(self) -> list[tuple[str, Numbers, float]]:
        """Class, box in the world at time 0, speed: in lanes 3.6 m apart, far enough from each other."""
        found = []
        names = list(CLASSES)
        for number in range(25):
            name = names[number % 4] if number % 5 else "car"
            size, fastest = CLASSES[name]
            lane, place = number % 5, number // 5
            x, y = 8.0 + 17 * place + self.rng.uniform(-1, 1), -8.0 + 4.2 * lane + self.rng.uniform(-0.2, 0.2)
            scale = self.rng.uniform(0.95, 1.05)
            own = tuple(scale * s for s in size)
            yaw = self.rng.uniform(-0.05, 0.05) + (np.pi if lane < 2 else 0.0)
            box = (x, y, own[2] / 2 - LIDAR_M, *own, wrap_yaw(float(yaw)))
            found.append((name, box, float(self.rng.uniform(0.3, 1.0) * min(fastest, 10.0) * (place == lane))))
        return found  # type: ignore[return-value]

    def _labels(self, row: int) -> dict[str, BoxLabel]:
        moment = self.moments[row]
        found = {}
        for number, (name, box, speed) in enumerate(self.world):
            gone = speed * moment.time_s
            there = (box[0] + gone * np.cos(box[6]), box[1] + gone * np.sin(box[6]), *box[2:])
            seen = from_world(tuple(map(float, there)), moment)  # type: ignore[arg-type]
            found[str(number)] = BoxLabel(id=f"b{number}", label=name, box=seen, track=str(number))
        return found

    def _by_hand(self, label: BoxLabel) -> BoxLabel:
        x, y, z = (value + self.rng.normal(0, 0.03) for value in label.box[:3])
        yaw = wrap_yaw(label.box[6] + self.rng.normal(0, np.deg2rad(0.5)))
        return replace(label, box=(x, y, z, *label.box[3:6], yaw))

    def points(self, row: int) -> np.ndarray:
        """Ground in rings, and the faces of the objects; 2 cm of noise. Nothing hides anything."""
        rng = np.random.default_rng(row)
        angle, reach = rng.uniform(-np.pi, np.pi, 30_000), 3 * np.exp(rng.uniform(0, 3.6, 30_000))
        ground = np.column_stack([reach * np.cos(angle), reach * np.sin(angle), np.full(30_000, -LIDAR_M)])
        labels = [label.box for label in self.true[row].values()]
        for box in labels:
            ground = ground[~_inside(ground, box)]
        return np.concatenate([ground, *(_faces(box, rng) for box in labels)]).astype(np.float32)

    def scene(self, row: int, detections: tuple[DetectorBox, ...] = ()) -> CheckedFrame:
        if row not in self._around:
            self._around[row] = Surroundings(self.points(row))
        return CheckedFrame(key=self.moments[row].key, row=row, around=self._around[row], detections=detections)


def courses_of(drive: CheckedDrive, drawn: Drawn) -> dict[str, NearbyTrack]:
    tracks: dict[str, list[TrackStep]] = {}
    for row, labels in drawn.items():
        for track, label in labels.items():
            box = to_world(label.box, drive.moments[row])
            tracks.setdefault(track, []).append(TrackStep(row, drive.moments[row].time_s, box))
    return {track: NearbyTrack(steps, len(steps), posed=True) for track, steps in tracks.items()}


def _inside(points: np.ndarray, box: Numbers) -> np.ndarray:
    cos, sin = np.cos(box[6]), np.sin(box[6])
    x, y = points[:, 0] - box[0], points[:, 1] - box[1]
    return (abs(x * cos + y * sin) < box[3] / 2) & (abs(y * cos - x * sin) < box[4] / 2)


def _faces(box: Numbers, rng: np.random.Generator) -> np.ndarray:
    """Points on the four sides: more of them near the sensor, at least 40."""
    count = int(np.clip(40_000 / (box[0] ** 2 + box[1] ** 2), 40, 600))
    half = np.array(box[3:6]) / 2 - 0.03
    local = rng.uniform(-1, 1, (count, 3)) * half
    side = rng.integers(0, 2, count)
    local[np.arange(count), side] = np.sign(local[np.arange(count), side]) * half[side]
    cos, sin = np.cos(box[6]), np.sin(box[6])
    x, y = local[:, 0] * cos - local[:, 1] * sin, local[:, 0] * sin + local[:, 1] * cos
    return np.column_stack([x, y, local[:, 2]]) + np.array(box[:3]) + rng.normal(0, 0.01, (count, 3))


def moved(label: BoxLabel, **changes: float) -> BoxLabel:
    """A label with numbers added to its box: x, y, z, l, w, h, yaw."""
    names = ("x", "y", "z", "l", "w", "h", "yaw")
    box = [value + changes.get(name, 0.0) for name, value in zip(names, label.box, strict=True)]
    return replace(label, box=(*box[:6], wrap_yaw(box[6])))  # type: ignore[arg-type]


Defect = Callable[[CheckedDrive, Drawn, int, str, np.random.Generator], None]
"""Spoils one track in one frame of the annotation."""


def _size(drive: CheckedDrive, drawn: Drawn, row: int, track: str, rng: np.random.Generator) -> None:
    for labels in drawn.values():
        labels[track] = moved(labels[track], l=float(rng.uniform(0.35, 0.8)) * labels[track].box[3])


def _track_size(drive: CheckedDrive, drawn: Drawn, row: int, track: str, rng: np.random.Generator) -> None:
    drawn[row][track] = moved(drawn[row][track], l=float(rng.uniform(0.06, 0.15)) * drawn[row][track].box[3])


def _turn(drive: CheckedDrive, drawn: Drawn, row: int, track: str, rng: np.random.Generator) -> None:
    drawn[row][track] = moved(drawn[row][track], yaw=float(rng.choice([-1, 1]) * rng.uniform(0.4, np.pi)))


def _jump(drive: CheckedDrive, drawn: Drawn, row: int, track: str, rng: np.random.Generator) -> None:
    angle, far = rng.uniform(-np.pi, np.pi), rng.uniform(0.8, 3.0)
    drawn[row][track] = moved(drawn[row][track], x=float(far * np.cos(angle)), y=float(far * np.sin(angle)))


def _speed(drive: CheckedDrive, drawn: Drawn, row: int, track: str, rng: np.random.Generator) -> None:
    label = drawn[row][track]
    far = 1.2 * FASTEST.get(label.label, 60.0) / 10
    for later in range(row, FRAMES):
        drawn[later][track] = moved(drawn[later][track], x=far * (later - row + 1))


def _overlap(drive: CheckedDrive, drawn: Drawn, row: int, track: str, rng: np.random.Generator) -> None:
    label = drawn[row][track]
    shift = float(rng.uniform(0, 0.7)) * label.box[3]
    twin = moved(label, x=shift * float(np.cos(label.box[6])), y=shift * float(np.sin(label.box[6])))
    drawn[row]["twin"] = replace(twin, id="twin", track="99")


def _twice(drive: CheckedDrive, drawn: Drawn, row: int, track: str, rng: np.random.Generator) -> None:
    drawn[row]["twin"] = replace(moved(drawn[row][track], x=15.0, y=15.0), id="twin")


def _gap(drive: CheckedDrive, drawn: Drawn, row: int, track: str, rng: np.random.Generator) -> None:
    for missing in range(row - int(rng.integers(1, 4)), row):
        drawn[missing].pop(track)


def _short(drive: CheckedDrive, drawn: Drawn, row: int, track: str, rng: np.random.Generator) -> None:
    for other in range(FRAMES):
        if other not in (row, row + 1):
            drawn[other].pop(track)


def _ground(drive: CheckedDrive, drawn: Drawn, row: int, track: str, rng: np.random.Generator) -> None:
    drawn[row][track] = moved(drawn[row][track], z=float(rng.choice([-1, 1]) * rng.uniform(0.5, 1.5)))


def _empty(drive: CheckedDrive, drawn: Drawn, row: int, track: str, rng: np.random.Generator) -> None:
    drawn[row][track] = replace(drawn[row][track], box=(*drawn[row][track].box[:2], 40.0, *drawn[row][track].box[3:]))


def _outside(drive: CheckedDrive, drawn: Drawn, row: int, track: str, rng: np.random.Generator) -> None:
    label = drawn[row][track]
    drawn[row][track] = moved(label, l=-0.3, w=-0.3)


def _broken(drive: CheckedDrive, drawn: Drawn, row: int, track: str, rng: np.random.Generator) -> None:
    box = list(drawn[row][track].box)
    place, value = [(0, 400.0), (6, float("nan")), (3, 0.0), (4, -1.0)][int(rng.integers(4))]
    box[place] = value
    drawn[row][track] = replace(drawn[row][track], box=tuple(box))  # type: ignore[arg-type]


DEFECTS: dict[str, Defect] = {
    "size": _size,
    "track_size": _track_size,
    "turn": _turn,
    "jump": _jump,
    "speed": _speed,
    "overlap": _overlap,
    "twice": _twice,
    "gap": _gap,
    "short": _short,
    "ground": _ground,
    "empty": _empty,
    "outside": _outside,
    "broken": _broken,
}

"""Random scenes and small helpers for the tests of the metrics."""

import numpy as np

from farfield.frame.annotation import Annotation
from farfield.geometry.boxes import Boxes
from farfield.metrics import Detections
from farfield.metrics.bootstrap import Bootstrap

NO_BOOTSTRAP = Bootstrap(replicates=0)
ByFrame = dict[tuple[str, str], Boxes]


def boxes(rows: list[tuple[float, ...]], *, scored: bool = True, label: str = "vehicle") -> Boxes:
    """Boxes from (x, y, z, length, width, height, yaw, score) rows."""
    if not rows:
        return Boxes.empty(scored=scored)
    table = np.array(rows, dtype=np.float64)
    return Boxes(
        centre_m=table[:, :3],
        size_m=table[:, 3:6],
        yaw_rad=table[:, 6],
        label=label,
        score=table[:, 7] if scored else None,
    )


def car(x: float, y: float = 0.0, *, score: float = 0.0, z: float = 0.0, yaw: float = 0.0) -> tuple[float, ...]:
    return (x, y, z, 4.0, 2.0, 1.5, yaw, score)


def random_scene(rng: np.random.Generator, *, frames: int = 12, sequences: int = 3) -> tuple[ByFrame, ByFrame]:
    """Crowded frames with tied scores, missed and doubled boxes, several classes, empty frames and point counts."""
    predictions, annotations = {}, {}
    for number in range(frames):
        key = (f"drive{number % sequences}", str(number))
        many = 0 if number == 1 else int(rng.integers(1, 9))
        centre = np.column_stack([rng.uniform(1, 260, many), rng.uniform(-60, 60, many), rng.normal(0, 1, many)])
        centre[: many // 2] = centre[:1] + rng.normal(0, 2, (many // 2, 3))  # crowds, so that boxes are contested
        size = rng.uniform([3, 1.5, 1.3], [12, 2.6, 3.5], (many, 3))
        yaw = rng.uniform(-np.pi, np.pi, many)
        names = rng.choice(["vehicle", "large_vehicle", "pedestrian", "unknown"], many, p=[0.5, 0.2, 0.1, 0.2])
        annotations[key] = Boxes(
            centre_m=centre, size_m=size, yaw_rad=yaw, label=names, point_count=rng.integers(0, 4, many)
        )
        source = rng.integers(0, many, int(rng.integers(0, 3 * many + 1))) if many else np.zeros(0, dtype=int)
        extra = int(rng.integers(0, 3)) + (many == 0)
        found = np.concatenate(
            [centre[source], np.column_stack([rng.uniform(0, 250, extra), *rng.normal(0, 9, (2, extra))])]
        )
        predictions[key] = Boxes(
            centre_m=found + rng.normal(0, 1, found.shape) * rng.choice([0.2, 1.0, 3.0], (len(found), 1)),
            size_m=np.concatenate([size[source], np.full((extra, 3), 2.0)]) * rng.uniform(0.8, 1.2, (len(found), 3)),
            yaw_rad=np.concatenate([yaw[source], np.zeros(extra)]) + rng.normal(0, 0.3, len(found)),
            label=rng.choice(["vehicle", "large_vehicle", "pedestrian"], len(found), p=[0.6, 0.3, 0.1]),
            score=np.round(rng.uniform(0.01, 1, len(found)), 1),
        )
    return predictions, annotations


def as_predictions(annotations: ByFrame) -> ByFrame:
    """The annotated boxes as if a detector had found them, all with one score."""
    return {key: part.replace(score=np.ones(len(part))) for key, part in annotations.items()}


def better_on(good_on: str, seed: int = 0) -> Detections:
    """Twelve drives, every other one in town; the boxes are right on one kind of road and 3 m off on the other."""
    predictions, annotations = random_scene(np.random.default_rng(0), frames=24, sequences=12)
    names = sorted({key[0] for key in annotations})
    road = {name: ("urban", "highway")[place % 2] for place, name in enumerate(names)}
    noise = np.random.default_rng(seed)
    boxes = {}
    for key in predictions:
        truth = annotations[key]
        off = 0.05 if road[key[0]] == good_on else 3.0
        moved = truth.centre_m + off * noise.normal(0, 1, truth.centre_m.shape)
        boxes[key] = truth.replace(centre_m=moved, score=noise.uniform(0.2, 1, len(truth)))
    return Detections(
        boxes=boxes,
        annotations={key: Annotation(boxes=each) for key, each in annotations.items()},
        conditions={key: {"road": road[key[0]]} for key in annotations},
    )

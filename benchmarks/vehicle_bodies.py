"""Bodies of simulated vehicles beside real ones: where points lie in annotated boxes, by visible side and range."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from _report import SHARED_REAL, MissingError, Part, part_parser, run_parts
from real_road import Donors, donors
from scipy.spatial import cKDTree
from scipy.stats import wasserstein_distance

from farfield.frame import Boxes, Frame
from farfield.geometry.boxes import box_coordinates_m, points_in_boxes
from farfield.simulation.bodies.actors import Actor
from farfield.simulation.bodies.vehicles import BODY_STYLES
from farfield.simulation.donors import DonorSweep, StandingBody, paste

WORLDS = ("v2", "v3")
RANGES_M = ((4.0, 20.0), (20.0, 45.0))
LEAST_POINTS, LONGEST_M = 30, 6.5
_ABOVE_M, _BESIDE_M = 0.2, 0.15  # points so far above the bottom and so far beside the box count
_OUTERMOST = 0.03  # quantile of the lower body's insets that counts as 0: annotators leave room about a car
_MOST_ROOM_M = 0.35
_ALIKE = (0.5, 2.0)  # as many simulated as real points, or something else hides one of them
_SAMPLES, _SAMPLED = 2000, 200  # on a body's surface, of a real car's points
_BALL_M, _LEAST_IN_BALL, _PATCHES = 0.75, 10, 60
_QUANTILES = np.linspace(0.02, 0.98, 25)  # a car's values of a line, so that every car weighs the same
_LEAST_VALUES, _REPLICATES, _SEED = 5, 200, 61

SINGLE, MERGED = "KITTI, View-of-Delft, Argoverse 2", "Luminar, several sensors merged"
LINES = {
    "height": "height over the bottom / box height",
    "end, low": "inset from the body's visible end, lower body, m",
    "end, high": "inset from that end, windows and roof, m",
    "side, low": "inset from the body's visible side, lower body, m",
    "side, high": "inset from that side, windows and roof, m",
    "variation": "surface variation of patches",
    "thickness": "thickness of patches, cm",
}
SHARES = {
    "roof": "share of points on the roof (height > 0.9)",
    "windows": "share at the windows (0.62 to 0.9)",
    "low": "share below 0.35",
    "within": "share deeper than 0.35 m within, below 0.85",
    "points": "points / real points",
}


@dataclass(frozen=True)
class CarPoints:
    """One body's points: values of each line, and shares."""

    lines: dict[str, np.ndarray]
    """25 quantiles of each; empty where there are too few values."""
    shares: dict[str, float]


def measured(points_m: np.ndarray, boxes: Boxes, row: int) -> CarPoints | None:
    """What the points in one box say, or None of too few.

    Args:
        points_m: Points about the box in the sensor's axes, shape (n, 3).
        boxes: Boxes in the same axes.
        row: Which of them.
    """
    half = boxes.size_m[row] / 2
    local, sensor = box_coordinates_m(points_m, boxes, row), box_coordinates_m(np.zeros((1, 3)), boxes, row)[0]
    local = local[(np.abs(local) <= half + _BESIDE_M).all(axis=1) & (local[:, 2] > _ABOVE_M - half[2])]
    if len(local) < LEAST_POINTS:
        return None
    height = (local[:, 2] + half[2]) / (2 * half[2])
    inset = half[:2] - np.sign(sensor[:2]) * local[:, :2]
    low = height < 0.6
    if low.sum() < LEAST_POINTS / 3:
        return None
    visible = np.abs(sensor[:2]) > half[:2] + 0.5
    inset = np.where(visible, inset - np.quantile(inset[low], _OUTERMOST, axis=0), np.inf)
    nearest, face = inset.min(axis=1), inset.argmin(axis=1)
    variation, thickness = patches(local)
    lines = {
        "height": height,
        "end, low": nearest[(face == 0) & low],
        "end, high": nearest[(face == 0) & ~low],
        "side, low": nearest[(face == 1) & low],
        "side, high": nearest[(face == 1) & ~low],
        "variation": variation,
        "thickness": 100 * thickness,
    }
    shares = {
        "roof": float((height > 0.9).mean()),
        "windows": float(((height > 0.62) & (height <= 0.9)).mean()),
        "low": float((height < 0.35).mean()),
        "within": float(((nearest > 0.35) & (height < 0.85)).mean()),
        "points": float(len(local)),
    }
    short = {name: np.quantile(v, _QUANTILES) if len(v) >= _LEAST_VALUES else v[:0] for name, v in lines.items()}
    return CarPoints(short, shares)


def patches(points_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Surface variation and thickness of patches of 0.75 m about some of the points."""
    some = points_m[np.random.default_rng(_SEED).permutation(len(points_m))[:_PATCHES]]
    variation, thickness = [], []
    for near in cKDTree(points_m).query_ball_point(some, _BALL_M):
        if len(near) < _LEAST_IN_BALL:
            continue
        values = np.maximum(np.linalg.eigvalsh(np.cov(points_m[near].T)), 0.0)
        variation.append(values[0] / values.sum())
        thickness.append(np.sqrt(values[0]))
    return np.array(variation), np.array(thickness)


def alike(car: dict[str, CarPoints]) -> bool:
    """Whether a real car and the simulated ones in its place have about as many points."""
    ratio = np.mean([car[world].shares["points"] for world in WORLDS]) / car["real"].shares["points"]
    return bool(_ALIKE[0] <= ratio <= _ALIKE[1])


def snug(points_m: np.ndarray, boxes: Boxes) -> Boxes:
    """Boxes without the room that annotators leave: shrunk to the outermost points on the sides that the sensor sees.

    The unseen sides move in by as much, the top to the highest points if they are near it.
    """
    size, centre = boxes.size_m.copy(), boxes.centre_m.copy()
    for row, rows in enumerate(points_in_boxes(points_m, boxes, margin_m=_BESIDE_M)):
        local, half = box_coordinates_m(points_m[rows], boxes, row), boxes.size_m[row] / 2
        sensor = box_coordinates_m(np.zeros((1, 3)), boxes, row)[0]
        low = local[(local[:, 2] > _ABOVE_M - half[2]) & (local[:, 2] < 0.2 * half[2])]
        if len(low) < LEAST_POINTS / 3:
            continue
        room = np.quantile(half[:2] - np.sign(sensor[:2]) * low[:, :2], _OUTERMOST / 2, axis=0)
        visible = np.abs(sensor[:2]) > half[:2] + 0.5
        size[row, :2] -= 2 * np.where(visible, np.clip(room, -0.1, _MOST_ROOM_M), 0.0)
        over = half[2] - np.quantile(local[:, 2], 1 - _OUTERMOST / 2)
        over = float(over) if -0.1 < over < _MOST_ROOM_M else 0.0
        size[row, 2] -= over
        centre[row, 2] -= over / 2
    return boxes.replace(size_m=size, centre_m=centre)


def surface_of(actor: Actor, rng: np.random.Generator) -> np.ndarray:
    """Random points on a body's triangles, shape (2000, 3); its bottom's middle is the origin."""
    mesh = actor.build()
    corners = mesh.vertices_m[mesh.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    rows = rng.choice(len(corners), size=_SAMPLES, p=area / area.sum())
    return np.einsum("nk,nkd->nd", rng.dirichlet(np.ones(3), size=_SAMPLES), corners[rows])


def actor_of(kind: str, size_m: np.ndarray, seed: tuple[int, int], world: str) -> Actor:
    """A body of a box's size."""
    length, width, height = size_m.tolist()
    return Actor(seed[1], kind, (length, width, height), np.random.SeedSequence(seed), world)


def fitting_kind(local_m: np.ndarray, size_m: np.ndarray, seed: tuple[int, int]) -> str:
    """The kind of car or van whose bodies of both worlds together lie nearest to a real car's points.

    Args:
        local_m: The points over the box's bottom's middle, in its axes, shape (n, 3).
        size_m: The box.
        seed: Draws the bodies.
    """
    rng = np.random.default_rng(seed)
    standing = local_m[local_m[:, 2] > _ABOVE_M]
    some = standing[rng.permutation(len(standing))[:_SAMPLED]]
    fit = {}
    for kind in BODY_STYLES:
        bodies = [surface_of(actor_of(kind, size_m, seed, world), rng) for world in WORLDS]
        fit[kind] = np.mean([cKDTree(body).query(some)[0].mean() for body in bodies])
    return min(fit, key=fit.__getitem__)


def cars_of(frame: Frame, one: Donors, seed: int) -> Iterator[tuple[float, dict[str, CarPoints]]]:
    """Range, and real and simulated points of every annotated car of a frame.

    The simulated one has the box's size and stands in it; the sweep without its annotated objects hides what it hid.
    """
    cloud, boxes = frame.cloud(), frame.boxes
    assert boxes is not None
    points = cloud.points_m.astype(np.float64)
    emptied = DonorSweep.of(cloud, boxes)
    away = np.hypot(*boxes.centre_m[:, :2].T)
    is_car = (boxes.label == "vehicle") & (boxes.size_m[:, 0] < LONGEST_M) & (away < RANGES_M[-1][1])
    rows = [int(row) for row in np.flatnonzero(is_car & (away > RANGES_M[0][0]))]
    boxes = snug(points, boxes)
    real = dict(zip(rows, points_in_boxes(points, boxes[rows], margin_m=2 * _BESIDE_M), strict=True)) if rows else {}
    cars = {row: measured(points[inside], boxes, row) for row, inside in real.items()}
    rows = [row for row in rows if cars[row] is not None]
    kinds = {}
    for row in rows:
        local = box_coordinates_m(points[real[row]], boxes, row) + np.array([0, 0, boxes.size_m[row, 2] / 2])
        kinds[row] = fitting_kind(local, boxes.size_m[row], (seed, row))
    simulated: dict[str, dict[int, CarPoints | None]] = {}
    for world in WORLDS:
        bodies = []
        for row in rows:
            actor = actor_of(kinds[row], boxes.size_m[row], (seed, row), world)
            x, y, z = boxes.centre_m[row].tolist()
            bodies.append(StandingBody.of(actor, x, y, z - actor.size_m[2] / 2, float(boxes.yaw_rad[row])))
        pasted = paste(emptied, bodies, one.model, np.random.default_rng(seed))
        of_body = [pasted.points_m[pasted.body == number].astype(np.float64) for number in range(len(rows))]
        simulated[world] = {row: measured(own, boxes, row) for row, own in zip(rows, of_body, strict=True)}
    for row in rows:
        triple = {"real": cars[row], **{world: simulated[world][row] for world in WORLDS}}
        if all(triple.values()) and alike(triple):  # type: ignore[arg-type]
            yield float(away[row]), triple  # type: ignore[misc]


@dataclass(frozen=True)
class Closeness:
    """How far two worlds' bodies are from real ones on one line.

    Args:
        far: Distance of each world from the real cars.
        less: By how much v3 is nearer than v2: the least and most of 95 % of draws of the cars.
        cars: How many cars.
    """

    far: tuple[float, float]
    less: tuple[float, float]
    cars: int


def closeness(cars: Sequence[dict[str, CarPoints]], name: str) -> Closeness | None:
    """Distances of a line's distributions (Wasserstein's first), or of a share's means; None of too few cars."""
    sources = ("real", *WORLDS)
    if name in LINES:
        full = [car for car in cars if all(len(car[source].lines[name]) for source in sources)]
        values = {source: np.array([car[source].lines[name] for car in full]) for source in sources}
    else:
        full = list(cars)
        values = {source: np.array([[car[source].shares[name]] for car in full]) for source in sources}
        if name == "points":
            values = {source: own / values["real"] for source, own in values.items()}
    if len(full) < _LEAST_VALUES:
        return None
    rng = np.random.default_rng(_SEED)
    draws = [np.arange(len(full)), *rng.integers(len(full), size=(_REPLICATES, len(full)))]
    far = np.array([[distance(values["real"][draw], values[world][draw], name) for world in WORLDS] for draw in draws])
    low, high = np.quantile(far[1:, 0] - far[1:, 1], [0.025, 0.975])
    return Closeness((float(far[0, 0]), float(far[0, 1])), (float(low), float(high)), len(full))


def distance(real: np.ndarray, simulated: np.ndarray, name: str) -> float:
    """Between distributions, or between means of shares."""
    if name in SHARES:
        return float(
            abs(np.median(real) - np.median(simulated)) if name == "points" else abs((real - simulated).mean())
        )
    return float(wasserstein_distance(real.ravel(), simulated.ravel()))


def run_boxes(arguments: Sequence[str]) -> None:
    """Points of real cars in their boxes, and of simulated cars of the same sizes in the same boxes of the same sweeps.

        python benchmarks/vehicle_bodies.py boxes [REAL] [--only WORD] [--frames N] [--seed N]

    Real boxes leave room about a car and a simulated body fills its box, so boxes are shrunk to the real points first,
    and insets count from each body's own outermost points. The kind is the one whose bodies of both worlds together lie
    nearest to the real points. Cars count whose simulated ones have half to twice as many points: others are hidden
    differently. Distances are Wasserstein's first in the line's unit, or differences of mean shares; v2 - v3 above 0
    means that v3 is nearer.
    """
    parser = part_parser(run_boxes.__doc__)
    parser.add_argument("real", type=Path, nargs="?", default=SHARED_REAL)
    parser.add_argument("--only", default="", help="of the sets, those whose name has this word")
    parser.add_argument("--frames", type=int, help="of each set; all unless given")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    if not options.real.is_dir():
        raise MissingError(f"no real frames in {options.real.name}")
    groups: dict[tuple[str, tuple[float, float]], list[dict[str, CarPoints]]] = {}
    for title, one in donors(options.real).items():
        if options.only not in title or title == "Luminar behind":  # the same sweeps, turned
            continue
        for number, frame in enumerate(one.frames()[: options.frames]):
            for away_m, car in cars_of(frame, one, 1000 * options.seed + number):
                span = next(span for span in RANGES_M if away_m < span[1])
                groups.setdefault((MERGED if title.startswith("Luminar") else SINGLE, span), []).append(car)
    for (group, (near_m, far_m)), cars in sorted(groups.items()):
        print(f"{group}, {near_m:.0f} to {far_m:.0f} m: {len(cars)} cars")
        print(
            f"  {'':<56}{'cars':>5}{'real':>9}{'v2':>9}{'v3':>9}   {'v2 from real':>12}{'v3 from real':>13}   v2 - v3"
        )
        for name, text in (LINES | SHARES).items():
            close = closeness(cars, name)
            if close is None:
                print(f"  {text:<56}  too few")
                continue
            middle = {source: middle_of(cars, name, source) for source in ("real", *WORLDS)}
            shown = "".join(f"{middle[source]:9.3f}" for source in ("real", *WORLDS))
            less = f"[{close.less[0]:+.3f}, {close.less[1]:+.3f}]"
            print(f"  {text:<56}{close.cars:5d}{shown}   {close.far[0]:12.3f}{close.far[1]:13.3f}   {less}", flush=True)


def middle_of(cars: Sequence[dict[str, CarPoints]], name: str, source: str) -> float:
    """Median over cars of a line's medians or of a ratio; mean of a share."""
    if name in LINES:
        own = [car[source].lines[name] for car in cars if len(car[source].lines[name])]
        return float(np.median([np.median(values) for values in own]))
    if name == "points":
        return float(np.median([car[source].shares[name] / car["real"].shares[name] for car in cars]))
    return float(np.mean([car[source].shares[name] for car in cars]))


if __name__ == "__main__":
    raise SystemExit(run_parts(__doc__, {"boxes": Part(run_boxes, "--only Argoverse")}))

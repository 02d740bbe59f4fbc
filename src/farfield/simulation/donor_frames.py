"""Frames to train on: real sweeps that lend their background, with simulated road users that stand in them.

The sweeps may be open ones or a user's own, annotated or not. Annotated objects are taken out; whatever else stands
may be a car that nobody annotated and gets a box of the class ``unsure``, where a training neither rewards nor
punishes. Every copy of a sweep looks in another direction, mostly along its road, and holds other road users.
"""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float64, Int64
from pydantic import Field
from scipy.ndimage import gaussian_filter1d

from farfield.datasets.base import Dataset, Subset
from farfield.errors import ConfigError
from farfield.files.yaml_text import PlainSettings
from farfield.frame import Annotation, Boxes, Cloud, Frame, Sensor
from farfield.frame.record import Constant
from farfield.geometry.clusters import standing_clusters
from farfield.geometry.poses import pose_from_yaw
from farfield.simulation.bodies.actors import CLASS_OF, Actor, draw_size_m, draw_truck
from farfield.simulation.donors import DonorSweep, PastedSweep, StandingBody, draw_actor, paste
from farfield.simulation.lidar.model import HDL_64E, LUMINAR_H2, OS1_128, OS2_64
from farfield.vocabulary.classes import UNSURE

MODELS = {model.name: model for model in (LUMINAR_H2, OS2_64, OS1_128, HDL_64E)}
_BANDS_M, _BAND_SHARES = ((5, 20), (20, 40), (40, 70), (70, 120)), (0.3, 0.35, 0.25, 0.1)
_PRIORS = ("us", "kitti", "korea")
_WORLD = "v3"  # whose bodies are pasted
_ALONG_SHARE, _ALONG_RAD = 0.7, 0.15  # copies that look along the road, and how well they are aligned
_ROW, _GAP_M, _SHIFT_M, _TURN_RAD = (2, 6), (0.5, 1.6), 0.15, 0.05  # cars of a row, and how they are parked
_FREE_M, _TRIES, _REACH_M, _GROUND_CELL_M = 0.4, 40, 130.0, 1.0  # free room about a body; places to try; how far
_AT_ORIGIN_M = 0.5  # a sweep that is moved less by its car's motion while it turns
_SWEEPS_READ, _SCENES_READ, _FRAMES_READ = 16, 500, 2  # about 50 MB of boxes at most
_UNSURE_TALL_M, _TILE_M, _MOST_UNSURE, _CAR_M, _PARTS_FROM_M = 10.0, 2.0, 1000, 4.5, 30.0
_CELL_M, _PATCH_M, _CELLS, _LINED = 0.25, 3.0, 5, 0.8  # patches of cells in which something stands: lined up or not

Number = float | int


class DonorConfig(PlainSettings):
    """Simulated road users pasted into sweeps."""

    copies: int = Field(40, ge=1, le=10_000, description="frames made of each sweep, each with other road users")
    vehicles: int = Field(12, ge=0, le=64, description="cars and vans a frame, as far as there is room")
    rows: float = Field(0.5, ge=0, le=1, description="share of the cars that stand in rows")
    large_vehicles: int = Field(1, ge=0, le=64, description="trucks and buses a frame")
    pedestrians: int = Field(3, ge=0, le=64, description="pedestrians a frame")
    bicycles: int = Field(2, ge=0, le=64, description="cyclists a frame")
    sensor: Literal["luminar-h2", "os2-64", "os1-128", "hdl-64e"] = Field(
        "os1-128", description="by whose law a body's echo is detected"
    )
    annotated_to_m: float = Field(
        0.0,
        ge=0,
        description="up to this range the boxes of annotated sweeps name every car; farther, and in sweeps without, "
        "whatever stands is neither object nor background",
    )
    annotations: bool = Field(
        True, description="take annotated objects out of the sweeps; false: their annotations are not looked at"
    )
    band_m: float = Field(0.5, ge=0, le=5, description="about what stands there, which does not count either")
    family: Literal["open", "own"] = Field("own", description="open: sweeps that may be shipped, weights too")
    seed: int = Field(0, ge=0, description="another seed draws other road users and places")


class DonorFrames(Subset):
    """Frames made of sweeps: ``copies`` of each, all copies of one sweep after the other.

    Clouds have the name and the columns x, y, z and intensity of the sweeps'; where these have no intensity, those
    have none. Files, and so what identifies a frame, are the sweep's.

    Args:
        sweeps: The sweeps, in their sensor's axes, z up; annotated or not.
        config: What to paste.
        cloud: Which of their clouds.
    """

    def __init__(self, sweeps: Dataset, config: DonorConfig, cloud: str) -> None:
        super().__init__(sweeps, [row for row in range(len(sweeps)) for _ in range(config.copies)])
        self.config, self.cloud = config, cloud
        self.frame_ids = tuple(f"{name}-{row % config.copies:04d}" for row, name in enumerate(self.frame_ids))
        self._set_up()

    def _set_up(self) -> None:
        self._sweep = lru_cache(maxsize=_SWEEPS_READ)(self._read)
        self._scene = lru_cache(maxsize=_SCENES_READ)(self._looked_at)
        self._pasted = lru_cache(maxsize=_FRAMES_READ)(self._made)

    def frame(self, index: int) -> Frame:
        """Build frame ``index``."""
        cloud, annotation = self._pasted(index)
        return Frame(
            sequence=self.sequences[index],
            frame_id=self.frame_ids[index],
            clouds={self.cloud: cloud},
            sensors={self.cloud: Sensor(kind="lidar", frame_T_sensor=np.eye(4))},
            reference=self.cloud,
            load_annotation=Constant(annotation),
        )

    def annotation(self, index: int) -> Annotation:
        """The road users of frame ``index``, and what is unsure."""
        return self._pasted(index)[1]

    def has_annotation(self, index: int) -> bool:
        """Every frame has one."""
        del index
        return True

    def fingerprint(self, *, options: bool = True) -> str:
        """As of the sweeps, and of what is pasted."""
        text = json.dumps([super().fingerprint(options=options), self.cloud, self.config.model_dump(mode="json")])
        return hashlib.sha256(text.encode()).hexdigest()

    def drive_indices(self) -> dict[str, np.ndarray]:
        """None: copies of a sweep are no drive."""
        return {}

    @property
    def places(self) -> tuple[str, ...]:
        """Names of the sweeps' sequences, each once."""
        return tuple(dict.fromkeys(self.sequences))

    def _read(self, sweep: int) -> tuple[DonorSweep, bool]:
        """A sweep without its objects, and whether it has an intensity.

        Raises:
            ConfigError: If its sensor is known to stand elsewhere than at the origin: its rays begin there.
        """
        frame = self.parent[sweep]
        sensor = frame.sensors.get(self.cloud)
        stands_m = None if sensor is None or sensor.frame_T_sensor is None else sensor.frame_T_sensor[:3, 3]
        if stands_m is not None and np.linalg.norm(stands_m) > _AT_ORIGIN_M:
            raise ConfigError(
                f"donors: expected sweeps in the axes of their sensor, which casts the rays; {self.cloud} of frame "
                f"{frame.frame_id} stands at {', '.join(f'{part:.2f}' for part in stands_m)} m. Open them in its axes, "
                f"--reference {self.cloud}."
            )
        cloud = frame.cloud(self.cloud)
        boxes = frame.boxes if self.config.annotations else None
        return DonorSweep.of(cloud, boxes), cloud.intensity is not None

    def _looked_at(self, sweep: int) -> tuple[Boxes, float]:
        """What is unsure in a sweep, and its road's direction."""
        donor, _ = self._sweep(sweep)
        unsure = unsure_boxes(donor, self.config.band_m)
        if self.config.annotations and self.parent[sweep].boxes is not None:
            unsure = unsure[unsure.range_m > self.config.annotated_to_m]
        return unsure, road_direction_rad(donor)

    def _made(self, index: int) -> tuple[Cloud, Annotation]:
        """The cloud and the annotation of a frame: a function of its number and the seed alone."""
        sweep, copy = divmod(index, self.config.copies)
        (donor, has_intensity), (unsure, road_rad) = self._sweep(sweep), self._scene(sweep)
        rng = np.random.default_rng((self.config.seed, sweep, copy))
        ahead_rad = road_rad + float(rng.choice([0.0, np.pi])) + float(rng.normal(0, _ALONG_RAD))
        if rng.random() >= _ALONG_SHARE:
            ahead_rad = float(rng.uniform(-np.pi, np.pi))
        turn = pose_from_yaw(-ahead_rad)
        turned, unsure = donor.turned(-ahead_rad), unsure.transform(turn)
        bodies = stand_bodies(turned, self.config, road_rad - ahead_rad, rng)
        pasted = paste(turned, bodies, MODELS[self.config.sensor], rng)
        cloud = Cloud(pasted.points_m, pasted.intensity if has_intensity else None)
        return cloud, Annotation(boxes=Boxes.concatenate([_seen(pasted), unsure]))

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name not in ("_sweep", "_scene", "_pasted")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._set_up()


def _seen(pasted: PastedSweep) -> Boxes:
    """The boxes of the bodies that have a point."""
    return pasted.boxes[pasted.points_in > 0]


def unsure_boxes(sweep: DonorSweep, band_m: Number) -> Boxes:
    """Boxes of the class ``unsure`` about all that stands, of whatever size and number of points, and a band round it.

    Clusters larger than a car are cut along a grid, so that boxes lie close to walls and hedges in any direction. Where
    boxes are more than 1000, all are cut along a coarser grid. Beyond 30 m a smaller cluster is taken for part of a
    car.

    Args:
        sweep: The sweep without its annotated objects.
        band_m: Width of the band.
    """
    rows, cluster = standing_clusters(sweep.points_m, sweep.height_m)
    if not len(rows):
        return Boxes.empty()
    points = sweep.points_m[rows]
    low, high = _extents(points, cluster)
    is_small = (high - low)[:, :2].max(axis=1) < _CAR_M
    is_part = is_small & (np.hypot(low[:, 0], low[:, 1]) > _PARTS_FROM_M)
    whole, tile_m = np.where(is_small, np.arange(len(low)), -1)[cluster], _TILE_M
    while True:
        tile = np.where(whole[:, None] < 0, np.floor(points[:, :2] / tile_m), 0).astype(np.int64)
        _, group = np.unique(np.column_stack([whole, tile]), axis=0, return_inverse=True)
        group = group.ravel()
        if group.max() < _MOST_UNSURE:
            break
        whole, tile_m = np.full(len(points), -1), 2 * tile_m
    low, high = _extents(points, group)
    least_m = np.where(np.bincount(group, weights=is_part[cluster]) > 0, _CAR_M, _CELL_M)
    size = np.maximum(high - low, least_m[:, None]) + 2 * band_m
    size[:, 2] = _UNSURE_TALL_M
    return Boxes(centre_m=(low + high) / 2, size_m=size, yaw_rad=np.zeros(len(size)), label=[UNSURE] * len(size))


def _extents(
    points_m: Float64[np.ndarray, "n 3"], group: Int64[np.ndarray, " n"]
) -> tuple[Float64[np.ndarray, "g 3"], Float64[np.ndarray, "g 3"]]:
    """Least and greatest coordinates of each group of points; groups are numbered from 0 without gaps."""
    low, high = (np.full((group.max() + 1, 3), end) for end in (np.inf, -np.inf))
    np.minimum.at(low, group, points_m)
    np.maximum.at(high, group, points_m)
    return low, high


def road_direction_rad(sweep: DonorSweep) -> float:
    """Direction of the road, modulo pi: that along which most of what stands is lined up, walls, kerbs and hedges.

    Args:
        sweep: The sweep.
    """
    standing = sweep.standing_points_m[:, :2]
    standing = standing[np.hypot(*standing.T) < _BANDS_M[2][1]]
    middle = (np.unique(np.floor(standing / _CELL_M).astype(np.int64), axis=0) + 0.5) * _CELL_M
    _, patch = np.unique(np.floor(middle / _PATCH_M).astype(np.int64), axis=0, return_inverse=True)
    patch = patch.ravel()
    count = np.bincount(patch)
    if not (count >= _CELLS).any():
        return 0.0
    mean = np.stack([np.bincount(patch, weights=column) for column in middle.T], axis=1) / count[:, None]
    away = middle - mean[patch]
    xx, yy, xy = (
        np.bincount(patch, weights=product) for product in (away[:, 0] ** 2, away[:, 1] ** 2, away[:, 0] * away[:, 1])
    )
    direction, strength = 0.5 * np.arctan2(2 * xy, xx - yy), np.hypot(2 * xy, xx - yy) / np.maximum(xx + yy, 1e-9)
    lined = (count >= _CELLS) & (strength > _LINED)
    edges = np.deg2rad(np.arange(0, 181, 2))
    votes = np.histogram(np.mod(direction[lined], np.pi), edges, weights=count[lined])[0]
    best = int(np.argmax(gaussian_filter1d(votes.astype(np.float64), 2.0, mode="wrap")))
    return float((edges[best] + edges[best + 1]) / 2)


def stand_bodies(
    sweep: DonorSweep, config: DonorConfig, road_rad: Number, rng: np.random.Generator
) -> list[StandingBody]:
    """Road users on the sweep's ground ahead, apart from each other and from what stands there.

    Args:
        sweep: The sweep.
        config: How many of each.
        road_rad: Direction of the road.
        rng: Draws all of it.
    """
    prior = str(rng.choice(_PRIORS))
    room, bodies = FreeRoom.of(sweep), list[StandingBody]()
    kinds = [("pedestrian", "pedestrian", "child")] * config.pedestrians + [("cyclist",)] * config.bicycles
    others = [str(rng.choice(names)) for names in kinds]
    others += [draw_truck(rng, long_haul=False, prior=prior) for _ in range(config.large_vehicles)]
    cars = 0
    while cars < config.vehicles:
        row = int(rng.integers(*_ROW)) if rng.random() < config.rows else 1
        row = min(row, config.vehicles - cars)
        cars += row
        bodies += room.stand_row([draw_actor(rng, prior, _WORLD) for _ in range(row)], float(road_rad), rng)
    for kind in others:
        length, width, height = draw_size_m(kind, rng, prior).tolist()
        actor = Actor(0, kind, (length, width, height), np.random.SeedSequence(int(rng.integers(1 << 62))), _WORLD)
        heading_rad = float(rng.uniform(-np.pi, np.pi)) if CLASS_OF[kind] == "pedestrian" else float(road_rad)
        bodies += room.stand_row([actor], heading_rad, rng)
    return bodies


@dataclass(frozen=True, eq=False)
class FreeRoom:
    """Where on a sweep's ground there is room: cells in which something stands, and the ground's height.

    Args:
        taken: Whether something stands in a cell of 0.25 m, shape (n, n), the sensor in the middle.
        ground_m: Height of the ground in a cell of 1 m, NaN where it was not seen, shape (m, m).
        points_m: Points on the ground ahead, among which places are drawn.
    """

    taken: Bool[np.ndarray, "n n"]
    ground_m: Float64[np.ndarray, "m m"]
    points_m: Float64[np.ndarray, "g 3"]

    @classmethod
    def of(cls, sweep: DonorSweep) -> "FreeRoom":
        """Of a sweep."""
        ground = sweep.ground_points_m
        ground = ground[np.abs(ground[:, :2]).max(axis=1, initial=0.0) < _REACH_M]
        taken = np.zeros((_cells(_CELL_M),) * 2, dtype=bool)
        standing = sweep.standing_points_m
        taken[tuple(_cell(standing[np.abs(standing[:, :2]).max(axis=1, initial=0.0) < _REACH_M], _CELL_M).T)] = True
        side = _cells(_GROUND_CELL_M)
        number = np.ravel_multi_index(tuple(_cell(ground, _GROUND_CELL_M).T), (side, side))
        with np.errstate(invalid="ignore"):
            total = np.bincount(number, weights=ground[:, 2], minlength=side**2)
            mean = total / np.bincount(number, minlength=side**2)
        return cls(taken, mean.reshape(side, side), ground[ground[:, 0] > 0])

    def stand_row(self, actors: Sequence[Actor], along_rad: float, rng: np.random.Generator) -> list[StandingBody]:
        """Stand a body, and further ones behind it as far as there is room; none where there is none for the first.

        Args:
            actors: The bodies.
            along_rad: Direction in which they stand, either way; a few stand across.
            rng: Draws place, headings and gaps.
        """
        size = actors[0].size_m
        range_m = np.hypot(*self.points_m[:, :2].T)
        low_m, high_m = _BANDS_M[int(rng.choice(len(_BANDS_M), p=_BAND_SHARES))]
        rows = np.flatnonzero((range_m >= low_m) & (range_m < high_m))
        if not len(rows):
            return []
        places = self.points_m[rows[rng.integers(len(rows), size=_TRIES)], :2]
        turns = rng.choice([0.0, np.pi, np.pi / 2, -np.pi / 2], p=[0.45, 0.45, 0.05, 0.05], size=_TRIES)
        yaws = along_rad + turns + rng.normal(0, _TURN_RAD, _TRIES)
        free = np.flatnonzero([self._is_free(*tried, size) for tried in zip(places, yaws, strict=True)])
        if not len(free):
            return []
        position, yaw = places[free[0]], float(yaws[free[0]])
        bodies = [self._stand(actors[0], position, yaw)]
        back, across = -np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
        end = position + back * size[0] / 2
        for actor in actors[1:]:
            middle = end + back * (float(rng.uniform(*_GAP_M)) + actor.size_m[0] / 2)
            end = middle + back * actor.size_m[0] / 2
            position = middle + across * float(rng.normal(0, _SHIFT_M))
            heading = yaw + float(rng.choice([0.0, np.pi], p=[0.8, 0.2])) + float(rng.normal(0, _TURN_RAD))
            if self._is_free(position, heading, actor.size_m):
                bodies.append(self._stand(actor, position, heading))
        return bodies

    def _footprint(self, place_m: np.ndarray, yaw_rad: float, size_m: Sequence[float]) -> Int64[np.ndarray, "k 2"]:
        """Cells that a body covers with the room that it needs."""
        half = [side / 2 + _FREE_M for side in size_m[:2]]
        along, across = (np.linspace(-reach, reach, int(np.ceil(2 * reach / (0.8 * _CELL_M))) + 1) for reach in half)
        local = np.stack(np.meshgrid(along, across, indexing="ij"), axis=-1).reshape(-1, 2)
        cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
        return _cell(local @ np.array([[cos, sin], [-sin, cos]]) + place_m, _CELL_M)

    def _is_free(self, place_m: np.ndarray, yaw_rad: float, size_m: Sequence[float]) -> bool:
        cells = self._footprint(place_m, yaw_rad, size_m)
        if (cells < 0).any() or (cells >= len(self.taken)).any() or np.hypot(*place_m) < _BANDS_M[0][0]:
            return False
        ground = self.ground_m[tuple(_cell(place_m[None], _GROUND_CELL_M)[0])]
        return bool(np.isfinite(ground)) and not self.taken[tuple(cells.T)].any()

    def _stand(self, actor: Actor, place_m: np.ndarray, yaw_rad: float) -> StandingBody:
        """Build a body on the ground of its place, which is taken from then on."""
        self.taken[tuple(self._footprint(place_m, yaw_rad, actor.size_m).T)] = True
        ground_m = float(self.ground_m[tuple(_cell(place_m[None], _GROUND_CELL_M)[0])])
        return StandingBody.of(actor, float(place_m[0]), float(place_m[1]), ground_m, yaw_rad)


def _cells(cell_m: float) -> int:
    return round(2 * _REACH_M / cell_m)


def _cell(points_m: np.ndarray, cell_m: float) -> Int64[np.ndarray, "n 2"]:
    """The cell of each point in a square about the sensor."""
    return np.floor((points_m[:, :2] + _REACH_M) / cell_m).astype(np.int64)

"""False vehicles of a detector on real sweeps, over the simulated cars that it finds in the same sweeps.

Annotated objects are taken out of real sweeps: every vehicle that is still detected is false. Simulated cars stand in
the same sweeps with the sensor's own rays, hidden by what is there: how many of them are found says how willing the
detector is. One curve of both compares detectors whose scores mean different things.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from jaxtyping import Bool, Int64

from farfield.datasets.base import Dataset
from farfield.errors import DatasetError
from farfield.evaluation.donor_trial import KINDS, RANGES_M, DonorTrial, FalseVehicle, PastedCar
from farfield.frame import Boxes, Cloud, Frame, Pose, Sensor, transform_frame
from farfield.geometry.boxes import count_points_in_boxes, points_in_boxes
from farfield.geometry.poses import invert
from farfield.simulation.donors import DonorSweep, StandingBody, draw_actor, find_place, paste
from farfield.simulation.lidar.model import LidarModel

# The constants are frozen: what is measured later is measured with the same eye.
VEHICLES = ("vehicle", "large_vehicle")
FARTHEST_M, SECTOR_RAD, MATCH_M = 70.0, np.deg2rad(35.0), 2.0
FAR_RANGES_M, FAR_HALF_WIDTH_M = ((70, 110), (110, 150), (150, 200), (200, 250)), 45.0
FAR_POINTS = ((1, 3), (3, 7), (7, 21), (21, 1 << 30))
COPIES, CARS_A_RANGE = 3, 2
_MOUNTED_RAD = np.deg2rad(20.0)
_KIND_MARGIN_M, _PLANT_SCATTER, _FEW_POINTS = 0.3, 0.03, 5
_TALL_M, _HIGHEST_M, _TALL_POINTS = 2.8, 8.0, 3

InField = Callable[[Frame, Boxes], Bool[np.ndarray, " n"]]
"""Which boxes of a frame lie where somebody annotated."""


def try_on_donors(
    detect: Callable[[Frame], Boxes],
    data: Dataset | Iterable[Frame],
    model: LidarModel,
    *,
    in_field: InField,
    cloud: str | None = None,
    seed: int = 0,
    progress: Callable[[int], None] | None = None,
) -> DonorTrial:
    """Run a detector on annotated sweeps without their objects, and on the same with simulated cars.

    Args:
        detect: The detector.
        data: Annotated sweeps in the coordinates in which the detector sees them.
        model: How their sensor detects and measures.
        in_field: Which boxes of a frame lie where somebody annotated.
        cloud: Name of the cloud that it reads (default: the first).
        seed: Draws cars and places: the same for every detector.
        progress: Called with the number of each sweep.

    Raises:
        DatasetError: If a sweep is not annotated: what is annotated is taken out, and what is left is false.
    """
    trial = DonorTrial()
    for number, own in enumerate(data):
        frame, frame_T_sensor = in_sensor_axes(own, cloud), _pose(own, cloud)
        sees = detect if frame_T_sensor is None else partial(_seen_in_frame, detect, frame_T_sensor)
        ahead_rad = _ahead_rad(frame_T_sensor)
        annotated = _annotated(frame)
        sweep = DonorSweep.of(frame.cloud(), annotated)
        bare = _detected(sees, frame, Cloud(sweep.points_m, sweep.intensity), in_field, (0.0, FARTHEST_M))
        bare = bare[_away_from(bare, annotated)]  # of what is left of an annotated object nobody knows
        trial.false += _false_vehicles(bare, sweep, number)
        for copy in range(COPIES):
            rng = np.random.default_rng((seed, number, copy))
            cars = _cars(sweep, frame, in_field, [(band, SECTOR_RAD) for band in RANGES_M], rng, ahead_rad)
            trial.cars += _tried(sees, frame, sweep, cars, model, in_field, (0.0, FARTHEST_M), number, rng)
        trial.sweeps += 1
        trial.scenes.append(frame.sequence)
        if progress is not None:
            progress(number)
    return trial


def far_pasted_cars(
    detect: Callable[[Frame], Boxes],
    data: Dataset | Iterable[Frame],
    model: LidarModel,
    *,
    in_field: InField,
    seed: int = 0,
) -> list[PastedCar]:
    """Simulated cars at 70 to 250 m in annotated sweeps without their objects, and whether a detector finds them.

    They stand where the sweep has ground returns, not more than 45 m to the side. The sweeps are in the sensor's axes;
    other arguments and errors are those of :func:`try_on_donors`.
    """
    span = float(FAR_RANGES_M[0][0]), float(FAR_RANGES_M[-1][1])
    bands = [(band, float(np.arctan2(FAR_HALF_WIDTH_M, band[1]))) for band in FAR_RANGES_M]
    cars: list[PastedCar] = []
    for number, frame in enumerate(data):
        sweep = DonorSweep.of(frame.cloud(), _annotated(frame))
        for copy in range(COPIES):
            rng = np.random.default_rng((seed, number, copy, 1))
            bodies = _cars(sweep, frame, in_field, bands, rng)
            cars += _tried(detect, frame, sweep, bodies, model, in_field, span, number, rng)
    return cars


def annotated_cars(
    detect: Callable[[Frame], Boxes],
    data: Dataset | Iterable[Frame],
    span_m: tuple[float, float],
    *,
    in_field: InField,
    cloud: str | None = None,
) -> list[PastedCar]:
    """A data set's own cars at some distance with a point and more, and whether a detector finds them.

    Args:
        detect: The detector.
        data: Annotated sweeps, real or simulated, in the sensor's axes.
        span_m: Ground distance of a car, at least and at most.
        in_field: Which boxes of a frame lie where somebody annotated.
        cloud: Name of the cloud (default: the first).

    Raises:
        DatasetError: If a sweep is not annotated.
    """
    cars: list[PastedCar] = []
    for number, frame in enumerate(data):
        boxes = _annotated(frame)
        boxes = boxes[(np.asarray(boxes.label) == VEHICLES[0]) & _within(boxes, span_m)]
        points = count_points_in_boxes(frame.cloud(cloud).points_m, boxes).astype(np.int64)
        counted = (points > 0) & (in_field(frame, boxes) if len(boxes) else points > 0)
        detections = _detected(detect, frame, frame.cloud(cloud), in_field, span_m)
        cars += _found(detections, boxes[counted], points[counted], number)
    return cars


def _annotated(frame: Frame) -> Boxes:
    if frame.boxes is None:
        raise DatasetError(f"frame {frame.key}: expected annotated boxes, which are taken out of the sweep; got none")
    return frame.boxes


def _within(boxes: Boxes, span_m: tuple[float, float]) -> Bool[np.ndarray, " n"]:
    return (boxes.range_m >= span_m[0]) & (boxes.range_m <= span_m[1])


def _cars(
    sweep: DonorSweep,
    frame: Frame,
    in_field: InField,
    bands: Sequence[tuple[tuple[int, int], float]],
    rng: np.random.Generator,
    ahead_rad: float = 0.0,
) -> list[StandingBody]:
    """Cars in a sweep, some in each band of range and so far to the side, where somebody would have annotated them."""
    cars: list[StandingBody] = []
    for band, side_rad in [*bands] * CARS_A_RANGE:
        sector_rad = (-side_rad, side_rad)
        car = find_place(sweep, draw_actor(rng), band, rng, azimuth_rad=sector_rad, ahead_rad=ahead_rad, taken=cars)
        if car is not None and in_field(frame, car.boxes)[0]:
            cars.append(car)
    return cars


def _tried(
    detect: Callable[[Frame], Boxes],
    frame: Frame,
    sweep: DonorSweep,
    bodies: Sequence[StandingBody],
    model: LidarModel,
    in_field: InField,
    span_m: tuple[float, float],
    number: int,
    rng: np.random.Generator,
) -> list[PastedCar]:
    """The cars of one copy of a sweep, each with the score at its place."""
    pasted = paste(sweep, bodies, model, rng)
    if not len(pasted.boxes):
        return []
    detections = _detected(detect, frame, pasted.cloud, in_field, span_m)
    return _found(detections, pasted.boxes, pasted.points_in, number)


def _detected(
    detect: Callable[[Frame], Boxes],
    frame: Frame,
    cloud: Cloud,
    in_field: InField,
    span_m: tuple[float, float],
) -> Boxes:
    """Vehicles that a detector sees in a cloud, at some distance and where somebody annotated."""
    name = next(iter(frame.clouds))
    sensors = {name: frame.sensors.get(name, Sensor(kind="lidar", frame_T_sensor=np.eye(4)))}
    sight = Frame(
        sequence=frame.sequence,
        frame_id=frame.frame_id,
        clouds={name: cloud},
        sensors=sensors,
        reference=frame.reference,
    )
    boxes = detect(sight)
    boxes = boxes[np.isin(np.asarray(boxes.label), VEHICLES) & _within(boxes, span_m)]
    return boxes[in_field(frame, boxes)] if len(boxes) else boxes


def _away_from(boxes: Boxes, others: Boxes) -> Bool[np.ndarray, " n"]:
    """Which boxes lie farther from all others than a match."""
    if not len(boxes) or not len(others):
        return np.ones(len(boxes), dtype=bool)
    apart = boxes.centre_m[:, None, :2] - others.centre_m[None, :, :2]
    return np.linalg.norm(apart, axis=2).min(axis=1) > MATCH_M


def _found(boxes: Boxes, cars: Boxes, points: Int64[np.ndarray, " b"], sweep: int) -> list[PastedCar]:
    """Each car with the best free detection within 2 m, detections in the order of their scores."""
    score = np.full(len(cars), -np.inf)
    if len(boxes) and len(cars):
        assert boxes.score is not None
        apart_m = np.linalg.norm(boxes.centre_m[:, None, :2] - cars.centre_m[None, :, :2], axis=2)
        for row in np.argsort(-boxes.score, kind="stable"):
            free = np.where(np.isinf(score), apart_m[row], np.inf)
            nearest = int(np.argmin(free))
            if free[nearest] <= MATCH_M:
                score[nearest] = boxes.score[row]
    rows = zip(cars.range_m.tolist(), points.tolist(), score.tolist(), strict=True)
    return [PastedCar(sweep=sweep, range_m=range_m, points=count, score=value) for range_m, count, value in rows]


def _false_vehicles(boxes: Boxes, sweep: DonorSweep, number: int) -> list[FalseVehicle]:
    """False vehicles with what stands in them."""
    if not len(boxes):
        return []
    assert boxes.score is not None
    inside = points_in_boxes(sweep.points_m, boxes, margin_m=_KIND_MARGIN_M)
    rows = enumerate(zip(inside, boxes.score.tolist(), strict=True))
    return [
        FalseVehicle(sweep=number, score=score, kind=_kind(sweep, boxes[[row]], at), box=boxes[[row]], points=len(at))
        for row, (at, score) in rows
    ]


def _kind(sweep: DonorSweep, box: Boxes, inside: Int64[np.ndarray, " n"]) -> str:
    """What stands in a box: walls, poles and trees go on above it, leaves are no plane."""
    above = inside[sweep.height_m[inside] > _KIND_MARGIN_M]
    if len(above) < _FEW_POINTS:
        return KINDS[2]
    near = np.linalg.norm(sweep.points_m[:, :2] - box.centre_m[0, :2], axis=1) < box.size_m[0, :2].max() / 2
    if (near & (sweep.height_m > _TALL_M) & (sweep.height_m < _HIGHEST_M)).sum() >= _TALL_POINTS:
        return KINDS[1]
    variances = np.linalg.eigvalsh(np.cov(sweep.points_m[above].T))
    return KINDS[0] if variances[0] > _PLANT_SCATTER * variances.sum() else KINDS[3]


def all_around(frame: Frame, boxes: Boxes) -> Bool[np.ndarray, " n"]:
    """Every box: of sweeps that are annotated all around."""
    del frame
    return np.ones(len(boxes), dtype=bool)


def in_camera(frame: Frame, boxes: Boxes) -> Bool[np.ndarray, " n"]:
    """Boxes whose centre falls into the frame's first camera: KITTI and View-of-Delft annotate no others."""
    camera = next(iter(frame.cameras.values()), None)
    return all_around(frame, boxes) if camera is None else camera.project(boxes.centre_m)[2]


def in_region(frame: Frame, boxes: Boxes) -> Bool[np.ndarray, " n"]:
    """Boxes whose centre lies where the frame's reader says that was annotated; all where it says nothing."""
    region = None if frame.annotation is None else frame.annotation.region
    return all_around(frame, boxes) if region is None else region.contains(boxes.centre_m)


def field_of(data: Dataset | Iterable[Frame]) -> InField:
    """Where some frames are annotated: where their reader says, if it does.

    Else it is the first camera's view where no box lies outside it, and all around where one does.
    """
    outside = False
    for frame in data:
        boxes = _annotated(frame)
        if frame.annotation is not None and frame.annotation.region is not None:
            return in_region
        outside = outside or not frame.cameras or not in_camera(frame, boxes).all()
    return all_around if outside else in_camera


def in_sensor_axes(frame: Frame, cloud: str | None = None) -> Frame:
    """The frame with one cloud alone, its sensor at the origin where it is known where that stands.

    Args:
        frame: The frame.
        cloud: Name of the cloud (default: the first).
    """
    name = cloud or next(iter(frame.clouds))
    alone = replace(frame, clouds={name: frame.cloud(name)})
    frame_T_sensor = _pose(frame, name)
    return alone if frame_T_sensor is None else transform_frame(alone, invert(frame_T_sensor))


def _pose(frame: Frame, cloud: str | None) -> Pose | None:
    """Where a cloud's sensor stands; None where that is not known, or at the origin."""
    sensor = frame.sensors.get(cloud or next(iter(frame.clouds)))
    pose = None if sensor is None else sensor.frame_T_sensor
    return None if pose is None or np.allclose(pose, np.eye(4), rtol=0, atol=1e-9) else pose


def _ahead_rad(frame_T_sensor: Pose | None) -> float:
    """Where the frame's +x points in the sensor's axes, such as pi in a frame turned round; 0 for a mounting's yaw."""
    if frame_T_sensor is None:
        return 0.0
    forward = frame_T_sensor[0, :3]  # the first column of the inverse's rotation
    yaw_rad = float(np.arctan2(forward[1], forward[0]))
    return yaw_rad if abs(yaw_rad) > _MOUNTED_RAD else 0.0


def _seen_in_frame(detect: Callable[[Frame], Boxes], frame_T_sensor: Pose, sight: Frame) -> Boxes:
    """What a detector sees in a frame in the sensor's axes: it detects in its own coordinates."""
    return detect(transform_frame(sight, frame_T_sensor)).transform(invert(frame_T_sensor))

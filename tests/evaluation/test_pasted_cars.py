"""False vehicles over found cars: the curve by hand, matches, kinds of what stands there, a detector that knows."""

import json
from dataclasses import dataclass, replace
from types import ModuleType

import numpy as np
import pytest

from farfield.errors import DatasetError
from farfield.evaluation import donor_trial, pasted_cars
from farfield.evaluation.donor_trial import (
    KINDS,
    DonorTrial,
    FalseVehicle,
    PastedCar,
    interval_over_sweeps,
    paired_difference,
)
from farfield.evaluation.pasted_cars import (
    FAR_POINTS,
    _false_vehicles,
    _found,
    all_around,
    annotated_cars,
    far_pasted_cars,
    field_of,
    in_camera,
    in_region,
    in_sensor_axes,
    try_on_donors,
)
from farfield.frame import Annotation, Boxes, Camera, CameraField, Cloud, Constant, Frame, Sensor, transform_frame
from farfield.geometry.poses import pose_from_yaw
from farfield.simulation.donors import DonorSweep
from farfield.simulation.lidar.model import HDL_64E


def boxes_at(*rows: tuple[float, float, float]) -> Boxes:
    """Cars at x, y with a score."""
    table = np.array(rows, dtype=np.float64).reshape(-1, 3)
    return Boxes(
        centre_m=np.column_stack([table[:, :2], np.full(len(table), -1.0)]),
        size_m=np.tile([4.4, 1.8, 1.5], (len(table), 1)),
        yaw_rad=np.zeros(len(table)),
        label=["vehicle"] * len(table),
        score=table[:, 2],
    )


def trial() -> DonorTrial:
    cars = [(0, 0.9, 50), (0, 0.6, 50), (1, 0.4, 50), (1, -np.inf, 50), (1, 0.95, 3)]
    false = [(0, 0.7), (0, 0.5), (1, 0.3)]
    return DonorTrial(
        sweeps=2,
        cars=[PastedCar(sweep=row, range_m=30.0, points=points, score=score) for row, score, points in cars],
        false=[
            FalseVehicle(sweep=row, score=score, kind=KINDS[0], box=boxes_at((9, 9, score)), points=9)
            for row, score in false
        ],
    )


def test_the_curve_is_that_of_a_count_by_hand() -> None:
    threshold, recall, false = trial().curve()
    np.testing.assert_allclose(threshold, [0.9, 0.7, 0.6, 0.5, 0.4, 0.3])
    np.testing.assert_allclose(recall, [0.25, 0.25, 0.5, 0.5, 0.75, 0.75])
    np.testing.assert_allclose(false, [0, 0.5, 0.5, 1, 1, 1.5])
    assert trial().at_recall(0.5) == 0.5
    assert trial().threshold_at(0.75) == 0.4
    assert trial().at_recall(0.8) is None
    only_second = trial().curve(np.array([1, 1]))
    assert only_second[1][-1] == 0.5
    assert only_second[2][-1] == 1.0
    assert trial().recall_by_points(0.5)["1 to 4"] == (1.0, 1)
    assert trial().recall_by_range(0.5)["20-35 m"] == (0.5, 4)


def test_intervals_draw_sweeps() -> None:
    interval = interval_over_sweeps(trial(), lambda own, sweeps: own.at_recall(0.5, sweeps))
    assert interval == (0.0, 0.5)  # of one sweep twice, and of both
    assert interval_over_sweeps(trial(), lambda own, sweeps: own.at_recall(1.0, sweeps)) == (1.0, np.inf)
    assert interval_over_sweeps(trial(), lambda own, sweeps: None) is None


def test_each_car_has_the_best_free_detection_near_it() -> None:
    detections = boxes_at((20.5, 0, 0.3), (20, 0, 0.9), (24.5, 0, 0.5), (60, 0, 0.99))
    cars = boxes_at((20, 0, 0), (24, 0, 0), (40, 0, 0))
    found = _found(detections, cars, np.array([9, 9, 9]), 7)
    assert [car.score for car in found] == [0.9, 0.5, -np.inf]
    assert {car.sweep for car in found} == {7}


def stand(points: np.ndarray) -> DonorSweep:
    return DonorSweep(points, np.zeros(len(points), np.float32), points[:, 2] + 1.8, np.zeros((0, 3)))


@pytest.mark.parametrize(
    ("low", "high", "kind"),
    [
        ((19, -0.8, -1.4), (21, 0.8, 0), KINDS[0]),
        ((20, -0.8, -1.4), (20.02, 0.8, 3), KINDS[1]),
        ((20, -0.8, -1.4), (20.02, 0.8, -0.4), KINDS[3]),
    ],
    ids=["bush", "wall", "board"],
)
def test_what_is_taken_for_a_car_is_told(
    low: tuple[float, ...], high: tuple[float, ...], kind: str, rng: np.random.Generator
) -> None:
    points = rng.uniform(low, high, (200, 3))
    assert [one.kind for one in _false_vehicles(boxes_at((20, 0, 0.5)), stand(points), 0)] == [kind]
    assert [one.kind for one in _false_vehicles(boxes_at((40, 0, 0.5)), stand(points), 0)] == [KINDS[2]]


@dataclass
class Knowing:
    """Takes clusters of points well above the road for cars: it finds all, and the annotated ones are gone."""

    reach_m: float = 70.0

    def __call__(self, frame: Frame) -> Boxes:
        points = frame.cloud().points_m
        high = points[(points[:, 2] > -1.2) & (np.hypot(points[:, 0], points[:, 1]) < self.reach_m)]
        if not len(high):
            return boxes_at()
        rows: list[tuple[float, float, float]] = []
        while len(high):
            near = np.hypot(*(high[:, :2] - high[0, :2]).T) < 3.5
            middle = (high[near, :2].min(axis=0) + high[near, :2].max(axis=0)) / 2
            rows.append((float(middle[0]), float(middle[1]), 0.8))
            high = high[~near]
        return boxes_at(*rows)


def street(elevation_deg: tuple[float, float], objects: Boxes | None, points: np.ndarray) -> Frame:
    """A flat road ahead as a turning sensor sees it, with what stands on it."""
    azimuth, up = np.meshgrid(np.linspace(-0.7, 0.7, 600), np.deg2rad(np.linspace(*elevation_deg, 60)))
    ray = np.stack([np.cos(up) * np.cos(azimuth), np.cos(up) * np.sin(azimuth), np.sin(up)], -1).reshape(-1, 3)
    cloud = Cloud(np.concatenate([ray * (-1.8 / ray[:, 2:]), points]))
    load = None if objects is None else Constant(Annotation(boxes=objects))
    return Frame(sequence="a", frame_id="0", clouds={"lidar": cloud}, reference="lidar", load_annotation=load)


def test_far_cars_are_tried_where_the_road_goes_on(rng: np.random.Generator) -> None:
    pytest.importorskip("embreex")
    near = boxes_at((30, 0, 0.0))
    frame = street((-1.45, -0.42), near, rng.uniform((29, -0.8, -1.7), (31, 0.8, -0.4), (50, 3)))
    cars = far_pasted_cars(Knowing(300.0), [frame], HDL_64E, in_field=all_around)
    assert len(cars) > 6
    assert all(69 < car.range_m < 251 for car in cars)
    seen = [car for car in cars if car.points > 6]
    assert np.mean([car.score > 0 for car in seen]) > 0.7
    assert far_pasted_cars(Knowing(69.0), [frame], HDL_64E, in_field=all_around)[0].score == -np.inf


def test_a_sets_own_far_cars_count_where_they_have_points(rng: np.random.Generator) -> None:
    objects = boxes_at((100, 0, 0.0), (150, 0, 0.0), (40, 0, 0.0))
    frame = street((-1.45, -0.42), objects, rng.uniform((98.2, -0.8, -1.15), (101.8, 0.8, -0.4), (30, 3)))
    cars = annotated_cars(Knowing(300.0), [frame], (70.0, 250.0), in_field=all_around)
    by_points = donor_trial.recall_by_points(cars, 0.5, FAR_POINTS)
    assert by_points["21 and more"] == (1.0, 1)
    assert max(car.range_m for car in cars) < 151
    only_near = street((-1.45, -0.42), boxes_at((40, 0, 0.0)), rng.uniform((99, -0.8, -1.1), (101, 0.8, -0.4), (30, 3)))
    assert annotated_cars(Knowing(300.0), [only_near], (70.0, 250.0), in_field=all_around) == []
    with pytest.raises(DatasetError, match="expected annotated boxes"):
        annotated_cars(Knowing(), [street((-14, -2), None, np.zeros((0, 3)))], (70.0, 250.0), in_field=all_around)


def test_the_field_is_the_cameras_where_no_box_lies_outside_its_view() -> None:
    camera = Camera(matrix=np.array([[700.0, 0, 600], [0, 700, 200], [0, 0, 1]]), width_px=1200, height_px=400)
    ahead, behind = boxes_at((20, 0, 0.0)), boxes_at((20, 0, 0.0), (-20, 0, 0.0))
    frames = [
        replace(street((-14, -2), boxes, np.zeros((0, 3))), cameras={"left": camera}) for boxes in (ahead, behind)
    ]
    assert field_of(frames[:1]) is in_camera
    assert field_of(frames) is all_around
    assert field_of([street((-14, -2), ahead, np.zeros((0, 3)))]) is all_around


def test_the_field_is_where_the_reader_says_that_was_annotated() -> None:
    """A car that is cut off by the picture's edge, as KITTI's 000011 has one, does not open the field all around."""
    camera = Camera(matrix=np.array([[700.0, 0, 600], [0, 700, 200], [0, 0, 1]]), width_px=1200, height_px=400)
    boxes = boxes_at((20, 0, 0.0), (4, 8, 0.0))
    annotation = Annotation(boxes=boxes, region=CameraField(camera=camera, name="left"))
    frame = replace(street((-14, -2), boxes, np.zeros((0, 3))), load_annotation=lambda: annotation, cameras={})
    bare = street((-14, -2), boxes_at((-20, 0, 0.0)), np.zeros((0, 3)))
    in_field = field_of([bare, frame])
    assert in_field is in_region
    np.testing.assert_array_equal(in_field(frame, boxes), [True, False])
    np.testing.assert_array_equal(in_field(bare, boxes), [True, True])


def test_a_detector_sees_the_named_cloud_in_its_own_coordinates(rng: np.random.Generator) -> None:
    """The road of a vehicle's frame lies at 0 m, its sensor 1.8 m above; what stands there is taken from one cloud."""
    pytest.importorskip("embreex")
    frame = street((-14, -2), boxes_at((16, -6, 0.0)), np.zeros((0, 3)))
    pose = np.eye(4)
    pose[:3, 3] = 1.2, 0.0, 1.8
    raised = Cloud(frame.cloud().points_m + pose[:3, 3].astype(np.float32))
    assert frame.boxes is not None
    annotation = Annotation(boxes=frame.boxes.transform(pose))
    frame = replace(
        frame,
        clouds={"other": Cloud(np.zeros((1, 3))), "lidar": raised},
        sensors={"lidar": Sensor(kind="lidar", frame_T_sensor=pose), "other": Sensor(kind="lidar")},
        load_annotation=lambda: annotation,
    )
    lowest: list[float] = []

    def detect(sight: Frame) -> Boxes:
        assert [*sight.clouds] == ["lidar"]
        lowest.append(float(np.median(sight.cloud().points_m[:, 2])))
        return boxes_at((30 + 1.2, 5, 0.9))

    result = try_on_donors(detect, [frame], HDL_64E, in_field=all_around, cloud="lidar")
    np.testing.assert_allclose(lowest, 0.0, atol=0.1)
    np.testing.assert_allclose(result.false[0].box.centre_m, [[30, 5, -2.8]])
    moved = in_sensor_axes(frame, "lidar")
    assert np.median(moved.cloud().points_m[:, 2]) == pytest.approx(-1.8, abs=0.1)


@pytest.mark.parametrize("turn_rad", [0.0, 0.1, np.pi / 2, np.pi])
def test_cars_stand_ahead_in_a_frame_that_was_turned(turn_rad: float) -> None:
    """They stood behind a detector that looks ahead, in frames turned round: none of them was found."""
    pytest.importorskip("embreex")
    azimuth, up = np.meshgrid(np.linspace(-3.14, 3.14, 1800), np.deg2rad(np.linspace(-14, -1.5, 40)))
    ray = np.stack([np.cos(up) * np.cos(azimuth), np.cos(up) * np.sin(azimuth), np.sin(up)], -1).reshape(-1, 3)
    frame = Frame(
        sequence="a",
        frame_id="0",
        clouds={"lidar": Cloud(ray * (-1.8 / ray[:, 2:]))},
        reference="lidar",
        sensors={"lidar": Sensor(kind="lidar", frame_T_sensor=np.eye(4))},
        load_annotation=Constant(Annotation(boxes=boxes_at())),
    )
    knowing = Knowing()

    def detect(sight: Frame) -> Boxes:
        boxes = knowing(sight)
        return boxes[boxes.centre_m[:, 0] > 0]

    turned = transform_frame(frame, pose_from_yaw(turn_rad))
    result = try_on_donors(detect, [turned], HDL_64E, in_field=all_around)
    assert len(result.cars) > 8
    assert np.mean([car.score > 0 for car in result.cars if car.points > 20]) > 0.7


def test_false_vehicles_are_sorted_by_range_and_points() -> None:
    assert trial().false_by_range(0.5) == {"6-20 m": 1.0, "20-35 m": 0.0, "35-50 m": 0.0, "50-70 m": 0.0}
    assert trial().false_by_points(0.2)["5 to 19"] == 1.5


def test_a_trial_reads_back_from_json() -> None:
    own = trial()
    own.scenes = ["a", "b"]
    back = DonorTrial.from_json(json.loads(json.dumps(own.to_json(), allow_nan=False)))
    assert (back.sweeps, back.scenes, back.cars) == (own.sweeps, own.scenes, own.cars)
    for one, other in zip(back.false, own.false, strict=True):
        assert (one.sweep, one.score, one.kind, one.points) == (other.sweep, other.score, other.kind, other.points)
        np.testing.assert_array_equal(one.box.centre_m, other.box.centre_m)
    both = DonorTrial()
    both.add(own, "KITTI")
    both.add(own, "Delft")
    assert both.scenes == ["KITTI/a", "KITTI/b", "Delft/a", "Delft/b"]
    assert both.at_recall(0.5) == own.at_recall(0.5)
    np.testing.assert_allclose(both.curve()[2], own.curve()[2])


def scenes_of(false_a_sweep: np.ndarray, sweeps: int) -> DonorTrial:
    """Scenes of some sweeps each, all of whose cars are found, with so many false vehicles in each sweep."""
    rows = np.repeat(false_a_sweep, sweeps)
    cars = [PastedCar(sweep=row, range_m=30.0, points=50, score=0.6) for row in range(len(rows))]
    box = boxes_at((9, 9, 0.9))
    false = [
        FalseVehicle(sweep=row, score=0.9, kind=KINDS[0], box=box, points=9)
        for row, count in enumerate(rows)
        for _ in range(count)
    ]
    names = [f"scene {number}" for number in np.repeat(np.arange(len(false_a_sweep)), sweeps)]
    return DonorTrial(sweeps=len(rows), cars=cars, false=false, scenes=names)


def test_a_change_has_the_interval_of_the_scenes_differences(rng: np.random.Generator) -> None:
    """Fifty scenes whose false vehicles vary a lot and fall by one or none: the mean of independent differences."""
    before = rng.integers(1, 30, 50)
    fall = np.repeat([0, 1], 25)
    result = paired_difference(
        scenes_of(before, 3), scenes_of(before - fall, 3), lambda own, sweeps: own.at_recall(0.8, sweeps)
    )
    assert result is not None
    change, interval = result
    assert change == pytest.approx(-0.5)
    assert interval is not None
    expected = 1.96 * np.sqrt(0.25 / 50)  # 1.2 if the runs were drawn apart; a third of the variance if sweeps were
    assert (interval[1] - interval[0]) / 2 == pytest.approx(expected, rel=0.15)


def test_a_change_needs_the_same_sweeps_and_figures_that_are_reached() -> None:
    whole = scenes_of(np.array([1, 2, 3]), 2)
    with pytest.raises(DatasetError, match="over the same sweeps"):
        paired_difference(whole, scenes_of(np.array([1, 2]), 3), lambda own, sweeps: own.at_recall(0.8, sweeps))
    assert paired_difference(whole, whole, lambda own, sweeps: own.at_recall(1.1, sweeps)) is None
    assert paired_difference(whole, whole, lambda own, sweeps: own.at_recall(0.8, sweeps)) == (0.0, (0.0, 0.0))


def constants_of(module: ModuleType) -> dict[str, object]:
    return {name: value for name, value in vars(module).items() if name.isupper()}


def test_the_eye_is_frozen() -> None:
    """What was measured before is compared with what is measured later: by the same constants."""
    record = {
        "RANGES_M": ((6, 20), (20, 35), (35, 50), (50, 70)),
        "KINDS": ("plant", "wall or other tall thing", "few points", "other"),
    }
    assert constants_of(donor_trial) == record | {
        "LEAST_POINTS": 5,
        "RECALL": 0.8,
        "RECALLS": (0.5, 0.6, 0.7, 0.8, 0.9),
        "POINTS": ((1, 5), (5, 20), (20, 100), (100, 1 << 30)),
        "DRAWS": 500,
    }
    assert constants_of(pasted_cars) == record | {
        "VEHICLES": ("vehicle", "large_vehicle"),
        "FARTHEST_M": 70.0,
        "SECTOR_RAD": pytest.approx(np.pi * 35 / 180),
        "MATCH_M": 2.0,
        "FAR_RANGES_M": ((70, 110), (110, 150), (150, 200), (200, 250)),
        "FAR_HALF_WIDTH_M": 45.0,
        "FAR_POINTS": ((1, 3), (3, 7), (7, 21), (21, 1 << 30)),
        "COPIES": 3,
        "CARS_A_RANGE": 2,
        "_KIND_MARGIN_M": 0.3,
        "_PLANT_SCATTER": 0.03,
        "_FEW_POINTS": 5,
        "_TALL_M": 2.8,
        "_HIGHEST_M": 8.0,
        "_TALL_POINTS": 3,
        "_MOUNTED_RAD": pytest.approx(np.pi * 20 / 180),
    }


def test_a_detector_is_tried_on_emptied_and_filled_sweeps(rng: np.random.Generator) -> None:
    pytest.importorskip("embreex")
    azimuth, up = np.meshgrid(np.linspace(-0.7, 0.7, 600), np.deg2rad(np.linspace(-14, -1.5, 60)))
    ray = np.stack([np.cos(up) * np.cos(azimuth), np.cos(up) * np.sin(azimuth), np.sin(up)], -1).reshape(-1, 3)
    road = ray * (-1.8 / ray[:, 2:])
    car = rng.uniform((14, -7, -1.7), (18, -5.4, -0.4), (400, 3))
    frame = Frame(
        sequence="a",
        frame_id="0",
        clouds={"lidar": Cloud(np.concatenate([road, car]))},
        reference="lidar",
        load_annotation=lambda: Annotation(
            boxes=Boxes(
                centre_m=np.array([[16, -6.2, -1.05]]),
                size_m=np.array([[4.2, 1.8, 1.5]]),
                yaw_rad=np.zeros(1),
                label=["vehicle"],
            )
        ),
    )
    result = try_on_donors(Knowing(), [frame], HDL_64E, in_field=all_around)
    assert result.sweeps == 1
    assert result.false == []
    assert len(result.cars) > 8
    assert np.mean([car.score > 0 for car in result.cars if car.points > 20]) > 0.7
    again = try_on_donors(Knowing(), [frame], HDL_64E, in_field=all_around)
    assert again.cars == result.cars

"""Statistics against analytic cases: known angles, a known power law, counts by hand, and one real radar picture."""

import json

import numpy as np
import pytest
from PIL import Image

from farfield.frame import Annotation, Boxes, Cloud, Constant, Frame, Sensor, transform_frame
from farfield.geometry.poses import invert, pose_from_yaw
from farfield.inspection.statistics import Statistics, gather, map_statistics, power_map_db
from farfield.inspection.statistics.objects import points_by_distance, radar_survival, survival
from farfield.inspection.statistics.radar import exponential_ratio
from farfield.radar.axes import KRADAR_AXES, POWER_UNIT
from farfield.vocabulary.published_tables import RAISED_SHARES


def cloud_at(elevation_deg, range_m=50.0):
    elevation = np.radians(np.asarray(elevation_deg, dtype=np.float64))
    points = np.stack([range_m * np.cos(elevation), 0 * elevation, range_m * np.sin(elevation)], axis=1)
    return Cloud(points.astype(np.float32), np.zeros(len(points), dtype=np.float32))


def cars(x_m, label="vehicle"):
    n = len(x_m)
    centre = np.column_stack([x_m, np.zeros(n), np.zeros(n)])
    return Boxes(centre_m=centre, size_m=np.tile([4.0, 2.0, 1.5], (n, 1)), yaw_rad=np.zeros(n), label=label)


def frame_of(clouds, boxes=None, **rest):
    annotation = None if boxes is None else Constant(Annotation(boxes=boxes))
    return Frame(**{"sequence": "s", "frame_id": "0", "clouds": clouds, "load_annotation": annotation, **rest})


def random_frames(rng, count=6):
    for number in range(count):
        points = rng.uniform([1, -20, -2], [120, 20, 2], (400, 3)).astype(np.float32)
        cloud = Cloud(points, np.zeros(400, dtype=np.float32))
        weather = ("normal", "sleet")[number % 2]
        clouds = {"gaussian": cloud} | ({"uniform": cloud[:100]} if number > 2 else {})
        boxes = cars(rng.uniform(5, 110, number), label=["vehicle", "pedestrian"][number % 2])
        radar = {"polar3d": rng.exponential(0.01, (2, 256, 107, 37)).astype(np.float32)} if number in (1, 4) else {}
        yield frame_of(
            clouds, boxes, sequence=f"s{number % 2}", frame_id=str(number), conditions={"weather": weather}, radar=radar
        )


def test_shares_by_elevation_are_those_of_a_normal_distribution(rng):
    angles = rng.normal(-2.0, 5.0, 200_000)
    cloud = gather([frame_of({"lidar": cloud_at(angles)})]).summary()["clouds"]["lidar"]
    assert cloud["share_of_focus"]["5"] == pytest.approx(0.6827, abs=0.005)  # one sigma either side
    assert cloud["share_of_focus"]["10"] == pytest.approx(0.9545, abs=0.003)
    # about the horizon, |el| < 5 runs from -0.6 to 1.4 sigma: Phi(1.4) - Phi(-0.6) = 0.91924 - 0.27425
    assert cloud["share_of_horizon"]["5"] == pytest.approx(0.64499, abs=0.005)


def test_near_returns_are_left_out_of_the_far_shares():
    near, far = cloud_at([-20.0, -20.0], 5.0), cloud_at([1.0, 3.0], 60.0)
    cloud = gather([frame_of({"lidar": Cloud.concatenate([near, far])})]).summary()["clouds"]["lidar"]
    assert cloud["share_of_horizon"] == {"2": 0.25, "5": 0.5, "10": 0.5}
    assert cloud["far_share_of_horizon"] == {"2": 0.5, "5": 1.0, "10": 1.0}
    assert sum(cloud["range"]["count"]) == 4
    assert cloud["longest_m"] == pytest.approx(60.0)


def test_missing_returns_do_not_count_and_shots_give_the_return_rate():
    cloud = Cloud.concatenate([cloud_at(np.zeros(30)), cloud_at(np.zeros(10), 0.0)])
    for given in ({"lidar": Sensor(kind="lidar", shots=40)}, {}):
        frames = [frame_of({"lidar": cloud}, sensors=given)]
        found = gather(frames, shots={} if given else {"lidar": 40}).summary()["clouds"]["lidar"]
        assert found["points_per_frame"] == 30
        assert found["return_rate"] == 0.75
    assert gather([frame_of({"lidar": cloud})]).summary()["clouds"]["lidar"]["return_rate"] is None


def test_real_luminar_sweeps_have_their_published_shares(shared_real):
    from farfield.datasets import open_dataset

    summary = gather(open_dataset(shared_real / "cirrus_layout")).summary()
    shares = summary["clouds"]["gaussian"]["far_share_of_horizon"]
    assert [shares["2"], shares["5"], shares["10"]] == pytest.approx([0.31, 0.68, 0.955], abs=0.01)
    assert summary["boxes"]["count"] == 95 + 96 + 95


def test_a_power_law_gives_its_own_slope_and_level(rng):
    range_m = 10 ** rng.uniform(1.0, 2.0, 4000)
    fit = points_by_distance(range_m, np.round(200 * (range_m / 50.0) ** -2.0).astype(np.int64))
    assert fit["slope"] == pytest.approx(-2.0, abs=0.03)
    assert fit["level"] == pytest.approx(200.0, rel=0.03)
    assert fit["fitted_m"][0] == pytest.approx(10.0)


def test_few_boxes_give_medians_but_no_line():
    fit = points_by_distance(np.array([21.0, 21.1, 21.2]), np.array([5, 9, 100]))
    assert fit["slope"] is None
    assert [value for value in fit["median"] if value is not None] == [9.0]
    assert sum(fit["boxes"]) == 3


def test_survival_by_hand():
    range_m = np.array([10.0, 10.0, 10.0, 50.0, 50.0, 50.0])
    count = np.array([100, 200, 30, 40, 10, 0])
    weather = np.array(["normal", "normal", "sleet", "normal", "sleet", "sleet"], dtype=object)
    table = survival(range_m, count, weather)["weather"]
    assert list(table) == ["normal", "sleet"]
    assert table["sleet"]["ratio"][:3] == [30 / 150, None, 5 / 40]
    assert table["sleet"]["overall"] == pytest.approx((0.2 * 1 + 0.125 * 2) / 3)
    assert table["normal"]["overall"] == 1.0


def test_points_classes_and_sizes_by_hand():
    points = np.array([[20, 0, 0], [20.5, 0.5, 0.2], [60, 0, 0], [30, 9, 0]], dtype=np.float32)
    cloud = Cloud(points, np.zeros(4, dtype=np.float32))
    boxes = Boxes.concatenate([cars([20.0, 60.0, 90.0]), cars([30.0], "pedestrian")])
    statistics = gather([frame_of({"lidar": cloud}, boxes, conditions={"weather": "fog"})])
    arrays = statistics.arrays()["points/lidar"]
    np.testing.assert_array_equal(arrays["count"], [2, 1, 0])
    np.testing.assert_array_equal(arrays["range_m"], [20.0, 60.0, 90.0])
    summary = statistics.summary()
    assert summary["boxes"]["classes"]["vehicle"]["share"] == 0.75
    assert summary["boxes"]["classes"]["vehicle"]["length_m"] == {"mean": 4.0, "std": 0.0}
    assert sum(summary["boxes"]["vehicle_distance"]["count"]) == 3
    assert summary["conditions"]["weather"] == {"fog": 1.0}


def test_the_two_patterns_are_compared_beyond_50_m():
    dense = cloud_at(np.zeros(6), 60.0)
    clouds = {"gaussian": Cloud.concatenate([dense, cloud_at(np.zeros(9), 20.0)]), "uniform": dense[:3]}
    assert gather([frame_of(clouds, cars([20.0, 60.0]))]).summary()["pattern_ratio_beyond_50_m"] == 2.0


def test_parts_that_are_merged_equal_the_whole(rng):
    frames = list(random_frames(rng))
    whole, first, second = gather(frames), gather(frames[:2]), gather(frames[2:])
    first.merge(second)
    assert json.dumps(first.summary(), sort_keys=True) == json.dumps(whole.summary(), sort_keys=True)
    for name, arrays in whole.arrays().items():
        for key, value in arrays.items():
            np.testing.assert_allclose(first.arrays()[name][key], value)
    with pytest.raises(ValueError, match="same focus"):
        first.merge(Statistics(focus_deg=0.0))


def test_what_is_missing_is_said_and_the_rest_is_kept():
    missing = gather([frame_of({})]).missing
    assert [text.split(":")[0] for text in missing] == [
        "no point cloud",
        "no annotated frame",
        "no radar tensor or polar map",
        "no weather, road, time recorded with the frames",
    ]
    other = gather([frame_of({"lidar": cloud_at([0.0])}, cars([9.0], "Car"))])
    assert "no box of class vehicle: no points in vehicle boxes" in other.missing
    assert json.dumps(other.summary(), allow_nan=False)


@pytest.mark.parametrize(("mark", "said"), [(True, True), (False, False), (None, None)])
def test_simulated_frames_say_so(mark, said):
    assert gather([frame_of({}, simulated=mark)]).simulated is said


def picture_of_a_real_map(path):
    """Decode the plotted range-azimuth map (256 x 107 cells) by its own colour bar."""
    image = np.asarray(Image.open(path).convert("RGB")).astype(np.int64)
    bar_rows = np.arange(176, 1280)
    bar_db = 150.0 + (326 - bar_rows) * 50.0 / (1265 - 326)  # ticks at 150 and 100 dB
    x = (240 + (np.arange(107) + 0.5) * (1430 - 240) / 107).round().astype(int)
    y = (1282 - (np.arange(256) + 0.5) * (1282 - 173) / 256).round().astype(int)
    colours, which = np.unique(image[y][:, x].reshape(-1, 3), axis=0, return_inverse=True)
    away = ((colours[:, None, :] - image[bar_rows, 1532]) ** 2).sum(-1)
    return bar_db[away.argmin(-1)][which].reshape(256, 107)


def test_a_real_radar_map_has_its_published_figures(shared_real):
    found = map_statistics(picture_of_a_real_map(shared_real / "kradar" / "example" / "plot_tes_ra.png"))
    assert found["floor_db"] == pytest.approx(109.1, abs=0.25)
    assert found["floor_std_db"] == pytest.approx(0.30, abs=0.05)
    assert found["peak_m"] == pytest.approx(51.8, abs=0.3)
    assert found["peak_db"] == pytest.approx(8.6, abs=0.3)
    assert list(found["row_quantiles_db"].values()) == pytest.approx([0.5, 0.8, 1.2, 2.0, 4.2], abs=0.15)
    assert found["rolloff_db"] == pytest.approx(-5.0, abs=0.5)
    assert found["dip_db"] == pytest.approx(-2.0, abs=1.0)
    assert found["leakage_db"] > 35.0
    for within, published in RAISED_SHARES.items():
        assert found["raised_share"][within] == pytest.approx(float(published), abs=0.0006)


def test_map_statistics_of_a_made_map(rng):
    range_m = KRADAR_AXES.range_m
    power_db = 109.0 + 0.3 * rng.standard_normal((256, 107))
    power_db[0] += 45.0
    power_db[(range_m > 110) & (range_m < 114)] -= 5.0
    power_db[108] += 1.0
    power_db[108, 50:53] += 8.0  # an object does not move the floor
    found = map_statistics(power_db)
    assert found["floor_db"] == pytest.approx(109.0, abs=0.02)
    assert found["floor_std_db"] == pytest.approx(0.3, abs=0.01)
    assert found["peak_m"] == range_m[108]
    assert found["leakage_db"] == pytest.approx(45.0, abs=0.2)
    assert found["rolloff_db"] == pytest.approx(-5.0, abs=0.1)
    assert found["row_quantiles_db"]["50"] == pytest.approx(1.0, abs=0.15)
    rows = ((range_m >= 45) & (range_m < 75)).sum()
    assert found["raised_share"]["45-75"] == pytest.approx(3 / (rows * 107))
    assert found["raised_share"]["20-30"] == 0.0


def test_radar_excess_stands_where_the_vehicle_does_in_the_radars_frame():
    pose = np.eye(4)
    pose[:3, 3] = (2.54, -0.3, -0.7)
    for weather, amount in (("normal", 9.0), ("heavy_snow", 4.5)):
        polar = np.full((2, 256, 107, 37), 0.008, dtype=np.float32)
        polar[0, 108, 53 + 30] *= 1.0 + amount  # 49.99 m, 30 degrees left
        place = 108 * 0.462890625 * np.array([np.cos(np.radians(30)), np.sin(np.radians(30)), 0.0]) + pose[:3, 3]
        boxes = cars([0.0, 0.0]).replace(centre_m=np.stack([place, place * [1, -1, 1]]))
        radar = {"polar3d": polar}
        sensors = {"polar3d": Sensor(kind="radar", frame_T_sensor=pose, in_frame=False)}
        frame = frame_of({}, boxes, radar=radar, conditions={"weather": weather}, sensors=sensors)
        for seen in (
            frame,
            transform_frame(frame, invert(pose)),
            transform_frame(frame, pose_from_yaw(2.0)),
        ):  # wherever it is seen from
            statistics = gather([seen])
            np.testing.assert_allclose(statistics.objects.radar_excess, [amount, 0.0], atol=1e-4)


def test_radar_change_by_weather_by_hand():
    range_m = np.array([30.0, 30.0, 50.0, 50.0, 50.0])
    excess = np.array([10.0, 5.0, 8.0, 4.0, 4.0])
    weather = np.array(["normal", "sleet", "normal", "sleet", "sleet"], dtype=object)
    table = radar_survival(range_m, excess, weather)["weather"]
    assert table["sleet"]["change_db"][1:3] == pytest.approx([-3.0103, -3.0103], abs=1e-4)
    assert table["sleet"]["overall"] == pytest.approx(-3.0103, abs=1e-4)
    assert table["sleet"]["change_db"][0] is None


def test_tensor_and_polar_map_give_the_same_map(rng):
    tensor = np.empty(KRADAR_AXES.shape, dtype=np.float32)
    tensor[:] = rng.exponential(1e11, KRADAR_AXES.shape[1:]).astype(np.float32)  # the same in every Doppler bin
    polar = np.zeros((2, 256, 107, 37), dtype=np.float32)
    polar[0] = tensor[0].transpose(0, 2, 1) / POWER_UNIT
    np.testing.assert_allclose(power_map_db({"tesseract": tensor}), power_map_db({"polar3d": polar}), atol=1e-4)
    assert power_map_db({"sparse": polar}) is None


def test_single_cells_of_noise_have_median_ln2(rng):
    tensor = rng.standard_exponential((8, 256, 37, 107), dtype=np.float32)
    tensor[:, :, 20, 50] *= 30.0
    assert exponential_ratio(tensor) == pytest.approx(np.log(2), abs=0.01)
    assert exponential_ratio(tensor + tensor[:, :, ::-1]) > 0.8  # two looks

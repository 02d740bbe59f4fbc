"""Weather as an augmentation: settings outside the presets', draws of their own, boxes that go with their points."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import yaml
from pydantic import ValidationError
from small import small_detector

from farfield.datasets import open_dataset
from farfield.detectors.inputs import CloudInput
from farfield.detectors.weights import load_weights
from farfield.errors import ConfigError
from farfield.experiments.plan import Plan
from farfield.experiments.schema import dump_experiment, load_experiment
from farfield.frame import Boxes
from farfield.papers.grid import load_grid
from farfield.papers.jobs import DataLocations, jobs_of
from farfield.papers.locations import locations_of
from farfield.simulation.overlay import OverlaidWeather
from farfield.simulation.weather.conditions import Weather
from farfield.training.config import AugmentationConfig, WeatherConfig
from farfield.training.samples import TrainingSamples
from farfield.training.weather import WeatherOverlay, check_weather, draw_weather, inside_presets, lay_over, read_with

STILL = {"flip_probability": 0.0, "rotation_rad": 0.0, "scale": 0.0}
LUMINAR = {"sensor": "luminar-h2", "probability": 1.0}
GRID = Path(__file__).parents[2] / "benchmarks" / "adaptation_weather.yaml"


def samples_of(data: Path, *, seed: int = 0, **augmentation: Any) -> TrainingSamples:
    network = small_detector("pointpillars")
    return TrainingSamples(
        open_dataset(data),
        inputs=network.inputs,
        clouds=("gaussian",),
        classes=("vehicle",),
        assigner=network.assigner,
        augmentation=AugmentationConfig(**augmentation),
        seed=seed,
    )


def test_what_is_laid_by_default_lies_outside_what_the_presets_hold():
    """Sleet and heavy snow ice windows over by 0.38 to 0.75, other weathers by 0.02 to 0.05."""
    assert inside_presets(WeatherConfig()) == []
    for settings, named in (
        ({"coverage": (0.1, 0.5)}, ["heavy_snow", "sleet"]),
        ({"coverage": (0.04, 0.2)}, ["light_snow"]),
        ({"drops": (0.01, 0.025)}, ["fog"]),
        ({"snow_mm_h": (2.0, 6.0)}, ["sleet", "heavy_snow"]),
        ({"rain_mm_h": (1.0, 1.2)}, ["sleet"]),
        ({"fog_m": (300, 500)}, ["fog"]),
        ({"film_mm": (0.025, 0.06)}, ["rain", "sleet"]),
        ({"transmission": (0.01, 0.1)}, ["0.05"]),
        ({"patches_deg": ((7.0, 9.0), (6.0, 12.0))}, ["8"]),
    ):
        found = inside_presets(WeatherConfig(**settings))
        assert len(found) == len(named), found
        for word in named:
            assert any(word in text for text in found), (word, found)


def test_the_benchmarks_settings_lie_outside_too():
    grid = load_grid(GRID)
    trees = [run.augmentation.get("weather") for run in grid.runs.values()]
    trees += [run.method.get("strong", {}).get("weather") for run in grid.runs.values()]
    configs = [WeatherConfig.model_validate(tree) for tree in trees if tree]
    assert len(configs) == 15
    assert all(inside_presets(config) == [] for config in configs)


def test_draws_stay_within_the_settings_and_come_as_often_as_they_say(rng):
    config = WeatherConfig(probability=0.5)
    drawn = [draw_weather(config, rng) for _ in range(2000)]
    laid = [each for each in drawn if each is not None]
    assert len(laid) == pytest.approx(1000, abs=120)
    rain = [each.weather.rain_mm_h for each in laid if each.weather.rain_mm_h]
    snow = [each.weather for each in laid if each.weather.snow_mm_h]
    fog = [each.weather.mor_m for each in laid if each.weather.mor_m < 2000]
    ice = [each for each in laid if not each.weather.snow_mm_h and each.weather.icing and each.kind == "ice"]
    assert all(len(part) > 180 for part in (rain, snow, fog, ice))
    assert len(rain) + len(snow) + len(fog) + len(ice) == len(laid)
    assert min(rain) == pytest.approx(12)
    assert max(rain) == pytest.approx(30)
    assert all(0.08 <= each.icing_at(0.0) <= 0.35 for each in snow)
    assert all(12 <= each.patches_deg[0] <= 25 and 0.08 <= each.transmission <= 0.3 for each in ice)
    assert draw_weather(WeatherConfig(probability=0.0), rng) is None
    same = [draw_weather(config, np.random.default_rng(seed)) for seed in (5, 5)]
    assert (same[0] is None) == (same[1] is None)


def test_settings_that_do_not_fit_are_refused():
    with pytest.raises(ValidationError, match="lower one first"):
        WeatherConfig(rain_mm_h=(30.0, 12.0))
    with pytest.raises(ValidationError):
        WeatherConfig(coverage=(0.5, 1.5))
    with pytest.raises(ValidationError):
        WeatherConfig(kinds=())
    lidar, radar = {"points": CloudInput()}, {"points": CloudInput(columns=("x_m", "y_m", "z_m", "power"))}
    with pytest.raises(ConfigError, match="os2-64"):
        check_weather(WeatherConfig(), lidar)
    check_weather(WeatherConfig(), radar)
    check_weather(WeatherConfig(sensor="os2-64"), lidar)
    check_weather(WeatherConfig(probability=0.0), lidar)
    check_weather(None, lidar)


def test_a_probability_of_0_and_no_setting_give_the_same_training_to_the_bit(experiment: Path, tmp_path: Path):
    weights = []
    for name, overrides in (("plain", []), ("off", ["augmentation.weather={probability: 0}"])):
        run = load_experiment(experiment, ["training.steps=3", *overrides])
        weights.append(load_weights(Plan(run, tmp_path / name).run())[0].state_dict())
    assert all(torch.equal(weights[0][name], value) for name, value in weights[1].items())
    assert "weather" not in dump_experiment(load_experiment(experiment))
    assert yaml.safe_load(dump_experiment(run))["augmentation"]["weather"]["probability"] == 0


def test_weather_changes_points_and_no_other_draw(data: Path):
    """The frame's order, mirror and turn stay; what is left of the points are points of the plain sample."""
    moved = {"flip_probability": 0.5, "rotation_rad": 0.3, "scale": 0.05}
    plain, laid = samples_of(data, **moved), samples_of(data, **moved, weather=LUMINAR)
    changed = 0
    for place in range(6):
        before, after = (each[place].inputs["points"].numpy() for each in (plain, laid))
        known = {row[:3].tobytes() for row in before}
        shared = np.array([row[:3].tobytes() in known for row in after])
        assert shared.sum() > 0.2 * len(before)
        changed += len(before) != shared.sum() or not shared.all()
    assert changed >= 5
    again = samples_of(data, **moved, weather=LUMINAR)
    np.testing.assert_array_equal(laid[3].inputs["points"], again[3].inputs["points"])
    other = samples_of(data, seed=1, **moved, weather=LUMINAR)
    assert len(other[3].inputs["points"]) != len(laid[3].inputs["points"])


def test_what_the_network_does_not_read_is_not_given_to_it(data: Path):
    bare = small_detector("pointpillars").inputs["points"].columns
    assert read_with(CloudInput(columns=("x_m", "y_m", "z_m")), WeatherConfig()) == ("x_m", "y_m", "z_m", "intensity")
    assert read_with(CloudInput(columns=("x_m", "y_m", "z_m")), None) == ("x_m", "y_m", "z_m")
    assert samples_of(data, **STILL, weather=LUMINAR)[0].inputs["points"].shape[1] == len(bare)


def opaque(config: WeatherConfig) -> OverlaidWeather:
    icy = Weather(icing=1.0, icing_age_s=float("inf"), temperature_c=-3.0)
    return OverlaidWeather(icy, np.random.SeedSequence(1), "ice", (15.0, 8.0), 1e-6)


def test_boxes_go_with_their_last_point_and_stay_if_they_never_had_one(rng):
    """A window that is covered all over its front: ahead nothing is left, behind everything."""
    config = WeatherConfig(sensor="os2-64")
    centre = np.array([[20.0, 0, 0], [-20.0, 0, 0], [40.0, 5.0, 0]])
    boxes = Boxes(centre_m=centre, size_m=np.full((3, 3), 2.0), yaw_rad=np.zeros(3), label=["vehicle"] * 3)
    xyz = np.repeat(centre[:2], 50, axis=0) + rng.uniform(-0.5, 0.5, (100, 3))
    table = np.column_stack([xyz, np.zeros(100), np.full(100, 0.5), np.zeros(100)]).astype(np.float32)
    columns = ("x_m", "y_m", "z_m", "lag_s", "intensity")
    laying = WeatherOverlay(config, columns, (("x_m", "y_m", "z_m", "intensity"),), opaque(config), rng)
    points, left = laying(table, boxes)
    assert (points[:, 0] < 0).all()
    assert len(points) == 50
    np.testing.assert_array_equal(left.centre_m[:, 0], [-20.0, 40.0])


def test_a_radars_cells_lose_power_and_keep_their_places(rng):
    points = np.column_stack([rng.uniform(5, 70, (500, 3)), np.full(500, 0.5)]).astype(np.float32)
    weather = Weather("heavy_snow", snow_mm_h=5.0, icing=0.3, icing_age_s=float("inf"), temperature_c=-3.0)
    laid = OverlaidWeather(weather, np.random.SeedSequence(1))
    weaker, kept = lay_over(points, ("x_m", "y_m", "z_m", "power"), WeatherConfig(), laid, rng)
    np.testing.assert_array_equal(weaker[:, :3], points[:, :3])
    assert kept.all()
    assert (weaker[:, 3] < points[:, 3]).all()
    assert (weaker[:, 3] > 0.3).all()


def test_without_intensity_all_points_count_as_of_one_reflectance(rng):
    points = np.column_stack([np.full(2000, 60.0), np.linspace(-20, 20, 2000), np.zeros(2000)]).astype(np.float32)
    fog = OverlaidWeather(Weather("fog", mor_m=200.0), np.random.SeedSequence(1))
    shares = []
    for reflectance in (0.05, 0.9):
        config = WeatherConfig(sensor="os2-64", reflectance=reflectance)
        _, kept = lay_over(points, ("x_m", "y_m", "z_m"), config, fog, np.random.default_rng(0))
        shares.append(kept.mean())
    assert shares[0] < 0.2 < shares[1]


def test_a_grids_run_in_weather_is_known_by_the_simulators_code_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    from farfield.papers import jobs

    grid = load_grid(GRID)
    asked: list[tuple[str, ...]] = []
    monkeypatch.setattr(jobs, "code_digest", lambda rooms: asked.append(rooms) or "")
    places = locations_of(grid, "laptop", tmp_path)
    named = {name: name for name in places}
    found = jobs_of(grid, "laptop", (), DataLocations(locations=places, fingerprints=named), tmp_path)
    assert len(found) == 42  # alike until thresholds and steps are set: four rows of the LiDAR are one
    laid = sum("simulation" in rooms for rooms in asked)
    assert laid == 27

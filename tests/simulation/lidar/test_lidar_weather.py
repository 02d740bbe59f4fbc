"""What weather does to a LiDAR's frame: extinction, ice, clutter, ground; each against a figure it must reproduce."""

import dataclasses

import numpy as np
import pytest
from _validation_scenes import HERE, body, coloured, fleet, frozen, patch_of_road, plate, quiet

from farfield.geometry.poses import pose_from_yaw
from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import quads
from farfield.simulation.lidar.air import FOG, PRECIPITATION, SPRAY, SURFACE, spray
from farfield.simulation.lidar.model import LUMINAR_H2, OS2_64
from farfield.simulation.lidar.rays import Scan
from farfield.simulation.lidar.surfaces import snow_grades
from farfield.simulation.lidar.sweep import SimulatedSweep, sweep
from farfield.simulation.weather.conditions import Weather
from farfield.simulation.weather.optics import extinction_per_m
from farfield.simulation.weather.spray import Plume
from farfield.simulation.world.scene import SceneWindow

SEED = np.random.SeedSequence(9)
WEATHERS = {
    "normal": Weather(),
    "rain": Weather("rain", rain_mm_h=5.0, mor_m=8000.0, water_mm=0.8, film_mm=0.03, icing=0.03),
    "light_snow": Weather("light_snow", snow_mm_h=0.6, mor_m=6000.0, snow_cover=0.4, icing=0.05, icing_age_s=600.0),
    "fog": Weather("fog", mor_m=500.0, icing=0.02),
    "heavy_snow": Weather("heavy_snow", snow_mm_h=2.0, mor_m=6000.0, icing=0.60, icing_tau_s=300.0, icing_age_s=900.0),
    "sleet": Weather(
        "sleet", rain_mm_h=1.0, snow_mm_h=2.5, wet_snow=True, mor_m=6000.0, icing=0.75, icing_age_s=600.0, water_mm=0.7
    ),
}


def drive(model: object, window: SceneWindow, weather: Weather | None, **seeds: object) -> SimulatedSweep:
    rng = np.random.default_rng(3)
    scan = Scan.draw(model, rng, pattern="uniform")  # type: ignore[arg-type]
    return sweep(scan, model, window, HERE, rng, weather=weather, **seeds)  # type: ignore[arg-type]


@pytest.mark.parametrize("wavelength_nm", [550.0])
def test_intensity_over_distance_gives_back_the_visibility(wavelength_nm: float) -> None:
    """Slope of the logarithm of the intensity is -2 alpha; ln 20 / alpha is the requested optical range within 1 %."""
    model = quiet(LUMINAR_H2, sub_rays=1)
    assert wavelength_nm == 550.0
    weather = Weather("fog", mor_m=800.0)
    ranges = np.array([10.0, 20.0, 40.0, 80.0])
    shown = []
    for range_m in ranges:
        window = frozen(body(plate(1.0, width_m=range_m, height_m=range_m / 3), range_m, 0, 0))
        cloud = drive(model, window, weather).cloud
        mine = cloud.points_m[:, 0] > range_m - 1
        straight = mine & (np.abs(cloud.points_m[:, 1:] / cloud.points_m[:, :1]).max(axis=1) < 0.1)
        shown.append(np.log(cloud.intensity[straight].astype(np.float64)).mean())
    alpha = -np.polyfit(ranges, shown, 1)[0] / 2
    visibility_m = 800.0 * np.log(0.02) / np.log(0.05)
    at_550 = alpha * (1550 / 550) ** (visibility_m / 1000 * 0.16 + 0.34)  # Kim's exponent between 1 and 6 km
    assert np.log(20) / at_550 == pytest.approx(800.0, rel=0.01)


def test_survival_of_cars_falls_in_the_order_of_the_weathers(rng: np.random.Generator) -> None:
    """normal > rain, light snow > fog > heavy snow, sleet: hits on cars by an OS2, beside clear air."""
    window = fleet(rng)
    hits = {
        name: int((drive(OS2_64, window, weather, window_seed=SEED).actor >= 0).sum())
        for name, weather in WEATHERS.items()
    }
    assert hits["normal"] > 2000
    assert hits["normal"] > max(hits["rain"], hits["light_snow"])
    assert min(hits["rain"], hits["light_snow"]) > hits["fog"]
    assert hits["fog"] > max(hits["heavy_snow"], hits["sleet"])
    assert hits["sleet"] < 0.6 * hits["normal"]


def test_ice_hides_whole_sectors_and_never_comes_back(rng: np.random.Generator) -> None:
    """Cars that a frozen window hides vanish together with their neighbours; the covered part only grows."""
    window = fleet(rng)
    seen = []
    for time_s in (0.0, 60.0, 400.0):
        sleet = Weather("sleet", icing=0.75, icing_tau_s=120.0, snow_mm_h=0.001, wet_snow=True)
        result = drive(OS2_64, dataclasses.replace(window, time_s=time_s), sleet, window_seed=SEED)
        seen.append(np.bincount(result.actor[result.actor >= 0], minlength=160) > 0)
    assert seen[0].sum() > seen[1].sum() > seen[2].sum()
    changes = int((np.diff(seen[1].astype(int)) != 0).sum())
    chance = 2 * 160 * seen[1].mean() * (1 - seen[1].mean())
    assert changes < 0.6 * chance


def test_snow_on_the_ground_is_dark_at_1550_nm_and_bright_at_865_nm() -> None:
    """Albedo 0.10 to 0.16 against more than 0.7."""
    snow = Weather("light_snow", snow_cover=1.0)
    for model, low, high in ((LUMINAR_H2, 0.10, 0.16), (OS2_64, 0.70, 0.95)):
        window = patch_of_road(Material.ASPHALT, reflectance=0.18)
        still = quiet(model, sub_rays=1)
        white, dry = (drive(still, window, weather).cloud for weather in (snow, None))
        white, dry = (cloud[np.hypot(cloud.points_m[:, 0], cloud.points_m[:, 1]) < 12] for cloud in (white, dry))
        x, y, z = dry.points_m.T.astype(np.float64)
        cosine = -z / np.sqrt(x**2 + y**2 + z**2)
        base = 0.18 if model is LUMINAR_H2 else 0.12
        np.testing.assert_allclose(dry.intensity, base * (0.97 * cosine + 0.03), atol=0.003)
        assert len(white) == len(dry) > 1000
        albedo = white.intensity / (0.9 * cosine + 0.1)
        assert low < np.median(albedo) < high


def test_partial_snow_lies_where_the_world_has_it() -> None:
    model = quiet(OS2_64, sub_rays=1)
    window = patch_of_road(Material.GRASS, reflectance=0.30)
    dry, patchy = drive(model, window, None).cloud, drive(model, window, Weather("light_snow", snow_cover=0.4)).cloud
    near = [cloud[np.hypot(cloud.points_m[:, 0], cloud.points_m[:, 1]) < 20] for cloud in (dry, patchy)]
    assert len(near[0]) == len(near[1]) > 1000
    changed = np.abs(near[0].intensity - near[1].intensity) > 0.006  # haze takes a step of 1/255
    x, y = near[0].points_m[:, 0].astype(np.float64), near[0].points_m[:, 1].astype(np.float64)
    expected = snow_grades(x, y, np.full(len(x), 0.4)) >= 0
    assert 0.1 < expected.mean() < 0.7
    assert np.mean(changed == expected) > 0.99


def test_wet_road_vanishes_beyond_30_to_50_m() -> None:
    """Returns of an OS2 from wet asphalt thin out where the dry road is still seen."""
    road = quads(np.array([[[3.0, -5, 0], [80, -5, 0], [80, 5, 0], [3, 5, 0]]]), int(Material.ASPHALT))
    window = frozen(body(coloured(road, 0.18), 0, 0, -1.9, actor=-1))
    dry, wet = (
        drive(OS2_64, window, weather).cloud.points_m[:, 0] for weather in (None, Weather("rain", water_mm=1.0))
    )
    assert np.percentile(wet, 98) < 0.8 * np.percentile(dry, 98)
    assert len(wet) < 0.8 * len(dry)


def test_clutter_is_near_and_of_its_kind() -> None:
    """Snow and rain give single returns within 15 m; fog gives soft echoes; clear air gives nothing."""
    far = frozen(body(plate(0.4, width_m=200, height_m=100), 45, 0, 0))
    clear = drive(OS2_64, far, WEATHERS["normal"])
    assert set(clear.kind) == {SURFACE}
    for name, share in (("rain", 0.002), ("heavy_snow", 0.03)):
        result = drive(OS2_64, far, WEATHERS[name])
        drops = result.kind == PRECIPITATION
        range_m = np.linalg.norm(result.cloud.points_m[drops], axis=1)
        assert share < drops.sum() / 131_072 < 0.25
        assert np.percentile(range_m, 90) < 15
        assert (result.actor[drops] == -1).all()
    dense = drive(OS2_64, far, Weather("fog", mor_m=60.0))
    assert (dense.kind == FOG).sum() > 1000


def test_flakes_never_replace_what_stands_before_them() -> None:
    near = frozen(body(plate(0.4, width_m=80, height_m=60), 3, 0, 0))
    result = drive(OS2_64, near, WEATHERS["heavy_snow"])
    ahead = result.cloud.points_m[:, 0] > 0.5
    assert result.cloud.points_m[ahead, 0].max() < 3.1


def test_spray_takes_light_and_gives_echoes() -> None:
    """Through the middle of a plume the signal falls by exp(-2 tau), tau = alpha sqrt(2 pi) sigma."""
    model = quiet(LUMINAR_H2, sub_rays=1)
    scan = Scan.draw(model, np.random.default_rng(0), pattern="uniform")
    plume = Plume((30.0, 0.0, 0.0), 0.0, (4.0, 1.0, 0.8), 0.05)
    open_m = np.full(scan.shape[0] * scan.shape[1], 100.0, dtype=np.float32)
    result = spray(scan, model, [plume], HERE, open_m)
    straight = np.argmax(scan.directions.reshape(-1, 3)[:, 0])
    tau = 0.05 * np.sqrt(2 * np.pi) * 4.0
    assert result.gain[straight] == pytest.approx(np.exp(-2 * tau), rel=0.02)
    assert result.gain.min() >= result.gain[straight] * 0.99
    assert result.range_m[straight] == pytest.approx(30.0, abs=0.1)
    assert (result.gain == 1).mean() > 0.7
    blocked = spray(scan, model, [plume], HERE, np.full_like(open_m, 5.0))
    assert blocked.gain.min() > 0.99
    assert blocked.strength.max() == 0


def test_vehicles_on_a_wet_road_trail_spray() -> None:
    window = frozen(body(plate(0.4, width_m=1, height_m=1), 60, 0, 0))
    fast = dataclasses.replace(
        window,
        bottom_m=np.array([[40.0, 0.0, -1.0]]),
        velocity_m_s=np.array([[32.0, 0.0, 0.0]]),
    )
    wet = Weather("rain", rain_mm_h=0.0, mor_m=20000.0, water_mm=1.0)
    kinds = [set(drive(LUMINAR_H2, scene, wet).kind) for scene in (fast, window)]
    assert SPRAY in kinds[0]
    assert SPRAY not in kinds[1]


def test_weather_repeats_with_its_seed_and_leaves_the_surface_draws_alone() -> None:
    """The same bytes again; and thin weather changes which shots come back only by what it absorbs."""
    window = frozen(body(plate(0.3, width_m=60, height_m=30), 30, 0, 0))
    first, again = (drive(OS2_64, window, WEATHERS["sleet"], window_seed=SEED).cloud for _ in range(2))
    assert first.points_m.tobytes() == again.points_m.tobytes()
    clear, haze = drive(OS2_64, window, None).cloud, drive(OS2_64, window, Weather(mor_m=1e7)).cloud
    shots = [cloud.extra["ring"].astype(np.int64) * 2048 + cloud.extra["column"] for cloud in (clear, haze)]
    assert len(np.intersect1d(*shots)) > 0.999 * max(len(clear), len(haze))


def test_mounting_turns_the_world_the_other_way() -> None:
    rng = np.random.default_rng(0)
    window = frozen(body(plate(0.5, width_m=4, height_m=4), 20, 0, 0))
    result = sweep(Scan.draw(OS2_64, rng), quiet(OS2_64), window, pose_from_yaw(np.pi / 2, (0.0, 0.0, 0.0)), rng)
    assert np.median(result.cloud.points_m[:, 1]) == pytest.approx(-19.995, abs=0.01)
    assert extinction_per_m(Weather(), 865.0) < 2e-4

"""Validation of the simulator: every figure beside an independent reference."""

import dataclasses
import re
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import Any

import _validation_scenes as stage
import numpy as np
from _report import RESULTS, Part, part_parser, run_parts, sections
from _validation_scenes import doppler_spectrum, point_spread_db, sampled_tensor, scatterers_of_snr
from scipy.optimize import brentq
from scipy.special import spherical_jn, spherical_yn

from farfield.geometry.poses import pose_from_yaw
from farfield.radar.axes import RadarAxes
from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import box, ellipsoid, quads
from farfield.simulation.camera.mounts import ZED_2I, Mount
from farfield.simulation.camera.render import radiance
from farfield.simulation.camera.sky import make_sky
from farfield.simulation.lidar.model import (
    LUMINAR_H2,
    OS1_128,
    OS1_128_BEAMS,
    OS2_64,
    OS2_128_BEAMS,
    BeamTable,
    LidarModel,
    detection_probability,
    line_elevations_deg,
    signal,
)
from farfield.simulation.lidar.rays import Scan
from farfield.simulation.lidar.sweep import SimulatedSweep, sweep
from farfield.simulation.radar.model import RadarModel
from farfield.simulation.radar.points import Scatterers
from farfield.simulation.radar.propagation import (
    film_loss_db,
    rain_coefficients,
    rain_loss_db_km,
    two_way_loss_db,
    water_permittivity,
)
from farfield.simulation.radar.rcs import corner_reflector_m2, vehicle_pattern_dbsm
from farfield.simulation.radar.synthesis import draw_noise, form_moments, form_tensor, synthesise
from farfield.simulation.trace import Tracer
from farfield.simulation.weather.backscatter import Beam, rain_drops, soft_echo
from farfield.simulation.weather.conditions import Weather, draw_weather
from farfield.simulation.weather.optics import haze_extinction_per_m, rain_extinction_per_m
from farfield.simulation.world.scene import SceneWindow
from farfield.vocabulary.conditions import WEATHERS
from farfield.vocabulary.patterns import PATTERNS
from farfield.vocabulary.published_tables import SHARES_NEAR_HORIZON

FIRST = "simulated, the first simulator's"
"""The section of results/detectors.txt that the first simulator's detectors have."""
SEED = 20260101
AIRS = {
    "normal": Weather(),
    "rain": Weather("rain", rain_mm_h=5.0, mor_m=8000.0, water_mm=0.8, film_mm=0.03, icing=0.03),
    "light_snow": Weather("light_snow", snow_mm_h=0.6, mor_m=6000.0, snow_cover=0.4, icing=0.05, icing_age_s=600.0),
    "fog": Weather("fog", mor_m=500.0, icing=0.02),
    "heavy_snow": Weather("heavy_snow", snow_mm_h=2.0, mor_m=6000.0, icing=0.60, icing_tau_s=300.0, icing_age_s=900.0),
    "sleet": Weather(
        "sleet", rain_mm_h=1.0, snow_mm_h=2.5, wet_snow=True, mor_m=6000.0, icing=0.75, icing_age_s=600.0, water_mm=0.7
    ),
}
SMALL_AXES = RadarAxes(
    range_m=0.5 * np.arange(32),
    azimuth_deg=np.arange(-50.0, 51.0, 10.0),
    elevation_deg=np.arange(-10.0, 11.0, 5.0),
    doppler_m_s=0.06 * np.arange(-8, 8),
)
EXACT = RadarModel(
    axes=SMALL_AXES, azimuth_elements=6, azimuth_slots=12, elevation_elements=3, elevation_slots=4,
    truncation_db=-np.inf, range_migration=False, leakage_db=(-40.0,) * 8, response_db=(0.0,) * 8,
)  # fmt: skip
QUIET = RadarModel(leakage_db=(-40.0,) * 8)
UNFILTERED = dataclasses.replace(QUIET, high_pass_m=0.0)
CAR_REAR = {"uniform": {50: 61.0, 100: 15.0, 200: 3.8}, "gaussian": {50: 145.0, 100: 35.0, 200: 8.6}}


@dataclasses.dataclass(frozen=True)
class Row:
    """One figure: what it is, what it must be, what came out; ``ok`` is None where nothing is claimed."""

    what: str
    reference: str
    expected: str
    measured: str
    ok: bool | None


Rows = Iterable[Row]


def near(what: str, reference: str, want: float, got: float, tolerance: float, digits: int = 3) -> Row:
    expected = f"{want:.{digits}f} +- {tolerance:.{digits}f}"
    return Row(what, reference, expected, f"{got:.{digits}f}", abs(got - want) <= tolerance)


def below(what: str, reference: str, limit: float, got: float) -> Row:
    return Row(what, reference, f"< {limit:g}", f"{got:.3g}", got < limit)


def between(what: str, reference: str, low: float, high: float, got: float, digits: int = 3) -> Row:
    return Row(what, reference, f"{low:g} to {high:g}", f"{got:.{digits}f}", low <= got <= high)


def sweep_in(model: LidarModel, window: SceneWindow, weather: Weather | None, **seeds: Any) -> SimulatedSweep:
    """One frame of a world, weather included."""
    rng = np.random.default_rng(3)
    drawn = Scan.draw(model, rng, pattern="uniform")
    return sweep(drawn, model, window, stage.HERE, rng, weather=weather, **seeds)


def chance(model: LidarModel, range_m: float, reflectance: float, extinction_per_m: float = 0.0) -> float:
    trim = np.array([int(Material.TRIM)])
    strength, _ = signal(
        model, np.array([range_m]), np.ones(1), np.array([reflectance]), trim, extinction_per_m=extinction_per_m
    )
    return float(detection_probability(model, strength)[0])


def half_range_m(model: LidarModel, reflectance: float, extinction_per_m: float = 0.0) -> float:
    """Where a target is detected with probability 0.5."""
    return float(brentq(lambda r: chance(model, r, reflectance, extinction_per_m) - 0.5, 1.0, 2000.0))


def radar_peaks_db() -> tuple[np.ndarray, np.ndarray]:
    """Ranges, and the best cell's signal over noise of 10 m2 there ahead of the high-pass filter."""
    model = UNFILTERED
    bins = np.array([22, 43, 108, 216])
    peaks = []
    for index in bins:
        one = Scatterers.of(np.array([[model.axes.range_m[index], 0.0, 0.0]]), np.zeros(1), np.array([10.0]))
        power = form_moments(synthesise(one, model, np.zeros(1)), model).mean_power / model.response()[:, None, None]
        peaks.append(10 * np.log10(power[index].max() * len(model.axes.doppler_m_s) / model.noise_floor))
    return model.axes.range_m[bins], np.array(peaks)


def range_equation() -> Rows:
    range_m, peaks = radar_peaks_db()
    slope = float(np.polyfit(np.log10(range_m), peaks, 1)[0])
    yield near(
        "radar peak power ahead of the filter, 10-100 m, dB a decade", "radar equation, R^-4", -40.0, slope, 0.5, 2
    )
    metres, trim = np.array([10.0, 31.6, 100.0, 200.0]), np.full(4, int(Material.TRIM))
    strength, _ = signal(LUMINAR_H2, metres, np.ones(4), np.full(4, 0.3), trim)
    slope = float(np.polyfit(np.log10(metres), 10 * np.log10(strength), 1)[0])
    yield near("LiDAR signal, dB a decade", "extended target, R^-2", -20.0, slope, 0.01, 3)


def counted_chance() -> float:
    """Share of shots at a 10 % plate at 200 m that come back, dropout included."""
    rng = np.random.default_rng(SEED)
    model = dataclasses.replace(LUMINAR_H2, texture=0.0)
    scan = Scan.draw(model, rng)
    target = stage.frozen(stage.body(stage.plate(0.1, width_m=40, height_m=40), 200, 0, 0))
    cloud = sweep(scan, model, target, stage.HERE, rng).cloud
    inside = np.abs(np.moveaxis(scan.rays[1:] / scan.rays[0], 0, -1)).max(axis=(0, 3)) < 19.9 / 200
    return float(inside[cloud.extra["ring"], cloud.extra["column"]].sum() / inside.sum())


def lidar_reference() -> Rows:
    sheet = "Luminar: 200 m at 10 %"
    yield near("P(10 %, 200 m), law", sheet, 0.90, chance(LUMINAR_H2, 200.0, 0.1), 0.02)
    yield near("P(10 %, 200 m), shots counted, 1 % dropout", sheet, 0.90, counted_chance(), 0.02)
    yield near("50 % range of a 10 % target, m", "200 m 10^(1.76/20)", 245.0, half_range_m(LUMINAR_H2, 0.1), 1.0, 1)
    clear = "(245/R)^2 exp(-2 alpha R) = 1, alpha 1.2e-4"
    got = half_range_m(LUMINAR_H2, 0.1, 1.2e-4)
    yield near("the same, alpha 1.2e-4 per m (20 km visibility)", clear, 237.5, got, 1.0, 1)
    mor_m = 20_000.0 * np.log(0.05) / np.log(0.02)
    alpha = haze_extinction_per_m(mor_m, 1550.0)
    got = half_range_m(LUMINAR_H2, 0.1, alpha)
    yield Row("the same, Kim's alpha at 1550 nm in 20 km", f"alpha {alpha:.2g} per m", "-", f"{got:.1f}", None)
    ratio = half_range_m(OS1_128, 0.8) / half_range_m(OS1_128, 0.1)
    yield near("OS1 range at 80 % over 10 %", "R^-2: sqrt(8)", 8**0.5, ratio, 0.01)
    yield near("OS1 range at 80 % over 10 %", "data sheet 120 m / 40 m", 3.0, ratio, 0.3, 2)


def fitted_mor_m(mor_m: float) -> float:
    """Optical range at 550 nm from the fall of the returned intensity over distance."""
    model, shown = stage.quiet(LUMINAR_H2, sub_rays=1), []
    ranges = min(mor_m / 4, 80.0) / np.array([8.0, 4.0, 2.0, 1.0])
    for range_m in ranges:
        wall = stage.plate(1.0, width_m=range_m, height_m=range_m / 3)
        window = stage.frozen(stage.body(wall, range_m, 0, 0))
        cloud = sweep_in(model, window, Weather("fog", mor_m=mor_m)).cloud
        mine = cloud.points_m[:, 0] > range_m - 1
        straight = mine & (np.abs(cloud.points_m[:, 1:] / cloud.points_m[:, :1]).max(axis=1) < 0.1)
        shown.append(np.log(cloud.intensity[straight].astype(np.float64)).mean())
    alpha = -np.polyfit(ranges, shown, 1)[0] / 2
    visibility_km = mor_m * np.log(0.02) / np.log(0.05) / 1000
    exponent = 0.0 if visibility_km < 0.5 else 0.16 * visibility_km + 0.34  # Kim, below 0.5 km or 1 to 6 km
    return float(np.log(20) / (alpha * (1550 / 550) ** exponent))


def contrast_at(mor_m: float) -> float:
    """Contrast of a black wall at the optical range, its own light taken out."""
    lens = dataclasses.replace(ZED_2I, matrix=(142.0, 144.0, 157.0, 92.0), width_px=320, height_px=180)
    camera = Mount(lens, (0.0, 0.0, 1.45)).camera(np.eye(4))
    weather = Weather("fog", cloud_cover=1.0, mor_m=mor_m)
    black = stage.painted(box([1.0, 60.0, 60.0], [0.5, 0.0, 0.0], int(Material.TYRE)))
    window = stage.on_asphalt((black, pose_from_yaw(0.0, (mor_m, 0.0, 0.0))))
    horizon = make_sky(weather).horizon_rgb
    airs = weather, dataclasses.replace(weather, mor_m=1e9)
    seen, clear = (radiance(window, camera, np.eye(4), air)[0][92, 157] for air in airs)
    return float(((horizon - seen) / horizon / (1 - clear / horizon)).mean())


def koschmieder() -> Rows:
    for mor_m in (150.0, 800.0):
        law = "Koschmieder: ln 20 / alpha"
        yield near(f"LiDAR: MOR fitted in fog of {mor_m:.0f} m, m", law, mor_m, fitted_mor_m(mor_m), 0.01 * mor_m, 1)
    for mor_m in (60.0, 150.0):
        what = f"camera: contrast of black at the MOR, {mor_m:.0f} m"
        yield near(what, "definition of the MOR (WMO)", 0.05, contrast_at(mor_m), 0.0005, 4)


def recommendations() -> Rows:
    for ghz, polarisation, k, alpha in (
        (77.0, "h", 1.1320, 0.7177),
        (77.0, "v", 1.1276, 0.7073),
        (76.5, "h", 1.1253, 0.7188),
        (76.5, "v", 1.1208, 0.7082),
        (10.0, "h", 0.01217, 1.2571),
        (100.0, "h", 1.3671, 0.6815),
    ):
        got, by = rain_coefficients(ghz, polarisation), "ITU-R P.838-3 by itur 0.4" if ghz > 70 else "ITU-R P.838-3"
        by = "ITU-R P.838-3, table" if ghz in (10.0, 100.0) else by
        yield near(f"k {polarisation.upper()} at {ghz:g} GHz", by, k, got[0], 1e-3 * k, 5)
        yield near(f"alpha {polarisation.upper()} at {ghz:g} GHz", by, alpha, got[1], 1e-3 * alpha, 4)
    loss = 2 * 0.1 * rain_loss_db_km(25.0, 77.0)
    yield near("two-way loss, 100 m in 25 mm/h, dB", "0.2 km x 1.1320 25^0.7177", 2.28, loss, 0.01)


def mie(size: np.ndarray, index: float) -> tuple[np.ndarray, np.ndarray]:
    """Extinction and radar backscatter efficiencies of spheres (Bohren and Huffman 1983, equations 4.53 to 4.88)."""
    n = np.arange(1, int(size.max() + 4 * size.max() ** (1 / 3)) + 3)[:, None]

    def riccati(x: np.ndarray, bessel: Callable[..., np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        value = bessel(n, x)
        return x * value, value + x * bessel(n, x, derivative=True)

    with np.errstate(all="ignore"):
        (inner, d_inner), (outer, d_outer) = riccati(index * size, spherical_jn), riccati(size, spherical_jn)
        wave, d_wave = (a + 1j * b for a, b in zip((outer, d_outer), riccati(size, spherical_yn), strict=True))
        a = (index * inner * d_outer - outer * d_inner) / (index * inner * d_wave - wave * d_inner)
        b = (inner * d_outer - index * outer * d_inner) / (inner * d_wave - index * wave * d_inner)
    counted = n <= size + 4 * size ** (1 / 3) + 2
    a, b = np.where(counted, a, 0), np.where(counted, b, 0)
    extinction = 2 / size**2 * ((2 * n + 1) * (a + b).real).sum(axis=0)
    return extinction, np.abs(((2 * n + 1) * (-1.0) ** n * (a - b)).sum(axis=0)) ** 2 / size**2


def mie_lidar_ratio_sr(shape: float, mode_um: float) -> float:
    """Lidar ratio at 905 nm of droplets r^shape exp(-shape r / mode) (gamma law of Rasshofer et al. 2011)."""
    radius_um = np.linspace(0.05, mode_um * (1 + 6 / shape**0.5) + 2, 4000)
    extinction, back = mie(2 * np.pi * radius_um / 0.905, 1.328)
    weight = radius_um ** (2 + shape) * np.exp(-shape * radius_um / mode_um)
    return float(4 * np.pi * (weight * extinction).sum() / (weight * back).sum())


def echoed_lidar_ratio_sr(extinction_per_m: float) -> float:
    """Lidar ratio from the library's echo of a fog that nothing gets through: sum of S r^2 is 1 / (2 ratio)."""
    beam = Beam(905.0, 100.0, 1e-3, overlap_m=(0.0, 0.0001))
    echo = soft_echo(beam, extinction_per_m)
    heard = (echo.strength * echo.range_m**2)[echo.range_m > 9.99].sum() * 0.02 / beam.pulse_m
    return float(np.pi / 0.1 * beam.reference_range_m**2 * np.exp(-20 * extinction_per_m) / (2 * heard))


def rain_and_fog() -> Rows:
    optics = np.pi * 8e6 / (4.1e3 * 10**-0.21) ** 3  # Q = 2 over Marshall and Palmer's drops, integrated in closed form
    sums = "Mie sums (miepython), Marshall/Palmer"
    yield near("rain 10 mm/h: alpha, 1e-3 per m", sums, 1.56, 1e3 * rain_extinction_per_m(10.0), 0.05 * 1.56)
    yield near("the same", "geometric optics, Q = 2", 1e3 * optics, 1e3 * rain_extinction_per_m(10.0), 0.05 * 1.56)
    drops = 1e3 * rain_drops(10.0, 865.0).extinction_per_m
    yield near("the same, of the drops drawn", "geometric optics, Q = 2", 1e3 * optics, drops, 0.05 * 1.56)
    band = "O'Connor et al. 2004: 18.8 +- 0.8 sr"
    for alpha in (0.1, 0.3):
        yield near(f"fog: ratio from its echo, alpha {alpha}, sr", band, 18.8, echoed_lidar_ratio_sr(alpha), 0.8, 2)
    for name, shape, mode_um in (("strong", 3.0, 10.0), ("moderate", 3.0, 8.0)):
        what = f"Mie sum here, {name} advection fog, sr"
        yield near(what, band, 18.8, mie_lidar_ratio_sr(shape, mode_um), 0.8, 2)


def point_spread() -> Rows:
    for axis in ("range", "doppler"):
        offsets = np.concatenate([[0.0, 0.5], np.linspace(0.40, 0.48, 9), np.linspace(1.36, 1.50, 15)])
        level = point_spread_db(offsets, axis, QUIET)
        half = float(np.interp(10 * np.log10(2), -level[2:11], offsets[2:11]))
        fourier = "Dirichlet kernel in closed form"
        yield near(f"{axis}: first side lobe, dB", fourier, -13.26, float(level[11:].max() - level[0]), 0.1, 2)
        yield near(f"{axis}: loss half a bin off, dB", fourier, 3.92, float(level[0] - level[1]), 0.02, 2)
        yield near(f"{axis}: width at half power, bins", fourier, 0.886, 2 * half, 0.005)
    yield below("5 scatterers: largest error over the peak", "sampled beat signal + FFT", 1e-4, brute_force_error())


def brute_force_error() -> float:
    rng = np.random.default_rng(SEED)
    angles = rng.uniform(-45, 45, 5), rng.uniform(-8, 8, 5)
    five = scatterers_of_snr(rng.uniform(2, 14, 5), *angles, rng.uniform(-3, 3, 5), 100.0, EXACT)
    phase = rng.uniform(0, 2 * np.pi, 5)
    found = form_tensor(synthesise(five, EXACT, phase), EXACT) / EXACT.noise_floor
    want = sampled_tensor(five, EXACT, phase)
    return float(np.abs(found - want).max() / want.max())


def noise() -> Rows:
    model, rng = RadarModel(), np.random.default_rng(7)
    cells = form_tensor(draw_noise(model, rng), model)[:, 150:200]
    independent = rng.exponential(1.0, (64, 50, 37, 107)).mean(axis=(0, 2))
    floor = float((10 * np.log10(cells.mean(axis=(0, 2)))).std())
    control = float((10 * np.log10(independent)).std())
    lag = [np.corrcoef(cells[:, :, 18, ::8].ravel(), cells[:, :, 18 + k, ::8].ravel())[0, 1] for k in (1, 18)]
    yield near("cells: median over mean", "exponential: ln 2", np.log(2), float(np.median(cells) / cells.mean()), 0.005)
    real = "digitised K-Radar frame"
    yield near("level of the floor, dB", real, 109.1, float(10 * np.log10(cells.mean())), 0.05, 2)
    yield near("floor of the range-azimuth map, std dB", real, 0.30, floor, 0.05)
    missed = abs(control - 0.3) > 0.05
    yield Row("control: independent cells must miss it", real, "not 0.300 +- 0.050", f"{control:.3f}", missed)
    yield between("correlation of beams 1 degree apart", "elevation beam of 9 degrees", 0.9, 1.0, float(lag[0]))
    yield between("correlation of beams 18 degrees apart", "elevation beam of 9 degrees", -0.35, 0.35, float(lag[1]))


def doppler() -> Rows:
    axes = QUIET.axes
    yield near("velocity span, m/s", "64 bins of K-Radar's arr_doppler", 3.8652, float(axes.velocity_span_m_s), 1e-4, 4)
    bins = [int(doppler_spectrum(0.72 + folds * axes.velocity_span_m_s, QUIET).argmax()) for folds in (0, 1, -2)]
    yield Row("bins of v, v + span, v - 2 span", "sampling theorem", "equal", str(bins), len(set(bins)) == 1)
    world = float(axes.doppler_m_s[doppler_spectrum(-100 / 3.6, QUIET).argmax()])
    half_bin = float(axes.doppler_step_m_s / 2)
    yield near("standing world at 100 km/h, m/s", "-27.778 + 7 x 3.8652", -27.7778 + 7 * 3.8652, world, half_bin)


def scan() -> Rows:
    def lines(pattern: str, count: int) -> np.ndarray:
        return line_elevations_deg(pattern, lines=count, edge_deg=15.0, focus_deg=-2.0, sigma_deg=5.0)

    fine = [lines(pattern, 6400) for pattern in PATTERNS]
    ratio = {at: np.divide(*((np.abs(e - at) < 0.25).sum() for e in fine)) for at in (-2.0, 4.6, -8.6)}
    normal = "density of a truncated normal"
    yield near("Gaussian over uniform lines at the focus", normal, 2.40, float(ratio[-2.0]), 0.05)
    for at, side in ((4.6, "above"), (-8.6, "below")):
        yield near(f"the same 6.6 degrees {side} it", normal, 1.0, float(ratio[at]), 0.05)
    coarse = lines("gaussian", 64)
    for reach, share in ((int(reach), float(share)) for reach, share in SHARES_NEAR_HORIZON.items()):
        got = float(np.mean(np.abs(coarse + 2.0) < reach))
        yield near(f"share of lines within {reach} degrees", "real Luminar frames .31/.69/.955", share, got, 0.02)
    uniform = lines("uniform", 64)
    step = np.diff(uniform)
    yield Row("lines of each pattern", "Cirrus paper", "64, 64", f"{len(coarse)}, {len(uniform)}", len(uniform) == 64)
    yield near("uniform spacing, degrees", "30 / 63", 30 / 63, float(step[np.abs(step - 30 / 63).argmax()]), 1e-4, 4)
    yield from ouster_rows("OS1-128", OS1_128_BEAMS, (20.95, -21.82, 128, 0.0158))
    yield from ouster_rows("OS2-128", OS2_128_BEAMS, (10.76, -11.09, 128, 0.0138))
    spacing = [float(-np.diff(beams.elevation_deg).mean()) for beams in (OS2_128_BEAMS, OS1_128_BEAMS)]
    calibrated = "calibrated unit (JSON), part of its rows"
    yield near("OS2 mean spacing, degrees", calibrated, (10.16 - 7.66) / 15, spacing[0], 0.006)
    yield near("OS1 spacing of every second row, degrees", calibrated, (5.89 - 0.98) / 7, 2 * spacing[1], 0.035)


def ouster_rows(name: str, beams: BeamTable, want: tuple[float, float, int, float]) -> Rows:
    got = (beams.elevation_deg[0], beams.elevation_deg[-1], len(beams.elevation_deg), beams.origin_m)
    yield Row(f"{name}: top, bottom, rows, origin", "published beam table", str(want), str(got), got == want)


def plane_error_m(rng: np.random.Generator) -> float:
    wall = quads(np.array([[[250.0, -99, -99], [250, 99, -99], [250, 99, 99], [250, -99, 99]]]), 0)
    directions = np.column_stack([np.ones(500), rng.uniform(-0.3, 0.3, (500, 2))])
    directions = (directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(np.float32)
    hits = Tracer(wall).cast(np.zeros(3), directions)
    return float(np.abs(hits.range_m.astype(np.float64) * directions[:, 0] - 250.0).max())


def sphere_error_m(rng: np.random.Generator) -> float:
    centre, radius = np.array([8.0, 1.0, -0.5]), 0.5
    aside = rng.standard_normal((2000, 3))
    target = centre + 0.35 * radius * aside / np.linalg.norm(aside, axis=1, keepdims=True)
    directions = (target / np.linalg.norm(target, axis=1, keepdims=True)).astype(np.float32)
    along = directions.astype(np.float64) @ centre
    exact = along - np.sqrt(radius**2 - (centre @ centre - along**2))
    mesh = ellipsoid(centre.tolist(), [radius] * 3, 0, sides=300, rows=220)
    return float(np.abs(Tracer(mesh).cast(np.zeros(3), directions).range_m - exact).max())


def box_error_m(rng: np.random.Generator) -> float:
    """Points of a whole sweep on a box against the slab method, in the box's frame; inf where the counts differ."""
    size = np.array([4.6, 1.9, 1.5])
    target = stage.body(stage.coloured(box(size.tolist(), [0, 0, 0], Material.SIGN), 50.0), 60, 9, -0.4, yaw_rad=0.7)
    model = stage.quiet(LUMINAR_H2, sub_rays=1)
    shots = Scan.draw(model, rng)
    cloud = sweep(shots, model, stage.frozen(target), stage.HERE, rng).cloud
    body_T_sensor = np.linalg.inv(target.world_T_body[0])
    directions = shots.directions.reshape(-1, 3).astype(np.float64) @ body_T_sensor[:3, :3].T
    planes = np.stack([(sign * size / 2 - body_T_sensor[:3, 3]) / directions for sign in (-1, 1)])
    enter, leave = planes.min(axis=0).max(axis=1), planes.max(axis=0).min(axis=1)
    exact, got = enter[enter < leave], np.linalg.norm(cloud.points_m.astype(np.float64), axis=1)
    return float(np.abs(got - exact).max()) if len(got) == len(exact) > 50 else np.inf


def points_on_rear(pattern: str, range_m: int, rng: np.random.Generator) -> float:
    """Mean number of shots at 1.85 x 1.5 m at the focus, over places and frames."""
    counts = []
    model, mesh = stage.quiet(LUMINAR_H2, jitter_deg=LUMINAR_H2.jitter_deg, sub_rays=1), stage.plate(50.0)
    scans = [Scan.draw(model, rng, pattern=pattern) for _ in range(4)]
    for index in range(range_m):
        z = np.tan(np.radians(-2.0)) * range_m + rng.uniform(-0.75, 0.75)
        window = stage.frozen(stage.body(mesh, range_m, rng.uniform(-3, 3), z))
        aimed = sweep(scans[index % 4], model, window, stage.HERE, rng).aimed
        counts.append(0 if aimed is None else int(aimed[0]))
    return float(np.mean(counts))


def geometry() -> Rows:
    rng = np.random.default_rng(SEED)
    yield below("plane at 250 m, largest error, m", "closed form", 1e-4, plane_error_m(rng))
    yield below("sphere, largest error, m", "quadratic formula", 1e-4, sphere_error_m(rng))
    yield below("turned box at 60 m, largest error, m", "slab method in float64", 1e-4, box_error_m(rng))
    for pattern in ("uniform", "gaussian"):
        for range_m, want in CAR_REAR[pattern].items():
            got = points_on_rear(pattern, range_m, rng)
            yield near(f"{pattern} points on a car's rear, {range_m} m", "solid angle", want, got, 0.1 * want, 2)


def cross_sections() -> Rows:
    model = RadarModel()
    effective_m2 = 0.1**2 / np.sqrt(3)  # what a trihedral of edge a shows on its axis
    want = 10 * np.log10(4 * np.pi * effective_m2**2 / model.wavelength_m**2)
    got = 10 * np.log10(corner_reflector_m2(0.1, model.wavelength_m))
    yield near("corner reflector, edge 0.1 m, dBsm", "4 pi A^2 / lambda^2, A = a^2 / sqrt 3", want, got, 0.01, 2)
    sides = vehicle_pattern_dbsm(np.radians([0.0, 180.0, 90.0, -90.0]))
    for side, level, found in zip(("front", "rear", "left", "right"), (15.5, 14.6, 20.75, 20.75), sides, strict=True):
        yield near(f"car from its {side}, dBsm", "3GPP TR 38.901, 7.9.2.1", level, float(found), 0.05, 2)
    range_m, peaks = radar_peaks_db()
    what, fall = f"10 m2 at {range_m[2]:.2f} m, synthesised, dB", float(-40 * np.log10(range_m[3] / range_m[2]))
    yield near(what, "SNR_0, from the real frame", 30.0, float(peaks[2]), 0.7, 2)
    yield near("from 50 to 100 m, dB", "R^-4", fall, float(peaks[3] - peaks[2]), 0.3, 2)
    film = film_loss_db(0.1, water_permittivity(76.5, 0.0), 76.5e9)
    yield near("0.1 mm of water at 0 C, one way, dB", "transfer matrix, apart", 5.0, film, 0.3, 2)


def radar_change_db(condition: str, *metres: float) -> float:
    """Greatest change of a target's signal over noise at some ranges, over 40 draws of a weather."""
    model, rng, range_m = RadarModel(), np.random.default_rng(SEED), np.array(metres)
    clear = two_way_loss_db(range_m, Weather(), model)
    drawn = (two_way_loss_db(range_m, draw_weather(condition, "day", rng), model, time_s=60.0) for _ in range(40))
    return float(max(np.abs(loss - clear).max() for loss in drawn))


def snow_albedo(model: LidarModel) -> float:
    """Albedo that the median return from snow on the road shows within 12 m."""
    window = stage.patch_of_road(Material.ASPHALT, reflectance=0.18)
    still = stage.quiet(model, sub_rays=1)
    white, dry = (sweep_in(still, window, w).cloud for w in (Weather("light_snow", snow_cover=1.0), None))
    near_by = [cloud[np.hypot(cloud.points_m[:, 0], cloud.points_m[:, 1]) < 12] for cloud in (white, dry)]
    x, y, z = near_by[1].points_m.T.astype(np.float64)
    cosine = -z / np.sqrt(x**2 + y**2 + z**2)
    return float(np.median(near_by[0].intensity / (0.9 * cosine + 0.1)))  # snow's law of the angle


def weather() -> Rows:
    hits = {}
    window = stage.fleet(np.random.default_rng(SEED))
    for name, air in AIRS.items():
        hits[name] = int((sweep_in(OS2_64, window, air, window_seed=np.random.SeedSequence(9)).actor >= 0).sum())
    groups = (("normal",), ("rain", "light_snow"), ("fog",), ("heavy_snow", "sleet"))
    falls = all(min(hits[n] for n in more) > max(hits[n] for n in less) for more, less in pairwise(groups))
    shown = ", ".join(f"{name} {hits[name]}" for group in groups for name in group)
    yield Row("OS2 hits on 160 cars, 20 to 70 m", "order by extinction and ice", "falls in groups", shown, falls)
    claim = "K-Radar's claim; here ITU and a thin film"
    for condition in WEATHERS:
        got = radar_change_db(condition, 20.0, 50.0, 70.0)
        yield below(f"radar SNR change in {condition}, to 70 m, dB", claim, 3.0, got)
    far = f"{radar_change_db('rain', 100.0):.2f}"
    yield Row("the same in rain at 100 m, dB", "to 70 m is our choice", "-", far, None)
    grains = "Mie + asymptotic theory"
    yield between("snow on the ground, albedo at 1550 nm", grains, 0.10, 0.16, snow_albedo(LUMINAR_H2))
    yield between("snow on the ground, albedo at 865 nm", grains, 0.70, 0.95, snow_albedo(OS2_64))
    yield from detectors()
    yield from radar_detectors()


def recorded(script: str) -> dict[str, str]:
    """The sections of what another benchmark printed."""
    path = RESULTS / f"{script}.txt"
    return sections(path) if path.exists() else {}


def overall_dds(text: str) -> dict[tuple[str, str], float]:
    """DDS by (trained on, tested on) from a table of ``detectors.py simulated``."""
    found = {}
    for section in text.split("\n\n"):
        trained = re.search(r"trained on \[(.*)\]", section)
        for cloud, block in re.findall(r"^ (\w+): .*\n((?:  .*\n?)+)", section, re.MULTILINE) if trained else ():
            overall = re.search(r"^  overall +(?:[\d.]+ +){4}[\d.]+ +([\d.]+)", block, re.MULTILINE)
            if trained and overall:
                found[trained[1].replace("'", ""), cloud] = float(overall[1])
    return found


def detectors() -> Rows:
    """What trained detectors show: one seed, not the sign test over three that a full proof needs."""
    dds = overall_dds(recorded("detectors").get(FIRST, ""))
    one = "detectors.txt, one seed"
    for what, better, worse, published in (
        ("DDS, G over U, each its own detector", ("gaussian",) * 2, ("uniform",) * 2, "> 0 (Cirrus +.077)"),
        ("DDS, U's own over G -> U", ("uniform",) * 2, ("gaussian", "uniform"), "> 0 (Cirrus +.018)"),
        ("DDS, G's own over U -> G", ("gaussian",) * 2, ("uniform", "gaussian"), "- (Cirrus +.093)"),
    ):
        if better in dds and worse in dds:
            got = dds[better] - dds[worse]
            text = f"{dds[better]:.3f} - {dds[worse]:.3f} = {got:+.3f}"
            yield Row(what, one, published, text, got > 0 if published.startswith(">") else None)
        else:
            yield Row(what, one, published, "no such run in the file", None)


def radar_detectors() -> Rows:
    """How far RTNH lies above PointPillars on the os2-64, by weather: a verdict where the interval leaves 0 out."""
    title = "rtnh-kradar-sim above pointpillars-kradar-sim"
    for weather_name, sign in (("normal", -1), ("sleet", 1), ("heavy_snow", 1)):
        section = "weathers" if sign < 0 else weather_name.replace("_", " ")
        text, name = recorded("radar_detectors").get(section, ""), f"radar_detectors.txt, {section}"
        found = re.search(rf"^{title}\n(?:  .+\n)*?  {weather_name} +(\S+) \[(\S+), (\S+)\]$", text, re.MULTILINE)
        what = f"AP_3d, trained radar over LiDAR, {weather_name}"
        expected = "> 0; icing is an input" if sign > 0 else "< 0"
        if found is None:
            yield Row(what, name, expected, "no such runs in the file", None)
            continue
        low, high = sorted(sign * float(end) for end in found.groups()[1:])
        verdict = True if low > 0 else False if high < 0 else None
        yield Row(what, f"{name}, one seed", expected, "{} [{}, {}]".format(*found.groups()), verdict)


TESTS: dict[int, tuple[str, Callable[[], Rows]]] = {
    1: ("Range equation", range_equation),
    2: ("LiDAR reference ranges", lidar_reference),
    3: ("Koschmieder", koschmieder),
    4: ("ITU-R P.838-3", recommendations),
    5: ("Rain and fog", rain_and_fog),
    6: ("Point spread", point_spread),
    7: ("Noise", noise),
    8: ("Doppler", doppler),
    9: ("Scan", scan),
    10: ("Geometry", geometry),
    11: ("Radar cross sections", cross_sections),
    12: ("Weather", weather),
}


def run_validation(arguments: Sequence[str]) -> int:
    """Twelve validation tests of the simulator: every figure beside an independent reference, with its tolerance.

        python benchmarks/validation.py [--only 6 7]

    Scenes and the brute-force radar are those of _validation_scenes.py; docs/validation.md says what is
    independent and what is assumed. Exit status 1 where a figure misses its tolerance. Rows marked "shown" carry no
    verdict.
    """
    parser = part_parser(run_validation.__doc__)
    parser.add_argument("--only", type=int, nargs="*", choices=TESTS, help="numbers of the tests to run")
    options = parser.parse_args(arguments)
    print("no  verdict  figure, its independent reference, expected value and tolerance, measured")
    verdicts = []
    for number in options.only or TESTS:
        title, rows = TESTS[number]
        print(f"\n{number}. {title}")
        for row in rows():
            verdicts.append(row.ok)
            verdict = {True: "pass", False: "FAIL", None: "shown"}[row.ok]
            what = f"{number:>2}  {verdict:<5} {row.what:<49} {row.reference:<44}"
            print(f"{what} {row.expected:<22} {row.measured}", flush=True)
    passed, failed = verdicts.count(True), verdicts.count(False)
    print(f"\n{passed} figures pass, {failed} fail, {verdicts.count(None)} are shown without a verdict.")
    return int(failed > 0)


if __name__ == "__main__":
    raise SystemExit(
        run_parts(
            __doc__,
            {
                "validation": Part(run_validation, "--only 1 2 3 4", exact=True),
            },
        )
    )

"""Radar cross sections at 77 GHz: of road users by class and aspect, of surfaces by material and grazing angle."""

import numpy as np
from jaxtyping import Float, Int

from farfield.simulation.bodies.actors import Actor
from farfield.simulation.bodies.materials import Material
from farfield.simulation.weather.conditions import Weather

# 3GPP TR 38.901, table 7.9.2.1 (vehicle): direction, greatest value in dBsm, 3 dB angle in degrees, greatest fall.
_VEHICLE_LOBES = (
    (0.0, 15.5, 40.5, 8.45),
    (90.0, 20.75, 26.9, 13.7),
    (180.0, 14.6, 36.3, 7.5),
    (270.0, 20.75, 26.9, 13.7),
)
_VEHICLE_STD_DB = 3.41
# Class: mean in dBsm and deviation in dB. Pedestrian and motorcycle: customary at 77 GHz; animal and others: defaults.
_CLASS_DB = {
    "pedestrian": (-6.0, 4.0),
    "wheeled_pedestrian": (-3.0, 4.0),
    "motorcycle": (2.0, 4.0),
    "animal": (-10.0, 4.0),
    "unknown": (-5.0, 5.0),
}
# Bicycle and rider: ten points of -11.6 (front, rear), -13.2 (oblique), -8.1 dBsm (side), Belgiovane and Chen 2017.
_BICYCLE_DEG = (0.0, 45.0, 90.0, 135.0, 180.0)
_BICYCLE_DB = (-1.6, -3.2, 1.9, -3.2, -1.6)
_CAR_FACE_M2 = 4.6 * 1.5

# Diffuse level at 10 degrees grazing in dB, its power law over the grazing angle, power reflectivity and rms slope of
# the specular part. Asphalt: -30 dB at 2 and -20 dB at 10 degrees; vegetation -12 dB; snow -17 dB (customary
# figures, not checked against measurements). The others are defaults.
_DEFAULT = (-15.0, 1.0, 0.1, 0.1)
_SURFACE_FIGURES = {
    Material.ASPHALT: (-20.0, 1.43, 0.15, 0.10),
    Material.LANE_PAINT: (-20.0, 1.43, 0.15, 0.10),
    Material.CONCRETE: (-20.0, 1.43, 0.20, 0.06),
    Material.BRICK: (-17.0, 1.0, 0.20, 0.06),
    Material.GRASS: (-12.0, 1.0, 0.0, 0.3),
    Material.SOIL: (-15.0, 1.0, 0.05, 0.2),
    Material.FOLIAGE: (-12.0, 0.5, 0.0, 0.3),
    Material.BARK: (-10.0, 0.5, 0.1, 0.3),
    Material.METAL: (-10.0, 0.5, 1.0, 0.15),
    Material.SIGN: (-12.0, 0.5, 1.0, 0.20),
    Material.GLASS: (-25.0, 1.0, 0.3, 0.04),
}
_SNOW = (-17.0, 0.5, 0.0, 0.3)
_WET_DB = -5.0
_GROUND = (Material.ASPHALT, Material.LANE_PAINT, Material.CONCRETE, Material.GRASS, Material.SOIL)
# How strongly a part of a road user scatters beside its bodywork; defaults.
_SHARE = {
    Material.METAL: 2.0, Material.PLATE: 2.0, Material.GLASS: 0.3, Material.TYRE: 0.2, Material.TRIM: 0.5,
    Material.CLOTH: 0.5, Material.SKIN: 0.7,
}  # fmt: skip


def corner_reflector_m2(edge_m: float, wavelength_m: float) -> float:
    """Trihedral corner reflector on its axis: 4 pi a^4 / (3 lambda^2), a its inner edge."""
    return 4 * np.pi * edge_m**4 / (3 * wavelength_m**2)


def vehicle_pattern_dbsm(aspect_rad: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Mean cross section of a car seen level: 3GPP TR 38.901, G - min(12 (d / d_3dB)^2, greatest fall), best lobe.

    Args:
        aspect_rad: Direction towards the radar in the car's frame: 0 from the front, pi / 2 from its left.
    """
    aspect = np.degrees(aspect_rad)
    lobes = []
    for centre, peak, width, fall in _VEHICLE_LOBES:
        off = np.abs((aspect - centre + 180.0) % 360.0 - 180.0)
        lobes.append(peak - np.minimum(12.0 * (off / width) ** 2, fall))
    return np.asarray(np.max(lobes, axis=0))


def near_range_dbsm(range_m: Float[np.ndarray, "*n"] | float) -> Float[np.ndarray, "*n"]:
    """Most that a car gives at a range: min(10 log10 R + 5, 20), for it is lit in part only (Kaernfelt 2009)."""
    return np.asarray(np.minimum(10 * np.log10(np.maximum(range_m, 1.0)) + 5.0, 20.0))


def mean_rcs_dbsm(actor: Actor, aspect_rad: float, range_m: float) -> float:
    """Mean cross section of a road user in dBsm.

    Larger bodies than a car (trucks, buses, trailers) gain with their side's area, up to 10 dB; a car's pattern is
    lowered by at most its near-range law.

    Args:
        actor: The road user.
        aspect_rad: Direction towards the radar in its frame.
        range_m: Its distance.
    """
    label = actor.label
    if label in ("vehicle", "large_vehicle", "trailer"):
        length, _, height = actor.size_m
        larger = 0.0 if label == "vehicle" else float(np.clip(10 * np.log10(length * height / _CAR_FACE_M2), 0.0, 10.0))
        pattern = float(vehicle_pattern_dbsm(np.array(aspect_rad)))
        return larger + min(pattern, float(near_range_dbsm(np.array(range_m))))
    if label == "bicycle":
        off = abs((np.degrees(aspect_rad) + 180.0) % 360.0 - 180.0)
        return float(np.interp(off, _BICYCLE_DEG, _BICYCLE_DB))
    return _CLASS_DB.get(label, _CLASS_DB["unknown"])[0]


def rcs_std_db(label: str) -> float:
    """Standard deviation of a class's cross section between individuals, in dB."""
    if label in ("large_vehicle", "trailer"):
        return 4.0
    if label == "bicycle":
        return 3.0
    return _VEHICLE_STD_DB if label == "vehicle" else _CLASS_DB.get(label, _CLASS_DB["unknown"])[1]


def slow_db(actor: Actor) -> float:
    """How far one individual stands off its class's mean, in dB: log-normal, kept all through a sequence."""
    seed = actor.seed
    seed_of_level = np.random.SeedSequence(entropy=seed.entropy, spawn_key=(*seed.spawn_key, 0x5241))
    return float(np.random.default_rng(seed_of_level).normal(0.0, rcs_std_db(actor.label)))


def part_share(material: Int[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """How strongly faces of these materials scatter beside bodywork; 1 for materials without a figure."""
    table = np.ones(max(len(Material), int(material.max(initial=0)) + 1))
    for part, share in _SHARE.items():
        table[part] = share
    return np.asarray(table[material])


def surface_rcs_m2_m2(
    material: Int[np.ndarray, " n"], cosine: Float[np.ndarray, " n"], weather: Weather
) -> Float[np.ndarray, " n"]:
    """Cross section of a surface's unit area: a diffuse part and Kirchhoff's specular part of a rough surface.

    Diffuse: level (grazing / 10 degrees)^power. Specular: R^2 sec^4 t exp(-tan^2 t / (2 s^2)) / (2 s^2) (Barrick 1968),
    t the angle of incidence. Water on the road lowers the road's diffuse part by 5 dB; snow replaces its share of the
    ground.

    Args:
        material: Materials, shape (n,); unknown ones get a default.
        cosine: Cosine of the angle of incidence, shape (n,).
        weather: Wet or snow-covered ground.
    """
    table = np.array([_SURFACE_FIGURES.get(Material(m), _DEFAULT) for m in Material])
    row = np.clip(material, 0, len(table) - 1)
    ground = np.isin(material, _GROUND)
    dry = _rough(table[row], cosine)
    if weather.water_mm > 0:
        wet = table.copy()
        wet[:, 0] += _WET_DB
        dry = np.where(ground & (material != Material.GRASS), _rough(wet[row], cosine), dry)
    snow = np.where(ground, weather.snow_cover, 0.0)
    return np.asarray((1 - snow) * dry + snow * _rough(np.array([_SNOW]), cosine))


def _rough(figures: Float[np.ndarray, "k 4"], cosine: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    level_db, power, reflectivity, slope = figures.T
    cos = np.clip(cosine, 1e-3, 1.0)
    grazing_deg = np.degrees(np.arcsin(cos))
    diffuse = np.minimum(10 ** (level_db / 10) * (grazing_deg / 10.0) ** power, 1.0)
    tan2 = 1.0 / cos**2 - 1.0
    specular = reflectivity / (2 * slope**2) / cos**4 * np.exp(-tan2 / (2 * slope**2))
    return np.asarray(diffuse + specular)

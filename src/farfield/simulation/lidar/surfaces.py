"""What the rays hit, as the sensor sees it in this weather: reflectances, wet roads, snow on the ground.

A film of water over a rough road: light enters through the air-water surface (Fresnel), the road below scatters it,
part of that is reflected back down (all of it beyond 48.6 degrees) and scattered again, the rest leaves upwards:

    rho_wet(theta) = t(theta) (t(theta) / n^2) A rho / (1 - r rho),    r = 1 - (1 - r_d) / n^2,

with t(theta) = 1 - F(theta), r_d = 0.066 the diffuse Fresnel reflectance of water from outside, and A the absorption
along the way down and up. What F takes goes forward, away from the sensor: flat looks see a dark road.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float, Float32, Int, Int32
from scipy.ndimage import gaussian_filter

from farfield.simulation.bodies.materials import SURFACES, Material, reflectance_at
from farfield.simulation.lidar.echoes import SurfaceReflectance
from farfield.simulation.lidar.model import LidarModel
from farfield.simulation.lidar.rays import NearestHits
from farfield.simulation.trace import Body
from farfield.simulation.weather.conditions import Weather
from farfield.simulation.weather.optics import is_short_wave

# Wet and snow-covered ground

GROUND = frozenset(
    {Material.ASPHALT, Material.CONCRETE, Material.LANE_PAINT, Material.GRASS, Material.SOIL, Material.SNOW}
)
ROAD = frozenset({Material.ASPHALT, Material.LANE_PAINT, Material.CONCRETE})
_WATER_INDEX = 1.33
_DIFFUSE_REFLECTANCE = 0.066
_TEXTURE_MM = 1.2  # depth of the road's texture: so much water covers it wholly
_CELL_M, _CELLS = 0.25, 512
SNOW_GRADES = 5  # steps of brightness from patch to patch


def fresnel_reflectance(cosine: Float[np.ndarray, "*shape"], index: float) -> Float[np.ndarray, "*shape"]:
    """Reflectance of a smooth surface for unpolarised light from the air.

    Args:
        cosine: Cosine of the angle of incidence.
        index: Refractive index behind the surface.
    """
    inside = np.sqrt(1 - (1 - cosine**2) / index**2)
    across = ((cosine - index * inside) / (cosine + index * inside)) ** 2
    along = ((inside - index * cosine) / (inside + index * cosine)) ** 2
    return (across + along) / 2


def wet_reflectance(
    reflectance: Float[np.ndarray, "*shape"],
    cosine: Float[np.ndarray, "*shape"],
    water_mm: float,
    wavelength_nm: float,
) -> Float[np.ndarray, "*shape"]:
    """Diffuse reflectance of a wet road as a LiDAR sees it.

    Args:
        reflectance: The dry road's.
        cosine: Cosine of the angle of incidence.
        water_mm: Depth of the water.
        wavelength_nm: Wavelength.
    """
    enters = 1 - fresnel_reflectance(cosine, _WATER_INDEX)
    inside = np.sqrt(1 - (1 - cosine**2) / _WATER_INDEX**2)
    absorbed = np.exp(-2 * (8.0 if is_short_wave(wavelength_nm) else 800.0) * water_mm / 1000 / inside)
    back = 1 - (1 - _DIFFUSE_REFLECTANCE) / _WATER_INDEX**2
    under = enters**2 / _WATER_INDEX**2 * absorbed * reflectance / (1 - back * reflectance)
    share = min(max(water_mm / _TEXTURE_MM, 0.0), 1.0)
    return (1 - share) * reflectance + share * under


def wet_factor(water_mm: float, wavelength_nm: float, *, steps: int = 256) -> Float32[np.ndarray, " steps"]:
    """Wet over dry reflectance of asphalt for cosines from 0 to 1 in even steps."""
    asphalt = np.full(steps, 0.15)
    wet = wet_reflectance(asphalt, np.linspace(0.0, 1.0, steps), water_mm, wavelength_nm)
    return (wet / asphalt).astype(np.float32)


@cache
def _tiles() -> Float32[np.ndarray, "2 cells cells"]:
    """Two smooth patterns of the ground that repeat every 128 m; each value in [0, 1) is equally frequent."""
    white = np.random.default_rng(20_260_101).standard_normal((2, _CELLS, _CELLS))
    tiles = []
    for layer, width_m in zip(white, (1.5, 0.4), strict=True):
        smooth = gaussian_filter(layer, width_m / _CELL_M, mode="wrap")
        tiles.append(np.argsort(np.argsort(smooth, axis=None)).reshape(smooth.shape) / smooth.size)
    return np.stack(tiles).astype(np.float32)


def snow_grades(
    x_m: Float[np.ndarray, " n"], y_m: Float[np.ndarray, " n"], share: Float[np.ndarray, " n"]
) -> Int[np.ndarray, " n"]:
    """How bright the snow at places of the world is: 0 to ``SNOW_GRADES`` - 1, or -1 where there is none.

    Args:
        x_m: World coordinates.
        y_m: World coordinates.
        share: Share of the ground around each place that snow covers.
    """
    column = np.floor(x_m / _CELL_M).astype(np.int64) % _CELLS
    row = np.floor(y_m / _CELL_M).astype(np.int64) % _CELLS
    cover, grade = _tiles()[:, row, column]
    return np.where(cover < share, (grade * SNOW_GRADES).astype(np.int64), -1)


def grade_factor() -> Float[np.ndarray, " grades"]:
    """Brightness of each grade of snow beside its mean: crusts, tracks and fresh snow differ by 15 %."""
    return np.linspace(0.85, 1.15, SNOW_GRADES)


_LEAST_WATER_MM = 0.02


@dataclass(frozen=True, eq=False)
class Surfaces:
    """The hits of all rays with what they look like.

    Args:
        face: Triangle of each ray's hit, an index of the tables, shape (rays, shots); -1 for none.
        reflectance: What every triangle sends back.
        actor: Road user that it belongs to, or -1.
        wet: Factor of each ray's signal by water on the road, shape (rays, shots); None where all is dry.
    """

    face: Int32[np.ndarray, "rays shots"]
    reflectance: SurfaceReflectance
    actor: Int[np.ndarray, " faces"]
    wet: Float32[np.ndarray, "rays shots"] | None

    @classmethod
    def of(cls, casting: NearestHits, model: LidarModel, weather: Weather) -> "Surfaces":
        """Look up what was hit, and cover the ground with water or snow.

        Args:
            casting: The hits.
            model: The sensor; its wavelength decides what is bright.
            weather: What lies on the ground.
        """
        material = _with_snow(casting.table(lambda body: body.tracer.mesh.material, -1), int(Material.SNOW))
        reflectance = _with_snow(casting.table(lambda body: body.tracer.mesh.reflectance, 0.0), 0.0)
        reflectance[-1 - SNOW_GRADES : -1] = SURFACES[Material.SNOW].reflectance * grade_factor()
        bright = reflectance_at(material, reflectance, model.wavelength_nm).astype(np.float32)
        actor = _with_snow(casting.table(lambda body: np.full(len(body.tracer.mesh.faces), body.actor), -1), -1)
        face, wet = casting.face, None
        if weather.snow_cover > 0 or weather.water_mm > _LEAST_WATER_MM:
            ground = _with_snow(casting.table(_is_ground, False), False)
            if weather.snow_cover > 0:
                face = _snowed(casting, ground, material, weather.snow_cover)
            if weather.water_mm > _LEAST_WATER_MM:
                factor = wet_factor(weather.water_mm, model.wavelength_nm)
                step = np.minimum(casting.cosine * (len(factor) - 1), len(factor) - 1).astype(np.int16)
                wet = np.where(ground[face], factor[step], np.float32(1))
        return cls(face, SurfaceReflectance.of(material, bright), actor, wet)


def _with_snow(table: np.ndarray, value: float | int) -> np.ndarray:
    """Put the grades of snow before a table's last entry, which stands for no hit."""
    return np.insert(table, len(table) - 1, [value] * SNOW_GRADES)


def _is_ground(body: Body) -> np.ndarray:
    """Which triangles of a body water and snow lie on."""
    if body.actor >= 0:
        return np.zeros(len(body.tracer.mesh.faces), dtype=bool)
    return body.tracer.level & np.isin(body.tracer.mesh.material, [int(material) for material in GROUND])


def _snowed(
    casting: NearestHits, ground: np.ndarray, material: Int[np.ndarray, " faces"], cover: float
) -> Int32[np.ndarray, "rays shots"]:
    """Faces with those replaced by snow on which it lies; on roads it lies less, for traffic wears it."""
    face = casting.face.copy()
    shots = np.flatnonzero(ground[face[0]])
    places_m = casting.places_m(shots)
    road = np.isin(material[face[0, shots]], [int(item) for item in ROAD])
    grade = snow_grades(places_m[:, 0], places_m[:, 1], np.where(road, cover**1.5, cover))
    snowy = grade >= 0
    shots, snow = shots[snowy], (len(material) - 1 - SNOW_GRADES + grade[snowy]).astype(np.int32)
    for ray in range(len(face)):
        face[ray, shots] = np.where(ground[face[ray, shots]], snow, face[ray, shots])
    return face

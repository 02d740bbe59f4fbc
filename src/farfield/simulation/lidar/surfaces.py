"""What the rays hit, as the sensor sees it in this weather: reflectances, wet roads, snow on the ground."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int, Int32

from farfield.simulation.bodies.materials import SURFACES, Material, reflectance_at
from farfield.simulation.lidar.echoes import SurfaceReflectance
from farfield.simulation.lidar.model import LidarModel
from farfield.simulation.lidar.rays import NearestHits
from farfield.simulation.trace import Body
from farfield.simulation.weather.conditions import Weather
from farfield.simulation.weather.ground import GROUND, ROAD, SNOW_GRADES, grade_factor, snow_grades, wet_factor

_LEAST_WATER_MM = 0.02


@dataclass(frozen=True, eq=False)
class Surfaces:
    """The hits of all rays with what they look like.

    Args:
        face: Triangle of each ray's hit, an index of the tables, shape (rays, shots); -1 for none.
        looks: What every triangle sends back.
        actor: Road user that it belongs to, or -1.
        wet: Factor of each ray's signal by water on the road, shape (rays, shots); None where all is dry.
    """

    face: Int32[np.ndarray, "rays shots"]
    looks: SurfaceReflectance
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
        drawn = _with_snow(casting.table(lambda body: body.tracer.mesh.reflectance, 0.0), 0.0)
        drawn[-1 - SNOW_GRADES : -1] = SURFACES[Material.SNOW].reflectance * grade_factor()
        bright = reflectance_at(material, drawn, model.wavelength_nm).astype(np.float32)
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
    places = casting.places_m(shots)
    road = np.isin(material[face[0, shots]], [int(item) for item in ROAD])
    grade = snow_grades(places[:, 0], places[:, 1], np.where(road, cover**1.5, cover))
    snowy = grade >= 0
    shots, snow = shots[snowy], (len(material) - 1 - SNOW_GRADES + grade[snowy]).astype(np.int32)
    for ray in range(len(face)):
        face[ray, shots] = np.where(ground[face[ray, shots]], snow, face[ray, shots])
    return face

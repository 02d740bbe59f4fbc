"""Surface materials: diffuse reflectance at 1550 nm and below 1000 nm, spread between objects, roughness and gloss.

Meshes carry reflectances at 1550 nm; :func:`reflectance_at` converts them for sensors at 865 or 905 nm. Reflectances of
asphalt, paint, vegetation and cloth are customary figures, not measurements of one data set. Snow (0.12 at 1550 nm,
0.85 at 865 nm) is what Mie and asymptotic theory give for grains of 50 to 500 um.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from jaxtyping import Float, Int

from farfield.errors import ConfigError


class Material(IntEnum):
    """What a triangle is made of."""

    ASPHALT = 0
    CONCRETE = 1
    LANE_PAINT = 2
    GRASS = 3
    SOIL = 4
    CAR_PAINT = 5
    TYRE = 6
    GLASS = 7
    LAMP = 8
    PLATE = 9
    CLOTH = 10
    SKIN = 11
    METAL = 12
    BRICK = 13
    FOLIAGE = 14
    SIGN = 15
    TRIM = 16
    CARGO = 17
    BARK = 18
    SNOW = 19


@dataclass(frozen=True)
class Surface:
    """Optical figures of one material.

    Args:
        reflectance: Median diffuse reflectance; retro-reflective films exceed 1.
        spread: Standard deviation of the logarithm of the reflectance between objects.
        backscatter: Share of the diffuse reflectance that a rough surface sends straight back at grazing incidence
            (the sin^2 term of Oren and Nayar, 1994).
        gloss: Extra return at normal incidence, falling off as cos^20.
        near_infrared: Median diffuse reflectance from 800 to 1000 nm (default: the same as at 1550 nm).
    """

    reflectance: float
    spread: float = 0.1
    backscatter: float = 0.0
    gloss: float = 0.0
    near_infrared: float | None = None


SURFACES: dict[Material, Surface] = {
    Material.ASPHALT: Surface(0.18, 0.15, 0.03, near_infrared=0.12),
    Material.CONCRETE: Surface(0.35, 0.15, 0.03, near_infrared=0.30),
    Material.LANE_PAINT: Surface(0.45, 0.25, 0.10, near_infrared=0.55),
    Material.GRASS: Surface(0.30, 0.15, 0.12, near_infrared=0.55),
    Material.SOIL: Surface(0.30, 0.15, 0.08, near_infrared=0.22),
    Material.CAR_PAINT: Surface(0.25, 0.70, 0.0, 0.25),
    Material.TYRE: Surface(0.04, 0.15),
    Material.GLASS: Surface(0.05, 0.10),
    Material.LAMP: Surface(2.0, 0.40),
    Material.PLATE: Surface(8.0, 0.40),
    Material.CLOTH: Surface(0.25, 0.40, 0.05, near_infrared=0.45),
    Material.SKIN: Surface(0.25, 0.10, near_infrared=0.45),
    Material.METAL: Surface(0.40, 0.20, 0.0, 0.30),
    Material.BRICK: Surface(0.30, 0.25, 0.03, near_infrared=0.28),
    Material.FOLIAGE: Surface(0.30, 0.20, 0.10, near_infrared=0.55),
    Material.SIGN: Surface(20.0, 0.30),
    Material.TRIM: Surface(0.06, 0.30),
    Material.CARGO: Surface(0.40, 0.45, 0.0, 0.10),
    Material.BARK: Surface(0.25, 0.20, 0.05),
    Material.SNOW: Surface(0.12, 0.10, 0.10, near_infrared=0.85),
}

_MEDIAN = np.array([SURFACES[material].reflectance for material in Material])
_SPREAD = np.array([SURFACES[material].spread for material in Material])
BACKSCATTER = np.array([SURFACES[material].backscatter for material in Material])
GLOSS = np.array([SURFACES[material].gloss for material in Material])
NEAR_INFRARED_RATIO = np.array(
    [
        (SURFACES[material].near_infrared or SURFACES[material].reflectance) / SURFACES[material].reflectance
        for material in Material
    ]
)


def reflectance_at(
    material: Int[np.ndarray, " f"], reflectance_1550: Float[np.ndarray, " f"], wavelength_nm: float | int
) -> Float[np.ndarray, " f"]:
    """Reflectances at a sensor's wavelength.

    Each is scaled by the ratio of its material's medians, so that a dark asphalt stays a dark one. The table knows two
    bands: 800 to 1000 nm (865 and 905 nm sensors) and 1500 to 1600 nm.

    Args:
        material: Materials, shape (f,).
        reflectance_1550: Diffuse reflectances at 1550 nm, shape (f,).
        wavelength_nm: The sensor's wavelength.

    Raises:
        ConfigError: If the wavelength lies in neither band.
    """
    if 1500 <= wavelength_nm <= 1600:
        return reflectance_1550
    if not 800 <= wavelength_nm <= 1000:
        raise ConfigError(f"wavelength: expected 800 to 1000 nm or 1500 to 1600 nm; got {wavelength_nm:g} nm")
    scaled = reflectance_1550 * NEAR_INFRARED_RATIO[material]
    return np.where(reflectance_1550 <= 1.0, np.minimum(scaled, 1.0), scaled)


def draw_reflectance(material: Int[np.ndarray, " f"], rng: np.random.Generator) -> Float[np.ndarray, " f"]:
    """Reflectance of each face of one object: log-normal between objects, one value a material within it.

    Args:
        material: Material of each face, shape (f,).
        rng: Source of randomness; always draws the same count of numbers.

    Returns:
        Reflectances, shape (f,); diffuse ones are clipped to [0.03, 1].
    """
    reflectance = _MEDIAN * np.exp(_SPREAD * rng.standard_normal(len(_MEDIAN)))
    diffuse = _MEDIAN <= 1.0
    reflectance[diffuse] = np.clip(reflectance[diffuse], 0.03, 1.0)
    return reflectance[material]

"""From echoes to returns: detection, range noise, what is written of each return."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int, UInt16

from farfield.simulation.lidar.model import REFERENCE_REFLECTANCE, LidarModel, detection_probability, range_spread_m

_AMBIENT_COUNTS = 2000.0  # near-infrared counts of a white surface under a high sun
_SIGNAL_COUNTS = 40.0  # photon counts at the detection threshold


@dataclass(frozen=True, eq=False)
class Returns:
    """What was detected.

    Args:
        shot: Index of each shot that came back, rising.
        range_m: Its measured distance from the beam's origin.
        reflectance: What its strength and distance say the surface reflects; the weather's losses make it darker.
        strength: Its signal over the threshold.
    """

    shot: Int[np.ndarray, " n"]
    range_m: Float32[np.ndarray, " n"]
    reflectance: Float32[np.ndarray, " n"]
    strength: Float32[np.ndarray, " n"]


def measure(
    model: LidarModel,
    range_m: Float32[np.ndarray, " n"],
    strength: Float32[np.ndarray, " n"],
    rng: np.random.Generator,
) -> Returns:
    """Detect echoes: by chance after their strength, with dropout, range noise and texture.

    Args:
        model: The sensor.
        range_m: Distance of each shot's echo, shape (n,).
        strength: Its signal over the threshold, 0 for no echo.
        rng: Draws the same count of numbers whatever came back.
    """
    n = len(range_m)
    lucky, texture = rng.random(n, dtype=np.float32), rng.standard_normal(n, dtype=np.float32)
    noise = rng.standard_normal(n, dtype=np.float32)
    heard = np.flatnonzero(strength > 1e-3)
    chance = detection_probability(model, strength[heard]) * (1 - model.dropout)
    shot = heard[lucky[heard] < chance]
    power, distance = strength[shot], range_m[shot]
    noisy = distance + range_spread_m(model, power).astype(np.float32) * noise[shot]
    seen = np.float32(REFERENCE_REFLECTANCE / model.reference_range_m**2) * power * distance * distance
    seen *= np.exp(np.float32(model.texture) * texture[shot])
    return Returns(shot, noisy.astype(np.float32), seen.astype(np.float32), power)


def reflectivity(reflectance: Float32[np.ndarray, " n"]) -> UInt16[np.ndarray, " n"]:
    """Calibrated reflectivity: per cent up to 100 for surfaces that scatter, above it 31 steps a doubling to 255."""
    bright = 100 + 31 * np.log2(np.maximum(reflectance, 1.0))
    return np.round(np.where(reflectance <= 1, 100 * reflectance, np.minimum(bright, 255))).astype(np.uint16)


def signal_counts(strength: Float32[np.ndarray, " n"]) -> Float32[np.ndarray, " n"]:
    """Photon counts of the returns: proportional to the power received."""
    return np.minimum(np.float32(_SIGNAL_COUNTS) * strength, np.float32(65535)).round()


def ambient_counts(
    reflectance: Float32[np.ndarray, " n"], daylight: float, rng: np.random.Generator
) -> UInt16[np.ndarray, " n"]:
    """Near-infrared counts of the surroundings: sunlight reflected by the surface, with shot noise.

    Args:
        reflectance: Diffuse reflectance at the sensor's wavelength.
        daylight: Illumination, 0 (night) to 1 (the sun overhead).
        rng: Source of the noise.
    """
    mean = 8 + _AMBIENT_COUNTS * daylight * np.minimum(reflectance, 1.0)
    noisy = mean + np.sqrt(mean) * rng.standard_normal(len(reflectance))
    return np.clip(np.round(noisy), 0, 65535).astype(np.uint16)

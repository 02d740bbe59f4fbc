"""From the hits of a beam's rays to its strongest echo, of hits too close to tell apart, and to what is detected."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int, Int32, UInt16

from farfield.simulation.bodies.materials import BACKSCATTER, GLOSS
from farfield.simulation.lidar.model import REFERENCE_REFLECTANCE, LidarModel, detection_probability, range_spread_m

_CHUNK = 32_768


@dataclass(frozen=True, eq=False)
class SurfaceReflectance:
    """What every triangle sends back: ``diffuse * cos + rough + gloss * cos^20``, at index -1 nothing.

    The values are reflectances at the sensor's wavelength.
    """

    diffuse: Float32[np.ndarray, " f"]
    rough: Float32[np.ndarray, " f"]
    gloss: Float32[np.ndarray, " f"]

    @classmethod
    def of(cls, material: Int[np.ndarray, " f"], reflectance: Float32[np.ndarray, " f"]) -> "SurfaceReflectance":
        """From materials and reflectances; reflectance 0 and material -1 stand for nothing."""
        rough = BACKSCATTER.astype(np.float32)[material]
        gloss = np.where(material >= 0, GLOSS[material], 0.0).astype(np.float32)
        return cls(reflectance * (1 - rough), reflectance * rough, gloss)

    def effective(
        self, face: Int32[np.ndarray, "rays n"], cosine: Float32[np.ndarray, "rays n"]
    ) -> Float32[np.ndarray, "rays n"]:
        """Effective reflectance of hits."""
        power = cosine * cosine  # to the 20th
        power *= power
        lobe = power * power
        lobe *= lobe
        lobe *= power
        lobe *= self.gloss[face]
        lobe += self.rough[face]
        lobe += self.diffuse[face] * cosine
        return lobe


@dataclass(frozen=True, eq=False)
class LidarEchoes:
    """The strongest echo of every shot.

    Args:
        range_m: Its distance; 0 where there is none, shape (n,).
        strength: Its signal over the threshold; 0 where there is none.
        ray: The ray that gave most of it.
    """

    range_m: Float32[np.ndarray, " n"]
    strength: Float32[np.ndarray, " n"]
    ray: Int[np.ndarray, " n"]


def strongest(
    model: LidarModel, range_m: Float32[np.ndarray, "rays n"], power: Float32[np.ndarray, "rays n"]
) -> LidarEchoes:
    """Merge the hits of each beam's rays into echoes and keep the strongest one.

    Hits closer to the next than ``model.merge_m`` make one echo: their powers add up, and its range is their mean
    weighted by power (a mixed pixel where they lie on different things).

    Args:
        model: The sensor.
        range_m: Distance of each ray's hit, shape (rays, n).
        power: Its signal over the threshold, the ray's weight included; 0 for none.
    """
    has_power = power > 0
    at = np.where(has_power, range_m, np.float32(0))
    total = power.sum(axis=0)
    mean = (power * at).sum(axis=0) / np.maximum(total, np.float32(1e-30))
    near = np.where(has_power, range_m, np.float32(np.inf)).min(axis=0)
    ray = np.zeros(len(total), dtype=np.int64)
    best = power[0].copy()
    for other in range(1, len(power)):
        better = power[other] > best
        np.copyto(ray, other, where=better)
        np.maximum(best, power[other], out=best)
    apart = np.flatnonzero(at.max(axis=0) - near > model.merge_m)
    if apart.size:
        mean[apart], total[apart], ray[apart] = _apart(model, at[:, apart], power[:, apart])
    return LidarEchoes(mean, total, ray)


def _apart(
    model: LidarModel, at_m: Float32[np.ndarray, "rays n"], power: Float32[np.ndarray, "rays n"]
) -> tuple[Float32[np.ndarray, " n"], Float32[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """The strongest group of neighbouring hits of each shot: range, power and strongest ray."""
    order = np.argsort(at_m, axis=0, kind="stable")  # rays that hit nothing (0 m) come first, without power
    at_m, power = np.take_along_axis(at_m, order, 0), np.take_along_axis(power, order, 0)
    group = np.zeros(at_m.shape, dtype=np.int8)
    np.cumsum(np.diff(at_m, axis=0) > model.merge_m, axis=0, out=group[1:])
    total, mean = np.zeros(at_m.shape[1], dtype=np.float32), np.zeros(at_m.shape[1], dtype=np.float32)
    ray = np.zeros(at_m.shape[1], dtype=np.int64)
    for number in range(len(at_m)):
        share = np.where(group == number, power, np.float32(0))
        sums = share.sum(axis=0)
        louder = sums > total
        weighted = (share * at_m).sum(axis=0) / np.maximum(sums, np.float32(1e-30))
        total, mean = np.where(louder, sums, total), np.where(louder, weighted, mean)
        loudest = np.take_along_axis(order, share.argmax(axis=0)[None], 0)[0]
        ray = np.where(louder, loudest, ray)
    return mean, total, ray


def surface_echoes(
    model: LidarModel,
    surfaces: SurfaceReflectance,
    weights: Float32[np.ndarray, " rays"],
    range_m: Float32[np.ndarray, "rays n"],
    cosine: Float32[np.ndarray, "rays n"],
    face: Int32[np.ndarray, "rays n"],
    *,
    extinction_per_m: float = 0.0,
    gain: Float32[np.ndarray, " n"] | Float32[np.ndarray, "rays n"] | None = None,
) -> LidarEchoes:
    """The strongest echo from surfaces, of each shot.

    Args:
        model: The sensor.
        surfaces: What every triangle sends back.
        weights: Share of the power in each ray, shape (rays,).
        range_m: Distance of each ray's hit, inf for none, shape (rays, n).
        cosine: Cosine of the angle of incidence.
        face: Triangle, -1 for none.
        extinction_per_m: Extinction of the air.
        gain: Further factor on the signal of each shot or ray (window, spray, changed ground), or None.
    """
    n = range_m.shape[1]
    out = LidarEchoes(np.empty(n, dtype=np.float32), np.empty(n, dtype=np.float32), np.empty(n, dtype=np.int64))
    scale = (weights * np.float32(model.reference_range_m**2 / REFERENCE_REFLECTANCE))[:, None]
    for first in range(0, n, _CHUNK):
        part = slice(first, min(first + _CHUNK, n))
        distance = range_m[:, part]
        power = surfaces.effective(face[:, part], cosine[:, part])
        power *= scale
        power /= distance * distance
        if extinction_per_m:
            power *= np.exp(np.float32(-2 * extinction_per_m) * distance)
        if gain is not None:
            power *= gain[..., part]
        power *= (distance > model.min_range_m) & (distance < model.max_range_m)
        echo = strongest(model, distance, power)
        out.range_m[part], out.strength[part], out.ray[part] = echo.range_m, echo.strength, echo.ray
    return out


# From echoes to returns: detection, range noise, what is written of each return

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
    uniform, texture = rng.random(n, dtype=np.float32), rng.standard_normal(n, dtype=np.float32)
    noise = rng.standard_normal(n, dtype=np.float32)
    candidates = np.flatnonzero(strength > 1e-3)
    chance = detection_probability(model, strength[candidates]) * (1 - model.dropout)
    shot = candidates[uniform[candidates] < chance]
    power, distance = strength[shot], range_m[shot]
    noisy = distance + range_spread_m(model, power).astype(np.float32) * noise[shot]
    reflectance = np.float32(REFERENCE_REFLECTANCE / model.reference_range_m**2) * power * distance * distance
    reflectance *= np.exp(np.float32(model.texture) * texture[shot])
    return Returns(shot, noisy.astype(np.float32), reflectance.astype(np.float32), power)


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

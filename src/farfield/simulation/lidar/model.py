"""A Luminar-H2-like LiDAR: two scan patterns, and the law by which a hit becomes a return.

Detection: with S the signal over the threshold,

    S(R) = (rho f(theta) / rho_ref) (R_ref / R)^2,    P_det = 1 / (1 + exp(-10 log10(S) / w)),    w = 0.8 dB,

so that R_ref = 245 m at rho_ref = 0.1 gives P_det = 0.9 for a 10 % target at 200 m, the sensor's published range.
f(theta) is cos(theta) plus a rough surface's grazing backscatter and a glossy one's mirror lobe.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from farfield.errors import ConfigError
from farfield.simulation.bodies.materials import BACKSCATTER, GLOSS


@dataclass(frozen=True)
class LidarModel:
    """Figures of the sensor; angles in degrees.

    Args:
        lines: Scan lines a frame.
        columns: Shots a line: 600 kHz, one pulse in flight to 250 m, at 10 Hz.
        azimuth_deg: Half of the horizontal field of view.
        elevation_deg: Half of the vertical field of view.
        focus_deg: Elevation of the densest lines of the Gaussian pattern.
        sigma_deg: Width of the Gaussian pattern; estimated on frames of a sister sensor.
        jitter_deg: Standard deviation of each shot's direction.
        reference_range_m: Range at which a 10 % target is detected with probability 0.5.
        threshold_width_db: Width w of the logistic detection law.
        max_range_m: No return comes from beyond.
        min_range_m: No return comes from nearer.
        range_noise_m: Range noise of strong returns.
        weak_noise_m: Further range noise at the threshold, falling with the square root of the signal.
        dropout: Share of returns lost at random.
        texture: Spread (of the logarithm) of the intensity from shot to shot on one surface.
        glass_return: Share of the shots at glass that come back from it; the others pass through.
    """

    lines: int = 64
    columns: int = 938
    azimuth_deg: float = 60.0
    elevation_deg: float = 15.0
    focus_deg: float = -2.0
    sigma_deg: float = 5.0
    jitter_deg: float = 0.01
    reference_range_m: float = 245.0
    threshold_width_db: float = 0.8
    max_range_m: float = 350.0
    min_range_m: float = 1.0
    range_noise_m: float = 0.01
    weak_noise_m: float = 0.05
    dropout: float = 0.01
    texture: float = 0.15
    glass_return: float = 0.25


REFERENCE_REFLECTANCE = 0.1
PATTERNS = ("gaussian", "uniform")


def line_elevations_deg(pattern: str, model: LidarModel) -> Float[np.ndarray, " lines"]:
    """Elevations of the scan lines, rising.

    The uniform pattern is equally spaced over the field of view; the Gaussian one takes the quantiles of a normal
    distribution around ``focus_deg`` that is cut off at the field's edges.

    Raises:
        ConfigError: If the pattern is neither "gaussian" nor "uniform".
    """
    edge = model.elevation_deg
    if pattern == "uniform":
        return np.linspace(-edge, edge, model.lines)
    if pattern != "gaussian":
        raise ConfigError(f"scan pattern: expected one of {', '.join(PATTERNS)}; got {pattern!r}")
    normal = NormalDist(model.focus_deg, model.sigma_deg)
    low, high = normal.cdf(-edge), normal.cdf(edge)
    shares = (np.arange(model.lines) + 0.5) / model.lines
    return np.array([normal.inv_cdf(low + share * (high - low)) for share in shares])


@dataclass(frozen=True, eq=False)
class Scan:
    """The shots of one sweep, line by line.

    Args:
        elevation_rad: Elevation of each line without jitter, rising, shape (lines,).
        azimuth_rad: Azimuth of each column without jitter, rising, shape (columns,).
        directions: Unit directions with jitter, shape (lines, columns, 3).
        origin_m: Where the sensor sits in the common frame, shape (3,).
    """

    elevation_rad: Float[np.ndarray, " lines"]
    azimuth_rad: Float[np.ndarray, " columns"]
    directions: Float32[np.ndarray, "lines columns 3"]
    origin_m: Float[np.ndarray, " 3"]

    @classmethod
    def draw(
        cls, pattern: str, model: LidarModel, rng: np.random.Generator, *, origin_m: Sequence[float | int]
    ) -> "Scan":
        """Lay out one sweep: lines of the pattern, evenly spaced columns with a random phase, jitter on each shot."""
        elevation = np.radians(line_elevations_deg(pattern, model)).astype(np.float32)
        step = 2 * model.azimuth_deg / model.columns
        phase = rng.uniform(0, 1, (model.lines, 1)).astype(np.float32)
        column = np.arange(model.columns, dtype=np.float32)
        azimuth = np.radians(-model.azimuth_deg + step * (column[None] + phase)).astype(np.float32)
        jitter = np.float32(np.radians(model.jitter_deg)) * rng.standard_normal((2, *azimuth.shape), dtype=np.float32)
        az, el = azimuth + jitter[0], elevation[:, None] + jitter[1]
        cos_el = np.cos(el)
        directions = np.stack([cos_el * np.cos(az), cos_el * np.sin(az), np.sin(el)], axis=-1)
        middle = np.radians(-model.azimuth_deg + step * (column + 0.5))
        return cls(
            elevation.astype(np.float64), middle.astype(np.float64), directions, np.asarray(origin_m, dtype=np.float64)
        )

    @property
    def margin_rad(self) -> float:
        """How far a shot's direction may lie from its line and column (phase, and 6 standard deviations of jitter)."""
        return float(self.azimuth_rad[1] - self.azimuth_rad[0]) / 2 + float(np.radians(0.1))


def signal(
    model: LidarModel,
    range_m: Float[np.ndarray, " n"],
    cosine: Float[np.ndarray, " n"],
    reflectance: Float[np.ndarray, " n"],
    material: Int[np.ndarray, " n"],
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Signal over the detection threshold, and the effective reflectance (what the intensity shows).

    Args:
        model: The sensor.
        range_m: Distance of the hits.
        cosine: Cosine of the angle of incidence.
        reflectance: Diffuse reflectance.
        material: Materials, for their roughness and gloss.
    """
    rough, gloss = BACKSCATTER[material], GLOSS[material]
    seen = reflectance * (cosine * (1 - rough) + rough) + gloss * cosine**20
    return seen / REFERENCE_REFLECTANCE * (model.reference_range_m / np.maximum(range_m, 0.1)) ** 2, seen


def detection_probability(model: LidarModel, strength: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Probability that a return of a given signal over the threshold is detected."""
    decibel = 10 * np.log10(np.maximum(strength, 1e-12))
    return 1 / (1 + np.exp(np.clip(-decibel / model.threshold_width_db, -60, 60)))


@dataclass(frozen=True, eq=False)
class Returns:
    """What a sweep measured: index of each shot that came back, its noisy range and its intensity in [0, 1]."""

    shot: Int[np.ndarray, " n"]
    range_m: Float[np.ndarray, " n"]
    intensity: Float[np.ndarray, " n"]


def measure(
    model: LidarModel,
    range_m: Float[np.ndarray, " n"],
    cosine: Float[np.ndarray, " n"],
    reflectance: Float[np.ndarray, " n"],
    material: Int[np.ndarray, " n"],
    rng: np.random.Generator,
) -> Returns:
    """Turn hits into returns: detection, dropout, range noise, and a textured intensity in steps of 1/255.

    Args:
        model: The sensor.
        range_m: Distance of each shot's hit, inf for none.
        cosine: Cosine of the angle of incidence.
        reflectance: Diffuse reflectance of what was hit.
        material: Its material.
        rng: Draws the same count of numbers whatever was hit.
    """
    n = len(range_m)
    lucky, texture = rng.random(n, dtype=np.float32), rng.standard_normal(n, dtype=np.float32)
    noise = rng.standard_normal(n, dtype=np.float32)
    hit = np.flatnonzero((range_m < model.max_range_m) & (range_m > model.min_range_m))
    distance = range_m[hit].astype(np.float64)
    strength, seen = signal(model, distance, cosine[hit].astype(np.float64), reflectance[hit], material[hit])
    seen = seen * np.exp(model.texture * texture[hit].astype(np.float64))
    chance = detection_probability(model, strength) * (1 - model.dropout)
    back: Bool[np.ndarray, " n"] = lucky[hit] < chance
    spread = np.sqrt(model.range_noise_m**2 + model.weak_noise_m**2 / np.maximum(strength[back], 1e-3))
    noisy = distance[back] + spread * noise[hit[back]]
    return Returns(hit[back], noisy, np.round(np.clip(seen[back], 0, 1) * 255) / 255)

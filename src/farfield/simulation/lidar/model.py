"""LiDAR sensors: their figures, and the law by which light that comes back becomes a detection.

With S the signal over the threshold,

    S(R) = (rho f(theta) / rho_ref) (R_ref / R)^2 T^2 exp(-2 alpha R),    P_det = 1 / (1 + exp(-10 log10(S) / w)),

where w = 0.8 dB, T is the transmission of the sensor's window and alpha the extinction of the air. R_ref = 245 m at
rho_ref = 0.1 gives P_det = 0.9 for a 10 % target at 200 m, the Luminar's published range. Those of the Ousters are read
off the weakest returns of real frames (72 and 55 m); the HDL-64E's gives its data sheet's 50 m likewise. f(theta) is
cos(theta) plus a rough surface's grazing backscatter and a glossy one's mirror lobe.
"""

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from jaxtyping import Float, Int

from farfield.errors import ConfigError
from farfield.simulation.bodies.materials import BACKSCATTER, GLOSS
from farfield.vocabulary.patterns import PATTERNS

# Where the rows of a sensor point: the lines of the Luminar's two patterns, the beam tables of the turning sensors


@dataclass(frozen=True)
class BeamTable:
    """The rows of a spinning sensor, from the highest down.

    Args:
        elevation_deg: Elevation of each row.
        offset_deg: By how much each row points to the right of the column's direction.
        origin_m: Distance of the beams' origin from the sensor's axis.
    """

    elevation_deg: tuple[float, ...]
    offset_deg: tuple[float, ...]
    origin_m: float

    @classmethod
    def table(
        cls, top_deg: float, bottom_deg: float, rows: int, cycle_deg: tuple[float, ...], origin_m: float
    ) -> "BeamTable":
        """Evenly spaced rows whose azimuth offsets repeat a cycle."""
        elevation = tuple(float(value) for value in np.linspace(top_deg, bottom_deg, rows))
        return cls(elevation, tuple(cycle_deg[row % len(cycle_deg)] for row in range(rows)), origin_m)

    def every_second(self) -> "BeamTable":
        """The rows 0, 2, 4..."""
        return BeamTable(self.elevation_deg[::2], self.offset_deg[::2], self.origin_m)


OS1_128_BEAMS = BeamTable.table(20.95, -21.82, 128, (4.21, 1.41, -1.40, -4.21), 0.0158)
OS2_128_BEAMS = BeamTable.table(10.76, -11.09, 128, (2.08, 0.70, -0.68, -2.05), 0.0138)
OS2_64_BEAMS = OS2_128_BEAMS.every_second()
HDL_64E_BEAMS = BeamTable(
    (*np.linspace(2.0, -8.7, 32).tolist(), *np.linspace(-9.2, -24.9, 32).tolist()), offset_deg=(0.0,) * 64, origin_m=0.0
)
"""The two blocks of 32 lasers of KITTI's Velodyne HDL-64E, the upper one denser, from +2.0 to -24.9 degrees.

Its data sheet gives the ends; where the blocks meet is read off the rings of KITTI's own sweeps, which scatter round
this table by 0.1 degrees.
"""


def line_elevations_deg(
    pattern: str, *, lines: int, edge_deg: float, focus_deg: float, sigma_deg: float
) -> Float[np.ndarray, " lines"]:
    """Elevations of the Luminar's scan lines, rising.

    The uniform pattern is equally spaced over the field of view; the Gaussian one takes the quantiles of a normal
    distribution around ``focus_deg`` that is cut off at the field's edges.

    Args:
        pattern: "gaussian" or "uniform".
        lines: How many.
        edge_deg: Half of the field of view.
        focus_deg: Middle of the Gaussian.
        sigma_deg: Its width.

    Raises:
        ConfigError: If the pattern is neither "gaussian" nor "uniform".
    """
    if pattern == "uniform":
        return np.linspace(-edge_deg, edge_deg, lines)
    if pattern != "gaussian":
        raise ConfigError(f"scan pattern: expected one of {', '.join(PATTERNS)}; got {pattern!r}")
    normal = NormalDist(focus_deg, sigma_deg)
    low, high = normal.cdf(-edge_deg), normal.cdf(edge_deg)
    shares = (np.arange(lines) + 0.5) / lines
    return np.array([normal.inv_cdf(low + share * (high - low)) for share in shares])


REFERENCE_REFLECTANCE = 0.1


@dataclass(frozen=True)
class LidarModel:
    """Figures of one sensor; angles in degrees.

    Args:
        name: What it is called.
        beams: Directions of the rows of a spinning sensor; None for one that draws lines (Luminar).
        lines: Scan lines a frame of a line-drawing sensor (600 kHz, one pulse in flight to 250 m, make 60,000 shots).
        columns: Shots a line, or columns a turn.
        azimuth_deg: Half of a line's width.
        elevation_deg: Half of the height of the field of lines.
        focus_deg: Elevation of the densest lines of the Gaussian pattern.
        sigma_deg: Width of the Gaussian pattern; estimated on frames of a sister sensor.
        jitter_deg: Standard deviation of each shot's direction.
        smile_deg: How much higher the ends of a line lie than its middle.
        period_s: Duration of a frame.
        wavelength_nm: Wavelength of the light.
        reference_range_m: Range at which a 10 % target is detected with probability 0.5.
        threshold_width_db: Width w of the logistic detection law.
        divergence_deg: Full width of the beam at half of its intensity.
        sub_rays: Rays a beam is made of: 5 (its middle and four around it) or 1.
        merge_m: Echoes closer than this are one (half of the length of a 5 ns pulse), at their power-weighted range.
        max_range_m: No return comes from beyond.
        min_range_m: No return comes from nearer.
        range_noise_m: Range noise of strong returns.
        weak_noise_m: Further range noise at the threshold, falling with the square root of the signal.
        dropout: Share of returns lost at random.
        texture: Spread (of the logarithm) of the signal from shot to shot on one surface.
        glass_return: Share of the shots at glass that come back from it; the others pass through.
        compensated: Whether the cloud is corrected for the sensor's own motion within the frame.
    """

    name: str = "luminar-h2"
    beams: BeamTable | None = None
    lines: int = 64
    columns: int = 938
    azimuth_deg: float = 60.0
    elevation_deg: float = 15.0
    focus_deg: float = -2.0
    sigma_deg: float = 5.0
    jitter_deg: float = 0.02
    smile_deg: float = 0.1
    period_s: float = 0.1
    wavelength_nm: float = 1550.0
    reference_range_m: float = 245.0
    threshold_width_db: float = 0.8
    divergence_deg: float = 0.057
    sub_rays: int = 5
    merge_m: float = 0.75
    max_range_m: float = 350.0
    min_range_m: float = 1.0
    range_noise_m: float = 0.01
    weak_noise_m: float = 0.05
    dropout: float = 0.01
    texture: float = 0.15
    glass_return: float = 0.25
    compensated: bool = True

    @property
    def rings(self) -> int:
        """How many lines or rows it has."""
        return len(self.beams.elevation_deg) if self.beams else self.lines

    @property
    def spinning(self) -> bool:
        """Whether it turns on a vertical axis and looks all around."""
        return self.beams is not None


LUMINAR_H2 = LidarModel()
OS2_64 = LidarModel(
    name="os2-64",
    beams=OS2_64_BEAMS,
    columns=2048,
    jitter_deg=0.0,
    wavelength_nm=865.0,
    reference_range_m=72.0,
    divergence_deg=0.10,
    max_range_m=240.0,
    min_range_m=0.8,
    range_noise_m=0.007,
    weak_noise_m=0.10,
    compensated=False,
)
OS1_128 = LidarModel(
    name="os1-128",
    beams=OS1_128_BEAMS,
    columns=2048,
    jitter_deg=0.0,
    wavelength_nm=865.0,
    reference_range_m=55.0,
    divergence_deg=0.18,
    max_range_m=170.0,
    min_range_m=0.5,
    range_noise_m=0.007,
    weak_noise_m=0.10,
    compensated=False,
)

HDL_64E = LidarModel(  # 2 cm and 10 % targets to 50 m by its data sheet; KITTI's files end at 80 m
    name="hdl-64e",
    beams=HDL_64E_BEAMS,
    columns=2083,
    jitter_deg=0.0,
    wavelength_nm=905.0,
    reference_range_m=60.0,
    divergence_deg=0.11,
    max_range_m=80.0,
    min_range_m=2.5,
    range_noise_m=0.02,
    weak_noise_m=0.05,
    compensated=False,
)


def signal(
    model: LidarModel,
    range_m: Float[np.ndarray, " n"],
    cosine: Float[np.ndarray, " n"],
    reflectance: Float[np.ndarray, " n"],
    material: Int[np.ndarray, " n"],
    *,
    extinction_per_m: float = 0.0,
    window: float = 1.0,
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Signal over the detection threshold, and the effective reflectance (what a clear day's intensity shows).

    Args:
        model: The sensor.
        range_m: Distance of the hits.
        cosine: Cosine of the angle of incidence.
        reflectance: Diffuse reflectance at the sensor's wavelength.
        material: Materials, for their roughness and gloss.
        extinction_per_m: Extinction alpha of the air.
        window: One-way transmission of the sensor's window.
    """
    rough, gloss = BACKSCATTER[material], GLOSS[material]
    reflected = reflectance * (cosine * (1 - rough) + rough) + gloss * cosine**20
    clear = reflected / REFERENCE_REFLECTANCE * (model.reference_range_m / np.maximum(range_m, 0.1)) ** 2
    return clear * window**2 * np.exp(-2 * extinction_per_m * range_m), reflected


def detection_probability(model: LidarModel, strength: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Probability that a return of a given signal over the threshold is detected."""
    decibel = 10 * np.log10(np.maximum(strength, 1e-12))
    return 1 / (1 + np.exp(np.clip(-decibel / model.threshold_width_db, -60, 60)))


def range_spread_m(model: LidarModel, strength: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Standard deviation of the measured range, sqrt(s0^2 + k^2 / S)."""
    return np.sqrt(model.range_noise_m**2 + model.weak_noise_m**2 / np.maximum(strength, 1e-3))

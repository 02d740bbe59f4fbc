"""The shots of one frame: direction, origin, time, ring and column of each."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Float32

from farfield.errors import ConfigError
from farfield.simulation.lidar.beams import line_elevations_deg
from farfield.simulation.lidar.model import LidarModel

_FWHM_TO_SIGMA = 1 / (2 * np.sqrt(2 * np.log(2)))
# The middle and four points at two standard deviations integrate a normal distribution exactly to the third degree.
_FIVE = np.array([[0, 0], [1, 1], [-1, 1], [-1, -1], [1, -1]]) * np.sqrt(2.0)
_WEIGHTS = {1: np.ones(1), 5: np.array([0.5, 0.125, 0.125, 0.125, 0.125])}


@dataclass(frozen=True, eq=False)
class Scan:
    """All shots of one frame on a grid of rings (rows) and columns, in the sensor's frame.

    Args:
        rays: Unit directions of every beam's rays, its middle first, shape (3, rays, rings, columns).
        weights: Share of the beam's power in each ray, shape (rays,).
        origin_m: Where the beams start, shape (3, 1, columns) or (3, 1, 1).
        time_s: When each shot leaves, relative to the frame's reference time, shape (rings, columns) or (1, columns).
        azimuth_rad: Direction of each column, shape (columns,).
        elevation_rad: Elevation of each ring, shape (rings,).
        margin_rad: How far a ray may lie from its column and its ring.
    """

    rays: Float32[np.ndarray, "3 rays rings columns"]
    weights: Float32[np.ndarray, " rays"]
    origin_m: Float32[np.ndarray, "3 1 origins"]
    time_s: Float[np.ndarray, "lines columns"]
    azimuth_rad: Float[np.ndarray, " columns"]
    elevation_rad: Float[np.ndarray, " rings"]
    margin_rad: tuple[float, float]

    @classmethod
    def draw(cls, model: LidarModel, rng: np.random.Generator, *, pattern: str = "gaussian") -> "Scan":
        """Lay out one frame of a sensor.

        Args:
            model: The sensor.
            rng: Draws phase and jitter of a line-drawing sensor; a spinning one always shoots alike.
            pattern: Line pattern of a line-drawing sensor: "gaussian" or "uniform".

        Raises:
            ConfigError: If the pattern is unknown or a beam has neither 1 nor 5 rays.
        """
        if model.sub_rays not in _WEIGHTS:
            raise ConfigError(f"LidarModel.sub_rays: expected 1 or 5; got {model.sub_rays}")
        return _spinning(model) if model.spinning else _lines(model, pattern, rng)

    @property
    def shape(self) -> tuple[int, int]:
        """Rings, columns."""
        return self.rays.shape[2], self.rays.shape[3]

    @property
    def directions(self) -> Float32[np.ndarray, "rings columns 3"]:
        """Unit directions of the beams' middles."""
        return np.moveaxis(self.rays[:, 0], 0, -1)

    @property
    def times_s(self) -> Float[np.ndarray, "rings columns"]:
        """When each shot leaves, relative to the reference time."""
        return np.broadcast_to(self.time_s, self.shape)


def _fan(
    azimuth_rad: Float32[np.ndarray, "rings columns"],
    elevation_rad: Float32[np.ndarray, "rings columns"],
    model: LidarModel,
) -> Float32[np.ndarray, "3 rays rings columns"]:
    """Rays of every beam: its middle, and the others turned about the two axes across it."""
    cos_az, sin_az = np.cos(azimuth_rad), np.sin(azimuth_rad)
    cos_el, sin_el = np.cos(elevation_rad), np.sin(elevation_rad)
    sigma = np.radians(model.divergence_deg) * _FWHM_TO_SIGMA
    offsets = (_FIVE[: model.sub_rays] * sigma).astype(np.float32)
    rays = np.empty((3, model.sub_rays, *azimuth_rad.shape), dtype=np.float32)
    for index, (across, up) in enumerate(offsets):
        scale = np.float32(1 / np.sqrt(1 + across**2 + up**2))
        flat = (cos_el - up * sin_el) * scale
        rays[0, index] = flat * cos_az - (across * scale) * sin_az
        rays[1, index] = flat * sin_az + (across * scale) * cos_az
        rays[2, index] = (sin_el + up * cos_el) * scale
    return rays


def _cone_rad(model: LidarModel) -> float:
    return float(2.4 * np.radians(model.divergence_deg) * _FWHM_TO_SIGMA)  # two deviations, wider off the horizon


def _lines(model: LidarModel, pattern: str, rng: np.random.Generator) -> Scan:
    """A Luminar's frame: one line after the other, from the top down (the real order is not published).

    Every line has a random phase of its columns, a smile (its ends lie higher) and a jitter of each shot.
    """
    rings, columns, half = model.lines, model.columns, model.azimuth_deg
    line_deg = line_elevations_deg(
        pattern, lines=rings, edge_deg=model.elevation_deg, focus_deg=model.focus_deg, sigma_deg=model.sigma_deg
    )
    step = 2 * half / columns
    phase = rng.uniform(0, 1, (rings, 1))
    jitter = model.jitter_deg * rng.standard_normal((2, rings, columns))
    azimuth = -half + step * (np.arange(columns) + phase)
    smile = model.smile_deg * ((azimuth / half) ** 2 - 1 / 3)
    az = np.radians(azimuth + jitter[0]).astype(np.float32)
    el = np.radians(line_deg[:, None] + smile + jitter[1]).astype(np.float32)
    order = np.arange(rings)[::-1]
    shot = order[:, None] * columns + np.arange(columns)
    loose = np.radians(6 * model.jitter_deg) + _cone_rad(model)
    return Scan(
        _fan(az, el, model),
        _WEIGHTS[model.sub_rays].astype(np.float32),
        np.zeros((3, 1, 1), dtype=np.float32),
        ((shot + 0.5) / (rings * columns) - 0.5) * model.period_s,
        np.radians(-half + step * (np.arange(columns) + 0.5)),
        np.radians(line_deg),
        (float(np.radians(step / 2) + loose), float(np.radians(model.smile_deg) + loose)),
    )


@lru_cache(maxsize=4)
def _spinning(model: LidarModel) -> Scan:
    """An Ouster's turn: from straight behind over the left side, clockwise; straight ahead at the reference time."""
    assert model.beams is not None
    column = np.arange(model.columns)
    encoder = np.pi - 2 * np.pi * column / model.columns
    offset = np.radians(np.array(model.beams.offset_deg))
    elevation = np.radians(np.array(model.beams.elevation_deg))
    az = (encoder[None] - offset[:, None]).astype(np.float32)
    el = np.broadcast_to(elevation[:, None], az.shape).astype(np.float32)
    origin = model.beams.origin_m * np.stack([np.cos(encoder), np.sin(encoder), np.zeros(model.columns)])
    parallax = model.beams.origin_m / max(model.min_range_m, 0.1)
    return Scan(
        _fan(az, el, model),
        _WEIGHTS[model.sub_rays].astype(np.float32),
        origin[:, None].astype(np.float32),
        ((column / model.columns - 0.5) * model.period_s)[None],
        encoder,
        elevation,
        (float(np.abs(offset).max()) + _cone_rad(model) + parallax, _cone_rad(model) + parallax),
    )

"""What covers a sensor's window: frost and snow that grow over its front, or drops of rain.

A smooth random field over azimuth and elevation, drawn once per sensor and sequence, says in which order the window's
parts get covered; the covered share follows ``Weather.icing_at``. Whole sectors go blind, as K-Radar's appendix shows.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32
from scipy.ndimage import gaussian_filter

from farfield.simulation.weather.conditions import Weather
from farfield.simulation.weather.optics import film_transmission

BLOCKED_TRANSMISSION = 0.05  # one way, through frost
FRONT_DEG = 70.0  # ice and snow gather on the part of the window that faces forward
_STEP_DEG = 0.5
WIDTHS_DEG = {"ice": (8.0, 4.0), "drop": (1.2, 0.8)}
"""How wide the covered parts are: deviations of the smoothing in azimuth and elevation."""


@dataclass(frozen=True, eq=False)
class WindowField:
    """The order in which the parts of one window get covered.

    Args:
        rank: For each cell of azimuth and elevation, the share of the front that is covered before it, 0 to 1.
        azimuth_deg: Half of the front's width; what lies beyond stays clean.
        elevation_deg: Lowest and highest elevation of the window.
    """

    rank: Float32[np.ndarray, "elevations azimuths"]
    azimuth_deg: float
    elevation_deg: tuple[float, float]

    @classmethod
    def draw(
        cls,
        seed: np.random.SeedSequence,
        kind: str,
        *,
        azimuth_deg: float,
        elevation_deg: tuple[float, float],
        widths_deg: tuple[float, float] | None = None,
    ) -> "WindowField":
        """Draw a window's field.

        Args:
            seed: The same for all frames of a sensor in a sequence.
            kind: "ice" (wide patches over the front) or "drop" (small spots).
            azimuth_deg: Half of the sensor's field of view; the front is at most 70 degrees of it.
            elevation_deg: Lowest and highest elevation that the sensor looks at.
            widths_deg: Deviations of the smoothing in azimuth and elevation; those of the kind if left out.
        """
        half = min(azimuth_deg, FRONT_DEG)
        low, high = elevation_deg
        shape = (max(round((high - low) / _STEP_DEG), 2), round(2 * half / _STEP_DEG))
        across, up = widths_deg or WIDTHS_DEG[kind]
        white = np.random.default_rng(seed).standard_normal(shape)
        smooth = gaussian_filter(white, (up / _STEP_DEG, across / _STEP_DEG), mode="wrap")
        spread = np.exp(0.5 * smooth / max(float(smooth.std()), 1e-12))  # log-normal; the wind loads the middle more
        if kind == "ice":
            spread *= 0.6 + 0.4 * np.cos(np.radians(np.linspace(-half, half, shape[1])))
        order = np.argsort(np.argsort(-spread, axis=None)).reshape(shape)
        return cls((order / order.size).astype(np.float32), half, elevation_deg)

    def covered(
        self, share: float, azimuth_deg: Float[np.ndarray, "*shape"], elevation_deg: Float[np.ndarray, "*shape"]
    ) -> np.ndarray:
        """Which directions look through a covered part of the window.

        Args:
            share: Covered share of the front.
            azimuth_deg: Azimuths, positive to the left.
            elevation_deg: Elevations, the same shape.
        """
        rows, columns = self.rank.shape
        low, high = self.elevation_deg
        row = np.clip((elevation_deg - low) / (high - low) * rows, 0, rows - 1).astype(np.int64)
        turned = (azimuth_deg + 180.0) % 360.0 - 180.0
        column = ((turned + self.azimuth_deg) / (2 * self.azimuth_deg) * columns).astype(np.int64)
        front = np.abs(turned) < self.azimuth_deg
        return front & (self.rank[row, np.clip(column, 0, columns - 1)] < share)


def window_cover_kind(weather: Weather) -> str:
    """What covers windows in a weather: "ice" where it snows, "drop" otherwise."""
    return "ice" if weather.snow_mm_h > 0 else "drop"


def transmission(
    field: WindowField,
    weather: Weather,
    time_s: float,
    wavelength_nm: float,
    azimuth_deg: Float[np.ndarray, "*shape"],
    elevation_deg: Float[np.ndarray, "*shape"],
) -> Float[np.ndarray, "*shape"]:
    """One-way transmission of a window in each direction.

    Args:
        field: The window's field.
        weather: Gives the covered share at a time, and the film of water.
        time_s: Time since the sequence began.
        wavelength_nm: The sensor's wavelength.
        azimuth_deg: Azimuths.
        elevation_deg: Elevations, the same shape.
    """
    clear = film_transmission(weather.film_mm, wavelength_nm)
    blocked = field.covered(weather.icing_at(time_s), azimuth_deg, elevation_deg)
    return np.where(blocked, BLOCKED_TRANSMISSION * clear, clear)

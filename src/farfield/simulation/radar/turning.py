"""A turning radar without height nor Doppler, such as RADIATE's Navtech CTS350-X: what it sees becomes a polar picture.

Every azimuth is measured at a time of its own while the car drives on; a picture is not corrected for that, as the real
one is not. Its decibels, leakage and floor were set beside the nine real pictures of RADIATE's sample sequence.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Float64, UInt8

from farfield.radar.axes import RadarAxes
from farfield.radar.turning import CELL_M, POLAR_SHAPE, TURN_S
from farfield.simulation.radar.model import RadarModel
from farfield.simulation.radar.points import Scatterers, cell_snr

SECTORS = 4
"""Parts of a turn, each of which sees the world of its own middle; within one, echoes move by their radial velocity."""
_RANGES, _AZIMUTHS = POLAR_SHAPE
_STEP_DEG = 360.0 / _AZIMUTHS
_SPREAD_BINS, _SPREAD_BEAMS = 5, 3
_AXES = RadarAxes(
    range_m=CELL_M * np.arange(_RANGES),
    azimuth_deg=np.arange(-45.0, 45.5, _STEP_DEG),
    elevation_deg=np.arange(-20.0, 20.5, 1.0),
    doppler_m_s=1000.0 * np.arange(-1, 1),  # it knows no Doppler: everything falls into one bin
)


@dataclass(frozen=True)
class TurningRadar:
    """Every constant of the radar.

    Args:
        echoes: The power budget: 10 m2 at 50 m, the receiver's filter, losses; the fan is broad in elevation, and what
            lies in azimuth is the turn's. Its strength was set beside the real pictures.
        beam_deg: Width of the beam at half power, one way (RADIATE's paper: 1.8).
        range_sigma_cells: Standard deviation of the response along range, in cells (real pictures: neighbouring cells
            correlate by 0.9).
        count_db: Decibels of one of the 256 counts (Navtech's half decibels; fits the floor's spread in the real ones).
        floor_count: The floor's median beyond 80 m (real pictures).
        leakage_range_m: Ranges at which added power is given.
        leakage_db: Added power over the floor there (real pictures: 17 dB below 2 m, 6 dB to 5 m).
    """

    echoes: RadarModel = field(
        default_factory=lambda: RadarModel(
            axes=_AXES,
            azimuth_6db_deg=1e6,
            elevation_6db_deg=5.0,
            snr0_db=54.0,
            range_migration=False,
            migration_blocks=1,
            clutter_reach_m=60.0,
            max_scatterers=20_000,
        )
    )
    beam_deg: float = 1.8
    range_sigma_cells: float = 1.2
    count_db: float = 0.5
    floor_count: float = 19.0
    leakage_range_m: tuple[float, ...] = (0.0, 1.5, 3.0, 6.0)
    leakage_db: tuple[float, ...] = (19.0, 17.0, 7.0, 0.0)

    @property
    def offsets_s(self) -> Float[np.ndarray, " sectors"]:
        """The middle of each sector's time, after the middle of the turn; sectors go clockwise from forward."""
        return (np.arange(SECTORS) + 0.5) / SECTORS * TURN_S - TURN_S / 2


def sector_yaw_rad(sector: int) -> float:
    """Where a sector's middle looks, counter-clockwise from forward."""
    return -2 * np.pi * (sector + 0.5) / SECTORS


def in_sector(echoes: Scatterers, sector: int) -> Scatterers:
    """What a sector's antenna meets, turned into the radar's own axes and moved to when the beam passes.

    Args:
        echoes: Scatterers in axes whose x looks along the sector's middle, at the middle of its time.
        sector: Which, from 0.
    """
    within = echoes.take(np.abs(echoes.azimuth_rad) <= np.pi / SECTORS)
    late_s = -within.azimuth_rad / (2 * np.pi) * TURN_S  # to the right is later
    range_m = np.maximum(within.range_m, 1e-6)
    grown = np.maximum(1.0 + within.velocity_m_s * late_s / range_m, 0.1)
    yaw = sector_yaw_rad(sector)
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    return replace(within, position_m=(within.position_m * grown[:, None]) @ turn.T)


def polar_picture(
    echoes: Scatterers,
    strength: Float[np.ndarray, " n"],
    radar: TurningRadar,
    rng: np.random.Generator,
) -> UInt8[np.ndarray, "ranges azimuths"]:
    """The picture: coherent sum of all echoes in beam and range, noise and leakage added, in counts of decibels.

    Args:
        echoes: Scatterers in the radar's axes, x forward.
        strength: Signal over noise of each, linear, shape (n,), as :func:`strengths` gives it.
        radar: The radar.
        rng: Draws phases and noise.
    """
    phase = rng.uniform(0.0, 2 * np.pi, len(echoes))
    echo = np.sqrt(strength) * np.exp(1j * phase)
    range_cells = echoes.range_m / CELL_M
    azimuth_cells = (-np.degrees(echoes.azimuth_rad) / _STEP_DEG - 0.5) % _AZIMUTHS
    field_ = np.zeros(_RANGES * _AZIMUTHS, dtype=np.complex128)
    for down in range(-_SPREAD_BINS, _SPREAD_BINS + 1):
        row = np.rint(range_cells).astype(np.int64) + down
        along = np.exp(-(((row - range_cells) / radar.range_sigma_cells) ** 2) / 4)  # of amplitudes
        for across in range(-_SPREAD_BEAMS, _SPREAD_BEAMS + 1):
            column = np.rint(azimuth_cells).astype(np.int64) + across
            off = (column - azimuth_cells) * _STEP_DEG / (radar.beam_deg / 2)
            gain = along * 2.0 ** -(off**2)  # two ways of power: once the amplitude of 2 ** -(2 off ** 2)
            inside = (row >= 0) & (row < _RANGES)
            cell = row[inside] * _AZIMUTHS + column[inside] % _AZIMUTHS
            amplitude = (gain * echo)[inside]
            real, imaginary = (
                np.bincount(cell, part, minlength=len(field_)) for part in (amplitude.real, amplitude.imag)
            )
            field_ += real + 1j * imaginary
    power = np.abs(field_.reshape(POLAR_SHAPE) + _noise(radar, rng)) ** 2
    floor_db = 10 * np.log10(np.log(2.0))  # the median of exponential power
    counts = radar.floor_count + (10 * np.log10(np.maximum(power, 1e-12)) - floor_db) / radar.count_db
    return np.clip(np.rint(counts), 0, 255).astype(np.uint8)


def strengths(echoes: Scatterers, radar: TurningRadar) -> Float64[np.ndarray, " n"]:
    """Signal over noise of each scatterer, in axes whose x looks along its sector's middle."""
    return cell_snr(echoes, radar.echoes)


def _noise(radar: TurningRadar, rng: np.random.Generator) -> np.ndarray:
    """Complex noise of power 1 that neighbouring ranges share, and leakage near the antenna, (ranges, azimuths)."""
    offsets = np.arange(-_SPREAD_BINS, _SPREAD_BINS + 1)
    kernel = np.exp(-((offsets / radar.range_sigma_cells) ** 2) / 4)
    kernel /= np.sqrt((kernel**2).sum())
    white = rng.standard_normal((_RANGES + 2 * _SPREAD_BINS, _AZIMUTHS, 2)) @ np.array([1.0, 1j]) / np.sqrt(2.0)
    noise = sum(weight * white[k : k + _RANGES] for k, weight in enumerate(kernel))
    level_db = np.interp(CELL_M * np.arange(_RANGES), radar.leakage_range_m, radar.leakage_db)
    return np.asarray(noise * 10 ** (level_db / 20)[:, None])

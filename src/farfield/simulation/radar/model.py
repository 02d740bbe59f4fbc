"""A 4D imaging radar like K-Radar's RETINA-4ST: its array, its power budget and its imperfections, all as fields.

"Real map" in a source means the one published range-azimuth map of K-Radar (``plot_tes_ra.png`` in its repository),
digitised, and what the data set's MATLAB tools say; "default" marks a customary figure that no source here measures.
"""

from dataclasses import dataclass, field
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32

from farfield.errors import ConfigError
from farfield.geometry.poses import pose
from farfield.radar.axes import KRADAR_AXES, RadarAxes
from farfield.vocabulary.kradar import KRADAR_ORIGIN_M

LIGHT_M_S = 299_792_458.0
WINDOWS = ("none", "hann", "hamming")


@dataclass(frozen=True)
class RadarModel:
    """Every constant of the radar.

    Args:
        axes: Bins of the tensor (K-Radar's own files).
        carrier_hz: Middle of the sweep (RETINA-4ST data sheet: 76-77 GHz band).
        azimuth_elements: Virtual elements along azimuth. Sparse, so that side lobes are 10 to 13 dB down over all
            angles as in the real map.
        azimuth_slots: Half-wavelength slots that they are thinned from; sets the beam of 1.07 degrees.
        elevation_elements: Virtual elements along elevation; few, for the floor's deviation of 0.30 dB in the real map
            shows about three independent elevation looks.
        elevation_slots: Half-wavelength slots of those; a beam of 9 degrees.
        array_seed: Draws slots and phase errors; the array is the same in every frame. Of seeds 0 to 9 the one whose
            azimuth side lobes come nearest to the real map's quantiles.
        phase_error_rad: Standard deviation of each element's uncorrected phase (real map).
        snr0_db: Signal over noise in the best cell for ``rcs0_m2`` at ``range0_m`` on boresight, from the strongest
            object of the real map.
        rcs0_m2: Radar cross section of the reference target.
        range0_m: Its range.
        azimuth_6db_deg: Angle where one pass through the antenna has lost 6 dB (default).
        elevation_6db_deg: The same for elevation (default).
        antenna_floor_db: Least antenna gain, one pass (default).
        noise_floor: Mean noise power in a cell, file units: 109.1 dB (real map).
        high_pass_m: Range whose echoes the receiver's high-pass filter halves, 0 for no filter. With 100 m echoes fall
            by about 20 dB a decade instead of 40. The real map needs some filter; of corners from 60 to 200 m
            it prefers none clearly (benchmarks/radar.py near-range).
        response_range_m: Ranges at which the receiver's response is given.
        response_db: Response there: -2 dB at 6-11 m, roll-off of -5 dB at 110-114 m (real map).
        leakage_range_m: Ranges at which added power is given.
        leakage_db: Mean added power over the floor there, before the response: transmitter leakage of 42 to 50 dB in
            bin 0, 6 to 8 dB at 1-5 m, wrap-around of 2 to 6 dB in the last bins (real map); -40 stands for none.
        leakage_doppler_bins: Half width at half power of its Lorentzian Doppler spread around standstill (default).
        window: Taper of range and Doppler transforms; K-Radar's tools have none.
        range_migration: Let fast targets walk through range bins during a frame.
        migration_min_m_s: Radial speed from which on they do.
        migration_blocks: Parts of a frame within which a target stands in one range.
        loop_s: Time between two chirps of one transmitter: wavelength over four times the greatest Doppler velocity.
        transmitters: Time-multiplexed transmitters: 12 slots of 42.2 us share a loop (default).
        tdm_phase: Leave the phase of a folded velocity across transmitters uncorrected (unknown for the real radar).
        truncation_db: Side lobes of a scatterer below this level over the noise are not computed.
        ground_reflection: Amplitude of the road's mirror reflection (default, dry asphalt at grazing).
        road_roughness_m: Standard deviation of the road's height (default).
        bounce_db: Power of what is seen under a hiding vehicle, relative to a free view (default).
        ghost_db: Power of mirror images in rails and walls (default).
        radome_wetting: Share of a hydrophobic radome that a film covers; beads leave the rest dry. A default, chosen so
            that light films lose 1 to 1.5 dB one way in rain.
        gas_db_km: One-way loss in clear air (ITU-R P.676 at sea level).
        dry_snow_db_km: One-way loss for each mm/h of dry snowfall (default: 0.3-1 dB in light snow, 1-3 in heavy).
        melting_factor: Loss of melting flakes over that of the same water as rain.
        clutter_reach_m: Rain echoes are drawn up to this range.
        clutter_scatterers: Mean number of rain scatterers.
        clutter_spread_m_s: Standard deviation of their radial velocities (default: 1 to 2 m/s).
        max_scatterers: The strongest so many are kept.
    """

    axes: RadarAxes = KRADAR_AXES
    carrier_hz: float = 76.5e9
    azimuth_elements: int = 24
    azimuth_slots: int = 86
    elevation_elements: int = 8
    elevation_slots: int = 10
    array_seed: int = 8
    phase_error_rad: float = 0.5
    snr0_db: float = 30.0
    rcs0_m2: float = 10.0
    range0_m: float = 50.0
    azimuth_6db_deg: float = 53.0
    elevation_6db_deg: float = 15.0
    antenna_floor_db: float = -20.0
    noise_floor: float = 10.0**10.91
    high_pass_m: float = 100.0
    response_range_m: tuple[float, ...] = (0.0, 5.0, 6.0, 11.0, 13.0, 107.0, 110.0, 118.5)
    response_db: tuple[float, ...] = (0.0, 0.0, -2.0, -2.0, 0.0, 0.0, -5.0, -5.0)
    leakage_range_m: tuple[float, ...] = (0.0, 0.5, 1.0, 5.0, 6.5, 113.5, 114.2, 118.0)
    leakage_db: tuple[float, ...] = (45.0, 15.0, 7.5, 5.0, -40.0, -40.0, 5.0, 10.0)
    leakage_doppler_bins: float = 0.5
    window: str = "none"
    range_migration: bool = True
    migration_min_m_s: float = 5.0
    migration_blocks: int = 4
    loop_s: float = 0.507e-3
    transmitters: int = 12
    tdm_phase: bool = False
    truncation_db: float = -3.0
    ground_reflection: float = -0.6
    road_roughness_m: float = 0.0005
    bounce_db: float = -10.0
    ghost_db: float = -15.0
    radome_wetting: float = 0.35
    gas_db_km: float = 0.35
    dry_snow_db_km: float = 1.0
    melting_factor: float = 2.0
    clutter_reach_m: float = 30.0
    clutter_scatterers: float = 600.0
    clutter_spread_m_s: float = 1.5
    max_scatterers: int = field(default=10_000)

    def __post_init__(self) -> None:
        if self.window not in WINDOWS:
            raise ConfigError(f"radar window: expected one of {', '.join(WINDOWS)}; got {self.window!r}")
        if self.migration_blocks < 1 or len(self.axes.doppler_m_s) % self.migration_blocks:
            raise ConfigError(
                f"radar migration_blocks: expected a divisor of {len(self.axes.doppler_m_s)} Doppler bins; "
                f"got {self.migration_blocks}"
            )
        for count, slots, name in (
            (self.azimuth_elements, self.azimuth_slots, "azimuth"),
            (self.elevation_elements, self.elevation_slots, "elevation"),
        ):
            if not 2 <= count <= slots:
                raise ConfigError(f"radar {name}_elements: expected 2 to {slots} (its slots); got {count}")

    @property
    def wavelength_m(self) -> float:
        """Wavelength of the carrier."""
        return LIGHT_M_S / self.carrier_hz

    @property
    def channels(self) -> int:
        """Number of virtual channels."""
        return self.azimuth_elements * self.elevation_elements

    def antenna_db(
        self, azimuth_rad: Float[np.ndarray, "*n"], elevation_rad: Float[np.ndarray, "*n"]
    ) -> Float[np.ndarray, "*n"]:
        """Gain of one pass relative to boresight: parabolic in decibels."""
        azimuth = np.degrees(azimuth_rad) / self.azimuth_6db_deg
        elevation = np.degrees(elevation_rad) / self.elevation_6db_deg
        return np.asarray(np.maximum(-6.0 * (azimuth**2 + elevation**2), self.antenna_floor_db))

    def echo_gain_db(self, range_m: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """What the receiver's high-pass filter leaves of an echo, in dB relative to one at ``range0_m``.

        An echo's beat frequency grows with its range, so that a filter with one pole ahead of the digitiser evens out
        half of the R^-4: R^2 / (R^2 + R_h^2).
        """
        weight = (self.high_pass_m / np.asarray(range_m)) ** 2
        return np.asarray(10.0 * np.log10((1.0 + (self.high_pass_m / self.range0_m) ** 2) / (1.0 + weight)))

    def response(self) -> Float[np.ndarray, " r"]:
        """Receiver's power response in each range bin."""
        return np.asarray(10 ** (np.interp(self.axes.range_m, self.response_range_m, self.response_db) / 10))

    def leakage(self) -> Float[np.ndarray, " r"]:
        """Mean added power in each range bin, in units of the noise; 0 where there is none."""
        level = np.interp(self.axes.range_m, self.leakage_range_m, self.leakage_db)
        return np.asarray(np.where(level > -30.0, 10 ** (level / 10), 0.0))


class VirtualArray(NamedTuple):
    """Where the virtual elements stand and how far their phases are off.

    Args:
        azimuth_slot: Positions along azimuth in half wavelengths, shape (a,).
        elevation_slot: Positions along elevation, shape (e,).
        azimuth_error_rad: Phase errors along azimuth, shape (a,); a channel's error is the sum of both.
        elevation_error_rad: Phase errors along elevation, shape (e,).
        gain: Amplitude that the errors leave of a coherent sum.
        transmitter: Time slot of each azimuth element, shape (a,).
    """

    azimuth_slot: Float[np.ndarray, " a"]
    elevation_slot: Float[np.ndarray, " e"]
    azimuth_error_rad: Float[np.ndarray, " a"]
    elevation_error_rad: Float[np.ndarray, " e"]
    gain: float
    transmitter: Float[np.ndarray, " a"]


@lru_cache(maxsize=8)
def virtual_array(model: RadarModel) -> VirtualArray:
    """The array of a model: both ends of each aperture are taken, the slots between them are drawn."""
    rng = np.random.default_rng(model.array_seed)
    azimuth, elevation = (
        np.sort(np.concatenate([[0, slots - 1], rng.choice(np.arange(1, slots - 1), count - 2, replace=False)]))
        for count, slots in (
            (model.azimuth_elements, model.azimuth_slots),
            (model.elevation_elements, model.elevation_slots),
        )
    )
    azimuth_error = rng.normal(0.0, model.phase_error_rad, model.azimuth_elements)
    elevation_error = rng.normal(0.0, model.phase_error_rad, model.elevation_elements)
    gain = abs(np.exp(1j * azimuth_error).mean() * np.exp(1j * elevation_error).mean())
    transmitter = np.floor(np.arange(model.azimuth_elements) * model.transmitters / model.azimuth_elements)
    return VirtualArray(
        azimuth.astype(float), elevation.astype(float), azimuth_error, elevation_error, float(gain), transmitter
    )


class BeamWeights(NamedTuple):
    """Weights of the digital beam forming, split into real and imaginary parts.

    Args:
        azimuth_re: Shape (elements, beams); unit noise gain.
        azimuth_im: Shape (elements, beams).
        elevation_re: Shape (beams, elements).
        elevation_im: Shape (beams, elements).
    """

    azimuth_re: Float32[np.ndarray, "a j"]
    azimuth_im: Float32[np.ndarray, "a j"]
    elevation_re: Float32[np.ndarray, "q e"]
    elevation_im: Float32[np.ndarray, "q e"]


@lru_cache(maxsize=8)
def beams(model: RadarModel) -> BeamWeights:
    """Conjugate steering vectors of every azimuth and elevation of the axes, without the phase errors."""
    array = virtual_array(model)
    azimuth = np.pi * np.outer(array.azimuth_slot, np.sin(np.radians(model.axes.azimuth_deg)))
    elevation = np.pi * np.outer(np.sin(np.radians(model.axes.elevation_deg)), array.elevation_slot)
    a, e = np.sqrt(len(azimuth)), np.sqrt(elevation.shape[1])
    parts = (np.cos(azimuth) / a, -np.sin(azimuth) / a, np.cos(elevation) / e, -np.sin(elevation) / e)
    return BeamWeights(*(np.ascontiguousarray(part, dtype=np.float32) for part in parts))


def radar_mount(ego_T_lidar: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """Pose of K-Radar's radar in the ego vehicle: 2.54 m ahead, 0.3 m right and 0.7 m below its os2-64, not turned."""
    return ego_T_lidar @ pose(np.eye(3), np.array(KRADAR_ORIGIN_M))

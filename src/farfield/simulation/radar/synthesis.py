"""From scatterers to the radar's tensor, through a virtual array.

Every scatterer adds a complex echo to each virtual channel and range-Doppler cell near it, shaped by the transforms'
own kernels; complex noise is added there, before beams are formed. So noise is correlated between beams, echoes
interfere, and side lobes are those of the array. Equations: mean over n of exp(2 pi j x n / N) for range and Doppler,
exp(pi j slot sin) for the array, u_az = cos(el) sin(az), u_el = sin(el).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32

from farfield.radar.products import Moments
from farfield.simulation.radar.echoes import Scatterers, cell_snr
from farfield.simulation.radar.model import RadarModel, beams, virtual_array

_BLOCKS = 32  # of range bins, the unit of parallel work
_TAPER = {"none": (1.0, 0.0), "hann": (0.5, -0.25), "hamming": (0.54, -0.23)}


@dataclass(frozen=True, eq=False)
class Channels:
    """Range-Doppler cells of every virtual channel, noise of variance 1 included.

    Args:
        re: Real part, shape (range, Doppler, channel); channels run over azimuth elements first.
        im: Imaginary part.
    """

    re: Float32[np.ndarray, "r d c"]
    im: Float32[np.ndarray, "r d c"]


def draw_noise(model: RadarModel, rng: np.random.Generator) -> Channels:
    """Thermal noise of every channel and the speckled leakage, drawn in one fixed order."""
    dopplers, ranges = len(model.axes.doppler_m_s), len(model.axes.range_m)
    shape = (ranges, dopplers, model.channels)
    parts = []
    added = _leakage(model)
    rows = np.flatnonzero(added.any(axis=1))
    for _ in range(2):
        part = rng.standard_normal(shape, dtype=np.float32)
        part *= np.float32(np.sqrt(0.5))
        speckle = rng.standard_normal((len(rows), dopplers, model.channels), dtype=np.float32)
        part[rows] += speckle * np.sqrt(added[rows] / 2).astype(np.float32)[..., None]
        parts.append(part)
    return Channels(*parts)


def _leakage(model: RadarModel) -> Float[np.ndarray, "r d"]:
    """Mean power of the leakage in each range-Doppler cell: the table, spread around standstill."""
    axes = model.axes
    offset = axes.fold(axes.doppler_m_s) / axes.doppler_step_m_s / model.leakage_doppler_bins
    spread = 1.0 / (1.0 + offset**2)
    return np.asarray(model.leakage()[:, None] * spread / spread.mean())


def synthesise(
    scatterers: Scatterers, model: RadarModel, phase_rad: Float[np.ndarray, " n"], noise: Channels | None = None
) -> Channels:
    """Echoes in every virtual channel, added to the noise in place.

    Args:
        scatterers: What is seen.
        model: The radar.
        phase_rad: Phase of each echo, shape (n,).
        noise: What :func:`draw_noise` gave; None stands for silence.

    Raises:
        MissingExtraError: If numba is not installed.
    """
    from farfield.simulation.radar.kernels import scatter

    axes = model.axes
    if noise is None:
        shape = (len(axes.range_m), len(axes.doppler_m_s), model.channels)
        noise = Channels(np.zeros(shape, np.float32), np.zeros(shape, np.float32))
    if len(scatterers):
        range_bin = (scatterers.range_m - axes.range_m[0]) / axes.range_step_m
        order = np.argsort(range_bin, kind="stable")
        snr = cell_snr(scatterers, model)[order]
        array = virtual_array(model)
        azimuth, elevation = _manifold(scatterers, model)
        scatter(
            noise.re,
            noise.im,
            range_bin[order],
            _walk_bins(scatterers, model)[order],
            axes.doppler_bin(scatterers.velocity_m_s)[order],
            np.sqrt(snr / model.channels) / array.gain,
            phase_rad[order].astype(np.float64),
            np.sqrt(snr),
            azimuth[order],
            elevation[order],
            float(10 ** (model.truncation_db / 20)),
            model.migration_blocks,
            _block_order(len(axes.range_m)),
        )
    return _tapered(noise, model)


def _manifold(
    scatterers: Scatterers, model: RadarModel
) -> tuple[Float32[np.ndarray, "n a"], Float32[np.ndarray, "n e"]]:
    """Phases across the azimuth and the elevation elements, errors included."""
    array = virtual_array(model)
    range_m = np.maximum(scatterers.range_m, 1e-6)
    u_azimuth, u_elevation = scatterers.position_m[:, 1] / range_m, scatterers.position_m[:, 2] / range_m
    azimuth = np.pi * np.outer(u_azimuth, array.azimuth_slot) + array.azimuth_error_rad
    elevation = np.pi * np.outer(u_elevation, array.elevation_slot) + array.elevation_error_rad
    if model.tdm_phase:
        axes = model.axes
        folds = np.round((scatterers.velocity_m_s - axes.fold(scatterers.velocity_m_s)) / axes.velocity_span_m_s)
        azimuth += 2 * np.pi * np.outer(folds, array.transmitter) / model.transmitters
    return azimuth.astype(np.float32), elevation.astype(np.float32)


def _walk_bins(scatterers: Scatterers, model: RadarModel) -> Float[np.ndarray, " n"]:
    """Range bins that each scatterer walks through during a frame; 0 for slow ones."""
    frame_s = model.loop_s * len(model.axes.doppler_m_s)
    walk = scatterers.velocity_m_s * frame_s / model.axes.range_step_m
    moves = (np.abs(scatterers.velocity_m_s) > model.migration_min_m_s) & model.range_migration
    return np.asarray(np.where(moves, walk, 0.0))


def _block_order(ranges: int) -> np.ndarray:
    """Blocks of range bins so mixed that any contiguous part of the order holds near and far ones (bit reversal)."""
    blocks = min(_BLOCKS, ranges)
    bits = max(1, int(np.ceil(np.log2(blocks))))
    turned = [int(f"{i:0{bits}b}"[::-1], 2) for i in range(1 << bits)]
    return np.array([i for i in turned if i < blocks], dtype=np.int64)


def _tapered(channels: Channels, model: RadarModel) -> Channels:
    """Window both transforms: a raised cosine is a sum of three neighbouring bins; noise keeps its variance."""
    centre, side = _TAPER[model.window]
    if side == 0.0:
        return channels
    scale = 1.0 / np.sqrt(centre**2 + 2 * side**2)
    parts = []
    for part in (channels.re, channels.im):
        for axis in (0, 1):
            mixed = centre * part + side * (np.roll(part, 1, axis) + np.roll(part, -1, axis))
            part = (scale * mixed).astype(np.float32)
        parts.append(part)
    return Channels(*parts)


def form_tensor(channels: Channels, model: RadarModel) -> Float32[np.ndarray, "d r e a"]:
    """Form all beams: linear power in file units, shape (Doppler, range, elevation, azimuth)."""
    from farfield.simulation.radar import kernels

    out = np.empty(model.axes.shape, dtype=np.float32)
    kernels.form_tensor(channels.re, channels.im, *beams(model), _scale(model), out)
    return out


def form_moments(channels: Channels, model: RadarModel) -> Moments:
    """Form all beams and reduce them over Doppler on the fly: the tensor is never held."""
    from farfield.simulation.radar import kernels

    out = np.empty((3, *model.axes.shape[1:]), dtype=np.float32)
    velocity = model.axes.doppler_m_s.astype(np.float32)
    kernels.form_moments(channels.re, channels.im, *beams(model), _scale(model), velocity, out)
    return Moments(out[0], out[1], out[2])


def _scale(model: RadarModel) -> Float32[np.ndarray, " r"]:
    return (model.noise_floor * model.response()).astype(np.float32)

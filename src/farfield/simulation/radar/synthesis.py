"""From scatterers to the radar's tensor, through a virtual array. Import it only where a tensor is made.

Every scatterer adds a complex echo to each virtual channel and range-Doppler cell near it, shaped by the transforms'
own kernels; complex noise is added there, before beams are formed. So noise is correlated between beams, echoes
interfere, and side lobes are those of the array. Equations: mean over n of exp(2 pi j x n / N) for range and Doppler,
exp(pi j slot sin) for the array, u_az = cos(el) sin(az), u_el = sin(el).

Every output row belongs to one range bin and is summed in a fixed order, so that the number of threads changes nothing.
No ``fastmath``: with it, code compiled now and code from numba's cache round differently. ``no_type_check`` keeps
runtime type checkers, which tests switch on, out of compiled functions.
"""

import math
from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Float, Float32

from farfield.errors import MissingExtraError
from farfield.radar.products import Moments
from farfield.simulation.radar.model import RadarModel, beams, virtual_array
from farfield.simulation.radar.points import Scatterers, cell_snr

# The arithmetic, compiled by numba

try:
    from numba import njit, prange
except ImportError as error:
    raise MissingExtraError("numba", "simulate", "The radar's tensor") from error


@njit(cache=True)
@no_type_check
def _size(x, length, count):
    """sin(pi x length / count) / (count sin(pi x / count)): ``length`` of ``count`` turning unit vectors, summed."""
    bottom = math.sin(math.pi * x / count)
    if abs(bottom) < 1e-9:
        turn = math.cos(math.pi * x / count) * math.cos(math.pi * x * length / count)
        return math.copysign(length / count, turn)
    return math.sin(math.pi * x * length / count) / (count * bottom)


@njit(cache=True)
@no_type_check
def _part_sum(x, first, length, count):
    """Mean over ``count`` of exp(2 pi j x m / count) for m = first ... first + length - 1, as (real, imaginary)."""
    size = _size(x, length, count)
    phase = math.pi * x * (2 * first + length - 1) / count
    return size * math.cos(phase), size * math.sin(phase)


@njit(cache=True)
@no_type_check
def _wrap(x, count):
    """Move ``x`` by a multiple of ``count`` into -count/2 ... count/2."""
    return x - count * math.floor(x / count + 0.5)


@njit(cache=True, parallel=True)
@no_type_check
def scatter(
    channel_re, channel_im, range_bin, walk_bins, doppler_bin, amplitude, phase, snr_amplitude, azimuth, elevation,
    least, parts, order,
):  # fmt: skip
    """Add every scatterer's echo to the virtual channels.

    Args:
        channel_re: Real part, float32 (range, Doppler, elevation elements * azimuth elements).
        channel_im: Imaginary part.
        range_bin: Fractional range bin in the middle of the frame, (n,).
        walk_bins: Range bins walked through in a frame, (n, ); 0 for those that stay.
        doppler_bin: Fractional Doppler bin, (n,).
        amplitude: Amplitude in each channel, (n,).
        phase: Phase of the echo, (n,).
        snr_amplitude: Amplitude after beam forming over that of the noise, (n,): decides how far side lobes go.
        azimuth: Phases across the azimuth elements, (n, a).
        elevation: Phases across the elevation elements, (n, e).
        least: Amplitude over that of the noise below which side lobes are left out; 0 keeps all.
        parts: Into how many parts the frame of a scatterer that walks is divided.
        order: Blocks of range bins in the order of work, (blocks,).
    """
    ranges, dopplers, channels = channel_re.shape
    wide, tall = azimuth.shape[1], elevation.shape[1]
    rows = (ranges + order.size - 1) // order.size
    for turn in prange(order.size):
        first_row = order[turn] * rows
        last_row = min(ranges, first_row + rows)
        steer_re = np.empty(channels, np.float32)
        steer_im = np.empty(channels, np.float32)
        doppler_re = np.empty((parts, dopplers), np.float64)
        doppler_im = np.empty((parts, dopplers), np.float64)
        for i in range(range_bin.size):
            blocks = 1 if walk_bins[i] == 0.0 else parts
            half = 0.5 * abs(walk_bins[i])
            width = 0.5 * ranges if least <= 0.0 else max(1.5, snr_amplitude[i] / (math.pi * least))
            ready = False
            for row in range(first_row, last_row):
                middle = _wrap(range_bin[i] - row, ranges)
                if abs(middle) > width + half:
                    continue
                if not ready:
                    ready = True
                    for e in range(tall):
                        for a in range(wide):
                            angle = azimuth[i, a] + elevation[i, e] + phase[i]
                            steer_re[e * wide + a] = amplitude[i] * math.cos(angle)
                            steer_im[e * wide + a] = amplitude[i] * math.sin(angle)
                    centre = math.floor(doppler_bin[i] + 0.5)
                    spread = _doppler_width(snr_amplitude[i], least, dopplers)
                    length = dopplers // blocks
                    for q in range(blocks):
                        for k in range(-spread, min(spread, dopplers - 1 - spread) + 1):
                            d = (centre + k) % dopplers
                            doppler_re[q, d], doppler_im[q, d] = _part_sum(
                                doppler_bin[i] - centre - k, q * length, length, dopplers
                            )
                _row(
                    channel_re[row], channel_im[row], steer_re, steer_im, doppler_re, doppler_im, blocks, middle,
                    walk_bins[i], snr_amplitude[i], least, math.floor(doppler_bin[i] + 0.5), ranges,
                )  # fmt: skip


@njit(cache=True)
@no_type_check
def _doppler_width(snr_amplitude, least, dopplers):
    if least <= 0.0:
        return dopplers // 2
    return min(dopplers // 2, max(2, math.ceil(snr_amplitude / (math.pi * least))))


@njit(cache=True)
@no_type_check
def _row(
    row_re,
    row_im,
    steer_re,
    steer_im,
    doppler_re,
    doppler_im,
    blocks,
    middle,
    walk,
    snr_amplitude,
    least,
    centre,
    ranges,
):
    """Add one scatterer to one range bin: only where its echo there stands out, both ways."""
    dopplers, channels = row_re.shape
    size = np.empty(blocks, np.float64)
    peak = 0.0
    for q in range(blocks):  # a target's phase turns at the carrier, the middle of the sweep: walking adds none
        size[q] = _size(middle + walk * ((q + 0.5) / blocks - 0.5), ranges, ranges)
        peak = max(peak, abs(size[q]))
    if peak * snr_amplitude < least and abs(middle) > 1.5 + 0.5 * abs(walk):
        return
    phase = math.pi * middle * (ranges - 1) / ranges
    turn_re, turn_im = math.cos(phase), math.sin(phase)
    spread = _doppler_width(peak * snr_amplitude, least, dopplers)
    for k in range(-spread, min(spread, dopplers - 1 - spread) + 1):
        d = (centre + k) % dopplers
        re, im = 0.0, 0.0
        for q in range(blocks):
            re += size[q] * doppler_re[q, d]
            im += size[q] * doppler_im[q, d]
        a, b = np.float32(re * turn_re - im * turn_im), np.float32(re * turn_im + im * turn_re)
        out_re, out_im = row_re[d], row_im[d]
        for c in range(channels):
            out_re[c] += a * steer_re[c] - b * steer_im[c]
            out_im[c] += a * steer_im[c] + b * steer_re[c]


@njit(cache=True)
@no_type_check
def _beam_power(cell_re, cell_im, az_re, az_im, el_re, el_im, y_re, y_im, sum_re, sum_im, scale, out):
    """Power of one range-Doppler cell in every beam: azimuth first, then elevation."""
    wide, beams = az_re.shape
    tall = el_re.shape[1]
    for e in range(tall):
        for j in range(beams):
            y_re[e, j] = np.float32(0)
            y_im[e, j] = np.float32(0)
        for a in range(wide):
            x, y = cell_re[e * wide + a], cell_im[e * wide + a]
            for j in range(beams):
                y_re[e, j] += x * az_re[a, j] - y * az_im[a, j]
                y_im[e, j] += x * az_im[a, j] + y * az_re[a, j]
    for q in range(el_re.shape[0]):
        for j in range(beams):
            sum_re[j] = np.float32(0)
            sum_im[j] = np.float32(0)
        for e in range(tall):
            u, v = el_re[q, e], el_im[q, e]
            for j in range(beams):
                sum_re[j] += u * y_re[e, j] - v * y_im[e, j]
                sum_im[j] += u * y_im[e, j] + v * y_re[e, j]
        for j in range(beams):
            out[q, j] = scale * (sum_re[j] * sum_re[j] + sum_im[j] * sum_im[j])


@njit(cache=True, parallel=True)
@no_type_check
def tensor_kernel(channel_re, channel_im, az_re, az_im, el_re, el_im, scale, out):
    """Beam power of every cell into ``out`` (Doppler, range, elevation, azimuth); ``scale`` is one a range bin."""
    ranges, dopplers, _ = channel_re.shape
    for r in prange(ranges):
        y_re = np.empty((el_re.shape[1], az_re.shape[1]), np.float32)
        y_im = np.empty_like(y_re)
        sum_re = np.empty(az_re.shape[1], np.float32)
        sum_im = np.empty_like(sum_re)
        for d in range(dopplers):
            _beam_power(
                channel_re[r, d], channel_im[r, d], az_re, az_im, el_re, el_im, y_re, y_im, sum_re, sum_im, scale[r],
                out[d, r],
            )  # fmt: skip


@njit(cache=True, parallel=True)
@no_type_check
def moments_kernel(channel_re, channel_im, az_re, az_im, el_re, el_im, scale, velocity, out):
    """Three means over Doppler into ``out`` (3, range, elevation, azimuth), without the tensor.

    All bins; all bins but the first; the latter times their velocity (:class:`farfield.radar.products.Moments`).
    """
    ranges, dopplers, _ = channel_re.shape
    for r in prange(ranges):
        y_re = np.empty((el_re.shape[1], az_re.shape[1]), np.float32)
        y_im = np.empty_like(y_re)
        sum_re = np.empty(az_re.shape[1], np.float32)
        sum_im = np.empty_like(sum_re)
        power = np.empty((el_re.shape[0], az_re.shape[1]), np.float32)
        out[:, r] = np.float32(0)
        for d in range(dopplers):
            _beam_power(
                channel_re[r, d], channel_im[r, d], az_re, az_im, el_re, el_im, y_re, y_im, sum_re, sum_im, scale[r],
                power,
            )  # fmt: skip
            share_all = np.float32(1.0 / dopplers)
            share_63 = np.float32(1.0 / (dopplers - 1)) if d > 0 else np.float32(0)
            moving = share_63 * velocity[d]
            for q in range(power.shape[0]):
                for j in range(power.shape[1]):
                    out[0, r, q, j] += share_all * power[q, j]
                    out[1, r, q, j] += share_63 * power[q, j]
                    out[2, r, q, j] += moving * power[q, j]


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
    out = np.empty(model.axes.shape, dtype=np.float32)
    tensor_kernel(channels.re, channels.im, *beams(model), _scale(model), out)
    return out


def form_moments(channels: Channels, model: RadarModel) -> Moments:
    """Form all beams and reduce them over Doppler on the fly: the tensor is never held."""
    out = np.empty((3, *model.axes.shape[1:]), dtype=np.float32)
    velocity = model.axes.doppler_m_s.astype(np.float32)
    moments_kernel(channels.re, channels.im, *beams(model), _scale(model), velocity, out)
    return Moments(out[0], out[1], out[2])


def _scale(model: RadarModel) -> Float32[np.ndarray, " r"]:
    return (model.noise_floor * model.response()).astype(np.float32)

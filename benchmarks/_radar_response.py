"""A radar model's response to single scatterers: the tensor by brute force, the point spread, the Doppler spectrum."""

from dataclasses import replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from farfield.simulation.radar.model import RadarModel, virtual_array
from farfield.simulation.radar.points import Scatterers, cell_snr
from farfield.simulation.radar.synthesis import synthesise


def scatterers_of_snr(
    range_m: Float[np.ndarray, " n"],
    azimuth_deg: float | Float[np.ndarray, " n"],
    elevation_deg: float | Float[np.ndarray, " n"],
    velocity_m_s: float | Float[np.ndarray, " n"],
    snr: float,
    model: RadarModel,
) -> Scatterers:
    """Scatterers that alone give cells of this signal to noise ratio."""
    azimuth, elevation = np.radians(np.broadcast_to(azimuth_deg, np.shape(range_m))), np.radians(elevation_deg)
    x, y = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
    position = np.asarray(range_m)[:, None] * np.stack([x, y, np.broadcast_to(np.sin(elevation), x.shape)], axis=1)
    velocity = np.broadcast_to(velocity_m_s, np.shape(range_m)).astype(float)
    unit = Scatterers.of(position, velocity, np.ones(len(position)))
    return replace(unit, rcs_m2=snr / cell_snr(unit, model))


def sampled_tensor(
    scatterers: Scatterers, model: RadarModel, phase_rad: Float[np.ndarray, " n"], *, walk: bool = False
) -> Float[np.ndarray, "d r e a"]:
    """The tensor by brute force, power over noise: every channel's beat signal is sampled, then come FFTs and beams.

    The slow check of ``synthesise``, for a small radar.

    Args:
        scatterers: What reflects.
        model: The radar.
        phase_rad: Phase of each scatterer.
        walk: Whether scatterers move through range while the chirps of a frame are sent.
    """
    axes, array = model.axes, virtual_array(model)
    samples, chirps = np.arange(len(axes.range_m)), np.arange(len(axes.doppler_m_s))
    signal = np.zeros((len(samples), len(chirps), model.elevation_elements, model.azimuth_elements), dtype=complex)
    for i, snr in enumerate(cell_snr(scatterers, model)):
        direction = scatterers.position_m[i] / scatterers.range_m[i]
        moved = scatterers.velocity_m_s[i] * model.loop_s * (chirps + 0.5 - len(chirps) / 2) if walk else 0.0 * chirps
        turns = 1 / (axes.range_step_m * len(samples))
        from_middle = samples[:, None] - (len(samples) - 1) / 2  # the carrier is the middle of the sweep
        beat = np.exp(2j * np.pi * turns * (samples[:, None] * scatterers.range_m[i] + from_middle * moved))
        turn = scatterers.velocity_m_s[i] / axes.velocity_span_m_s - axes.doppler_m_s[0] / axes.velocity_span_m_s
        rows = np.exp(1j * (np.pi * array.azimuth_slot * direction[1] + array.azimuth_error_rad))
        columns = np.exp(1j * (np.pi * array.elevation_slot * direction[2] + array.elevation_error_rad))
        echo = beat * np.exp(2j * np.pi * chirps * turn)
        level = np.sqrt(snr / model.channels) / array.gain * np.exp(1j * phase_rad[i])
        signal += level * echo[:, :, None, None] * columns[:, None] * rows
    cells = np.fft.fft(np.fft.fft(signal, axis=0), axis=1) / (len(samples) * len(chirps))
    u_az, u_el = np.sin(np.radians(axes.azimuth_deg)), np.sin(np.radians(axes.elevation_deg))
    rows = np.exp(-1j * np.pi * np.outer(u_az, array.azimuth_slot)) / np.sqrt(model.azimuth_elements)
    columns = np.exp(-1j * np.pi * np.outer(u_el, array.elevation_slot)) / np.sqrt(model.elevation_elements)
    return np.abs(np.einsum("qe,ja,rdea->drqj", columns, rows, cells)) ** 2


def point_spread_db(
    offset_bins: Float[np.ndarray, " n"], axis: Literal["range", "doppler"], model: RadarModel
) -> Float[np.ndarray, " n"]:
    """Power in one cell, in dB of the peak, as a target moves away from the cell's centre along range or Doppler."""
    exact = replace(model, truncation_db=-np.inf, range_migration=False)
    axes = exact.axes
    levels = []
    for offset in offset_bins:
        range_m = axes.range_m[100] + (offset * axes.range_step_m if axis == "range" else 0.0)
        speed = offset * axes.doppler_step_m_s if axis == "doppler" else 0.0
        one = scatterers_of_snr(np.array([range_m]), 0.0, 0.0, speed, 1.0, exact)
        cell = synthesise(one, exact, np.zeros(1))
        levels.append(np.sum(cell.re[100, 32].astype(float) ** 2 + cell.im[100, 32].astype(float) ** 2))
    return 10 * np.log10(np.array(levels) * virtual_array(exact).gain ** 2)


def doppler_spectrum(velocity_m_s: float, model: RadarModel) -> Float[np.ndarray, " d"]:
    """Power of one target ahead over the Doppler bins."""
    one = scatterers_of_snr(np.array([30.0]), 0.0, 0.0, velocity_m_s, 1e3, model)
    cell = synthesise(one, model, np.zeros(1))
    return (cell.re**2 + cell.im**2).sum(axis=(0, 2))

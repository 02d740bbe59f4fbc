"""Weather laid over radar cells that were measured in other weather: weaker echoes, and a floor that may rise.

A cell's power is the receiver's noise plus echoes. What air and radome take, twice, is taken from the echoes alone:
what lies above the floor shrinks, the floor stays. Rain's own echoes are left out: in a cell they lie 25 dB below the
noise even at 20 mm/h. What the floor gains instead, as a wet radome's reflections may add, is a setting.
"""

import numpy as np
from jaxtyping import Float, Float32

from farfield.radar.axes import POWER_UNIT
from farfield.simulation.radar.model import RadarModel
from farfield.simulation.radar.propagation import two_way_loss_db
from farfield.simulation.weather.conditions import Weather
from farfield.simulation.weather.laid import CLEAR

_LOOKS = 3.0  # independent looks that a cell's power averages, as those of the floor


def overlay_cells(
    points_m: Float32[np.ndarray, "n 3"],
    power: Float32[np.ndarray, " n"],
    model: RadarModel,
    weather: Weather,
    rng: np.random.Generator,
    *,
    floor_rise_db: float | int = 0.0,
) -> Float32[np.ndarray, " n"]:
    """What weather makes of the power of radar cells.

    Args:
        points_m: The cells, in the radar's frame.
        power: Mean power over Doppler, in ``POWER_UNIT``.
        model: The radar.
        weather: The weather, in addition to that in which the cells were measured.
        rng: Draws the speckle of what the floor gains.
        floor_rise_db: By how much the mean of the noise rises.

    Returns:
        Their power in that weather, shape (n,).
    """
    range_m = np.linalg.norm(points_m.astype(np.float64), axis=1)
    floor = floor_power(range_m, model)
    loss_db = two_way_loss_db(range_m, weather, model) - two_way_loss_db(range_m, CLEAR, model)
    changed = power - np.maximum(power - floor, 0.0) * (1 - 10 ** (-loss_db / 10))
    if floor_rise_db > 0:
        changed += floor * (10 ** (floor_rise_db / 10) - 1) * rng.gamma(_LOOKS, 1 / _LOOKS, len(power))
    return changed.astype(np.float32)


def floor_power(range_m: Float[np.ndarray, " n"], model: RadarModel) -> Float[np.ndarray, " n"]:
    """Mean power of noise in cells, in ``POWER_UNIT``, with the receiver's response by range."""
    response_db = np.interp(range_m, model.response_range_m, model.response_db)
    return model.noise_floor / POWER_UNIT * 10 ** (response_db / 10)

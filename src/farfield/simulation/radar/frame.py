"""One radar frame of a scene: scatterers, tensor or its moments, and what of the road users it shows."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32

from farfield.errors import ConfigError
from farfield.radar.products import Moments
from farfield.simulation.radar.model import RadarModel
from farfield.simulation.radar.points import Scatterers, masked_db, object_snr_db
from farfield.simulation.radar.scatterers import scatterers
from farfield.simulation.radar.synthesis import draw_noise, form_moments, form_tensor, synthesise
from farfield.simulation.weather.conditions import Weather
from farfield.simulation.world.scene import SceneWindow

OUTPUTS = ("mean", "tensor")


@dataclass(frozen=True, eq=False)
class RadarFrame:
    """What the radar measured.

    Args:
        tensor: Linear power in file units, shape (Doppler, range, elevation, azimuth); None unless it is an output.
        moments: The tensor reduced over Doppler, for cube and polar map; None unless it is an output.
        scatterers: What was seen.
        snr_db: Signal over noise of each road user in its best cell, shape (n,); -inf for those never hit.
        masked_db: How far another echo at the same range outshines it, shape (n,); see
            :func:`farfield.simulation.radar.points.availability`.
    """

    tensor: Float32[np.ndarray, "d r e a"] | None
    moments: Moments | None
    scatterers: Scatterers
    snr_db: Float[np.ndarray, " n"]
    masked_db: Float[np.ndarray, " n"]

    @property
    def power(self) -> Float32[np.ndarray, "r e a"] | None:
        """Mean power over all Doppler bins, in file units; None unless "mean" is among the outputs."""
        return None if self.moments is None else self.moments.mean_power

    @property
    def doppler_m_s(self) -> Float32[np.ndarray, "r e a"] | None:
        """Power-weighted mean velocity over all Doppler bins but the first; None unless "mean" is among the outputs."""
        if self.moments is None:
            return None
        return self.moments.velocity_moment / np.maximum(self.moments.mean_power_63, np.float32(1e-30))


def measure(
    window: SceneWindow,
    model: RadarModel,
    world_T_radar: Float[np.ndarray, "4 4"],
    weather: Weather,
    seed: np.random.SeedSequence,
    *,
    outputs: Sequence[str] = ("mean",),
) -> RadarFrame:
    """Measure a scene with the radar at the window's reference moment.

    Args:
        window: The scene; with knots, turning and exact velocities are taken from them.
        model: The radar.
        world_T_radar: Its pose at that moment.
        weather: The sequence's weather.
        seed: Draws this frame; the same seed gives the same bytes whatever the number of threads.
        outputs: "mean" for the moments over Doppler, "tensor" for the whole tensor (260 MB), or both.

    Raises:
        ConfigError: If an output is unknown.
        MissingExtraError: If numba or embreex is not installed.
    """
    unknown = sorted(set(outputs) - set(OUTPUTS))
    if unknown:
        raise ConfigError(f"radar outputs: expected some of {', '.join(OUTPUTS)}; got {', '.join(unknown)}")
    streams = [
        np.random.default_rng(np.random.SeedSequence(entropy=seed.entropy, spawn_key=(*seed.spawn_key, stream)))
        for stream in range(3)
    ]
    echoes = scatterers(window, model, world_T_radar, weather, streams[0])
    tensor = reduced = None
    if outputs:
        phase = streams[1].uniform(0.0, 2 * np.pi, len(echoes))
        channels = synthesise(echoes, model, phase, draw_noise(model, streams[2]))
        tensor = form_tensor(channels, model) if "tensor" in outputs else None
        reduced = form_moments(channels, model) if "mean" in outputs else None
    count = len(window.actors)
    return RadarFrame(tensor, reduced, echoes, object_snr_db(echoes, model, count), masked_db(echoes, model, count))

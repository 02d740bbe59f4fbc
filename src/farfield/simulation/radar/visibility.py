"""Which road users the radar sees: signal over noise in their best cell, and K-Radar's availability flag."""

import numpy as np
from jaxtyping import Bool, Float

from farfield.simulation.radar.echoes import ScattererKind, Scatterers, cell_snr
from farfield.simulation.radar.model import RadarModel

VISIBLE_SNR_DB = 15.0
"""Least signal over noise in the best cell of what an annotator can find.

K-Radar's annotators looked at maps averaged over Doppler and elevation. There the floor scatters by 0.30 dB, so three
deviations are 0.9 dB, a rise of 0.23 of the floor. One object fills about 18 of the 2,368 averaged cells, so its cells
stand 0.23 * 2368 / 18 = 30, or 15 dB, over the noise."""

MASKING_DB = 10.0
"""An object so far below the strongest other echo of its range is lost among that echo's side lobes (10 to 13 dB down
over all azimuths in the real map)."""

SHARPEST_DEG = 1.07


def object_snr_db(scatterers: Scatterers, model: RadarModel, actors: int) -> Float[np.ndarray, " n"]:
    """Signal over noise of each road user in its best cell, in dB, losses included; -inf for those never hit.

    The powers of its scatterers within one range bin, Doppler bin and azimuth beam are summed (random phases: the mean
    of the coherent sum). Images in walls do not count; a path under another vehicle does.

    Args:
        scatterers: What is seen.
        model: The radar.
        actors: Number n of road users.
    """
    best = np.zeros(actors)
    mine = (scatterers.actor >= 0) & (scatterers.kind != ScattererKind.GHOST)
    own = scatterers.take(np.flatnonzero(mine))
    if len(own):
        cells = np.stack(
            [
                own.actor,
                np.round(own.range_m / model.axes.range_step_m).astype(np.int64),
                np.round(model.axes.doppler_bin(own.velocity_m_s)).astype(np.int64) % len(model.axes.doppler_m_s),
                np.round(np.degrees(own.azimuth_rad) / SHARPEST_DEG).astype(np.int64),
            ]
        )
        cell, which = np.unique(cells, axis=1, return_inverse=True)
        power = np.bincount(which.reshape(-1), cell_snr(own, model), minlength=cell.shape[1])
        np.maximum.at(best, cell[0], power)
    with np.errstate(divide="ignore"):
        return np.asarray(10 * np.log10(best))


def masked_db(scatterers: Scatterers, model: RadarModel, actors: int) -> Float[np.ndarray, " n"]:
    """How far the strongest other echo within half a bin of each road user's strongest range outshines it, in dB.

    Returns:
        Excess over the road user's own strongest scatterer, shape (n,); -inf where nothing else is there.
    """
    snr = cell_snr(scatterers, model)
    bins = np.round(scatterers.range_m / model.axes.range_step_m).astype(np.int64)
    excess = np.full(actors, -np.inf)
    solid = scatterers.kind != ScattererKind.GHOST
    for actor in np.unique(scatterers.actor[(scatterers.actor >= 0) & solid]):
        own = np.flatnonzero((scatterers.actor == actor) & solid)
        peak = own[np.argmax(snr[own])]
        rivals = (bins == bins[peak]) & (scatterers.actor != actor)
        if rivals.any():
            excess[actor] = 10 * np.log10(max(float(snr[rivals].max()), 1e-30) / max(float(snr[peak]), 1e-30))
    return excess


def availability(
    snr_db: Float[np.ndarray, " n"],
    lidar_visible: Bool[np.ndarray, " n"],
    *,
    threshold_db: float = VISIBLE_SNR_DB,
    masked_by_db: Float[np.ndarray, " n"] | None = None,
) -> list[str]:
    """K-Radar's v2.1 flag: "R" for what the radar sees, "L" for what the LiDAR alone sees, "L1" for neither.

    The data set gives L1 to objects that its tool could not match between two label versions; here it marks what
    neither sensor shows and only the scene knows.

    Args:
        snr_db: From :func:`object_snr_db`.
        lidar_visible: Whether the LiDAR sees each road user, shape (n,).
        threshold_db: Least signal over noise; see :data:`VISIBLE_SNR_DB`.
        masked_by_db: From :func:`masked_db`: those outshone by more than :data:`MASKING_DB` are not seen.
    """
    seen = snr_db >= threshold_db
    if masked_by_db is not None:
        seen &= masked_by_db < MASKING_DB
    return ["R" if radar else "L" if lidar else "L1" for radar, lidar in zip(seen, lidar_visible, strict=True)]

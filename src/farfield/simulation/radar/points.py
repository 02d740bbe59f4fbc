"""Point scatterers: in space, as the radar sees them, and the link budget that turns them into signal over noise."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from enum import IntEnum

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.simulation.radar.model import RadarModel


class ScattererKind(IntEnum):
    """What a scatterer is."""

    SURFACE = 0
    OBJECT = 1
    LIMB = 2
    BOUNCE = 3
    GHOST = 4
    POST = 5
    RAIN = 6
    PLANT = 7


@dataclass(frozen=True, eq=False)
class Scatterers:
    """Point scatterers in the radar's frame (x forward, y left, z up).

    Args:
        position_m: Where they are, or seem to be, shape (n, 3).
        velocity_m_s: Radial velocity relative to the radar, positive when receding, shape (n,).
        rcs_m2: Radar cross section, multipath and fluctuation included, shape (n,).
        actor: Row of the road user in the window, -1 for none, shape (n,).
        kind: A :class:`ScattererKind`, shape (n,).
        loss_db: Two-way loss on the path: air, rain, radome, shape (n,).
    """

    position_m: Float[np.ndarray, "n 3"]
    velocity_m_s: Float[np.ndarray, " n"]
    rcs_m2: Float[np.ndarray, " n"]
    actor: Int[np.ndarray, " n"]
    kind: Int[np.ndarray, " n"]
    loss_db: Float[np.ndarray, " n"]

    @classmethod
    def of(
        cls,
        position_m: Float[np.ndarray, "n 3"],
        velocity_m_s: Float[np.ndarray, " n"],
        rcs_m2: Float[np.ndarray, " n"],
        *,
        actor: Int[np.ndarray, " n"] | int = -1,
        kind: ScattererKind = ScattererKind.SURFACE,
    ) -> "Scatterers":
        """Scatterers of one kind on a path without loss."""
        n = len(position_m)
        return cls(
            np.asarray(position_m, dtype=np.float64),
            np.asarray(velocity_m_s, dtype=np.float64),
            np.asarray(rcs_m2, dtype=np.float64),
            np.broadcast_to(np.asarray(actor, dtype=np.int64), (n,)).copy(),
            np.full(n, int(kind), dtype=np.int64),
            np.zeros(n),
        )

    @classmethod
    def join(cls, parts: Sequence["Scatterers"]) -> "Scatterers":
        """All scatterers of some sets, in their order."""
        if not parts:
            return cls.of(np.zeros((0, 3)), np.zeros(0), np.zeros(0))
        return cls(*(np.concatenate([getattr(part, column.name) for part in parts]) for column in fields(cls)))

    def __len__(self) -> int:
        return len(self.rcs_m2)

    def take(self, rows: Int[np.ndarray, " k"] | Bool[np.ndarray, " n"]) -> "Scatterers":
        """Some of them."""
        return Scatterers(*(getattr(self, column.name)[rows] for column in fields(self)))

    @property
    def range_m(self) -> Float[np.ndarray, " n"]:
        """Distance from the radar."""
        return np.asarray(np.linalg.norm(self.position_m, axis=1))

    @property
    def azimuth_rad(self) -> Float[np.ndarray, " n"]:
        """Azimuth, positive to the left."""
        return np.asarray(np.arctan2(self.position_m[:, 1], self.position_m[:, 0]))

    @property
    def elevation_rad(self) -> Float[np.ndarray, " n"]:
        """Elevation, positive upwards."""
        level_m = np.hypot(self.position_m[:, 0], self.position_m[:, 1])
        return np.asarray(np.arctan2(self.position_m[:, 2], level_m))


def cell_snr(scatterers: Scatterers, model: RadarModel) -> Float[np.ndarray, " n"]:
    """Signal over noise that each scatterer alone gives a cell centred on it: the radar equation, linear.

    SNR = SNR_0 (rcs / rcs_0) (R_0 / R)^4 G^2 / G_0^2 / loss, times what the receiver's high-pass filter leaves; its
    response acts on signal and noise alike.
    """
    range_m = np.maximum(scatterers.range_m, model.axes.range_step_m)
    antenna = 2.0 * model.antenna_db(scatterers.azimuth_rad, scatterers.elevation_rad)
    level_db = model.snr0_db + antenna - scatterers.loss_db + 40.0 * np.log10(model.range0_m / range_m)
    level_db += model.echo_gain_db(range_m)
    return np.asarray(10 ** (level_db / 10) * scatterers.rcs_m2 / model.rcs0_m2)


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
    on_object = (scatterers.actor >= 0) & (scatterers.kind != ScattererKind.GHOST)
    object_echoes = scatterers.take(np.flatnonzero(on_object))
    if len(object_echoes):
        cells = np.stack(
            [
                object_echoes.actor,
                np.round(object_echoes.range_m / model.axes.range_step_m).astype(np.int64),
                np.round(model.axes.doppler_bin(object_echoes.velocity_m_s)).astype(np.int64)
                % len(model.axes.doppler_m_s),
                np.round(np.degrees(object_echoes.azimuth_rad) / SHARPEST_DEG).astype(np.int64),
            ]
        )
        cell, which = np.unique(cells, axis=1, return_inverse=True)
        power = np.bincount(which.reshape(-1), cell_snr(object_echoes, model), minlength=cell.shape[1])
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
    is_direct = scatterers.kind != ScattererKind.GHOST
    for actor in np.unique(scatterers.actor[(scatterers.actor >= 0) & is_direct]):
        actor_echoes = np.flatnonzero((scatterers.actor == actor) & is_direct)
        peak = actor_echoes[np.argmax(snr[actor_echoes])]
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
    radar_visible = snr_db >= threshold_db
    if masked_by_db is not None:
        radar_visible &= masked_by_db < MASKING_DB
    return ["R" if radar else "L" if lidar else "L1" for radar, lidar in zip(radar_visible, lidar_visible, strict=True)]


@dataclass(frozen=True, eq=False)
class ScatterPoints:
    """Scattering points of the scene, in the radar's axes.

    Args:
        position_m: Relative to the radar, shape (n, 3).
        velocity_m_s: Relative to the world, in the radar's axes, shape (n, 3).
        rcs_m2: Mean radar cross section, shape (n,).
        actor: Road user, -1 for none, shape (n,).
        kind: A :class:`ScattererKind`, shape (n,).
    """

    position_m: Float[np.ndarray, "n 3"]
    velocity_m_s: Float[np.ndarray, "n 3"]
    rcs_m2: Float[np.ndarray, " n"]
    actor: Int[np.ndarray, " n"]
    kind: Int[np.ndarray, " n"]

    @classmethod
    def fixed(
        cls, position_m: Float[np.ndarray, "n 3"], rcs_m2: Float[np.ndarray, " n"], kind: ScattererKind
    ) -> "ScatterPoints":
        """Points that stand still and belong to nobody."""
        n = len(position_m)
        return cls(position_m, np.zeros((n, 3)), rcs_m2, np.full(n, -1), np.full(n, int(kind)))

    @classmethod
    def join(cls, parts: Sequence["ScatterPoints"]) -> "ScatterPoints":
        """All points of some sets."""
        if not parts:
            return cls.fixed(np.zeros((0, 3)), np.zeros(0), ScattererKind.SURFACE)
        return cls(*(np.concatenate([getattr(part, column.name) for part in parts]) for column in fields(cls)))

    def __len__(self) -> int:
        return len(self.rcs_m2)

    def take(self, rows: Int[np.ndarray, " k"]) -> "ScatterPoints":
        """Some of them."""
        return ScatterPoints(*(getattr(self, column.name)[rows] for column in fields(self)))

    def seen_from(self, velocity_m_s: Float[np.ndarray, " 3"]) -> Scatterers:
        """What a radar of this velocity (in its own axes) sees: radial velocities."""
        range_m = np.maximum(np.linalg.norm(self.position_m, axis=1), 1e-6)
        radial = np.einsum("ij,ij->i", self.velocity_m_s - velocity_m_s, self.position_m) / range_m
        return Scatterers(self.position_m, radial, self.rcs_m2, self.actor, self.kind, np.zeros(len(self)))

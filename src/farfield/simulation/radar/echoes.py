"""What the radar sees of a scene: point scatterers, and the link budget that turns them into signal over noise."""

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
        flat = np.hypot(self.position_m[:, 0], self.position_m[:, 1])
        return np.asarray(np.arctan2(self.position_m[:, 2], flat))


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

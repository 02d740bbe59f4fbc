"""Points with a velocity in space, before the radar looks at them."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float, Int

from farfield.simulation.radar.echoes import ScattererKind, Scatterers


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

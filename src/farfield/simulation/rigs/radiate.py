"""The RADIATE car's turning radar: a picture a turn, four a second, and the boxes that are drawn on it.

Coordinates of a frame are the radar's in the middle of its turn: x forward, y left, z up.
"""

from functools import cached_property

import numpy as np
from jaxtyping import Float, Float32, UInt8

from farfield.frame import Boxes
from farfield.geometry.poses import invert, pose_from_yaw
from farfield.radar.turning import cartesian
from farfield.simulation import labels
from farfield.simulation.radar.echoes import Scatterers
from farfield.simulation.radar.scatterers import scatterers
from farfield.simulation.radar.turning import (
    SECTORS,
    TurningRadar,
    in_sector,
    polar_picture,
    sector_yaw_rad,
    strengths,
)
from farfield.simulation.radar.visibility import object_snr_db
from farfield.simulation.rigs.drive import HALF_SWEEP_S, SimulatedDrive, SimulatedFrame
from farfield.simulation.world.scene import SceneWindow

_REACH_M, _HALF_SPAN_S = 110.0, 0.02
_LABEL_M = 100.0
_SEEN_DB = 13.0
"""Least signal over noise in its best cell of what is drawn: a lone cell of noise passes it once in 5e8."""
TURN_MIDDLE_S = 0.1
"""How long after its own time a turn is at its middle: the first one begins when the sequence has begun."""


class RadiateMoment(SimulatedFrame):
    """One turn of the radar.

    Args:
        drive: The sequence.
        index: Number of the turn.
    """

    def __init__(self, drive: SimulatedDrive, index: int) -> None:
        super().__init__(drive, index)
        self.time_s = drive.time_s(index) - HALF_SWEEP_S + TURN_MIDDLE_S
        self.radar = TurningRadar()

    @cached_property
    def window(self) -> SceneWindow:
        """The scene in the middle of the turn."""
        return self._window(self.time_s)

    def _window(self, time_s: float) -> SceneWindow:
        return self.drive.scene.window(time_s, half_span_s=_HALF_SPAN_S, reach_m=_REACH_M, behind_m=_REACH_M)

    @cached_property
    def sectors(self) -> list[tuple[SceneWindow, Scatterers]]:
        """The scene in the middle of each sector's time, and what its antenna meets, along the sector's middle."""
        seeds = self.drive.seeds("turning", self.index).spawn(SECTORS)
        found = []
        for sector, offset_s in enumerate(self.radar.offsets_s):
            window = self._window(self.time_s + float(offset_s))
            world_T_radar = window.world_T_ego_now @ self.drive.mounted.ego_T_lidar
            looking = world_T_radar @ pose_from_yaw(sector_yaw_rad(sector))
            rng = np.random.default_rng(seeds[sector])
            found.append((window, scatterers(window, self.radar.echoes, looking, self.drive.weather, rng)))
        return found

    @cached_property
    def polar(self) -> UInt8[np.ndarray, "576 400"]:
        """The polar picture."""
        parts, powers = [], []
        for sector, (_, seen) in enumerate(self.sectors):
            kept = seen.take(np.abs(seen.azimuth_rad) <= np.pi / SECTORS)
            parts.append(in_sector(kept, sector))
            powers.append(strengths(kept, self.radar))
        rng = self.drive.rng("turning", self.index)
        return polar_picture(Scatterers.join(parts), np.concatenate(powers), self.radar, rng)

    def picture(self, name: str) -> Float32[np.ndarray, "height width"]:
        """The picture "polar", or "cartesian" from above, as numbers in [0, 1]."""
        counts = self.polar if name == "polar" else cartesian(self.polar)
        return counts.astype(np.float32) / np.float32(255)

    @cached_property
    def boxes(self) -> Boxes:
        """Full boxes of the road users that stand out of the noise, where their sector's time shows them."""
        found = []
        for sector, (window, seen) in enumerate(self.sectors):
            full = labels.full_boxes(
                window.actors,
                window.bottom_m,
                window.yaw_rad,
                window.velocity_m_s,
                invert(window.world_T_ego_now @ self.drive.mounted.ego_T_lidar),
            )
            ahead = _wrapped(np.arctan2(full.centre_m[:, 1], full.centre_m[:, 0]) - sector_yaw_rad(sector))
            here = (np.abs(ahead) <= np.pi / SECTORS) & (full.range_m < _LABEL_M)
            snr_db = object_snr_db(seen, self.radar.echoes, len(window.actors))
            found.append(full[np.flatnonzero(here & (snr_db >= _SEEN_DB))])
        return _once(Boxes.concatenate(found))


def _wrapped(angle_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    return np.asarray((angle_rad + np.pi) % (2 * np.pi) - np.pi)


def _once(boxes: Boxes) -> Boxes:
    """Each road user once: one that passes from a sector into the next is seen there first."""
    assert boxes.track_id is not None
    _, first = np.unique(boxes.track_id, return_index=True)
    return boxes[np.sort(first)]

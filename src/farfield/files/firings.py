"""What turning LiDARs send: packets of firings, in which every beam is fired once about one direction of the rotor.

The makers' packets (:mod:`farfield.files.velodyne`, :mod:`farfield.files.hesai`) become the same arrays: a row a
firing, a column a beam. Directions count clockwise from ahead, as all their makers count them.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64, UInt8, UInt16

HOUR_NS = 3_600_000_000_000


@dataclass(frozen=True, eq=False)
class Heads:
    """When and in which direction the firings of some packets began.

    Args:
        stamp_ns: Of each packet, by the sensor's clock, shape (packets,).
        since_stamp_ns: Of each firing, shape (packets, firings).
        azimuth_deg: Of the rotor, clockwise, in [0, 360), shape (packets, firings).
        mode: Which returns each packet holds, by the maker's number, shape (packets,).
    """

    stamp_ns: Int64[np.ndarray, " packets"]
    since_stamp_ns: Int64[np.ndarray, "packets firings"]
    azimuth_deg: Float64[np.ndarray, "packets firings"]
    mode: UInt8[np.ndarray, " packets"]


@dataclass(frozen=True, eq=False)
class Firings:
    """What each beam measured in some firings.

    Args:
        azimuth_deg: Where each beam pointed, clockwise from ahead, shape (firings, beams).
        since_stamp_ns: When, from the packet's stamp, shape (firings, beams).
        range_steps: 0 where nothing returned, shape (firings, beams, returns).
        reflectivity: 0 to 255, shape (firings, beams, returns).
        step_m: Metres of a step of the range.
    """

    azimuth_deg: Float64[np.ndarray, "firings beams"]
    since_stamp_ns: Int64[np.ndarray, "firings beams"]
    range_steps: UInt16[np.ndarray, "firings beams returns"]
    reflectivity: UInt8[np.ndarray, "firings beams returns"]
    step_m: float


class TurningLidar(ABC):
    """A model of a turning LiDAR, in one mode of returns.

    Attributes:
        name: The model's.
        mode: Which returns its packets hold, by the maker's number.
        returns: What they are called, in the order of the packet.
        elevation_deg: Of each beam, in the order of the packet, shape (beams,).
        up_m: Where each beam leaves, above the sensor's origin, shape (beams,).
        clock_ns: After how long the sensor's clock begins anew; None: it says the date.
    """

    name: str
    mode: int
    returns: tuple[str, ...]
    elevation_deg: Float64[np.ndarray, " beams"]
    up_m: Float64[np.ndarray, " beams"]
    clock_ns: int | None = None

    @abstractmethod
    def valid(self, packets: UInt8[np.ndarray, "packets bytes"]) -> Bool[np.ndarray, " packets"]:
        """Which packets are of this model, layout and mode."""

    @abstractmethod
    def heads(self, packets: UInt8[np.ndarray, "packets bytes"]) -> Heads:
        """When and where the firings of packets began, quickly."""

    @abstractmethod
    def firings(self, packets: UInt8[np.ndarray, "packets bytes"]) -> Firings:
        """What packets measured, a row a firing in the order of :meth:`heads`."""

    @property
    def rings(self) -> Int64[np.ndarray, " beams"]:
        """Number of each beam from above, shape (beams,)."""
        rings = np.empty(len(self.elevation_deg), dtype=np.int64)
        rings[np.argsort(-self.elevation_deg, kind="stable")] = np.arange(len(rings))
        return rings

"""What a rig is, a measuring car with its sensors, and the registry of rigs, one record each.

All that is one rig's own stands in its file below ``rigs``.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

from farfield.frame import Frame
from farfield.registry import Registry


@runtime_checkable
class FrameWriter(Protocol):
    """Writes frames in a data set's layout."""

    root: Path

    def paths(self, frame: Frame) -> dict[str, Path]:
        """The file of each part of a frame."""

    def write(self, frame: Frame) -> dict[str, Path]:
        """Write a frame; returns what ``paths`` does."""


@dataclass(frozen=True, kw_only=True)
class Rig:
    """One measuring car.

    Args:
        sensors: Its sensors, in its own order.
        segment_name: Format of its sequences' names, of ``sequence`` (from 0) and ``number`` (from 1).
        frame: Makes a frame without its pose, of a :class:`~farfield.simulation.rigs.drive.SimulatedDrive`, the frame's
            index, its sensors and its time in nanoseconds; nothing may be simulated before it is read.
        writer: Makes the writer of its frames, of a folder and a preset; usually ``functools.partial`` or a class.
        caches: Whether a fast binary cache can be written beside its clouds.
        finishes: Whether its writer's ``finish()`` writes what belongs to whole sequences.
    """

    sensors: tuple[str, ...]
    segment_name: str
    frame: Callable[..., Frame]
    writer: Callable[..., FrameWriter]
    caches: bool = False
    finishes: bool = False


RIGS: Registry[Rig] = Registry(
    "farfield.rigs",
    "rig",
    {name: f"farfield.simulation.rigs.{name}:RIG" for name in ("cirrus", "kradar", "kitti", "radiate")},
)
"""Rigs by name; a package adds one by an entry point of group ``farfield.rigs``, a notebook by ``RIGS.register``."""

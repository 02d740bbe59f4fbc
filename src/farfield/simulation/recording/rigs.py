"""How the frames of each simulated rig are written: one line a rig."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from farfield.errors import ConfigError

if TYPE_CHECKING:
    from farfield.frame import Frame
    from farfield.simulation import Preset


@runtime_checkable
class FrameWriter(Protocol):
    """Writes frames in a data set's layout."""

    root: Path

    def paths(self, frame: "Frame") -> dict[str, Path]:
        """The file of each part of a frame."""

    def write(self, frame: "Frame") -> dict[str, Path]:
        """Write a frame; returns what ``paths`` does."""


@dataclass(frozen=True, kw_only=True)
class RigFiles:
    """How a rig's frames are written.

    Args:
        writer: Makes the writer of a preset's frames for a folder.
        caches: Whether a fast binary cache can be written beside its clouds.
        finishes: Whether its writer's ``finish()`` writes what belongs to whole sequences.
    """

    writer: Callable[["Preset", Path], Any]
    caches: bool = False
    finishes: bool = False


def _cirrus(preset: "Preset", root: Path) -> FrameWriter:  # noqa: ARG001
    from farfield.datasets.cirrus import CirrusWriter

    return CirrusWriter(root)


def _kradar(preset: "Preset", root: Path) -> FrameWriter:
    from farfield.datasets.kradar import KRadarWriter

    return KRadarWriter(root, columns=preset.columns)


def _kitti(preset: "Preset", root: Path) -> FrameWriter:  # noqa: ARG001
    from farfield.simulation.recording.kitti import SimulatedKittiWriter

    return SimulatedKittiWriter(root)


def _radiate(preset: "Preset", root: Path) -> FrameWriter:  # noqa: ARG001
    from farfield.simulation.recording.radiate import SimulatedRadiateWriter

    return SimulatedRadiateWriter(root)


RIGS = {
    "cirrus": RigFiles(writer=_cirrus, caches=True),
    "kradar": RigFiles(writer=_kradar, finishes=True),
    "kitti": RigFiles(writer=_kitti, finishes=True),
    "radiate": RigFiles(writer=_radiate, finishes=True),
}


def files_of(preset: "Preset") -> RigFiles:
    """How a preset's frames are written.

    Raises:
        ConfigError: If no data set's layout takes the frames of its rig.
    """
    if preset.rig not in RIGS:
        known = ", ".join(RIGS)
        raise ConfigError(f"preset {preset.name}: expected a rig that can be written, one of {known}; got {preset.rig}")
    return RIGS[preset.rig]


def writer_for(preset: "Preset", root: Path | str) -> Any:
    """The writer of the data set that a preset's rig simulates."""
    return files_of(preset).writer(preset, Path(root))

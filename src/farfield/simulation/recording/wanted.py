"""Simulate where the data are absent or begun: what an experiment that describes its own data needs."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, model_serializer

from farfield.frame.provenance import SIMULATION_FILE
from farfield.jobs.runs import Progress
from farfield.simulation.recording.rigs import files_of
from farfield.simulation.recording.settings import RecordingOptions
from farfield.simulation.recording.simulated import RecordingSummary, record
from farfield.vocabulary.conditions import Side


class SimulationConfig(BaseModel):
    """A simulated data set that is made where ``data.path`` does not exist yet."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    preset: str = Field(description="which one, as `farfield simulate --help` lists them")
    sequences: int = Field(ge=1, description="drives")
    frames: int = Field(ge=1, description="frames of each sequence")
    seed: int = Field(0, description="another seed gives other roads and traffic")
    sensors: str | None = Field(None, description="what to write, separated by commas; the preset's own if left out")
    stride_s: float | None = Field(None, gt=0, le=1, description="time between frames; the preset's own if left out")
    traffic: Side | None = Field(None, description="on which side it keeps; the preset's own if left out")

    @model_serializer(mode="wrap")
    def _said(self, others: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        """All settings; the side only where it is said, so that data and trainings are known as before."""
        return {name: value for name, value in others(self).items() if name != "traffic" or value is not None}


def ensure(
    wanted: SimulationConfig | None,
    path: Path,
    progress: Progress = iter,
    report: Callable[[str], object] | None = None,
) -> RecordingSummary | None:
    """Simulate a data set where there is none yet, or go on with one that was begun; leave other data as they are.

    Args:
        wanted: What to simulate; None leaves everything as it is.
        path: Where the data set stands or is going to stand; a relative path starts at the current folder.
        progress: As of ``record``.
        report: As of ``record``.

    Returns:
        What was recorded; None if nothing had to be simulated.

    Raises:
        ConfigError, DatasetError: As of ``record``.
    """
    begun = (path / SIMULATION_FILE).is_file()  # then the rest is simulated, or nothing is missing
    if wanted is None or (path.exists() and not begun):
        return None
    return _recorded(wanted, path, progress=progress, report=report)


def planned(wanted: SimulationConfig, path: Path) -> RecordingOptions:
    """What :func:`ensure` would record into an absent folder; nothing is written.

    Raises:
        ConfigError: As of ``record``.
    """
    return _recorded(wanted, path, dry_run=True).recording


def _recorded(wanted: SimulationConfig, path: Path, **how: Any) -> RecordingSummary:
    from farfield.simulation import find_preset

    return record(
        wanted.preset,
        path,
        frames=wanted.sequences * wanted.frames,
        sequences=wanted.sequences,
        sensors=wanted.sensors,
        seed=wanted.seed,
        stride_s=wanted.stride_s,
        traffic=wanted.traffic,
        cache=files_of(find_preset(wanted.preset)).caches,
        **how,
    )

"""Where the data of a grid stand: the user's, or simulated once and gone on with after an interruption."""

import hashlib
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from farfield.datasets import Dataset, open_dataset
from farfield.errors import ConfigError
from farfield.files.sizes import sized
from farfield.frame.provenance import SIMULATION_JOURNAL
from farfield.jobs import JobOptions
from farfield.papers.grid import ExperimentGrid, SimulatedSet
from farfield.simulation.recording import RecordingSummary, record
from farfield.simulation.recording.frames import bytes_needed

_DIGITS = 8


@dataclass(frozen=True, kw_only=True)
class DataLocation:
    """Where a data set stands.

    Args:
        path: Its folder.
        split: Which part of it; all if empty.
        simulated: What is simulated there; None for the user's data.
        options: Options of its reader.
        time: Time of day of all that is simulated, ``"day"`` or ``"night"``; None leaves it to the preset.
    """

    path: Path
    split: str = ""
    simulated: SimulatedSet | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    time: str | None = None

    @property
    def has_frames(self) -> bool:
        """Whether some of its frames are there; a simulation that was killed at its start leaves a folder without."""
        if self.simulated is None:
            return self.path.exists()
        journal = self.path / SIMULATION_JOURNAL
        return journal.is_file() and journal.stat().st_size > 0

    def open(self, **options: Any) -> Dataset:
        """Its frames; options of the reader besides its own."""
        data = open_dataset(self.path, **{**self.options, **options})
        return data.split(self.split) if self.split else data


def locations_of(
    grid: ExperimentGrid, budget: str, folder: Path, *, data: Path | None = None, source: Path | None = None
) -> dict[str, DataLocation]:
    """The location of each set that a budget needs.

    Args:
        grid: The grid.
        budget: Name of the budget.
        folder: Where simulated sets stand, each in a folder named by a hash of its settings.
        data: The user's data set; without one all is simulated.
        source: The user's data of the other device; without them it is simulated.

    Raises:
        ConfigError: If a folder is not there.
    """
    folders = {"data": data, "source": source}
    for option, path in folders.items():
        if path is not None and not path.is_dir():
            raise ConfigError(f"--{option}: expected a folder, found none at {path}")
    locations: dict[str, DataLocation] = {}
    for name in grid.sets_of(budget):
        simulated = grid.budgets[budget].sets[name]
        real = grid.real.get(name)
        path = folders[real.of] if real is not None else None
        if real is not None and path is not None:
            locations[name] = DataLocation(path=path, split=real.split)
        elif data is None or real is not None:
            digest = hashlib.sha256(simulated.model_dump_json().encode()).hexdigest()[:_DIGITS]
            locations[name] = DataLocation(path=folder / f"{name}-{digest}", simulated=simulated)
    return locations


def provide(
    locations: Mapping[str, DataLocation],
    *,
    options: JobOptions,
    report: Callable[[str], object] | None = None,
) -> float:
    """Simulate what is not there yet, complete frames only; called again it goes on.

    Args:
        locations: The sets; those of the user are left as they are.
        options: Who simulates them.
        report: Called with lines of what is done.

    Returns:
        Seconds that it took.
    """
    began = time.monotonic()
    for location in locations.values():
        if location.simulated is not None:
            simulate(
                location.simulated,
                location.path,
                time=location.time,
                workers=options.workers,
                engine=options.engine,
                address=options.address,
                progress=options.progress,
                report=report,
            )
    return time.monotonic() - began


def simulation_needed(locations: Iterable[DataLocation]) -> str:
    """What is still to be simulated, in words: number of frames and disk space; writes nothing.

    Args:
        locations: The sets.
    """
    frames, size = 0, 0.0
    for location in locations:
        if location.simulated is not None and not location.path.exists():
            recording = simulate(location.simulated, location.path, dry_run=True).recording
            frames += sum(recording.plan)
            size += bytes_needed(recording, sum(recording.plan))
    return f"{frames} simulated frames, at most {sized(size)}" if frames else "no frame to simulate"


def simulate(simulated: SimulatedSet, path: Path, **options: Any) -> RecordingSummary:
    """Simulate a set into a folder, with the fast cache of its clouds where its layout has one.

    Args:
        simulated: The set.
        path: The folder.
        options: Further options of ``record``.
    """
    from farfield.simulation import find_preset
    from farfield.simulation.rig import RIGS

    return record(
        simulated.preset,
        path,
        frames=simulated.sequences * simulated.frames,
        sequences=simulated.sequences,
        sensors=simulated.sensors,
        weather=simulated.weather,
        seed=simulated.seed,
        stride_s=simulated.stride_s,
        traffic=simulated.traffic,
        world=simulated.world,
        cache=RIGS[find_preset(simulated.preset).rig].caches,
        **options,
    )


def fingerprints_of(locations: Mapping[str, DataLocation]) -> dict[str, str]:
    """Fingerprint of the frames of each set."""
    return {name: location.open().fingerprint() for name, location in locations.items()}

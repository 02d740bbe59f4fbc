"""Where the data of a grid stand: the user's, or simulated once and gone on with after an interruption."""

import hashlib
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from farfield.datasets import Dataset, open_dataset
from farfield.errors import ConfigError
from farfield.jobs.runs import Progress
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
    """

    path: Path
    split: str = ""
    simulated: SimulatedSet | None = None
    options: Mapping[str, Any] = field(default_factory=dict)

    def opened(self) -> Dataset:
        """Its frames."""
        data = open_dataset(self.path, **self.options)
        return data.split(self.split) if self.split else data


def places_of(
    grid: ExperimentGrid, budget: str, folder: Path, *, data: Path | None = None, source: Path | None = None
) -> dict[str, DataLocation]:
    """The place of each set that a budget needs.

    Args:
        grid: The grid.
        budget: Name of the budget.
        folder: Where simulated sets stand, each in a folder named by what it is.
        data: The user's data set; without one all is simulated.
        source: The user's data of the other device; without them it is simulated.

    Raises:
        ConfigError: If a folder is not there.
    """
    given = {"data": data, "source": source}
    for what, path in given.items():
        if path is not None and not path.is_dir():
            raise ConfigError(f"--{what}: expected a folder, found none at {path}")
    found: dict[str, DataLocation] = {}
    for name in grid.sets_of(budget):
        simulated = grid.budgets[budget].sets[name]
        real = grid.real.get(name)
        path = given[real.of] if real is not None else None
        if real is not None and path is not None:
            found[name] = DataLocation(path=path, split=real.split)
        elif data is None or real is not None:
            said = hashlib.sha256(simulated.model_dump_json().encode()).hexdigest()[:_DIGITS]
            found[name] = DataLocation(path=folder / f"{name}-{said}", simulated=simulated)
    return found


def provide(
    places: Mapping[str, DataLocation],
    *,
    workers: int = 0,
    progress: Progress = iter,
    report: Callable[[str], object] | None = None,
) -> float:
    """Simulate what is not there yet, whole frames only; called again it goes on.

    Args:
        places: The places.
        workers: Processes; 0 takes as many as there are cores and memory for.
        progress: Wraps the numbers of the frames that are left.
        report: Called with lines of what is done.

    Returns:
        Seconds that it took.
    """
    began = time.monotonic()
    for place in places.values():
        wanted = place.simulated
        if wanted is not None:
            simulate(wanted, place.path, workers=workers, progress=progress, report=report)
    return time.monotonic() - began


def wanting(sets: Iterable[tuple[SimulatedSet | None, Path]]) -> str:
    """What is to be simulated, in words: frames and room of the sets that are not there; writes nothing.

    Args:
        sets: What is simulated, if it is, and where.
    """
    frames, size = 0, 0.0
    for wanted, path in sets:
        if wanted is not None and not path.exists():
            recording = simulate(wanted, path, dry_run=True).recording
            frames += sum(recording.plan)
            size += bytes_needed(recording, sum(recording.plan))
    return f"{frames} simulated frames, at most {size / 1e9:.2f} GB" if frames else "no frame to simulate"


def simulate(wanted: SimulatedSet, path: Path, **how: Any) -> RecordingSummary:
    """Simulate a set into a folder, with the fast cache of its clouds where its layout has one."""
    from farfield.simulation import find_preset
    from farfield.simulation.rig import RIGS

    return record(
        wanted.preset,
        path,
        frames=wanted.sequences * wanted.frames,
        sequences=wanted.sequences,
        sensors=wanted.sensors,
        weather=wanted.weather,
        seed=wanted.seed,
        stride_s=wanted.stride_s,
        traffic=wanted.traffic,
        cache=RIGS[find_preset(wanted.preset).rig].caches,
        **how,
    )


def fingerprints_of(places: Mapping[str, DataLocation]) -> dict[str, str]:
    """What tells the frames of each set."""
    return {name: place.opened().fingerprint() for name, place in places.items()}

"""The runs of a grid as ordinary experiments in the order in which they are done, each with a key of its causes."""

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from farfield.errors import ConfigError
from farfield.experiments.schema import Experiment
from farfield.papers.claims import Claim
from farfield.papers.grid import ExperimentGrid, GridRun, Tree, merged
from farfield.papers.places import DataLocation

_TRAINING_ROOMS = (
    "adaptation",
    "datasets",
    "detectors",
    "files",
    "frame",
    "geometry",
    "radar",
    "training",
    "vocabulary",
)
_SCORING_ROOMS = ("evaluation", "metrics")
_SOURCE = Path(__file__).resolve().parents[1]
_INERT = ("checkpoint_every_s", "log_every_steps", "tensorboard", "workers")
"""Settings of a training that change none of its weights."""
_KEY_DIGITS = 12


@dataclass(frozen=True, kw_only=True)
class TrainingJob:
    """One training, and what is scored of it.

    Args:
        runs: The grid's runs that it is: two runs of one experiment are one job.
        seed: Its seed.
        experiment: The experiment.
        key: Hash of the experiment, the data and the code that trains.
        clouds: Clouds that it is scored on.
        start: Folder of the job whose weights it starts from; empty for none.
        network: The budget's name of its network.
    """

    runs: tuple[str, ...]
    seed: int
    experiment: Experiment
    key: str
    clouds: tuple[str, ...]
    start: str = ""
    network: str = "grid"

    @property
    def folder(self) -> str:
        """Name of its folder."""
        return f"s{self.seed}-{self.runs[0]}-{self.key}"

    @property
    def kind(self) -> str:
        """Jobs of one kind take as long a step: what a step does, whatever it learns from."""
        tree = self.experiment.model_dump(mode="json")
        method = {name: value for name, value in tree["method"].items() if name != "start"}
        groups = tree["data"] if "path" not in tree["data"] else {"": tree["data"]}
        clouds = {name: group["clouds"] for name, group in groups.items()}
        said = [self.network, tree["detector"], method, clouds, tree["training"]["batch_size"]]
        return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()[:_KEY_DIGITS]


@dataclass(frozen=True, kw_only=True)
class DataLocations:
    """Where jobs find data: each set's place, and the fingerprint of the frames there.

    Args:
        places: Where the sets stand.
        fingerprints: What tells their frames, by set.
    """

    places: Mapping[str, DataLocation]
    fingerprints: Mapping[str, str] = field(default_factory=dict)


def jobs_of(
    grid: ExperimentGrid,
    budget: str,
    claims: Iterable[Claim],
    data: DataLocations,
    runs_folder: Path,
    *,
    steps_share: float = 1.0,
) -> list[TrainingJob]:
    """All jobs of a budget, seed by seed, so that an interrupted grid has whole tables of fewer seeds.

    Args:
        grid: The grid.
        budget: Name of the budget.
        claims: Claims, whose rows say on which clouds runs are scored besides their own.
        data: Where the data stand.
        runs_folder: Folder of all jobs' folders.
        steps_share: Share of the budget's steps.

    Raises:
        ConfigError: If there is no such budget.
    """
    if budget not in grid.budgets:
        raise ConfigError(f"budget: expected one of {', '.join(grid.budgets)}; got {budget!r}")
    clouds = _scored_clouds(grid, claims)
    chosen = grid.runs_of(budget)
    ordered = sorted(chosen, key=lambda name: bool(chosen[name].start))  # who gives a start comes before who takes it
    jobs: dict[str, TrainingJob] = {}
    for seed in range(grid.budgets[budget].seeds):
        own: dict[str, TrainingJob] = {}
        for name in ordered:
            job = _job(grid, budget, name, seed, data, runs_folder, own, steps_share)
            same = jobs.get(job.key)
            runs = (name,) if same is None else (*same.runs, name)
            scored = sorted({cloud for run in runs for cloud in clouds.get(run, ())})
            known = job if same is None else same
            own[name] = jobs[job.key] = TrainingJob(
                runs=runs,
                seed=seed,
                experiment=known.experiment,
                key=job.key,
                clouds=tuple(scored),
                start=known.start,
                network=known.network,
            )
    return list(jobs.values())


def waves(jobs: Iterable[TrainingJob]) -> list[list[TrainingJob]]:
    """Jobs that others start from, then all others; each seed by seed."""
    listed = list(jobs)
    awaited = {job.start for job in listed if job.start}
    first = [job for job in listed if job.folder in awaited]
    return [wave for wave in (first, [job for job in listed if job.folder not in awaited]) if wave]


def _scored_clouds(grid: ExperimentGrid, claims: Iterable[Claim]) -> dict[str, list[str]]:
    """Clouds that each run is scored on: those that claims name, and its own."""
    pairs = [pair for claim in claims for pair in (*claim.comparisons, *claim.controls)]
    rows = [row for pair in pairs for row in (pair.a, pair.b) if row.run]
    clouds: dict[str, list[str]] = {name: list(run.scored) for name, run in grid.runs.items()}
    for row in rows:
        if row.run in clouds:
            clouds[row.run].append(row.cloud or _only_cloud(grid.runs[row.run]))
    return clouds


def _only_cloud(run: GridRun) -> str:
    return next(iter(run.streams.values())).clouds[0]


def _job(
    grid: ExperimentGrid,
    budget: str,
    name: str,
    seed: int,
    data: DataLocations,
    runs_folder: Path,
    own: Mapping[str, TrainingJob],
    steps_share: float,
) -> TrainingJob:
    run, start = grid.runs[name], own.get(grid.runs[name].start)
    tree = _tree(grid, budget, name, seed, data, steps_share)
    if start is not None:
        tree["method"]["start"] = str(runs_folder / start.folder)
    experiment = Experiment.model_validate(tree)
    fingerprints = {stream: data.fingerprints.get(source.set, "") for stream, source in run.streams.items()}
    key = _key(experiment, fingerprints, start.key if start else "")
    return TrainingJob(
        runs=(name,),
        seed=seed,
        experiment=experiment,
        key=key,
        clouds=(),
        start=start.folder if start else "",
        network=run.network,
    )


def _tree(grid: ExperimentGrid, budget: str, name: str, seed: int, data: DataLocations, steps_share: float) -> Tree:
    """The experiment of a run as its YAML would have it."""
    run, settings = grid.runs[name], grid.budgets[budget].lowered(steps_share)
    groups = {
        stream: {
            "path": data.places[source.set].path,
            "split": data.places[source.set].split or None,
            "clouds": source.clouds,
            "part": source.part,
            "options": {**data.places[source.set].options, **source.options},
            "aliases": grid.aliases,
        }
        for stream, source in run.streams.items()
    }
    changes = {name: tree for name, tree in settings.augmentation.items() if name in run.augmentation}
    training = merged(grid.training, settings.training)
    training |= {
        "steps": settings.steps_for(run.network),
        "batch_size": round(run.batch * settings.batch),
        "seed": seed,
    }
    return {
        "name": f"{name}-s{seed}",
        "data": next(iter(groups.values())) if len(groups) == 1 else groups,
        "method": merged(settings.method.get(str(run.method["name"]), {}), run.method),
        "detector": settings.networks[run.network],
        "augmentation": merged(grid.augmentation, changes, run.augmentation),
        "training": training,
    }


def _key(experiment: Experiment, fingerprints: Mapping[str, str], start: str) -> str:
    tree: dict[str, Any] = experiment.model_dump(mode="json")
    del tree["name"]
    tree["method"].pop("start", None)
    for group in [tree["data"]] if "path" in tree["data"] else tree["data"].values():
        del group["path"]
    for setting in _INERT:
        tree["training"].pop(setting, None)
    rooms = (*_TRAINING_ROOMS, "simulation") if _lays_weather(tree) else _TRAINING_ROOMS
    said = [tree, dict(sorted(fingerprints.items())), start, code_digest(rooms)]
    return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()[:_KEY_DIGITS]


def _lays_weather(tree: Mapping[str, Any]) -> bool:
    """Whether an experiment lays the simulator's weather over its frames."""
    strong = tree["method"].get("strong") or {}
    return bool(tree["augmentation"].get("weather") or strong.get("weather"))


@cache
def code_digest(rooms: tuple[str, ...] = _SCORING_ROOMS) -> str:
    """Hash of the source of some rooms and of the plan of a run; by default of those that detect and score."""
    digest = hashlib.sha256()
    assert all((_SOURCE / room).is_dir() for room in rooms), "a room was renamed"
    files = sorted(path for room in rooms for path in (_SOURCE / room).rglob("*.py"))
    for path in [*files, _SOURCE / "experiments" / "plan.py"]:
        digest.update(path.relative_to(_SOURCE).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()

"""The runs of a grid as ordinary experiments in the order in which they are done, each with a key of its causes."""

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

from farfield.errors import ConfigError
from farfield.experiments.schema import Experiment
from farfield.papers.claims import Claim, ClaimSide
from farfield.papers.grid import ExperimentGrid, Tree, merge_trees
from farfield.papers.locations import DataLocation

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
_INERT = ("accelerator", "checkpoint_every_s", "log_every_steps", "tensorboard", "workers")
"""Settings of a training that do not change its weights, or by no more than rounding."""
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
        network: The budget's name of its network; of the table of transfer the world, whose clouds a step reads.
        fingerprints: Of the frames of its streams, as its key has them; empty where there are none yet.
    """

    runs: tuple[str, ...]
    seed: int
    experiment: Experiment
    key: str
    clouds: tuple[str, ...]
    start: str = ""
    network: str = "grid"
    fingerprints: Mapping[str, str] = field(default_factory=dict)

    @property
    def folder(self) -> str:
        """Name of its folder."""
        return f"s{self.seed}-{self.runs[0]}-{self.key}"

    @property
    def kind(self) -> str:
        """Hash of what a step does, whatever it learns from: the steps of jobs of one kind take equally long."""
        tree = self.experiment.model_dump(mode="json")
        method = {name: value for name, value in tree["method"].items() if name != "start"}
        groups = tree["data"] if "path" not in tree["data"] else {"": tree["data"]}
        clouds = {name: group["clouds"] for name, group in groups.items()}
        return _digest([self.network, tree["detector"], method, clouds, tree["training"]["batch_size"]])


@dataclass(frozen=True, kw_only=True)
class DataLocations:
    """Where jobs find data, and which frames stand there.

    Args:
        locations: Where the sets stand.
        fingerprints: Fingerprint of the frames of each set.
    """

    locations: Mapping[str, DataLocation]
    fingerprints: Mapping[str, str] = field(default_factory=dict)


def jobs_of(
    grid: ExperimentGrid,
    budget: str,
    claims: Iterable[Claim],
    data: DataLocations,
    runs_folder: Path,
    *,
    steps_share: float = 1.0,
    training: Tree | None = None,
) -> list[TrainingJob]:
    """All jobs of a budget, seed by seed, so that an interrupted grid has whole tables of fewer seeds.

    Args:
        grid: The grid.
        budget: Name of the budget.
        claims: Claims, whose rows say on which clouds runs are scored besides their own.
        data: Where the data stand.
        runs_folder: Folder of all jobs' folders.
        steps_share: Share of the budget's steps.
        training: Settings of all trainings that stand over those of the grid and the budget.

    Raises:
        ConfigError: If there is no such budget.
    """
    if budget not in grid.budgets:
        raise ConfigError(f"budget: expected one of {', '.join(grid.budgets)}; got {budget!r}")
    clouds = _scored_clouds(grid, claims)
    runs = grid.runs_of(budget)
    ordered = sorted(runs, key=lambda name: bool(runs[name].start))  # those that others start from come first
    jobs: dict[str, TrainingJob] = {}
    for seed in range(grid.budgets[budget].seeds):
        of_seed: dict[str, TrainingJob] = {}
        for name in ordered:
            start = of_seed.get(runs[name].start)
            job = _job(grid, budget, name, seed, data, runs_folder, start, steps_share, training or {})
            job = jobs.get(job.key, job)  # two runs of one experiment are one job
            names = tuple(dict.fromkeys((*job.runs, name)))
            scored = sorted({cloud for run in names for cloud in clouds.get(run, ())})
            of_seed[name] = jobs[job.key] = replace(job, runs=names, clouds=tuple(scored))
    return list(jobs.values())


def waves(jobs: Iterable[TrainingJob]) -> list[list[TrainingJob]]:
    """Jobs that others start from, then all others; each seed by seed."""
    every = list(jobs)
    starts = {job.start for job in every if job.start}
    first = [job for job in every if job.folder in starts]
    return [wave for wave in (first, [job for job in every if job.folder not in starts]) if wave]


def _scored_clouds(grid: ExperimentGrid, claims: Iterable[Claim]) -> dict[str, list[str]]:
    """Clouds that each run is scored on: those that claims name, and its own."""
    clouds: dict[str, list[str]] = {name: list(run.scored) for name, run in grid.runs.items()}
    for row in (row for claim in claims for pair in claim.pairs for row in (pair.a, pair.b)):
        if row.run in clouds:
            clouds[row.run].append(cloud_of(row, grid))
    return clouds


def cloud_of(row: ClaimSide, grid: ExperimentGrid) -> str:
    """The cloud that a row is scored on: the one it names, or the only one that its run learns from."""
    return row.cloud or next(iter(grid.runs[row.run].streams.values())).clouds[0]


def _job(
    grid: ExperimentGrid,
    budget: str,
    name: str,
    seed: int,
    data: DataLocations,
    runs_folder: Path,
    start: TrainingJob | None,
    steps_share: float,
    training: Tree,
) -> TrainingJob:
    run, tree = grid.runs[name], _tree(grid, budget, name, seed, data, steps_share, training)
    if start is not None:
        tree["method"]["start"] = str(runs_folder / start.folder)
    experiment = Experiment.model_validate(tree)
    fingerprints = {stream: data.fingerprints.get(source.set, "") for stream, source in run.streams.items()}
    return TrainingJob(
        runs=(name,),
        seed=seed,
        experiment=experiment,
        key=_key(experiment, fingerprints, start.key if start else ""),
        clouds=(),
        start=start.folder if start else "",
        network=run.network,
        fingerprints=fingerprints,
    )


def _tree(
    grid: ExperimentGrid,
    budget: str,
    name: str,
    seed: int,
    data: DataLocations,
    steps_share: float,
    training_over: Tree,
) -> Tree:
    """The experiment of a run as its YAML would have it."""
    run, settings = grid.runs[name], grid.budgets[budget].lowered(steps_share)
    groups = {
        stream: {
            "path": data.locations[source.set].path,
            "split": data.locations[source.set].split or None,
            "clouds": source.clouds,
            "part": source.part,
            "options": {**data.locations[source.set].options, **source.options},
            "aliases": grid.aliases,
        }
        for stream, source in run.streams.items()
    }
    changes = {name: tree for name, tree in settings.augmentation.items() if name in run.augmentation}
    training = merge_trees(grid.training, settings.training, training_over)
    training |= {
        "steps": settings.steps_for(run.network),
        "batch_size": round(run.batch * settings.batch),
        "seed": seed,
    }
    return {
        "name": f"{name}-s{seed}",
        "data": next(iter(groups.values())) if len(groups) == 1 else groups,
        "method": merge_trees(settings.method.get(str(run.method["name"]), {}), run.method),
        "detector": settings.networks[run.network],
        "augmentation": merge_trees(grid.augmentation, changes, run.augmentation),
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
    strong = tree["method"].get("strong") or {}
    simulates = bool(tree["augmentation"].get("weather") or strong.get("weather"))  # weather laid over its frames
    rooms = (*_TRAINING_ROOMS, "simulation") if simulates else _TRAINING_ROOMS
    return _digest([tree, dict(sorted(fingerprints.items())), start, code_digest(rooms)])


def _digest(tree: list[Any]) -> str:
    return hashlib.sha256(json.dumps(tree, sort_keys=True).encode()).hexdigest()[:_KEY_DIGITS]


@cache
def code_digest(rooms: tuple[str, ...] = _SCORING_ROOMS) -> str:
    """Hash of the source of some rooms, by default those that detect and score, and of what runs an experiment."""
    digest = hashlib.sha256()
    assert all((_SOURCE / room).is_dir() for room in rooms), "a room was renamed"
    files = sorted(path for room in rooms for path in (_SOURCE / room).rglob("*.py"))
    for path in [*files, *(_SOURCE / "experiments" / name for name in ("frames.py", "plan.py"))]:
        digest.update(path.relative_to(_SOURCE).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()

"""The table of transfer (Paek et al., NeurIPS 2022, appendix G): worlds and their floors, scores, cost, results.

Jobs are done by the engine of the papers' grids (:mod:`farfield.papers.running`).
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from farfield.datasets import Dataset, open_dataset
from farfield.datasets.maps import CommonRadar, make
from farfield.detectors.runtime import Detector
from farfield.evaluation import detect
from farfield.experiments.frames import annotated_frames, part_of
from farfield.files.atomic import write_text
from farfield.files.json_text import read_json
from farfield.jobs import JobOptions
from farfield.jobs.folders import held
from farfield.jobs.runs import Progress
from farfield.metrics.deciding import figure, sample
from farfield.papers.grid import Tree
from farfield.papers.jobs import TrainingJob, code_digest, waves
from farfield.papers.locations import DataLocation, provide, simulation_needed
from farfield.papers.planning import RunRate, measure, measure_simulating
from farfield.papers.running import SCORES, GridScoring, Report, clocks_of, do_all, no_progress, scores_of, silent
from farfield.papers.scoring import json_of_sample
from farfield.papers.transfer.results import lines_of, tree_of
from farfield.papers.transfer.table import CLOUD, TransferTable, share_of, transfer_jobs
from farfield.training.method import LABELLED
from farfield.vocabulary.counts import count_of

FLOORS = "floors.json"
STEPS = 6
"""Steps of each trial of a plan."""
_SCORING_ROOMS = ("training", "detectors", "evaluation", "metrics")
_CLOCK = ("training_s", "processor_s")


@dataclass(frozen=True)
class TransferScoring(GridScoring):
    """The worlds' data in their common form, and how a job is scored on them.

    Args:
        table: The table.
        folder: Folder of the data.
        floors: The file that holds the worlds' floors.
    """

    table: TransferTable
    folder: Path
    floors: Path

    memory_bytes = 2_000_000_000

    @property
    def digest(self) -> str:
        """Hash of all that decides the scores besides the weights."""
        return f"{self.table.digest} {code_digest(_SCORING_ROOMS)}"

    @property
    def locations(self) -> dict[str, DataLocation]:
        """Where the sets of the worlds with data of their own stand, by name of the folder."""
        sets = {
            self.table.set_name(name, part): simulated
            for name, world in self.table.worlds.items()
            for part, simulated in (("train", world.train), ("val", world.val))
        }
        return {name: DataLocation(path=self.folder / name, simulated=simulated) for name, simulated in sets.items()}

    def measure_floors(self) -> None:
        """Measure the floors that are not there yet, of the training sets, unless the table gives them."""
        floors = self._floors()
        for name, world in self.table.worlds.items():
            if name in floors:
                continue
            form = CommonRadar(**{**world.form, "floor_db": tuple(world.form.get("floor_db", (0.0,)))})
            if "floor_db" not in world.form:
                data = open_dataset(self.folder / self.table.set_name(name, "train"), **world.floor_options)
                step = max(1, len(data) // self.table.floor_frames)
                form = form.fitted(data[index] for index in range(0, len(data), step))
            floors[name] = dict(form.settings())
            write_text(self.floors, json.dumps(floors, indent=1) + "\n")

    def _floors(self) -> Tree:
        return dict(read_json(self.floors)) if self.floors.is_file() else {}

    def _in_common_form(self, world: str, part: str, *, drop_doppler: float = 0.0) -> Dataset:
        """A world's frames in the common form."""
        data = open_dataset(self.folder / self.table.set_name(world, part), **self.table.worlds[world].options)
        return data.mapped(make("common_radar", {**self._floors()[world], "drop_doppler": drop_doppler}))

    def frames(self, job: TrainingJob) -> Mapping[str, Dataset]:
        """The frames that a job learns from: the share of its world's training set."""
        row = self.table.rows[job.runs[0]]
        data = self._in_common_form(row.world, "train", drop_doppler=row.drop_doppler)
        return {LABELLED: annotated_frames(part_of(data, (0.0, share_of(job))), "skip")}

    def of_job(self, job: TrainingJob, weights: Path) -> Tree:
        """Detect in the ``"val"`` set of a job's world, and score."""
        data = self._in_common_form(self.table.rows[job.runs[0]].world, "val")
        detections = detect(Detector.load(weights), data, cloud=CLOUD, annotated_only=True)
        settings: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in self.table.score.settings.items()
        }
        scored = sample(
            detections,
            figure(self.table.metric),
            protocol=self.table.score.protocol,
            replicates=self.table.replicates,
            **settings,
        )
        annotations = detections.annotations.values()
        return {
            "row": job.runs[0],
            "share": share_of(job),
            "seed": job.seed,
            "value": scored.value,
            "sample": json_of_sample(scored),
            "frames": len(data),
            "objects": sum(list(annotation.boxes.label).count("vehicle") for annotation in annotations),
        }


@dataclass(frozen=True, kw_only=True)
class TransferExperiment:
    """The table of transfer in a folder; called again it resumes where it stopped.

    Args:
        table: The table.
        out: Folder of data, runs and the table.
        seeds: Those of the table unless given.
        workers: Processes, one thread each.
        engine: Where they work, as of :class:`~farfield.jobs.JobOptions`.
        address: Of Ray's cluster.
        progress: Makes what wraps the numbers of units that are left, by what is done.
        report: Called with lines of what is done.
    """

    table: TransferTable
    out: Path
    seeds: tuple[int, ...] | None = None
    workers: int = 1
    engine: str = "local"
    address: str = ""
    progress: Callable[[str], Progress] = no_progress
    report: Report = silent

    @property
    def runs_folder(self) -> Path:
        """Folder of the floors and of all runs; a table that declares something else has another."""
        return self.out / "runs" / self.table.digest[:8]

    @property
    def scoring(self) -> TransferScoring:
        """The data, and how they are scored."""
        return TransferScoring(self.table, self.out / "data", self.runs_folder / FLOORS)

    @property
    def jobs(self) -> list[TrainingJob]:
        """All trainings of the seeds."""
        return transfer_jobs(self.table, self.out / "data", self.runs_folder, self.seeds)

    def run(self) -> None:
        """Simulate, train and score all that is not done: first the rows that others start from."""
        scoring = self.scoring
        with held(self.out):
            self.runs_folder.mkdir(parents=True, exist_ok=True)
            # simulate, and measure the floors of the training sets
            simulating = self.progress("simulating")
            options = JobOptions(workers=self.workers, engine=self.engine, address=self.address, progress=simulating)
            provide(scoring.locations, options=options, report=self.report)
            scoring.measure_floors()
            # train and score
            options = replace(options, progress=self.progress("training"))
            do_all(self.jobs, self.runs_folder, scoring, options=options, report=self.report)

    def write(self) -> list[str]:
        """Decide, and write ``transfer.txt``, ``transfer.json`` and ``report.html`` of the runs done.

        Returns:
            The lines of the text.
        """
        from farfield.papers.transfer.page import write_transfer

        scores = self.scores()
        lines = lines_of(self.table, scores)
        tree = tree_of(self.table, scores, self.table.seeds * len(self.table.row_shares))
        write_text(self.out / "transfer.txt", "\n".join([*lines, ""]))
        write_text(self.out / "transfer.json", json.dumps(tree, indent=1) + "\n")
        write_transfer(self.out / "report.html", tree)
        return lines

    def scores(self) -> list[Tree]:
        """The scores of all finished runs of the table, with what they took; those that diverged are left out."""
        trees = []
        jobs = transfer_jobs(self.table, self.out / "data", self.runs_folder)
        for job in (job for wave in waves(jobs) for job in wave):
            if (self.runs_folder / job.folder / SCORES).is_file():
                scores = scores_of(job, self.runs_folder)
                if "clock" not in scores:  # older runs hold it
                    last = clocks_of(job, self.runs_folder)[-1:]
                    scores["clock"] = {name: clock[name] for clock in last for name in _CLOCK}
                trees += [] if scores.get("failed") else [scores]
        return trees

    def dry_run(self) -> list[str]:
        """What there is to do, in lines; writes nothing."""
        return [self._runs_line(), simulation_needed(self.scoring.locations.values())]

    def _runs_line(self) -> str:
        jobs = self.jobs
        return (
            f"{count_of(len(jobs), 'run')} of {count_of(self.table.training['steps'], 'step')}, "
            f"{len(waves(jobs)[0])} of them to start from"
        )

    def outline(self) -> list[str]:
        """What will be done, and what it will cost on this machine: measured in a minute or two, elsewhere."""
        table, jobs = self.table, self.jobs
        simulating_s, rates = measure_worlds(table)
        lines = [
            self._runs_line(),
            *(
                f"  {table.worlds[name].words}: {simulating_s[name]:.2f} s to simulate a frame, {rate.step_s:.2f} s a "
                f"step of {count_of(table.training['batch_size'], 'frame')}, {rate.frame_s:.2f} s to score a frame"
                for name, rate in rates.items()
            ),
            f"{'row':<84}{'seeds':>6}  frames to learn from",
        ]
        seeds = len({job.seed for job in jobs})
        for name in table.rows:
            shares = table.shares_of(name)
            frames = ", ".join(f"{table.frames_of(name, share):,} ({100 * share:g} %)" for share in shares)
            lines.append(f"{table.row_words(name)[:83]:<84}{seeds:>6}  {frames}")
        simulating, training = (seconds / 3600 for seconds in core_seconds(table, simulating_s, rates, jobs))
        lines.append(
            f"about {simulating + training:.1f} core-hours: {simulating:.1f} to simulate, {training:.1f} to train and "
            "score"
        )
        return lines


def measure_worlds(table: TransferTable) -> tuple[dict[str, float], dict[str, RunRate]]:
    """Of each world with data of its own the core seconds a simulated frame, and the rate of its runs.

    Args:
        table: The table.
    """
    worlds = [name for name, world in table.worlds.items() if not world.of]
    with TemporaryDirectory() as scratch:
        folder = Path(scratch)
        scoring = TransferScoring(table, folder / "data", folder / FLOORS)
        # a few frames of each training set, then a few steps of a row that starts from none
        sets = {f"{name}-train": scoring.locations[f"{name}-train"] for name in worlds}
        seconds, _ = measure_simulating(sets, sets, scoring.folder)
        scoring.measure_floors()
        jobs = [job for job in transfer_jobs(table, scoring.folder, folder / "runs", (0,)) if not job.start]
        by_world = {job.network: job for job in reversed(jobs) if share_of(job) == 1.0}
        rates = measure(list(by_world.values()), folder / "trials", JobOptions(), steps=STEPS, frames=scoring.frames)
    return (
        {name: seconds[f"{name}-train"] for name in worlds},
        {name: rates[by_world[name].kind] for name in worlds if name in by_world},
    )


def core_seconds(
    table: TransferTable, simulating_s: Mapping[str, float], rates: Mapping[str, RunRate], jobs: Sequence[TrainingJob]
) -> tuple[float, float]:
    """Seconds of a core to simulate the worlds, and to train and score the jobs.

    Args:
        table: The table.
        simulating_s: Of a frame of each world that has data of its own.
        rates: Of the runs in each such world.
        jobs: The jobs.
    """
    simulating = 0.0
    for name, frame_s in simulating_s.items():
        sets = (table.worlds[name].train, table.worlds[name].val)
        simulating += frame_s * sum(simulated.sequences * simulated.frames for simulated in sets)
    training = 0.0
    for job in jobs:
        row, rate = table.rows[job.runs[0]], rates[job.network]
        val = table.worlds[row.world].val
        steps: Any = table.training["steps"] if row.steps is None else row.steps
        training += rate.step_s * (steps + row.reestimate_batches) + rate.frame_s * val.sequences * val.frames
    return simulating, training

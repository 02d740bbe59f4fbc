"""Do the runs of the table of transfer: simulate, take the floors, train or go on, detect, keep what was scored."""

import json
import logging
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from farfield.datasets import Dataset, open_dataset
from farfield.datasets.maps import CommonRadar, make
from farfield.detectors.runtime import Detector
from farfield.evaluation import detect
from farfield.experiments.frames import annotated_frames, part_of
from farfield.experiments.plan import Plan
from farfield.experiments.schema import experiment_of
from farfield.files.atomic import write_text
from farfield.jobs import JobJournal, JobOptions, Unit, UnitResult, run
from farfield.metrics.deciding import figure, sample
from farfield.papers.jobs import code_digest
from farfield.papers.places import simulate, wanting
from farfield.papers.running import SPENT, CpuTime
from farfield.papers.scoring import json_of_sample
from farfield.papers.transfer.deciding import lines_of, tree_of
from farfield.papers.transfer.declared import TransferRun, TransferTable, experiment_tree, runs_of
from farfield.training.method import LABELLED
from farfield.training.report import TrainingReport

SCORES, WEIGHTS, FLOORS = "scores.json", "weights.safetensors", "floors.json"
CLOUD = "radar"


@dataclass(frozen=True)
class WorldSets:
    """Where the worlds' data stand, and the form in which they are seen.

    Args:
        table: The table.
        folder: Folder of the data.
        floors: The file that keeps the worlds' floors.
    """

    table: TransferTable
    folder: Path
    floors: Path

    def path(self, world: str, part: str) -> Path:
        """Folder of a world's ``"train"`` or ``"val"`` set."""
        return self.folder / f"{self.table.worlds[world].of or world}-{part}"

    def wanting(self) -> str:
        """What is to be simulated, in words."""
        worlds = self.table.worlds.items()
        training = [(world.train, self.path(name, "train")) for name, world in worlds]
        return wanting([*training, *((world.val, self.path(name, "val")) for name, world in worlds)])

    def provide(self, **how: Any) -> None:
        """Simulate what is not there yet, and take the floors of the training sets."""
        for name, world in ((name, world) for name, world in self.table.worlds.items() if not world.of):
            for part, wanted in (("train", world.train), ("val", world.val)):
                simulate(wanted, self.path(name, part), **how)
        kept = self._floors()
        for name in self.table.worlds:
            if name not in kept:
                kept[name] = dict(self._taken(name).settings())
                write_text(self.floors, json.dumps(kept, indent=1) + "\n")

    def _floors(self) -> dict[str, Any]:
        return dict(json.loads(self.floors.read_text(encoding="utf-8"))) if self.floors.is_file() else {}

    def _taken(self, name: str) -> CommonRadar:
        world = self.table.worlds[name]
        data = open_dataset(self.path(name, "train"), **world.floor_options)
        step = max(1, len(data) // self.table.floor_frames)
        form = CommonRadar(**{"floor_db": (0.0,), **world.form})
        if "floor_db" in world.form:
            return form
        return form.fitted(data[index] for index in range(0, len(data), step))

    def form(self, world: str, *, drop_doppler: float = 0.0) -> Any:
        """The map that brings a world's clouds into the common form."""
        return make("common_radar", {**self._floors()[world], "drop_doppler": drop_doppler})

    def seen(self, world: str, part: str, *, drop_doppler: float = 0.0) -> Dataset:
        """A world's frames in the common form."""
        data = open_dataset(self.path(world, part), **self.table.worlds[world].options)
        return data.mapped(self.form(world, drop_doppler=drop_doppler))


@dataclass(frozen=True)
class TransferTask:
    """Does a run in its folder; the unit's parameters are the run.

    Args:
        sets: The data.
        folder: Folder of all runs' folders.
    """

    sets: WorldSets
    folder: Path

    memory_bytes = 2_000_000_000
    own_process = True

    def __call__(self, unit: Unit) -> UnitResult:
        """Train unless the weights are there, detect, score, and write the scores."""
        wanted: TransferRun = unit.parameters
        home, began = self.folder / wanted.folder, time.monotonic()
        spending = CpuTime(home / SPENT)
        logging.getLogger("lightning_fabric").setLevel(logging.WARNING)
        if not (home / WEIGHTS).is_file():
            self._train(wanted, home, spending)
        spending.note()
        trained_s = time.monotonic() - began
        clock = {"training_s": round(trained_s, 1), "processor_s": 0.0}
        kept = self.score(wanted, home)
        clock["processor_s"] = round(spending.seconds, 1)
        write_text(home / SCORES, json.dumps({**kept, "clock": clock}) + "\n")
        (home / "checkpoint.pt").unlink(missing_ok=True)
        spending.done()
        return UnitResult(files=(home / SCORES,), clock=clock)

    def _train(self, wanted: TransferRun, home: Path, report: TrainingReport) -> None:
        table = self.sets.table
        row = table.rows[wanted.row]
        source = TransferRun(row=row.start, share=1.0, seed=wanted.seed)
        start = self.folder / source.folder / WEIGHTS if row.start else None
        path = self.sets.path(row.world, "train")
        experiment = experiment_of(experiment_tree(table, wanted, data=path, start=start), where=wanted.folder)
        seen = self.sets.seen(row.world, "train", drop_doppler=row.drop_doppler)
        data = annotated_frames(part_of(seen, (0.0, wanted.share)), "skip")
        Plan(experiment, home, data={LABELLED: data}).run(report)

    def score(self, wanted: TransferRun, home: Path) -> dict[str, Any]:
        """Detect in the world's ``"val"`` set with the weights in a folder, and score."""
        table = self.sets.table
        data = self.sets.seen(table.rows[wanted.row].world, "val")
        found = detect(Detector.load(home / WEIGHTS), data, cloud=CLOUD, annotated_only=True)
        settings: dict[str, Any] = {
            name: tuple(each) if isinstance(each, list) else each for name, each in table.score.settings.items()
        }
        taken = sample(
            found, figure(table.metric), protocol=table.score.protocol, replicates=table.replicates, **settings
        )
        objects = sum(list(annotation.boxes.label).count("vehicle") for annotation in found.annotations.values())
        said = {"row": wanted.row, "share": wanted.share, "seed": wanted.seed}
        return {**said, "value": taken.value, "sample": json_of_sample(taken), "frames": len(data), "objects": objects}


@dataclass(frozen=True, kw_only=True)
class TransferExperiment:
    """The table at work in a folder; called again it goes on where it stopped.

    Args:
        table: What is declared.
        out: Folder of data, runs and the table.
        seeds: Those of the table unless given.
        workers: Processes, one thread each.
        progress: Makes a wrapper of numbers of work that is left, from what the work is.
        said: Called with lines of what is done.
    """

    table: TransferTable
    out: Path
    seeds: tuple[int, ...] | None = None
    workers: int = 1
    progress: Callable[[str], Callable[[Iterable[int]], Iterable[int]]] | None = None
    said: Callable[[str], object] | None = None

    @property
    def sets(self) -> WorldSets:
        """The data."""
        return WorldSets(self.table, self.out / "data", self.runs_folder / FLOORS)

    def run(self) -> None:
        """Simulate, then do all runs: first those that others start from."""
        self.runs_folder.mkdir(parents=True, exist_ok=True)
        self.sets.provide(workers=self.workers, progress=self._bar("simulating"), report=self.said)
        setting = f"{self.table.digest} {code_digest(('training', 'detectors', 'evaluation', 'metrics'))}"
        journal = JobJournal(self.runs_folder / ".journal.jsonl", setting)
        for wave in runs_of(self.table, self.seeds):
            units = [Unit(each.folder, parameters=each) for each in wave]
            left = sum(not journal.has(unit) for unit in units)
            if left and self.said is not None:
                self.said(f"{left} of {len(units)} runs are left")
            bulk = JobOptions(workers=self.workers, progress=self._bar("training"))
            run(TransferTask(self.sets, self.runs_folder), units, bulk, journal=journal)

    @property
    def runs_folder(self) -> Path:
        """Folder of the floors and of all runs; a table that declares something else has another."""
        return self.out / "runs" / self.table.digest[:8]

    def _bar(self, what: str) -> Callable[[Iterable[int]], Iterable[int]]:
        return iter if self.progress is None else self.progress(what)

    def write(self) -> list[str]:
        """Write ``transfer.txt``, ``transfer.json`` and ``report.html`` of the runs done; returns the text's lines."""
        from farfield.papers.transfer_page import write_transfer

        scores = self.scores()
        lines = lines_of(self.table, scores)
        tree = tree_of(self.table, scores, sum(map(len, runs_of(self.table))))
        write_text(self.out / "transfer.txt", "\n".join([*lines, ""]))
        write_text(self.out / "transfer.json", json.dumps(tree, indent=1) + "\n")
        write_transfer(self.out / "report.html", tree)
        return lines

    def scores(self) -> list[dict[str, Any]]:
        """What all finished runs scored."""
        runs = [each for wave in runs_of(self.table) for each in wave]
        paths = [self.runs_folder / each.folder / SCORES for each in runs]
        return [json.loads(path.read_text(encoding="utf-8")) for path in paths if path.is_file()]

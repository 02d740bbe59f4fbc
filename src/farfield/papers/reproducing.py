"""A paper's tables by one command: plan, simulate, train, score, decide, write the page; resumable throughout."""

import hashlib
import json
import os
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from farfield.detectors.weights import load_weights
from farfield.errors import ConfigError
from farfield.files.atomic import read_bytes, write_text
from farfield.jobs import JobOptions
from farfield.jobs.folders import locked
from farfield.jobs.runs import Progress
from farfield.papers import planning
from farfield.papers.claims import Claims
from farfield.papers.claims import load as load_claims
from farfield.papers.deciding import DecisionRule, Scores
from farfield.papers.feature_maps import feature_maps
from farfield.papers.grid import BudgetSettings, ExperimentGrid, Tree, load_grid
from farfield.papers.jobs import DataLocations, TrainingJob, jobs_of
from farfield.papers.measuring import SMALL_BATCH, STEPS, RunRate, measure, measure_simulating
from farfield.papers.needs import needs_of
from farfield.papers.places import DataLocation, fingerprints_of, places_of, provide, wanting
from farfield.papers.running import WEIGHTS, clocks_of, do_all, done_jobs, scores_of
from farfield.papers.scenarios import scenarios_of, seeds_of
from farfield.papers.scoring import ScoringTask
from farfield.papers.sheets import measure_sheet, provide_sheets, sheet_places, sheets_of
from farfield.papers.statistics import objects_in
from farfield.papers.summary import ReproductionSummary, curves_of, summary_of
from farfield.vocabulary.patterns import PATTERNS

if TYPE_CHECKING:
    from farfield.papers.radar_sheets import SheetGroup

MEASURED, PLAN, SUMMARY, TIMING, PAGE = "measured.json", "plan.json", "reproduction.json", "timing.json", "report.html"
_MAX_BYTES = 1 << 26
Said = Callable[[str], object]


def _silent(line: str) -> None:
    del line


def _unseen(what: str) -> Progress:
    del what
    return iter


@dataclass(frozen=True, kw_only=True)
class Reproduction:
    """A paper's tables with a budget, in a folder.

    Args:
        grid: The grid.
        claims: The claims that it decides.
        out: The folder: data, runs, plan, summary, page.
        budget: Name of the budget.
        minutes: Minutes that the whole is to take at most; None for the budget's own core minutes.
        workers: Processes, one thread each; 0 for as many as there are cores.
        data: The user's data set; without one all is simulated.
        source: The user's data of the other device, for Table IV.
        measured_steps: Steps of each trial before the plan is made.
        progress: Makes what wraps the numbers of units that are left, by what is done.
        said: Called with each line for the user.

    Raises:
        ConfigError: If there is no such budget.
    """

    grid: ExperimentGrid
    claims: Claims
    out: Path
    budget: str = "laptop"
    minutes: float | None = None
    workers: int = 0
    data: Path | None = None
    source: Path | None = None
    measured_steps: int = STEPS
    progress: Callable[[str], Progress] = _unseen
    said: Said = _silent

    def __post_init__(self) -> None:
        if self.budget not in self.grid.budgets:
            raise ConfigError(f"--budget: expected one of {', '.join(self.grid.budgets)}; got {self.budget!r}")
        if self.minutes is not None and self.minutes <= 0:
            raise ConfigError(f"--minutes: expected more than 0, got {self.minutes:g}")

    @classmethod
    def of(cls, paper: str, **options: Any) -> "Reproduction":
        """The shipped grid and claims of a paper, ``"cirrus"`` or ``"kradar"``; options are the other fields."""
        return cls(grid=load_grid(paper), claims=load_claims(paper), **options)

    @property
    def paper(self) -> str:
        """The paper."""
        return self.grid.paper

    @property
    def settings(self) -> BudgetSettings:
        """What the budget makes of the grid."""
        return self.grid.budgets[self.budget]

    @property
    def hands(self) -> int:
        """Processes at a time."""
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        return self.workers or cores

    @property
    def simulated(self) -> bool:
        """Whether rows are scored on simulated frames."""
        return self.data is None

    @property
    def places(self) -> dict[str, DataLocation]:
        """Where each set stands."""
        return places_of(self.grid, self.budget, self.out / "data", data=self.data, source=self.source)

    def outline(self) -> planning.GridPlan:
        """The plan: measured first, then kept, so that the same command goes on with the same steps."""
        kept = _read(self.out / PLAN)
        if kept.get("asked") == self._asked:
            return planning.outline_of(kept["outline"])
        outline = self._planned()
        write_text(self.out / PLAN, json.dumps({"asked": self._asked, "outline": outline.to_json()}, indent=1) + "\n")
        return outline

    def rehearsed(self) -> list[str]:
        """What there is to do, in lines, measuring and writing nothing; the plan too where one was made before."""
        places, settings = self.places, self.settings
        jobs = self.jobs(places)
        steps = {job.network: settings.steps_for(job.network) for job in jobs}
        sets = [*places.values(), *self.sheet_places.values()]
        kept = _read(self.out / PLAN)
        known = kept.get("asked") == self._asked
        return [
            f"{len(jobs)} trainings; steps: {', '.join(f'{name} {count}' for name, count in steps.items())}",
            wanting((place.simulated, place.path) for place in sets),
            *(planning.described(planning.outline_of(kept["outline"])) if known else ()),
        ]

    @property
    def _asked(self) -> Tree:
        """What a plan was made for."""
        return {**self._measured_for, "minutes": self.minutes}

    @property
    def _measured_for(self) -> Tree:
        return {
            "budget": self.budget,
            "workers": self.hands,
            "grid": hashlib.sha256(self.grid.model_dump_json().encode()).hexdigest(),
            "data": None if self.data is None else str(self.data.resolve()),
            "source": None if self.source is None else str(self.source.resolve()),
        }

    @property
    def sheet_places(self) -> dict[str, DataLocation]:
        """Where the frames of the sheets are simulated, by weather; none where the page shows the user's or none."""
        if self.paper != "kradar" or not self.simulated:
            return {}
        return sheet_places(self.settings, self.out / "data")

    def _measured(self, places: Mapping[str, DataLocation]) -> tuple[dict[str, RunRate], dict[str, float], float]:
        """The pace of each kind of run, and core seconds a simulated frame by set and of a sheet: measured once."""
        kept = _read(self.out / MEASURED)
        if kept.get("for") == self._measured_for:
            return planning.paces_of(kept), dict(kept["simulating_s"]), float(kept.get("sheet_s", 0.0))
        scratch = self.out / ".measure"
        shutil.rmtree(scratch, ignore_errors=True)  # of a command that was killed: its frames would cost nothing
        self.out.mkdir(parents=True, exist_ok=True)
        needed = {stream.set for run in self.grid.runs_of(self.budget).values() for stream in run.streams.values()}
        self.said("measuring: a few simulated frames, then a few steps of each kind of run")
        simulating, small = measure_simulating(
            places, needed, scratch / "data", progress=self.progress("simulating a few frames")
        )
        sheet_s = measure_sheet(self.sheet_places, scratch / "data")
        bulk = JobOptions(workers=self.hands, progress=self.progress("measuring"))
        part = min(1.0, SMALL_BATCH / self.settings.batch)
        paces = measure(
            self.jobs(small), scratch / "runs", bulk, steps=self.measured_steps, batch_share=part, said=self.said
        )
        shutil.rmtree(scratch, ignore_errors=True)
        found = {
            "paces": {kind: asdict(pace) for kind, pace in paces.items()},
            "simulating_s": simulating,
            "sheet_s": sheet_s,
        }
        write_text(self.out / MEASURED, json.dumps({"for": self._measured_for, **found}, indent=1) + "\n")
        return paces, simulating, sheet_s

    def _planned(self) -> planning.GridPlan:
        places = self.places
        jobs = self.jobs(places)
        paces, simulating, sheet_s = self._measured(places)
        left = {name: seconds for name, seconds in simulating.items() if not places[name].path.exists()}
        frames = self._frames_scored(places)
        limits = [self.settings.core_minutes, None if self.minutes is None else self.minutes * self.hands]
        limit = min((each for each in limits if each is not None), default=None)
        sheets = [each.simulated for each in self.sheet_places.values() if not each.path.exists()]
        beside_s = sheet_s * sum(each.sequences * each.frames for each in sheets if each is not None)
        share, cost = planning.fitted(jobs, self.settings, paces, left, frames, limit, beside_s=beside_s)
        lowered = self.settings.lowered(share)
        networks = sorted({job.network for job in jobs})
        runs = tuple(self.grid.runs_of(self.budget))
        return planning.GridPlan(
            budget=self.budget,
            steps_share=share,
            steps={network: lowered.steps_for(network) for network in networks},
            jobs=len(jobs),
            rows=len(runs),
            seeds=self.settings.seeds,
            cost=cost,
            workers=self.hands,
            outlooks=planning.outlooks(self.claims, runs, self.settings),
            paces=paces,
            simulating_s=simulating,
        )

    def _frames_scored(self, places: Mapping[str, DataLocation]) -> int:
        total = 0
        for name in self._chosen(self.settings.scored_on, places):
            place = places[name]
            known = place.simulated
            total += len(place.opened()) if known is None else known.sequences * known.frames
        return total

    @staticmethod
    def _chosen(names: Iterable[str], places: Mapping[str, DataLocation]) -> list[str]:
        """Those of the sets that there are; the validation set where there is none of them."""
        return [name for name in names if name in places] or ["val"]

    def jobs(
        self,
        places: Mapping[str, DataLocation],
        fingerprints: Mapping[str, str] | None = None,
        *,
        steps_share: float = 1.0,
    ) -> list[TrainingJob]:
        """All trainings, seed by seed."""
        data = DataLocations(places=places, fingerprints=fingerprints or {})
        return jobs_of(self.grid, self.budget, self.claims, data, self._runs, steps_share=steps_share)

    @property
    def _runs(self) -> Path:
        return self.out / "runs"

    def run(self, *, page_only: bool = False) -> Path:
        """Do all that is not done, and write the summary and the page.

        Args:
            page_only: Do no run: the page of what is there.

        Returns:
            The page.

        Raises:
            ConfigError: If the plan does not fit into the minutes, nothing is there for a page, or another command is
                at work in the folder.
        """
        self.out.mkdir(parents=True, exist_ok=True)
        try:
            with nullcontext() if page_only else locked(self.out, shared=False):
                return self._run(page_only=page_only)
        except BlockingIOError as error:
            raise ConfigError(
                f"{self.out}: expected no other command at work in this folder, found one. Wait for it, or name "
                "another folder with --out; --page writes the page of what is done meanwhile."
            ) from error

    def _run(self, *, page_only: bool) -> Path:
        outline = self.outline()
        for line in planning.described(outline):
            self.said(line)
        places = self.places
        if not page_only:
            provide(places, workers=self.hands, progress=self.progress("simulating"), report=self.said)
        fingerprints = fingerprints_of(places)
        jobs = self.jobs(places, fingerprints, steps_share=outline.steps_share)
        scoring = self._scoring(places, fingerprints)
        if not page_only:
            do_all(
                jobs,
                self._runs,
                scoring,
                workers=self.hands,
                progress=self.progress("runs"),
                said=self.said,
            )
        done = done_jobs(jobs, self._runs, scoring)
        if not done:
            raise ConfigError(f"{self.out}: expected finished runs to write a page of, found none of {len(jobs)}")
        return self._conclude(outline, jobs, done, places, fingerprints)

    def _scoring(self, places: Mapping[str, DataLocation], fingerprints: Mapping[str, str]) -> ScoringTask:
        chosen = self._chosen(self.settings.scored_on, places)
        return ScoringTask(
            score=self.settings.score,
            places={name: places[name] for name in chosen},
            fingerprints={name: fingerprints[name] for name in chosen},
            needs=tuple(needs_of(self.claims, self.grid, self.settings.score)),
            replicates=self.settings.replicates,
        )

    def _conclude(
        self,
        outline: planning.GridPlan,
        jobs: Sequence[TrainingJob],
        done: Sequence[TrainingJob],
        places: Mapping[str, DataLocation],
        fingerprints: Mapping[str, str],
    ) -> Path:
        from farfield.papers.page import write_page

        self.said(f"deciding on {len(self.claims)} claims with {len(done)} of {len(jobs)} runs")
        kept = [scores_of(job, self._runs) for job in done]
        scores = Scores.of(kept)
        chosen = self._chosen(self.settings.statistics_on, places)
        bulk = JobOptions(workers=self.hands, progress=self.progress("counting points"))
        objects = objects_in({name: places[name] for name in chosen}, bulk)
        decided = DecisionRule(
            claims=self.claims, grid=self.grid, settings=self.settings, scores=scores, objects=objects
        ).decided()
        made = ReproductionSummary(
            paper=self.paper,
            budget=self.budget,
            simulated=self.simulated,
            steps=outline.steps,
            planned=len(jobs),
            done=len(done),
            failed=[(each["runs"][0], each["seed"], each["failed"]) for each in kept if each.get("failed")],
            sets={name: (fingerprints[name], place.simulated) for name, place in places.items()},
            trained_on=[load_weights(path)[1] for path in self._all_weights(done)],
        )
        summary = summary_of(made, self.grid, self.claims, scores, objects, decided)
        sheets = self._sheets(done, places)
        summary["sheets"] = [{"title": group.title, "frames": group.facts()} for group in sheets]
        summary["features"] = self._features(done, places)
        summary["scenarios"] = self._scenarios(done, self._scoring(places, fingerprints))
        write_text(self.out / SUMMARY, json.dumps(summary, indent=1) + "\n")
        runs = {job.folder: {"runs": list(job.runs), "clock": clocks_of(job, self._runs)} for job in done}
        timing = {"planned": outline.to_json(), "runs": runs}
        write_text(self.out / TIMING, json.dumps(timing, indent=1) + "\n")
        curves = curves_of(scores, self.settings.score)
        return write_page(self.out / PAGE, summary, timing, curves=curves, objects=objects.columns, sheets=sheets)

    def _all_weights(self, done: Sequence[TrainingJob]) -> list[Path]:
        """Weights of all runs that have any: one that diverged has none."""
        files = [self._runs / job.folder / WEIGHTS for job in done]
        return [path for path in files if path.is_file()]

    def _weights(self, done: Sequence[TrainingJob]) -> dict[str, Path]:
        """Weights of the first seed by run."""
        files = {run: self._runs / job.folder / WEIGHTS for job in done if job.seed == 0 for run in job.runs}
        return {run: path for run, path in files.items() if path.is_file()}

    def _features(self, done: Sequence[TrainingJob], places: Mapping[str, DataLocation]) -> list[Tree]:
        (first, *_) = self._chosen(self.settings.scored_on, places)
        return feature_maps(self._weights(done), places[first], self.settings.score)

    def _sheets(self, done: Sequence[TrainingJob], places: Mapping[str, DataLocation]) -> "list[SheetGroup]":
        """K-Radar's sheets; their frames are simulated now if they are not there yet."""
        if self.paper != "kradar":
            return []
        own = self.sheet_places
        provide_sheets(own, workers=self.hands, progress=self.progress("simulating the sheets"), report=self.said)
        (first, *_) = self._chosen(self.settings.scored_on, places)
        data = None if self.simulated else places[first]
        return sheets_of(own, data, self._weights(done), self.settings)

    def _scenarios(self, done: Sequence[TrainingJob], scoring: ScoringTask) -> Tree:
        seeds = seeds_of(job for job in done if (self._runs / job.folder / WEIGHTS).is_file())
        runs = {
            name: [scoring.detections(self._runs / jobs[name].folder / WEIGHTS, name) for jobs in seeds.values()]
            for name in PATTERNS
        }
        return scenarios_of(runs, scoring.score)


def _read(path: Path) -> Tree:
    if not path.is_file():
        return {}
    try:
        return dict(json.loads(read_bytes(path, max_bytes=_MAX_BYTES)))
    except ValueError:
        return {}  # cut off or foreign: planned anew

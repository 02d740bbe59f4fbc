"""A paper's tables by one command: plan, simulate, train, score, decide, write the page; resumable throughout.

Cirrus (Wang et al., ICRA 2021), Tables I to VI; K-Radar (Paek et al., NeurIPS 2022), Tables 3, 4 and 9.
"""

import hashlib
import json
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from farfield.detectors.devices import chosen_device
from farfield.detectors.weights import load_weights
from farfield.errors import ConfigError
from farfield.files.atomic import read_bytes, write_text
from farfield.files.json_text import plain_json
from farfield.jobs import JobOptions
from farfield.jobs.folders import held
from farfield.jobs.process import usable_cores
from farfield.jobs.runs import Progress
from farfield.papers import planning
from farfield.papers.claim_rows import SUMMARY, TIMING
from farfield.papers.claims import Claims
from farfield.papers.claims import load as load_claims
from farfield.papers.deciding import DecisionRule, Scores
from farfield.papers.feature_maps import feature_maps
from farfield.papers.fingerprints import learnt_fingerprints, note_fingerprints
from farfield.papers.grid import BudgetSettings, ExperimentGrid, Tree, load_grid
from farfield.papers.jobs import DataLocations, TrainingJob, jobs_of
from farfield.papers.locations import DataLocation, fingerprints_of, locations_of, provide, simulation_needed
from farfield.papers.prospects import outlooks
from farfield.papers.running import (
    SCORES,
    WEIGHTS,
    Report,
    clocks_of,
    do_all,
    done_jobs,
    no_progress,
    scores_of,
    silent,
    train_all,
)
from farfield.papers.scenarios import scenarios_of, seeds_of
from farfield.papers.scoring import ScoringTask, needs_of
from farfield.papers.sheets import SheetGroup, sheet_locations, sheets_of
from farfield.papers.statistics import objects_in
from farfield.papers.summary import ReproductionSummary, curves_of, summary_of
from farfield.papers.validation import validation_of
from farfield.vocabulary.counts import count_of
from farfield.vocabulary.patterns import PATTERNS

MEASURED, PLAN, PAGE = "measured.json", "plan.json", "report.html"
_MAX_BYTES = 1 << 26
_ACCELERATORS = {"auto": "auto", "cpu": "cpu", "cuda": "gpu"}
"""What a training calls the devices."""
_PRECISIONS = ("", "auto", "fp32", "bf16")


@contextmanager
def sole_command(out: Path) -> Iterator[None]:
    """Keep other commands from a folder.

    Raises:
        ConfigError: If another command is at work there.
    """
    with held(out, fix="Wait for it, or name another folder with --out; --page writes the page of what is done."):
        yield


@dataclass(frozen=True, kw_only=True)
class Reproduction:
    """A paper's tables with a budget, in a folder.

    Args:
        grid: The grid.
        claims: The claims that it decides.
        out: The folder: data, runs, plan, summary, page.
        budget: Name of the budget.
        minutes: Minutes that all of it takes at most; None for the budget's own core minutes.
        workers: Processes, one thread each; 0 for as many as there are cores.
        engine: Where they work: ``"local"``, ``"ray"``, or an installed engine's name. Costs are measured here.
        address: Of Ray's cluster.
        data: The user's data set; without one all is simulated.
        source: The user's data of the other device, for Table IV.
        device: What trains and detects: ``"auto"``, ``"cpu"`` or ``"cuda"``, a GPU that all workers share.
        precision: Number type of all trainings: ``"auto"``, ``"fp32"`` or ``"bf16"``; empty for the budget's.
        measured_steps: Steps of each trial before the plan is made.
        progress: Makes what wraps the numbers of units that are left, by what is done.
        report: Called with each line for the user.

    Raises:
        ConfigError: If there is no such budget, device or precision.
    """

    grid: ExperimentGrid
    claims: Claims
    out: Path
    budget: str = "laptop"
    minutes: float | None = None
    workers: int = 0
    engine: str = "local"
    address: str = ""
    data: Path | None = None
    source: Path | None = None
    device: str = "auto"
    precision: str = ""
    measured_steps: int = planning.STEPS
    progress: Callable[[str], Progress] = no_progress
    report: Report = silent

    def __post_init__(self) -> None:
        if self.budget not in self.grid.budgets:
            raise ConfigError(f"--budget: expected one of {', '.join(self.grid.budgets)}; got {self.budget!r}")
        if self.minutes is not None and self.minutes <= 0:
            raise ConfigError(f"--minutes: expected more than 0, got {self.minutes:g}")
        if self.device not in _ACCELERATORS:
            raise ConfigError(f"--device: expected one of {', '.join(_ACCELERATORS)}; got {self.device!r}")
        if self.precision not in _PRECISIONS:
            raise ConfigError(f"--precision: expected one of {', '.join(_PRECISIONS[1:])}; got {self.precision!r}")

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
    def num_workers(self) -> int:
        """Processes at a time."""
        return self.workers or usable_cores()

    def _options(self, what: str) -> JobOptions:
        """Who does the units of a part, with its bar."""
        workers = self.num_workers if self.engine == "local" else self.workers  # 0: as many as a cluster has room for
        return JobOptions(workers=workers, engine=self.engine, address=self.address, progress=self.progress(what))

    @property
    def simulated(self) -> bool:
        """Whether rows are scored on simulated frames."""
        return self.data is None

    @property
    def locations(self) -> dict[str, DataLocation]:
        """Where each set stands."""
        return locations_of(self.grid, self.budget, self.out / "data", data=self.data, source=self.source)

    @property
    def sheet_locations(self) -> dict[str, DataLocation]:
        """Where the frames of the sheets are simulated, by weather; none where the page shows the user's or none."""
        if self.paper != "kradar" or not self.simulated:
            return {}
        return sheet_locations(self.settings, self.out / "data")

    @property
    def _runs(self) -> Path:
        return self.out / "runs"

    def jobs(
        self,
        locations: Mapping[str, DataLocation],
        fingerprints: Mapping[str, str] | None = None,
        *,
        steps_share: float = 1.0,
    ) -> list[TrainingJob]:
        """All trainings, seed by seed."""
        data = DataLocations(locations=locations, fingerprints=fingerprints or {})
        training: Tree = {} if self.device == "auto" else {"accelerator": _ACCELERATORS[self.device]}
        training |= {"precision": self.precision} if self.precision else {}
        return jobs_of(
            self.grid, self.budget, self.claims, data, self._runs, steps_share=steps_share, training=training
        )

    def train(self) -> list[TrainingJob]:
        """Simulate what runs learn from and train all that is not trained, as :meth:`run` would, and score nothing.

        Where nothing limits the minutes, the steps are those of the budget and nothing is measured first. The folder
        may then be taken to another machine, without its data: there :meth:`run`, with this name of the folder and the
        same code, trains what is left and scores.

        Returns:
            The trainings whose weights are not there: those that diverged.

        Raises:
            ConfigError: If the plan does not fit into the minutes, there is no such device, or another command is at
                work in the folder.
        """
        chosen_device(self.device)
        with sole_command(self.out):
            shutil.rmtree(self._scratch, ignore_errors=True)
            share = self.outline().steps_share if self._limited else 1.0
            locations, learnt = self.locations, self._learnt()
            needed = {name: locations[name] for name in sorted(self._untrained(share))}
            provide(needed, options=self._options("simulating"), report=self.report)
            fingerprints = learnt_fingerprints(self.out, locations, learnt)
            note_fingerprints(self.out, locations, fingerprints)
            jobs = self.jobs(locations, fingerprints, steps_share=share)
            scoring = self._scoring(locations, {})
            train_all(jobs, self._runs, scoring, options=self._options("trainings"), report=self.report)
        return [job for job in jobs if not (self._runs / job.folder / WEIGHTS).is_file()]

    def run(self, *, page_only: bool = False) -> Path:
        """Do all that is not done, and write the summary and the page.

        The steps: plan, simulate the sets that are not there, train and score run by run, decide on the claims, and
        show the paper's tables beside ours.

        Args:
            page_only: Do no run: the page of what is there.

        Returns:
            The page.

        Raises:
            ConfigError: If the plan does not fit into the minutes, nothing is there for a page, or another command is
                at work in the folder.
        """
        chosen_device(self.device)
        if page_only:
            self.out.mkdir(parents=True, exist_ok=True)
            return self._run(page_only=True)
        with sole_command(self.out):
            shutil.rmtree(self._scratch, ignore_errors=True)
            return self._run(page_only=False)

    def _run(self, *, page_only: bool) -> Path:
        # plan
        outline = self.outline()
        for line in planning.described(outline):
            self.report(line)
        # simulate
        locations, share = self.locations, outline.steps_share
        learnt = self._learnt()
        if not page_only:
            others = set(locations) - learnt
            needed = {name: locations[name] for name in locations if name in others | self._untrained(share)}
            provide(needed, options=self._options("simulating"), report=self.report)
        fingerprints = learnt_fingerprints(self.out, locations, learnt)
        if not page_only:
            note_fingerprints(self.out, locations, fingerprints)
        fingerprints |= fingerprints_of({name: locations[name] for name in locations if name not in learnt})
        # train and score
        jobs = self.jobs(locations, fingerprints, steps_share=share)
        scoring = self._scoring(locations, fingerprints)
        if not page_only:
            do_all(jobs, self._runs, scoring, options=self._options("runs"), report=self.report)
        done = done_jobs(jobs, self._runs, scoring)
        if not done:
            raise ConfigError(f"{self.out}: expected finished runs to write a page of, found none of {len(jobs)}")
        # decide and show
        return self._conclude(outline, jobs, done, locations, scoring, fingerprints)

    # Planning

    def outline(self) -> planning.GridPlan:
        """The plan: measured first, then stored, so that the same command goes on with the same steps."""
        stored = _read(self.out / PLAN)
        if stored.get("asked") == self._planned_for:
            return planning.outline_of(stored["outline"])
        if not self._limited and not self._untrained():
            return self._unmeasured()
        outline = self._plan()
        tree = {"asked": self._planned_for, "outline": outline.to_json()}
        write_text(self.out / PLAN, json.dumps(tree, indent=1) + "\n")
        return outline

    def dry_run(self) -> list[str]:
        """What there is to do, in lines, measuring and writing nothing; the plan too where one was made before."""
        locations, settings = self.locations, self.settings
        jobs = self.jobs(locations)
        steps = {job.network: settings.steps_for(job.network) for job in jobs}
        stored = _read(self.out / PLAN)
        has_plan = stored.get("asked") == self._planned_for
        return [
            f"{len(jobs)} trainings; steps: {', '.join(f'{name} {count}' for name, count in steps.items())}",
            simulation_needed([*locations.values(), *self.sheet_locations.values()]),
            *(planning.described(planning.outline_of(stored["outline"])) if has_plan else ()),
        ]

    @property
    def _planned_for(self) -> Tree:
        """What a plan depends on."""
        return {**self._measured_for, "minutes": self.minutes}

    @property
    def _measured_for(self) -> Tree:
        """What measurements depend on."""
        return {
            "budget": self.budget,
            "workers": self.num_workers,
            "grid": hashlib.sha256(self.grid.model_dump_json().encode()).hexdigest(),
            "data": None if self.data is None else str(self.data.resolve()),
            "source": None if self.source is None else str(self.source.resolve()),
        }

    @property
    def _scratch(self) -> Path:
        """Where a command measures; one that was killed leaves it, and a plan for as many workers may be there."""
        return self.out / ".measure"

    def _measure(
        self, locations: Mapping[str, DataLocation]
    ) -> tuple[dict[str, planning.RunRate], dict[str, float], float]:
        """The rate of each kind of run, and core seconds a simulated frame by set and of a sheet: measured once."""
        stored = _read(self.out / MEASURED)
        if stored.get("for") == self._measured_for:
            return planning.rates_of(stored), dict(stored["simulating_s"]), float(stored.get("sheet_s", 0.0))
        scratch = self._scratch
        shutil.rmtree(scratch, ignore_errors=True)  # of a command that was killed: its frames would cost nothing
        self.out.mkdir(parents=True, exist_ok=True)
        needed = {stream.set for run in self.grid.runs_of(self.budget).values() for stream in run.streams.values()}
        self.report("measuring: a few simulated frames, then a few steps of each kind of run")
        simulating, small = planning.measure_simulating(
            locations, needed, scratch / "data", progress=self.progress("simulating a few frames")
        )
        sheets = dict(list(self.sheet_locations.items())[:1])
        sheet_s = sum(planning.measure_simulating(sheets, (), scratch / "sheets")[0].values(), 0.0)
        rates = planning.measure(
            self.jobs(small),
            scratch / "runs",
            JobOptions(workers=self.num_workers, progress=self.progress("measuring")),
            steps=self.measured_steps,
            batch_share=min(1.0, planning.SMALL_BATCH / self.settings.batch),
            report=self.report,
        )
        shutil.rmtree(scratch, ignore_errors=True)
        tree = {
            "for": self._measured_for,
            "paces": {kind: asdict(rate) for kind, rate in rates.items()},
            "simulating_s": simulating,
            "sheet_s": sheet_s,
        }
        write_text(self.out / MEASURED, json.dumps(tree, indent=1) + "\n")
        return rates, simulating, sheet_s

    def _plan(self) -> planning.GridPlan:
        # what it costs: measured rates, frames that are not there yet
        locations, settings = self.locations, self.settings
        jobs = self.jobs(locations)
        rates, simulating, sheet_s = self._measure(locations)
        missing = {name: seconds for name, seconds in simulating.items() if not locations[name].path.exists()}
        sheets = [location.simulated for location in self.sheet_locations.values() if not location.path.exists()]
        beside_s = sheet_s * sum(sheet.sequences * sheet.frames for sheet in sheets if sheet is not None)
        frames_scored = 0
        for location in self._existing(settings.scored_on, locations).values():
            scored = location.simulated
            frames_scored += len(location.open()) if scored is None else scored.sequences * scored.frames
        # the steps that fit
        limits = [settings.core_minutes, None if self.minutes is None else self.minutes * self.num_workers]
        limit = min((minutes for minutes in limits if minutes is not None), default=None)
        share, cost = planning.fit_steps(jobs, settings, rates, missing, frames_scored, limit, beside_s=beside_s)
        lowered = settings.lowered(share)
        runs = tuple(self.grid.runs_of(self.budget))
        return planning.GridPlan(
            budget=self.budget,
            steps_share=share,
            steps={network: lowered.steps_for(network) for network in sorted({job.network for job in jobs})},
            jobs=len(jobs),
            rows=len(runs),
            seeds=settings.seeds,
            cost=cost,
            workers=self.num_workers,
            outlooks=outlooks(self.claims, runs, settings),
            paces=rates,
            simulating_s=simulating,
        )

    @property
    def _limited(self) -> bool:
        """Whether minutes may lower the steps."""
        return self.minutes is not None or self.settings.core_minutes is not None

    def _unmeasured(self) -> planning.GridPlan:
        """The plan of a grid whose trainings are done: the declared steps; what scoring costs is not measured."""
        jobs, runs = self.jobs(self.locations), tuple(self.grid.runs_of(self.budget))
        return planning.GridPlan(
            budget=self.budget,
            steps_share=1.0,
            steps={network: self.settings.steps_for(network) for network in sorted({job.network for job in jobs})},
            jobs=len(jobs),
            rows=len(runs),
            seeds=self.settings.seeds,
            cost=planning.GridCost(simulating=0.0, training=0.0, scoring=0.0),
            workers=self.num_workers,
            outlooks=outlooks(self.claims, runs, self.settings),
        )

    def _learnt(self) -> set[str]:
        """The sets that runs learn from and none is scored on."""
        runs = self.grid.runs_of(self.budget).values()
        learnt = {stream.set for run in runs for stream in run.streams.values()}
        return learnt - {*self.settings.scored_on, *self.settings.statistics_on}

    def _untrained(self, steps_share: float = 1.0) -> set[str]:
        """The sets that a training is left of, which is neither trained nor known to diverge."""
        locations, learnt = self.locations, self._learnt()
        fingerprints = learnt_fingerprints(self.out, locations, learnt)
        jobs = self.jobs(locations, fingerprints, steps_share=steps_share)
        ends = (WEIGHTS, SCORES)
        left = [job for job in jobs if not any((self._runs / job.folder / name).is_file() for name in ends)]
        sets = {stream.set for job in left for stream in self.grid.runs[job.runs[0]].streams.values()}
        return sets | (learnt - set(fingerprints))

    @staticmethod
    def _existing(names: Iterable[str], locations: Mapping[str, DataLocation]) -> dict[str, DataLocation]:
        """Those of the sets that there are; the validation set where there is none of them."""
        return {name: locations[name] for name in names if name in locations} or {"val": locations["val"]}

    def _scoring(self, locations: Mapping[str, DataLocation], fingerprints: Mapping[str, str]) -> ScoringTask:
        scored = self._existing(self.settings.scored_on, locations)
        return ScoringTask(
            score=self.settings.score,
            locations=scored,
            fingerprints={name: fingerprints.get(name, "") for name in scored},
            needs=tuple(needs_of(self.claims, self.grid, self.settings.score)),
            replicates=self.settings.replicates,
            device=self.device,
        )

    # Deciding and showing

    def _conclude(
        self,
        outline: planning.GridPlan,
        jobs: Sequence[TrainingJob],
        done: Sequence[TrainingJob],
        locations: Mapping[str, DataLocation],
        scoring: ScoringTask,
        fingerprints: Mapping[str, str],
    ) -> Path:
        from farfield.papers.page import write_page

        # decide
        self.report(f"deciding on {len(self.claims)} claims with {len(done)} of {count_of(len(jobs), 'run')}")
        trees = [scores_of(job, self._runs) for job in done]
        scores = Scores.of(trees)
        options = self._options("counting points")
        objects = objects_in(self._existing(self.settings.statistics_on, locations), options)
        rule = DecisionRule(claims=self.claims, grid=self.grid, settings=self.settings, scores=scores, objects=objects)
        comparisons = rule.decide()
        # the summary
        weights = {job.folder: self._runs / job.folder / WEIGHTS for job in done}
        weights = {folder: path for folder, path in weights.items() if path.is_file()}  # one that diverged has none
        of_first_seed = {
            run: weights[job.folder] for job in done if job.seed == 0 and job.folder in weights for run in job.runs
        }
        reproduced = ReproductionSummary(
            paper=self.paper,
            budget=self.budget,
            simulated=self.simulated,
            steps=outline.steps,
            planned=len(jobs),
            done=len(done),
            failed=[(tree["runs"][0], tree["seed"], tree["failed"]) for tree in trees if tree.get("failed")],
            sets={name: (fingerprints[name], location.simulated) for name, location in locations.items()},
            trained_on=[load_weights(path)[1] for path in weights.values()],
            validation=validation_of(done, self._runs),
        )
        summary = summary_of(reproduced, self.grid, self.claims, scores, objects, comparisons)
        first_set = next(iter(scoring.locations.values()))
        sheets = self._sheets(first_set, of_first_seed)
        summary["sheets"] = [{"title": group.title, "frames": group.facts()} for group in sheets]
        summary["features"] = feature_maps(of_first_seed, first_set, self.settings.score)
        seeds = seeds_of(job for job in done if job.folder in weights)
        by_pattern = {
            name: [scoring.detections(weights[patterns[name].folder], name) for patterns in seeds.values()]
            for name in PATTERNS
        }
        summary["scenarios"] = scenarios_of(by_pattern, scoring.score)
        write_text(self.out / SUMMARY, json.dumps(summary, indent=1) + "\n")
        # what the clocks measured, and the page
        runs = {job.folder: {"runs": list(job.runs), "clock": clocks_of(job, self._runs)} for job in done}
        flags = {"device": self.device, "precision": self.precision, "workers": self.num_workers}
        timing = {"planned": outline.to_json(), "options": flags, "runs": runs}
        write_text(self.out / TIMING, json.dumps(timing, indent=1) + "\n")
        curves = curves_of(scores, self.settings.score)
        return write_page(self.out / PAGE, summary, timing, curves=curves, objects=objects.columns, sheets=sheets)

    def _sheets(self, first_set: DataLocation, weights: Mapping[str, Path]) -> list[SheetGroup]:
        """K-Radar's sheets; their frames are simulated now if they are not there yet."""
        if self.paper != "kradar":
            return []
        locations = self.sheet_locations
        provide(locations, options=self._options("simulating the sheets"), report=self.report)
        return sheets_of(locations, None if self.simulated else first_set, weights, self.settings)


def _read(path: Path) -> Tree:
    if not path.is_file():
        return {}
    try:
        return dict(plain_json(read_bytes(path, max_bytes=_MAX_BYTES)))
    except ValueError:
        return {}  # cut off or foreign: planned anew

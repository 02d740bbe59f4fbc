"""Adaptation without labels: to another device, and to sleet and heavy snow; the share of the gap that it closes."""

import argparse
import hashlib
import json
import resource
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from _adaptation_teachers import REMEDIES, remedy_of, thresholds
from _report import ROOT, SHARED_REAL, Part, part_parser, progress, run_parts

import farfield as ff
from farfield.errors import ConfigError
from farfield.evaluation import detect
from farfield.experiments.plan import Plan
from farfield.experiments.schema import Experiment, experiment_of
from farfield.files.atomic import write_text
from farfield.jobs import JobOptions
from farfield.metrics.deciding import Difference, Scalar, decide, difference_of, figure, pooled
from farfield.metrics.deciding.difference import ScoreSample, sample
from farfield.papers import load_grid
from farfield.papers.deciding import Scores
from farfield.papers.grid import ExperimentGrid
from farfield.papers.jobs import DataLocations, TrainingJob, jobs_of
from farfield.papers.locations import DataLocation, fingerprints_of, locations_of, provide
from farfield.papers.running import WEIGHTS, clocks_of, do_all, done_jobs, scores_of
from farfield.papers.scoring import RequiredScore, ScoringTask
from farfield.simulation.recording import record
from farfield.training.config import WeatherConfig
from farfield.training.report import TrainingReport
from farfield.training.weather import inside_presets

START = "pointpillars-cirrus-sim"
FIGURES = {"AP 2 m": "ap/2.0", "mAP": "dds/0/map", "aIoU": "dds/0/aiou", "DDS": "dds/0/dds"}
DRIVE_0001 = ("002335", "002352", "002364", "003638")
BINS_M = (0.0, 30.0, 70.0, 120.0)


class Course(TrainingReport):
    """Says how the work goes on, on the error stream."""

    def reading(self, numbers: Iterable[int], what: str) -> Iterable[int]:
        """With a progress bar."""
        return progress(list(numbers), what)

    def say(self, text: str) -> None:
        """Print it."""
        print(text, file=sys.stderr, flush=True)

    def step(self, step: int, losses: dict[str, float]) -> None:
        """Every fiftieth step."""
        if step % 50 == 0:
            self.say(f"step {step}: loss {losses['loss']:.3f}")


class Cores:
    """Core minutes of this work, over all calls, kept in its folder.

    Args:
        path: Where they are kept.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.before = json.loads(path.read_text()) if path.is_file() else {}
        self.begun = self._used()

    @staticmethod
    def _used() -> float:
        used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        return sum(each.ru_utime + each.ru_stime for each in used)

    def spent(self, what: str) -> float:
        """Book the minutes since the last call under a name; gives all of that name."""
        now = self._used()
        self.before[what] = self.before.get(what, 0.0) + (now - self.begun) / 60
        self.begun = now
        write_text(self.path, json.dumps(self.before, indent=1) + "\n")
        return self.before[what]


def simulated(work: Path, name: str, frames: int, sequences: int, seed: int, weather: str) -> Any:
    """Frames of the simulated os2-64."""
    folder = work / name
    bar = partial(progress, what=f"simulating {name}")
    record(
        "kradar-sim",
        folder,
        frames=frames,
        sequences=sequences,
        sensors="os2-64",
        seed=seed,
        weather=weather,
        progress=bar,
    )
    return ff.open_dataset(folder)


def trained_on_labels(work: Path, adapted: Path, target: Path, rounds: int) -> Path:
    """The detector trained on the target's labels: a round of the adaptation with labels in place of pseudo boxes."""
    tree = yaml.safe_load((adapted / "round-1" / "experiment.yaml").read_text())
    tree["name"], tree["data"]["target"]["path"] = "labels", str(target)
    tree["method"] = {"name": "device", "norm": "per_domain", "adversarial": None, "start": START}
    tree["training"]["steps"] *= rounds
    Plan(experiment_of(tree), work / "labels").run(Course())
    return work / "labels"


def samples(detector: str | Path, sets: Sequence[Any], cloud: str, kept: Path) -> dict[str, ScoreSample]:
    """Each figure of a detector on some sets of frames together, with its draws."""
    found = None
    for number, data in enumerate(sets):
        bar = partial(progress, what=f"searching with {Path(detector).name}")
        journal = kept.with_name(f"{kept.name}-{number}.jsonl")
        part = detect(ff.load_detector(detector), data, cloud=cloud, annotated_only=True, journal=journal, progress=bar)
        if found is None:
            found = part
        boxes, annotations = {**found.boxes, **part.boxes}, {**found.annotations, **part.annotations}
        found = replace(found, boxes=boxes, annotations=annotations)
    assert found is not None
    return {
        name: sample(found, figure(key), label="vehicle", range_bins_m=BINS_M, epsilons=(0.0,))
        for name, key in FIGURES.items()
    }


def interval(draws: np.ndarray) -> str:
    """The middle 95 per cent of what the draws give."""
    low, high = np.nanquantile(draws, (0.025, 0.975))
    return f"[{low:+.3f}, {high:+.3f}]"


def report(rows: dict[str, dict[str, ScoreSample]], before: str, after: str, above: str | None) -> None:
    """Print all figures, the gain, and the share of the gap that it closes."""
    print(f"{'':<22}" + "".join(f"{name:>10}" for name in FIGURES))
    for name, row in rows.items():
        print(f"{name:<22}" + "".join(f"{row[each].value or 0.0:10.3f}" for each in FIGURES))
    for name in FIGURES:
        low, high = rows[before][name], rows[after][name]
        gain = high.draws - low.draws
        text = f"{name}: gain {(high.value or 0) - (low.value or 0):+.3f} {interval(gain)}"
        if above is not None:
            top = rows[above][name]
            gap = top.draws - low.draws
            text += f", gap {(top.value or 0) - (low.value or 0):+.3f} {interval(gap)}"
            if np.nanquantile(gap, 0.025) > 0:
                share = ((high.value or 0) - (low.value or 0)) / ((top.value or 0) - (low.value or 0))
                text += f", share closed {share:+.2f} {interval(gain / gap)}"
            else:
                text += ", no gap to close"
        print(text, flush=True)


def on_os2(options: argparse.Namespace) -> None:
    """The simulated os2-64."""
    work, cores = options.work, Cores(options.work / "cores.json")
    target = simulated(work, "target", options.frames, options.frames // 5, 31, options.weather)
    other = simulated(work, "other", options.scored, options.scored // 3, 731, options.weather)
    cores.spent("target and scored frames")
    choices: dict[str, Any] = {"frames": options.frames, "clouds": ("os2-64",), "rounds": options.rounds}
    choices["source_frames"], choices["whole_bodies"] = options.source_frames, options.whole_bodies
    done = ff.adapt(
        START,
        target,
        out=work / "adapted",
        minutes=options.minutes,
        steps=options.steps,
        report=Course(),
        **choices,
    )
    minutes = cores.spent("adapting")
    print(
        f"adapting: {minutes:.0f} core-minutes, source frames included; {options.rounds} x {done.settled.steps} steps"
    )
    print(f"thresholds: object {done.settled.positive}, background {done.settled.negative}")
    print("".join(f"sign: {text}\n" for text in done.signs), end="")
    rows: dict[str, str | Path] = {"before": START, "adapted": done.folder}
    if options.controls:
        steps = done.settled.steps * options.rounds
        off = ("method.weight=0",)
        source = work / "adapted" / "source"
        control = ff.adapt(START, target, out=work / "statistics", source=source, steps=steps, overrides=off, **choices)
        rows["statistics alone"] = control.folder
    rows["trained on labels"] = trained_on_labels(work, done.folder, work / "target", options.rounds)
    cores.spent("controls")
    found = {
        name: samples(weights, [other], "os2-64", work / f".scored-{name.replace(' ', '-')}")
        for name, weights in rows.items()
    }
    drives = found["before"]["DDS"].groups
    print(f"{len(other)} frames of {drives} other drives; vehicle; boxes show whole bodies there, the visible part in")
    if options.whole_bodies:
        print("what the detector learnt; the source's labels teach whole bodies in all rows but the first")
    else:
        print("the source: aIoU, and DDS with it, holds a gap that pseudo boxes cannot close")
    report(found, "before", "adapted", "trained on labels")


def on_kitti(options: argparse.Namespace) -> None:
    """Real KITTI: adapted to four sweeps of drive 0001, scored on other drives."""
    drive = SHARED_REAL / "kitti_raw" / "2011_09_26" / "2011_09_26_drive_0001_sync" / "velodyne_points" / "data"
    out = options.work / "kitti"
    choices: dict[str, Any] = {"rounds": options.rounds, "source_frames": options.source_frames}
    choices["whole_bodies"] = options.whole_bodies
    choices["steps"] = options.steps
    done = ff.adapt(START, drive, out=out, minutes=options.minutes, report=Course(), **choices)
    print(f"adapted to {len(done.after.boxes)} sweeps in {options.rounds} x {done.settled.steps} steps")
    sets = []
    for name in ("kitti", "kitti_more"):
        data = ff.open_dataset(SHARED_REAL / name)
        sets.append(data.select([n for n, frame in enumerate(data.frame_ids) if frame not in DRIVE_0001]))
    found = {
        row: samples(weights, sets, "lidar", options.work / f".scored-kitti-{row}")
        for row, weights in (("before", START), ("adapted", done.folder))
    }
    print(f"{sum(map(len, sets))} frames of other drives; draws of {found['before']['DDS'].grouped_by}")
    report(found, "before", "adapted", None)
    print("reported, not decided: so few frames decide nothing")


def run_devices(arguments: Sequence[str]) -> None:
    """What farfield adapt gains: the share of the gap to a detector trained on the target's labels that it closes.

        python benchmarks/adaptation.py devices [--minutes 50] [--work data/adapting] [--controls] [--whole-bodies]
        python benchmarks/adaptation.py devices --kitti

    The target is 200 frames of the simulated os2-64 (preset kradar-sim, one weather), adapted to without their labels
    from pointpillars-cirrus-sim, whose source frames are simulated within the same time. The detector trained on their
    labels starts from the same weights and takes as many steps with the same source frames, statistics by domain and
    settings, and a head of its own, so that labels are the only difference. With --whole-bodies the source's labels are
    whole bodies, as the target's are, in all rows but the first. All are scored on other drives; intervals are those of
    1,000 draws of these. A control learns from the same batches without pseudo boxes: what statistics and more steps
    give.

    --kitti adapts to the whole sweeps of drive 0001 of KITTI's raw data (shared/real, local) and scores on the frames
    of other drives: few, so that the interval is reported and nothing is decided. Killed, a run goes on where it
    stopped; of a killed call the core minutes of the stage that it was in are not counted.
    """
    parser = part_parser(run_devices.__doc__)
    parser.add_argument("--work", type=Path, default=ROOT / "data" / "adapting")
    parser.add_argument("--minutes", type=float, default=50.0, help="of the adaptation, by the clock")
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--source-frames", type=int, default=240)
    parser.add_argument("--scored", type=int, default=120)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--weather", default="normal")
    parser.add_argument("--controls", action="store_true", help="also without pseudo boxes")
    parser.add_argument("--whole-bodies", action="store_true", help="the source's labels are whole bodies, too")
    parser.add_argument("--steps", type=int, default=0, help="of all rounds; the command's own unless given")
    parser.add_argument("--kitti", action="store_true", help="real KITTI in place of the simulated os2-64")
    options = parser.parse_args(arguments)
    options.work.mkdir(parents=True, exist_ok=True)
    (on_kitti if options.kitti else on_os2)(options)


BUDGET = "laptop"
CLOUDS = {"radar": "radar", "lidar": "os2-64"}
NAMES = {"radar": "RTNH on the radar", "lidar": "PointPillars on the os2-64"}
FIGURE = "ap/vehicle/3d/0.3"
PARTS = {"sleet and heavy snow": ("sleet", "heavy_snow"), "sleet": ("sleet",), "heavy snow": ("heavy_snow",)}
SOURCE = "normal and overcast"
ADAPTED = ("weather", "statistics", "teacher", "teacher_weather", *REMEDIES)
SHARES = np.round(np.arange(-3.0, 4.001, 0.01), 2)
AIM = 0.5


def scalars() -> dict[str, Scalar]:
    """AP3D by weather; of two weathers their mean."""
    parts = {**PARTS, SOURCE: ("normal", "overcast")}
    return {
        name: Scalar(tuple((f"weather/{each}", FIGURE, 1 / len(weathers)) for each in weathers))
        for name, weathers in parts.items()
    }


def chosen_grid(options: argparse.Namespace) -> ExperimentGrid:
    """The grid in the size that was asked for."""
    grid = load_grid(Path(__file__).with_name("adaptation_weather.yaml"))
    settings = grid.budgets[BUDGET]
    sequences = {
        "source": options.frames // 2,
        "target": options.frames // 2,
        "val": options.val,
        "test": options.scored,
    }
    sets = {name: each.model_copy(update={"sequences": sequences[name]}) for name, each in settings.sets.items()}
    changed = settings.model_copy(update={"sets": sets, "seeds": options.seeds, "steps": options.steps})
    runs = {
        name: run
        for name, run in grid.runs.items()
        if name.partition("_")[0] in options.sensors and (options.remedies or name.partition("_")[2] not in REMEDIES)
    }
    return grid.model_copy(update={"runs": runs, "budgets": {BUDGET: changed}})


def check_outside(grid: ExperimentGrid) -> int:
    """See that what is laid over frames lies outside the targets' own; how many settings of weather there are.

    Raises:
        ConfigError: If it does not.
    """
    trees = [run.augmentation.get("weather") for run in grid.runs.values()]
    trees += [run.method.get("strong", {}).get("weather") for run in grid.runs.values()]
    configs = [WeatherConfig.model_validate(tree) for tree in trees if tree]
    inside = sorted({text for config in configs for text in inside_presets(config)})
    if inside:
        raise ConfigError("weather: expected settings outside the targets'; " + "; ".join(inside))
    return len(configs)


def adapted(job: TrainingJob, runs: Path, val: DataLocation, steps: int) -> TrainingJob:
    """A job that starts from a finished one: fewer steps, half the rate, thresholds from that one's scores."""
    tree = job.experiment.model_dump(mode="json")
    rate, steps = tree["training"]["learning_rate"] / 2, steps * remedy_of(job).times
    tree["training"] |= {"steps": steps, "learning_rate": rate}
    if tree["method"]["name"] == "teacher":
        tree["method"] |= thresholds(job, runs, val)
    told = {name: value for name, value in tree["method"].items() if name != "start"}
    said = json.dumps([job.key, told, steps, rate], sort_keys=True)
    key = hashlib.sha256(said.encode()).hexdigest()[: len(job.key)]
    return replace(job, experiment=Experiment.model_validate(tree), key=key)


def trained(grid: ExperimentGrid, options: argparse.Namespace) -> tuple[list[TrainingJob], ScoringTask]:
    """Simulate, train and score all that is not done: the jobs in their order, and how they were scored."""
    runs = options.out / "runs"
    places = locations_of(grid, BUDGET, options.out / "data")
    provide(places, options=JobOptions(workers=options.workers, progress=partial(progress, what="simulating")))
    fingerprints = fingerprints_of(places)
    jobs = jobs_of(grid, BUDGET, (), DataLocations(locations=places, fingerprints=fingerprints), runs)
    settings = grid.budgets[BUDGET]
    needs = [
        RequiredScore(run=run, cloud=CLOUDS[run.partition("_")[0]], table="", scalar=scalar)
        for run in grid.runs
        for scalar in scalars().values()
    ]
    scoring = ScoringTask(
        score=settings.score,
        locations={name: places[name] for name in settings.scored_on},
        fingerprints={name: fingerprints[name] for name in settings.scored_on},
        needs=tuple(needs),
        replicates=settings.replicates,
    )
    work = partial(
        do_all, folder=runs, scoring=scoring, workers=options.workers, progress=partial(progress, what="runs")
    )
    first = [job for job in jobs if not job.start]
    work(first)
    begun = [job for job in jobs if job.start and (runs / job.start / WEIGHTS).is_file()]  # others' starts diverged
    begun = [replace(job, runs=(run,)) for job in begun for run in job.runs]  # alike until thresholds and steps are set
    later = [adapted(job, runs, places["val"], options.adapt_steps) for job in begun]
    work(later)
    return [*first, *later], scoring


Row = dict[int, ScoreSample]


def towards(source: Row, oracle: Row, share: float) -> Row:
    """What lies at a share of the way from the source's row to the oracle's, seed by seed."""
    found = {}
    for seed, low in source.items():
        high = oracle[seed]
        known = low.value is not None and high.value is not None
        value = low.value + share * (high.value - low.value) if known else None
        found[seed] = replace(low, value=value, draws=low.draws + share * (high.draws - low.draws))
    return found


def minus(a: Row, b: Row) -> Difference:
    """The difference of two rows, paired by seed."""
    seeds = sorted(a.keys() & b.keys())
    return difference_of([a[seed] for seed in seeds], [b[seed] for seed in seeds])


def spread_at(table: Mapping[str, Mapping[str, Row]], rows: Sequence[str], share: float) -> Any:
    """Spread over seeds of rows about a share of the gap, pooled over the rows and both weathers."""
    parts = [table[part] for part in ("sleet", "heavy snow")]
    return pooled(
        minus(part[row], towards(part["source"], part["oracle"], share))
        for part in parts
        for row in rows
        if row in part
    )


def share_closed(rows: Mapping[str, Row], row: str, spreads: Mapping[float, Any]) -> tuple[float, float, float]:
    """The share of the gap that a row closes, and the ends of its interval; infinite beyond -3 and 4."""
    gain, gap = (minus(rows[name], rows["source"]).estimate or 0.0 for name in (row, "oracle"))
    inside = []
    for share, spread in spreads.items():
        ends = minus(rows[row], towards(rows["source"], rows["oracle"], share)).with_pooled(spread).interval()
        if ends is not None and ends[0] <= 0 <= ends[1]:
            inside.append(share)
    if not inside:
        return gain / gap, np.nan, np.nan
    low = -np.inf if inside[0] == SHARES[0] else inside[0]
    return gain / gap, low, np.inf if inside[-1] == SHARES[-1] else inside[-1]


def spoken(found: Difference) -> str:
    """A difference with its interval."""
    ends = found.interval()
    return f"{found.estimate or 0:+.3f}" + ("" if ends is None else f" [{ends[0]:+.3f}, {ends[1]:+.3f}]")


def lines_of(sensor: str, grid: ExperimentGrid, scores: Scores) -> list[str]:
    """The table of a sensor, its gaps, and the shares closed."""
    table: dict[str, dict[str, Row]] = {}
    for part, scalar in scalars().items():
        name = RequiredScore(run="", cloud="", table="", scalar=scalar).name
        rows = {run: scores.samples(run, CLOUDS[sensor], name) for run in grid.runs if run.startswith(sensor)}
        table[part] = {run.partition("_")[2]: row for run, row in rows.items() if row}
    first = next(iter(PARTS))
    lines = ["", f"{NAMES[sensor]}: AP3D of vehicles at IoU 0.3, mean over seeds", f"{'':<36}"]
    lines[-1] += "".join(f"{part:>22}" for part in table)
    for row in table[first]:
        values = [[each.value for each in table[part][row].values() if each.value is not None] for part in table]
        words = grid.runs[f"{sensor}_{row}"].words
        lines.append(f"{words:<36}" + "".join(f"{np.mean(seen) if seen else np.nan:22.3f}" for seen in values))
    if not {"source", "oracle"} <= table[first].keys():
        return [*lines, "the source's or the oracle's row is not done"]
    for part in PARTS:
        lines += _gap_lines(sensor, grid, table, part)
    lines.append(f"on {SOURCE}, row - source (adapted rows read these frames with the target's statistics):")
    others = [row for row in ADAPTED if row in table[SOURCE]]
    return lines + [
        f"  {grid.runs[f'{sensor}_{row}'].words:<36}{spoken(minus(table[SOURCE][row], table[SOURCE]['source']))}"
        for row in others
    ]


def _gap_lines(sensor: str, grid: ExperimentGrid, table: Mapping[str, Mapping[str, Row]], part: str) -> list[str]:
    rows = table[part]
    spread = spread_at(table, (*ADAPTED, "oracle"), 0.0)
    gap = minus(rows["oracle"], rows["source"]).with_pooled(spread)
    decided = decide(gap)
    lines = [f"{part}, gap (oracle - source): {decided}; {gap.groups} {gap.grouped_by}"]
    open_gap = decided.verdict == "holds"
    spreads = {float(share): spread_at(table, ADAPTED, float(share)) for share in SHARES if open_gap}
    if not open_gap and decided.verdict != "no decision":
        lines[-1] += ": no gap to close"
    for row in (each for each in ADAPTED if each in rows):
        gain = minus(rows[row], rows["source"]).with_pooled(spread)
        text = f"  {grid.runs[f'{sensor}_{row}'].words:<36}gain {spoken(gain)}"
        if open_gap:
            share, low, high = share_closed(rows, row, spreads)
            verdict = "half and more" if low >= AIM else "less than half" if high < AIM else "undecided"
            text += f", share closed {share:+.2f} [{low:+.2f}, {high:+.2f}]: {verdict}"
        lines.append(text)
    plain, taught = "weather" in rows, "teacher_weather" in rows and "teacher" in rows
    if "teacher_long" in rows and "statistics_long" in rows:
        method = minus(rows["teacher_long"], rows["statistics_long"]).with_pooled(spread)
        lines.append(f"  teacher, four times the steps - the same without pseudo boxes: {spoken(method)}")
        if "continued_long" in rows:
            target = minus(rows["statistics_long"], rows["continued_long"]).with_pooled(spread)
            lines.append(f"  statistics by domain, four times the steps - source frames alone: {spoken(target)}")
    if plain and taught:
        both = minus(rows["teacher_weather"], rows["teacher"]).with_pooled(spread)
        method = minus(rows["teacher"], rows["statistics"]).with_pooled(spread)
        lines.append(f"  weather laid over, with a teacher - without: {spoken(both)}")
        lines.append(f"  teacher - statistics alone: {spoken(method)}")
    return lines


def teacher_lines(jobs: Sequence[TrainingJob], runs: Path) -> list[str]:
    """Thresholds and boxes of every teacher."""
    lines = ["", "teachers: thresholds, boxes a frame in the last tenth of the steps"]
    for job in jobs:
        settings = job.experiment.method.settings
        rows = [json.loads(line) for line in (runs / job.folder / "log.jsonl").read_text().splitlines()]
        last = rows[-max(1, len(rows) // 10) :]
        sure, unsure = (np.mean([row.get(name, 0.0) for row in last]) for name in ("pseudo_boxes", "ignored_boxes"))
        limits = ", ".join(f"{which} {settings[which]['vehicle']:.2f}" for which in ("positive", "negative"))
        lines.append(f"  {job.runs[0]}-s{job.seed}".ljust(34) + f"{limits}; sure {sure:.2f}, ignored {unsure:.2f}")
    return lines


def cost_lines(jobs: Sequence[TrainingJob], runs: Path) -> list[str]:
    """Core minutes by row."""
    spent: dict[str, float] = {}
    for job in jobs:
        seconds = sum(float(each["processor_s"]) for each in clocks_of(job, runs))
        spent[job.runs[0]] = spent.get(job.runs[0], 0.0) + seconds / 60
    total = sum(spent.values())
    rows = ", ".join(f"{name} {minutes:.1f}" for name, minutes in spent.items())
    return ["", f"core minutes of trainings and scoring, all seeds: {total:.1f} ({rows})"]


def run_weather(arguments: Sequence[str]) -> None:
    """Adapted to sleet and heavy snow without their labels: how much of the gap each means closes, for radar and LiDAR.

        python benchmarks/adaptation.py weather [--seeds 3] [--steps 240] [--frames 100] [--workers 2] [--out FOLDER]

    Detectors learn from simulated normal and overcast drives (RTNH in half its width on the radar, PointPillars on the
    os2-64) and are scored on other drives in sleet and heavy snow. The grid is adaptation_weather.yaml. Rows: the
    source alone; weather laid over it; and from these weights, in --adapt-steps steps of source and target frames with
    statistics by domain, a mean teacher without and with weather laid over, the same with weight 0 (statistics alone),
    and the oracle, which learns from the target's labels in place of pseudo boxes: the labels are the only difference.
    With --remedies the LiDAR has further rows, where the teacher closed no gap: what it finds with a low score ignored
    and not background, thresholds from frames with weather laid over them, four times the steps with their own control.
    Thresholds of the pseudo boxes come from each start's scores on source frames that it did not learn from. Settings
    of the weather that is laid over lie outside what the target's weathers hold: this is checked.

    The gap is oracle minus source; its interval and the pooled spread over seeds are those of
    farfield.metrics.deciding. Where it lies above 0, the share that a row closes is the s for which row = source + s
    (oracle - source), and its interval all s of which that is not refused at 95 % (Fieller, 1954), seeds paired and
    sequences drawn alike. A killed call goes on where it stopped. With one seed nothing is decided.
    """
    parser = part_parser(run_weather.__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "data" / "weather-adapting")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--steps", type=int, default=240, help="of the rows that start from nothing")
    parser.add_argument("--adapt-steps", type=int, default=50, help="of those that start from their weights")
    parser.add_argument(
        "--frames", type=int, default=100, help="of the source's and of the target's drives, two a drive"
    )
    parser.add_argument("--val", type=int, default=24, help="source frames that are scored")
    parser.add_argument("--scored", type=int, default=80, help="target frames that are scored, one a drive")
    parser.add_argument("--sensors", nargs="+", choices=CLOUDS, default=list(CLOUDS))
    parser.add_argument("--remedies", action="store_true", help="also the LiDAR's rows of _adaptation_teachers.py")
    parser.add_argument("--workers", type=int, default=0, help="processes; 0 for as many as there are cores")
    options = parser.parse_args(arguments)
    options.out = options.out.resolve()
    grid = chosen_grid(options)
    checked = check_outside(grid)
    jobs, scoring = trained(grid, options)
    runs = options.out / "runs"
    done = done_jobs(jobs, runs, scoring)
    kept = [scores_of(job, runs) for job in done]
    failed = [f"{each['runs'][0]}, seed {each['seed']}: {each['failed']}" for each in kept if each.get("failed")]
    sets = ", ".join(f"{name} {each.sequences * each.frames}" for name, each in grid.budgets[BUDGET].sets.items())
    print(f"\nsimulated frames: {sets}; {options.steps} steps, adapted in {options.adapt_steps}")
    print(f"weather laid over: {checked} settings, none inside those of the presets; {len(done)} of {len(jobs)} runs")
    print(*(f"failed: {text}" for text in failed), sep="\n", end="\n" if failed else "")
    scores = Scores.of(kept)
    for sensor in options.sensors:
        print(*lines_of(sensor, grid, scores), sep="\n")
    print(*teacher_lines([job for job in done if job.experiment.method.name == "teacher"], runs), sep="\n")
    print(*cost_lines(done, runs), sep="\n")


if __name__ == "__main__":
    raise SystemExit(
        run_parts(
            __doc__,
            {
                "devices": Part(
                    run_devices,
                    "--work TMP/devices --minutes 0 --steps 2 --frames 5 --source-frames 2 --scored 3 --rounds 1",
                ),
                "weather": Part(run_weather, None),  # six trainings and their scores take minutes, however small
            },
        )
    )

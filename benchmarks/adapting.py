"""What farfield adapt gains: the share of the gap to a detector trained on the target's labels that it closes.

    python benchmarks/adapting.py [--minutes 50] [--work data/adapting] [--controls] [--whole-bodies]
    python benchmarks/adapting.py --kitti

The target is 200 frames of the simulated os2-64 (preset kradar-sim, one weather), adapted to without their labels from
pointpillars-cirrus-sim, whose source frames are simulated within the same time. The detector trained on their labels
starts from the same weights and takes as many steps with the same source frames, statistics by domain and settings, and
a head of its own, so that labels are the only difference. With --whole-bodies the source's labels are whole bodies, as
the target's are, in all rows but the first. All are scored on other drives; intervals are those of 1,000
draws of these. A control learns from the same batches without pseudo boxes: what statistics and more steps give.

--kitti adapts to the whole sweeps of drive 0001 of KITTI's raw data (shared/real, local) and scores on the frames of
other drives: few, so that the interval is reported and nothing is decided. Killed, a run goes on where it stopped; of a
killed call the core minutes of the stage that it was in are not counted.
"""

import argparse
import json
import resource
import sys
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from _report import ROOT, SHARED_REAL, header, progress

import farfield as ff
from farfield.evaluation import detect
from farfield.experiments.plan import Plan
from farfield.experiments.schema import experiment_of
from farfield.files.atomic import write_text
from farfield.metrics.deciding import figure
from farfield.metrics.deciding.difference import ScoreSample, sample
from farfield.simulation.recording import record
from farfield.training.report import TrainingReport

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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
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
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    print(header(), "\n", sep="")
    (on_kitti if options.kitti else on_os2)(options)


if __name__ == "__main__":
    main()

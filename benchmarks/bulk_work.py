"""Bulk work: equal bytes, CPU and speed-up of every verb, cost of the mechanism, memory; what evaluating takes."""

import hashlib
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import psutil
from _report import Part, part_parser, run_parts

from farfield.jobs import JobJournal, JobOptions, Unit, UnitResult, run, values

UNIT_MS, RERUN_S, GROWTH = 2.0, 5.0, 1.10
TINY = """
name: tiny
data: {path: DATA, clouds: [gaussian]}
detector:
  {grid: {range_m: 64.0, half_width_m: 16.0, cell_m: 0.5}, widths: [8, 16, 16], depths: [0, 0, 0], neck_width: 16,
   score_threshold: 0.0}
training: {steps: 2, batch_size: 1, precision: fp32, threads: 1, workers: 0}
"""


@dataclass
class Cost:
    """What a command took.

    Args:
        wall_s: Seconds by the clock.
        cpu_s: Seconds of CPU of all its processes.
        command_mb: Largest memory of the command itself.
        worker_mb: Largest memory of one of its workers.
    """

    wall_s: float = 0.0
    cpu_s: float = 0.0
    command_mb: float = 0.0
    worker_mb: float = 0.0


def measured(words: list[str]) -> Cost:
    """Run a verb and watch it."""
    cost, began = Cost(), time.perf_counter()
    running = subprocess.Popen([sys.executable, "-m", "farfield.cli", *words], stdout=subprocess.DEVNULL)
    process = psutil.Process(running.pid)
    while True:
        pid, status, usage = os.wait4(running.pid, os.WNOHANG)
        if pid:
            break
        try:
            cost.command_mb = max(cost.command_mb, process.memory_info().rss / 1e6)
            for child in process.children():
                cost.worker_mb = max(cost.worker_mb, child.memory_info().rss / 1e6)
        except psutil.Error:
            pass
        time.sleep(0.05)
    if status:
        raise SystemExit(f"farfield {' '.join(words)}: status {status}")
    cost.wall_s, cost.cpu_s = time.perf_counter() - began, usage.ru_utime + usage.ru_stime
    return cost


def digest(out: Path) -> tuple[str, int]:
    """One digest of all files below a path and their number, without what the clock measured."""
    files = [out] if out.is_file() else sorted(path for path in out.rglob("*") if path.is_file())
    files = [path for path in files if path.name not in ("timing.json", "log.jsonl")]  # a training's log has its speed
    whole = hashlib.sha256()
    for path in files:
        whole.update(path.relative_to(out.parent).as_posix().encode() + hashlib.sha256(path.read_bytes()).digest())
    return whole.hexdigest()[:16], len(files)


def verbs(data: Path, cached: Path, kradar: Path, frames: int) -> dict[str, tuple[list[str], str]]:
    """The words of each verb, and where its files go."""
    few = f"--frames {frames} --sequences 4 --sensors gaussian,uniform,camera"
    words = {
        "simulate (Cirrus)": f"simulate cirrus-sim OUT/a {few}",
        "simulate (K-Radar)": f"simulate kradar-sim-mini OUT/a --frames {max(frames // 2, 6)} --sensors os2-64,cube",
        "convert --to kitti": f"convert {data} OUT/a --to kitti",
        "convert --to cirrus": f"convert {data} OUT/a --to cirrus",
        "convert --to boxes-csv": f"convert {data} OUT/a --to boxes-csv",
        "convert --to cache": f"convert {cached} --to cache --overwrite",
        "convert --to radar-store": f"convert {kradar} OUT/a --to radar-store",
        "predict": f"predict pointpillars-cirrus-sim {data} --cloud gaussian --out OUT/a/boxes.csv",
        "evaluate": f"evaluate pointpillars-cirrus-sim {data} --clouds gaussian --replicates 20 --out OUT/a",
        "stats": f"stats {data} --name frames --sweeps {frames} --out OUT/a",
        "doctor": f"doctor {data} --frames {frames}",
        "compare": f"compare {data} {cached} --frames {frames} --out OUT/a",
        "odometry": f"odometry {data} --out OUT/a",
        "depth": f"depth {data} --out OUT/a",
        "anonymize": f"anonymize {data} OUT/a",
        "adapt": f"adapt pointpillars-cirrus-sim {data} --source {data} --cloud gaussian --rounds 1 --steps 2 "
        f"--frames {frames} --source-frames {frames} --out OUT/a",
    }
    return {name: (line.split(), str(cached) if "cache" in name else "OUT/a") for name, line in words.items()}


def table(folder: Path, frames: int, only: Sequence[str] | None, *, ray: bool) -> bool:
    """CPU and speed-up of each verb, and whether all left the same bytes."""
    data, kradar = folder / "data", folder / "kradar"
    record = [sys.executable, "-m", "farfield.cli", "simulate"]
    few = ["--frames", str(frames), "--sequences", "4", "--sensors", "gaussian,uniform,camera"]
    subprocess.run([*record, "cirrus-sim", str(data), *few], check=True, stdout=subprocess.DEVNULL)
    cubes = ["--frames", str(max(frames // 2, 6)), "--sensors", "os2-64,cube"]
    subprocess.run([*record, "kradar-sim-mini", str(kradar), *cubes], check=True, stdout=subprocess.DEVNULL)
    heads = f"{'verb':26} {'1: CPU s':>9} {'wall s':>7} {'2: CPU s':>9} {'wall s':>7} {'speed-up':>9} {'MB':>5}"
    print(f"{heads}  files, digest", flush=True)
    equal = True
    for name, (words, compared) in verbs(data, data, kradar, frames).items():
        if only is not None and name not in only:
            continue
        costs, digests = [], []
        for flags in (["--workers", "1"], ["--workers", "2"], ["--workers", "2", "--engine", "ray"])[: 2 + ray]:
            out = folder / f"{name.replace(' ', '-')}-{len(costs)}"
            out.mkdir()
            costs.append(measured([*(word.replace("OUT", str(out)) for word in words), *flags]))
            left = Path(compared.replace("OUT", str(out)))
            digests.append(digest(left) if left.exists() else ("prints only", 0))
        one, two, *by_ray = costs
        same = len(set(digests)) == 1
        equal &= same
        said = f"{digests[0][1]} {digests[0][0]}" if same else f"DIFFER: {digests}"
        numbers = f"{one.cpu_s:9.1f} {one.wall_s:7.1f} {two.cpu_s:9.1f} {two.wall_s:7.1f}"
        said += "".join(f"; Ray: wall {cost.wall_s:.1f} s" for cost in by_ray)
        print(f"{name:26} {numbers} {one.wall_s / two.wall_s:9.2f} {two.worker_mb:5.0f}  {said}", flush=True)
    print("equal bytes" if equal else "BYTES DIFFER")
    return equal


def nothing(unit: Unit) -> UnitResult:
    """No work."""
    del unit
    return UnitResult()


def mechanism(folder: Path, many: int, finished: int) -> bool:
    """CPU of units without work, and of finding that nothing is left."""
    from bulk_work import nothing as work

    good = True
    for workers in (1, 2):
        units = [Unit(str(number), parameters=number) for number in range(many)]
        began = cpu_seconds()
        count = sum(1 for _ in values(work, units, JobOptions(workers=workers)))
        ms = 1e3 * (cpu_seconds() - began) / count
        good &= ms <= UNIT_MS
        print(f"{many:,} units of no work, {workers} worker(s): {ms:.3f} ms of CPU a unit (at most {UNIT_MS:g})")
        journal = JobJournal(folder / f"nothing-{workers}" / "journal.jsonl")
        began = cpu_seconds()
        run(work, units, JobOptions(workers=workers), journal=journal)
        ms = 1e3 * (cpu_seconds() - began) / count
        good &= ms <= UNIT_MS
        print(f"the same with a journal, {workers} worker(s): {ms:.3f} ms of CPU a unit (at most {UNIT_MS:g})")
    sources, out = folder / "sources", folder / "finished"
    sources.mkdir()
    out.mkdir()
    units = []
    for number in range(finished):
        (sources / f"{number}.in").write_bytes(b"in")
        units.append(Unit(f"{number:06d}", (sources / f"{number}.in",), out))
    run(written, units, JobOptions(), journal=JobJournal(out / "journal.jsonl", "s"))
    began = cpu_seconds()
    again = run(written, units, JobOptions(), journal=JobJournal(out / "journal.jsonl", "s"))
    seconds = cpu_seconds() - began
    good &= seconds <= RERUN_S and (again.written, again.skipped) == (0, finished)
    print(
        f"{finished:,} finished units, each of one source and one file: a rerun finds {again.written} left in "
        f"{seconds:.2f} s of CPU (at most {RERUN_S:g})"
    )
    return good


def written(unit: Unit) -> UnitResult:
    """Write a small file."""
    path = unit.parameters / f"{unit.name}.out"
    path.write_bytes(b"out")
    return UnitResult(files=(path,))


def cpu_seconds() -> float:
    """CPU of this process and of those that it waited for."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def memory(folder: Path, many: int, only: Sequence[str]) -> bool:
    """Memory of predict and evaluate over more and more frames."""
    print(f"{'frames':>7} {'verb':9} {'command MB':>11} {'worker MB':>10} {'wall s':>7}", flush=True)
    base = folder / "base"
    command = [sys.executable, "-m", "farfield.cli"]
    subprocess.run(
        [*command, "simulate", "cirrus-sim-mini", str(base), "--frames", "20", "--sequences", "2"],
        check=True,
        stdout=subprocess.DEVNULL,
    )
    (folder / "tiny.yaml").write_text(TINY.replace("DATA", str(base)))
    subprocess.run(
        [*command, "train", str(folder / "tiny.yaml"), "--out", str(folder / "runs")],
        check=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    subprocess.run(
        [*command, "convert", str(base), str(folder / "kitti"), "--to", "kitti"], check=True, stdout=subprocess.DEVNULL
    )
    largest: dict[str, list[float]] = {}
    for count in (many // 4, many // 2, many):
        data = repeated(folder / "kitti", folder / f"many-{count}", count)
        for verb, rest in (("predict", ["--out", f"{data}.csv"]), ("evaluate", ["--out", f"{data}-evaluation"])):
            if verb not in only:
                continue
            more = ["--replicates", "20"] if verb == "evaluate" else ["--score-threshold", "0"]
            cost = measured([verb, str(folder / "runs" / "tiny"), str(data), *rest, *more, "--workers", "2"])
            largest.setdefault(verb, []).append(cost.command_mb)
            print(f"{count:7} {verb:9} {cost.command_mb:11.0f} {cost.worker_mb:10.0f} {cost.wall_s:7.0f}", flush=True)
    grown = {verb: 1e3 * (sizes[-1] - sizes[0]) / (many - many // 4) for verb, sizes in largest.items()}
    print("\n".join(f"{verb}: {kb:.0f} kB a frame" for verb, kb in grown.items()))
    return all(sizes[-1] <= GROWTH * sizes[0] for sizes in largest.values())


def repeated(source: Path, target: Path, count: int) -> Path:
    """KITTI frames again and again under new numbers, as links to the same files."""
    split = source / "training" if (source / "training").is_dir() else source
    for kind in sorted(path for path in split.iterdir() if path.is_dir() and path.name != "ImageSets"):
        files = sorted(path for path in kind.iterdir() if path.stem.isdigit())
        folder = target / kind.relative_to(source)
        folder.mkdir(parents=True)
        for number in range(count if files else 0):
            path = files[number % len(files)]
            os.link(path, folder / f"{number:06d}{path.suffix}")
    return target


def run_verbs(arguments: Sequence[str]) -> int:
    """Every verb with one process, with two workers, and with two of a local Ray, on the same simulated frames.

        python benchmarks/bulk_work.py verbs [--frames 24] [--only VERB ...] [--ray]

    The digests of all files that both left must be equal (what the clock measured stands in timing.json, apart). MB is
    the largest worker. Exit status 1 if bytes differ.
    """
    parser = part_parser(run_verbs.__doc__)
    parser.add_argument("--frames", type=int, default=24)
    parser.add_argument("--only", nargs="+", help="names of the table's first column")
    parser.add_argument("--ray", action="store_true", help="with --engine ray too, where it is installed")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        return int(not table(Path(folder), options.frames, options.only, ray=options.ray))


def run_mechanism(arguments: Sequence[str]) -> int:
    """The mechanism alone: 10,000 units of no work, and 35,000 finished units that a rerun finds intact.

        python benchmarks/bulk_work.py mechanism [--units 10000] [--finished 35000]

    Exit status 1 above 2 ms a unit, or 5 s for the rerun.
    """
    parser = part_parser(run_mechanism.__doc__)
    parser.add_argument("--units", type=int, default=10_000)
    parser.add_argument("--finished", type=int, default=35_000)
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        return int(not mechanism(Path(folder), options.units, options.finished))


def run_memory(arguments: Sequence[str]) -> int:
    """Memory of predict and evaluate over many frames, with a small detector that gives as many boxes as it may.

        python benchmarks/bulk_work.py memory [--many 2000] [--only predict]

    Exit status 1 where the command's memory over all frames passes that over a quarter of them by more than a tenth.
    """
    parser = part_parser(run_memory.__doc__)
    parser.add_argument("--many", type=int, default=2000)
    parser.add_argument("--only", nargs="+", default=["predict", "evaluate"])
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        return int(not memory(Path(folder), options.many, options.only))


DETECTING = """
import sys, time
from farfield.api import load_detector, open_dataset
detector, data, clouds = load_detector(sys.argv[1], device="cpu"), open_dataset(sys.argv[2]), sys.argv[3].split(",")
spent = 0.0
for frame in data:
    for cloud in clouds:
        frame.cloud(cloud)
        began = time.process_time()
        detector.with_cloud(cloud)(frame)
        spent += time.process_time() - began
print(f"{len(data)} {spent}")
"""


def cpu_s(command: list[str]) -> tuple[float, str]:
    """CPU seconds of a command with all its processes, and what it prints."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, done.stdout


def recorded(folder: Path, frames: int) -> Path:
    """Simulated frames in two patterns."""
    command = [sys.executable, "-m", "farfield.cli", "simulate", "cirrus-sim", str(folder), "--frames", str(frames)]
    subprocess.run([*command, "--sensors", "gaussian,uniform"], check=True, stdout=subprocess.DEVNULL)
    return folder


def run_evaluate(arguments: Sequence[str]) -> None:
    """CPU seconds of ``farfield evaluate`` with and without its page, beside the detector's own.

        python benchmarks/bulk_work.py evaluate [DATA ...] [--detector NAME] [--clouds NAMES] [--without FLAGS]

    Without DATA 12 and 200 frames are simulated. Each run is a process of its own, its workers' time included; wall
    time says little on a machine that others use too. ``--without`` are the flags that leave the page out, so
    that a version without ``--no-report`` can be timed as well: ``--without=--shown-frames=0``.
    "once more" is the same command again: nothing is detected anew.
    """
    parser = part_parser(run_evaluate.__doc__)
    parser.add_argument("data", type=Path, nargs="*")
    parser.add_argument("--frames", type=int, nargs="+", default=[12, 200], help="to simulate")
    parser.add_argument("--detector", default="pointpillars-cirrus-sim")
    parser.add_argument("--clouds", default="gaussian,uniform")
    parser.add_argument("--without", default="--no-report")
    options = parser.parse_args(arguments)
    print("CPU seconds of all processes\n")
    heads = f"{'detector alone':>15} {'with page':>10} {'without':>8} {'once more':>10}"
    print(f"{'frames':>6} {'clouds':>18} {heads}  wall s")
    with tempfile.TemporaryDirectory() as folder:
        for data in options.data or [recorded(Path(folder) / f"d{frames}", frames) for frames in options.frames]:
            given = [options.detector, str(data), options.clouds]
            frames, alone = cpu_s([sys.executable, "-c", DETECTING, *given])[1].split()
            spent, began = [], time.monotonic()
            base = [sys.executable, "-m", "farfield.cli", "evaluate", *given[:2], "--clouds", options.clouds]
            for flags, out in (([], "a"), ([options.without], "b"), ([], "a")):
                spent.append(cpu_s([*base, "--device", "cpu", "--out", f"{folder}/{data.name}-{out}", *flags])[0])
            wall = time.monotonic() - began
            cells = " ".join([f"{spent[0]:10.1f}", f"{spent[1]:8.1f}", f"{spent[2]:10.1f}"])
            print(f"{frames:>6} {options.clouds:>18} {float(alone):15.1f} {cells} {wall:7.0f}", flush=True)


if __name__ == "__main__":
    raise SystemExit(
        run_parts(
            __doc__,
            {
                "verbs": Part(run_verbs, "--frames 6 --only 'convert --to boxes-csv'", exact=True),
                "mechanism": Part(run_mechanism, "--units 50 --finished 100"),
                "memory": Part(run_memory, "--many 4 --only predict"),
                "evaluate": Part(run_evaluate, "--frames 1 --clouds gaussian"),
            },
        )
    )

"""Time and memory from points to boxes: LiDAR's and radar's detectors, number types, growing ranges."""

import argparse
import ctypes
import json
import os
import resource
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from _report import Part, child_output, part_parser, run_parts

from farfield.detectors import DETECTORS, build_detector
from farfield.detectors.devices import chosen_precision, flags_of_cpu
from farfield.detectors.runtime import Detector
from farfield.detectors.weights import load_weights, resolve_weights
from farfield.experiments.catalogue import find
from farfield.experiments.schema import load_experiment
from farfield.frame import Cloud, Frame
from farfield.radar.cells import REGIONS, Over
from farfield.simulation import simulate_sequence
from farfield.vocabulary.kradar import KRADAR_ORIGIN_M

TABLE = [f"runs/{n}-cirrus-sim-table" for n in ("pointpillars", "voxelnet", "second", "pointrcnn", "sparsecentre")]
PUBLISHED = {  # published widths and voxels, on the window of 250 m x 100 m; untrained
    "second, published widths": ("second-cirrus-sim", ["middle_out=128", "widths=[128,256]", "neck_width=256"]),
    "second, published widths, 0.05 m": (
        "second-cirrus-sim",
        ["middle_out=128", "widths=[128,256]", "neck_width=256", "grid.cell_m=[0.05,0.05,0.1]"],
    ),
    "voxelnet, published widths": (
        "voxelnet-cirrus-sim",
        [
            "vfe_widths=[32,128]",
            "voxel_channels=128",
            "middle_widths=[64,64,64]",
            "widths=[128,128,256]",
            "neck_width=256",
        ],
    ),
}


def busy_cloud(points: int, seed: int) -> Cloud:
    """A simulated cloud inside the detector's window, with just so many points: sweeps of both patterns joined."""
    frames = simulate_sequence("cirrus-sim", seed=seed, sequence=0, frames=2)
    joined = Cloud.concatenate([cloud for frame in frames for cloud in frame.clouds.values()])
    x, y, z = joined.points_m.T
    inside = np.flatnonzero((x >= 0) & (x < 250) & (np.abs(y) < 50) & (z > -6) & (z < 6))
    chosen = np.random.default_rng(seed).choice(inside, points, replace=len(inside) < points)
    return joined[np.sort(chosen)]


def milliseconds(detector: Detector, cloud: Cloud, frames: int, *, warm: int = 3) -> np.ndarray:
    """Time of each frame, the first few left out."""
    taken = []
    for _ in range(frames + warm):
        began = time.perf_counter()
        detector(cloud)
        taken.append(1e3 * (time.perf_counter() - began))
    return np.array(taken[warm:])


def untrained(experiment: str, overrides: Sequence[str], precision: str) -> Detector:
    """The network of an experiment with random weights."""
    changed = [f"detector.{override}" for override in overrides]
    config = load_experiment(find(experiment), changed).detector
    return Detector(build_detector(config, seed=0), precision=precision, device="cpu")


def run_lidar(arguments: Sequence[str]) -> None:
    """Milliseconds from points to boxes after suppression: every detector, 250 m x 100 m, 60,000 points.

        python benchmarks/detector_speed.py lidar [--detectors NAME_OR_RUN ...] [--published] [--rounds 3] [--threads 2]

    Networks of published widths are untrained: their few random boxes cost less suppression. Detectors take turns, so
    that a noisy moment of the machine meets all of them.
    """
    parser = part_parser(run_lidar.__doc__)
    parser.add_argument("--detectors", nargs="+", default=["pointpillars-cirrus-sim", *TABLE])
    parser.add_argument("--frames", type=int, default=8, help="frames of a round")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--points", type=int, default=60_000)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--published", action="store_true", help="also published widths, untrained")
    options = parser.parse_args(arguments)
    torch.set_num_threads(options.threads)
    cloud = busy_cloud(options.points, seed=1)
    built = {}
    for precision in ("bf16", "fp32"):
        for name in options.detectors:
            built[name, precision] = Detector.load(name, precision=precision, device="cpu")
        for name, (experiment, overrides) in PUBLISHED.items() if options.published else ():
            built[name, precision] = untrained(experiment, overrides, precision)
    taken = {key: np.zeros(0) for key in built}
    for _ in range(options.rounds):
        for key, detector in built.items():
            taken[key] = np.concatenate([taken[key], milliseconds(detector, cloud, options.frames)])
    print(
        f"{len(cloud)} points in the window, {options.threads} threads; ms a frame, points to boxes after suppression"
    )
    print(f"{'detector':<34} precision  median     p90     min   parameters  boxes")
    for (name, precision), values in taken.items():
        parameters = sum(p.numel() for p in built[name, precision].network.parameters())
        figures = f"{np.median(values):7.0f} {np.quantile(values, 0.9):7.0f} {values.min():7.0f}"
        boxes = len(built[name, precision](cloud))
        print(f"{name.removeprefix('runs/'):<34} {precision:<9} {figures}   {parameters / 1e6:6.2f} M    {boxes:5d}")
    print(f"\npeak memory of the process {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3:.0f} MB")


SEQUENCES = (0, 20, 45)  # urban in clear air, rain, heavy snow on a highway
DENSITIES = (
    ("rtnh-kradar", "narrow", "region"),
    ("rtnh-kradar", "narrow", "all"),
    ("rtnh-wide-kradar", "wide", "all"),
)
OTHERS = {
    "rtnh-kradar": ("RTNH, 10 %", "radar", 0.1),
    "rtnh-kradar-sim": ("RTNH, simulated, 10 %", "radar", 0.1),
    "rtn50-kradar": ("RTN-50", "radar", 1),
    "rtnx101-kradar": ("RTN-X101", "radar", 1),
    "pointpillars-kradar": ("PointPillars, os2-64", "os2-64", None),
}
BACKGROUND_LOGIT = 4.0


def frames(count: int) -> list[Frame]:
    """Busy frames of sequences in different weather."""
    made = []
    for sequence in SEQUENCES[:count]:
        made += simulate_sequence("kradar-sim", sequence=sequence, frames=1, start=20, sensors=("os2-64", "cells"))
    return made


def cloud_of(frame: Frame, kind: str, region: str, rate: float | None, over: Over = "region") -> Cloud:
    """The radar's strongest cells in a region, or the LiDAR's points, in the radar's frame."""
    if kind == "radar":
        cells = frame.radar["cells"].select(region, rate, over=over)
        return Cloud(cells.points_m(), None, {"power": cells.power})
    cloud = frame.clouds[kind]
    return Cloud(cloud.points_m - np.array(KRADAR_ORIGIN_M, dtype=np.float32), cloud.intensity)


def detector(experiment: str, runs: Path, execution: str = "", precision: str = "bf16") -> Detector:
    """The detector of an experiment, trained if there is a run of that name."""
    config = load_experiment(find(experiment)).detector
    weights = runs / experiment / "weights.safetensors"
    trained = weights.is_file()
    network = load_weights(weights)[0] if trained else build_detector(config, seed=0)
    if not trained and hasattr(network.head, "classes"):
        with torch.no_grad():
            network.head.classes.bias[0] = BACKGROUND_LOGIT
    if execution:
        network.backbone.execution = execution
    return Detector(network, precision=precision, device="cpu")


def in_turns(built: dict[str, tuple[Detector, list[Cloud]]], rounds: int) -> dict[str, np.ndarray]:
    """Milliseconds of each detector on each of its clouds, shape (rounds, clouds)."""
    taken: dict[str, list[list[float]]] = {name: [] for name in built}
    for _ in range(rounds + 1):
        for name, (network, clouds) in built.items():
            row = []
            for cloud in clouds:
                began = time.perf_counter()
                network(cloud)
                row.append(1e3 * (time.perf_counter() - began))
            taken[name].append(row)
    return {name: np.array(rows[1:]) for name, rows in taken.items()}


def densities(shown: list[Frame], runs: Path, rounds: int, only: Sequence[str]) -> Iterator[str]:
    """RTNH in both forms and both densities, one line each."""
    rows, rates = (DENSITIES, (0.01, 0.1)) if [*only] == [*OTHERS] else (DENSITIES[:1], (0.01,))
    for experiment, region, over in rows:
        for rate in rates:
            clouds = [cloud_of(frame, "radar", region, rate, over) for frame in shown]
            ways = ("auto", "sparse", "dense") if rate == 0.01 else ("auto", "dense")
            built = {way: (detector(experiment, runs, way), clouds) for way in ways}
            taken = in_turns(built, rounds)
            per_way = "  ".join(f"{way} {np.median(ms):4.0f} ({ms.min():4.0f})" for way, ms in taken.items())
            each = " ".join(f"{value:.0f}" for value in np.median(taken["auto"], axis=0))
            cells = " ".join(str(len(cloud)) for cloud in clouds)
            form = built["auto"][0].config.form
            whole = "corridor" if over == "region" else "cube"
            what = f"{form:<10}{region:<7}{100 * rate:4.0f} % of {whole:<9}"
            yield f"{what} {per_way}   auto by frame {each}; cells {cells}"


def comparison(shown: list[Frame], runs: Path, rounds: int, only: Sequence[str], *, memory: bool) -> Iterator[str]:
    """The detectors of the paper's tables in the narrow region, one line each."""
    built, others = {}, {name: OTHERS[name] for name in only}
    for precision in ("bf16", "fp32"):
        for experiment, (_, kind, rate) in others.items():
            clouds = [cloud_of(frame, kind, "narrow", rate) for frame in shown]
            built[f"{experiment} {precision}"] = (detector(experiment, runs, precision=precision), clouds)
    taken = in_turns(built, max(1, rounds // 2))
    yield f"{'':<22}parameters  bf16 ms  fp32 ms  peak memory MB, bf16 / fp32 (of which before the network)"
    for experiment, (title, _, _) in others.items():
        bf16, fp32 = (taken[f"{experiment} {precision}"] for precision in ("bf16", "fp32"))
        size = sum(p.numel() for p in built[f"{experiment} bf16"][0].network.parameters()) / 1e6
        peaks = [peak_of(experiment, precision) for precision in ("bf16", "fp32")] if memory else []
        memory_mb = " / ".join(f"{peak['peak_mb']:.0f} ({peak['before_mb']:.0f})" for peak in peaks)
        yield f"{title:<22}{size:8.2f} M  {np.median(bf16):7.0f}  {np.median(fp32):7.0f}  {memory_mb}"


def peak_of(experiment: str, precision: str) -> dict[str, float]:
    """Peak memory of a process that does nothing but detect."""
    printed = child_output("--peak", experiment, "--precision", precision)
    peak: dict[str, float] = json.loads(printed.splitlines()[-1])
    return peak


def print_peak(experiment: str, precision: str) -> None:
    """Detect in three clouds like those of the narrow region and print the memory that it took."""
    rng = np.random.default_rng(0)
    _, kind, rate = OTHERS[experiment]
    count = {"os2-64": 90_000, "radar": int(rate * REGIONS["narrow"].cells) if rate == 0.1 else 102_966}[kind]
    grid = np.stack(np.meshgrid(np.arange(180), np.arange(32), np.arange(20), indexing="ij"), -1).reshape(-1, 3)
    points = grid[rng.choice(len(grid), count, replace=False)] * 0.4 + [0.2, -6.2, -1.8]
    cloud = Cloud(points.astype(np.float32), None, {"power": rng.exponential(0.02, count).astype(np.float32)})
    before_mb = _peak_mb()
    network = detector(experiment, Path("absent"), precision=precision)
    ctypes.CDLL("libc.so.6").malloc_trim(0)  # what building it took
    Path("/proc/self/clear_refs").write_text("5", "ascii")  # forget the peak so far
    for _ in range(3):
        network(cloud)
    print(json.dumps({"peak_mb": _peak_mb(), "before_mb": before_mb}))


def _peak_mb() -> float:
    """Peak resident memory of this program; ``ru_maxrss`` would count the parent, which started it by a fork."""
    status = Path("/proc/self/status").read_text("ascii")
    return int(status.split("VmHWM:")[1].split()[0]) * 1024 / 1e6


def run_radar(arguments: Sequence[str]) -> None:
    """Radar detectors and their LiDAR baseline on simulated K-Radar frames: milliseconds, parameters, peak memory.

        python benchmarks/detector_speed.py radar [--runs DIR] [--rounds 5] [--threads 2] [--frames 3] [--no-memory]

    From a cloud in memory to boxes after suppression. RTNH in both forms, at 1 and 10 %, each convolving sparsely,
    densely and as it chooses itself. The share is that of the corridor's cells, as in the released clouds of benchmark
    v1.0, or of the whole cube's, as in those of v2.0, which keeps more of a region. Then RTN-50, RTN-X101 and
    PointPillars in the narrow region. A run below --runs that bears an experiment's name gives its weights; other
    networks are untrained, and softmax heads are biased to background almost everywhere, as a trained one is. All take
    turns, so that a noisy moment meets all of them. Peak memory is that of a process of its own while it detects in
    three clouds, weights included, beside what it held before it had a network.
    """
    parser = part_parser(run_radar.__doc__)
    parser.add_argument("--runs", type=Path, default=Path("runs"))
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--frames", type=int, default=3, choices=(1, 2, 3))
    parser.add_argument("--no-memory", action="store_true")
    parser.add_argument("--only", nargs="+", choices=list(OTHERS), default=list(OTHERS))
    parser.add_argument("--peak", choices=list(OTHERS), help=argparse.SUPPRESS)
    parser.add_argument("--precision", default="bf16", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    torch.set_num_threads(options.threads)
    if options.peak:
        print_peak(options.peak, options.precision)
        return
    shown = frames(options.frames)
    print(f"RTNH, bf16, {options.threads} threads: ms a frame, median (smallest) over frames and rounds")
    for line in densities(shown, options.runs, options.rounds, options.only):
        print(line, flush=True)
    print(f"\nnarrow region, {options.threads} threads: ms a frame, median over frames and rounds")
    for line in comparison(shown, options.runs, options.rounds, options.only, memory=not options.no_memory):
        print(line, flush=True)


KINDS = {"as it is": "", "AVX-512 alone": "AVX512_CORE"}
NAMES = tuple(f"{name}-cirrus-sim" for name in ("pointpillars", "second", "sparsecentre", "pointrcnn", "voxelnet"))


def measured(names: list[str], points: int, frames: int) -> dict[str, list[float]]:
    """Milliseconds of processor time a frame, by detector and number type; runs in a process of its own."""
    torch.set_num_threads(1)
    cloud, taken = busy_cloud(points, seed=1), {}
    for name in names:
        for precision in ("fp32", "bf16"):
            detector, times = Detector.load(name, precision=precision, device="cpu"), []
            for _ in range(frames + 1):
                began = time.process_time()
                detector(cloud)
                times.append(1e3 * (time.process_time() - began))
            taken[f"{name} {precision}"] = times[1:]
    return taken


def choices(names: list[str]) -> dict[str, str]:
    """What auto takes by detector, and why, where torch sees what oneDNN may use."""
    flags = {"": flags_of_cpu(), "AVX512_CORE": {"avx512": True}}[os.environ.get("ONEDNN_MAX_CPU_ISA", "")]
    networks = {name: DETECTORS[name.removesuffix("-cirrus-sim")].network_class for name in names}
    return {name: ": ".join(chosen_precision(network, flags)) for name, network in networks.items()}


def in_process(isa: str, options: argparse.Namespace, what: str = "--measured") -> dict[str, Any]:
    """The measurement, or the choices, under an instruction set."""
    words = [what, "--points", options.points, "--frames", options.frames, "--detectors", *options.detectors]
    printed = child_output(*words, environment={"ONEDNN_MAX_CPU_ISA": isa} if isa else {})
    return json.loads(printed.splitlines()[-1])


def run_precision(arguments: Sequence[str]) -> None:
    """Float32 and bfloat16 on this processor, and on one without bfloat16 instructions; what auto chooses.

        python benchmarks/detector_speed.py precision [--points 60000] [--frames 6] [--rounds 3]

    oneDNN, which multiplies for torch on a CPU, is told by ONEDNN_MAX_CPU_ISA which instructions it may use:
    AVX512_CORE are those of processors with AVX-512 alone. Those without AVX-512 have nothing to choose. Numbers are
    the processor time of one thread, so that other programs do not count; each kind is a process of its own, and kinds
    take turns.
    """
    parser = part_parser(run_precision.__doc__)
    parser.add_argument("--detectors", nargs="+", default=list(NAMES))
    parser.add_argument("--points", type=int, default=60_000)
    parser.add_argument("--frames", type=int, default=6, help="frames of a round")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--measured", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--chosen", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.measured or options.chosen:
        inner = (
            measured(options.detectors, options.points, options.frames)
            if options.measured
            else choices(options.detectors)
        )
        print(json.dumps(inner))
        return
    taken: dict[tuple[str, str], list[float]] = {}
    for _ in range(options.rounds):
        for kind, isa in KINDS.items():
            for key, times in in_process(isa, options).items():
                taken.setdefault((kind, key), []).extend(times)
    chosen = {kind: in_process(isa, options, "--chosen") for kind, isa in KINDS.items()}
    print(f"{options.points} points; ms of processor time a frame, one thread: median (least)")
    print(f"{'detector':<26} {'processor':<14} {'fp32':>14} {'bf16':>14}   auto takes")
    for name in options.detectors:
        for kind in KINDS:
            cells = [
                f"{np.median(times):7.0f} ({min(times):4.0f})"
                for times in (taken[kind, f"{name} {precision}"] for precision in ("fp32", "bf16"))
            ]
            print(f"{name:<26} {kind:<14} {cells[0]:>14} {cells[1]:>14}   {chosen[kind][name]}")


RANGES_M = (50, 100, 150, 200, 250)
RANGE_DETECTORS = ("pointpillars", "voxelnet:dense", "voxelnet", "second", "sparsecentre")
WORDS = {
    "pointpillars": "PointPillars",
    "voxelnet": "VoxelNet, sparse middle",
    "voxelnet:dense": "VoxelNet, as published",
    "second": "SECOND",
    "sparsecentre": "fully sparse",
}


def clouds(points: int, seed: int, folder: Path, ranges_m: Sequence[int]) -> dict[int, Path]:
    """One cloud for each range: as many points of the same joined sweeps, drawn from its window."""
    frames = simulate_sequence("cirrus-sim", seed=seed, sequence=0, frames=2)
    joined = Cloud.concatenate([cloud for frame in frames for cloud in frame.clouds.values()])
    rows = np.column_stack([joined.points_m, joined.intensity]).astype(np.float32)
    x, y, z = rows[:, :3].T
    paths = {}
    for range_m in ranges_m:
        inside = np.flatnonzero((x >= 0) & (x < range_m) & (np.abs(y) < 50) & (z > -3) & (z < 1))
        chosen = np.random.default_rng(seed).choice(inside, points, replace=False)
        paths[range_m] = folder / f"{range_m}.npy"
        np.save(paths[range_m], rows[np.sort(chosen)])
    return paths


def measure(name: str, range_m: float, cloud_path: Path, frames: int, threads: int) -> dict[str, float]:
    """Median time and peak memory of one detector with one range; runs in a process of its own."""
    torch.set_num_threads(threads)
    rows = np.load(cloud_path, allow_pickle=False)
    cloud = Cloud(rows[:, :3], rows[:, 3])
    torch.mm(torch.ones(8, 8), torch.ones(8, 8))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    kind, _, middle = name.partition(":")
    if kind in WORDS:
        settings = {"name": kind, **({"middle": middle} if middle else {})}
        config, weights = DETECTORS[kind].config_class.model_validate(settings), None
        config = config.model_copy(update={"score_threshold": 0.3})  # above what an untrained network says
    else:
        network, _ = load_weights(resolve_weights(name))
        config, weights = network.config, network.state_dict()
    grid = config.grid.model_copy(update={"range_m": float(range_m)})
    network = build_detector(config.model_copy(update={"grid": grid}), seed=0)
    if weights is not None:
        network.load_state_dict(weights)
    detector = Detector(network, precision="bf16", device="cpu")
    taken, began = [], time.perf_counter()
    while len(taken) < min(3, frames + 2) or (len(taken) < frames + 2 and time.perf_counter() - began < 60):
        start = time.perf_counter()
        found = detector(cloud)
        taken.append(1e3 * (time.perf_counter() - start))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    kept = taken[2:]
    return {
        "ms": float(np.median(kept)),
        "fastest_ms": float(np.min(kept)),
        "mb": (peak - before) / 1e3,
        "boxes": len(found),
    }


def apart(name: str, range_m: int, cloud_path: Path, options: argparse.Namespace) -> dict[str, float]:
    """Run :func:`measure` in a fresh process."""
    printed = child_output(
        *("--one", name, range_m, cloud_path, "--frames", options.frames, "--threads", options.threads)
    )
    result: dict[str, float] = json.loads(printed.splitlines()[-1])
    return result


def draw(found: dict[str, dict[int, dict[str, float]]], points: int, path: Path) -> None:
    """Two panels, time and memory over range, one line a detector, named at its end."""
    from matplotlib.ticker import LogLocator, NullFormatter

    from farfield.figures.style import INK, PATTERNS, figure_bytes, house_style, new_figure

    colours = dict(zip(found, [*PATTERNS[1:], "#7048e8", INK], strict=False))
    colours["sparsecentre"] = PATTERNS[0]
    with house_style():
        figure = new_figure(9.2, 3.9)
        panels = figure.subplots(1, 2)
        for axes, key, title in zip(panels, ("ms", "mb"), ("Time a frame, ms", "Peak memory, MB"), strict=True):
            ends = []
            for name, rows in found.items():
                values = [*(row[key] for row in rows.values())]
                strong = name == "sparsecentre"
                axes.plot(
                    [*rows], values, "o-", color=colours[name], lw=2.6 if strong else 1.4, ms=5 if strong else 3.5
                )
                ends.append((values[-1], name))
            axes.set_yscale("log")
            axes.set_ylim(axes.get_ylim()[0] * 0.8, axes.get_ylim()[1] * 1.25)
            low, high = np.log(axes.get_ylim())
            place = -np.inf
            for value, name in sorted(ends):
                place = max((np.log(value) - low) / (high - low), place + 0.055)
                axes.annotate(
                    WORDS.get(name, Path(name).name),
                    (1.02, place),
                    xycoords="axes fraction",
                    va="center",
                    color=colours[name],
                    fontweight="bold" if name == "sparsecentre" else "normal",
                )
            axes.set_title(title)
            axes.set_xticks([*rows], [f"{r} m" for r in rows])
            axes.grid(True, which="major")
            axes.tick_params(which="minor", length=0)
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.yaxis.set_major_formatter("{x:,.0f}")
            axes.yaxis.set_minor_formatter(NullFormatter())
        figure.supxlabel(
            f"length of the window; {points:,} points in each, 100 m wide", fontsize=8.5, x=0.02, ha="left"
        )
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(figure_bytes(figure, "png", dpi=150))


def run_range(arguments: Sequence[str]) -> None:
    """Time and memory of dense and sparse detectors as the range grows and the number of points does not.

        python benchmarks/detector_speed.py range [--detectors NAME_OR_WEIGHTS ...] [--points 30000] [--frames 15]
                                                  [--figure PNG]

    Every window is 100 m wide and 50 to 250 m long and holds the same number of points of simulated sweeps. A name of a
    detector stands for its default network, untrained; ``voxelnet:dense`` for VoxelNet with dense 3D convolutions;
    anything else for trained weights. Each figure comes from a process of its own.
    """
    parser = part_parser(run_range.__doc__)
    parser.add_argument("--detectors", nargs="+", default=list(RANGE_DETECTORS))
    parser.add_argument("--points", type=int, default=30_000)
    parser.add_argument("--frames", type=int, default=15)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--ranges", type=int, nargs="+", default=RANGES_M, help="m")
    parser.add_argument("--figure", type=Path, help="where it is drawn, as docs/images/range_cost.png")
    parser.add_argument("--one", nargs=3, metavar=("NAME", "RANGE", "CLOUD"), help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.one:
        name, range_m, path = options.one
        print(json.dumps(measure(name, float(range_m), Path(path), options.frames, options.threads)))
        return
    print(f"{options.points} points in every window, bf16, {options.threads} threads, medians, points to boxes.")
    print("Peak memory is that of a process of its own less what the imports took.\n")
    print(f"{'':<26}" + "".join(f"{f'{r} m':>16}" for r in options.ranges) + "   longest / shortest")
    found: dict[str, dict[int, dict[str, float]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        paths = clouds(options.points, 1, Path(folder), options.ranges)
        for name in options.detectors:
            found[name] = {r: apart(name, r, path, options) for r, path in paths.items()}
            texts = [f"{row['ms']:.0f} ms {row['mb']:.0f} MB" for row in found[name].values()]
            cells = "".join(f"{text:>16}" for text in texts)
            first, last = (found[name][r] for r in (options.ranges[0], options.ranges[-1]))
            ratios = f"{last['ms'] / first['ms']:>8.1f} x {last['mb'] / max(first['mb'], 0.1):.1f} x"
            print(f"{WORDS.get(name, name):<26}{cells}{ratios}", flush=True)
    if options.figure:
        draw(found, options.points, options.figure)


if __name__ == "__main__":
    raise SystemExit(
        run_parts(
            __doc__,
            {
                "lidar": Part(
                    run_lidar, "--detectors pointpillars-cirrus-sim --frames 1 --rounds 1 --points 2000 --threads 1"
                ),
                "radar": Part(run_radar, "--rounds 1 --frames 1 --threads 1 --no-memory --only rtn50-kradar"),
                "precision": Part(
                    run_precision, "--detectors pointpillars-cirrus-sim --frames 1 --rounds 1 --points 2000"
                ),
                "range": Part(
                    run_range, "--detectors pointpillars --ranges 50 100 --frames 1 --points 2000 --threads 1"
                ),
            },
        )
    )

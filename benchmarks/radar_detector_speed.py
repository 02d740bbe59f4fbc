"""Radar detectors and their LiDAR baseline on simulated K-Radar frames: milliseconds, parameters, peak memory.

usage: python benchmarks/radar_detector_speed.py [--runs DIR] [--rounds 5] [--threads 2] [--frames 3] [--no-memory]

From a cloud in memory to boxes after suppression. RTNH in both forms, at 1 and 10 %, each convolving sparsely, densely
and as it chooses itself. The share is that of the corridor's cells, as in the released clouds of benchmark v1.0, or of
the whole cube's, as in those of v2.0, which keeps more of a region. Then RTN-50, RTN-X101 and PointPillars in the
narrow region. A run below --runs that bears an experiment's name gives its weights; other networks are untrained, and
softmax heads are biased to background almost everywhere, as a trained one is. All take turns, so that a noisy
moment meets all of them. Peak memory is that of a process of its own while it detects in three clouds, weights
included, beside what it held before it had a network.
"""

import argparse
import ctypes
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from _report import header

from farfield.detectors import build_detector
from farfield.detectors.runtime import Detector
from farfield.detectors.weights import load_weights
from farfield.experiments.catalogue import find
from farfield.experiments.schema import load_experiment
from farfield.frame import Cloud, Frame
from farfield.radar.axes import KRADAR_ORIGIN_M
from farfield.radar.cells import REGIONS, Over
from farfield.simulation import simulate_sequence

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


def densities(shown: list[Frame], runs: Path, rounds: int) -> Iterator[str]:
    """RTNH in both forms and both densities, one line each."""
    for experiment, region, over in DENSITIES:
        for rate in (0.01, 0.1):
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


def comparison(shown: list[Frame], runs: Path, rounds: int, memory: bool) -> Iterator[str]:
    """The detectors of the paper's tables in the narrow region, one line each."""
    built = {}
    for precision in ("bf16", "fp32"):
        for experiment, (_, kind, rate) in OTHERS.items():
            clouds = [cloud_of(frame, kind, "narrow", rate) for frame in shown]
            built[f"{experiment} {precision}"] = (detector(experiment, runs, precision=precision), clouds)
    taken = in_turns(built, max(1, rounds // 2))
    yield f"{'':<22}parameters  bf16 ms  fp32 ms  peak memory MB, bf16 / fp32 (of which before the network)"
    for experiment, (title, _, _) in OTHERS.items():
        bf16, fp32 = (taken[f"{experiment} {precision}"] for precision in ("bf16", "fp32"))
        size = sum(p.numel() for p in built[f"{experiment} bf16"][0].network.parameters()) / 1e6
        peaks = [peak_of(experiment, precision) for precision in ("bf16", "fp32")] if memory else []
        memory_mb = " / ".join(f"{peak['peak_mb']:.0f} ({peak['before_mb']:.0f})" for peak in peaks)
        yield f"{title:<22}{size:8.2f} M  {np.median(bf16):7.0f}  {np.median(fp32):7.0f}  {memory_mb}"


def peak_of(experiment: str, precision: str) -> dict[str, float]:
    """Peak memory of a process that does nothing but detect."""
    command = [sys.executable, __file__, "--peak", experiment, "--precision", precision]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    peak: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=Path, default=Path("runs"))
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--frames", type=int, default=3, choices=(1, 2, 3))
    parser.add_argument("--no-memory", action="store_true")
    parser.add_argument("--peak", choices=list(OTHERS), help=argparse.SUPPRESS)
    parser.add_argument("--precision", default="bf16", help=argparse.SUPPRESS)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    if options.peak:
        print_peak(options.peak, options.precision)
        return
    print(header(), "\n", sep="")
    shown = frames(options.frames)
    print(f"RTNH, bf16, {options.threads} threads: ms a frame, median (smallest) over frames and rounds")
    for line in densities(shown, options.runs, options.rounds):
        print(line, flush=True)
    print(f"\nnarrow region, {options.threads} threads: ms a frame, median over frames and rounds")
    for line in comparison(shown, options.runs, options.rounds, not options.no_memory):
        print(line, flush=True)


if __name__ == "__main__":
    main()

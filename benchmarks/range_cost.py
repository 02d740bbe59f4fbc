"""Time and memory of dense and sparse detectors as the range grows and the number of points does not.

usage: python benchmarks/range_cost.py [--detectors NAME_OR_WEIGHTS ...] [--points 30000] [--frames 15] [--figure PNG]

Every window is 100 m wide and 50 to 250 m long and holds the same number of points of simulated sweeps. A name of a
detector stands for its default network, untrained; ``voxelnet:dense`` for VoxelNet with dense 3D convolutions; anything
else for trained weights. Each figure comes from a process of its own.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from _report import ROOT, header

RANGES_M = (50, 100, 150, 200, 250)
DETECTORS = ("pointpillars", "voxelnet:dense", "voxelnet", "second", "sparsecentre")
WORDS = {
    "pointpillars": "PointPillars",
    "voxelnet": "VoxelNet, sparse middle",
    "voxelnet:dense": "VoxelNet, as published",
    "second": "SECOND",
    "sparsecentre": "fully sparse",
}


def clouds(points: int, seed: int, folder: Path) -> dict[int, Path]:
    """One cloud for each range: as many points of the same joined sweeps, drawn from its window."""
    from farfield.frame import Cloud
    from farfield.simulation import simulate_sequence

    frames = simulate_sequence("cirrus-sim", seed=seed, sequence=0, frames=2)
    joined = Cloud.concatenate([cloud for frame in frames for cloud in frame.clouds.values()])
    rows = np.column_stack([joined.points_m, joined.intensity]).astype(np.float32)
    x, y, z = rows[:, :3].T
    paths = {}
    for range_m in RANGES_M:
        inside = np.flatnonzero((x >= 0) & (x < range_m) & (np.abs(y) < 50) & (z > -3) & (z < 1))
        chosen = np.random.default_rng(seed).choice(inside, points, replace=False)
        paths[range_m] = folder / f"{range_m}.npy"
        np.save(paths[range_m], rows[np.sort(chosen)])
    return paths


def measure(name: str, range_m: float, cloud_path: Path, frames: int, threads: int) -> dict[str, float]:
    """Median time and peak memory of one detector with one range; runs in a process of its own."""
    import torch

    from farfield.detectors import DETECTORS, build_detector
    from farfield.detectors.runtime import Detector
    from farfield.detectors.weights import load_weights, resolve_weights
    from farfield.frame import Cloud

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
    while len(taken) < 3 or (len(taken) < frames + 2 and time.perf_counter() - began < 60):
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
    one = ["--one", name, str(range_m), str(cloud_path), "--frames", str(options.frames)]
    done = subprocess.run(
        [sys.executable, __file__, *one, "--threads", str(options.threads)],
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise SystemExit(f"{name} at {range_m} m:\n{done.stderr}")
    result: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
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
                values = [rows[r][key] for r in RANGES_M]
                strong = name == "sparsecentre"
                axes.plot(
                    RANGES_M, values, "o-", color=colours[name], lw=2.6 if strong else 1.4, ms=5 if strong else 3.5
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
            axes.set_xticks(RANGES_M, [f"{r} m" for r in RANGES_M])
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--detectors", nargs="+", default=list(DETECTORS))
    parser.add_argument("--points", type=int, default=30_000)
    parser.add_argument("--frames", type=int, default=15)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--figure", type=Path, default=ROOT / "docs" / "images" / "range_cost.png")
    parser.add_argument("--one", nargs=3, metavar=("NAME", "RANGE", "CLOUD"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        name, range_m, path = options.one
        print(json.dumps(measure(name, float(range_m), Path(path), options.frames, options.threads)))
        return
    print(header(), "\n", sep="")
    print(f"{options.points} points in every window, bf16, {options.threads} threads, medians, points to boxes.")
    print("Peak memory is that of a process of its own less what the imports took.\n")
    print(f"{'':<26}" + "".join(f"{f'{r} m':>16}" for r in RANGES_M) + "      250 m / 50 m")
    found: dict[str, dict[int, dict[str, float]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        paths = clouds(options.points, 1, Path(folder))
        for name in options.detectors:
            found[name] = {r: apart(name, r, path, options) for r, path in paths.items()}
            texts = [f"{row['ms']:.0f} ms {row['mb']:.0f} MB" for row in found[name].values()]
            cells = "".join(f"{text:>16}" for text in texts)
            first, last = (found[name][r] for r in (RANGES_M[0], RANGES_M[-1]))
            ratios = f"{last['ms'] / first['ms']:>8.1f} x {last['mb'] / first['mb']:.1f} x"
            print(f"{WORDS.get(name, name):<26}{cells}{ratios}", flush=True)
    draw(found, options.points, options.figure)


if __name__ == "__main__":
    main()

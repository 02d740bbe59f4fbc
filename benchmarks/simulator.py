"""The simulator: seconds a frame, the detection law at 200 m, and the statistics of its frames beside real ones.

    python benchmarks/simulator.py [--sequences 20] [--frames 5] [--output benchmarks/results/simulator.txt]

Real figures: shares of points by elevation in frames of a sister sensor (0.31-0.32, 0.68-0.70, 0.95-0.96), points on a
car's rear by solid angle, points per box falling with the square of the distance. Exit status 1 where a 10 % target at
200 m is not seen with probability 0.90 +- 0.02, or a frame takes more than 0.5 s.
"""

import argparse
import time
from pathlib import Path

import numpy as np
from _report import header

from farfield.files.atomic import write_text
from farfield.frame import Frame
from farfield.simulation import find_preset, simulate_frame
from farfield.simulation.lidar.model import LidarModel, detection_probability, signal

VEHICLES = ("vehicle", "large_vehicle")
BINS_M = ((0, 30), (30, 70), (70, 100), (100, 150), (150, 200), (200, 250), (250, 350))
SPEED_LIMIT_S = 0.5


def frames_and_times(sequences: int, frames: int) -> tuple[list[Frame], list[float], list[float]]:
    """Frames, seconds of each sequence's first frame (its world included) and of the others."""
    preset = find_preset("cirrus-sim", duration_s=20.0, stride_s=1.0)
    made, first, later = [], [], []
    for sequence in range(sequences):
        for index in range(frames):
            start = time.perf_counter()
            frame = simulate_frame(preset, seed=99, sequence=sequence, index=index)
            (later if index else first).append(time.perf_counter() - start)
            made.append(frame)
    return made, first, later


def law() -> str:
    model = LidarModel()
    ranges = np.array([100.0, 150, 200, 245, 300])
    lines = []
    for rho in (0.1, 0.25):
        strength, _ = signal(model, ranges, np.ones(5), np.full(5, rho), np.full(5, 16))
        chance = detection_probability(model, strength) * (1 - model.dropout)
        lines.append(
            f"  {rho:4.0%} target  " + "  ".join(f"{r:.0f} m {c:.3f}" for r, c in zip(ranges, chance, strict=True))
        )
    return "\n".join(lines)


def elevation_shares(frames: list[Frame]) -> str:
    shares = []
    for frame in frames:
        x, y, z = frame.clouds["gaussian"].points_m.T
        elevation = np.degrees(np.arctan2(z, np.hypot(x, y)))
        shares.append([np.mean(np.abs(elevation + 2) < reach) for reach in (2, 5, 10)])
    return "  ".join(
        f"|el + 2| < {reach}: {share:.3f}" for reach, share in zip((2, 5, 10), np.mean(shares, axis=0), strict=True)
    )


def by_range(frames: list[Frame]) -> tuple[str, str]:
    """Vehicles by distance with their points, and the exponents of points over distance."""
    boxes = [frame.boxes for frame in frames]
    label = np.concatenate([box.label for box in boxes])
    chosen = np.isin(label, VEHICLES)
    range_m = np.concatenate([box.range_m for box in boxes])[chosen]
    counts = {
        name: np.concatenate([frame.annotation.details[f"point_count_{name}"] for frame in frames])[chosen]
        for name in ("gaussian", "uniform")
    }
    rows = ["  range m    a frame  median points Gaussian  uniform  ratio of sums"]
    for low, high in BINS_M:
        inside = (range_m >= low) & (range_m < high)
        if inside.any():
            g, u = counts["gaussian"][inside], counts["uniform"][inside]
            row = f"  {low:3d}-{high:3d}  {inside.sum() / len(frames):9.2f}  {np.median(g):22.0f}  {np.median(u):7.0f}"
            rows.append(f"{row}  {g.sum() / max(u.sum(), 1):13.2f}")
    fit = (range_m > 20) & (range_m < 120)
    slopes = {
        name: np.polyfit(np.log(range_m[fit]), np.log(np.maximum(count[fit], 0.5)), 1)[0]
        for name, count in counts.items()
    }
    return "\n".join(rows), ", ".join(f"{name} {slope:.2f}" for name, slope in slopes.items())


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sequences", type=int, default=20)
    parser.add_argument("--frames", type=int, default=5)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    frames, first, later = frames_and_times(options.sequences, options.frames)
    model = LidarModel()
    strength, _ = signal(model, np.array([200.0]), np.ones(1), np.array([0.1]), np.array([16]))
    at_200 = float(detection_probability(model, strength)[0]) * (1 - model.dropout)
    median = float(np.median(later))
    points = {name: np.mean([len(frame.clouds[name]) for frame in frames]) for name in ("gaussian", "uniform")}
    names, counts = np.unique(np.concatenate([frame.boxes.label for frame in frames]), return_counts=True)
    table, slopes = by_range(frames)
    text = "\n".join(
        [
            header(),
            "",
            f"frame, both patterns, one process: median {median:.3f} s, 90 % under {np.percentile(later, 90):.3f} s",
            f"first frame of a sequence, its world included: median {np.median(first):.3f} s",
            f"returns of 60,032 shots: Gaussian {points['gaussian']:.0f}, uniform {points['uniform']:.0f}",
            "probability of detection, dropout included:",
            law(),
            f"Gaussian returns {elevation_shares(frames)}  (real: 0.31-0.32, 0.68-0.70, 0.95-0.96)",
            f"annotated a frame {counts.sum() / len(frames):.1f}: "
            + ", ".join(f"{count} {name}" for name, count in zip(names, counts, strict=True)),
            "vehicles (with large ones):",
            table,
            f"points a vehicle over distance, exponent between 20 and 120 m: {slopes} (-2 but for what hides them)",
            "",
        ]
    )
    print(text)
    if options.output:
        write_text(options.output, text)
    return int(abs(at_200 - 0.90) > 0.02 or median > SPEED_LIMIT_S)


if __name__ == "__main__":
    raise SystemExit(main())

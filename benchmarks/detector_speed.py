"""Milliseconds from points to boxes after suppression: every detector, 250 m x 100 m, 60,000 points, two CPU threads.

usage: python benchmarks/detector_speed.py [--detectors NAME_OR_RUN ...] [--published] [--rounds 3] [--threads 2]

Networks of published widths are untrained: their few random boxes cost less suppression. Detectors take turns, so that
a noisy moment of the machine meets all of them.
"""

import argparse
import resource
import time
from collections.abc import Sequence

import numpy as np
import torch
from _report import header

from farfield.detectors import build_detector
from farfield.detectors.runtime import Detector
from farfield.experiments.catalogue import find
from farfield.experiments.schema import load_experiment
from farfield.frame import Cloud
from farfield.simulation import simulate_sequence

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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--detectors", nargs="+", default=["pointpillars-cirrus-sim", *TABLE])
    parser.add_argument("--frames", type=int, default=8, help="frames of a round")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--points", type=int, default=60_000)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--published", action="store_true", help="also published widths, untrained")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    print(header(), "\n", sep="")
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


if __name__ == "__main__":
    main()

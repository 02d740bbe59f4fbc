"""Milliseconds from points to boxes after suppression: the shipped PointPillars, 250 m x 100 m, 60,000 points.

usage: python benchmarks/detector_speed.py [--detector NAME] [--frames 40] [--threads 2]
"""

import argparse
import resource
import time

import numpy as np
import torch
from _report import header

from farfield.detectors.runtime import Detector
from farfield.frame import Cloud
from farfield.simulation import simulate_sequence


def busy_cloud(points: int, seed: int) -> Cloud:
    """A simulated cloud inside the detector's window, with just so many points: sweeps of both patterns joined."""
    frames = simulate_sequence("cirrus-sim", seed=seed, sequence=0, frames=2, uniform_offset_ms=0.0)
    joined = Cloud.concatenate([cloud for frame in frames for cloud in frame.clouds.values()])
    x, y, z = joined.points_m.T
    inside = np.flatnonzero((x >= 0) & (x < 250) & (np.abs(y) < 50) & (z > -6) & (z < 6))
    chosen = np.random.default_rng(seed).choice(inside, points, replace=len(inside) < points)
    return joined[np.sort(chosen)]


def milliseconds(detector: Detector, cloud: Cloud, frames: int) -> np.ndarray:
    """Time of each frame, the first few left out."""
    taken = []
    for _ in range(frames + 5):
        began = time.perf_counter()
        detector(cloud)
        taken.append(1e3 * (time.perf_counter() - began))
    return np.array(taken[5:])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--detector", default="pointpillars-cirrus-sim")
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--points", type=int, default=60_000)
    parser.add_argument("--threads", type=int, default=2)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    print(header(), "\n", sep="")
    cloud = busy_cloud(options.points, seed=1)
    detectors = {name: Detector.load(options.detector, precision=name, device="cpu") for name in ("bf16", "fp32")}
    config = detectors["fp32"].config
    nx, ny = config.grid.shape(int(np.prod(config.strides)))
    parameters = sum(p.numel() for p in detectors["fp32"].network.parameters())
    cell_m = config.grid.cell_m
    print(f"{options.detector}: pillars of {cell_m} m, {nx} x {ny} ({nx * cell_m:g} x {ny * cell_m:g} m)")
    print(f"widths {config.pillar_channels} -> {config.widths}, depths {config.depths}, necks {config.neck_width}")
    print(f"{parameters / 1e6:.2f} M parameters")
    print(f"{len(cloud)} points in the window, {len(detectors['fp32'](cloud))} boxes, {options.threads} threads\n")
    print("precision   median      p90      min   (ms a frame, voxelisation to boxes after suppression)")
    for _ in range(2):  # alternating, so that a noisy moment of the machine shows
        for name, detector in detectors.items():
            taken = milliseconds(detector, cloud, options.frames)
            print(f"{name:<9} {np.median(taken):8.1f} {np.quantile(taken, 0.9):8.1f} {taken.min():8.1f}")
    print(f"\npeak memory of the process {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3:.0f} MB")


if __name__ == "__main__":
    main()

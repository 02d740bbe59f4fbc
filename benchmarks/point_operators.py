"""Milliseconds of the point operators and of PointRCNN, points to boxes, on simulated clouds over 250 m x 100 m.

usage: python benchmarks/point_operators.py [--points 16384 40000] [--repeats 10] [--threads 2] [--device cpu]
"""

import argparse
import time
from collections.abc import Callable
from functools import partial

import numpy as np
import torch
from _report import header

from farfield.detectors.inputs import POSITION, cloud_tensor
from farfield.detectors.pointrcnn import points as ops
from farfield.detectors.pointrcnn.network import PointRCNN, PointRCNNConfig
from farfield.detectors.runtime import Detector
from farfield.frame import Cloud
from farfield.simulation import simulate_sequence

CENTRES = 4096


def simulated_cloud(points: int) -> Cloud:
    """So many points of a simulated frame inside the window: sweeps of both patterns joined."""
    frames = simulate_sequence("cirrus-sim", seed=1, sequence=0, frames=2)
    joined = Cloud.concatenate([cloud for frame in frames for cloud in frame.clouds.values()])
    x, y, z = joined.points_m.T
    inside = np.flatnonzero((x >= 0) & (x < 250) & (np.abs(y) < 50) & (np.abs(z) < 6))
    return joined[np.sort(np.random.default_rng(1).choice(inside, points, replace=len(inside) < points))]


def milliseconds(work: Callable[[], object], repeats: int, device: str) -> tuple[float, float]:
    """Least and median time of several runs, after one that does not count."""
    taken = []
    for _ in range(repeats + 1):
        began = time.perf_counter()
        work()
        if device == "cuda":
            torch.cuda.synchronize()
        taken.append(1e3 * (time.perf_counter() - began))
    return min(taken[1:]), float(np.median(taken[1:]))


def operators(cloud: torch.Tensor) -> dict[str, Callable[[], object]]:
    """Every operator on one frame, as PointRCNN calls it."""
    xyz, n = cloud[:, :3].contiguous(), [len(cloud)]
    chosen, taken = ops.farthest_points(xyz, n, CENTRES)
    centres = xyz[chosen]
    far_first = centres[:128]
    rois = torch.cat([far_first, xyz.new_tensor([4.6, 1.9, 1.7, 0.3]).expand(128, 4)], 1)
    group = ops.ball_query(xyz, n, centres, taken, radii_m=(1.0,), limits=(32,))[0]
    features = torch.randn(len(group.point), 64, device=xyz.device)
    row, weight = ops.three_nearest(xyz, n, centres, taken)
    coarse = torch.randn(len(centres), 128, device=xyz.device)
    return {
        f"farthest points, {CENTRES}": lambda: ops.farthest_points(xyz, n, CENTRES),
        f"one point a voxel, {CENTRES}": lambda: ops.spread_points(xyz, n, CENTRES),
        "ball query, 0.1 and 0.5 m": lambda: ops.ball_query(
            xyz, n, centres, taken, radii_m=(0.1, 0.5), limits=(16, 32)
        ),
        "ball query, 0.3 and 1.0 m": lambda: ops.ball_query(
            xyz, n, centres, taken, radii_m=(0.3, 1.0), limits=(16, 32)
        ),
        f"group maximum, {len(group.point)} x 64": lambda: ops.group_max(features, group),
        f"three nearest of {CENTRES}": lambda: ops.three_nearest(xyz, n, centres, taken),
        "interpolation, 128 features": lambda: ops.interpolate(coarse, row, weight),
        "RoI pooling, 128 boxes": lambda: ops.points_in_rois(xyz, n, rois, [128], context_m=1.0, limit=512),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, nargs="+", default=[16384, 40000])
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--device", default="cpu", choices=["cpu", "cuda"])
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    torch.manual_seed(0)
    print(header(), "\n", sep="")
    print(f"{options.threads} threads, {options.device}; least and median of {options.repeats} runs, ms\n")
    for count in options.points:
        cloud = simulated_cloud(count)
        print(f"{count} points")
        tensor = cloud_tensor(cloud, POSITION).to(options.device)
        work = operators(tensor)
        network = PointRCNN(PointRCNNConfig(points=count))
        torch.nn.init.constant_(network.segmentation[-1].bias, 0.0)  # untrained: let it propose as many as it may
        for precision in ("fp32", "bf16"):
            detector = Detector(network, precision=precision, device=options.device)
            work[f"PointRCNN {precision}, {count} points read"] = partial(detector, cloud)
        for name, function in work.items():
            least, median = milliseconds(function, options.repeats, options.device)
            print(f"  {name:<44}{least:9.2f}{median:9.2f}")
        print()


if __name__ == "__main__":
    main()

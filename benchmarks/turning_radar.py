"""The simulated turning radar beside the nine real pictures of RADIATE's sample, and left-hand traffic in all layouts.

python benchmarks/turning_radar.py [--data RADIATE] [--frames 4] [--output benchmarks/results/turning_radar.txt]
"""

import argparse
from pathlib import Path

import numpy as np
from _report import SHARED_REAL, header

from farfield.datasets.radiate import Radiate
from farfield.files.atomic import write_text
from farfield.radar.turning import CELL_M
from farfield.simulation import simulate_frame
from farfield.simulation.world.scene import ROADS, WorldScene

BANDS_M = ((0, 2), (2, 5), (5, 10), (10, 20), (20, 45), (45, 80), (80, 100))
QUANTILES = (5, 25, 50, 75, 95, 99)


def lines_of(theirs: np.ndarray, ours: np.ndarray) -> list[str]:
    """Counts (half decibels) at quantiles by range, real over simulated, and how neighbouring cells correlate."""
    lines = [
        "counts of the polar picture, real | simulated",
        f"{'metres':<10}" + "".join(f"{q:>12} %" for q in QUANTILES),
    ]
    for near, far in BANDS_M:
        rows = slice(int(near / CELL_M), int(far / CELL_M))
        pairs = zip(*(np.percentile(each[:, rows], QUANTILES) for each in (theirs, ours)), strict=True)
        lines.append(f"{f'{near}-{far}':<10}" + "".join(f"{f'{a:.0f} | {b:.0f}':>14}" for a, b in pairs))
    for name, axis in (("range", 1), ("azimuth", 2)):
        said = " | ".join(f"{correlation(each[:, 60:], axis):.2f}" for each in (theirs, ours))
        lines.append(f"correlation of neighbours along {name}: {said}")
    return lines


def correlation(pictures: np.ndarray, axis: int) -> float:
    count = pictures.shape[axis]
    one, other = (np.take(pictures, range(k, k + count - 1), axis) for k in (0, 1))
    return float(np.corrcoef(one.ravel(), other.ravel())[0, 1])


def passing() -> list[str]:
    """By road, on which side those pass that come towards: the median offset to the left of one's own course."""
    lines = ["", "vehicles that come towards, number and median offset to the left in metres: right-hand | left-hand"]
    for road in ROADS:
        said = []
        for side in ("right", "left"):
            found = np.concatenate([offsets(road, side, seed) for seed in range(4)])
            said.append(f"{len(found)}, {np.median(found):+.1f}" if len(found) else "none")
        lines.append(f"{road:<14} {' | '.join(said)}")
    return lines


def offsets(road: str, side: str, seed: int) -> np.ndarray:
    window = WorldScene(road, np.random.SeedSequence(seed), duration_s=6.0, traffic=side).window(3.0, reach_m=150.0)
    here = window.world_T_ego_now
    vehicles = np.array([actor.label in ("vehicle", "large_vehicle") for actor in window.actors], dtype=bool)
    offset = (window.bottom_m - here[:3, 3]) @ here[:3, :2]
    towards = vehicles & (window.velocity_m_s @ here[:3, 0] < -3.0) & (offset[:, 0] < 80.0)
    return offset[towards, 1]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=SHARED_REAL / "radiate", help="a folder of RADIATE's sequences")
    parser.add_argument("--frames", type=int, default=4, help="simulated turns, each of a drive of its own")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    real = Radiate(options.data)
    theirs = np.stack([np.asarray(real[index].radar["polar"]) for index in range(len(real))]) * 255
    frames = (simulate_frame("radiate-sim", sequence=k, index=4, sensors=("polar",)) for k in range(options.frames))
    ours = np.stack([np.asarray(frame.radar["polar"]) for frame in frames]) * 255
    said = f"{len(theirs)} real turns of one drive in fog, {len(ours)} simulated ones of as many drives"
    text = "\n".join([header(), "", said, *lines_of(theirs, ours), *passing(), ""])
    print(text)
    if options.output:
        write_text(options.output, text)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

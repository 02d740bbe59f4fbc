"""Rotated IoU in float64: overlapping pairs per second, and the error in analytic cases 250 m from the sensor.

    python benchmarks/iou.py [--pairs 400000] [--repeats 5] [--output benchmarks/results/iou.txt]

Boxes go in and IoU comes out (``paired_iou``), rejection of far pairs and heights included. Exit status 1 where an
error reaches 1e-9 or two threads stay below 500,000 pairs per second.
"""

import argparse
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from _report import header

from farfield.files.atomic import write_text
from farfield.geometry.boxes import Boxes
from farfield.geometry.iou import paired_iou

REQUIRED_PER_S, TOLERANCE = 500_000, 1e-9
SIZE_M = (4.5, 1.9, 1.6)


def overlapping_pairs(count: int) -> tuple[Boxes, Boxes]:
    """Vehicles anywhere to 250 m and detections of them: centres off by decimetres, sizes by a tenth, any heading."""
    rng = np.random.default_rng(7)
    centre_m = np.column_stack(
        [rng.uniform(0, 250, count), rng.uniform(-50, 50, count), rng.uniform(-1.5, -0.5, count)]
    )
    size_m = np.array(SIZE_M) * rng.uniform(0.8, 1.3, (count, 3))
    annotated = Boxes(centre_m=centre_m, size_m=size_m, yaw_rad=rng.uniform(-np.pi, np.pi, count))
    detected = Boxes(
        centre_m=centre_m + rng.normal(0, [0.3, 0.3, 0.1], (count, 3)),
        size_m=size_m * rng.uniform(0.9, 1.1, (count, 3)),
        yaw_rad=annotated.yaw_rad + rng.normal(0, 0.3, count) + np.pi * rng.integers(0, 2, count),
    )
    overlap = paired_iou(annotated, detected) > 0
    return annotated[overlap], detected[overlap]


def pairs_per_second(a: Boxes, b: Boxes, *, kind: str, threads: int, repeats: int) -> list[tuple[float, float]]:
    parts = [slice(start, start + len(a) // threads) for start in range(0, len(a), len(a) // threads)]
    halves = [(a[part], b[part]) for part in parts]
    rates = []
    with ThreadPoolExecutor(threads) as pool:
        for _ in range(repeats):
            start = time.perf_counter(), time.process_time()
            list(pool.map(lambda pair: paired_iou(*pair, kind=kind), halves))
            rates.append((len(a) / (time.perf_counter() - start[0]), len(a) / (time.process_time() - start[1])))
    return sorted(rates)


def far_boxes(size_m: tuple[float, float, float] = SIZE_M, *, count: int = 20_000) -> Boxes:
    """Boxes of one size 250 m away, in random directions with random headings, the four axis-parallel ones first."""
    rng = np.random.default_rng(11)
    azimuth_rad, yaw_rad = rng.uniform(-np.pi, np.pi, (2, count))
    yaw_rad[:4] = np.arange(4) * np.pi / 2
    centre_m = np.column_stack([250 * np.cos(azimuth_rad), 250 * np.sin(azimuth_rad), np.full(count, -1.0)])
    return Boxes(centre_m=centre_m, size_m=np.tile(size_m, (count, 1)), yaw_rad=yaw_rad)


def moved(
    boxes: Boxes, ahead_m: float = 0, left_m: float = 0, turn_rad: float = 0, size_m: tuple[float, ...] | None = None
) -> Boxes:
    cos, sin = np.cos(boxes.yaw_rad), np.sin(boxes.yaw_rad)
    offset = [ahead_m * cos - left_m * sin, ahead_m * sin + left_m * cos, np.zeros(len(boxes))]
    size = boxes.size_m if size_m is None else np.tile(size_m, (len(boxes), 1))
    return boxes.replace(
        centre_m=boxes.centre_m + np.column_stack(offset), yaw_rad=boxes.yaw_rad + turn_rad, size_m=size
    )


def analytic_cases() -> Iterator[tuple[str, Boxes, Boxes, float]]:
    """Name, boxes, their partners, exact IoU (the same in BEV and 3D, because the heights agree)."""
    length, width, height = SIZE_M
    car, square = far_boxes(), far_boxes((2.5, 2.5, 1.0))
    yield "coincident", car, car, 1.0
    yield "turned by pi", car, moved(car, turn_rad=np.pi), 1.0
    yield "square turned by pi/2", square, moved(square, turn_rad=np.pi / 2), 1.0
    yield "square turned by pi/4", square, moved(square, turn_rad=np.pi / 4), float(np.sqrt(0.5))
    yield "shared side edges", car, moved(car, ahead_m=1.7), (length - 1.7) / (length + 1.7)
    yield "shared side edges, turned by pi", car, moved(car, 1.7, turn_rad=np.pi), (length - 1.7) / (length + 1.7)
    yield "shared front edges", car, moved(car, left_m=0.6), (width - 0.6) / (width + 0.6)
    yield "nested, turned", car, moved(car, 0.3, -0.1, 0.2, (1.0, 0.8, height)), 0.8 / (length * width)
    yield "nested, shared corner", car, moved(car, 1.75, 0.45, 0, (1.0, 1.0, height)), 1 / (length * width)
    yield "crossed", car, moved(car, turn_rad=np.pi / 2), width**2 / (2 * length * width - width**2)
    yield "touching ends", car, moved(car, ahead_m=length), 0.0
    yield "touching sides", car, moved(car, left_m=width), 0.0
    yield "touching corners", car, moved(car, length, width), 0.0
    yield "far apart", car, moved(car, ahead_m=30.0), 0.0


def report(pairs: int, repeats: int) -> tuple[str, bool]:
    a, b = overlapping_pairs(pairs)
    good = True
    lines = [header(), "", f"{len(a)} overlapping pairs; million pairs per second, best and median of {repeats},"]
    lines += ["and per second of processor time in one core (free of what other programs take)"]
    for kind in ("bev", "3d"):
        for threads in (1, 2):
            rates = pairs_per_second(a, b, kind=kind, threads=threads, repeats=repeats)
            best, median, busy = rates[-1][0], rates[len(rates) // 2][0], max(rate for _, rate in rates)
            lines.append(f"  {kind:4} {threads} thread(s)  {best / 1e6:6.2f}  {median / 1e6:6.2f}  {busy / 1e6:6.2f}")
        good &= median >= REQUIRED_PER_S
    lines += ["", f"largest absolute error in IoU at 250 m, {len(far_boxes())} poses a case"]
    lines += [f"  {'case':32} bev       3d"]
    for name, first, second, expected in analytic_cases():
        errors = [float(np.abs(paired_iou(first, second, kind=kind) - expected).max()) for kind in ("bev", "3d")]
        lines.append(f"  {name:32} {errors[0]:.2e}  {errors[1]:.2e}")
        good &= max(errors) < TOLERANCE
    verdict = "met" if good else "NOT MET"
    lines += ["", f"required: {REQUIRED_PER_S} pairs per second, errors below {TOLERANCE}: {verdict}"]
    return "\n".join(lines) + "\n", good


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--pairs", type=int, default=400_000)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "results" / "iou.txt")
    arguments = parser.parse_args()
    text, good = report(arguments.pairs, arguments.repeats)
    print(text, end="")
    arguments.output.parent.mkdir(exist_ok=True)
    write_text(arguments.output, text)
    return 0 if good else 1


if __name__ == "__main__":
    raise SystemExit(main())

"""What the studio's gestures find: real vehicles by range, forty simulated objects, objects of the radar alone, times.

usage: python benchmarks/studio_fitting.py [REAL] [--seeds 3] [--output benchmarks/results/studio_fitting.txt]

REAL holds ``cirrus_layout``, ``kitti``, ``kitti_more``, ``view_of_delft`` and ``argoverse2``; without it the real
part is left out. A press hits one of the object's own points; a drag follows the heading with an error of 4 degrees
(standard deviation); the prior is the median size of the object's class in its data set. The constants were chosen on
all sets but ``kitti_more``. Simulated objects are pressed 0.35 m beside a point of theirs.
"""

import argparse
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from _gestures import Subject, click, click_lane, drag, drawn, measured, seen_whole, shrunk, snapped, subjects
from _report import SHARED_REAL, header, progress
from scipy.ndimage import maximum_filter

from farfield.annotation.fitting import BoxFit, Prior, fit_radar_peak, peak_near
from farfield.datasets import open_dataset
from farfield.files.atomic import write_text
from farfield.frame import Boxes, Frame
from farfield.radar.axes import KRADAR_AXES
from farfield.simulation import simulate_frame
from farfield.vocabulary.classes import VEHICLE_KINDS

REAL = {
    "Luminar, KITTI, View-of-Delft, Argoverse 2": (
        *("cirrus_layout/Cirrus_dataset1", "kitti", "view_of_delft/lidar", "argoverse2"),
    ),
    "held out: 14 further KITTI frames": ("kitti_more",),
}
BINS_M = ((0, 30), (30, 60), (60, 100), (100, 300))
TARGETS = "   targets for click and drag: .76 (< 30 m), .65 (30-60 m), .55 (60-100 m)"
GESTURES: dict[str, Callable[[Subject, np.random.Generator], BoxFit | Boxes]] = {
    "click": click,
    "click, lane known": click_lane,
    "click and drag": drag,
    "rectangle as drawn": drawn,
    "rectangle, fitted again": snapped,
    "rectangle, shrunk to points": shrunk,
}
SIMULATED = ((1, 0), (2, 0), (3, 0), (4, 0), (5, 0), (6, 0))
SEEN_BY_RADAR = ((4, 0), (4, 100), (5, 0), (1, 0), (9, 50), (15, 30))
FORTY, NEAR_M, CLOUD = 40, 40.0, 131_072


def real_frames(real: Path, names: Sequence[str]) -> Iterator[tuple[str, Frame]]:
    for name in names:
        for frame in open_dataset(real / name):
            yield name, frame


def table(title: str, chosen: Sequence[Subject], seeds: int) -> Iterator[str]:
    """Median overlap from above and median error of the centre by range, a line a gesture."""
    counts = [sum(low <= one.range_m < high for one in chosen) for low, high in BINS_M]
    heads = [f"{low}-{high} m ({n})" for (low, high), n in zip(BINS_M, counts, strict=True)]
    yield f"\n{title}: {len(chosen)} objects\n  {'':<28}{'all':>6} {'> .7':>6}  " + "".join(f"{h:>17}" for h in heads)
    ranges = np.tile([one.range_m for one in chosen], seeds)
    for name, gesture in GESTURES.items():
        each = [measured(chosen, gesture, seed=seed) for seed in range(1, seeds + 1)]
        iou = np.concatenate([errors.iou for errors in each])
        centre = np.concatenate([errors.centre_m for errors in each])
        cells = []
        for low, high in BINS_M:
            held = (ranges >= low) & (ranges < high)
            cells.append(f"{np.median(iou[held]):.2f} / {np.median(centre[held]):.2f} m" if held.any() else "-")
        share = f"{100 * np.mean(iou > 0.7):.0f} %"
        yield f"  {name:<28}{np.median(iou):6.2f} {share:>6}  " + "".join(f"{cell:>17}" for cell in cells)


def real_part(real: Path, seeds: int) -> Iterator[str]:
    for title, names in REAL.items():
        found = list(subjects(real_frames(real, names)))
        yield from table(f"{title}, vehicles", [one for one in found if one.vehicle], seeds)
        yield TARGETS
        small = [one for one in found if not one.vehicle]
        if small:
            yield from table(f"{title}, people and two-wheelers", small, seeds)


def simulated_part() -> Iterator[str]:
    """The first forty objects within 40 m, with the size of their class and with that of their track."""
    frames = [
        ("simulated", simulate_frame("kradar-sim", seed=1, sequence=sequence, index=index))
        for sequence, index in progress(SIMULATED, "simulating")
    ]
    near = [one for one in subjects(frames) if one.range_m < NEAR_M][:FORTY]
    known = [replace(one, prior=replace(one.prior, size_m=_size(one.box), fixed_size=True)) for one in near]
    yield f"\n{len(near)} simulated objects within {NEAR_M:g} m, pressed 0.35 m and dragged 4 degrees off"
    for title, chosen in (("size of the class", near), ("size of the track", known)):
        found = measured(chosen, partial(drag, error_m=0.35), seed=1)
        missed = int((found.iou < 0.1).sum())
        yield (
            f"  {title:<20} centre {np.median(found.centre_m):.3f} m, yaw {np.median(found.yaw_deg):.2f} degrees, "
            f"overlap {np.median(found.iou):.2f} (medians); missed {missed}"
        )
        whole = np.array([seen_whole(one) for one in chosen])
        yield (
            f"    along the heading {np.median(found.along_m):.3f} m, across {np.median(found.across_m):.3f} m; centre "
            f"of the {whole.sum()} with points at both ends {np.median(found.centre_m[whole]):.3f} m, of the others "
            f"{np.median(found.centre_m[~whole]):.3f} m"
        )
    yield "   targets: centre 0.10 m, yaw 2 degrees"


def _size(box: Boxes) -> tuple[float, float, float]:
    length, width, height = box.size_m[0].tolist()
    return length, width, height


def radar_part() -> Iterator[str]:
    """Boxes behind the strongest peak on each vehicle, 8 to 80 m away; the press snaps to the peak near it."""
    rows = [row for place in progress(SEEN_BY_RADAR, "simulating the radar") for row in _of_radar(*place)]
    found = np.array(rows)
    cell = (np.abs(found[:, 0]) <= KRADAR_AXES.range_step_m) & (np.abs(found[:, 1]) <= 1.0)
    title = "vehicles, pressed 0.35 m beside their strongest peak, yaw 4 degrees off, no LiDAR"
    yield f"\nobjects of the radar alone: {len(found)} {title}"
    yield (
        f"  range {np.median(found[:, 0]):+.2f} m (median), {np.median(np.abs(found[:, 0])):.2f} m (median of the "
        f"size); azimuth {np.median(np.abs(found[:, 1])):.2f} degrees; within a cell in both {np.mean(cell):.2f}"
    )
    yield "   target: one cell, 0.46 m and 1 degree"


def _of_radar(sequence: int, index: int) -> Iterator[tuple[float, float]]:
    frame = simulate_frame("kradar-sim", seed=1, sequence=sequence, index=index, sensors=("os2-64", "polar3d"))
    pose, boxes = frame.sensors["radar"].frame_T_sensor, frame.boxes
    assert pose is not None
    assert boxes is not None
    bird = np.asarray(frame.radar["polar3d"])[0].max(axis=2)
    peak = bird == maximum_filter(bird, 3)
    ranges, angles = np.meshgrid(KRADAR_AXES.range_m, np.deg2rad(KRADAR_AXES.azimuth_deg), indexing="ij")
    places = np.stack([ranges * np.cos(angles), ranges * np.sin(angles)], axis=-1) + pose[:2, 3]
    for number in range(len(boxes)):
        box, ego = boxes[number], pose[:2, 3]
        away = box.centre_m[0, :2] - ego
        angle = np.rad2deg(np.arctan2(away[1], away[0]))
        if str(box.label[0]) not in VEHICLE_KINDS or not 8 < np.hypot(*away) < 80 or abs(angle) > 48:
            continue
        cos, sin = np.cos(box.yaw_rad[0]), np.sin(box.yaw_rad[0])
        local = (places - box.centre_m[0, :2]) @ np.array([[cos, -sin], [sin, cos]])
        on_it = peak & (np.abs(local) <= box.size_m[0, :2] / 2 + 0.7).all(axis=-1)
        if not on_it.any():
            continue
        best = places.reshape(-1, 2)[int(np.argmax(np.where(on_it, bird, -1)))]
        hand = np.random.default_rng([sequence, index, number])
        pressed = best - ego + hand.normal(0, 0.35, 2)
        peak_m = np.array(peak_near(bird, pressed) or pressed) + ego
        yaw = float(box.yaw_rad[0] + np.deg2rad(hand.normal(0, 4)))
        prior = Prior(size_m=_size(box), lane_rad=yaw, ego_m=(float(ego[0]), float(ego[1])))
        found = np.array(fit_radar_peak(np.zeros((0, 3)), peak_m, prior).box[:2]) - ego
        turn = np.rad2deg(np.arctan2(found[1], found[0])) - angle
        yield float(np.hypot(*found) - np.hypot(*away)), float(turn)


def times_part(chosen: Sequence[Subject]) -> Iterator[str]:
    """Milliseconds a fit with its ground, in clouds filled up to 131,072 points."""
    rng = np.random.default_rng(0)
    filled = [replace(one, points_m=_filled(one.points_m, rng)) for one in chosen[:: max(len(chosen) // 60, 1)]]
    yield f"\ntime of one fit with its ground, {CLOUD} points, {len(filled)} objects (others may use the processor)"
    for name in ("click", "click and drag", "rectangle, fitted again"):
        begun = time.process_time()
        found = measured(filled, GESTURES[name], seed=1)
        used_ms = 1000 * (time.process_time() - begun) / len(filled)
        middle, high = np.quantile(found.ms, [0.5, 0.95])
        yield f"  {name:<28} median {middle:.0f} ms, p95 {high:.0f} ms; of the processor {used_ms:.0f} ms on average"
    yield "   target: p95 150 ms"


def _filled(points_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    more = points_m[rng.integers(len(points_m), size=max(CLOUD - len(points_m), 0))]
    return np.concatenate([points_m, more + rng.normal(0, 0.02, more.shape).astype(np.float32)])[:CLOUD]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("real", type=Path, nargs="?", default=SHARED_REAL)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    lines: list[str] = []
    parts: list[Iterable[str]] = [[header()]]
    if options.real.is_dir():
        every = [one for names in REAL.values() for one in subjects(real_frames(options.real, names))]
        parts += [real_part(options.real, options.seeds), simulated_part(), radar_part(), times_part(every)]
    else:
        print(f"{options.real}: no real frames, that part is left out", file=sys.stderr)
        parts += [simulated_part(), radar_part()]
    for part in parts:
        for line in part:
            print(line, flush=True)
            lines.append(line)
    if options.output is not None:
        write_text(options.output, "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()

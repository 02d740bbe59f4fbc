"""Calibrations from random starts against the simulator's truth, with the CPU time of a start.

Simulates K-Radar's car on three roads by day and one by night, 80 frames each in eight runs of ten, pictures in four of
them. They stay in --data, as do the rows that are done: a second run goes on where the first ended. Every solver starts
from random errors; the starts of a road share its drive, so that their errors are not independent.

    python benchmarks/calibration.py --data data/calibration --output benchmarks/results/calibration.txt
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from _report import header, progress
from scipy.spatial.transform import Rotation

from farfield.calibration.edges import (
    align_edges,
    difference,
    edge_residual_px,
    edge_spread,
    moved,
    views_of,
)
from farfield.calibration.jobs import KRADAR_NODE_M
from farfield.calibration.moments import read_moments
from farfield.calibration.pairs import calibrate_pairs
from farfield.calibration.radar_lidar import Evidence, RadarPose, calibrate_radar
from farfield.calibration.registration import register
from farfield.calibration.sweeps import sweep_edges
from farfield.datasets import open_dataset
from farfield.datasets.base import Dataset
from farfield.datasets.kradar.writer import KRadarWriter
from farfield.files.atomic import write_text
from farfield.geometry.cameras import Camera
from farfield.geometry.poses import invert, pose
from farfield.simulation import find_preset, simulate_frame
from farfield.simulation.rigs.drive import drive_of

ROADS = (("urban", "day", 0), ("highway", "day", 1), ("suburban", "day", 2), ("urban", "night", 3))
SEED = 5
RUNS = (30, 95, 160, 225, 62, 127, 192, 257)
PICTURED = 4  # runs with pictures
CAMERA_FRAMES = 20


def simulated(folder: Path, road: str, light: str, sequence: int) -> tuple[Dataset, float]:
    """A K-Radar of one sequence, and how much later its radar measures, in seconds."""
    preset = find_preset("kradar-sim", road=road, time=light, weather="normal", duration_s=30.0)
    writer = KRadarWriter(folder / f"{road}-{light}")
    for run, index in ((run, start + step) for run, start in enumerate(RUNS) for step in range(10)):
        sensors = ("os2-64", "sparse", *(("cam-front",) if index % 2 == 0 and run < PICTURED else ()))
        sensors += ("os1-128",) if index in (30, 160) else ()
        frame = simulate_frame(preset, seed=SEED, sequence=sequence, index=index, sensors=sensors)
        if not writer.paths(frame)["record"].exists():
            writer.write(frame)
    writer.finish()
    return open_dataset(writer.root, format="kradar"), drive_of(preset, SEED, sequence).mounted.radar_offset_s


def radar_row(data: Dataset, late_s: float, starts: int) -> str:
    """Radar-LiDAR from +-2 m, +-3 degrees, +-3 frames."""
    evidence = Evidence.of(read_moments((data[i] for i in range(len(data))), node_m=KRADAR_NODE_M))
    truth, rng = np.array([-2.54, 0.3, 0.0, late_s]), np.random.default_rng(0)
    away, covered, frames, seconds = [], [], [], []
    for _ in progress(range(starts), "radar-LiDAR"):
        x, y = truth[:2] + rng.uniform(-2, 2, 2)
        yaw, offset = np.radians(rng.uniform(-3, 3)), int(rng.integers(-3, 4))
        began = time.process_time()
        guess = RadarPose(x_m=x, y_m=y, z_m=0.7, yaw_rad=yaw, frames=offset)
        found = calibrate_radar(evidence, guess)
        seconds.append(time.process_time() - began)
        error = found.pose.vector - truth
        away.append(np.abs(error))
        covered.append(np.abs(error) < 2 * found.solution.sigma)
        frames.append(found.pose.frames == 0)
    x, y, yaw, late = np.median(away, axis=0)
    worst = np.max(away, axis=0)
    return (
        f"{np.mean(frames):7.0%} {100 * x:6.1f} {100 * y:6.1f} {np.degrees(yaw):7.3f} {1000 * late:6.1f}   "
        f"{100 * worst[0]:5.1f} {100 * worst[1]:5.1f} {np.degrees(worst[2]):7.3f} {np.mean(covered):9.0%} "
        f"{np.mean(seconds):7.1f}"
    )


def camera_rows(data: Dataset, starts: int) -> list[str]:
    """LiDAR-camera from +-1 degree and +-0.1 m, and from twice the angle."""
    numbers = [i for i in range(len(data)) if "cam-front" in data[i].images][:CAMERA_FRAMES]
    pictures = [data[i].images["cam-front"] for i in numbers]
    truth = data[numbers[0]].cameras["cam-front"]
    edges = [sweep_edges(data, i, camera="cam-front", lidar="os2-64")[0] for i in numbers]
    views = views_of(pictures, edges, truth, margin_px=100)
    rows = []
    for turn, count in ((1.0, starts), (2.0, max(starts // 2, 1))):
        rng, away, covered, seconds, left = np.random.default_rng(1), [], [], [], []
        for _ in progress(range(count), "LiDAR-camera"):
            delta = np.concatenate([np.radians(rng.uniform(-turn, turn, 3)), rng.uniform(-0.1, 0.1, 3)])
            began = time.process_time()
            sigma = (*(np.radians(turn),) * 3, 0.1, 0.1, 0.1)
            found = align_edges(moved(truth, delta), views, sigma=sigma)
            seconds.append(time.process_time() - began)
            error = np.abs(difference(found, truth))
            spread = edge_spread(found, views)[0]
            away.append((np.degrees(error[:3].max()), 100 * error[3:].max()))
            covered.append(error < 2 * spread)
            left.append(np.median(np.abs(edge_residual_px(found, views))))
        degrees, cm = np.array(away).T
        good = np.mean((degrees < 0.2) & (cm < 8))
        rows.append(
            f"+-{turn:.0f} deg {count:3d} {np.median(degrees):9.3f} {degrees.max():7.3f} {np.median(cm):7.1f} "
            f"{cm.max():6.1f} {np.median(left):8.2f} {good:9.0%} {np.mean(covered):9.0%} {np.mean(seconds):7.1f}"
        )
    return rows


def pairs_row(data: Dataset, starts: int) -> list[str]:
    """Picked pairs with 2 px of hand noise, from nothing; twelve with a focal length 20 % off."""
    frame = data[0]
    truth = frame.cameras["cam-front"]
    points = frame.clouds["os2-64"].points_m.astype(float)
    points = points[truth.project(points)[2] & (np.linalg.norm(points, axis=1) < 40) & (points[:, 2] > -1.2)]
    rng, rows = np.random.default_rng(2), []
    for name, count, far, focal in (
        ("8 at random", 8, False, False),
        ("8 spread over picture and range", 8, True, False),
        ("12 at random, focal length free", 12, False, True),
    ):
        away = []
        for _ in range(starts):
            picked = points[rng.permutation(len(points))[: 40 if far else count]]
            picked = spread(picked, truth, count) if far else picked
            seen = truth.project(picked)[0] + rng.normal(0, 2, (count, 2))
            matrix = truth.matrix * (np.array([[1.2, 1, 1], [1, 1.2, 1], [1, 1, 1]]) if focal else 1.0)
            guess = partial(type(truth), distortion=truth.distortion, camera_T_lidar=np.eye(4))
            found = calibrate_pairs(picked, seen, guess(matrix=matrix), focal=focal).camera
            turn = np.degrees(np.linalg.norm(difference(found, truth)[:3]))
            away.append((turn, 100 * abs(found.matrix[0, 0] / truth.matrix[0, 0] - 1)))
        turn, longer = np.median(away, axis=0)
        worst = np.percentile(away, 90, axis=0)[0]
        length = f", focal length {longer:.2f} % median" if focal else ""
        rows.append(f"{name}: {starts} draws, {turn:.3f} degrees median, {worst:.3f} at 90 %{length}")
    return rows


def spread(points_m: np.ndarray, camera: Camera, count: int) -> np.ndarray:
    """Of candidates those that lie farthest from one another in picture and range: what a hand is told to pick."""
    depth = np.log(np.linalg.norm(points_m, axis=1))[:, None]
    place = np.hstack([camera.project(points_m)[0] / [camera.width_px, camera.height_px], depth / np.log(8)])
    chosen = [0]
    for _ in range(count - 1):
        chosen.append(int(np.linalg.norm(place[:, None] - place[chosen], axis=2).min(axis=1).argmax()))
    return points_m[chosen]


def lidars_row(data: Dataset, starts: int) -> str:
    """os1-128 against os2-64 from +-1 degree, +-0.2 m."""
    frames = [each for each in (data[i] for i in range(len(data))) if "os1-128" in each.clouds]
    targets, sources = ([each.clouds[name].points_m for each in frames] for name in ("os2-64", "os1-128"))
    truth = frames[0].sensors["os1-128"].frame_T_sensor
    assert truth is not None
    rng, away, seconds = np.random.default_rng(3), [], []
    for _ in range(starts):
        turn = Rotation.from_rotvec(np.radians(rng.uniform(-1, 1, 3))).as_matrix()
        began = time.process_time()
        found = register(targets, sources, start=pose(turn, rng.uniform(-0.2, 0.2, 3)) @ truth)
        seconds.append(time.process_time() - began)
        step = found.target_T_source @ invert(truth)
        angle = np.degrees(Rotation.from_matrix(step[:3, :3]).magnitude())
        away.append((angle, 100 * np.linalg.norm(found.target_T_source[:3, 3] - truth[:3, 3])))
    angle, cm = np.max(away, axis=0)
    return f"{starts:3d} starts: at most {angle:.4f} degrees, {cm:.2f} cm; {np.mean(seconds):.1f} s"


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("data/calibration"))
    parser.add_argument("--output", type=Path)
    parser.add_argument("--starts", type=int, default=30)
    parser.add_argument("--camera-starts", type=int, default=30)
    options = parser.parse_args()
    sets = {(road, light): simulated(options.data, road, light, number) for road, light, number in ROADS}
    lines = [
        header(),
        f"starts: radar {options.starts}, camera {options.camera_starts}; {10 * len(RUNS)} frames a road, a drive each",
    ]
    print("\n".join(lines), flush=True)
    kept = Kept(options.data / f"rows-{options.starts}-{options.camera_starts}.json")
    for line in _tables(sets, options.starts, options.camera_starts, kept):
        print(line, flush=True)
        lines.append(line)
        if options.output:
            options.output.write_text("\n".join(lines) + "\n", encoding="utf-8")


@dataclass(frozen=True)
class Kept:
    """Rows that an earlier run with as many starts printed."""

    path: Path

    def rows(self, name: str, make: Callable[[], str | list[str]]) -> list[str]:
        """The rows of this name; made, and kept, if there are none yet."""
        known = json.loads(self.path.read_text(encoding="utf-8")) if self.path.exists() else {}
        if name not in known:
            made = make()
            known[name] = [made] if isinstance(made, str) else made
            write_text(self.path, json.dumps(known, indent=1) + "\n")
        return [f"{name.split(':')[1]:<15} {row}" for row in known[name]]


def _tables(
    sets: dict[tuple[str, str], tuple[Dataset, float]], starts: int, camera_starts: int, kept: Kept
) -> Iterator[str]:
    """Lines of all tables as they become known."""
    yield "Picked pairs, 2 px of noise, from nothing"
    yield from kept.rows("pairs:urban day", partial(pairs_row, sets["urban", "day"][0], max(starts, 30)))
    yield "\nRadar-LiDAR from +-2 m, +-3 degrees, +-3 frames; median and worst errors; covered: within 2 sigma"
    yield "road            frames   x cm   y cm yaw deg  dt ms | worst x     y     yaw   covered   CPU s"
    for (road, light), (data, late) in sets.items():
        yield from kept.rows(f"radar:{road} {light}", partial(radar_row, data, late, starts))
    yield "\nos1-128 against os2-64 from +-1 degree, +-0.2 m, two frames"
    for (road, light), (data, _) in sets.items():
        yield from kept.rows(f"lidars:{road} {light}", partial(lidars_row, data, min(starts, 3)))
    yield f"\nLiDAR-camera by edges, {CAMERA_FRAMES} frames, +-0.1 m; largest of three angles and of three shifts"
    yield "road            start    n  med. deg   worst med. cm  worst  edge px  < .2, 8  covered   CPU s"
    for (road, light), (data, _) in sets.items():
        yield from kept.rows(f"camera:{road} {light}", partial(camera_rows, data, camera_starts))


if __name__ == "__main__":
    main()

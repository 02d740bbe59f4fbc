"""Calibrations of cameras and of a second LiDAR from random starts against the simulator's truth.

Simulates K-Radar's car on three roads by day and one by night, four runs of ten frames each, pictures in
twenty of them. They stay in --data, as does every start that is done: a second run goes on where the first ended, and
the table says how many starts each row has, and the CPU time of one. Every solver starts from random errors; the starts
of a road share its drive, so that their errors are not independent. ``radar_calibration.py`` measures the radar's.

    python benchmarks/calibration.py --data data/calibration --output benchmarks/results/calibration.txt
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from _report import header, progress
from scipy.spatial.transform import Rotation

from farfield.calibration.camera_edges import (
    EdgeResiduals,
    EdgeViews,
    align_edges,
    camera_difference,
    edge_residuals,
    edge_uncertainty,
    edge_views,
    move_camera,
)
from farfield.calibration.camera_pairs import calibrate_pairs
from farfield.calibration.depth_edges import sweep_edges
from farfield.calibration.lidar_lidar import register
from farfield.datasets import open_dataset
from farfield.datasets.base import Dataset
from farfield.datasets.kradar.writer import KRadarWriter
from farfield.files.atomic import write_text
from farfield.frame import Frame
from farfield.geometry.cameras import Camera
from farfield.geometry.poses import invert, pose
from farfield.simulation import find_preset, simulate_frame

ROADS = (("urban", "day", 0), ("highway", "day", 1), ("suburban", "day", 2), ("urban", "night", 3))
SEED = 5
FRAMES = tuple(start + step for start in (30, 95, 160, 225) for step in range(10))
PICTURED = tuple(index for index in FRAMES if index % 2 == 0)
CAMERA_FRAMES = 20
PAIRED_FRAMES, PAIRED_DRAWS = 10, 100


def simulated(folder: Path, road: str, light: str, sequence: int) -> Dataset:
    """A K-Radar of one sequence."""
    preset = find_preset("kradar-sim", road=road, time=light, weather="normal", duration_s=30.0)
    writer = KRadarWriter(folder / f"{road}-{light}")
    there = {int(path.stem.split("_")[1]) - 1 for path in writer.root.glob("*/frame_record/*.json")}  # sweeps from 1
    absent = [index for index in FRAMES if index not in there]
    for index in progress(absent, f"simulating {road} {light}"):
        sensors = ("os2-64", *(("cam-front",) if index in PICTURED else ()))
        sensors += ("os1-128",) if index in (30, 160) else ()
        writer.write(simulate_frame(preset, seed=SEED, sequence=sequence, index=index, sensors=sensors))
    writer.finish()
    return open_dataset(writer.root, format="kradar")


def started(
    path: Path, count: int, make: Callable[[Sequence[int]], Iterator[dict[str, Any]]], seconds: float
) -> list[dict[str, Any]]:
    """Rows of the first ``count`` starts: those in the journal, and those made until the time is up."""
    rows = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    known, began = {row["start"] for row in rows}, time.monotonic()
    wanted = [number for number in range(count) if number not in known]
    for row in make(wanted) if wanted and seconds > 0 else ():
        rows.append(row)
        with path.open("a") as file:
            file.write(json.dumps(row) + "\n")
        if time.monotonic() - began > seconds:
            break
    return [row for row in rows if row["start"] < count]


def camera_rows(open_road: Callable[[], Dataset], starts: int, done: Path, seconds: float) -> list[str]:
    """LiDAR-camera from +-1 degree and +-0.1 m, and from twice the angle."""
    lines = []
    for turn, count in ((1.0, starts), (2.0, max(starts // 2, 1))):
        path = done.with_name(f"{done.stem}-{turn:.0f}.jsonl")
        rows = started(path, count, partial(camera_starts, open_road, turn), seconds)
        if not rows:
            lines.append(f"+-{turn:.0f} deg   0")
            continue
        error = np.abs([row["error"] for row in rows])
        covered = error < 2 * np.array([row["sigma"] for row in rows])
        degrees, cm = np.degrees(error[:, :3].max(axis=1)), 100 * error[:, 3:].max(axis=1)
        left, single, took = (np.array([row[name] for row in rows]) for name in ("edge_px", "single_px", "seconds"))
        good = np.mean((degrees < 0.2) & (cm < 8))
        lines.append(
            f"+-{turn:.0f} deg {len(rows):3d} {np.median(degrees):9.3f} {degrees.max():7.3f} {np.median(cm):7.1f} "
            f"{cm.max():6.1f} {np.median(left):8.2f} {np.median(single):7.2f} {good:9.0%} {np.mean(covered):9.0%} "
            f"{np.mean(took):7.1f}"
        )
    return lines


def camera_views(data: Dataset) -> tuple[Camera, EdgeViews]:
    """The right camera, and edges of LiDAR and pictures."""
    pictured = [i for i in range(len(data)) if "cam-front" in data[i].images][:CAMERA_FRAMES]
    pictures = [data[i].images["cam-front"] for i in pictured]
    truth = data[pictured[0]].cameras["cam-front"]
    edges = [sweep_edges(data, i, camera="cam-front", lidar="os2-64")[0] for i in pictured]
    return truth, edge_views(pictures, edges, truth, margin_px=100)


def least_row(open_road: Callable[[], Dataset]) -> str:
    """What the edge residual is where nothing is wrong, and with a yaw that is off."""
    truth, views = camera_views(open_road())
    turned = [move_camera(truth, np.array([0, np.radians(degrees), 0, 0, 0, 0])) for degrees in (0.0, 0.2, 1.0)]
    found = [edge_residuals(camera, views) for camera in turned]
    rows = (("", [each.median_px for each in found]), ("each edge as one: ", [single_px(each) for each in found]))
    return "; ".join(
        f"{words}{left[0]:.2f} px at the right pose, {left[1]:.2f} and {left[2]:.2f} px turned by 0.2 and 1 degree"
        for words, left in rows
    )


def single_px(residuals: EdgeResiduals) -> float:
    """The median with every edge counting as one."""
    return float(np.median(np.abs(residuals.across_px)))


def camera_starts(open_road: Callable[[], Dataset], turn: float, numbers: Sequence[int]) -> Iterator[dict[str, Any]]:
    """Errors, sigma, edge residual and CPU time of single starts."""
    truth, views = camera_views(open_road())
    for number in numbers:
        rng = np.random.default_rng((1, int(turn), number))
        delta = np.concatenate([np.radians(rng.uniform(-turn, turn, 3)), rng.uniform(-0.1, 0.1, 3)])
        began = time.process_time()
        found = align_edges(move_camera(truth, delta), views, sigma=(*(np.radians(turn),) * 3, 0.1, 0.1, 0.1))
        took = time.process_time() - began
        residuals = edge_residuals(found, views)
        yield {
            "start": number,
            "error": camera_difference(found, truth).tolist(),
            "sigma": edge_uncertainty(found, views)[0].tolist(),
            "edge_px": residuals.median_px,
            "single_px": single_px(residuals),
            "seconds": took,
        }


def pairs_row(open_road: Callable[[], Dataset], starts: int) -> list[str]:
    """Picked pairs with 2 px of hand noise, from nothing; twelve with a focal length 20 % off."""
    scenes = [_scene(frame) for frame in pictured(open_road(), PAIRED_FRAMES)]
    rng, rows = np.random.default_rng(2), []
    for name, count, far, focal in (
        ("8 at random", 8, False, False),
        ("8 spread over picture and range", 8, True, False),
        ("12 at random, focal length free", 12, False, True),
    ):
        away, bound = [], []
        for draw in range(starts):
            truth, points = scenes[draw % len(scenes)]
            picked = points[rng.permutation(len(points))[: 40 if far else count]]
            picked = spread(picked, truth, count) if far else picked
            seen = truth.project(picked)[0] + rng.normal(0, 2, (count, 2))
            matrix = truth.matrix * (np.array([[1.2, 1, 1], [1, 1.2, 1], [1, 1, 1]]) if focal else 1.0)
            guess = partial(type(truth), distortion=truth.distortion, camera_T_lidar=np.eye(4))
            found = calibrate_pairs(picked, seen, guess(matrix=matrix), focal=focal).camera
            turn = np.degrees(np.linalg.norm(camera_difference(found, truth)[:3]))
            away.append((turn, 100 * abs(found.matrix[0, 0] / truth.matrix[0, 0] - 1)))
            bound.extend(least_turns(truth, picked, rng) if not focal else ())
        turn, longer = np.median(away, axis=0)
        worst = np.percentile(away, 90, axis=0)[0]
        length = f", focal length {longer:.2f} % median" if focal else ""
        least = "" if focal else f"; least possible {np.median(bound):.3f} and {np.percentile(bound, 90):.3f}"
        rows.append(f"{name}: {starts} draws, {turn:.3f} degrees median, {worst:.3f} at 90 %{length}{least}")
    return rows


def pictured(data: Dataset, count: int) -> list[Frame]:
    """Frames with pictures, spread over the drive."""
    keys = [frame for frame in data if frame.images]
    return keys[:: max(1, len(keys) // count)][:count]


def _scene(frame: Frame) -> tuple[Camera, np.ndarray]:
    """The camera, and the points within 40 m and above the road that it sees."""
    camera = frame.cameras["cam-front"]
    points = frame.clouds["os2-64"].points_m.astype(float)
    return camera, points[camera.project(points)[2] & (np.linalg.norm(points, axis=1) < 40) & (points[:, 2] > -1.2)]


def least_turns(camera: Camera, points_m: np.ndarray, rng: np.random.Generator, sigma_px: float = 2.0) -> np.ndarray:
    """Turns in degrees drawn from the Cramer-Rao bound: what no unbiased solver can undercut with these picks."""
    slopes = []
    for step in np.diag([1e-4] * 3 + [1e-3] * 3):
        after, before = (move_camera(camera, each).project(points_m)[0] for each in (step, -step))
        slopes.append((after - before).ravel() / (2 * step.sum()))
    slope = np.stack(slopes, axis=1)
    covariance = sigma_px**2 * np.linalg.inv(slope.T @ slope)
    drawn = rng.multivariate_normal(np.zeros(3), covariance[:3, :3], 100)
    return np.degrees(np.linalg.norm(drawn, axis=1))


def spread(points_m: np.ndarray, camera: Camera, count: int) -> np.ndarray:
    """Of candidates those that lie farthest from one another in picture and range: what a hand is told to pick."""
    depth = np.log(np.linalg.norm(points_m, axis=1))[:, None]
    place = np.hstack([camera.project(points_m)[0] / [camera.width_px, camera.height_px], depth / np.log(8)])
    chosen = [0]
    for _ in range(count - 1):
        chosen.append(int(np.linalg.norm(place[:, None] - place[chosen], axis=2).min(axis=1).argmax()))
    return points_m[chosen]


def lidars_row(open_road: Callable[[], Dataset], starts: int) -> str:
    """os1-128 against os2-64 from +-1 degree, +-0.2 m."""
    data = open_road()
    both = [i for i in range(len(data)) if any(path.parent.name == "os1-128" for path in data.files(i))]
    frames = [data[i] for i in both]
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
    parser.add_argument("--roads", nargs="+", default=[f"{road} {light}" for road, light, _ in ROADS])
    parser.add_argument(
        "--seconds",
        type=float,
        default=np.inf,
        help="for each row, after which no start begins; 0 prints what is there",
    )
    options = parser.parse_args()
    sets = {
        (road, light): partial(simulated, options.data, road, light, number)
        for road, light, number in ROADS
        if f"{road} {light}" in options.roads
    }
    lines = [
        header(),
        f"at most {options.starts} starts a road; {len(FRAMES)} frames a road, a drive each",
    ]
    print("\n".join(lines), flush=True)
    for line in _tables(sets, options):
        print(line, flush=True)
        lines.append(line)
        if options.output:
            options.output.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _tables(sets: dict[tuple[str, str], Callable[[], Dataset]], options: argparse.Namespace) -> Iterator[str]:
    """Lines of all tables as they become known."""
    kept = Kept(options.data / "rows.json")
    yield f"Picked pairs in one of {PAIRED_FRAMES} frames, 2 px of noise, from nothing; least: the Cramer-Rao bound"
    yield from kept.rows(
        "pairs", "urban day", partial(pairs_row, partial(simulated, options.data, *ROADS[0]), PAIRED_DRAWS)
    )
    if options.starts:
        yield "\nos1-128 against os2-64 from +-1 degree, +-0.2 m, two frames"
        for (road, light), opened in sets.items():
            if options.seconds > 0 or kept.has("lidars", f"{road} {light}"):
                yield from kept.rows("lidars", f"{road} {light}", partial(lidars_row, opened, 3))
    yield f"\nLiDAR-camera by edges, {CAMERA_FRAMES} frames, +-0.1 m; largest of three angles and of three shifts"
    yield "road            start    n  med. deg   worst med. cm  worst  edge px  single  < .2, 8  covered   CPU s"
    for (road, light), opened in sets.items():
        done = options.data / f"camera-{road}-{light}.jsonl"
        rows = camera_rows(opened, options.starts, done, options.seconds) if options.starts else []
        yield from (f"{road + ' ' + light:<15} {row}" for row in rows)
    yield "\nThe edge residual without any calibration"
    for (road, light), opened in sets.items():
        yield f"{road + ' ' + light:<15} {least_row(opened)}"


@dataclass(frozen=True)
class Kept:
    """Rows that an earlier run printed."""

    path: Path

    def has(self, table: str, road: str) -> bool:
        """Whether there are such rows."""
        return self.path.exists() and f"{table}:{road}" in json.loads(self.path.read_text(encoding="utf-8"))

    def rows(self, table: str, road: str, make: Callable[[], str | list[str]]) -> list[str]:
        """The rows of this table and road; made, and kept, if there are none yet."""
        known = json.loads(self.path.read_text(encoding="utf-8")) if self.path.exists() else {}
        name = f"{table}:{road}"
        if name not in known:
            made = make()
            known[name] = [made] if isinstance(made, str) else made
            write_text(self.path, json.dumps(known, indent=1) + "\n")
        return [f"{road:<15} {row}" for row in known[name]]


if __name__ == "__main__":
    main()

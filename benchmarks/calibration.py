"""Calibration of cameras and of a second LiDAR against the simulator's truth, by boards, and on real frames."""

import argparse
import json
import tempfile
import time
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from _board_rendering import board_poses, render_board
from _report import SHARED_REAL, MissingError, Part, part_parser, progress, run_parts
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from farfield.calibration.boards import Board, calibrate_board, find_board
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
from farfield.calibration.checking import check_camera
from farfield.calibration.depth_edges import lidar_edges, sweep_edges
from farfield.calibration.lidar_lidar import register
from farfield.calibration.radar_features import read_sensor_pairs
from farfield.calibration.radar_lidar import calibrate_radar
from farfield.calibration.radar_matching import RadarEvidence, RadarPose
from farfield.datasets import open_dataset
from farfield.datasets.base import Dataset
from farfield.datasets.kradar.labels import annotation_of, read_labels
from farfield.datasets.kradar.texts import read_camera
from farfield.datasets.kradar.writer import KRadarWriter
from farfield.errors import DatasetError
from farfield.figures.camera import boxes_picture
from farfield.files.atomic import write_text
from farfield.files.images import read_image, write_image
from farfield.frame import Boxes, Frame
from farfield.frame.cloud import read_cloud
from farfield.geometry.cameras import Camera
from farfield.geometry.poses import invert, pose
from farfield.simulation import find_preset, simulate_frame

ROADS = (("urban", "day", 0), ("highway", "day", 1), ("suburban", "day", 2), ("urban", "night", 3))
SEED = 5
FRAMES = tuple(start + step for start in (30, 95, 160, 225) for step in range(10))
PICTURED = tuple(index for index in FRAMES if index % 2 == 0)
CAMERA_FRAMES = 20
PAIRED_FRAMES, PAIRED_DRAWS = 10, 100


def simulated(folder: Path, road: str, light: str, sequence: int, frames: int | None) -> Dataset:
    """A K-Radar of one sequence."""
    preset = find_preset("kradar-sim", road=road, time=light, weather="normal", duration_s=30.0)
    writer = KRadarWriter(folder / f"{road}-{light}")
    there = {int(path.stem.split("_")[1]) - 1 for path in writer.root.glob("*/frame_record/*.json")}  # sweeps from 1
    absent = [index for index in FRAMES[:frames] if index not in there]
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


def run_cameras(arguments: Sequence[str]) -> None:
    """Calibrations of cameras and of a second LiDAR from random starts against the simulator's truth.

    Simulates K-Radar's car on three roads by day and one by night, four runs of ten frames each, pictures in twenty of
    them. They stay in --data, as does every start that is done: a second run goes on where the first ended, and the
    table says how many starts each row has, and the CPU time of one. Every solver starts from random errors; the starts
    of a road share its drive, so that their errors are not independent. ``calibration_checks.py`` measures the radar's.

        python benchmarks/calibration.py cameras --data data/calibration
    """
    parser = part_parser(run_cameras.__doc__)
    parser.add_argument("--data", type=Path, default=Path("data/calibration"))
    parser.add_argument("--starts", type=int, default=30)
    parser.add_argument("--frames", type=int, help="of a road, the first so many")
    parser.add_argument("--draws", type=int, default=PAIRED_DRAWS, help="of picked pairs")
    parser.add_argument("--roads", nargs="+", default=[f"{road} {light}" for road, light, _ in ROADS])
    parser.add_argument(
        "--seconds",
        type=float,
        default=np.inf,
        help="for each row, after which no start begins; 0 prints what is there",
    )
    options = parser.parse_args(arguments)
    sets = {
        (road, light): partial(simulated, options.data, road, light, number, options.frames)
        for road, light, number in ROADS
        if f"{road} {light}" in options.roads
    }
    print(
        f"at most {options.starts} starts a road; {len(FRAMES[: options.frames])} frames a road, a drive each",
        flush=True,
    )
    for line in _tables(sets, options):
        print(line, flush=True)


def _tables(sets: dict[tuple[str, str], Callable[[], Dataset]], options: argparse.Namespace) -> Iterator[str]:
    """Lines of all tables as they become known."""
    kept = Kept(options.data / "rows.json")
    yield f"Picked pairs in one of {PAIRED_FRAMES} frames, 2 px of noise, from nothing; least: the Cramer-Rao bound"
    yield from kept.rows(
        "pairs",
        "urban day",
        partial(pairs_row, partial(simulated, options.data, *ROADS[0], options.frames), options.draws),
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


LENSES = {
    "ZED 2i (K-Radar)": (567.7, 577.2, 628.7, 369.3, 1280, 720, (-0.0289, 0.0006, 0.0040, -0.0050, 0.0)),
    "1920 x 650 (Cirrus)": (1050.0, 1050.0, 962.0, 318.0, 1920, 650, (-0.30, 0.10, 0.0005, -0.0003, 0.0)),
    "barrel, k3": (420.0, 421.0, 318.0, 241.0, 640, 480, (-0.28, 0.09, 0.0004, -0.0006, -0.012)),
}


def camera_of(values: tuple) -> Camera:
    """A camera of the table."""
    fx, fy, cx, cy, width, height, distortion = values
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    return Camera(matrix=matrix, distortion=np.array(distortion), width_px=width, height_px=height)


def corner_error_px(found: Camera, truth: Camera) -> float:
    """Largest distance in the four corners between both cameras' pixels of one ray, after the best turn.

    A shifted principal point and a turned camera are the same to a first order, and extrinsics take it up.
    """
    u, v = np.meshgrid(np.linspace(0, truth.width_px - 1, 9), np.linspace(0, truth.height_px - 1, 9))
    pixels = np.column_stack([u.ravel(), v.ravel()])
    rays = truth.rays(pixels)

    left = least_squares(residuals, np.zeros(3), args=(found, rays, pixels)).fun.reshape(9, 9, 2)
    return float(np.linalg.norm(left[[0, 0, -1, -1], [0, -1, 0, -1]], axis=1).max())


def residuals(turn: np.ndarray, camera: Camera, rays: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Pixels of turned rays less those of the truth."""
    return np.nan_to_num(camera.project(rays @ Rotation.from_rotvec(turn).as_matrix().T)[0] - pixels, nan=99.0).ravel()


def row(truth: Camera, board: Board, pictures: int, seed: int) -> str:
    """One lens and one board."""
    rng, began = np.random.default_rng(seed), time.process_time()
    poses = board_poses(truth, board, pictures, rng)
    seen = [find_board(render_board(truth, at, board, rng=rng), board, str(i)) for i, at in enumerate(poses)]
    found = calibrate_board([each for each in seen if each is not None], board)
    focal = np.abs(np.diag(found.camera.matrix)[:2] / np.diag(truth.matrix)[:2] - 1).max()
    return (
        f"{len(found.used):3d}/{pictures:<3d} {focal:8.3%} {found.sigma[0] / truth.matrix[0, 0]:8.3%} "
        f"{corner_error_px(found.camera, truth):9.2f} {np.median(found.error_px):7.2f} {found.covered:8.0%} "
        f"{time.process_time() - began:6.1f}"
    )


def run_board(arguments: Sequence[str]) -> None:
    """Intrinsics and distortion from rendered pictures of a chessboard and a ChArUco board, whose truth is known.

    python benchmarks/calibration.py board [--pictures 20]
    """
    parser = part_parser(run_board.__doc__)
    parser.add_argument("--pictures", type=int, default=20)
    parser.add_argument("--lenses", type=int, default=len(LENSES), help="the first so many")
    options = parser.parse_args(arguments)
    print("Rendered pictures: blur 0.5 px, noise 2 grey values, light that falls off")
    print("lens                 board       seen     focal    sigma corner px  rms px  covered  CPU s", flush=True)
    for name, values in progress(list(LENSES.items())[: options.lenses], "lenses"):
        for markers in (False, True):
            text = row(camera_of(values), Board(markers=markers), options.pictures, seed=1)
            print(f"{name:<20} {'ChArUco' if markers else 'chessboard':<10} {text}", flush=True)


# Real frames.


ERRORS = ((0.5, 0.05), (1.0, 0.10), (2.0, 0.10))  # degrees about, and metres along, each axis, at most
SETS = ("kitti", "kitti_more", "view_of_delft", "pcd", "kradar")
KRADAR_SEQUENCE = 11  # of the example picture: the time stamp of its label says so
HEAD = (
    "set                    frames from              deg before  after  worst | cm before  after  worst |"
    " px before  after  worst  CPU s"
)


_YAW, _ASIDE = np.array([0, np.radians(1.0), 0, 0, 0, 0]), np.array([0, 0, 0, 0.2, 0, 0])


def aligned(
    name: str, camera: Camera, pictures: Sequence[np.ndarray], clouds: Sequence[np.ndarray], starts: int
) -> Iterator[tuple[str, Camera, Camera]]:
    """Rows of one set: largest angle, largest shift and median pixel error over random starts; a start and its end."""
    edges = [lidar_edges(points) for points in clouds]
    near = np.concatenate([points[::20] for points in clouds]).astype(np.float64)
    near = near[camera.project(near)[2] & (np.linalg.norm(near, axis=1) < 50)]
    there = camera.project(near)[0]
    for degrees, metres in ERRORS:
        rng, rows, began = np.random.default_rng(0), [], time.process_time()
        for _ in range(starts):
            delta = np.concatenate([np.radians(rng.uniform(-degrees, degrees, 3)), rng.uniform(-metres, metres, 3)])
            start = move_camera(camera, delta)
            views = edge_views(pictures, edges, start, margin_px=100)
            sigma = (*(np.radians(degrees),) * 3, *(metres,) * 3)
            found = align_edges(start, views, sigma=sigma)
            rows.append([_off(each, camera, near, there) for each in (start, found)])
        before, after = np.array(rows).transpose(1, 0, 2)
        cells = [
            f"{np.median(b):9.2f} {np.median(a):6.2f} {a.max():6.2f}" for b, a in zip(before.T, after.T, strict=True)
        ]
        text = f"{name:<22} {len(clouds):6d} {degrees:.1f} deg {100 * metres:3.0f} cm  " + " |  ".join(cells)
        yield f"{text} {(time.process_time() - began) / starts:6.1f}", start, found
    views = edge_views(pictures, edges, camera, margin_px=100)
    if len(clouds) < 2:
        yield "  one frame alone: no sigma", camera, camera
        return
    sigma, notes = edge_uncertainty(align_edges(camera, views), views)
    told = ", ".join(f"{s:.2f}" for s in np.degrees(sigma[:3])), ", ".join(f"{100 * s:.0f}" for s in sigma[3:])
    yield f"  sigma (pitch, yaw, roll) {told[0]} deg, (x, y, z) {told[1]} cm", camera, camera
    for note in notes or ("all six are observed",):
        yield f"  {note}", camera, camera
    own = _off(align_edges(camera, views), camera, near, there)
    yield f"  begun at the published one: {own[0]:.2f} deg, {own[1]:.1f} cm, {own[2]:.1f} px away", camera, camera
    for what, delta in (("published", np.zeros(6)), ("turned by 1 deg", _YAW), ("shifted by 20 cm", _ASIDE)):
        check = check_camera(move_camera(camera, delta), views)
        yield (
            f"  the doctor on the {what}: {check.verdict} ({check.px:.1f} px, {check.evidence:.1f} errors)",
            camera,
            camera,
        )


def _off(found: Camera, truth: Camera, points_m: np.ndarray, pixels: np.ndarray) -> tuple[float, float, float]:
    error = np.abs(camera_difference(found, truth))
    away = np.linalg.norm(replace(found, width_px=0, height_px=0).project(points_m)[0] - pixels, axis=1)
    return float(np.degrees(error[:3].max())), 100 * float(error[3:].max()), float(np.nanmedian(away))


def alike(folders: Sequence[Path], form: str) -> list[Frame]:
    """Frames with the picture and calibration that most of the folders' frames share."""
    frames = [frame for folder in folders for frame in open_dataset(folder, format=form)]
    frames = [each for each in frames if "camera" in each.images and "camera" in each.cameras]
    marks = [np.round(each.cameras["camera"].camera_T_lidar, 6).tobytes() for each in frames]
    usual = max(marks, key=marks.count)
    found = [each for each, mark in zip(frames, marks, strict=True) if mark == usual]
    sizes = [each.images["camera"].shape for each in found]
    size = max(sizes, key=sizes.count)
    return [each for each, own in zip(found, sizes, strict=True) if own == size]


def of_frames(name: str, frames: Sequence[Frame], starts: int, folder: Path | None) -> Iterator[str]:
    """Rows of a data set's frames, and the first frame before and after from the second kind of start."""
    camera, clouds = frames[0].cameras["camera"], [each.clouds["lidar"].points_m for each in frames]
    pictures = [each.images["camera"] for each in frames]
    yield f"  frames {', '.join(each.frame_id for each in frames)}"
    for number, (text, start, found) in enumerate(aligned(name, camera, pictures, clouds, starts)):
        yield text
        if number == 1 and folder is not None:
            boxes = frames[0].boxes
            pair = [boxes_picture(pictures[0], each, boxes, clouds[0].astype(float)) for each in (start, found)]
            write_image(folder / f"{name.split()[0].lower()}.png", np.concatenate(pair))


def pair(starts: int, folder: Path | None) -> Iterator[str]:
    """The pair of PJLab's SensorsCalibration."""
    place = SHARED_REAL / "pcd" / "lidar2camera"
    inner = json.loads((place / "center_camera-intrinsic.json").read_text())["center_camera-intrinsic"]["param"]
    outer = json.loads((place / "top_center_lidar-to-center_camera-extrinsic.json").read_text())
    pose = np.array(outer["top_center_lidar-to-center_camera-extrinsic"]["param"]["sensor_calib"]["data"])
    bent = np.ravel(inner["cam_dist"]["data"])[:5]
    picture, cloud = read_image(place / "0.png"), read_cloud(place / "0.pcd")
    camera = Camera(
        matrix=np.array(inner["cam_K"]["data"], dtype=float),
        distortion=np.pad(bent, (0, 5 - len(bent))).astype(float),
        camera_T_lidar=pose,
        width_px=picture.shape[1],
        height_px=picture.shape[0],
    )
    points = cloud.points_m.astype(np.float64)
    for number, (text, start, found) in enumerate(aligned("lidar2camera pair", camera, [picture], [points], starts)):
        yield text
        if number == 1 and folder is not None:
            drawn = [boxes_picture(picture, each, Boxes.empty(), points) for each in (start, found)]
            write_image(folder / "pair.png", np.concatenate(drawn))


def kradar_example(folder: Path | None) -> Iterator[str]:
    """Boxes of the example label on the example picture, by both releases of its sequence's calibration."""
    place = SHARED_REAL / "kradar"
    picture = read_image(place / "example" / "img_example.png")
    boxes = annotation_of(read_labels(place / "example" / "label_example.txt"), "v1.0").boxes
    drawn, picture = [], picture[:, : picture.shape[1] // 2]  # both eyes side by side: the left one
    for release in ("calib_seq", "calib_seq_v2"):
        with tempfile.TemporaryDirectory() as scratch, zipfile.ZipFile(place / f"{release}.zip") as archive:
            name = next(n for n in archive.namelist() if n.endswith(f"seq_{KRADAR_SEQUENCE:02d}/cam_1.yml"))
            (Path(scratch) / "cam_1.yml").write_bytes(archive.read(name))
            camera = read_camera(Path(scratch) / "cam_1.yml")
        height, width = picture.shape[:2]
        seen = camera.project(boxes.centre_m)
        yield f"  {release}: {int(seen[2].sum())} of {len(boxes)} centres in the picture of {width} x {height}: " + (
            ", ".join(f"({u:.0f}, {v:.0f})" for u, v in seen[0][seen[2]])
        )
        drawn.append(boxes_picture(picture, camera, boxes))
    if folder is not None:
        write_image(folder / "kradar.png", np.concatenate(drawn))


def radar(frames: Sequence[Frame], starts: int) -> Iterator[str]:
    """View-of-Delft's radar against its LiDAR: x, y and yaw from +-0.5 m and +-1 degree."""
    sensor = frames[0].sensors["radar"].frame_T_sensor
    moments = [replace(each, number=100 * i) for i, each in enumerate(read_sensor_pairs(frames, lidar="lidar"))]
    evidence, truth = RadarEvidence.of(moments), invert(sensor)
    yaw = float(np.arctan2(truth[1, 0], truth[0, 0]))
    tilt = np.degrees(np.arccos(np.clip(truth[2, 2], -1, 1)))
    yield f"  published: x {truth[0, 3]:.2f}, y {truth[1, 3]:.2f}, z {truth[2, 3]:.2f} m,"
    counts = ", ".join(str(len(each.echoes_m)) for each in moments)
    yield f"  yaw {np.degrees(yaw):.2f}, tilt {tilt:.2f} deg; {counts} strong echoes a frame"
    rng, notes = np.random.default_rng(0), ("two frames do not tell x, y, yaw or the time offset; z is not solved",)
    for number in range(starts):
        x, y = truth[:2, 3] + (rng.uniform(-0.5, 0.5, 2) if number else 0.0)
        turn = yaw + (float(np.radians(rng.uniform(-1, 1))) if number else 0.0)
        guess = RadarPose(x_m=float(x), y_m=float(y), z_m=float(truth[2, 3]), yaw_rad=turn)
        try:
            found = calibrate_radar(evidence, guess, reach_m=1.0, frames=0)
        except DatasetError as error:
            yield f"  from ({x - truth[0, 3]:+.2f}, {y - truth[1, 3]:+.2f}) m: {error}"
            continue
        notes = found.notes
        away = 100 * (found.pose.x_m - truth[0, 3]), 100 * (found.pose.y_m - truth[1, 3])
        angle, sigma = np.degrees(found.pose.yaw_rad - yaw), found.solution.sigma
        yield (
            f"  from ({100 * (x - truth[0, 3]):+4.0f}, {100 * (y - truth[1, 3]):+4.0f}) cm, "
            f"{np.degrees(turn - yaw):+.2f} deg to x {away[0]:+.0f} +- {100 * sigma[0]:.0f} cm, y {away[1]:+.0f} +- "
            f"{100 * sigma[1]:.0f} cm, yaw {angle:+.2f} +- {np.degrees(sigma[2]):.2f} deg; "
            f"{found.residual['matches']:.0f} matches"
        )
    yield from (f"  {note}" for note in notes)


def lines(starts: int, folder: Path | None, sets: Sequence[str]) -> Iterator[str]:
    """All tables, as they become known."""
    kitti = [each for name in ("kitti", "kitti_more") if name in sets and (each := SHARED_REAL / name).is_dir()]
    delft = SHARED_REAL / "view_of_delft"
    delft_here = "view_of_delft" in sets and delft.is_dir()
    yield f"\nLiDAR-camera by edges, {starts} starts; medians, worst of the starts; largest of three angles and shifts"
    yield HEAD
    if kitti:
        yield from of_frames("KITTI (09_26)", alike(kitti, "kitti"), starts, folder)
    if delft_here:
        frames = list(open_dataset(delft))
        yield from of_frames("View-of-Delft", frames, starts, folder)
    if "pcd" in sets and (SHARED_REAL / "pcd" / "lidar2camera").is_dir():
        yield from pair(starts, folder)
    if "kradar" in sets and (SHARED_REAL / "kradar" / "example").is_dir():
        yield f"\nK-Radar's example picture with its label's boxes, sequence {KRADAR_SEQUENCE}"
        yield from kradar_example(folder)
    if delft_here:
        yield "\nView-of-Delft's radar against its LiDAR, two frames of two drives"
        yield from radar(frames, min(starts, 5))


def run_real(arguments: Sequence[str]) -> None:
    """Calibration on real frames: published calibrations perturbed and brought back, boxes and points drawn.

    KITTI and View-of-Delft frames, a LiDAR-camera pair, K-Radar's example picture, View-of-Delft's radar against its
    LiDAR; each is skipped where it is absent.

        python benchmarks/calibration.py real --pictures runs/pictures
    """
    parser = part_parser(run_real.__doc__)
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--starts", type=int, default=10)
    parser.add_argument("--sets", nargs="+", choices=SETS, default=SETS)
    options = parser.parse_args(arguments)
    if not any((SHARED_REAL / name).is_dir() for name in options.sets):
        raise MissingError("no real frames beside the project")
    if options.pictures is not None:
        options.pictures.mkdir(parents=True, exist_ok=True)
    for line in lines(options.starts, options.pictures, options.sets):
        print(line, flush=True)


if __name__ == "__main__":
    raise SystemExit(
        run_parts(
            __doc__,
            {
                "cameras": Part(run_cameras, "--data TMP/cameras --frames 3 --draws 3 --starts 1 --roads 'urban day'"),
                "board": Part(run_board, "--pictures 6 --lenses 1"),
                "real": Part(run_real, "--starts 1 --sets view_of_delft kradar"),
            },
        )
    )

"""The doctor's checks of calibrations, with planted errors; the calibration of a radar against its LiDAR."""

import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from _calibration_worlds import SolvedValues, solved_edges, solved_lidars, solved_pairs, solved_radar
from _report import Part, part_parser, progress, run_parts
from scipy.stats import binom

from farfield.calibration.camera_edges import PARAMETERS as CAMERA_POSE
from farfield.calibration.camera_edges import (
    SIGMAS_PX,
    EdgeViews,
    move_camera,
)
from farfield.calibration.checking import check_camera, check_radar
from farfield.calibration.jobs import KRADAR_NODE_M
from farfield.calibration.least_squares import Parameter
from farfield.calibration.lidar_lidar import PARAMETERS as LIDAR_POSE
from farfield.calibration.radar_features import read_sensor_pairs
from farfield.calibration.radar_lidar import calibrate_radar
from farfield.calibration.radar_matching import PARAMETERS as RADAR
from farfield.calibration.radar_matching import RadarEvidence, RadarPose
from farfield.datasets import open_dataset
from farfield.datasets.base import Dataset
from farfield.datasets.kradar.writer import KRadarWriter
from farfield.geometry.boxes import wrap_angle_rad
from farfield.geometry.cameras import Camera
from farfield.inspection.doctor.calibration import camera_views
from farfield.simulation import find_preset, simulate_frame
from farfield.simulation.presets import Preset
from farfield.simulation.rigs.drive import drive_of

# Planted errors of a camera's calibration.


DOCTOR_ROADS = ("urban", "suburban", "highway")
SETS = 20
DOCTOR_RUNS = (30, 100, 170, 240)
DOCTOR_LENGTH = 6
PICTURES = (0, 3, 5)
ERRORS = (  # those with a figure to meet first
    ("correct", 0.0),
    ("deg", 1.0),
    ("cm", 20.0),
    ("cm", 40.0),
    ("deg", 2.0),
    ("deg", 0.5),
    ("cm", 10.0),
    ("deg", 0.2),
    ("cm", 5.0),
    ("deg", 0.1),
    ("cm", 2.0),
    ("drift deg", 1.0),
    ("drift cm", 20.0),
)


def simulate_set(folder: Path, number: int, runs: int | None) -> Path:
    """One drive as a K-Radar; frames that are there are kept."""
    preset = find_preset("kradar-sim", road=DOCTOR_ROADS[number % 3], time="day", weather="normal", duration_s=30.0)
    writer = KRadarWriter(folder / f"{number:02d}")
    if (writer.root / "done").exists():
        return writer.root
    for start in DOCTOR_RUNS[:runs]:
        for step in range(DOCTOR_LENGTH):
            sensors = ("os2-64", "sparse", *(("cam-front",) if step in PICTURES else ()))
            frame = simulate_frame(preset, seed=1000 + number, sequence=0, index=start + step, sensors=sensors)
            if not writer.paths(frame)["record"].exists():
                writer.write(frame)
    writer.finish()
    (writer.root / "done").touch()
    return writer.root


def planted_camera(camera: Camera, kind: str, size: float, rng: np.random.Generator) -> Camera:
    """The camera turned about, or shifted along, a random axis."""
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    delta = np.zeros(6)
    delta[slice(0, 3) if kind.endswith("deg") else slice(3, 6)] = axis
    return move_camera(camera, delta * (np.radians(size) if kind.endswith("deg") else size / 100))


def drifted(camera: Camera, views: EdgeViews, kind: str, size: float, rng: np.random.Generator) -> EdgeViews:
    """The LiDAR's edges of the second half of the drive as they are seen after the camera has moved."""
    late = views.frame >= views.count // 2
    away = planted_camera(camera, kind, size, rng)
    step = np.linalg.inv(away.camera_T_lidar) @ camera.camera_T_lidar
    points = views.points_m.copy()
    points[late] = points[late] @ step[:3, :3].T + step[:3, 3]
    return replace(views, points_m=points)


def kept_views(root: Path, data: Dataset) -> tuple[Camera, EdgeViews]:
    """The camera and the edges of a drive, found once."""
    path = root / "views.npz"
    camera = data[0].cameras["cam-front"]
    if not path.exists():
        camera, views = camera_views(data, range(len(data)), "cam-front")
        levels = {f"level{number}": level for number, level in enumerate(views.levels)}
        size = np.array([camera.width_px, camera.height_px])
        columns = {name: value for name, value in vars(views).items() if name != "levels"}
        np.savez(path.with_name("part.npz"), **levels, **columns, size=size)
        path.with_name("part.npz").rename(path)
    with np.load(path) as known:
        width, height = (int(each) for each in known["size"])
        levels = tuple(known[f"level{number}"] for number in range(len(SIGMAS_PX)))
        columns = {name: known[name] for name in ("points_m", "frame", "axis", "weight")}
    return replace(camera, width_px=width, height_px=height), EdgeViews(levels=levels, **columns)


def check_set(root: Path, number: int, done: set[tuple[int, str, str, float]], kinds: int) -> Iterator[dict[str, Any]]:
    """All checks of one drive that are not in the journal."""
    data, wanted = open_dataset(root), [each for each in ERRORS[:kinds] if (number, "camera", *each) not in done]
    if not wanted:
        return
    camera, views = kept_views(root, data)
    for kind, size in wanted:
        rng = np.random.default_rng((number, int(10 * size), len(kind)))
        if "drift" in kind:
            found = check_camera(camera, drifted(camera, views, kind, size, rng))
        else:
            found = check_camera(planted_camera(camera, kind, size, rng), views)
        yield {"set": number, "sensor": "camera", "kind": kind, "size": size, **vars(found)}


def _in_order(error: tuple[str, float]) -> tuple[int, float]:
    return ["correct", "deg", "cm", "drift deg", "drift cm"].index(error[0]), error[1]


def table(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Claims by error."""
    yield f"{'error':>16}{'sets':>6}{'off':>7}{'moved':>7}{'not told':>10}   median: deg    cm    px  evidence"
    for kind, size in sorted(ERRORS, key=_in_order):
        own = [row for row in rows if (row["kind"], row["size"]) == (kind, size)]
        if own:
            verdicts = [row["verdict"] for row in own]
            counts = [verdicts.count(word) for word in ("off", "moved", "not told")]
            turn, cm, px, sure = (np.median([row[key] for row in own]) for key in ("degrees", "cm", "px", "evidence"))
            what = kind if kind == "correct" else f"{kind} {size:g}"
            yield (
                f"{what:>16}{len(own):6d}{counts[0]:7d}{counts[1]:7d}{counts[2]:10d}"
                f"   {turn:11.2f}{cm:6.1f}{px:6.1f}{sure:10.1f}"
            )


def draw(rows: list[dict[str, Any]], path: Path, sensor: str = "camera") -> None:
    """Picture of a sensor's rows: the share that is claimed over the planted error, with Wilson's intervals."""
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(1, 2, figsize=(9, 3.4), sharey=True, layout="constrained")
    rows = [row for row in rows if row["sensor"] == sensor]
    right = [row for row in rows if row["kind"] == "correct"]
    for panel, (kind, unit, asked) in zip(panels, (("deg", "degrees", 1.0), ("cm", "centimetres", 20.0)), strict=True):
        sizes = sorted({row["size"] for row in rows if row["kind"] == kind})
        own = [right, *([row for row in rows if (row["kind"], row["size"]) == (kind, size)] for size in sizes)]
        shares = np.array([np.mean([row["verdict"] in ("off", "moved") for row in each]) for each in own])
        count, z = np.array([len(each) for each in own]), 1.96
        middle = (shares + z**2 / (2 * count)) / (1 + z**2 / count)
        half = z * np.sqrt(shares * (1 - shares) / count + z**2 / (4 * count**2)) / (1 + z**2 / count)
        low, high = shares - (middle - half), middle + half - shares
        at = np.arange(len(own))
        panel.errorbar(at, 100 * shares, 100 * np.maximum([low, high], 0), fmt="o-", capsize=3, color="#1f6fb4")
        panel.axvline(1 + sizes.index(asked), color="#999999", linestyle=":")
        panel.text(
            0.95 + sizes.index(asked), 50, "asked: always from here", rotation=90, ha="right", va="center", size=8
        )
        panel.set_xticks(at, ["right", *(f"{size:g}" for size in sizes)])
        panel.set_xlabel(f"planted error of the {sensor}, {unit}")
        panel.grid(axis="y", alpha=0.3)
    panels[0].set_ylabel(f"claimed, % of {len(right)} data sets")
    figure.savefig(path, dpi=110)


def run_doctor(arguments: Sequence[str]) -> None:
    """How often the doctor finds a planted error of a camera's calibration, and that it claims none on correct data.

    Simulates twenty K-Radar drives by day, each 24 frames in four runs of six with pictures, plants errors of 0.1 to 2
    degrees about, or 2 to 40 cm along, a random axis, and counts the claims. ``radar`` does so for the
    radar. Drives are kept in --data and checks in its journal, so that a second run goes on.

        python benchmarks/calibration_checks.py doctor [--sets 20]
    """
    parser = part_parser(run_doctor.__doc__)
    parser.add_argument("--data", type=Path, default=Path("data/calibration_doctor"))
    parser.add_argument("--picture", type=Path, help="of the camera's rows: where its PNG goes")
    parser.add_argument("--sets", type=int, default=SETS)
    parser.add_argument("--runs", type=int, help="of a drive, the first so many of its four")
    parser.add_argument("--kinds", type=int, default=len(ERRORS), help="of the errors, the first so many")
    options = parser.parse_args(arguments)
    journal = options.data / "checks.jsonl"
    journal.parent.mkdir(parents=True, exist_ok=True)
    rows = [json.loads(line) for line in journal.read_text().splitlines()] if journal.exists() else []
    for number in progress(range(options.sets), "drives"):
        root = simulate_set(options.data, number, options.runs)
        done = {(row["set"], row["sensor"], row["kind"], row["size"]) for row in rows}
        for row in check_set(root, number, done, options.kinds):
            rows.append(row)
            with journal.open("a") as file:
                file.write(json.dumps(row) + "\n")
    print(f"{options.sets} drives, 24 frames and 12 pictures each; kradar-sim by day\n")
    print("\n".join(table(rows)))
    if options.picture:
        draw(rows, options.picture)


# Drives of a minute each for the radar, of which runs of consecutive frames are kept.


STARTS_ROADS = ("urban", "highway", "suburban")
LIGHTS = ("day", "night")
SEED = 6
SECONDS = 60.0
DEVELOPED = 6  # the first drives, on which the solver was developed: they are not reported
UNSEEN = 48  # the first of the drives on which the threshold of a claim was not chosen
FRESH = 68  # the first of those on which nothing was chosen or seen
STARTS_RUNS = tuple(range(5, 560, 29))
STARTS_LENGTH = 10


@dataclass(frozen=True, kw_only=True)
class SimulatedDrive:
    """One drive.

    Args:
        road: Name of a road.
        light: ``"day"`` or ``"night"``.
        number: Of the sequence: drives of other numbers have other worlds.
        seed: Of the data set.
        runs: First frame of each run.
    """

    road: str
    light: str
    number: int
    seed: int = SEED
    runs: tuple[int, ...] = STARTS_RUNS

    @property
    def name(self) -> str:
        """Of its folder."""
        return f"{self.road}-{self.light}-{self.number}"

    @property
    def preset(self) -> Preset:
        """What is simulated."""
        return find_preset("kradar-sim", road=self.road, time=self.light, weather="normal", duration_s=SECONDS)

    @property
    def late_s(self) -> float:
        """How much later its radar measures, in seconds."""
        return drive_of(self.preset, self.seed, self.number).mounting.radar_offset_s

    def opened(self, folder: Path, sensors: Sequence[str] = ("os2-64", "sparse")) -> Dataset:
        """Simulate the frames that are not there, and open the drive as a K-Radar."""
        writer = KRadarWriter(folder / self.name)
        there = {int(path.stem.split("_")[1]) - 1 for path in writer.root.glob("*/frame_record/*.json")}  # from 1
        wanted = [start + step for start in self.runs for step in range(STARTS_LENGTH)]
        absent = [index for index in wanted if index not in there]
        for index in progress(absent, f"simulating {self.name}"):
            writer.write(
                simulate_frame(self.preset, seed=self.seed, sequence=self.number, index=index, sensors=tuple(sensors))
            )
        if absent:
            writer.finish()
        return open_dataset(writer.root, format="kradar")


KINDS = [(road, light) for light in LIGHTS for road in STARTS_ROADS]


def drives(rounds: int, first: int = DEVELOPED) -> list[SimulatedDrive]:
    """Drives in the order in which they are made: each road by day and by night in every round."""
    return [_numbered(first + number) for number in range(len(KINDS) * rounds)]


def highways(count: int, first: int) -> list[SimulatedDrive]:
    """So many drives on highways from a number on: there the spread is greatest."""
    found = (_numbered(number) for number in range(first, first + len(KINDS) * count))
    return [each for each in found if each.road == "highway"][:count]


def unseen(count: int) -> list[SimulatedDrive]:
    """So many drives on which the threshold of a claim was not chosen, roads and lights in turn."""
    return [_numbered(UNSEEN + number) for number in range(count)]


def _numbered(number: int) -> SimulatedDrive:
    road, light = KINDS[number % len(KINDS)]
    return SimulatedDrive(road=road, light=light, number=number)


STARTS = 8
FRAME_S = 0.1
RIGHT = RadarPose(x_m=-2.54, y_m=0.3, z_m=0.7)
PLANTED = tuple(error for error in ERRORS if "drift" not in error[0])


def planted_radar(pose: RadarPose, kind: str, size: float, rng: np.random.Generator) -> RadarPose:
    """The radar's pose with another yaw, or shifted in the plane."""
    if kind.endswith("deg"):
        return replace(pose, yaw_rad=pose.yaw_rad + float(np.radians(size) * rng.choice([-1, 1])))
    turn = rng.uniform(0, 2 * np.pi)
    x, y = np.array([np.cos(turn), np.sin(turn)]) * size / 100
    return replace(pose, x_m=pose.x_m + float(x), y_m=pose.y_m + float(y))


def evidence_of(drive: SimulatedDrive, folder: Path) -> RadarEvidence:
    """Objects of both sensors in a drive."""
    data = drive.opened(folder)
    return RadarEvidence.of(read_sensor_pairs((data[i] for i in range(len(data))), node_m=KRADAR_NODE_M))


def start_row(drive: SimulatedDrive, evidence: RadarEvidence, number: int) -> dict[str, Any]:
    """Error, sigma and CPU time of one random start."""
    rng = np.random.default_rng((0, drive.number, number))
    x, y = np.array([RIGHT.x_m, RIGHT.y_m]) + rng.uniform(-2, 2, 2)
    yaw, offset = np.radians(rng.uniform(-3, 3)), int(rng.integers(-3, 4))
    began = time.process_time()
    found = calibrate_radar(evidence, RadarPose(x_m=x, y_m=y, z_m=RIGHT.z_m, yaw_rad=yaw, frames=offset))
    error = found.pose.vector - RIGHT.vector - [0.0, 0.0, 0.0, drive.late_s]
    error[2] = wrap_angle_rad(error[2])
    return {
        "error": error.tolist(),
        "sigma": found.solution.sigma.tolist(),
        "frames": found.pose.frames,
        "seconds": time.process_time() - began,
    }


def check_row(drive: SimulatedDrive, evidence: RadarEvidence, kind: str, size: float) -> dict[str, Any]:
    """What the doctor says of a calibration with a planted error."""
    rng = np.random.default_rng((1, drive.number, int(10 * size), len(kind)))
    return vars(check_radar(planted_radar(RIGHT, kind, size, rng), evidence))


def made(folder: Path, wanted: list[SimulatedDrive], starts: int, seconds: float) -> Iterator[dict[str, Any]]:
    """Rows of all starts and checks: those in the journal, and those made until the time is up."""
    journal, began = folder / "rows.jsonl", time.monotonic()
    rows = [json.loads(line) for line in journal.read_text().splitlines()] if journal.exists() else []
    yield from (row for row in rows if row["drive"] in {drive.name for drive in wanted})
    known = {(row["drive"], row["kind"], row["size"]) for row in rows}
    for drive in wanted:
        keys = [(drive.name, "start", number) for number in range(starts)]
        keys += [(drive.name, kind, size) for kind, size in PLANTED]
        absent = [key for key in keys if key not in known]
        if not absent or time.monotonic() - began > seconds:
            continue
        evidence = evidence_of(drive, folder)
        for name, kind, size in absent:
            own = start_row(drive, evidence, int(size)) if kind == "start" else check_row(drive, evidence, kind, size)
            row = {"drive": name, "kind": kind, "size": size, "road": drive.road, "light": drive.light, **own}
            with journal.open("a") as file:
                file.write(json.dumps(row) + "\n")
            yield row


def starts_table(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Errors, sigma and coverage by road and light."""
    yield "Radar-LiDAR from +-2 m, +-3 degrees, +-3 frames; median and worst errors, median sigma; covered: within two"
    yield "frames: exact to half a frame, frame and time offset together, as dt is"
    yield (
        "road            drives starts  frames   x cm   y cm yaw deg  dt ms | worst x     y     yaw | "
        "sigma x     y     yaw   covered   CPU s"
    )
    groups = [(f"{road} {light}", (road,), (light,)) for road in STARTS_ROADS for light in LIGHTS]
    groups += [(f"{road} both", (road,), LIGHTS) for road in STARTS_ROADS] + [
        (f"all {light}", STARTS_ROADS, (light,)) for light in LIGHTS
    ]
    for name, roads, lights in [*groups, ("all", STARTS_ROADS, LIGHTS)]:
        own = [row for row in rows if row["kind"] == "start" and row["road"] in roads and row["light"] in lights]
        if own:
            yield f"{name:<15} {starts_row(own)}"


def medians(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Medians over drives, and what they may be: intervals of 95 % between order statistics."""
    yield "\nMedian over drives of x, y (cm) and yaw (degrees), and the interval of 95 % that so many drives leave"
    for name, roads in [*((road, (road,)) for road in STARTS_ROADS), ("all", STARTS_ROADS)]:
        own = [row for row in rows if row["kind"] == "start" and row["road"] in roads]
        by_drive = {row["drive"]: np.abs(row["error"][:3]) for row in own}
        if not by_drive:
            continue
        away = np.sort(np.array(list(by_drive.values())) * [100.0, 100.0, 180 / np.pi], axis=0)
        least = max(int(binom.ppf(0.025, len(away), 0.5)) - 1, 0)
        parts = zip(("x", "y", "yaw"), (1, 1, 3), np.median(away, 0), away[least], away[-1 - least], strict=True)
        told = [f"{axis} {middle:.{n}f} ({low:.{n}f} to {high:.{n}f})" for axis, n, middle, low, high in parts]
        yield f"{name:<9} {len(away):3d} drives: {', '.join(told)}"


def whole_error(row: dict[str, Any]) -> np.ndarray:
    """Errors of x, y and yaw, and of the time that frames and time offset name together.

    A radar that is late by half a frame is as far from one frame as from the next: either may be named.
    """
    return np.add(row["error"], [0.0, 0.0, 0.0, -FRAME_S * row["frames"]])


def starts_row(rows: list[dict[str, Any]]) -> str:
    """One line."""
    away = np.abs([whole_error(row) for row in rows])
    sigma = np.array([row["sigma"] for row in rows])
    covered, (x_told, y_told, yaw_told, _) = away < 2 * sigma, np.median(sigma, axis=0)
    (x, y, yaw, late), worst = np.median(away, axis=0), np.max(away, axis=0)
    exact = away[:, 3] < FRAME_S / 2
    return (
        f"{len({row['drive'] for row in rows}):6d} {len(rows):6d} {np.mean(exact):7.0%} "
        f"{100 * x:6.1f} {100 * y:6.1f} {np.degrees(yaw):7.3f} {1000 * late:6.1f}   "
        f"{100 * worst[0]:5.1f} {100 * worst[1]:5.1f} {np.degrees(worst[2]):7.3f} | "
        f"{100 * x_told:5.1f} {100 * y_told:5.1f} {np.degrees(yaw_told):7.3f} {np.mean(covered):9.0%} "
        f"{np.mean([row['seconds'] for row in rows]):7.1f}"
    )


def drives_table(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Where the starts of each drive ended: their median error, in brackets sigma, and how far they lie apart."""
    yield "\nBy drive: median error (sigma) of its starts; apart: between the two of them farthest from one another"
    yield "drive                    x cm          y cm        yaw deg         dt ms     apart: x cm   y cm  yaw deg"
    unit = np.array([100.0, 100.0, 180 / np.pi, 1000.0])
    for name in dict.fromkeys(row["drive"] for row in rows if row["kind"] == "start"):
        own = [row for row in rows if (row["drive"], row["kind"]) == (name, "start")]
        error = np.array([whole_error(row) for row in own]) * unit
        sigma = np.array([row["sigma"] for row in own]) * unit
        (x, y, yaw, late), (sx, sy, syaw, slate) = np.median(error, axis=0), np.median(sigma, axis=0)
        apart = np.ptp(error, axis=0)
        yield (
            f"{name:<20} {x:6.1f} ({sx:4.1f}) {y:6.1f} ({sy:4.1f}) {yaw:7.3f} ({syaw:5.3f}) {late:6.1f} ({slate:4.1f})"
            f"  {apart[0]:12.2f} {apart[1]:6.2f} {apart[2]:8.4f}"
        )


def checks_table(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Claims of the doctor by planted error."""
    yield "\nThe doctor's check of the radar, with the right calibration and with planted errors"
    yield f"{'error':>10} {'sets':>5} {'off':>5} {'fits':>5} {'not told':>9}   sigmas: least median  worst"
    for kind, size in sorted(PLANTED, key=lambda error: (error[0] != "correct", error[0], error[1])):
        own = [row for row in rows if (row["kind"], row["size"]) == (kind, size)]
        if own:
            verdicts, sure = [row["verdict"] for row in own], np.array([row["evidence"] for row in own])
            counts = " ".join(
                f"{verdicts.count(word):{width}d}" for word, width in (("off", 5), ("fits", 5), ("not told", 9))
            )
            what = kind if kind == "correct" else f"{kind} {size:g}"
            yield f"{what:>10} {len(own):5d} {counts} {sure.min():15.1f} {np.median(sure):6.1f} {sure.max():6.1f}"


def run_radar(arguments: Sequence[str]) -> None:
    """Radar-LiDAR calibrations from random starts, and the doctor's check of a radar, against the simulator's truth.

    Simulates K-Radar's car on three roads by day and by night: drives of a minute each, of which twenty runs of ten
    frames are kept. Eight solvers start in each drive, from up to +-2 m, +-3 degrees and +-3 frames off. The starts of
    one drive share its data, so that a row's spread is that of its drives. The doctor checks every drive with the right
    calibration and with planted errors of 0.1 to 2 degrees, or 2 to 40 cm in a random direction. How deep a side of the
    road may be was chosen on the highways up to number 25, among others; the threshold of a claim on drives up to
    number 46; how strong a side lobe may be from the array alone, and then seen to fix y on the highways up to number
    67. On those of --unseen, from number 48 on, nothing else was, and on those of --fresh, from number 68 on, nothing
    at all. The drives stay in --data, as does all that is done: a second run goes on where the first ended.

        python benchmarks/calibration_checks.py radar --rounds 4 --highways 6
        python benchmarks/calibration_checks.py radar --rounds 0 --unseen 20 --picture PNG --section 'radar, unseen'
    """
    parser = part_parser(run_radar.__doc__)
    parser.add_argument("--data", type=Path, default=Path("data/radar_calibration"))
    parser.add_argument("--picture", type=Path, help="of the doctor's rows: where its PNG goes")
    parser.add_argument("--rounds", type=int, default=2, help="drives of each road by day and by night")
    parser.add_argument("--highways", type=int, default=0, help="so many more drives on highways after those")
    parser.add_argument("--developed", action="store_true", help="the drives on which the solver was developed instead")
    parser.add_argument("--unseen", type=int, default=0, help="so many drives more, made after the threshold was set")
    parser.add_argument("--fresh", type=int, default=0, help="so many highways more, simulated after all choices")
    parser.add_argument("--starts", type=int, default=STARTS, help="in each drive")
    parser.add_argument("--drives", type=int, help="the first so many of all these")
    parser.add_argument("--runs", type=int, help="of a drive, the first so many of its twenty")
    parser.add_argument(
        "--seconds", type=float, default=np.inf, help="after which no drive begins; 0 prints what is there"
    )
    options = parser.parse_args(arguments)
    options.data.mkdir(parents=True, exist_ok=True)
    after = DEVELOPED + len(KINDS) * options.rounds
    wanted = drives(1, first=0) if options.developed else [*drives(options.rounds), *highways(options.highways, after)]
    wanted += [*unseen(options.unseen), *highways(options.fresh, FRESH)]
    wanted = [replace(drive, runs=STARTS_RUNS[: options.runs]) for drive in wanted[: options.drives]]
    rows = list(made(options.data, wanted, options.starts, options.seconds))
    count = len({row["drive"] for row in rows})
    runs = f"{len(STARTS_RUNS[: options.runs])} runs of {STARTS_LENGTH} frames"
    each = f"{runs} within a minute, {options.starts} starts in each"
    lines = [
        f"{count} drives of {each}",
        "",
        *starts_table(rows),
        *medians(rows),
        *drives_table(rows),
        *checks_table(rows),
    ]
    print("\n".join(lines))
    if options.picture:
        draw([{"sensor": "radar", **row} for row in rows], options.picture, "radar")


# Errors over sigma, over many made-up drives with known truth.


def spread_rows(name: str, parameters: Sequence[Parameter], solved: Sequence[SolvedValues]) -> Iterator[str]:
    """Errors over sigma of one kind, a row a parameter."""
    error, sigma = (np.array([getattr(each, column) for each in solved]) for column in ("error", "sigma"))
    for number, parameter in enumerate(parameters):
        ratio = error[:, number] / sigma[:, number]
        unit, factor = {"rad": ("deg", 180 / np.pi), "m": ("cm", 100.0), "s": ("ms", 1000.0)}[parameter.unit]
        yield (
            f"{name:<28} {parameter.name:<12} {len(ratio):4d} {np.sqrt(np.mean(ratio**2)):7.2f} "
            f"{np.mean(np.abs(ratio) < 2):8.0%} {np.abs(ratio).max():6.1f}   "
            f"{factor * np.sqrt(np.mean(error[:, number] ** 2)):9.3f} {factor * np.median(sigma[:, number]):9.3f} "
            f"{unit}"
        )


def run_sigma(arguments: Sequence[str]) -> None:
    """Errors over sigma of every kind of calibration, over many made-up drives with known truth.

    Roads, boards and streets are drawn anew for every seed, with what the simulator's echoes, rays and pictures err by,
    errors that all echoes of a drive have in common among them (``_calibration_worlds.py``). Where sigma is honest, the
    root mean square of the ratio is near 1, and 95 % lie within two sigmas.

        python benchmarks/calibration_checks.py sigma [--seeds 60]
    """
    parser = part_parser(run_sigma.__doc__)
    parser.add_argument("--seeds", type=int, default=60)
    parser.add_argument("--edge-seeds", type=int, default=40)
    parser.add_argument("--kinds", nargs="+", choices=("radar", "pairs", "lidars", "edges"))
    options = parser.parse_args(arguments)
    kinds = [
        ("radar", "radar, 90 frames", RADAR, partial(solved_radar, frames=90), options.seeds),
        ("radar", "radar, 30 frames", RADAR, partial(solved_radar, frames=30), options.seeds),
        ("pairs", "camera, 8 pairs", CAMERA_POSE, partial(solved_pairs, count=8), options.seeds),
        ("pairs", "camera, 20 pairs", CAMERA_POSE, partial(solved_pairs, count=20), options.seeds),
        ("lidars", "LiDAR to LiDAR, 3 frames", LIDAR_POSE, partial(solved_lidars, frames=3), options.seeds),
        ("edges", "camera, edges, 16 frames", CAMERA_POSE, partial(solved_edges, frames=16), options.edge_seeds),
    ]
    print("kind                         parameter    seeds  rms z  within 2  worst   rms error     sigma")
    for kind, name, parameters, solve, seeds in kinds:
        if options.kinds is None or kind in options.kinds:
            print("\n".join(spread_rows(name, parameters, [solve(seed) for seed in range(seeds)])), flush=True)


if __name__ == "__main__":
    raise SystemExit(
        run_parts(
            __doc__,
            {
                "doctor": Part(run_doctor, "--data TMP/doctor --sets 1 --kinds 2 --runs 1"),
                "sigma": Part(run_sigma, "--seeds 2 --edge-seeds 1 --kinds pairs radar lidars"),
                "radar": Part(run_radar, "--data TMP/radar --rounds 1 --starts 1 --drives 1 --runs 1"),
            },
        )
    )

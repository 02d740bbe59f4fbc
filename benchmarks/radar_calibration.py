"""Radar-LiDAR calibrations from random starts, and the doctor's check of a radar, against the simulator's truth.

Simulates K-Radar's car on three roads by day and by night: drives of a minute each, of which twenty runs of ten frames
are kept. Eight solvers start in each drive, from up to +-2 m, +-3 degrees and +-3 frames off. The starts of one drive
share its data, so that a row's spread is that of its drives. The doctor checks every drive with the right calibration
and with planted errors of 0.1 to 2 degrees, or 2 to 40 cm in a random direction. How deep a side of the road may be was
chosen on the highways up to number 25, among others; the threshold of a claim on drives up to number 46; how strong a
side lobe may be from the array alone, and then seen to fix y on the highways up to number 67. On those of --unseen,
from number 48 on, nothing else was, and on those of --fresh, from number 68 on, nothing at all. The drives stay in
--data, as does all that is done: a second run goes on where the first ended.

    python benchmarks/radar_calibration.py --rounds 4 --highways 6 --output benchmarks/results/radar_calibration.txt
    python benchmarks/radar_calibration.py --rounds 0 --unseen 20 --picture docs/images/calibration_doctor_radar.png
"""

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from _calibration_drives import (
    DEVELOPED,
    FRESH,
    KINDS,
    LENGTH,
    LIGHTS,
    ROADS,
    RUNS,
    SimulatedDrive,
    drives,
    highways,
    unseen,
)
from _report import header
from calibration_doctor import ERRORS, draw
from scipy.stats import binom

from farfield.calibration.checking import check_radar
from farfield.calibration.jobs import KRADAR_NODE_M
from farfield.calibration.radar_features import read_sensor_pairs
from farfield.calibration.radar_lidar import calibrate_radar
from farfield.calibration.radar_matching import RadarEvidence, RadarPose
from farfield.geometry.boxes import wrap_angle_rad

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
    groups = [(f"{road} {light}", (road,), (light,)) for road in ROADS for light in LIGHTS]
    groups += [(f"{road} both", (road,), LIGHTS) for road in ROADS] + [
        (f"all {light}", ROADS, (light,)) for light in LIGHTS
    ]
    for name, roads, lights in [*groups, ("all", ROADS, LIGHTS)]:
        own = [row for row in rows if row["kind"] == "start" and row["road"] in roads and row["light"] in lights]
        if own:
            yield f"{name:<15} {starts_row(own)}"


def medians(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Medians over drives, and what they may be: intervals of 95 % between order statistics."""
    yield "\nMedian over drives of x, y (cm) and yaw (degrees), and the interval of 95 % that so many drives leave"
    for name, roads in [*((road, (road,)) for road in ROADS), ("all", ROADS)]:
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


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("data/radar_calibration"))
    parser.add_argument("--output", type=Path)
    parser.add_argument("--picture", type=Path, help="of the doctor's rows: where its PNG goes")
    parser.add_argument("--rounds", type=int, default=2, help="drives of each road by day and by night")
    parser.add_argument("--highways", type=int, default=0, help="so many more drives on highways after those")
    parser.add_argument("--developed", action="store_true", help="the drives on which the solver was developed instead")
    parser.add_argument("--unseen", type=int, default=0, help="so many drives more, made after the threshold was set")
    parser.add_argument("--fresh", type=int, default=0, help="so many highways more, simulated after all choices")
    parser.add_argument("--starts", type=int, default=STARTS, help="in each drive")
    parser.add_argument(
        "--seconds", type=float, default=np.inf, help="after which no drive begins; 0 prints what is there"
    )
    options = parser.parse_args()
    options.data.mkdir(parents=True, exist_ok=True)
    after = DEVELOPED + len(KINDS) * options.rounds
    wanted = drives(1, first=0) if options.developed else [*drives(options.rounds), *highways(options.highways, after)]
    wanted += [*unseen(options.unseen), *highways(options.fresh, FRESH)]
    rows = list(made(options.data, wanted, options.starts, options.seconds))
    count = len({row["drive"] for row in rows})
    lines = [
        header(),
        f"{count} drives of {len(RUNS)} runs of {LENGTH} frames within a minute, {options.starts} starts in each",
        "",
    ]
    lines += [*starts_table(rows), *medians(rows), *drives_table(rows), *checks_table(rows)]
    print("\n".join(lines))
    if options.output:
        options.output.write_text("\n".join(lines) + "\n", encoding="utf-8")
    if options.picture:
        draw([{"sensor": "radar", **row} for row in rows], options.picture, "radar")


if __name__ == "__main__":
    main()

"""Odometry on simulated drives of 300 m against the truth, its time, and KITTI raw's four sweeps against each other.

    python benchmarks/odometry.py FOLDER --every 2 --output benchmarks/results/odometry.txt

FOLDER takes the drives (``_drives.py``, 10 GB at ten sweeps a second) and what odometry writes beside them; what stands
there is not done again.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from _drives import DRIVES, STRIDE_S, Simulated, write
from _report import SHARED_REAL, header
from jaxtyping import Float

from farfield.datasets import open_dataset
from farfield.odometry.drift import differences, way_m
from farfield.odometry.drives import DriveSweeps, OdometryTrack, SweepSettings, Turning, odometry, register_sweeps
from farfield.odometry.odometry import OdometrySettings

CLOUDS = {"cirrus-sim": ("gaussian", "uniform"), "kradar-sim": ("os2-64",)}
TIMED = 20
KITTI = "kitti_raw/2011_09_26/2011_09_26_drive_0001_sync/velodyne_points/data"
HEAD = (
    "road      cloud      sweeps  way m  end %  deg/100 m   100 m stretches: rms %   deg    stated %   deg     "
    "CPU ms a sweep, fit + read  lost  not observed"
)


def ends(found: Float[np.ndarray, "n 4 4"], true: Float[np.ndarray, "n 4 4"]) -> tuple[float, float]:
    """Error over the whole drive: place in per cent of the way, direction in degrees a 100 m."""
    length, place_m, turn_deg = differences(true, found, stretch_m=1e9)
    return 100 * float(place_m[0]) / length, 100 * float(turn_deg[0]) / length


def timed(sweeps: DriveSweeps) -> tuple[float, float]:
    """Milliseconds of the processor that the sweeps in the middle of a drive take: fitting, reading."""
    began = time.process_time()
    middle = [sweeps[len(sweeps) // 2 + number] for number in range(TIMED)]
    read = time.process_time()
    register_sweeps(middle[:5])
    started = time.process_time()
    register_sweeps(middle)  # begins like the five
    done = time.process_time()
    return 1e3 * (done - started - (started - read)) / (len(middle) - 5), 1e3 * (read - began) / len(middle)


def one(drive: Simulated, cloud: str, root: Path, every: int, *, backward: bool) -> str:
    """A row of the table."""
    data = open_dataset(drive.folder(root))
    begins = drive.frame(0).time_ns
    numbers = [round((data[index].time_ns - begins) / (STRIDE_S * 1e9)) for index in range(len(data))]
    rows = [row for row, number in enumerate(numbers) if number % every == 0]
    chosen = data.select(rows)
    settings = SweepSettings(cloud=cloud)
    out = root / f"{drive.preset}-{drive.road}-{cloud}-{every}"
    (track,) = odometry(chosen, out, sweeps=settings, backward=backward)
    true = drive.truth()[[numbers[row] for row in rows]]
    fit_ms, read_ms = timed(DriveSweeps(chosen, chosen.drives()[0], settings))
    return row_of(track, true, drive.road, cloud, fit_ms, read_ms)


def row_of(
    track: OdometryTrack, true: Float[np.ndarray, "n 4 4"], road: str, cloud: str, fit_ms: float, read_ms: float
) -> str:
    """The errors of a track, those that it states, and its times as a line."""
    end, turn = ends(track.table.world_T_frame, true)
    length, place_m, turn_deg = differences(true, track.table.world_T_frame)
    rms = [float(np.sqrt((values**2).mean())) for values in (100 * place_m / length, turn_deg)]
    drift = track.drift
    stated = "       -       -" if drift is None else f"{drift.place_percent:>8.2f}{drift.turn_deg:>8.3f}"
    blind = sum(bool(name) for name in track.table.blind)
    return (
        f"{road:<10}{cloud:<10}{len(true):>7}{way_m(true)[-1]:>7.0f}{end:>7.2f}{turn:>11.3f}{rms[0]:>25.2f}{rms[1]:>8.3f}"
        f"   {stated}{fit_ms:>20.0f} + {read_ms:<4.0f}{track.table.lost.sum():>10}{blind:>14}"
    )


def kitti() -> list[str]:
    """Four real sweeps, forwards and backwards, by how the scanner is taken to turn."""
    lines = [
        "KITTI raw, drive 0001, four sweeps 0.1036 s apart; its GPS/IMU says 13.17 m/s at the first, 1.364 m a step",
        "",
    ]
    lines.append("points moved          steps m               backwards, m          residual mm   parted by")
    data = open_dataset(SHARED_REAL / KITTI)
    (drive,) = data.drives()
    turnings: tuple[Turning, ...] = ("no", "clockwise", "counterclockwise")
    for turning in turnings:
        settings = SweepSettings(turning=turning, step_s=0.1036)
        forward = register_sweeps(DriveSweeps(data, drive, settings), OdometrySettings())
        back = register_sweeps(DriveSweeps(data, drive, settings, backward=True), OdometrySettings())
        tracks = (forward.world_T_sensor, np.linalg.inv(back.world_T_sensor[-1]) @ back.world_T_sensor[::-1])
        steps = ["  ".join(f"{step:.3f}" for step in np.diff(way_m(track))) for track in tracks]
        off = np.linalg.inv(tracks[0][-1]) @ tracks[1][-1]
        turned = np.degrees(np.arccos(np.clip((np.trace(off[:3, :3]) - 1) / 2, -1, 1)))
        parted = f"{100 * np.linalg.norm(off[:3, 3]):.1f} cm, {turned:.3f} deg after {way_m(tracks[0])[-1]:.2f} m"
        lines.append(
            f"{turning:<20}{steps[0]:<23}{steps[1]:<23}{1e3 * forward.residual_m[1:].mean():>10.1f}   {parted}"
        )
    return lines


def main() -> None:
    """Run what was asked for; the output grows row by row."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--every", type=int, default=1, help="take every n-th sweep of ten a second")
    parser.add_argument("--backward", default="gaussian", help="clouds whose drift is stated too, by commas")
    parser.add_argument("--output", type=Path)
    given = parser.parse_args()
    lines = [header(), "", f"simulated drives, a sweep each {given.every * STRIDE_S:.1f} s", "", HEAD]
    real = kitti() if (SHARED_REAL / KITTI).is_dir() else ["KITTI raw: not here"]
    for drive in sorted(DRIVES, key=lambda each: each.road):
        write(drive, given.folder, range(0, drive.frames, given.every))
        for cloud in CLOUDS[drive.preset]:
            lines.append(one(drive, cloud, given.folder, given.every, backward=cloud in given.backward.split(",")))
            print(lines[-1], file=sys.stderr, flush=True)
            if given.output is not None:
                given.output.write_text("\n".join([*lines, "", *real]) + "\n", encoding="utf-8")
    print("\n".join([*lines, "", *real]))


if __name__ == "__main__":
    main()

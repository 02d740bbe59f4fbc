"""``farfield odometry``: poses for drives that come without."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from farfield.cli._flags import ALL_CORES, AS_THEY_ARE, Jobs, Reading, ReadingFlags
from farfield.cli._output import check_outputs, from_data, would_write, write_json
from farfield.vocabulary.counts import count_of

if TYPE_CHECKING:
    from farfield.datasets import Dataset


def run(
    data: tyro.conf.Positional[Path],
    /,
    *,
    out: Path | None = None,
    cloud: Annotated[str | None, tyro.conf.arg(aliases=["--clouds"])] = None,
    deskew: bool = True,
    turning: Literal["no", "clockwise", "counterclockwise"] = "no",
    step_s: float = 0.1,
    reach_m: float = 120.0,
    backward: bool = True,
    drives: tuple[str, ...] = (),
    truth: Path | None = None,
    reading: Reading = AS_THEY_ARE,
    picture: Path | None = None,
    overwrite: bool = False,
    jobs: Jobs = ALL_CORES,
    dry_run: bool = False,
) -> int:
    """Find the poses of a data set's LiDAR from its sweeps alone, and say how far they drift.

    examples:
      farfield odometry Cirrus_dataset1
      farfield odometry Cirrus_dataset1 --cloud uniform --out runs/uniform --picture runs/uniform/track.png
      farfield odometry kradar/ --drives 1 2 --workers 2
      farfield odometry velodyne_points/data --turning counterclockwise --step-s 0.1036
      farfield odometry kitti_raw --truth oxts_poses
      farfield track predictions.csv --data Cirrus_dataset1 --poses runs/odometry-Cirrus_dataset1 --out tracks.csv

    Writes poses/DRIVE.csv, odometry.json and odometry.html, never into the data. Everything that opens data takes them:
    ff.open_dataset(DATA, poses=OUT). An interrupted run resumes, in the middle of a drive too; results do not depend on
    interruptions or the number of workers.

    Args:
        data: The data set.
        out: Folder to write into (default: runs/odometry-NAME).
        cloud: Name of the cloud (default: the one in whose coordinates the frames stand).
        deskew: Move points to their sweep's moment, where their times are known.
        turning: How the scanner turns, seen from above, where points have no times and were not moved: the beam looks
            along x at the sweep's moment.
        step_s: Seconds between sweeps where frames have no times.
        reach_m: Farther points are left out.
        backward: Place the sweeps backwards too, which tells the drift and takes as long again.
        drives: Only these.
        truth: Known poses to compare with, as `farfield odometry` writes them (default: those of the data). Absolute
            errors (ATE, after a rigid alignment) and relative ones (RPE) by step and length stand in accuracy.json too.
        reading: How the files are read.
        picture: SVG, PNG or JPEG of the tracks from above to write.
        overwrite: Forget what was done before.
        jobs: Who does the work.
        dry_run: Say what would be written, and write nothing.
    """
    from farfield.errors import ConfigError
    from farfield.figures.style import check_picture
    from farfield.files.atomic import readable
    from farfield.jobs.folders import held
    from farfield.odometry.accuracy import accuracy_json, against_drive
    from farfield.odometry.drives import SweepSettings, odometry
    from farfield.odometry.odometry import OdometrySettings
    from farfield.pages.odometry_page import write_odometry

    if picture is not None:
        check_picture(picture)
    name = readable(data.resolve().name)
    folder = out or Path("runs") / f"odometry-{name}"
    check_outputs((data, *reading.paths), files={"--picture": picture}, folders={"--out": folder})
    opened = reading.open(data)
    if drives:
        indices_by_drive = opened.drive_indices()
        absent = [drive for drive in drives if drive not in indices_by_drive]
        if absent:
            raise ConfigError(f"--drives: expected some of {', '.join(indices_by_drive)}; got {absent[0]!r}")
        opened = opened.select([int(index) for drive in drives for index in indices_by_drive[drive]])
    if dry_run:
        count = len(opened.drives())
        what = f"the poses of {count_of(len(opened), 'sweep')} of {count_of(count, 'drive')}"
        would_write(what, folder, from_data(opened))
        return 0
    known_drives = {drive.name: drive for drive in (_known(reading, data, truth) if truth else opened).drives()}
    with held(folder):
        tracks = odometry(
            opened,
            folder,
            sweeps=SweepSettings(cloud=cloud, deskew=deskew, turning=turning, step_s=step_s),
            settings=OdometrySettings(most_m=reach_m),
            backward=backward,
            overwrite=overwrite,
            bulk=jobs.options("placing drives"),
        )
        write_odometry(folder, tracks, title=f"Odometry of {name}", picture=picture)
        accuracies = {
            track.name: against_drive(track.table, known_drives[track.name])
            for track in tracks
            if track.name in known_drives
        }
        if truth is not None and not any(accuracies.values()):
            raise ConfigError(f"--truth: expected poses of three frames or more of these drives, found none in {truth}")
        if any(accuracies.values()):
            trees = {key: accuracy_json(value) for key, value in accuracies.items() if value is not None}
            write_json(folder / "accuracy.json", trees)
    for track in tracks:
        drift = track.drift
        known_drift = "drift not known"
        if drift is not None:
            known_drift = f"expect {drift.place_percent:.2f} % and {drift.turn_deg_per_100m:.3f} degrees a 100 m"
        clock = "" if track.cpu_ms is None else f", {track.cpu_ms:.0f} ms of CPU a sweep"
        print(
            f"{track.name}: {count_of(len(track.table), 'sweep', spec=',')}, {track.way_m:,.1f} m, {known_drift}{clock}"
        )
        print("".join(f"  note: {finding}\n" for finding in track.findings), end="")
        if accuracies.get(track.name) is not None:
            print("".join(f"  {line}\n" for line in str(accuracies[track.name]).splitlines()), end="")
    print(f"poses: {(folder / 'poses').resolve()}\nreport: {(folder / 'odometry.html').resolve()}")
    return 0


def _known(reading: ReadingFlags, data: Path, truth: Path) -> "Dataset":
    """The data set with the known poses."""
    return reading.open(data, poses=truth)

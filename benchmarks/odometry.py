"""Odometry against the truth and on real sweeps; deskewing and labels moved in time against the truth."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from _report import ROOT, SHARED_REAL, Part, part_parser, progress, run_parts
from jaxtyping import Float

from farfield.datasets import open_dataset
from farfield.datasets.maps import LabelsAt
from farfield.frame import Annotation, Frame
from farfield.geometry.boxes import BOX_MARGIN_M, count_points_in_boxes, points_in_boxes
from farfield.geometry.poses import invert
from farfield.odometry.drift import differences, way_m
from farfield.odometry.drives import DriveSweeps, OdometryTrack, SweepSettings, Turning, odometry, register_sweeps
from farfield.odometry.odometry import OdometrySettings
from farfield.simulation import simulate_sequence
from farfield.simulation.labels import full_boxes
from farfield.simulation.presets import find_preset
from farfield.simulation.recording.raw.measure import RawFrame, ego_poses
from farfield.simulation.rigs.cirrus import CirrusFrame
from farfield.simulation.rigs.drive import SimulatedDrive, drive_of
from farfield.sync import PoseTrack, deskew, deskew_boxes

# Simulated drives of 300 m, ten sweeps a second, in Cirrus' and K-Radar's layout: data without poses, and the truth.

STRIDE_S = 0.1


@dataclass(frozen=True)
class Simulated:
    """One drive.

    Args:
        preset: Which rig.
        road: Which road.
        seed: Which world.
        frames: So many sweeps see 300 m.
    """

    preset: str
    road: str
    seed: int
    frames: int

    def frame(self, index: int) -> Any:
        """Frame ``index``, with its true pose; nothing is simulated before it is read."""
        from farfield.simulation import simulate_frame

        cirrus = self.preset == "cirrus-sim"
        return simulate_frame(
            self.preset,
            seed=self.seed,
            sequence=0,
            index=index,
            sensors=("gaussian", "uniform") if cirrus else ("os2-64",),
            road=self.road,
            stride_s=STRIDE_S,
            duration_s=60.0,
            weather="normal",
            uniform_offset_ms=(0.0, 0.0),
        )

    def folder(self, root: Path) -> Path:
        """Where its data set stands."""
        return root / f"{self.preset}-{self.road}"

    def truth(self) -> Float[np.ndarray, "n 4 4"]:
        """Pose of every sweep."""
        return np.stack([self.frame(index).world_T_frame for index in range(self.frames)])


DRIVES = (
    Simulated("cirrus-sim", "highway", 0, 140),
    Simulated("kradar-sim", "highway", 0, 180),
    Simulated("cirrus-sim", "urban", 3, 300),
    Simulated("kradar-sim", "urban", 3, 376),
    Simulated("cirrus-sim", "mountain", 0, 332),
    Simulated("kradar-sim", "mountain", 0, 328),
    Simulated("cirrus-sim", "suburban", 0, 280),
    Simulated("kradar-sim", "suburban", 0, 276),
)


def write(drive: Simulated, root: Path, indices: Sequence[int]) -> None:
    """Write sweeps that are not there; no boxes."""
    from farfield.datasets.cirrus import CirrusWriter
    from farfield.datasets.kradar import KRadarWriter

    folder = drive.folder(root)
    writer = CirrusWriter(folder) if drive.preset == "cirrus-sim" else KRadarWriter(folder)
    for index in indices:
        frame = replace(drive.frame(index), load_annotation=None)
        if not all(path.exists() for path in writer.paths(frame).values()):
            writer.write(frame)
    if isinstance(writer, KRadarWriter):
        writer.finish()


CLOUDS = {"cirrus-sim": ("gaussian", "uniform"), "kradar-sim": ("os2-64",)}
TIMED, START = 20, 5
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
    middle = [sweeps[len(sweeps) // 2 + number] for number in range(min(TIMED, len(sweeps) // 2))]
    read = time.process_time()
    register_sweeps(middle[:START])  # whatever is compiled at the first call is compiled here
    warm = time.process_time()
    register_sweeps(middle[:START])
    started = time.process_time()
    register_sweeps(middle)  # begins like the first
    done = time.process_time()
    return 1e3 * (done - started - (started - warm)) / (len(middle) - START), 1e3 * (read - began) / len(middle)


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


def run_drives(arguments: Sequence[str]) -> None:
    """Odometry on simulated drives of 300 m against the truth, its time, and four of KITTI's raw sweeps.

        python benchmarks/odometry.py drives [FOLDER] --every 2

    FOLDER takes the drives (10 GB at ten sweeps a second) and what odometry writes beside them; what
    stands there is not done again.
    """
    parser = part_parser(run_drives.__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=ROOT / "data" / "drives")
    parser.add_argument("--sweeps", type=int, help="the first so many of one drive, in place of all")
    parser.add_argument("--every", type=int, default=1, help="take every n-th sweep of ten a second")
    parser.add_argument("--backward", default="gaussian", help="clouds whose drift is stated too, by commas")
    given = parser.parse_args(arguments)
    print(f"simulated drives, a sweep each {given.every * STRIDE_S:.1f} s\n\n{HEAD}", flush=True)
    drives = sorted(DRIVES, key=lambda drive: drive.road)
    if given.sweeps:
        drives = [replace(drives[0], frames=given.sweeps)]
    for drive in drives:
        write(drive, given.folder, range(0, drive.frames, given.every))
        for cloud in CLOUDS[drive.preset]:
            backward = cloud in given.backward.split(",")
            print(one(drive, cloud, given.folder, given.every, backward=backward), flush=True)
    print()
    print("\n".join(kitti() if (SHARED_REAL / KITTI).is_dir() else ["KITTI raw: not here"]))


ROADS = ("urban", "suburban", "alleyway", "highway")
MOMENTS = 10
LEAST_POINTS = 10
STANDS_M_S = 0.3
FAST_M_S = 15.0


class Corrected(CirrusFrame):
    """The same sweep as the simulator itself corrects it."""

    def __init__(self, drive: SimulatedDrive, number: int, time_s: float) -> None:
        super().__init__(drive, number)
        self.time_s = time_s


@dataclass
class Errors:
    """Root mean square errors of the points of each box, in metres."""

    raw: list[float]
    ego: list[float]
    both: list[float]


def moments(drive: SimulatedDrive) -> list[tuple[float, float, float, float]]:
    """Moments at which the car turns and accelerates most: time, speed, turn in degrees a second, acceleration."""
    time_s = np.arange(1.0, drive.segment.duration_s - 1.0, 0.25)
    step = 0.2
    before, now, after = (ego_poses(drive, time_s + d) for d in (-step, 0.0, step))
    speed = np.linalg.norm(after[:, :3, 3] - before[:, :3, 3], axis=1) / (2 * step)
    push = np.linalg.norm(after[:, :2, 3] - 2 * now[:, :2, 3] + before[:, :2, 3], axis=1) / step**2
    heading = [np.arctan2(poses[:, 1, 0], poses[:, 0, 0]) for poses in (before, after)]
    turn = np.degrees(np.angle(np.exp(1j * (heading[1] - heading[0])))) / (2 * step)
    best, chosen = np.argsort(-(np.abs(turn) / 10 + push / 2) * np.minimum(speed, 10.0)), []
    for row in best:
        if all(abs(time_s[row] - time_s[other]) >= 1.0 for other in chosen):
            chosen.append(int(row))
        if len(chosen) == MOMENTS:
            break
    return [(float(time_s[r]), float(speed[r]), float(turn[r]), float(push[r])) for r in chosen]


def errors_of_sweep(drive: SimulatedDrive, number: int, time_s: float, found: dict[str, Errors]) -> int:
    """Add the errors within each road user's points; returns how many points kept their place."""
    raw, right = RawFrame(drive, number, time_s), Corrected(drive, number, time_s)
    mount = drive.mounting.ego_T_lidar
    knots_s = np.arange(np.floor((time_s - 0.2) * 10) / 10, time_s + 0.25, 0.1)
    track = PoseTrack(np.rint(knots_s * 1e9).astype(np.int64), ego_poses(drive, knots_s) @ mount)
    swept = raw.gaussian
    measured, since_s = swept.cloud.points_m.astype(np.float64), swept.cloud.extra["time_ns"] / 1e9
    times_ns = np.rint((time_s + since_s) * 1e9).astype(np.int64)
    done = deskew(measured, times_ns, track, reference_ns=round(time_s * 1e9))
    window, lidar_T_world = raw.window, invert(raw.world_T_lidar)
    boxes = full_boxes(window.actors, window.bottom_m, window.yaw_rad, window.velocity_m_s, lidar_T_world)
    own = deskew_boxes(done.points_m, times_ns, boxes, reference_ns=round(time_s * 1e9))
    velocity = window.velocity_m_s @ raw.world_T_lidar[:3, :3]
    for actor in np.unique(swept.actor[swept.actor >= 0]):
        rows = np.flatnonzero(swept.actor == actor)
        if len(rows) < LEAST_POINTS:
            continue
        way = since_s[rows, None] * velocity[actor]
        true = right.gaussian.cloud.points_m[rows] - way
        stands = np.linalg.norm(velocity[actor]) < STANDS_M_S
        into = found["standing" if stands else "moving"]
        for values, points in (
            (into.raw, measured[rows]),
            (into.ego, done.points_m[rows]),
            (into.both, own[rows]),
        ):
            values.append(float(np.sqrt(np.mean(np.sum((points - true) ** 2, axis=1)))))
    return done.left


def deskewing(moments_each: int, roads: Sequence[str]) -> list[str]:
    """Errors of points before and after, by road and by what moves."""
    lines = ["deskewing: root mean square error of the points of each road user, mean over road users, m", ""]
    lines.append(
        "road       sweeps  speed m/s  turn deg/s  accel. m/s^2  road users     boxes   raw    ego motion  and its own"
    )
    total = {kind: Errors([], [], []) for kind in ("standing", "moving")}
    for road in roads:
        drive = drive_of(find_preset("cirrus-sim", road=road), 0, 0)
        found = {kind: Errors([], [], []) for kind in total}
        chosen = moments(drive)[:moments_each]
        left = sum(
            errors_of_sweep(drive, number, chosen[number][0], found) for number in progress(range(len(chosen)), road)
        )
        assert left == 0, "points without a pose"
        speed, turn, push = (np.mean([abs(row[k]) for row in chosen]) for k in (1, 2, 3))
        for kind, errors in found.items():
            for name in ("raw", "ego", "both"):
                getattr(total[kind], name).extend(getattr(errors, name))
            head = f"{road:<11}{len(chosen):>6}{speed:>11.1f}{turn:>12.1f}{push:>14.2f}"
            lines.append(f"{head}  {kind:<12}{_means(errors)}")
    for kind, errors in total.items():
        lines.append(f"{'all':<56}{kind:<12}{_means(errors)}")
    lines += [
        "",
        "At least halved for what stands, by the car's motion: "
        + _halved(total["standing"].raw, total["standing"].ego),
        "At least halved for what moves, with its own motion: " + _halved(total["moving"].raw, total["moving"].both),
        "",
        "Error against where the point lies on its body at the sweep's middle. Poses every 0.1 s, on SE(3) in between.",
        "Ego motion: farfield.sync.deskew. And its own: deskew_boxes too, by the true boxes and velocities. Who goes",
        "along with the car is smeared less by a raw sweep than by one corrected for the car's motion alone.",
    ]
    return lines


def _halved(before: list[float], after: list[float]) -> str:
    share = float(np.mean(after) / np.mean(before))
    each = np.array(after) <= 0.5 * np.array(before)
    return f"{'yes' if share <= 0.5 else 'no'}, {share:.1%} of the error is left; in {each.mean():.0%} of the boxes"


def _means(errors: Errors) -> str:
    if not errors.raw:
        return f"{0:>8}"
    raw, ego, both = (float(np.mean(values)) for values in (errors.raw, errors.ego, errors.both))
    return f"{len(errors.raw):>8}{raw:>7.3f}{ego:>8.3f} ({ego / raw:>4.2f}){both:>8.3f} ({both / raw:>4.2f})"


def without_velocities(frame: Frame) -> Frame:
    """The frame as a file of Cirrus has it: boxes with identities, without velocities."""
    annotation = frame.annotation
    assert annotation is not None
    plain = {
        "boxes": annotation.boxes.replace(velocity_m_s=None),
        "details": annotation.details,
        "extent": annotation.extent,
    }
    return replace(frame, load_annotation=partial(Annotation, **plain))


def moved_labels(frames: int, sequences: int) -> list[str]:
    """Points of fast cars in their boxes: of the annotated sweep, and of the uniform one before and after."""
    lines = ["", f"labels at the uniform sweep's time: cars faster than {FAST_M_S:g} m/s over ground, highway", ""]
    title = "stride s  what the boxes tell      later ms   cars  uniform points   in boxes before  after      "
    lines.append(title + "cars with 80 %: before  after")
    for stride_s in (0.1, 0.5):
        plain, late = [], []
        for sequence in progress(range(sequences), f"frames every {stride_s:g} s"):
            plain += simulate_sequence(
                "cirrus-sim-highway",
                sequence=sequence,
                frames=frames,
                stride_s=stride_s,
                sensors=("gaussian", "uniform"),
            )
        for told, strip in (("velocities", False), ("identities and poses", True)):
            seen = [without_velocities(frame) if strip else frame for frame in plain]
            late = [
                LabelsAt("uniform")(frame, lambda k, row=row, seen=seen: _before(seen, row, k))
                for row, frame in enumerate(seen)
            ]
            lines.append(f"{stride_s:>8.1f}  {told:<22}{_counted(plain, late)}")
    lines += [
        "",
        "Uniform points: those that the simulator knows to lie on the car. In boxes: within the annotated box,",
        f"{100 * BOX_MARGIN_M:g} cm wider on each side; the road's points count there too. First frames of a sequence,",
        "where identities tell no velocity, are left out. The same of the annotated Gaussian sweep, for comparison:",
        *_gaussian_share(plain),
    ]
    return lines


def _before(frames: list[Frame], row: int, k: int) -> Frame | None:
    return frames[row - k] if row >= k and frames[row - k].sequence == frames[row].sequence else None


def _fast(frame: Frame) -> np.ndarray:
    annotation = frame.annotation
    assert annotation is not None
    assert annotation.boxes.velocity_m_s is not None
    fast = np.linalg.norm(annotation.boxes.velocity_m_s, axis=1) > FAST_M_S
    return fast & (annotation.boxes.label == "vehicle") & (annotation.details["point_count_uniform"] >= 5)


def _counted(plain: list[Frame], late: list[Frame]) -> str:
    on: list[int] = []
    inside: dict[str, list[int]] = {"before": [], "after": []}
    delays = []
    for row, (frame, moved) in enumerate(zip(plain, late, strict=True)):
        if _before(plain, row, 1) is None:
            continue
        fast, points = _fast(frame), frame.clouds["uniform"].points_m
        for name, seen in (("before", frame.annotation), ("after", moved.annotation)):
            assert seen is not None
            inside[name] += count_points_in_boxes(points, seen.boxes[fast], margin_m=BOX_MARGIN_M).tolist()
        assert frame.annotation is not None
        on += frame.annotation.details["point_count_uniform"][fast].tolist()
        delays.append(((frame.time_ns_of("uniform") or 0) - (frame.time_ns or 0)) / 1e6)
    share = {name: f"{sum(counts)} ({sum(counts) / sum(on):.0%})" for name, counts in inside.items()}
    most = {name: f"{np.mean(np.array(counts) >= 0.8 * np.array(on)):.0%}" for name, counts in inside.items()}
    return (
        f"{np.mean(delays):>9.1f}{len(on):>7}{sum(on):>16}{share['before']:>18}{share['after']:>13}"
        f"{most['before']:>17}{most['after']:>7}"
    )


def _gaussian_share(plain: list[Frame]) -> list[str]:
    on = inside = 0
    for frame in plain:
        fast = _fast(frame)
        assert frame.annotation is not None
        on += int(frame.annotation.details["point_count_gaussian"][fast].sum())
        found = points_in_boxes(frame.clouds["gaussian"].points_m, frame.annotation.boxes[fast], margin_m=BOX_MARGIN_M)
        inside += sum(map(len, found))
    return [f"{inside} of {on} ({inside / on:.0%})"]


def run_deskewing(arguments: Sequence[str]) -> None:
    """Deskewing against the simulator's truth, and labels moved to the time of the other sweep.

    First: sweeps of a Luminar whose points stay in the sensor's coordinates of their own time, at moments at which the
    simulated car turns and accelerates; corrected by ``farfield.sync.deskew`` with poses every 0.1 s, and compared with
    where each point lies on its body at the sweep's middle. Second: simulated Cirrus frames, whose uniform sweep is up
    to 0.1 s later than the annotated one; points of fast cars in their boxes before and after the map ``labels_at``.

        python benchmarks/odometry.py deskewing [--moments 10] [--frames 10] [--sequences 4]
    """
    parser = part_parser(run_deskewing.__doc__)
    parser.add_argument("--moments", type=int, default=MOMENTS, help="sweeps a road")
    parser.add_argument("--frames", type=int, default=10, help="frames a sequence")
    parser.add_argument("--sequences", type=int, default=4)
    parser.add_argument("--roads", nargs="+", choices=ROADS, default=list(ROADS))
    options = parser.parse_args(arguments)
    print("\n".join(deskewing(options.moments, options.roads)))
    print("\n".join(moved_labels(options.frames, options.sequences)))


if __name__ == "__main__":
    raise SystemExit(
        run_parts(
            __doc__,
            {
                "drives": Part(run_drives, "TMP/drives --sweeps 16 --every 2 --backward none"),
                "deskewing": Part(run_deskewing, "--moments 1 --roads urban --frames 2 --sequences 1"),
            },
        )
    )

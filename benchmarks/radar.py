"""Simulated radars beside real ones: the tensor, echoes by range, a turning radar; real View-of-Delft frames."""

import resource
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from _report import SHARED_REAL, MissingError, Part, part_parser, run_parts
from matplotlib.collections import LineCollection
from rich.progress import track

from farfield.api import open_dataset
from farfield.datasets.radiate import Radiate
from farfield.datasets.view_of_delft.reader import radar_velocity_m_s, read_radar
from farfield.figures.birds_eye import draw_birdseye, draw_boxes
from farfield.figures.camera import box_lines
from farfield.figures.style import ANNOTATED, INK, MUTED, figure_bytes, house_style, new_figure
from farfield.frame import Boxes, Cloud, Frame
from farfield.geometry.boxes import count_points_in_boxes
from farfield.geometry.poses import pose_from_yaw, transform_points
from farfield.inspection.statistics.radar import map_statistics
from farfield.radar.products import polar3d_from_moments, zyx_cube
from farfield.radar.turning import CELL_M
from farfield.simulation import simulate_frame
from farfield.simulation.presets import find_preset
from farfield.simulation.radar.model import RadarModel
from farfield.simulation.radar.points import Scatterers, cell_snr
from farfield.simulation.radar.synthesis import draw_noise, form_moments, form_tensor, synthesise
from farfield.simulation.rigs.drive import drive_of
from farfield.simulation.rigs.kradar import KRadarFrame
from farfield.simulation.world.scene import ROADS, WorldScene
from farfield.vocabulary.published_tables import RAISED_SHARES

COUNTS = (2_000, 10_000, 30_000)
TENSOR_QUANTILES = (5, 25, 50, 75, 95)
TIME_LIMIT_S, MEMORY_LIMIT_GB = 1.0, 2.5
STRONG_M = (25.0, 33.5, 42.1, 51.8, 60.2)
MODEL = RadarModel()


def peak_gb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def clutter(count: int, rng: np.random.Generator) -> Scatterers:
    """Scatterers all over the field of view, 10 dB a cell at 50 m with 6 dB of spread, one in a hundred 25 dB above."""
    range_m, azimuth = rng.uniform(3, 115, count), np.radians(rng.uniform(-53, 53, count))
    elevation, speed = np.radians(rng.uniform(-10, 10, count)), rng.uniform(-20, 0, count)
    level_db = 10 + rng.normal(0, 6, count) + 40 * np.log10(50 / range_m) + np.where(rng.random(count) < 0.01, 25, 0)
    x, y, z = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)
    unit = Scatterers.of(range_m[:, None] * np.stack([x, y, z], axis=1), speed, np.ones(count))
    return replace(unit, rcs_m2=10 ** (level_db / 10) / cell_snr(unit, MODEL))


def best_times(count: int, output: str, repeats: int) -> dict[str, float]:
    """Seconds of each step of the fastest repeat."""
    rng = np.random.default_rng(count)
    seen, phase = clutter(count, rng), rng.uniform(0, 2 * np.pi, count)
    best: dict[str, float] = {}
    for _ in range(repeats):
        start = time.perf_counter()
        noise = draw_noise(MODEL, rng)
        drawn = time.perf_counter()
        channels = synthesise(seen, MODEL, phase, noise)
        added = time.perf_counter()
        form_tensor(channels, MODEL) if output == "tensor" else form_moments(channels, MODEL)
        end = time.perf_counter()
        steps = {"total": end - start, "noise": drawn - start, "echoes": added - drawn, "beams": end - added}
        best = steps if not best or steps["total"] < best["total"] else best
    return best


def strong_objects(rng: np.random.Generator) -> tuple[Scatterers, np.ndarray]:
    """Cars' worth of scatterers whose peaks stand 8.6 dB over the floor of the map, as the real frame's strongest."""
    quiet = replace(MODEL, leakage_db=(-40.0,) * len(MODEL.leakage_db))
    parts, phases = [], []
    for distance in STRONG_M:
        n = 30
        range_m, azimuth = distance + rng.uniform(-0.2, 0.3, n), np.radians(1 + rng.uniform(-1, 1, n))
        tilt = np.radians(rng.uniform(-1.5, 0.5, n))
        place = np.stack([np.cos(tilt) * np.cos(azimuth), np.cos(tilt) * np.sin(azimuth), np.sin(tilt)], axis=1)
        one = Scatterers.of(range_m[:, None] * place, np.full(n, 1.23), np.full(n, 1.0))
        phase = rng.uniform(0, 2 * np.pi, n)
        alone = form_moments(synthesise(one, quiet, phase), quiet).mean_power.mean(axis=1).max() / MODEL.noise_floor
        parts.append(replace(one, rcs_m2=one.rcs_m2 * (10**0.86 - 1) / alone))
        phases.append(phase)
    return Scatterers.join(parts), np.concatenate(phases)


def statistics() -> str:
    """The map of strong objects in noise beside the real frame's figures, and the control of independent noise."""
    rng = np.random.default_rng(7)
    seen, phase = strong_objects(rng)
    tensor = form_tensor(synthesise(seen, MODEL, phase, draw_noise(MODEL, rng)), MODEL)
    level = 10 * np.log10(tensor.mean(axis=(0, 2)))
    floor = level[150:220]
    above = level - np.median(floor)
    rows = [at - 2 + above[at - 2 : at + 3].max(axis=1).argmax() for at in np.int64(STRONG_M) * 256 // 118]
    quantiles = np.mean([np.percentile(above[row], TENSOR_QUANTILES) for row in rows], axis=0)
    widths = [np.sum(above[row] > above[row].max() - 3) for row in rows]
    beside = [above[row + step, above[row].argmax()] for row in rows for step in (-1, 1)]
    axis = MODEL.axes.range_m
    by_range = 10 * np.log10((10 ** (level / 10)).mean(axis=1)) - np.median(floor)
    zones = [
        by_range[(axis >= low) & (axis < high)].mean() for low, high in ((1, 5), (7, 11), (110, 113.5), (114.5, 119))
    ]
    control = 10 * np.log10(rng.exponential(1.0, (64, 20, 37, 107)).mean(axis=(0, 2)))
    cells = tensor[:, 150:200]
    peak = np.mean([above[row].max() for row in rows])
    table = [
        ("range-azimuth map, mean over Doppler and elevation", "simulated", "real"),
        ("floor, 15-107 m, dB", f"{np.median(floor):.1f}", "109.1"),
        ("its deviation between cells, dB", f"{floor.std():.2f}", "0.30"),
        ("  control: independent noise in each cell, dB", f"{control.std():.2f}", ""),
        ("strong rows, quantiles 5/25/50/75/95 %, dB", "/".join(f"{q:.1f}" for q in quantiles), "0.5/0.8/1.2/2.0/4.2"),
        ("  peak (set), dB", f"{peak:.1f}", "8.6"),
        ("  width at -3 dB, cells", f"{np.mean(widths):.1f}", "3-4"),
        ("  neighbours in range, dB", f"{np.mean(beside):.1f}", "2.7, 1.6"),
        ("bin 0, dB", f"{by_range[0]:.0f}", "42 to 50"),
        ("1-5 m, dB", f"{zones[0]:.1f}", "6 to 8"),
        ("7-11 m, dB", f"{zones[1]:.1f}", "-2"),
        ("110-113.5 m, dB", f"{zones[2]:.1f}", "-5"),
        ("last 4 m, dB", f"{zones[3]:.1f}", "2 to 6"),
        ("single cells, median over mean", f"{np.median(cells) / cells.mean():.3f}", "(exponential: 0.693)"),
    ]
    lines = [f"{what:<52}{simulated:<22}{real}".rstrip() for what, simulated, real in table]
    return "\n".join(lines)


def run_tensor(arguments: Sequence[str]) -> int:
    """The radar's tensor: seconds by number of scatterers, peak memory, and its map's statistics beside a real frame's.

        python benchmarks/radar.py tensor [--repeats 5]

    Real figures: one range-azimuth map published with K-Radar (plot_tes_ra.png), digitised. Times are the best of some
    repeats, on all cores. Exit status 1 where the full tensor of 10,000 scatterers takes more than 1.0 s or memory
    passes 2.5 GB.
    """
    parser = part_parser(run_tensor.__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--counts", type=int, nargs="+", default=COUNTS, help="of scatterers")
    options = parser.parse_args(arguments)
    lines = ["seconds, best of repeats        total   noise  echoes   beams"]
    slowest = 0.0
    for output in ("mean", "tensor"):  # memory only grows: the smaller output first
        for count in options.counts:
            steps = best_times(count, output, options.repeats)
            lines.append(
                f"  {output:<6} {count:6d} scatterers    " + "  ".join(f"{value:6.3f}" for value in steps.values())
            )
            slowest = steps["total"] if (output, count) == ("tensor", 10_000) else slowest
        lines.append(f"  peak memory of the process so far: {peak_gb():.2f} GB")
    rng = np.random.default_rng(0)
    reduced = form_moments(draw_noise(MODEL, rng), MODEL)
    for name, make in (
        ("polar map", lambda: polar3d_from_moments(reduced.mean_power_63, reduced.velocity_moment)),
        ("cube", lambda: zyx_cube(reduced.mean_power)),
    ):
        make()
        start = time.perf_counter()
        make()
        lines.append(f"  {name} from the moments: {time.perf_counter() - start:.3f} s")
    memory = peak_gb()
    print("\n".join([*lines, f"  peak memory at the end: {memory:.2f} GB", "", statistics()]))
    return int(slowest > TIME_LIMIT_S or memory > MEMORY_LIMIT_GB)


MARGIN_M = 0.5  # the radar measures a direction to about a degree: half a metre at 30 m
STILL_M_S = 0.5
COLOURS_TO_M_S = 3.0
WINDOW_M = (0.0, 60.0, -25.0, 25.0)
VELOCITY = "v_r_compensated_m_s"


def outside_m(points_m: np.ndarray, box: Boxes) -> np.ndarray:
    """Distance of points from the surface of one box in three dimensions, 0 inside, shape (n,)."""
    turn = pose_from_yaw(float(-box.yaw_rad[0]))[:3, :3]
    local_m = np.abs((points_m - box.centre_m[0]) @ turn.T)
    return np.linalg.norm(np.maximum(local_m - box.size_m[0] / 2, 0.0), axis=1)


def near_any(points_m: np.ndarray, boxes: Boxes, margin_m: float) -> np.ndarray:
    """Which points are inside or within a margin of any box, shape (n,)."""
    near = np.zeros(len(points_m), dtype=bool)
    for index in range(len(boxes)):
        near |= outside_m(points_m, boxes[index : index + 1]) <= margin_m
    return near


def annotated_area(frame: Frame, cloud: Cloud) -> Cloud:
    """The points where objects are annotated: in the camera's picture and within 50 m."""
    seen = frame.cameras["camera"].project(cloud.points_m)[2]
    return cloud[seen & (np.linalg.norm(cloud.points_m, axis=1) < 50.0)]


def box_table(frame: Frame, boxes: Boxes, moving: np.ndarray) -> list[str]:
    """One line a box: range, points of both sensors, distance to the nearest radar point, velocities."""
    lidar, radar = frame.clouds["lidar"], frame.clouds["radar"]
    lines = [f"  {'label':<14} moving range_m  lidar radar nearest_m  median v_r over ground, m/s"]
    counts = count_points_in_boxes(lidar.points_m, boxes, margin_m=0.05)
    names = frame.annotation.original_label
    for index in np.argsort(np.linalg.norm(boxes.centre_m[:, :2], axis=1)):
        gap_m = outside_m(radar.points_m, boxes[index : index + 1])
        inside = gap_m <= MARGIN_M
        speed = f"{np.median(radar.extra[VELOCITY][inside]):+.2f}" if inside.any() else "-"
        range_m = np.linalg.norm(boxes.centre_m[index, :2])
        lines.append(
            f"  {names[index]:<14} {'yes' if moving[index] else 'no':<6} {range_m:7.1f} {counts[index]:6d}"
            f" {inside.sum():5d} {gap_m.min():9.2f}  {speed}"
        )
    return lines


def alternatives(frame: Frame, boxes: Boxes) -> list[str]:
    """How many radar points lie in boxes as read, and with the calibration or the axes wrong on purpose."""
    path = next(name for name in frame.metadata["files"] if "radar" in name and name.endswith(".bin"))
    own, lidar_T_radar = read_radar(Path(path)), frame.sensors["radar"].frame_T_sensor
    mirrored = np.diag([1.0, -1.0, 1.0, 1.0])
    cases = {
        "as read": lidar_T_radar,
        "left and right mirrored": lidar_T_radar @ mirrored,
        "radar taken for lidar coordinates": np.eye(4),
        "turned by +5 degrees": lidar_T_radar @ pose_from_yaw(float(np.radians(5))),
        "turned by -5 degrees": lidar_T_radar @ pose_from_yaw(float(np.radians(-5))),
    }
    moving = boxes[frame.annotation.moving]
    lines = [f"  {'':<34} points in boxes, of them faster than {STILL_M_S} m/s in moving boxes"]
    for name, motion in cases.items():
        points_m = transform_points(motion, own.points_m.astype(np.float64))  # one is a mirror, which no cloud takes
        cloud = Cloud(points_m.astype(np.float32), None, own.extra)
        fast = cloud[np.abs(cloud.extra[VELOCITY]) > STILL_M_S]
        inside = near_any(cloud.points_m, boxes, MARGIN_M).sum()
        lines.append(f"  {name:<34} {inside:6d} {near_any(fast.points_m, moving, MARGIN_M).sum():6d}")
    return lines


def summary(frame: Frame, boxes: Boxes, moving: np.ndarray) -> list[str]:
    """Shares and residuals of a frame's radar points."""
    radar = annotated_area(frame, frame.clouds["radar"])
    speed = np.abs(radar.extra[VELOCITY])
    near_moving = near_any(radar.points_m, boxes[moving], MARGIN_M)
    near_still = near_any(radar.points_m, boxes[~moving], MARGIN_M) & ~near_moving
    background = ~near_any(radar.points_m, boxes, 1.0)
    fast = speed > STILL_M_S

    def share(part: np.ndarray, of: np.ndarray) -> str:
        return f"{(part & of).sum()} of {of.sum()} ({(part & of).sum() / max(of.sum(), 1):.0%})"

    path = next(name for name in frame.metadata["files"] if "radar" in name and name.endswith(".bin"))
    own = read_radar(Path(path))
    velocity = radar_velocity_m_s(own)
    rays = own.points_m / np.linalg.norm(own.points_m, axis=1, keepdims=True)
    residual = np.abs(rays @ velocity - (own.extra[VELOCITY] - own.extra["v_r_m_s"]))
    quantiles = np.percentile(speed[background], [50, 75, 90])
    return [
        f"  clouds: {len(frame.clouds['lidar'])} lidar, {len(frame.clouds['radar'])} radar points; {len(radar)} of"
        f" the radar's in the picture within 50 m; {len(boxes)} boxes, {moving.sum()} moving",
        f"  radar points in or within {MARGIN_M} m of a moving box, faster than {STILL_M_S} m/s:"
        f" {share(fast, near_moving)}",
        f"  of those near a still box: {share(fast, near_still)}; of those more than 1 m from every box:"
        f" {share(fast, background)}",
        f"  points faster than {STILL_M_S} m/s that are near a moving box: {share(near_moving, fast)}",
        f"  |v_r over ground| more than 1 m from every box: median {quantiles[0]:.3f}, 75 % {quantiles[1]:.3f}, 90 %"
        f" {quantiles[2]:.3f} m/s",
        f"  the radar's velocity from its two velocity columns: {np.round(velocity, 3).tolist()} m/s, residual median"
        f" {np.median(residual):.4f}, largest {residual.max():.4f} m/s",
    ]


def picture(frame: Frame, boxes: Boxes, moving: np.ndarray, path: Path) -> None:
    """Draw the camera's image with everything projected, beside the same from above."""
    lidar, radar, camera = frame.clouds["lidar"], frame.clouds["radar"], frame.cameras["camera"]
    image = frame.images["camera"]
    look = {"cmap": "coolwarm", "vmin": -COLOURS_TO_M_S, "vmax": COLOURS_TO_M_S, "edgecolors": INK, "linewidths": 0.5}
    with house_style():
        figure = new_figure(20.0, 7.6)
        left, right = figure.subplots(1, 2, width_ratios=[1.35, 1.0])
        left.imshow(image)
        pixels, _, seen = camera.project(lidar.points_m)
        left.scatter(*pixels[seen][::4].T, s=2.0, c="#ffe066", linewidths=0, alpha=0.8)
        for part, colour in ((boxes[~moving], "#ced4da"), (boxes[moving], "#4dabf7")):
            left.add_collection(LineCollection(box_lines(part, camera), colors=colour, linewidths=1.3))
        pixels, _, seen = camera.project(radar.points_m)
        dots = left.scatter(*pixels[seen].T, s=34, c=radar.extra[VELOCITY][seen], **look)
        left.set(xlim=(0, image.shape[1]), ylim=(image.shape[0], 0), title=f"frame {frame.frame_id}: camera")
        left.set_axis_off()
        draw_birdseye(right, lidar, window_m=WINDOW_M, rings_m=(25.0, 50.0), point_size=0.3)
        draw_boxes(right, boxes[~moving], MUTED, line_width=1.3, order=4)
        draw_boxes(right, boxes[moving], ANNOTATED, line_width=1.6, order=5)
        right.scatter(*radar.points_m[:, :2].T, s=26, c=radar.extra[VELOCITY], zorder=6, **look)
        right.set_title("from above: lidar grey, radar coloured")
        figure.colorbar(dots, ax=right, label="radial velocity over ground (m/s), positive away", shrink=0.8)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(figure_bytes(figure, "png", dpi=110))


def run_projection(arguments: Sequence[str]) -> None:
    """Real View-of-Delft frames: do the radar, the lidar, the boxes and the camera picture fit together?

        python benchmarks/radar.py projection [REAL] [--pictures FOLDER]

    REAL is the data set's root. A picture a frame goes to a folder of your own, as the data's licence does not let us
    ship it: boxes, lidar and radar points projected into the camera's image, and the same seen from above. Points of
    the radar are coloured by their radial velocity over ground; boxes of objects marked as moving are blue, others
    grey.
    """
    parser = part_parser(run_projection.__doc__)
    parser.add_argument("real", type=Path, nargs="?", default=SHARED_REAL / "view_of_delft")
    parser.add_argument("--pictures", type=Path)
    options = parser.parse_args(arguments)
    if not options.real.is_dir():
        raise MissingError(f"no frames in {options.real.name}")
    lines = []
    for frame in open_dataset(options.real):
        assert frame.boxes is not None
        boxes, moving = frame.boxes, frame.annotation.moving
        lines += [f"\nView-of-Delft, frame {frame.frame_id}", *summary(frame, boxes, moving)]
        lines += ["", *alternatives(frame, boxes), "", *box_table(frame, boxes, moving)]
        if options.pictures:
            picture(frame, boxes, moving, options.pictures / f"view_of_delft_{frame.frame_id}.png")
    print("\n".join(lines))


def shares(high_pass_m: float, sequences: int, seed: int) -> np.ndarray:
    """Share of raised cells of the first frame of each drive by band, shape (sequences, bands)."""
    preset, model, rows = find_preset("kradar-sim"), replace(RadarModel(), high_pass_m=high_pass_m), []
    for sequence in track(range(sequences), f"{high_pass_m:g} m", transient=True):
        measured = KRadarFrame(drive_of(preset, seed, sequence), 0).measured(("mean",), model)
        power_db = 10 * np.log10(measured.moments.mean_power.mean(axis=1, dtype=np.float64))
        rows.append(list(map_statistics(power_db)["raised_share"].values()))
    return np.array(rows)


def run_near_range(arguments: Sequence[str]) -> None:
    """How echoes fall with range: simulated maps beside the one published real map, by high-pass filter.

        python benchmarks/radar.py near-range [--sequences 58] [--high-pass 0 30 60 100 200]

    Prints, by band of range, the share of cells 2 dB above the floor, in the median over drives, and in how many of the
    drives it is less than in the real map (plot_tes_ra.png, digitised; tests/datasets/test_statistics.py). A receiver
    that fits has that rank near a half in every band; one frame tells no more.
    """
    parser = part_parser(run_near_range.__doc__)
    parser.add_argument("--sequences", type=int, default=58)
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--high-pass", type=float, nargs="+", default=[0.0, 30.0, 60.0, 100.0, 200.0])
    options = parser.parse_args(arguments)
    real = np.array([float(share) for share in RAISED_SHARES.values()])
    bands = "".join(f"{band:>8}" for band in RAISED_SHARES)
    print(f"{'cells 2 dB above the floor, per cent, by metres':<48}{bands}")
    print(f"{'real, one map':<48}" + "".join(f"{100 * share:8.1f}" for share in real))
    for high_pass_m in options.high_pass:
        found = shares(high_pass_m, options.sequences, options.seed)
        name = f"high-pass filter at {high_pass_m:g} m" if high_pass_m else "no high-pass filter"
        ranks = (found < real).mean(axis=0) + 0.5 * (found == real).mean(axis=0)
        print(f"{name + ', median':<48}" + "".join(f"{100 * share:8.1f}" for share in np.median(found, axis=0)))
        away = f"  rank of the real map (mean distance from a half {np.abs(ranks - 0.5).mean():.2f})"
        print(f"{away:<48}" + "".join(f"{rank:8.2f}" for rank in ranks), flush=True)


BANDS_M = ((0, 2), (2, 5), (5, 10), (10, 20), (20, 45), (45, 80), (80, 100))
TURNING_QUANTILES = (5, 25, 50, 75, 95, 99)


def lines_of(theirs: np.ndarray, ours: np.ndarray) -> list[str]:
    """Counts (half decibels) at quantiles by range, real over simulated, and how neighbouring cells correlate."""
    lines = [
        "counts of the polar picture, real | simulated",
        f"{'metres':<10}" + "".join(f"{q:>12} %" for q in TURNING_QUANTILES),
    ]
    for near, far in BANDS_M:
        rows = slice(int(near / CELL_M), int(far / CELL_M))
        pairs = zip(*(np.percentile(each[:, rows], TURNING_QUANTILES) for each in (theirs, ours)), strict=True)
        lines.append(f"{f'{near}-{far}':<10}" + "".join(f"{f'{a:.0f} | {b:.0f}':>14}" for a, b in pairs))
    for name, axis in (("range", 1), ("azimuth", 2)):
        said = " | ".join(f"{correlation(each[:, 60:], axis):.2f}" for each in (theirs, ours))
        lines.append(f"correlation of neighbours along {name}: {said}")
    return lines


def correlation(pictures: np.ndarray, axis: int) -> float:
    count = pictures.shape[axis]
    one, other = (np.take(pictures, range(k, k + count - 1), axis) for k in (0, 1))
    return float(np.corrcoef(one.ravel(), other.ravel())[0, 1])


def passing(seeds: int) -> list[str]:
    """By road, on which side those pass that come towards: the median offset to the left of one's own course."""
    lines = ["", "vehicles that come towards, number and median offset to the left in metres: right-hand | left-hand"]
    for road in ROADS:
        said = []
        for side in ("right", "left"):
            found = np.concatenate([offsets(road, side, seed) for seed in range(seeds)])
            said.append(f"{len(found)}, {np.median(found):+.1f}" if len(found) else "none")
        lines.append(f"{road:<14} {' | '.join(said)}")
    return lines


def offsets(road: str, side: str, seed: int) -> np.ndarray:
    window = WorldScene(road, np.random.SeedSequence(seed), duration_s=6.0, traffic=side).window(3.0, reach_m=150.0)
    here = window.world_T_ego_now
    vehicles = np.array([actor.label in ("vehicle", "large_vehicle") for actor in window.actors], dtype=bool)
    offset = (window.bottom_m - here[:3, 3]) @ here[:3, :2]
    towards = vehicles & (window.velocity_m_s @ here[:3, 0] < -3.0) & (offset[:, 0] < 80.0)
    return offset[towards, 1]


def run_turning(arguments: Sequence[str]) -> None:
    """The simulated turning radar beside the nine real pictures of RADIATE's sample, and left-hand traffic.

    python benchmarks/radar.py turning [--data RADIATE] [--frames 4]
    """
    parser = part_parser(run_turning.__doc__)
    parser.add_argument("--data", type=Path, default=SHARED_REAL / "radiate", help="a folder of RADIATE's sequences")
    parser.add_argument("--frames", type=int, default=4, help="simulated turns, each of a drive of its own")
    parser.add_argument("--seeds", type=int, default=4, help="worlds of each layout")
    options = parser.parse_args(arguments)
    if not options.data.is_dir():
        raise MissingError(f"no pictures in {options.data.name}")
    real = Radiate(options.data)
    theirs = np.stack([np.asarray(real[index].radar["polar"]) for index in range(len(real))]) * 255
    frames = (simulate_frame("radiate-sim", sequence=k, index=4, sensors=("polar",)) for k in range(options.frames))
    ours = np.stack([np.asarray(frame.radar["polar"]) for frame in frames]) * 255
    said = f"{len(theirs)} real turns of one drive in fog, {len(ours)} simulated ones of as many drives"
    print("\n".join([said, *lines_of(theirs, ours), *passing(options.seeds)]))


if __name__ == "__main__":
    raise SystemExit(
        run_parts(
            __doc__,
            {
                "tensor": Part(run_tensor, "--repeats 1 --counts 500"),
                "projection": Part(run_projection),
                "near-range": Part(run_near_range, "--sequences 1 --high-pass 60"),
                "turning": Part(run_turning, "--frames 1 --seeds 1"),
            },
        )
    )

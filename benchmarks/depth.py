"""Depth maps: real sweeps thinned to fewer lines against the full ones, simulated frames against the truth."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from _report import SHARED_REAL, Part, part_parser, progress, run_parts
from jaxtyping import Float, Float32

from farfield.api import open_dataset
from farfield.depth import DepthMap, depth_map
from farfield.depth.completion import ip_basic, nearest_depth
from farfield.depth.maps import cloud_and_camera
from farfield.depth.raster import remove_hidden, sparse_depth
from farfield.depth.rings import ring_numbers
from farfield.geometry.cameras import Camera
from farfield.geometry.poses import invert
from farfield.metrics.depth import BINS_M, DepthErrors, depth_errors, errors_by_range, mean_of
from farfield.simulation.camera.cast import cast_image, place_bodies, ray_grid
from farfield.simulation.world.scene import SceneWindow

SKETCHED = ("000000", "000001", "000134")
WINDOW = (5, 7)  # in which a point of a full sweep may be hidden
DROPPED = (0, 5, 10, 20, 50)


@dataclass
class Scene:
    """A sweep before a camera, and what is true there."""

    name: str
    points: np.ndarray
    ring: np.ndarray | None
    camera: Camera
    truth: np.ndarray
    every: int


Method = Callable[[Scene], np.ndarray | DepthMap]


def true_depth(
    window: SceneWindow, camera: Camera, world_T_lidar: Float[np.ndarray, "4 4"]
) -> Float32[np.ndarray, "height width"]:
    """Depth along the optical axis of what each pixel's ray hits first, at the window's reference moment.

    Args:
        window: The scene.
        camera: The camera; its ``camera_T_lidar`` places it relative to ``world_T_lidar``.
        world_T_lidar: Pose of the frame that the camera is given in.

    Returns:
        Metres, NaN for the sky and beyond the distortion's fold, shape (height, width).

    Raises:
        MissingExtraError: If embreex is not installed.
    """
    grid = ray_grid(camera)
    picture = cast_image(place_bodies(window), grid, world_T_lidar @ invert(camera.camera_T_lidar))
    depth = picture.range_m * grid.directions[:, 2]
    depth[~np.isfinite(picture.range_m) | (grid.directions[:, 2] <= 0)] = np.nan
    return depth.reshape(grid.height, grid.width)


def sparse_of(scene: Scene) -> np.ndarray:
    return sparse_depth(scene.points, scene.camera)


def by_nearest(scene: Scene, *, tested: bool) -> np.ndarray:
    if tested:
        return depth_map(scene.points, scene.camera, method="nearest", ring=scene.ring).depth_m
    return nearest_depth(sparse_of(scene))


def by_ip_basic(scene: Scene, *, stretch: int | None) -> np.ndarray:
    return ip_basic(sparse_of(scene), stretch=scene.every if stretch is None else stretch)


def ours(scene: Scene, *, method: Any, compiled: bool | None = None) -> DepthMap:
    return depth_map(scene.points, scene.camera, method=method, ring=scene.ring, compiled=compiled)


METHODS: dict[str, Method] = {
    "nearest": partial(by_nearest, tested=False),
    "nearest, hidden points out": partial(by_nearest, tested=True),
    "IP-Basic's rules": partial(by_ip_basic, stretch=1),
    "IP-Basic's rules, stretched": partial(by_ip_basic, stretch=None),
    "delaunay": partial(ours, method="delaunay"),
    "rings": partial(ours, method="rings"),
}
BASELINES, OURS = tuple(METHODS)[:4], tuple(METHODS)[4:]


def real_scenes(real: Path) -> Iterator[tuple[str, np.ndarray, np.ndarray, Camera]]:
    for folder in ("kitti", "kitti_more"):
        for frame in open_dataset(real / folder):
            cloud, camera = cloud_and_camera(frame)
            ring = ring_numbers(cloud.points_m)
            assert ring is not None
            yield frame.frame_id, cloud.points_m, ring, camera


def thinned(name: str, points: np.ndarray, ring: np.ndarray, camera: Camera, every: int) -> Scene:
    """Every second or fourth ring, and as truth what the camera sees of the others where those have no point."""
    kept = ring % every == 0
    shown = remove_hidden(sparse_depth(points, camera), WINDOW)
    left, given = sparse_depth(points[~kept], camera), sparse_depth(points[kept], camera)
    truth = np.where(np.isinf(given) & np.isfinite(left) & (shown == left), left, np.nan)
    return Scene(name, points[kept], ring[kept], camera, truth, every)


def whole(depth: np.ndarray | DepthMap) -> tuple[np.ndarray, float]:
    """All pixels filled, the empty ones by the nearest, and the share that was filled before."""
    values = depth.depth_m if isinstance(depth, DepthMap) else depth
    known = np.isfinite(values)
    return nearest_depth(np.where(known, values, np.inf).astype(np.float64)), known


def table(scenes: list[Scene]) -> tuple[list[str], dict[str, dict[str, float]]]:
    """One row a method: means over images, coverage, milliseconds, MAE and RMSE by range over pooled pixels."""
    named = [f"{low:g}-{high:g} m" for low, high in pairwise(BINS_M)]
    head = f"  {'method':<28} {'MAE':>6} {'RMSE':>6} {'iMAE':>6} {'iRMSE':>6}  filled  cpu ms " + "".join(
        f"{name:>15}" for name in named
    )
    lines, figures = [head], {}
    for name, method in METHODS.items():
        per_image, filled, spent = [], [], []
        ranges: dict[str, DepthErrors] = {}
        method(scenes[0])  # compiled code is loaded
        for scene in progress(scenes, name):
            began = time.process_time()
            depth = method(scene)
            spent.append(1e3 * (time.process_time() - began))
            values, known = whole(depth)
            per_image.append(depth_errors(values, scene.truth))
            filled.append(depth_errors(np.where(known, values, np.nan), scene.truth).coverage)
            for key, errors in errors_by_range(values, scene.truth).items():
                ranges[key] = ranges.get(key, DepthErrors()) + errors
        mean = mean_of(per_image)
        figures[name] = mean | {"pooled_mae_mm": ranges["all"].mae_mm, "pooled_rmse_mm": ranges["all"].rmse_mm}
        parts = [ranges[key.removesuffix(" m")] for key in named]
        row = f"  {name:<28} {mean['mae_mm']:6.0f} {mean['rmse_mm']:6.0f} {mean['imae_1_km']:6.2f}"
        row += f" {mean['irmse_1_km']:6.2f} {np.mean(filled):6.1%} {np.median(spent):8.1f} "
        cells = [f"{part.mae_mm:.0f}/{part.rmse_mm:.0f}" if part.compared else "-" for part in parts]
        lines.append(row + "".join(f"{cell:>15}" for cell in cells))
    return lines, figures


def verdict(figures: dict[str, dict[str, float]], factor: float) -> str:
    """How the rings stand to the best baseline."""
    best = min(BASELINES, key=lambda name: figures[name]["mae_mm"])
    least = min(figures[name]["rmse_mm"] for name in BASELINES)
    mine = figures["rings"]
    times = figures[best]["mae_mm"] / mine["mae_mm"]
    words = f"  rings: MAE {times:.2f} times below the best baseline ({best}); wanted {factor:g}: "
    words += "met" if times >= factor else "missed"
    return words + f"; RMSE {mine['rmse_mm']:.0f} beside their least, {least:.0f}"


def uncertainty(scenes: list[Scene]) -> list[str]:
    """What is left when the pixels of the largest uncertainty are dropped, over the pixels that the map fills."""
    lines = [f"  {'dropped':<12} {'MAE':>6} {'RMSE':>6} {'oracle MAE':>11}"]
    sums: dict[int, list[tuple[float, float, float]]] = {share: [] for share in DROPPED}
    within = []
    for scene in progress(scenes, "uncertainty"):
        found = ours(scene, method="rings")
        both = np.isfinite(scene.truth) & np.isfinite(found.depth_m)
        error = np.abs(found.depth_m[both] - scene.truth[both])
        doubt = found.uncertainty_m[both]
        within.append(float(np.mean(error <= doubt)))
        order, sure = np.argsort(doubt, kind="stable"), np.sort(error)
        for share in DROPPED:
            count = round(len(error) * (1 - share / 100))
            kept = error[order[:count]]
            sums[share].append((kept.mean(), np.sqrt((kept**2).mean()), sure[:count].mean()))
    means = {share: 1e3 * np.mean(rows, axis=0) for share, rows in sums.items()}
    lines += [f"  {share:>3} %        {m[0]:6.0f} {m[1]:6.0f} {m[2]:11.0f}" for share, m in means.items()]
    cut = 1 - means[5][0] / means[0][0]
    lines.append(
        f"  dropping 5 % cuts MAE by {cut:.0%} (wanted 25 %): {'met' if cut >= 0.25 else 'missed'}; "
        f"{np.mean(within):.0%} of the errors are smaller than the uncertainty"
    )
    return lines


def speed(scenes: list[Scene], method: str) -> str:
    """Median and best processor time of a map, with numba and without."""
    words = []
    for name, compiled, limit in (("numba", True, 40), ("numpy", False, 150)):
        spent = []
        for scene in [scenes[0], *scenes]:
            began = time.process_time()
            ours(scene, method=method, compiled=compiled)
            spent.append(1e3 * (time.process_time() - began))
        middle, least = np.median(spent[1:]), min(spent[1:])
        words.append(f"{name} median {middle:.0f}, best {least:.0f} (at most {limit})")
    return ", ".join(words)


def simulated(preset: str, cloud: str, camera: str, frames: int) -> list[Scene]:
    """Frames of a preset in clear weather, one a sequence, with the exact depth."""
    from farfield.simulation.presets import find_preset
    from farfield.simulation.rigs.cirrus import CirrusFrame
    from farfield.simulation.rigs.drive import drive_of
    from farfield.simulation.rigs.kitti import KittiFrame
    from farfield.simulation.rigs.kradar import KRadarFrame
    from farfield.simulation.sequence import simulate_frame

    moments: dict[str, Any] = {"cirrus": CirrusFrame, "kitti": KittiFrame, "kradar": KRadarFrame}
    chosen, scenes = find_preset(preset, weather="normal"), []
    for sequence in progress(range(frames), preset):
        sensors = (cloud, camera)
        frame = simulate_frame(chosen, sequence=sequence, index=5, sensors=sensors)
        points, lens = cloud_and_camera(frame, cloud, camera)
        moment = moments[chosen.rig](drive_of(chosen, chosen.seed, sequence), 5)
        truth = true_depth(moment.window, frame.cameras[camera], moment.world_T_lidar)
        ring = points.extra.get("ring")
        scene = Scene(frame.sequence, points.points_m, None if ring is None else ring.astype(np.int64), lens, truth, 1)
        filled = ours(scene, method="auto").depth_m
        scene.truth = np.where(np.isfinite(filled) & (truth < BINS_M[-1]), truth, np.nan)
        scene.name += f": {np.isfinite(filled[truth < BINS_M[-1]]).mean():.0%} of the true depths to 250 m filled"
        scenes.append(scene)
    return scenes


def run_maps(arguments: Sequence[str]) -> None:
    """Depth maps: real KITTI sweeps thinned to 16 and 32 lines, and simulated frames, against the truth.

        python benchmarks/depth.py [--real FOLDER] [--frames 4]

    Thinned: every 4th or 2nd ring is the input; the truth are the points of the left-out rings that the camera sees, at
    pixels that the input does not hit. What a method leaves empty is filled by the nearest pixel before it is scored,
    so that none gains by filling only what is easy; how much it filled itself stands beside. Simulated: the ray
    caster's depth of every pixel that the rings' map fills, weather off.
    """
    parser = part_parser(run_maps.__doc__)
    parser.add_argument("--real", type=Path, default=SHARED_REAL)
    parser.add_argument("--frames", type=int, default=4)
    parser.add_argument("--presets", nargs="+", help="of the simulated ones")
    chosen = parser.parse_args(arguments)
    text = ["MAE, RMSE in mm of z; iMAE, iRMSE in 1/km; means over images, ranges pooled over pixels."]
    if (chosen.real / "kitti").is_dir():
        sweeps = list(progress(list(real_scenes(chosen.real)), "sweeps"))
        for lines, every, factor in ((16, 4, 1.4), (32, 2, 1.0)):
            scenes = [thinned(*sweep, every) for sweep in sweeps]
            sketched = [scene for scene in scenes if scene.name in SKETCHED]
            for what, some in ((f"{len(scenes)} KITTI frames", scenes), (f"frames {', '.join(SKETCHED)}", sketched)):
                pixels = sum(int(np.isfinite(scene.truth).sum()) for scene in some)
                rows, figures = table(some)
                text += ["", f"{what}, {lines} lines of 64 as input, {pixels} true pixels", *rows]
                text.append(verdict(figures, factor))
            text += ["", f"rings at {lines} lines, by uncertainty", *uncertainty(scenes)]
            text += [f"  cpu ms a frame at {lines} lines, {name}: {speed(scenes, name)}" for name in OURS]
        full = [Scene(name, points, ring, camera, np.zeros((1, 1)), 1) for name, points, ring, camera in sweeps]
        text += [f"  cpu ms a frame at 64 lines, {name}: {speed(full, name)}" for name in OURS]
    for preset, cloud, camera in (
        ("kitti-sim", "lidar", "camera"),
        ("kradar-sim", "os2-64", "cam-front"),
        ("cirrus-sim", "uniform", "camera"),
    ):
        if chosen.presets is not None and preset not in chosen.presets:
            continue
        scenes = simulated(preset, cloud, camera, chosen.frames)
        rows, _ = table(scenes)
        text += ["", f"{preset}, {cloud} in {camera}, clear weather, {len(scenes)} frames against the exact depth"]
        text += [*rows, *(f"  {scene.name}" for scene in scenes)]
        text += ["", f"{preset}, rings, by uncertainty", *uncertainty(scenes)]
    print("\n".join(text))


if __name__ == "__main__":
    raise SystemExit(
        run_parts(
            __doc__,
            {
                "maps": Part(run_maps, "--real NONE --frames 1 --presets kitti-sim"),
            },
        )
    )

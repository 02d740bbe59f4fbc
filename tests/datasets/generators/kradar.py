"""K-Radar's percentage clouds: pc5p to pc30p, eleven columns each, with labels of v2.1 and LiDAR sweeps.

Source: what was measured on its files and read in its development kit.
"""

from pathlib import Path

import numpy as np

from .dual_radar import moved
from .scene import Scene
from .truth import CloudTruth, FrameTruth, Truth, apply

NAMES = {
    "car": ("Sedan", "vehicle"),
    "truck": ("Bus or Truck", "large_vehicle"),
    "bicycle": ("Bicycle", "bicycle"),
    "pedestrian": ("Pedestrian", "pedestrian"),
}
RADAR_M = np.array([-2.54, 0.3, 0.7])
"""Where the radar stands in the axes of os2-64: labels = radar + this."""
SHARES = (5, 10, 20, 30)


def write_kradar(root: Path, *, frames: int = 3, disk: bool = False) -> Truth:
    """Sequence 1.

    Args:
        root: The folder.
        frames: How many.
        disk: Whether the sequence stands in a disk's folder, ``dir_1to20/1``.
    """
    scene = Scene(111, (0.0, 0.0, -1.7), 0.0, level=True)
    base = root / "dir_1to20" / "1" if disk else root / "1"
    labels = root / "kradar_revised_label_v2_1/KRadar_revised_visibility/1"
    for folder in (base / "os2-64", base / "info_calib", labels, *(root / f"pc{share}p/1" for share in SHARES)):
        folder.mkdir(parents=True)
    (base / "info_calib/calib_radar_lidar.txt").write_text("frame difference,x,y\n31,-2.54,0.3\n")
    (base / "description.txt").write_text("urban,night,normal\n")
    truths = []
    for number in range(frames):
        radar, lidar = 33 + number, 2 + number
        frame_T_world = np.linalg.inv(scene.world_T_ego(number * 0.1))
        points = apply(frame_T_world, scene.points(number, number * 0.1, 120, clutter=200))
        write_pcd(base / f"os2-64/os2-64_{lidar:05d}.pcd", points)
        clouds = {"os2-64": CloudTruth(world_m=np.round(points, 6))}
        for share in SHARES:
            clouds[f"pc{share}p"] = write_cells(root / f"pc{share}p/1/rpc_{radar:05d}.npy", points, share, number)
        boxes = [moved(box, frame_T_world) for box in scene.boxes(number, number * 0.1, NAMES)]
        stamp = f"timestamp={1643292946.710046 + number * 0.1:.9f}"
        lines = [
            f"* idx(tesseract_os2-64_cam-front_os1-128_cam-lrr)={radar:05d}_{lidar:05d}_00001_00001_00004, {stamp}"
        ]
        for row, box in enumerate(boxes):
            yaw = float(np.degrees(np.arctan2(box.rotation[1, 0], box.rotation[0, 0]))) + (360 if row == 2 else 0)
            numbers = [*box.centre_m, yaw, *(box.size_m / 2)]
            lines.append(", ".join(["*", "R", str(row), box.original, *(f"{value:.12f}" for value in numbers)]))
        (labels / f"{radar:05d}_{lidar:05d}.txt").write_text("\n".join(lines) + "\n")
        truths.append(FrameTruth(sequence="1", frame_id=None, time_ns=None, clouds=clouds, boxes=boxes))
    return Truth(frames=truths, tracked=False)


def write_cells(path: Path, points: np.ndarray, share: int, number: int) -> CloudTruth:
    """Radar cells: x, y, z, power / 1e13, Doppler, range, azimuth, elevation and the three indices."""
    random = np.random.default_rng([share, number])
    count = 20 + 10 * share
    range_m = random.uniform(5, 117, count)
    azimuth, elevation = np.radians(random.uniform(-53, 53, count)), np.radians(random.uniform(-18, 18, count))
    x = range_m * np.cos(elevation) * np.cos(azimuth)
    y, z = range_m * np.cos(elevation) * np.sin(azimuth), range_m * np.sin(elevation)
    power, doppler = random.uniform(0.01, 3, count), random.uniform(-1.93, 1.87, count)
    cells = [random.integers(0, size, count) for size in (256, 107, 37)]
    rows = np.column_stack([x, y, z, power, doppler, range_m, -azimuth, -elevation, *cells])
    np.save(path, rows)
    del points
    return CloudTruth(world_m=rows[:, :3], held={"Doppler": [doppler]}, radar=True, tolerance_m=1e-4)


def write_pcd(path: Path, points: np.ndarray) -> None:
    """An ASCII PCD with Ouster's nine fields."""
    count = len(points)
    lines = [
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        "FIELDS x y z intensity t reflectivity ring ambient range",
        "SIZE 4 4 4 4 4 2 1 2 4",
        "TYPE F F F F U U U U U",
        "COUNT 1 1 1 1 1 1 1 1 1",
        f"WIDTH {count}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {count}",
        "DATA ascii",
    ]
    lines += [
        f"{x:.6f} {y:.6f} {z:.6f} 100 {round(row * 1e8 / len(points))} 50 {row % 64} 7 {round(np.hypot(x, y) * 1000)}"
        for row, (x, y, z) in enumerate(points)
    ]
    path.write_text("\n".join(lines) + "\n")

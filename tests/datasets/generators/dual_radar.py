"""Dual-Radar: KITTI's labels beside a LiDAR whose y looks ahead, and two radars in axes of their own.

Source: the data set classes of adept-thu/Dual-Radar (Apache-2.0): rows a file, matrices, heading = -rotation_y.
"""

import io
from pathlib import Path

import numpy as np
from PIL import Image

from .scene import Scene, pose_of, rotation_z, strengths
from .truth import BoxTruth, CloudTruth, FrameTruth, Truth, apply

LIDAR_T_ARBE = np.array(
    [
        [0.9981128011677526, 0.05916115557244023, 0.016455814060541557, 0.07800451346438697],
        [-0.059503891609836816, 0.9980033119043885, -0.021181980812864695, 2.214080041485726],
        [0.015169806470300943, 0.022121191179620064, 0.9996402002082792, -1.6030740415943632],
        [0.0, 0.0, 0.0, 1.0],
    ]
)
LIDAR_T_ARS548 = np.array(
    [
        [0.08065852999237734, -0.996741790402992, 6.930878282577699e-05, 0.07152088247656341],
        [0.9955755395152072, 0.0805607912438313, -0.04836635228309268, 1.9685450015593613],
        [0.04820318099952712, 0.003970161005102628, 0.9988296607345621, -1.1990909999923147],
        [0.0, 0.0, 0.0, 1.0],
    ]
)
CAMERA_T_LIDAR = np.array([[1.0, 0, 0, 0.04], [0, 0, -1.0, -0.31], [0, 1.0, 0, -0.22], [0, 0, 0, 1]])
FRAME_T_LIDAR = pose_of(rotation_z(-np.pi / 2), (0.0, 0.0, 0.0))
NAMES = {
    "car": ("Car", "vehicle"),
    "truck": ("Truck", "large_vehicle"),
    "bicycle": ("Cyclist", "bicycle"),
    "pedestrian": ("Pedestrian", "pedestrian"),
}


def write_dual_radar(root: Path, *, frames: int = 4) -> Truth:
    """The training part; the world is the LiDAR's place with x ahead."""
    scene = Scene(81, (0.0, 0.0, -1.7), 0.0, level=True)
    base = root / "training"
    for sub in ("robosense", "arbe", "ars548", "calib", "image", "label"):
        (base / sub).mkdir(parents=True, exist_ok=True)
    (root / "ImageSets").mkdir()
    names = [f"{7 + 3 * number:06d}" for number in range(frames)]
    (root / "ImageSets/train.txt").write_text("\n".join(names[:-1]) + "\n")
    (root / "ImageSets/val.txt").write_text(names[-1] + "\n")
    truths = []
    for number, name in enumerate(names):
        time_s = number * 0.1
        frame_T_world = np.linalg.inv(scene.world_T_ego(time_s))
        points = apply(frame_T_world, scene.points(number, time_s, 90, clutter=83))
        points = points[points[:, 0] > 0]
        lidar = apply(np.linalg.inv(FRAME_T_LIDAR), points).astype("<f4")
        intensity = strengths(len(lidar), number)
        stamps = 1_680_000_000 % 86_400 + np.linspace(0, 0.1, len(lidar))
        np.column_stack([lidar, intensity, np.arange(len(lidar)) % 80, stamps]).astype("<f4").tofile(
            base / f"robosense/{name}.bin"
        )
        clouds = {
            "robosense": CloudTruth(
                world_m=apply(FRAME_T_LIDAR, lidar.astype(np.float64)),
                intensity=intensity / 255,
                columns={"ring": np.arange(len(lidar)) % 80.0},
            )
        }
        for salt, (radar, matrix) in enumerate({"arbe": LIDAR_T_ARBE, "ars548": LIDAR_T_ARS548}.items()):
            random = np.random.default_rng([number, salt])
            chosen = lidar[random.choice(len(lidar), 33 + 8 * salt, replace=False)].astype(np.float64)
            own = apply(np.linalg.inv(matrix), chosen).astype("<f4")
            power, doppler = random.uniform(1, 90, len(own)), random.uniform(-20, 20, len(own))
            np.column_stack([own, power, doppler]).astype("<f4").tofile(base / f"{radar}/{name}.bin")
            world = apply(FRAME_T_LIDAR, apply(matrix, own.astype(np.float64)))
            clouds[radar] = CloudTruth(
                world_m=world, held={"power": [power], "Doppler": [doppler]}, radar=True, tolerance_m=1e-3
            )
        boxes = scene.boxes(number, time_s, NAMES)
        boxes = [moved(box, frame_T_world) for box in boxes if apply(frame_T_world, box.centre_m)[0] > 0]
        (base / f"label/{name}.txt").write_text("".join(line(box, row) for row, box in enumerate(boxes)))
        write_calib(base / f"calib/{name}.txt")
        picture = io.BytesIO()
        Image.new("RGB", (32, 20), (90, 120, 40)).save(picture, format="PNG")
        (base / f"image/{name}.png").write_bytes(picture.getvalue())
        truths.append(FrameTruth(sequence=None, frame_id=None, time_ns=None, clouds=clouds, boxes=boxes))
    return Truth(frames=truths, tracked=False)


def moved(box: BoxTruth, target_T_world: np.ndarray) -> BoxTruth:
    """A box in other coordinates."""
    centre, turn = apply(target_T_world, box.centre_m), target_T_world[:3, :3] @ box.rotation
    return BoxTruth(**{**vars(box), "centre_m": centre, "rotation": turn, "velocity_m_s": None})


def line(box: BoxTruth, row: int) -> str:
    """One line: KITTI's fifteen columns, then score and track."""
    turn = FRAME_T_LIDAR[:3, :3].T @ box.rotation
    yaw = float(np.arctan2(turn[1, 0], turn[0, 0]))
    length, width, height = box.size_m
    bottom = apply(np.linalg.inv(FRAME_T_LIDAR), box.centre_m) - [0, 0, height / 2]
    x, y, z = apply(CAMERA_T_LIDAR, bottom)
    numbers = [height, width, length, x, y, z, -yaw]
    return f"{box.original} 0 0 0 1 2 9 8 " + " ".join(f"{value:.9f}" for value in numbers) + f" 0 {row + 3}\n"


def write_calib(path: Path) -> None:
    """Calibration in KITTI's form."""
    lens = "12.0 0 16.0 0 0 12.0 10.0 0 0 0 1 0"
    lines = [f"P{number}: {lens}" for number in range(4)]
    lines.append("R0_rect: 1 0 0 0 1 0 0 0 1")
    lines.append("Tr_velo_to_cam: " + " ".join(f"{value:.9f}" for value in CAMERA_T_LIDAR[:3].ravel()))
    lines.append("Tr_imu_to_velo: 1 0 0 0 0 1 0 0 0 0 1 0")
    path.write_text("\n".join(lines) + "\n")

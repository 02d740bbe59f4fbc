"""Small trees of other people's data sets for tests, written file by file as their own tools write them."""

import json
from pathlib import Path

import numpy as np
from PIL import Image

from farfield.files.clouds import write_bin

PITCH_RAD = np.radians(7.0)
LIDAR_T_RADAR_M = np.array([2.5, 0.1, -1.2])

CALIB = "\n".join(
    [
        *[f"P{i}: 700 0 600 45.0 0 700 180 -0.3 0 0 1 0.005" for i in range(4)],
        "R0_rect: 1 0 0 0 1 0 0 0 1",
        "Tr_velo_to_cam: 0 -1 0 0.02 0 0 -1 -0.06 1 0 0 -0.33",
        "Tr_imu_to_velo: 1 0 0 0 0 1 0 0 0 0 1 0",
    ]
)
LABELS = """Car 0.10 1 -1.57 100 100 200 200 1.5 1.8 4.0 2.0 1.7 20.0 -1.5707963267948966
DontCare -1 -1 -10 503 169 590 190 -1 -1 -1 -1000 -1000 -1000 -10
Cyclist 0.00 0 0.0 1 2 3 4 1.7 0.6 1.9 -3.0 1.6 30.0 0.0
"""


def write_kitti(root: Path) -> Path:
    """One frame in KITTI's object layout: a car, a cyclist and a region that nobody cares for; no image."""
    for folder in ("velodyne", "calib", "label_2"):
        (root / "training" / folder).mkdir(parents=True)
    rows = np.array([[20.3, -2.0, -0.9, 0.5], [5.0, 5.0, -1.6, 0.1]], dtype="<f4")
    (root / "training/velodyne/000007.bin").write_bytes(rows.tobytes())
    (root / "training/calib/000007.txt").write_text(CALIB + "\n")
    (root / "training/label_2/000007.txt").write_text(LABELS)
    return root


def write_kitti_tracking(root: Path) -> Path:
    """Two frames of a car in KITTI's tracking layout."""
    base = root / "training"
    for folder in ("velodyne/0003", "calib", "label_02"):
        (base / folder).mkdir(parents=True)
    for number in (0, 1):
        np.ones((2, 4), "<f4").tofile(base / f"velodyne/0003/{number:06d}.bin")
    (base / "calib/0003.txt").write_text(CALIB.replace("R0_rect:", "R_rect").replace("Tr_velo_to_cam:", "Tr_velo_cam"))
    line = LABELS.splitlines()[0]
    (base / "label_02/0003.txt").write_text(f"0 5 {line}\n1 5 {line}\n1 6 {line}\n")
    return root


def calib_text(offset_m: np.ndarray | None = None) -> str:
    """A camera that looks down by seven degrees from the lidar's place, of a sensor that stands at ``offset_m``."""
    sin, cos = np.sin(PITCH_RAD), np.cos(PITCH_RAD)
    turn = np.array([[0.0, -1.0, 0.0], [-sin, 0.0, -cos], [cos, 0.0, -sin]])
    motion = np.column_stack([turn, turn @ (np.zeros(3) if offset_m is None else offset_m)])
    camera = "\n".join(f"P{i}: 1000 0 500 0 0 1000 300 0 0 0 1 0" for i in range(4))
    numbers = " ".join(repr(float(value)) for value in motion.ravel())
    return f"{camera}\nR0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: {numbers}\nTr_imu_to_velo:"


def write_tree(tree: Path, cloud: np.ndarray, offset_m: np.ndarray, label: str | None, frame: str = "00001") -> None:
    for name in ("velodyne", "label_2", "calib", "pose"):
        (tree / name).mkdir(parents=True, exist_ok=True)
    write_bin(tree / "velodyne" / f"{frame}.bin", cloud.astype(np.float32))
    (tree / "calib" / f"{frame}.txt").write_text(calib_text(offset_m))
    if label is not None:
        (tree / "label_2" / f"{frame}.txt").write_text(label)
    turn = [0, 0, 1, -1, 0, 0, 0, -1, 0]  # camera x, y, z ahead and down to odometry x, y, z
    pose = [*turn[:3], 5.0, *turn[3:6], 7.0, *turn[6:], 1.3, 0, 0, 0, 1]
    names = ("odomToCamera", "mapToCamera", "UTMToCamera")
    (tree / "pose" / f"{frame}.json").write_text("\n".join(json.dumps({name: pose}) for name in names))


def car_label(moving: int = 1) -> str:
    """A car 20 m ahead on the level of the lidar, its length across the road."""
    sin, cos = np.sin(PITCH_RAD), np.cos(PITCH_RAD)
    return f"Car {moving} 0 0 0 0 1 1 1.5 1.8 4.2 0 {-20 * sin} {20 * cos} 0 1\n"


RADAR_ROWS = np.array(
    [  # x, y, z, RCS, v_r, v_r compensated, scan; the radar drives at 2, 0.5, 0 m/s, all but the last stand still
        [10, 0, 0, -30, -2.0, 0.0, 0],
        [0, 10, 0, 0, -0.5, 0.0, 0],
        [0, 0, 4, 30, 0.0, 0.0, 0],
        [3, 4, 0, 60, 1.0, 2.6, 0],
        [5, 0, 0, 90, 9.0, 9.0, -2],
    ]
)


def write_delft(root: Path) -> Path:
    """One frame of View-of-Delft: a lidar, one radar scan and one labelled car; no image."""
    lidar = np.array([[10.0, 1.0, 0.5, 51.0], [20.0, 0.0, 0.75, 255.0]])
    write_tree(root / "lidar" / "training", lidar, np.zeros(3), car_label())
    write_tree(root / "radar" / "training", RADAR_ROWS, LIDAR_T_RADAR_M, None)
    return root


SECONDS = 1574859771


def write_sequence(folder: Path) -> Path:
    """Two turns of the radar; sensors are stamped 0.25 s before the radar's picture that they belong to."""
    for name in ("Navtech_Polar", "Navtech_Cartesian", "velo_lidar", "zed_left", "annotations"):
        (folder / name).mkdir(parents=True)
    for number in (1, 2):
        polar, cartesian = np.zeros((576, 400), np.uint8), np.zeros((1152, 1152), np.uint8)
        polar[100, 0], polar[200, 99], polar[300, 300] = 255, 102, 51  # ahead, to the right, to the left
        cartesian[475, 576] = 255
        Image.fromarray(polar).save(folder / "Navtech_Polar" / f"{number:06d}.png")
        Image.fromarray(cartesian).save(folder / "Navtech_Cartesian" / f"{number:06d}.png")
        Image.fromarray(np.zeros((4, 6, 3), np.uint8)).save(folder / "zed_left" / f"{number:06d}.png")
    radar = [f"Frame: 00000{n} Time: {SECONDS}.{n * 250_000_000}" for n in (1, 2)]
    (folder / "Navtech_Polar.txt").write_text("\n".join(radar) + "\n")
    (folder / "Navtech_Cartesian.txt").write_text("\n".join(radar) + "\n")
    # lidar 7 fits the first turn; 8 only the radar's stamp itself, not the moment it shows
    (folder / "velo_lidar.txt").write_text(
        f"Frame: 000007 Time: {SECONDS}.10000000\nFrame: 000008 Time: {SECONDS}.250000000\n"
    )
    (folder / "velo_lidar" / "000007.csv").write_text("3,10,-1,51,0\n-4,-20,2,255,31\n")
    (folder / "zed_left.txt").write_text(f"Frame: 000001 Time: {SECONDS}.249000000\n")
    (folder / "meta.json").write_text(json.dumps({"name": "fog_6_0", "type": "fog", "set": "test"}))
    objects = [
        # 40 cells ahead of the radar and 20 to its right, 30 long, 12 wide, oncoming
        {"id": 1, "class_name": "bus", "bboxes": [{"position": [589.5, 520.5, 12, 30], "rotation": 180}, []]},
        # 60 cells behind and 10 to the left, turning off to the right
        {"id": 9, "class_name": "van", "bboxes": [[], {"position": [560.5, 622.5, 10, 26], "rotation": 274}]},
    ]
    (folder / "annotations" / "annotations.json").write_text(json.dumps(objects))
    return folder


def write_argoverse2(root: Path) -> Path:
    """One sweep of an Argoverse 2 log with one annotated vehicle, the vehicle's pose and a camera's calibration."""
    from pyarrow import feather, table

    time_ns = 315966265259836000
    log = root / "7fab2350-7eaf-3b7e-a39d-6937a4c1bede"
    turn = {"qw": [1.0], "qx": [0.0], "qy": [0.0], "qz": [0.0]}
    place = {"tx_m": [10.0], "ty_m": [2.0], "tz_m": [0.5]}
    box = {"length_m": [4.0], "width_m": [2.0], "height_m": [1.5]}
    points = {name: np.array([10.0, 20.0], dtype=np.float16) for name in "xyz"}
    points |= {"intensity": np.array([0, 255], np.uint8), "laser_number": np.array([1, 2], np.uint8)}
    known = {"timestamp_ns": [time_ns], "track_uuid": ["a"], "category": ["REGULAR_VEHICLE"], "num_interior_pts": [1]}
    lens = {"fx_px": 800.0, "fy_px": 800.0, "cx_px": 512.0, "cy_px": 384.0, "k1": 0.0, "k2": 0.0, "k3": 0.0}
    size = {"height_px": [768], "width_px": [1024]}
    files = {
        f"sensors/lidar/{time_ns}": points | {"offset_ns": np.array([0, 9], np.int32)},
        "annotations": known | box | turn | place,
        "city_SE3_egovehicle": {"timestamp_ns": [time_ns]} | turn | place,
        "calibration/intrinsics": {"sensor_name": ["ring_front_center"], **{k: [v] for k, v in lens.items()}, **size},
        "calibration/egovehicle_SE3_sensor": {"sensor_name": ["ring_front_center"]} | turn | place,
    }
    for name, columns in files.items():
        (log / name).parent.mkdir(parents=True, exist_ok=True)
        feather.write_feather(table(columns), str(log / f"{name}.feather"), compression="uncompressed")
    return log

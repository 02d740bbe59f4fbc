"""Small text files of K-Radar: calibrations, times, odometry, GPS and IMU.

The tables of motion::

    <root>/resources/odometry/gt/gt_01.txt, or gt_odom/gt_01.txt    a pose of each annotated frame, KITTI's 12 numbers
    <root>/resources/odometry/gt_rel/01.txt                         qw qx qy qz tx ty tz from the frame before
    <root>/resources/odometry/seq_1_local.csv                       microseconds, x, y, z of the GPS receiver
    <root>/<seq>/gps*.txt, imu*.txt, gps/*.txt, imu/*.txt           GPS and IMU, one measurement a line

The last are a download of their own whose place in the tree is not published, so any of those names is taken.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from farfield.datasets.kradar.layout import IMAGE_HEIGHT_PX, IMAGE_WIDTH_PX, RESOURCES
from farfield.errors import FileFormatError
from farfield.files import limits
from farfield.files.atomic import read_bytes
from farfield.frame import Camera
from farfield.vocabulary.kradar import KRADAR_ORIGIN_M

MAX_BYTES = 4 << 20
_LARGEST = 1e9
_CAMERA_KEYS = ("fx", "fy", "px", "py", "k1", "k2", "k3", "k4", "k5")
_POSE_KEYS = tuple(f"{name}_ldr2cam" for name in ("yaw", "pitch", "roll", "x", "y", "z"))


def read_lines(path: Path, *, max_bytes: int = MAX_BYTES) -> list[str]:
    """Lines of a text file, white space stripped, blank ones left out.

    Raises:
        FileFormatError: If the file is larger than ``max_bytes``.
    """
    text = read_bytes(path, max_bytes=max_bytes).decode("utf-8", errors="replace")
    return [line.strip() for line in text.splitlines() if line.strip()]


def numbers_of(cells: Sequence[str]) -> list[float] | None:
    """The numbers that cells of text hold; None where one is no number, not finite, or above 1e9."""
    try:
        values = [float(cell) for cell in cells]
    except ValueError:
        return None
    return values if all(abs(value) < _LARGEST for value in values) else None


def format_radar_calibration(difference: int) -> str:
    """Frame difference, and what is added to a LiDAR point's x and y to get the radar's."""
    x, y, _ = KRADAR_ORIGIN_M
    return f"frame difference,x,y\n{difference},{-x},{-y}\n"


def read_radar_calibration(path: Path) -> tuple[int, float, float]:
    """Frame difference, and x and y of the radar in the LiDAR's frame in metres.

    Raises:
        FileFormatError: If the second line is not three numbers, the first of them whole.
    """
    lines = read_lines(path)
    values = numbers_of(lines[1].split(",")) if len(lines) > 1 else None
    if values is None or len(values) != 3 or not values[0].is_integer():
        expected = "a whole number and two numbers"
        raise FileFormatError(path, where="line 2", expected=expected, got=repr(lines[1:2])[:100])
    return int(values[0]), -values[1], -values[2]


def format_times(times_ns: Mapping[str, int]) -> str:
    """Lines ``file, unix seconds`` in the order of the files' names."""
    rows = [f"{name}, {ns // 1_000_000_000}.{ns % 1_000_000_000:09d}\n" for name, ns in sorted(times_ns.items())]
    return "".join(rows)


def read_times(path: Path) -> dict[str, int]:
    """Times in nanoseconds by file name.

    Raises:
        FileFormatError: If a line is no ``file, unix seconds``.
    """
    times: dict[str, int] = {}
    for number, line in enumerate(read_lines(path), start=1):
        match = re.fullmatch(r"([^,]+?)\s*,\s*([0-9]{1,9}|[0-8][0-9]{9})(?:\.([0-9]{1,9})[0-9]*)?", line)
        if not match:
            raise FileFormatError(path, where=f"line {number}", expected="file, unix seconds", got=repr(line[:100]))
        times[match[1]] = int(match[2]) * 1_000_000_000 + int((match[3] or "").ljust(9, "0"))
    return times


def format_camera(camera: Camera, number: int) -> str:
    """The calibration of one eye; keys in the real files' (alphabetical) order.

    ``k1`` to ``k5`` are OpenCV's k1, k2, p1, p2, k3. The rotation is intrinsic in z, y, x order reversed, as SciPy's
    ``from_euler("zyx", [yaw, pitch, roll])`` has it, from the os2-64's axes to the camera's; the translation follows.
    """
    from scipy.spatial.transform import Rotation

    matrix, pose = camera.matrix, camera.camera_T_lidar
    angles = Rotation.from_matrix(pose[:3, :3]).as_euler("zyx", degrees=True)
    intrinsics = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *camera.distortion]
    values = dict(zip(_CAMERA_KEYS + _POSE_KEYS, [*intrinsics, *angles, *pose[:3, 3]], strict=True))
    rows = {"cam_number": str(number)} | {key: repr(float(value)) for key, value in values.items()}
    return "".join(f"{key}: {text}\n" for key, text in sorted(rows.items()))


def read_camera(path: Path) -> Camera:
    """Read the calibration of one eye.

    Raises:
        FileFormatError: If a key is missing or its value no number.
    """
    from scipy.spatial.transform import Rotation

    pairs = [line.partition(":") for line in read_lines(path)]
    cells = {key.strip(): value.strip() for key, _, value in pairs}
    for key in (*_CAMERA_KEYS, *_POSE_KEYS):
        if numbers_of([cells.get(key, "")]) is None:
            actual = repr(cells.get(key))[:80]
            raise FileFormatError(path, where=f"key {key!r}", expected="a finite number", got=actual)
    fx, fy, px, py, *distortion = (float(cells[key]) for key in _CAMERA_KEYS)
    yaw, pitch, roll, *translation = (float(cells[key]) for key in _POSE_KEYS)
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("zyx", [yaw, pitch, roll], degrees=True).as_matrix()
    pose[:3, 3] = translation
    return Camera(
        matrix=np.array([[fx, 0.0, px], [0.0, fy, py], [0.0, 0.0, 1.0]]),
        distortion=np.array(distortion),
        camera_T_lidar=pose,
        width_px=IMAGE_WIDTH_PX,
        height_px=IMAGE_HEIGHT_PX,
    )


def format_odometry(world_T_lidar: Sequence[Float[np.ndarray, "4 4"]]) -> str:
    """KITTI's twelve numbers a line, one line a frame, relative to the first pose."""
    first_T_world = np.linalg.inv(world_T_lidar[0])
    rows = ((first_T_world @ pose)[:3].ravel().tolist() for pose in world_T_lidar)
    return "\n".join(" ".join(f"{round(value, 12) + 0.0:.6e}" for value in row) for row in rows)


def read_odometry(path: Path) -> Float[np.ndarray, "n 4 4"]:
    """Poses relative to the first one, shape (n, 4, 4).

    Raises:
        FileFormatError: If a line is not twelve finite numbers.
    """
    lines = read_lines(path)
    poses = np.tile(np.eye(4), (len(lines), 1, 1))
    for number, line in enumerate(lines, start=1):
        values = numbers_of(line.split())
        if values is None or len(values) != 12 or not all(map(math.isfinite, values)):
            raise FileFormatError(path, where=f"line {number}", expected="12 finite numbers", got=repr(line[:100]))
        poses[number - 1, :3] = np.reshape(values, (3, 4))
    return poses


# How the vehicle moved: odometry, and the tables of its GPS receiver and its two IMUs.

GPS_COLUMNS = ("latitude_deg", "longitude_deg", "altitude_m", *(f"covariance_{k}" for k in range(9)))
IMU_COLUMNS = (
    *(f"angular_velocity_{axis}_rad_s" for axis in "xyz"),
    *(f"angular_velocity_covariance_{k}" for k in range(9)),
    *(f"acceleration_{axis}_m_s2" for axis in "xyz"),
    *(f"acceleration_covariance_{k}" for k in range(9)),
)
LOCAL_COLUMNS = ("x_m", "y_m", "z_m")


@dataclass(frozen=True, eq=False, kw_only=True)
class TimedTable:
    """Measurements over time.

    Args:
        time_ns: Unix time of each row, in the order of the file.
        values: One row a measurement, one column of ``columns`` each.
        columns: Names of the columns, with their units.
    """

    time_ns: Int[np.ndarray, " n"]
    values: Float[np.ndarray, "n c"]
    columns: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.time_ns)

    def nearest(self, time_ns: int, *, within_ns: int = 1_000_000_000) -> dict[str, float] | None:
        """The measurement nearest to a time by column, or None where none lies within ``within_ns``."""
        if not len(self):
            return None
        row = int(np.abs(self.time_ns - time_ns).argmin())
        if abs(int(self.time_ns[row]) - time_ns) > within_ns:
            return None
        return dict(zip(self.columns, self.values[row].tolist(), strict=True))


def read_gps(path: Path) -> TimedTable:
    """Read ``time, latitude, longitude, altitude, 9 covariances``; time in seconds, micro- or nanoseconds.

    Raises:
        FileFormatError: If a line is no row of so many finite numbers.
    """
    return _read_table(path, GPS_COLUMNS)


def read_imu(path: Path) -> TimedTable:
    """Read ``time, angular velocity, 9 covariances, linear acceleration, 9 covariances``.

    Raises:
        FileFormatError: As :func:`read_gps`.
    """
    return _read_table(path, IMU_COLUMNS)


def read_local(path: Path) -> TimedTable:
    """Read ``timestamp,local_x,local_y,local_z``: microseconds and metres from the first row.

    Raises:
        FileFormatError: As :func:`read_gps`.
    """
    return _read_table(path, LOCAL_COLUMNS)


def _read_table(path: Path, columns: Sequence[str]) -> TimedTable:
    lines = [line.replace(",", " ").split() or [""] for line in read_lines(path, max_bytes=limits.MAX_BYTES)]
    if lines and _time_ns(lines[0][0]) is None:
        lines = lines[1:]  # a line of names
    times = np.empty(len(lines), dtype=np.int64)
    values = np.empty((len(lines), len(columns)))
    for row, cells in enumerate(lines):
        numbers, time_ns = numbers_of(cells[1:]), _time_ns(cells[0])
        if numbers is None or time_ns is None or len(numbers) != len(columns):
            expected = f"a time and {len(columns)} finite numbers"
            raise FileFormatError(path, where=f"row {row + 1}", expected=expected, got=repr(", ".join(cells))[:100])
        times[row], values[row] = time_ns, numbers
    return TimedTable(time_ns=times, values=values, columns=tuple(columns))


def _time_ns(cell: str) -> int | None:
    """Unix nanoseconds of a time in seconds (10 digits before the point), micro- (16) or nanoseconds (19)."""
    digits_before, _, part = cell.strip().partition(".")
    if (
        not (digits_before.isascii() and digits_before.isdigit() and len(digits_before) in (10, 13, 16, 19))
        or not (part + "0").isdecimal()
    ):
        return None
    digits = (digits_before + part if len(digits_before) == 10 else digits_before).ljust(19, "0")[:19]
    return int(digits) if digits.isascii() and int(digits) < 1 << 63 else None


def odometry_paths(sequence: str) -> dict[str, tuple[Path, ...]]:
    """Where a sequence's poses may stand, relative to the root: ``absolute`` and ``relative`` ones."""
    folder, number = RESOURCES / "odometry", int(sequence)
    absolute = (folder / "gt" / f"gt_{number:02d}.txt", folder / "gt_odom" / f"gt_{number:02d}.txt")
    return {"absolute": absolute, "relative": (folder / "gt_rel" / f"{number:02d}.txt",)}


def read_relative_odometry(path: Path) -> Float[np.ndarray, "n 4 4"]:
    """Poses in the frame of the first line, from lines ``qw qx qy qz tx ty tz`` that each go on from the line before.

    Raises:
        FileFormatError: If a line is not seven finite numbers, the first four a unit quaternion.
    """
    from scipy.spatial.transform import Rotation

    lines = read_lines(path)
    poses = np.tile(np.eye(4), (len(lines), 1, 1))
    for row, line in enumerate(lines):
        values = numbers_of(line.split())
        if values is None or len(values) != 7 or not abs(np.linalg.norm(values[:4]) - 1.0) < 1e-3:
            expected = "a unit quaternion qw qx qy qz and tx ty tz"
            raise FileFormatError(path, where=f"line {row + 1}", expected=expected, got=repr(line[:100]))
        step = np.eye(4)
        step[:3, :3] = Rotation.from_quat([*values[1:4], values[0]]).as_matrix()
        step[:3, 3] = values[4:]
        poses[row] = step if row == 0 else poses[row - 1] @ step
    return poses


def read_poses(roots: Sequence[Path], sequence: str) -> Float[np.ndarray, "n 4 4"] | None:
    """Poses of a sequence's annotated frames, absolute ones before relative ones; None where there is no file.

    Raises:
        FileFormatError: If the file is damaged.
    """
    readers = {"absolute": read_odometry, "relative": read_relative_odometry}
    for kind, paths in odometry_paths(sequence).items():
        for path in (root / path for path in paths for root in roots):
            if path.is_file():
                return readers[kind](path)
    return None


def motion_files(roots: Sequence[Path], sequence: str) -> dict[str, Path]:
    """Files of the GPS receiver and the IMUs of a sequence: ``gps``, ``gps_local``, ``imu``, ``imu_2``."""
    paths_by_name: dict[str, Path] = {}
    for root in roots:
        local = root / RESOURCES / "odometry" / f"seq_{int(sequence)}_local.csv"
        if local.is_file():
            paths_by_name.setdefault("gps_local", local)
        for name in ("gps", "imu"):
            base = root / sequence
            paths = sorted(path for pattern in (f"{name}*.txt", f"{name}/*.txt") for path in base.glob(pattern))
            for number, path in enumerate(paths[: 2 if name == "imu" else 1]):
                paths_by_name.setdefault(name if number == 0 else f"{name}_2", path)
    return paths_by_name

"""Small text files of K-Radar: radar calibration, camera calibration, times, odometry."""

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from farfield.datasets.kradar.layout import IMAGE_HEIGHT_PX, IMAGE_WIDTH_PX
from farfield.errors import FileFormatError
from farfield.files.atomic import read_bytes
from farfield.frame import Camera
from farfield.radar.axes import KRADAR_ORIGIN_M

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
        raise FileFormatError(path, where="line 2", expected=expected, found=repr(lines[1:2])[:100])
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
        found = re.fullmatch(r"([^,]+?)\s*,\s*([0-9]{1,9}|[0-8][0-9]{9})(?:\.([0-9]{1,9})[0-9]*)?", line)
        if not found:
            raise FileFormatError(path, where=f"line {number}", expected="file, unix seconds", found=repr(line[:100]))
        times[found[1]] = int(found[2]) * 1_000_000_000 + int((found[3] or "").ljust(9, "0"))
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
            found = repr(cells.get(key))[:80]
            raise FileFormatError(path, where=f"key {key!r}", expected="a finite number", found=found)
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
            raise FileFormatError(path, where=f"line {number}", expected="12 finite numbers", found=repr(line[:100]))
        poses[number - 1, :3] = np.reshape(values, (3, 4))
    return poses

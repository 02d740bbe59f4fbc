"""Calibrations that other programs write: ROS' camera_info, OpenCV's FileStorage, Kalibr's camchain.

They hold a camera's intrinsics, and none of them where it stands against a LiDAR, unless ``camera_T_lidar`` (or
``T_cam_lidar``) was added by hand. Sources: ROS' camera_calibration_parsers, OpenCV's FileStorage, Kalibr's wiki.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from farfield.files.yaml_text import plain_yaml

_POSES = ("camera_T_lidar", "T_cam_lidar", "T_camera_lidar")
_MATRICES = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "CameraMat", "intrinsic_matrix", "K", "K1", "M1")
_COEFFICIENTS = (
    *("distortion_coefficients", "distCoeffs", "dist_coeffs", "dist_coeff", "Distortion_Coefficients", "DistCoeff"),
    *("D", "D1"),
)
_SIZES = (("image_width", "image_height"), ("image_Width", "image_Height"), ("width", "height"))
_PINHOLE = ("", "plumb_bob", "radtan", "rational_polynomial", "none")


@dataclass(frozen=True, eq=False, kw_only=True)
class ForeignCamera:
    """One camera of a foreign file.

    Args:
        form: Whose file it is.
        matrix: Intrinsics in pixels, shape (3, 3).
        distortion: Brown-Conrady coefficients, shape (5,).
        camera_T_lidar: Where it stands, shape (4, 4); None where the file does not say.
        width_px: Image width; 0 where the file does not say.
        height_px: Image height.
    """

    form: str
    matrix: Float[np.ndarray, "3 3"]
    distortion: Float[np.ndarray, " 5"]
    camera_T_lidar: Float[np.ndarray, "4 4"] | None
    width_px: int
    height_px: int


def parse_calibration(text: str) -> Any:
    """YAML or JSON, also as OpenCV writes it: with ``%YAML:1.0`` above and its own tags.

    Numbers that are not finite are taken, for programs write them where they know nothing, such as the error of a
    calibration that was put together by hand; where a number is read it has to be finite.

    Raises:
        yaml.YAMLError: If it is none.
    """
    text = text.removeprefix("\ufeff")
    if text.startswith("%YAML:"):
        text = text.partition("\n")[2]
    return plain_yaml(text, finite=False)


def foreign_cameras(content: Any) -> dict[str, ForeignCamera] | None:
    """The cameras of a foreign file by name; None where it is none of the three forms.

    Args:
        content: What :func:`parse_calibration` gave.

    Raises:
        ValueError: If the form is known and its content is not: a matrix of another shape, a lens that is no pinhole.
    """
    if not isinstance(content, Mapping):
        return None
    chain = {str(name): node for name, node in content.items() if isinstance(node, Mapping) and "intrinsics" in node}
    if chain:
        return {name: _kalibr(name, node) for name, node in chain.items()}
    name = next((name for name in _MATRICES if isinstance(content.get(name), Mapping | list)), None)
    if name is None or not (isinstance(content[name], Mapping) or name != "camera_matrix"):
        return None
    is_ros = "distortion_model" in content or "camera_name" in content
    return {str(content.get("camera_name") or "camera"): _matrix_file(content, name, is_ros=is_ros)}


def _matrix_file(content: Mapping[str, Any], name: str, *, is_ros: bool) -> ForeignCamera:
    """ROS' and OpenCV's files: matrices with rows, cols and data."""
    matrix = _array(content[name], name).reshape(-1)
    if matrix.size != 9:
        raise ValueError(f"{name}: expected 3 x 3 numbers, got {matrix.size}")
    _check_lens(str(content.get("distortion_model") or ""))
    key = next((key for key in _COEFFICIENTS if content.get(key) is not None), None)
    values = np.zeros(0) if key is None else _array(content[key], key).reshape(-1)
    width, height = next(((content[w], content[h]) for w, h in _SIZES if w in content and h in content), (0, 0))
    size = content.get("ImageSize") or content.get("image_size")
    if isinstance(size, list) and len(size) == 2:
        width, height = size
    form = "ROS' camera_info" if is_ros else "OpenCV's FileStorage"
    return _camera(form, matrix.reshape(3, 3), values, content, (width, height))


def _kalibr(name: str, node: Mapping[str, Any]) -> ForeignCamera:
    """One camera of Kalibr's camchain: fx, fy, cx, cy; k1, k2, p1, p2."""
    model = str(node.get("camera_model", "pinhole"))
    if model != "pinhole":
        raise ValueError(f"{name}: expected a pinhole camera, got {model}")
    _check_lens(str(node.get("distortion_model") or ""))
    intrinsics = _array(node["intrinsics"], f"{name}.intrinsics")
    if intrinsics.shape != (4,):
        raise ValueError(f"{name}.intrinsics: expected fx, fy, cx, cy, got {intrinsics.size} numbers")
    fx, fy, cx, cy = intrinsics
    resolution = node.get("resolution")
    size = list(resolution) if isinstance(resolution, list) else []
    values = _array(node.get("distortion_coeffs") or [], f"{name}.distortion_coeffs")
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    return _camera("Kalibr's camchain", matrix, values, node, [*size, 0, 0][:2])


def _check_lens(model: str) -> None:
    if model.lower() not in _PINHOLE:
        raise ValueError(f"distortion_model: expected plumb_bob or radtan (Brown-Conrady), got {model}")


def _camera(
    form: str, matrix: np.ndarray, values: np.ndarray, node: Mapping[str, Any], size: Sequence[Any]
) -> ForeignCamera:
    check_matrix(matrix)
    if values[5:].any():
        raise ValueError(f"the distortion: expected k1, k2, p1, p2, k3 alone, got {values.size} that are not 0")
    key = next((key for key in _POSES if node.get(key) is not None), None)
    motion = None if key is None else _array(node[key], key)
    if motion is not None and motion.size != 16:
        raise ValueError(f"{key}: expected 4 x 4 numbers, got {motion.size}")
    sides = [int(side) if isinstance(side, int | float) and 0 <= side < 1e6 else 0 for side in size]
    return ForeignCamera(
        form=form,
        matrix=matrix,
        distortion=np.concatenate([values[:5], np.zeros(max(0, 5 - values.size))]),
        camera_T_lidar=None if motion is None else motion.reshape(4, 4),
        width_px=sides[0],
        height_px=sides[1],
    )


def check_matrix(matrix: Float[np.ndarray, "3 3"]) -> None:
    """Refuse what is no camera's matrix.

    Raises:
        ValueError: If a focal length is not above 0, or the last row is not 0, 0, 1.
    """
    if not (matrix[0, 0] > 0 and matrix[1, 1] > 0 and matrix[2].tolist() == [0.0, 0.0, 1.0]):
        raise ValueError(f"the matrix: expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], got {matrix.tolist()}")


def _array(node: Any, name: str) -> np.ndarray:
    """Numbers of a list, or of ``rows``, ``cols`` and ``data``."""
    numbers = node.get("data") if isinstance(node, Mapping) else node
    try:
        array = np.array(numbers, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{name}: expected numbers, got {str(numbers)[:60]}") from error
    if not np.isfinite(array).all() or array.ndim < 1:
        raise ValueError(f"{name}: expected finite numbers, got {str(numbers)[:60]}")
    return array

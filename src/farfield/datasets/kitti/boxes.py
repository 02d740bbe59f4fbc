"""KITTI's calibration and label files as cameras, poses, boxes and annotations (Geiger et al., CVPR 2012)."""

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float
from PIL import Image

from farfield.errors import ConfigError, DatasetError, FileFormatError, plain
from farfield.files.cuboids import check_yaw
from farfield.files.kitti import KittiObjects
from farfield.files.stand_ins import check_itself
from farfield.frame import Annotation, Boxes, Camera, CameraField
from farfield.geometry.cameras import image_boxes
from farfield.geometry.kitti import camera_from_lidar, lidar_from_camera
from farfield.vocabulary.classes import CIRRUS_FROM_KITTI, normalised_class

_RECTIFIED_PX = {
    721.5377: (1242, 375),  # 2011_09_26
    707.0493: (1224, 370),  # 2011_09_28
    718.3351: (1238, 374),  # 2011_09_29
    707.0912: (1226, 370),  # 2011_09_30
    718.856: (1241, 376),  # 2011_10_03
}
_SAME_FOCAL_PX = 0.01


def camera_from_calib(calib: Mapping[str, np.ndarray]) -> Float[np.ndarray, "4 4"]:
    """Map of lidar to rectified camera coordinates: ``R0_rect @ Tr_velo_to_cam``.

    Args:
        calib: Matrices of a calibration file; KITTI tracking's ``R_rect`` and ``Tr_velo_cam`` do as well.

    Raises:
        DatasetError: If a matrix is missing.
    """
    rectify = next((calib[name] for name in ("R0_rect", "R_rect", "R0") if name in calib), None)
    motion = next((calib[name] for name in ("Tr_velo_to_cam", "Tr_velo_cam") if name in calib), None)
    if rectify is None or motion is None:
        raise DatasetError(f"calibration: expected R0_rect and Tr_velo_to_cam, got {', '.join(calib) or 'nothing'}")
    matrix = np.eye(4)
    matrix[:3] = _shaped(rectify, (3, 3), "R0_rect") @ _shaped(motion, (3, 4), "Tr_velo_to_cam")
    determinant = float(np.linalg.det(matrix[:3, :3]))
    if not 0.9 < determinant < 1.1:
        raise DatasetError(f"calibration: expected R0_rect @ Tr_velo_to_cam to rotate (1), got {determinant:.3g}")
    return matrix


LABEL_AXES = ("camera", "lidar", "lidar-bottom")
"""In which axes labels stand: KITTI's camera; or the LiDAR's, x y z the centre, or the bottom's centre, and rotation_y
the yaw about z, as own labels with a unit calibration have them."""
_UNIT = 0.1
_MOST_UP = -0.5  # the upward part of a camera's y axis at most


def checked_axes(label_axes: str) -> None:
    """Refuse axes that there are not.

    Raises:
        ConfigError: If it is none of :data:`LABEL_AXES`.
    """
    if label_axes not in LABEL_AXES:
        raise ConfigError(f"label_axes: expected one of {', '.join(LABEL_AXES)}, got {label_axes!r}")


def check_objects(objects: KittiObjects, path: Path) -> None:
    """Refuse boxes that would be lost or turned: those of one or two sizes, and yaws in degrees.

    Raises:
        FileFormatError: If there is one.
    """
    for line, yaw_rad, sizes in zip(objects.line, objects.rotation_y_rad, objects.size_m, strict=True):
        check_yaw(float(yaw_rad), path, f"line {line}")
        if (sizes > 0).any() and not (sizes > 0).all():
            expected = "three positive sizes, or none of an object without a 3D box"
            raise FileFormatError(path, where=f"line {line}", expected=expected, got=repr(sizes.tolist()))


def boxes_in_axes(
    objects: KittiObjects,
    camera_T_lidar: Float[np.ndarray, "4 4"],
    label_axes: str,
    path: Path,
    *,
    classes: str = "cirrus",
) -> Boxes:
    """The boxes of a label file in the axes that it is said to have; the others are those of the two functions below.

    Args:
        objects: Rows of the file.
        camera_T_lidar: Lidar to rectified camera coordinates.
        label_axes: One of :data:`LABEL_AXES`.
        path: The file, for messages.
        classes: As of :func:`boxes_from_objects`.

    Raises:
        DatasetError: If the labels are said to stand in the camera's axes, and the calibration's y axis does not point
            down: no camera stands so.
        FileFormatError: If a yaw is in degrees, or an object has some of the three sizes.
    """
    check_objects(objects, path)
    if label_axes != "camera":
        return boxes_in_lidar(objects, bottom=label_axes == "lidar-bottom", classes=classes)
    if camera_T_lidar[1, 2] > _MOST_UP and objects.has_box.any():
        unit = np.abs(camera_T_lidar[:3, :3] - np.eye(3)).max() < _UNIT
        turn = "turns nothing (R0_rect and Tr_velo_to_cam are unit matrices)" if unit else "leaves y level or up"
        raise DatasetError(
            f"{path}: expected boxes in a camera's axes (x right, y down, z ahead), got a calibration that {turn}: "
            "the labels stand in the LiDAR's axes, or Tr_velo_to_cam is not the way from the LiDAR to the camera. Say "
            "--label-axes lidar (x y z is the centre of a box, rotation_y its yaw about z) or lidar-bottom (x y z is "
            "the centre of its bottom), or give the camera's calibration"
        )
    return boxes_from_objects(objects, camera_T_lidar, classes=classes)


def boxes_in_lidar(objects: KittiObjects, *, bottom: bool, classes: str = "cirrus") -> Boxes:
    """Boxes of labels that stand in the LiDAR's axes, in KITTI's columns.

    Args:
        objects: Rows of a label file.
        bottom: Whether x y z is the centre of the bottom, else of the box.
        classes: As of :func:`boxes_from_objects`.
    """
    boxed = objects[objects.has_box]
    centre = boxed.bottom_m.copy()
    centre[:, 2] += boxed.size_m[:, 0] / 2 if bottom else 0.0
    return Boxes(
        centre_m=centre,
        size_m=boxed.size_m[:, ::-1].copy(),
        yaw_rad=boxed.rotation_y_rad,
        label=_names(boxed, classes),
        score=boxed.score,
    )


def _names(objects: KittiObjects, classes: str) -> list[str]:
    names = objects.type.tolist()
    return [normalised_class(name, CIRRUS_FROM_KITTI) for name in names] if classes == "cirrus" else names


def _shaped(matrix: np.ndarray, shape: tuple[int, int], name: str) -> np.ndarray:
    if matrix.shape != shape:
        raise DatasetError(f"calibration: expected {name} of shape {shape}, got {matrix.shape}")
    return np.asarray(matrix, dtype=np.float64)


def image_size(matrix: Float[np.ndarray, "3 3"]) -> tuple[int, int]:
    """Width and height of the rectified colour images of a calibration, where the image itself is absent.

    KITTI rectified each day's drives to a size of its own, which its focal length tells. The image of another
    calibration is taken to be twice as wide and high as its principal point lies from the corner: near enough to tell
    the field of view.

    >>> image_size(np.array([[721.5377, 0, 609.5593], [0, 721.5377, 172.854], [0, 0, 1]]))
    (1242, 375)
    """
    for focal_px, size in _RECTIFIED_PX.items():
        if abs(matrix[0, 0] - focal_px) < _SAME_FOCAL_PX:
            return size
    return max(round(2 * float(matrix[0, 2])) + 1, 1), max(round(2 * float(matrix[1, 2])) + 1, 1)


def camera_of(calib: Mapping[str, np.ndarray], *, width_px: int = 0, height_px: int = 0) -> Camera:
    """Build the left colour camera (P2) with its pose; P2's fourth column becomes an offset of the camera."""
    if "P2" not in calib:
        raise DatasetError(f"calibration: expected P2, got {', '.join(calib) or 'nothing'}")
    projection = _shaped(calib["P2"], (3, 4), "P2")
    if not abs(np.linalg.det(projection[:, :3])) > 1e-9:
        raise DatasetError(f"calibration: expected an invertible P2, got {projection.tolist()}")
    offset = np.eye(4)
    offset[:3, 3] = np.linalg.solve(projection[:, :3], projection[:, 3])
    return Camera(
        matrix=projection[:, :3].copy(),
        camera_T_lidar=offset @ camera_from_calib(calib),
        width_px=width_px,
        height_px=height_px,
    )


def sized_camera(
    calib: Mapping[str, np.ndarray], image: Path | None, *, size_px: tuple[int, int] | None = None
) -> Camera:
    """Camera P2 with the size of its image, from the image's header.

    Args:
        calib: The calibration file's matrices.
        image: The image, or None.
        size_px: Width and height where there is no image; None takes those of KITTI's drives, see :func:`image_size`.
    """
    if image is None:
        width, height = size_px or image_size(camera_of(calib).matrix)
        return camera_of(calib, width_px=width, height_px=height)
    check_itself(image)
    try:
        with Image.open(image, formats=("JPEG", "PNG")) as picture:
            width, height = picture.size
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise DatasetError(f"{image}: expected a JPEG or PNG image, found: {plain(error)}") from error
    return camera_of(calib, width_px=width, height_px=height)


def boxes_from_objects(
    objects: KittiObjects, camera_T_lidar: Float[np.ndarray, "4 4"], *, classes: str = "cirrus"
) -> Boxes:
    """Convert KITTI objects to lidar boxes; rows without a 3D box (``DontCare``) are left out.

    Args:
        objects: Rows of a label or detection file.
        camera_T_lidar: Lidar to rectified camera coordinates.
        classes: ``"cirrus"`` translates class names (unknown ones become ``unknown``), ``"kitti"`` keeps them.
    """
    boxed = objects[objects.has_box]
    centre, size, yaw = lidar_from_camera(boxed.bottom_m, boxed.size_m, boxed.rotation_y_rad, camera_T_lidar)
    return Boxes(centre_m=centre, size_m=size, yaw_rad=yaw, label=_names(boxed, classes), score=boxed.score)


def objects_from_boxes(boxes: Boxes, camera: Camera, *, classes: Mapping[str, str]) -> KittiObjects:
    """Convert lidar boxes to KITTI objects: the inverse of :func:`boxes_from_objects`, with 2D boxes.

    A box behind the camera or outside its image gets the 2D box -1 -1 -1 -1. Occlusion is not known (3).

    Args:
        boxes: Boxes in lidar coordinates.
        camera: The left colour camera (its pose is taken as that of the rectified frame).
        classes: Class names by ours; others stay, their blanks as underscores.

    Raises:
        DatasetError: If two classes would have one name.
    """
    names = kitti_names(np.asarray(boxes.label).tolist(), classes)
    bottom, size, rotation_y = camera_from_lidar(boxes.centre_m, boxes.size_m, boxes.yaw_rad, camera.camera_T_lidar)
    box_px, truncation = image_boxes(boxes, camera)
    alpha = rotation_y - np.arctan2(bottom[:, 0], bottom[:, 2])
    return KittiObjects(
        type=np.array([names[str(name)] for name in boxes.label], dtype=np.str_),
        truncation=truncation,
        occlusion=np.full(len(boxes), 3, dtype=np.int64),
        alpha_rad=np.mod(alpha + np.pi, 2 * np.pi) - np.pi,
        box_px=box_px,
        size_m=size,
        bottom_m=bottom,
        rotation_y_rad=rotation_y,
        score=boxes.score,
        line=np.arange(1, len(boxes) + 1, dtype=np.int64),
    )


def kitti_names(labels: Iterable[str], classes: Mapping[str, str]) -> dict[str, str]:
    """KITTI's name of each class, one word of its columns; of ours that it has not, the class's own.

    Raises:
        DatasetError: If a class of one's own would have the name of another, or cannot be written in ASCII.

    >>> kitti_names(["vehicle", "traffic cone"], {"vehicle": "Car"})
    {'vehicle': 'Car', 'traffic cone': 'traffic_cone'}
    """
    names: dict[str, str] = {}
    for label in dict.fromkeys(map(str, labels)):
        name = classes.get(label) or "_".join(label.split())
        same = [other for other, own in names.items() if own == name and name not in CIRRUS_FROM_KITTI]
        twin = next(iter(same), None)
        if not name.isascii() or not name or name == "DontCare" or twin is not None:
            problem = f"{twin!r} is called so too" if twin is not None else "it is no word of KITTI's text"
            raise DatasetError(
                f"class {label!r}: expected a name of its own in KITTI's text, got {name!r}: {problem}. Rename it by a "
                "mapping: classes: {OLD: NEW}"
            )
        names[label] = name
    return names


def annotation_of(objects: KittiObjects, boxes: Boxes, region: CameraField | None) -> Annotation:
    """What KITTI knows of its objects beyond their boxes.

    Args:
        objects: Rows of a label file, ``DontCare`` included.
        boxes: Boxes of those that have one, in the same order.
        region: Where was annotated.
    """
    boxed = objects[objects.has_box]
    details = {name: getattr(boxed, name) for name in ("truncation", "occlusion", "box_px", "alpha_rad")}
    return Annotation(
        boxes=boxes,
        original_label=tuple(boxed.type.tolist()),
        details=details,
        unboxed={"dontcare_px": objects.box_px[objects.type == "DontCare"]},
        region=region,
    )

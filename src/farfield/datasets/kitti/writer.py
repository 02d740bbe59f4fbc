"""Write frames in KITTI's object layout."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from farfield.datasets.kitti.object import objects_from_boxes
from farfield.errors import DatasetError
from farfield.files.atomic import write_text
from farfield.files.clouds import write_bin
from farfield.files.images import write_image
from farfield.files.kitti import write_labels
from farfield.frame import Boxes, Camera, Frame
from farfield.vocabulary.classes import KITTI_FROM_CIRRUS

_SUFFIXES = {"velodyne": "bin", "calib": "txt", "label_2": "txt", "image_2": "png"}
# Stands in where a data set has no calibration: the image size of Cirrus, looking along x, 79 degrees wide.
VIRTUAL_CAMERA = Camera(
    matrix=np.array([[1173.0, 0.0, 959.5], [0.0, 1173.0, 324.5], [0.0, 0.0, 1.0]]), width_px=1920, height_px=650
)


class KittiWriter:
    """Write ``training/{velodyne,label_2,calib,image_2}/NNNNNN.*``.

    Boxes behind the camera or outside its image are written too, with the 2D box -1 -1 -1 -1. A frame without
    calibration gets a virtual camera at the lidar's origin and no image. Lens distortion has no place in KITTI's
    calibration: rectify the images beforehand, or leave 2D boxes unused.

    Args:
        root: Folder in which ``training`` is made.
        classes: KITTI's names by ours; others become ``Misc``.
    """

    def __init__(self, root: Path | str, *, classes: Mapping[str, str] = KITTI_FROM_CIRRUS) -> None:
        self.root, self.classes = Path(root), classes

    def write(
        self,
        number: int,
        frame: Frame,
        *,
        cloud: str | None = None,
        boxes: Boxes | None = None,
        occlusion: Int[np.ndarray, " n"] | None = None,
    ) -> dict[str, Path]:
        """Write one frame under a number.

        Args:
            number: 0 to 999999.
            frame: The frame.
            cloud: Which cloud; None takes the first; it must be one with intensity.
            boxes: Boxes to label instead of the frame's.
            occlusion: How far each box is hidden: 0 visible, 1 partly, 2 largely occluded, 3 unknown; None: unknown.

        Returns:
            The files written, by kind.

        Raises:
            DatasetError: If the number has more than six digits, or the cloud is a radar's, without intensity.
        """
        if not 0 <= number <= 999_999:
            raise DatasetError(f"frame {frame.key}: expected a KITTI number from 0 to 999999, got {number}")
        name = next((key for key in frame.cameras if key in frame.images), None)
        camera = frame.cameras[name] if name is not None else next(iter(frame.cameras.values()), VIRTUAL_CAMERA)
        boxes = frame.boxes if boxes is None else boxes
        points = frame.cloud(cloud)
        if points.intensity is None:
            raise DatasetError(
                f"frame {frame.key}: KITTI's velodyne files hold LiDAR clouds with intensity, got a cloud of "
                f"{', '.join(points.columns)}. Choose by `cloud` one of {', '.join(frame.clouds)} that has it."
            )
        paths = {"velodyne": self.path("velodyne", number), "calib": self.path("calib", number)}
        for path in paths.values():
            path.parent.mkdir(parents=True, exist_ok=True)
        write_bin(paths["velodyne"], np.column_stack([points.points_m, points.intensity]))
        write_text(paths["calib"], calibration_text(camera))
        if boxes is not None:
            paths["label_2"] = self.path("label_2", number)
            paths["label_2"].parent.mkdir(parents=True, exist_ok=True)
            objects = objects_from_boxes(boxes, camera, classes=self.classes)
            write_labels(paths["label_2"], objects if occlusion is None else replace(objects, occlusion=occlusion))
        if name is not None:
            paths["image_2"] = self.path("image_2", number)
            paths["image_2"].parent.mkdir(parents=True, exist_ok=True)
            write_image(paths["image_2"], frame.images[name])
        return paths

    def path(self, kind: str, number: int) -> Path:
        """The file of a number: ``velodyne``, ``calib``, ``label_2`` or ``image_2``."""
        return self.root / "training" / kind / f"{number:06d}.{_SUFFIXES[kind]}"


def calibration_text(camera: Camera) -> str:
    """KITTI's calibration file for one camera: P0 to P3 alike, no rectification."""
    projection = np.column_stack([camera.matrix, np.zeros(3)])
    matrices = {f"P{number}": projection for number in range(4)}
    matrices |= {"R0_rect": np.eye(3), "Tr_velo_to_cam": camera.camera_T_lidar[:3], "Tr_imu_to_velo": np.eye(4)[:3]}
    return "".join(f"{name}: {_row(matrix)}\n" for name, matrix in matrices.items())


def _row(matrix: Float[np.ndarray, "rows columns"]) -> str:
    return " ".join(repr(value) for value in matrix.ravel().tolist())

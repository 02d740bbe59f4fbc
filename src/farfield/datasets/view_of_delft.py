"""View-of-Delft's LiDAR layout (Palffy et al.: "Multi-class Road User Detection with 3+1D Radar", RA-L 2022).

KITTI's layout with ``pose/*.json`` beside it: an HDL-64 cloud, one image, labels in the camera's coordinates. Its
headings turn about the lidar's vertical axis and not the camera's, which looks down by seven degrees.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from farfield.datasets.classes import CIRRUS_FROM_VIEW_OF_DELFT, normalised_class
from farfield.datasets.kitti import Kitti
from farfield.datasets.kitti_boxes import camera_from_calib
from farfield.files.kitti import KittiObjects, read_calib, read_labels
from farfield.frame import Boxes, Frame
from farfield.geometry.poses import transform_points


class ViewOfDelft(Kitti):
    """View-of-Delft frames: cloud ``"lidar"``, image ``"camera"``, boxes of full objects; as :class:`Kitti` otherwise.

    Args:
        root: The folder ``lidar`` of the data set, with ``training`` or ``testing``.
        **options: As :class:`Kitti` takes them.

    Raises:
        DatasetError: If there is no cloud.
    """

    name = "view_of_delft"

    def frame(self, index: int) -> Frame:
        """Build frame ``index``."""
        frame = super().frame(index)
        labels, calib = self._file(index, "label_2", ".txt"), self._file(index, "calib", ".txt")
        if labels is None or calib is None:
            return frame
        camera_T_lidar = camera_from_calib(read_calib(calib))
        return replace(frame, annotation=partial(_annotation, labels, camera_T_lidar, self.classes))


def _annotation(labels: Path, camera_T_lidar: Float[np.ndarray, "4 4"], classes: str) -> Boxes:
    return boxes_from_labels(read_labels(labels), camera_T_lidar, classes=classes)


def boxes_from_labels(
    objects: KittiObjects, camera_T_lidar: Float[np.ndarray, "4 4"], *, classes: str = "cirrus"
) -> Boxes:
    """Convert View-of-Delft's objects to lidar boxes.

    The centre of the bottom face is moved into the lidar's frame; the box stands upright there, and ``rotation_y``
    turns clockwise about its vertical from the right-hand side.

    Args:
        objects: Rows of a label file; the sixteenth column, always 1, is no score.
        camera_T_lidar: Lidar to camera coordinates.
        classes: ``"cirrus"`` translates class names (unknown ones become ``unknown``), ``"kitti"`` keeps them.
    """
    kept = objects[objects.has_box]
    bottom_m = transform_points(np.linalg.inv(camera_T_lidar), kept.bottom_m)
    names: Any = kept.type.tolist()
    if classes == "cirrus":
        names = [normalised_class(name, CIRRUS_FROM_VIEW_OF_DELFT) for name in names]
    return Boxes(
        centre_m=bottom_m + np.array([0.0, 0.0, 0.5]) * kept.size_m[:, :1],
        size_m=kept.size_m[:, ::-1].copy(),
        yaw_rad=-(kept.rotation_y_rad + np.pi / 2),
        label=names,
    )

"""View-of-Delft's labels as boxes. The files' headings turn about the radar's vertical axis.

The documentation says "around the LiDAR's -Z axis". The nine-degree-of-freedom labels that the example frames have as
well show which axis it is: seen in the radar's frame the headings agree to 0.001 degrees, in the lidar's they are
0.35 degrees off, the angle between the two sensors.
"""

from typing import Any

import numpy as np
from jaxtyping import Float

from farfield.files.kitti import KittiObjects
from farfield.files.view_of_delft import DelftObjects
from farfield.frame import Boxes
from farfield.geometry.kitti import upright_from_camera
from farfield.geometry.poses import rotation_from_quaternion
from farfield.vocabulary.classes import CIRRUS_FROM_VIEW_OF_DELFT, normalised_class

_RADAR_R_LABEL = np.diag([1.0, -1.0, -1.0])  # x forward, y right, z down to x forward, y left, z up
_KITTI_NAMES = {"car": "Car", "pedestrian": "Pedestrian"}


def boxes_from_labels(
    objects: KittiObjects, camera_T_sensor: Float[np.ndarray, "4 4"], *, classes: str = "cirrus"
) -> Boxes:
    """Convert View-of-Delft's objects to boxes in a sensor's frame: exact for the radar.

    The box stands upright in the sensor's frame, see :func:`~farfield.geometry.kitti.upright_from_camera`.

    Args:
        objects: Rows of a label file; the sixteenth column, always 1, is no score.
        camera_T_sensor: Radar (or lidar) to camera coordinates.
        classes: ``"cirrus"`` translates class names (unknown ones become ``unknown``), ``"kitti"`` keeps them.
    """
    kept = objects[objects.has_box]
    centre, size, yaw = upright_from_camera(kept.bottom_m, kept.size_m, kept.rotation_y_rad, camera_T_sensor)
    return Boxes(centre_m=centre, size_m=size, yaw_rad=yaw, label=_class_names(kept.type.tolist(), classes))


def boxes_from_objects(objects: DelftObjects, *, classes: str = "cirrus") -> Boxes:
    """Convert the objects of a JSON label file to boxes in the radar's frame, upright: their roll and pitch are lost.

    Args:
        objects: The file's objects.
        classes: ``"cirrus"`` or ``"kitti"``, where a bicycle with a rider is a ``Cyclist``, as in the text files.
    """
    heading = rotation_from_quaternion(objects.quaternion_xyzw)[:, :, 0] @ _RADAR_R_LABEL
    return Boxes(
        centre_m=objects.centre_m @ _RADAR_R_LABEL,
        size_m=objects.size_m,
        yaw_rad=np.arctan2(heading[:, 1], heading[:, 0]),
        label=_class_names(kitti_names(objects), classes),
    )


def kitti_names(objects: DelftObjects) -> list[str]:
    """Class names of a JSON label file as the text files have them."""
    return [
        "Cyclist" if name == "bicycle" and attributes.get("has_rider") else _KITTI_NAMES.get(name, name)
        for name, attributes in zip(objects.class_name, objects.attributes, strict=True)
    ]


def _class_names(names: list[str], classes: str) -> Any:
    return [normalised_class(name, CIRRUS_FROM_VIEW_OF_DELFT) for name in names] if classes == "cirrus" else names

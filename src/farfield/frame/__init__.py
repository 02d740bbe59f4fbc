"""Frame: the one record that flows from readers and the simulator to detectors, metrics, reports and the studio."""

from farfield.frame.annotation import Annotation, CameraField, Footprints
from farfield.frame.cloud import Cloud
from farfield.frame.drive import Drive, Key
from farfield.frame.record import Constant, Frame, Lazy, Pose, Sensor, camera_sensor, merge_clouds, transform_frame
from farfield.geometry.boxes import Boxes
from farfield.geometry.cameras import Camera

__all__ = [
    "Annotation",
    "Boxes",
    "Camera",
    "CameraField",
    "Cloud",
    "Constant",
    "Drive",
    "Footprints",
    "Frame",
    "Key",
    "Lazy",
    "Pose",
    "Sensor",
    "camera_sensor",
    "merge_clouds",
    "transform_frame",
]

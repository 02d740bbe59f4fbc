"""Frame: the one record that flows from readers and the simulator to detectors, metrics, reports and the studio."""

from farfield.frame.annotation import Annotation, CameraField
from farfield.frame.drive import Drive, Key
from farfield.frame.record import Cloud, Frame, Lazy
from farfield.geometry.boxes import Boxes
from farfield.geometry.cameras import Camera

__all__ = ["Annotation", "Boxes", "Camera", "CameraField", "Cloud", "Drive", "Frame", "Key", "Lazy"]

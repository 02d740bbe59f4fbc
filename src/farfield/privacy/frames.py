"""A data set whose images are covered as they are read, and its annotated vehicles, on which plates may be.

Where boxes and a calibration are there, weak plates count on vehicles only. The nuScenes authors ran their detectors at
a threshold of high recall and then dropped what overlapped no annotated vehicle (Caesar et al., 2020, arXiv 1903.11027,
section 3.1). Where there is no calibration this step is left out.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from jaxtyping import Float, UInt8

from farfield.frame import Annotation, Frame
from farfield.frame.record import Lazy
from farfield.geometry.boxes import Boxes
from farfield.geometry.cameras import Camera
from farfield.privacy.anonymising import AnonymizeOptions
from farfield.privacy.covering import cover_boxes
from farfield.privacy.detectors import find_boxes
from farfield.privacy.image_boxes import PLATE, ImageBoxes

VEHICLE_GROWTH = 1.2
_NEAREST_M = 0.3
_WITHOUT_PLATE = frozenset({"animal", "bicycle", "cyclist", "pedestrian", "person", "rider", "wheeled_pedestrian"})
_Picture = UInt8[np.ndarray, "height width 3"]


@dataclass(frozen=True)
class Anonymized:
    """Covers faces and number plates in a frame's images, each image by itself: ``dataset.mapped(Anonymized())``.

    Weak boxes of faces are covered too, for no track says which of them are faces; weak ones of plates only within
    vehicles, where the frame has boxes and the camera a calibration. What a detector misses stays visible.
    :func:`~farfield.privacy.anonymise` follows the boxes over the pictures of a drive.

    Args:
        chosen: How.
    """

    chosen: AnonymizeOptions = field(default_factory=AnonymizeOptions)

    def __call__(self, frame: Frame) -> Frame:
        """The frame with covered images."""
        images = frame.images
        covered = {}
        for name in images:
            load = images.loader(name) if isinstance(images, Lazy) else partial(images.__getitem__, name)
            covered[name] = partial(_cover_image, load, self.chosen, frame.load_annotation, frame.cameras.get(name))
        return replace(frame, images=Lazy(covered))


def _cover_image(
    load: Callable[[], _Picture],
    options: AnonymizeOptions,
    load_annotation: Callable[[], Annotation] | None,
    camera: Camera | None,
) -> _Picture:
    image = load()
    boxes = find_boxes(image, options.finders())
    if (boxes.kind == PLATE).any():
        vehicles_px = np.zeros((0, 4))
        if load_annotation is not None and camera is not None:
            vehicles_px = project_vehicles(load_annotation().boxes, camera)
        boxes = drop_plates_off_vehicles(boxes, vehicles_px, options.linking.strong)
    return cover_boxes(image, boxes.within(image.shape[1], image.shape[0]), options.how, np.random.default_rng())


def project_vehicles(boxes: Boxes, camera: Camera, *, growth: float = VEHICLE_GROWTH) -> Float[np.ndarray, "n 4"]:
    """Upright boxes in the picture around the vehicles that it may show, grown about their centres.

    Args:
        boxes: In the coordinates that ``camera`` refers to; persons, animals and bicycles are left out.
        camera: The picture's.
        growth: Factor of width and height.

    Returns:
        Left, top, right, bottom, shape (n, 4), cut at the picture's edges. A vehicle that reaches behind the camera
        goes on to the picture's edge on its side, from top to bottom.
    """
    vehicles = []
    width, height = camera.width_px or np.inf, camera.height_px or np.inf
    for row in range(len(boxes)):
        if str(boxes.label[row]).lower() in _WITHOUT_PLATE:
            continue
        pixels, depth_m, _ = camera.project(boxes[row : row + 1].corners_m()[0], min_depth_m=_NEAREST_M)
        ahead = depth_m > _NEAREST_M
        if not ahead.any():
            continue
        low, high = pixels[ahead].min(axis=0), pixels[ahead].max(axis=0)
        if not ahead.all():  # it is beside the camera: what is behind lies farther out still
            on_the_left = (low + high)[0] < width
            low = np.array([0.0 if on_the_left else low[0], 0.0])
            high = np.array([high[0] if on_the_left else width, height])
        half = (high - low) / 2 * growth
        centre = (low + high) / 2
        vehicles.append(np.concatenate([centre - half, centre + half]))
    if not vehicles:
        return np.zeros((0, 4))
    clipped = np.array(vehicles).clip(0, [width, height, width, height])
    return np.asarray(clipped[(clipped[:, 2:] > clipped[:, :2]).all(axis=1)])


def drop_plates_off_vehicles(boxes: ImageBoxes, vehicle_px: Float[np.ndarray, "n 4"], strong: float) -> ImageBoxes:
    """The boxes without weak plates whose centre lies in no vehicle.

    Args:
        boxes: Faces stay as they are.
        vehicle_px: From :func:`project_vehicles`.
        strong: Plates from this score on stay wherever they are.
    """
    centre = (boxes.box_px[:, :2] + boxes.box_px[:, 2:]) / 2
    low, high = vehicle_px[None, :, :2], vehicle_px[None, :, 2:]
    inside = ((centre[:, None] >= low) & (centre[:, None] <= high)).all(axis=2).any(axis=1)
    return boxes[(boxes.kind != PLATE) | (boxes.score >= strong) | inside]

"""A picture with the LiDAR's points and the boxes in it, as Cirrus' Figure 5 has them."""

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw

from farfield.figures.camera import box_lines
from farfield.geometry.boxes import Boxes
from farfield.geometry.cameras import Camera

_INKS = {"pedestrian": (235, 45, 45), "wheeled_pedestrian": (235, 45, 45), "bicycle": (60, 110, 255)}
_OTHER = (40, 220, 60)
_NEAR_M, _FAR_M = 3.0, 100.0


def boxes_picture(
    image: UInt8[np.ndarray, "height width 3"],
    camera: Camera,
    boxes: Boxes,
    points_m: Float[np.ndarray, "n 3"] | None = None,
    *,
    line_px: int = 2,
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw boxes (pedestrians red, bicycles blue, vehicles green) and, if given, points from near red to far blue."""
    canvas = image.copy() if points_m is None else _with_points((image * 0.75).astype(np.uint8), camera, points_m)
    picture = Image.fromarray(canvas)
    pen = ImageDraw.Draw(picture)
    labels = np.asarray(boxes.label).tolist()
    for number, label in enumerate(labels):
        ink = _INKS.get(str(label), _OTHER)
        for line in box_lines(boxes[np.array([number])], camera):
            pen.line([(float(u), float(v)) for u, v in line], fill=ink, width=line_px)
    return np.asarray(picture)


def _with_points(
    canvas: UInt8[np.ndarray, "height width 3"], camera: Camera, points_m: Float[np.ndarray, "n 3"]
) -> UInt8[np.ndarray, "height width 3"]:
    pixels, depth, visible = camera.project(points_m)
    order = np.flatnonzero(visible)[np.argsort(-depth[visible])]  # near points over far ones
    share = np.clip(np.log(depth[order] / _NEAR_M) / np.log(_FAR_M / _NEAR_M), 0, 1)[:, None]
    near, middle, far = (np.array(ink) for ink in ((255, 70, 40), (250, 220, 40), (50, 110, 255)))
    ink = np.where(share < 0.5, near + (middle - near) * 2 * share, middle + (far - middle) * (2 * share - 1))
    column, row = np.clip(pixels[order].round().astype(int), 0, [canvas.shape[1] - 2, canvas.shape[0] - 2]).T
    for down in (0, 1):
        for right in (0, 1):
            canvas[row + down, column + right] = ink.astype(np.uint8)
    return canvas

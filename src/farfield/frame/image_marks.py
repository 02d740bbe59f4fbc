"""The boxes that annotators drew in a camera's image, beside the 3D boxes of the frame."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.frame.record import Frame
from farfield.geometry.cameras import Camera, image_boxes


@dataclass(frozen=True, eq=False, kw_only=True)
class ImageMarks:
    """2D boxes of a frame in one image.

    Args:
        camera: The image's name.
        box_px: Left, top, right, bottom, shape (n, 4), pixels.
        row: Which of the frame's 3D boxes each belongs to, shape (n,).
        label: Classes, n names.
        ignored_px: Regions in which nothing was annotated (KITTI's ``DontCare``), shape (m, 4).
    """

    camera: str
    box_px: Float[np.ndarray, "n 4"]
    row: Int[np.ndarray, " n"]
    label: tuple[str, ...]
    ignored_px: Float[np.ndarray, "m 4"] = field(default_factory=lambda: np.zeros((0, 4)))

    def __len__(self) -> int:
        return len(self.box_px)


def image_marks(frame: Frame) -> ImageMarks | None:
    """The 2D boxes of a frame's annotation (its detail ``box_px``); None where it has none.

    KITTI's labels have one camera, the first of the frame. Rows without a 2D box (0 0 0 0, -1 -1 -1 -1) are left out.

    Args:
        frame: A frame; its annotation is read.
    """
    annotation = frame.annotation
    camera = next(iter(frame.cameras), next(iter(frame.images), ""))
    if annotation is None or not camera or "box_px" not in annotation.details:
        return None
    box_px = np.asarray(annotation.details["box_px"], dtype=np.float64)
    drawn = _is_drawn(box_px)
    ignored_px = np.asarray(annotation.unboxed.get("dontcare_px", np.zeros((0, 4))), dtype=np.float64).reshape(-1, 4)
    return ImageMarks(
        camera=camera,
        box_px=box_px[drawn],
        row=np.flatnonzero(drawn),
        label=tuple(str(name) for name in np.asarray(annotation.boxes.label)[drawn]),
        ignored_px=ignored_px[_is_drawn(ignored_px)],
    )


def _is_drawn(box_px: Float[np.ndarray, "n 4"]) -> Bool[np.ndarray, " n"]:
    return np.asarray(np.isfinite(box_px).all(axis=1) & (box_px[:, 2:] > box_px[:, :2]).all(axis=1))


def projected_overlap(frame: Frame, marks: ImageMarks) -> Float[np.ndarray, " n"]:
    """How much each 2D box overlaps what its 3D box covers in the image (intersection over union), NaN where unseen.

    Args:
        frame: The frame.
        marks: Its 2D boxes.
    """
    camera: Camera | None = frame.cameras.get(marks.camera)
    boxes = frame.boxes
    if camera is None or boxes is None:
        return np.full(len(marks), np.nan)
    seen_px, _ = image_boxes(boxes[marks.row], camera)
    low, high = np.maximum(seen_px[:, :2], marks.box_px[:, :2]), np.minimum(seen_px[:, 2:], marks.box_px[:, 2:])
    shared = np.maximum(high - low, 0.0).prod(axis=1)
    areas = [(part[:, 2:] - part[:, :2]).prod(axis=1) for part in (seen_px, marks.box_px)]
    overlap = shared / np.maximum(areas[0] + areas[1] - shared, 1e-9)
    return np.where(_is_drawn(seen_px), overlap, np.nan)

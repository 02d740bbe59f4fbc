"""Camera pictures with points and boxes projected into them, and depth maps beside them."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8
from PIL import Image, ImageDraw

from farfield.figures.birds_eye import Tags, tags_of
from farfield.figures.style import INK, POINT, house_style, new_figure
from farfield.frame.image_marks import ImageMarks
from farfield.geometry.boxes import Boxes
from farfield.geometry.cameras import Camera
from farfield.vocabulary.classes import CLASS_COLOURS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_EDGES = ((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7))
_STEPS = 9  # an edge is bent by distortion, so it is drawn through so many points


def box_lines(boxes: Boxes, camera: Camera) -> list[Float[np.ndarray, "steps 2"]]:
    """Project the twelve edges of each box; edges that leave the picture are cut where they do.

    Args:
        boxes: Boxes in the frame that the camera's pose refers to.
        camera: A calibrated camera.

    Returns:
        Polylines in pixels, each of shape (steps, 2).
    """
    if not len(boxes):
        return []
    corners = boxes.corners_m()
    start, end = corners[:, [a for a, _ in _EDGES]], corners[:, [b for _, b in _EDGES]]
    share = np.linspace(0.0, 1.0, _STEPS)[:, None]
    along = start[:, :, None] + (end - start)[:, :, None] * share
    pixels, _, visible = camera.project(along.reshape(-1, 3))
    shape = (-1, _STEPS)
    return [
        line[inside]
        for line, inside in zip(pixels.reshape(*shape, 2), visible.reshape(shape), strict=True)
        if inside.sum() >= 2
    ]


def camera_picture(
    image: UInt8[np.ndarray, "height width 3"],
    camera: Camera | None,
    *,
    annotated: Boxes | None = None,
    predicted: Boxes | None = None,
    points_m: Float[np.ndarray, "n 3"] | None = None,
    marks: ImageMarks | None = None,
    title: str = "",
) -> "Figure":
    """Draw an image with projected points and boxes, in a colour a class (Cirrus, Figure 5); else the image alone.

    Args:
        image: Shape (height, width, 3), uint8.
        camera: Its calibration, or None: then nothing is projected.
        annotated: Annotated boxes, drawn solid.
        predicted: Predicted boxes, dashed where there are annotated ones too.
        points_m: Points in the frame of the boxes, shape (n, 3), drawn in a colour by range.
        marks: 2D boxes as they were annotated in this image, drawn dotted; regions to be ignored grey.
        title: Title.
    """
    height, width = image.shape[:2]
    with house_style():
        figure = new_figure(11.0, 11.0 * height / width + (0.3 if title else 0.0))
        axes = figure.add_subplot()
        axes.imshow(image, interpolation="antialiased")
        if camera is not None:
            if points_m is not None:
                _draw_points(axes, points_m, camera)
            for boxes, line_width in ((annotated, 2.0), (predicted, 1.2)):
                if boxes is not None:
                    style = "dashed" if boxes is predicted and annotated is not None else "solid"
                    _draw_boxes(axes, boxes, camera, line_width, style)
            tagged = annotated if predicted is None else predicted
            if tagged is not None:
                _draw_tags(Tags(axes, (0.0, float(width), 0.0, float(height)), INK), tagged, camera)
        if marks is not None:
            _draw_marks(axes, marks)
        axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))
        axes.set_axis_off()
        if title:
            axes.set_title(title)
    return figure


def _draw_points(axes: "Axes", points_m: Float[np.ndarray, "n 3"], camera: Camera) -> None:
    pixels, _, visible = camera.project(points_m)
    range_m = np.hypot(points_m[:, 0], points_m[:, 1])[visible]
    shown = pixels[visible]
    axes.scatter(shown[:, 0], shown[:, 1], c=range_m, s=1.2, cmap="viridis_r", linewidths=0, zorder=1)


def _draw_boxes(axes: "Axes", boxes: Boxes, camera: Camera, line_width: float, style: str) -> None:
    from matplotlib.collections import LineCollection

    labels = np.asarray(boxes.label)
    for name in dict.fromkeys(labels.tolist()):
        of_class, colour = boxes[labels == name], CLASS_COLOURS.get(name, POINT)
        lines = LineCollection(box_lines(of_class, camera), colors=colour, linewidths=line_width, linestyles=style)
        axes.add_collection(lines)


def _draw_marks(axes: "Axes", marks: ImageMarks) -> None:
    """The 2D boxes, in the colours of their classes."""
    from matplotlib.patches import Rectangle

    colours = [CLASS_COLOURS.get(name, POINT) for name in marks.label] + ["#808080"] * len(marks.ignored_px)
    for (left, top, right, bottom), colour in zip((*marks.box_px, *marks.ignored_px), colours, strict=True):
        corner, size = (float(left), float(top)), (float(right - left), float(bottom - top))
        axes.add_patch(Rectangle(corner, *size, fill=False, edgecolor=colour, linewidth=1.2, linestyle="dotted"))


def _draw_tags(tags: Tags, boxes: Boxes, camera: Camera) -> None:
    """Class and score above or below each box that is seen, the surest or nearest first, where none covers another."""
    if not len(boxes):
        return
    boxes = boxes[np.argsort(boxes.range_m if boxes.score is None else -boxes.score, kind="stable")]
    pixels, _, visible = camera.project(boxes.corners_m().reshape(-1, 3))
    labels = np.asarray(boxes.label).tolist()
    for label, corners, inside, tag in zip(
        labels, pixels.reshape(-1, 8, 2), visible.reshape(-1, 8), tags_of(boxes), strict=True
    ):
        if inside.any():
            (left, top), (right, bottom) = corners[inside].min(axis=0), corners[inside].max(axis=0)
            wide, high = tags.size(tag)
            tags.draw(
                tag, ((left, top - high), (right - wide, top - high), (left, bottom)), CLASS_COLOURS.get(label, POINT)
            )


# A picture with the LiDAR's points and the boxes in it, as Cirrus' Figure 5 has them.

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


# A depth map beside the camera's picture.

_COLOURS = "turbo_r"
_TICKS_M = (1, 2, 3, 5, 10, 20, 30, 50, 100, 200, 400)


def depth_picture(
    depth_m: Float32[np.ndarray, "h w"],
    measured: Bool[np.ndarray, "h w"],
    uncertainty_m: Float32[np.ndarray, "h w"],
    image: UInt8[np.ndarray, "h w channels"] | None = None,
    *,
    method: str = "",
    title: str = "",
) -> "Figure":
    """Draw the picture with its measured points, the depth over it (fainter where it is less sure), the uncertainty.

    Args:
        depth_m: Depth by pixel in metres, NaN where there is none, shape (h, w).
        measured: Where it was measured rather than interpolated, shape (h, w).
        uncertainty_m: How far it may be off, NaN where that is not known, shape (h, w).
        image: The camera's picture, if there is one.
        method: What filled the map.
        title: What stands above.
    """
    from matplotlib.colors import LogNorm

    height, width = depth_m.shape
    finite_m = depth_m[np.isfinite(depth_m)]
    nearest_m, farthest_m = (float(finite_m.min()), float(finite_m.max())) if finite_m.size else (1.0, 100.0)
    norm = LogNorm(nearest_m, max(farthest_m, nearest_m * 1.01))
    sure = np.isfinite(uncertainty_m).any()
    rows = 3 if sure else 2
    with house_style():
        figure = new_figure(10.0, rows * 9.0 * height / width + 0.9)
        axes = figure.subplots(rows, 1)
        grey = np.full((height, width), 0.15, np.float32) if image is None else image[..., :3].mean(axis=2) / 510
        for ax in axes:
            ax.set_axis_off()
        axes[0].imshow(grey if image is None else image, cmap="gray", vmin=0, vmax=1)
        v, u = np.nonzero(measured)
        axes[0].scatter(u, v, c=depth_m[v, u], s=1.2, lw=0, cmap=_COLOURS, norm=norm)
        axes[0].set_title(f"{title}{len(v):,} measured depths", fontsize=9)
        axes[1].imshow(grey, cmap="gray", vmin=0, vmax=1)
        certainty = _certainty(depth_m, uncertainty_m)
        shown = axes[1].imshow(depth_m, cmap=_COLOURS, norm=norm, alpha=certainty, interpolation="none")
        filled = np.isfinite(depth_m).mean()
        axes[1].set_title(f"{method}: {filled:.0%} of the pixels, fainter where less sure", fontsize=9)
        ticks = [tick for tick in _TICKS_M if nearest_m <= tick <= farthest_m]
        bar = figure.colorbar(shown, ax=list(axes[:2]), label="depth in m", ticks=ticks, format="%g", shrink=0.8)
        bar.minorticks_off()
        if sure:
            doubt = axes[2].imshow(uncertainty_m, cmap="magma", norm=LogNorm(0.02, 20), interpolation="none")
            axes[2].set_title("how far it may be off", fontsize=9)
            figure.colorbar(doubt, ax=axes[2], label="m", format="%g", shrink=0.8)
        for ax in axes:
            ax.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))
    return figure


def _certainty(
    depth_m: Float32[np.ndarray, "h w"], uncertainty_m: Float32[np.ndarray, "h w"]
) -> Float32[np.ndarray, "h w"]:
    """1 where the uncertainty is a hundredth of the depth or unknown, towards 0.3 where it is as large as the depth."""
    share = np.nan_to_num(uncertainty_m / depth_m, nan=0.0, posinf=1.0)
    return np.where(np.isfinite(depth_m), np.clip(1 - 0.7 * share, 0.3, 1), 0).astype(np.float32)

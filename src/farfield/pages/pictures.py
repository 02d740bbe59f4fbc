"""The pictures of one frame, with captions and alternative texts, ready to be put into a page."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from farfield.evaluation.objects import confident, of_classes
from farfield.evaluation.record import FrameView
from farfield.evaluation.sensing import kind_of, returns_word
from farfield.figures.birds_eye import RANGES_M, Window, filled_zooms, fitting_window, in_window, overview, zooms
from farfield.figures.camera import camera_picture
from farfield.figures.plots import scan_patterns
from farfield.figures.power_map import power_map
from farfield.figures.style import figure_uri
from farfield.figures.words import pattern_note, pattern_title
from farfield.frame import Frame
from farfield.geometry.boxes import Boxes
from farfield.metrics.presenting import HitRule
from farfield.pages.template import PageImage
from farfield.vocabulary.kradar import Bounds
from farfield.vocabulary.scores import SHOWN_SCORE

_DPI = 110  # of the points, which are counted at as many


@dataclass(frozen=True, kw_only=True)
class DrawingOptions:
    """How the frames of a page are drawn.

    Args:
        labels: Classes that count; None for all.
        score_min: Predictions below it are left out.
        finding: When an annotated box counts as found.
        edges_m: Edges of the range bins, which arcs mark.
        region_m: x, y and z from and to: where boxes count, in the frames' coordinates; None for everywhere.
    """

    labels: Collection[str] | None = None
    score_min: float = SHOWN_SCORE
    finding: HitRule = field(default_factory=HitRule)
    edges_m: tuple[float, ...] = RANGES_M
    region_m: Bounds | None = None

    def counting(self, boxes: Boxes, window_m: Window) -> Boxes:
        """The boxes that a caption counts: of the classes, in the region, and in the picture."""
        inside = of_classes(boxes, self.labels) & in_window(boxes.centre_m, window_m)
        if self.region_m is not None:
            low, high = np.reshape(self.region_m, (3, 2)).T
            inside &= ((boxes.centre_m >= low) & (boxes.centre_m < high)).all(axis=1)
        return boxes[inside]


def frame_pictures(view: FrameView, drawing: DrawingOptions) -> list[PageImage]:
    """Draw a frame: the whole window and the zooms of every cloud that was run, the radar's map, the camera's image.

    Args:
        view: The frame and its predictions.
        drawing: How.
    """
    pictures = []
    for name, predictions in view.by_cloud.items():
        pictures += _cloud_pictures(view, name, predictions, drawing)
    return [*pictures, *_radar_pictures(view, drawing), *_camera_pictures(view, drawing.score_min)]


def _cloud_pictures(view: FrameView, name: str, predictions: Boxes | None, drawing: DrawingOptions) -> list[PageImage]:
    annotated, cloud = view.frame.boxes, view.frame.cloud(name)
    predicted = None if predictions is None else confident(predictions, drawing.score_min)
    edges, kind = drawing.edges_m, kind_of(view.frame, name)
    window = fitting_window(cloud, annotated, predicted, edges_m=edges)
    start = f"{len(cloud):,} {returns_word(kind, many=True)}."
    caption = _caption(start, annotated, predicted, drawing, window)
    alt = f"Bird's-eye view of the {name} cloud to {window[1]:g} m, with annotated and predicted boxes"
    boxes: dict[str, Any] = {"annotated": annotated, "predicted": predicted, "labels": drawing.labels, "rings_m": edges}
    whole = overview(cloud, **boxes, window_m=window, point=returns_word(kind))
    pictures = [PageImage(figure_uri(whole, dpi=_DPI), alt, caption, heading=pattern_title(name))]
    parts = filled_zooms(cloud, annotated, predicted, edges_m=edges)
    if len(parts) > 1:
        enlarged = zooms(cloud, **boxes, windows_m=parts)
        pictures.append(PageImage(figure_uri(enlarged, dpi=_DPI), f"The same {name} view enlarged by range"))
    return pictures


def _caption(
    start: str, annotated: Boxes | None, predicted: Boxes | None, drawing: DrawingOptions, window_m: Window
) -> str:
    if predicted is None:
        return start
    sureness = f"score {drawing.score_min:g} or more"
    if annotated is None:
        return f"{start} {len(predicted)} predictions of {sureness}; this frame is not annotated."
    wanted, seen = drawing.counting(annotated, window_m), drawing.counting(predicted, window_m)
    where = "" if drawing.region_m is None else " in the region that counts"
    found = int((drawing.finding.found_by(seen, wanted) >= 0).sum())
    wrong = len(seen) - found
    return (
        f"{start} {found} of {len(wanted)} annotated objects{where} found {drawing.finding}, "
        f"{wrong} prediction{'' if wrong == 1 else 's'} without one ({sureness})."
    )


def _radar_pictures(view: FrameView, drawing: DrawingOptions) -> list[PageImage]:
    """The radar's power from above, where the frame has it in the coordinates of its boxes."""
    if view.radar_db is None:
        return []
    given = {name: boxes for name, boxes in view.by_cloud.items() if boxes is not None}
    order = sorted(given, key=lambda name: kind_of(view.frame, name) != "radar")  # the radar's own in the first colour
    kept = {name: confident(given[name], drawing.score_min) for name in order}
    predicted = kept if len(kept) > 1 else next(iter(kept.values()), None)
    figure = power_map(
        view.radar_db, annotated=view.frame.boxes, predicted=predicted, labels=drawing.labels, rings_m=drawing.edges_m
    )
    caption = "Mean power over height, in decibel: the brighter, the stronger."
    alt = "The radar's power seen from above, with annotated and predicted boxes"
    return [PageImage(figure_uri(figure, "jpg", dpi=110), alt, caption, heading="Radar map")]


def _camera_pictures(view: FrameView, score_min: float) -> list[PageImage]:
    pictures = []
    source, predictions = next(iter(view.by_cloud.items()), ("", None))
    predicted = None if predictions is None else confident(predictions, score_min)
    points_m = _points_to_project(view.frame, source)
    boxes: dict[str, Any] = {"annotated": view.frame.boxes, "predicted": predicted}
    for name, image in view.frame.images.items():
        camera = view.frame.cameras.get(name)
        figure = camera_picture(image, camera, **boxes, points_m=points_m)
        caption = f"{name}: no calibration, so no points and no boxes."
        if camera is not None:
            dashed = ", predicted ones dashed" if predicted is not None and view.frame.boxes is not None else ""
            points = "" if points_m is None else f"points of {source} in a colour by range, the nearest yellow, and "
            caption = f"{name}: {points}boxes in a colour a class{dashed}, projected with its calibration."
        pictures.append(
            PageImage(figure_uri(figure, "jpg", dpi=140), f"Image of the camera {name!r}", caption, heading="Camera")
        )
    return pictures


def _points_to_project(frame: Frame, cloud: str) -> Float[np.ndarray, "n 3"] | None:
    """A cloud's points, if they stand in the coordinates of the frame."""
    sensor = frame.sensors.get(cloud)
    if cloud not in frame.clouds or (sensor is not None and not sensor.in_frame):
        return None
    return frame.cloud(cloud).points_m


def pattern_picture(frame: Frame, edges_m: Sequence[float] = RANGES_M) -> PageImage:
    """Draw the LiDAR clouds of a frame side by side as the sensor saw them; ``edges_m`` are marked by arcs."""
    notes = " ".join(note for name in frame.clouds if (note := pattern_note(name)))
    return PageImage(
        figure_uri(scan_patterns(dict(frame.clouds), edges_m=edges_m)),
        f"The {' and '.join(frame.clouds)} scan patterns of one moment side by side, seen from the sensor, "
        "and their number of points by range",
        f"The same moment in {len(frame.clouds)} patterns: as the sensor sees it, from above, counted. {notes}".strip(),
    )

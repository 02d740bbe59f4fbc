"""The pictures of one frame, with captions and alternative texts, ready to be put into a page."""

from collections.abc import Collection
from dataclasses import dataclass

from farfield.frame import Frame
from farfield.geometry.boxes import Boxes
from farfield.metrics.centre.matching import found_by
from farfield.reports.camera import camera_picture
from farfield.reports.evaluation import FrameView
from farfield.reports.figures import Window, filled_zooms, fitting_window, in_window, overview, zooms
from farfield.reports.objects import of_classes, sure
from farfield.reports.plots import scan_patterns
from farfield.reports.style import figure_uri
from farfield.reports.words import pattern_note, pattern_title


@dataclass(frozen=True)
class Picture:
    """A picture in a page.

    Args:
        uri: ``data:`` address.
        alt: What it shows, for those who cannot see it.
        caption: What stands under it.
        heading: What stands above it.
    """

    uri: str
    alt: str
    caption: str = ""
    heading: str = ""


def frame_pictures(
    view: FrameView, *, labels: Collection[str] | None, score_min: float, window_m: Window | None = None
) -> list[Picture]:
    """Draw a frame: the whole window and the zooms of every cloud that was run, and the camera's image.

    Args:
        view: The frame and its predictions.
        labels: Classes that count.
        score_min: Predictions below it are left out.
        window_m: x from, x to, y from, y to; None takes 250 m, or 120 m where nothing lies beyond.
    """
    frame, pictures = view.frame, []
    annotated = frame.boxes
    for name, predictions in view.by_cloud.items():
        predicted = None if predictions is None else sure(predictions, score_min)
        cloud = frame.cloud(name)
        window = window_m or fitting_window(cloud, annotated, predicted)
        caption = _caption(len(cloud), annotated, predicted, labels, score_min, window)
        alt = f"Bird's-eye view of the {name} point cloud to {window[1]:g} m, with annotated and predicted boxes"
        whole = overview(cloud, annotated=annotated, predicted=predicted, labels=labels, window_m=window)
        pictures.append(Picture(figure_uri(whole), alt, caption, heading=pattern_title(name)))
        parts = filled_zooms(cloud, annotated, predicted)
        if len(parts) > 1:
            enlarged = zooms(cloud, annotated=annotated, predicted=predicted, labels=labels, windows_m=parts)
            pictures.append(Picture(figure_uri(enlarged), f"The same {name} view enlarged by range"))
    return pictures + _camera_pictures(view, score_min)


def _caption(
    points: int,
    annotated: Boxes | None,
    predicted: Boxes | None,
    labels: Collection[str] | None,
    score_min: float,
    window_m: Window,
) -> str:
    start = f"{points:,} points."
    if predicted is None:
        return start
    if annotated is None:
        return f"{start} {len(predicted)} predictions of score {score_min:g} or more; this frame is not annotated."
    wanted = annotated[of_classes(annotated, labels) & in_window(annotated.centre_m, window_m)]
    seen = predicted[in_window(predicted.centre_m, window_m)]
    found = int((found_by(seen, wanted) >= 0).sum())
    wrong = len(seen) - found
    return (
        f"{start} {found} of {len(wanted)} annotated objects found within 2 m, "
        f"{wrong} prediction{'' if wrong == 1 else 's'} without one (score {score_min:g} or more)."
    )


def _camera_pictures(view: FrameView, score_min: float) -> list[Picture]:
    pictures = []
    for name, image in view.frame.images.items():
        camera = view.frame.cameras.get(name)
        predictions = next(iter(view.by_cloud.values()), None)
        predicted = None if predictions is None else sure(predictions, score_min)
        figure = camera_picture(image, camera, annotated=view.frame.boxes, predicted=predicted)
        caption = (
            f"{name}: boxes projected with its calibration." if camera else f"{name}: no calibration, so no boxes."
        )
        pictures.append(
            Picture(figure_uri(figure, "jpg", dpi=140), f"Image of the camera {name!r}", caption, heading="Camera")
        )
    return pictures


def pattern_picture(frame: Frame) -> Picture:
    """Draw all clouds of a frame side by side as the sensor saw them."""
    notes = " ".join(note for name in frame.clouds if (note := pattern_note(name)))
    return Picture(
        figure_uri(scan_patterns(dict(frame.clouds))),
        f"The {' and '.join(frame.clouds)} scan patterns of one moment side by side, seen from the sensor, "
        "and their number of points by range",
        f"The same moment in {len(frame.clouds)} patterns: as the sensor sees it, from above, counted. {notes}".strip(),
    )

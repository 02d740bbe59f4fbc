"""One self-contained HTML page: scores by range, curves, pictures and what made them. It needs no network."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from farfield.evaluation.record import Evaluation, FrameView
from farfield.evaluation.report_data import confident, kind_of, of_classes, returns_word, scored_labels
from farfield.figures import report_text
from farfield.figures.birds_eye import RANGES_M, Window, filled_zooms, fitting_window, in_window, overview, zooms
from farfield.figures.camera import camera_picture
from farfield.figures.plots import points_against_range, precision_recall, scan_patterns
from farfield.figures.radar import power_map, weathers_picture
from farfield.figures.report_text import pattern_note, pattern_title
from farfield.figures.style import PATTERNS, figure_bytes, figure_uri
from farfield.figures.tables import class_rows, condition_tables, heading, range_name, rows, with_own_parts
from farfield.files.atomic import write_bytes, write_text
from farfield.frame import Frame
from farfield.geometry.boxes import Boxes
from farfield.metrics.comparing import protocol_family
from farfield.metrics.detections import presentation_of, protocol_of
from farfield.metrics.presenting import HitRule, Presentation, edges_m
from farfield.pages.template import PageImage, render_template
from farfield.vocabulary.counts import count_of
from farfield.vocabulary.kradar import REGIONS_M, Bounds
from farfield.vocabulary.scores import SHOWN_SCORE
from farfield.vocabulary.studio import studio_link

# The pictures of one frame, with captions and alternative texts, ready to be put into a page.

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
    whole_window = overview(cloud, **boxes, window_m=window, point=returns_word(kind))
    pictures = [PageImage(figure_uri(whole_window, dpi=_DPI), alt, caption, heading=pattern_title(name))]
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
        return f"{start} {count_of(len(predicted), 'prediction')} of {sureness}; this frame is not annotated."
    annotated_inside, predicted_inside = drawing.counting(annotated, window_m), drawing.counting(predicted, window_m)
    where = "" if drawing.region_m is None else " in the region that counts"
    num_found = int((drawing.finding.found_by(predicted_inside, annotated_inside) >= 0).sum())
    wrong = len(predicted_inside) - num_found
    is_part = drawing.labels is not None and not of_classes(annotated, drawing.labels).all()
    kinds = f" of {' and '.join(drawing.labels or ())}" if is_part else ""
    return (
        f"{start} {num_found} of {count_of(len(annotated_inside), 'annotated object')}{kinds}{where} found "
        f"{drawing.finding}, "
        f"{count_of(wrong, 'prediction')} without one ({sureness})."
    )


def _radar_pictures(view: FrameView, drawing: DrawingOptions) -> list[PageImage]:
    """The radar's power from above, where the frame has it in the coordinates of its boxes."""
    if view.radar_db is None:
        return []
    by_cloud = {name: boxes for name, boxes in view.by_cloud.items() if boxes is not None}
    order = sorted(
        by_cloud, key=lambda name: kind_of(view.frame, name) != "radar"
    )  # the radar's own in the first colour
    confident_boxes = {name: confident(by_cloud[name], drawing.score_min) for name in order}
    predicted = confident_boxes if len(confident_boxes) > 1 else next(iter(confident_boxes.values()), None)
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


Progress = Callable[[list[FrameView]], Iterable[FrameView]]
_WEATHERS_DPI = 110
_UNITS = ("m", "s", "ms", "ns", "rad", "deg", "hz")


def write_report(
    path: Path | str, evaluation: Evaluation, *, shown_score: float = SHOWN_SCORE, progress: Progress = iter
) -> Path:
    """Write the report page, all or nothing.

    Args:
        path: The HTML file to write.
        evaluation: What it shows.
        shown_score: Predictions below this score are left out of pictures.
        progress: Wraps the frames while they are drawn.

    Returns:
        The path.
    """
    path = Path(path)
    page = render_report(evaluation, shown_score=shown_score, progress=progress)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, page)
    return path


def render_report(evaluation: Evaluation, *, shown_score: float = SHOWN_SCORE, progress: Progress = iter) -> str:
    """Return the page as HTML; arguments as in :func:`write_report`."""
    results = evaluation.results
    first = next(iter(results.values()), {})
    protocol, edges = protocol_of(first), edges_m(first) or RANGES_M
    shown = presentation_of(first)
    kinds = {kind_of(view.frame, name) for view in evaluation.frames for name in view.frame.clouds}
    drawing = DrawingOptions(
        labels=scored_labels(results),
        score_min=shown_score,
        finding=shown.finding,
        edges_m=tuple(edges),
        region_m=_region(first, evaluation.frames),
    )
    own_parts = with_own_parts(results, evaluation.parts)
    tables = condition_tables(own_parts, shown.figures, protocol, shown.kinds)
    return render_template(
        "page.html",
        {**_FILTERS, "heading": partial(heading, protocol), "unit": protocol.presenter.unit},
        title=evaluation.title,
        headline=report_text.headline(results, protocol, shown),
        scope=report_text.scope(results),
        subjects=report_text.subjects(results),
        notes=report_text.notes(results),
        origin=report_text.origin(evaluation.provenance),
        glossary=report_text.glossary(shown, kinds),
        colours=PATTERNS,
        shown=shown,
        score_rows=rows(results, shown.figures, protocol),
        part_rows=rows(results, shown.parts, protocol),
        detail_rows=rows(results, [name for _, names in shown.groups for name in names], protocol),
        condition_tables=tables,
        gaussian=any(name == "gaussian" for name in results),
        class_rows=class_rows(evaluation.parts, shown.figures, protocol),
        result_names=list(results),
        curves=_curves(results, shown),
        patterns=_patterns(evaluation.frames, edges),
        studio_link=studio_link,
        frames=[(view, frame_pictures(view, drawing)) for view in progress(evaluation.frames)],
        arcs=report_text.metres(edges),
        points=_points(evaluation.objects, edges),
        shown_score=shown_score,
        settings=evaluation.settings,
        provenance=evaluation.provenance,
        conventions={name: _convention(result) for name, result in results.items()},
    )


def _convention(result: Mapping[str, Any]) -> dict[str, Any]:
    """The settings on which a result's figures depend, with the class, the range bins and how intervals are drawn."""
    settings = result.get("settings") or {}
    beside = {name: settings[name] for name in ("label", "classes", "range_bins_m", "bootstrap") if name in settings}
    protocol = protocol_of(result)
    shown_settings = {**protocol.depends_on(settings), **beside}
    return {
        "protocol": result.get("protocol"),
        **{protocol.presenter.setting_title(name): v for name, v in shown_settings.items()},
    }


def _region(result: Mapping[str, Any], frames: Sequence[FrameView]) -> Bounds | None:
    """The region in which boxes count, where it is a K-Radar's and the frames stand in the radar's coordinates."""
    region = (result.get("settings") or {}).get("region")
    if protocol_family(result) != "kradar" or any(view.frame.reference != "radar" for view in frames):
        return None
    bounds = REGIONS_M.get(region) if isinstance(region, str) else region
    return tuple(bounds) if isinstance(bounds, list | tuple) and len(bounds) == 6 else None


def _curves(results: Mapping[str, Mapping[str, Any]], shown: Presentation) -> PageImage | None:
    having = {name: result for name, result in results.items() if protocol_of(result).presenter.curves(result)}
    if not having:
        return None
    return PageImage(
        figure_uri(precision_recall(having)),
        f"Precision over recall for {', '.join(having)}",
        f"{shown.about_curves} A line that stays high and reaches far to the right is good; its dot is the highest "
        "recall reached.".strip(),
    )


def _patterns(frames: Sequence[FrameView], edges: Sequence[float]) -> PageImage | None:
    """The scan patterns of one moment side by side, where a frame has several of them."""
    for view in frames:
        if len(view.frame.clouds) > 1 and any(report_text.pattern_note(name) for name in view.frame.clouds):
            return pattern_picture(view.frame, edges)
    return None


def _points(objects: Mapping[str, Mapping[str, Any]], edges: Sequence[float]) -> PageImage | None:
    having = {name: rows for name, rows in objects.items() if rows.get("range_m")}
    if not having:
        return None
    limits = next(iter(having.values()))
    rule = limits.get("finding") or f"within {limits.get('distance_m', 2):g} m"
    return PageImage(
        figure_uri(points_against_range(having, edges_m=edges)),
        f"Points inside each annotated box over its range for {', '.join(having)}, found and missed in two colours",
        f"Each dot is one annotated object. Found: {rule}, by a prediction of score "
        f"{limits.get('score_min', 0):g} or more.",
    )


def _fact_name(name: str) -> str:
    stem, _, unit = name.rpartition("_")
    return (f"{stem} ({unit})" if stem and unit in _UNITS else name).replace("_", " ")


_FILTERS: dict[str, Callable[..., Any]] = {
    "range_name": range_name,
    "fact_name": _fact_name,
    "pattern_title": report_text.pattern_title,
}


def write_weathers(evaluation: Evaluation, folder: Path, *, picture: str) -> tuple[Path, Path]:
    """Write the evaluation, its page and the picture of its moment into a folder.

    Args:
        evaluation: Of :func:`farfield.evaluation.weathers.evaluate_weathers`, the radar's detector first.
        folder: Where; made if absent.
        picture: Name of the picture, ``.jpg`` or ``.png``.

    Returns:
        The paths of the page and of the picture.
    """
    radar, lidar = evaluation.results
    evaluation.save(folder)
    drawn = weathers_picture(evaluation.frames, radar=radar, lidar=lidar)
    write_bytes(folder / picture, figure_bytes(drawn, "png" if picture.endswith(".png") else "jpg", dpi=_WEATHERS_DPI))
    return write_report(folder / "report.html", evaluation), folder / picture

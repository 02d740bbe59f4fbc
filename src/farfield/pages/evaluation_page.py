"""One self-contained HTML page: scores by range, curves, pictures and what made them. It needs no network."""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from farfield.evaluation.record import Evaluation, FrameView
from farfield.evaluation.results import scored_labels
from farfield.evaluation.sensing import kind_of
from farfield.figures import words
from farfield.figures.birds_eye import RANGES_M
from farfield.figures.parts import class_rows, condition_tables, with_own_parts
from farfield.figures.plots import points_against_range, precision_recall
from farfield.figures.style import PATTERNS, figure_uri
from farfield.figures.tables import heading, range_name, rows
from farfield.files.atomic import write_text
from farfield.metrics.conventions import protocol_family
from farfield.metrics.presenting import Presentation, edges_m
from farfield.metrics.protocol import protocol_of
from farfield.pages.pictures import DrawingOptions, frame_pictures, pattern_picture
from farfield.pages.template import PageImage, render_template
from farfield.vocabulary.kradar import REGIONS_M, Bounds
from farfield.vocabulary.scores import SHOWN_SCORE
from farfield.vocabulary.studio import studio_link

Progress = Callable[[list[FrameView]], Iterable[FrameView]]
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
    shown = protocol.presentation(first)
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
        {**_FILTERS, "heading": partial(heading, protocol), "unit": protocol.unit},
        title=evaluation.title,
        headline=words.headline(results, protocol, shown),
        scope=words.scope(results),
        subjects=words.subjects(results),
        notes=words.notes(results),
        origin=words.origin(evaluation.provenance),
        glossary=words.glossary(shown, kinds),
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
        arcs=words.metres(edges),
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
    known = {**protocol.depends_on(settings), **beside}
    return {"protocol": result.get("protocol"), **{protocol.setting_title(name): v for name, v in known.items()}}


def _region(result: Mapping[str, Any], frames: Sequence[FrameView]) -> Bounds | None:
    """The region in which boxes count, where it is a K-Radar's and the frames stand in the radar's coordinates."""
    region = (result.get("settings") or {}).get("region")
    if protocol_family(result) != "kradar" or any(view.frame.reference != "radar" for view in frames):
        return None
    bounds = REGIONS_M.get(region) if isinstance(region, str) else region
    return tuple(bounds) if isinstance(bounds, list | tuple) and len(bounds) == 6 else None


def _curves(results: Mapping[str, Mapping[str, Any]], shown: Presentation) -> PageImage | None:
    having = {name: result for name, result in results.items() if protocol_of(result).curves(result)}
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
        if len(view.frame.clouds) > 1 and any(words.pattern_note(name) for name in view.frame.clouds):
            return pattern_picture(view.frame, edges)
    return None


def _points(objects: Mapping[str, Mapping[str, Any]], edges: Sequence[float]) -> PageImage | None:
    having = {name: each for name, each in objects.items() if each.get("range_m")}
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


def _fact_text(value: Any) -> str:
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "–"}[value]
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, str | int):
        return str(value)
    if isinstance(value, list | tuple) and all(isinstance(each, str | int | float) for each in value):
        return ", ".join(_fact_text(each) for each in value) or "none"
    if isinstance(value, Mapping):
        return ", ".join(f"{key}: {_fact_text(each)}" for key, each in value.items()) or "none"
    return json.dumps(value, default=str)


_FILTERS: dict[str, Callable[..., Any]] = {
    "range_name": range_name,
    "shown": _fact_text,
    "fact_name": _fact_name,
    "pattern_title": words.pattern_title,
}

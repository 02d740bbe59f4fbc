"""One self-contained HTML page: scores by range, curves, pictures and what made them. It needs no network."""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from farfield.files.atomic import write_text
from farfield.reports import words
from farfield.reports.evaluation import Evaluation, FrameView
from farfield.reports.parts import class_rows, condition_tables
from farfield.reports.pictures import Picture, frame_pictures, pattern_picture
from farfield.reports.plots import points_against_range, precision_recall
from farfield.reports.results import ap_names, epsilons, scored_labels
from farfield.reports.style import PATTERNS, figure_uri
from farfield.reports.tables import range_name, rows, score_names, score_title
from farfield.reports.template import render_template
from farfield.vocabulary.studio import studio_link

_UNITS = ("m", "s", "ms", "ns", "rad", "deg", "hz")
CURVE_EPSILONS = (0.0, 0.006)


def write_report(
    path: Path | str,
    *,
    title: str,
    results: Mapping[str, Mapping[str, Any]],
    frames: Sequence[FrameView] = (),
    settings: Mapping[str, Any] | None = None,
    provenance: Mapping[str, Any] | None = None,
    objects: Mapping[str, Mapping[str, Any]] | None = None,
    parts: Mapping[str, Mapping[str, Any]] | None = None,
    shown_score: float = 0.3,
) -> Path:
    """Write the report page, all or nothing.

    Args:
        path: The HTML file to write.
        title: Its title.
        results: Result JSON (what ``farfield score`` writes) by pattern or data set name.
        frames: Frames to show.
        settings: What the detector and the run were set to.
        provenance: Versions, seed, commit, data fingerprint, ``simulated`` (bool), ``trained_on``.
        objects: Annotated objects by result name, see :func:`farfield.reports.objects.annotated_objects`.
        parts: Figures by condition and sector and rows of all classes, see :class:`Evaluation`.
        shown_score: Predictions below this score are left out of pictures.

    Returns:
        The path.
    """
    path = Path(path)
    page = render(
        Evaluation(
            title=title,
            results=results,
            frames=list(frames),
            settings=settings or {},
            provenance=provenance or {},
            objects=objects or {},
            parts=parts or {},
        ),
        shown_score=shown_score,
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, page)
    return path


def render(evaluation: Evaluation, *, shown_score: float = 0.3) -> str:
    """Return the page as HTML; arguments as in :func:`write_report`."""
    results = evaluation.results
    labels = scored_labels(results)
    dds, aps = score_names(results), ap_names(results)
    names = dds or aps
    parts = ["dds/0/map", "dds/0/aiou", *aps] if dds else []
    all_epsilons = sorted({name for result in results.values() for name in epsilons(result)}, key=float)
    return render_template(
        "page.html",
        _FILTERS,
        title=evaluation.title,
        headline=words.headline(results),
        scope=words.scope(results),
        origin=words.origin(evaluation.provenance),
        glossary=words.GLOSSARY,
        colours=PATTERNS,
        names=names,
        score_rows=rows(results, names),
        parts=parts,
        part_rows=rows(results, parts),
        all_epsilons=all_epsilons,
        detail_rows=rows(results, [f"dds/{e}/{part}" for e in all_epsilons for part in ("dds", "map", "aiou")]),
        condition_tables=condition_tables(evaluation.parts, names),
        class_rows=class_rows(evaluation.parts, names),
        result_names=list(results),
        curves=_curves(results),
        patterns=_patterns(evaluation.frames),
        studio_link=studio_link,
        frames=[(view, frame_pictures(view, labels=labels, score_min=shown_score)) for view in evaluation.frames],
        points=_points(evaluation.objects),
        shown_score=shown_score,
        settings=evaluation.settings,
        provenance=evaluation.provenance,
        conventions={name: result.get("settings") or {} for name, result in results.items()},
    )


def _curves(results: Mapping[str, Mapping[str, Any]]) -> Picture | None:
    having = {name: result for name, result in results.items() if result.get("curves")}
    if not having:
        return None
    return Picture(
        figure_uri(precision_recall(having, epsilons=CURVE_EPSILONS)),
        f"Precision over recall for {', '.join(having)}, at epsilon 0 and 0.006, one line for each distance threshold",
        "Each line allows another distance between the predicted and the annotated centre. A line that stays high and "
        "reaches far to the right is good; its dot is the highest recall reached.",
    )


def _patterns(frames: Sequence[FrameView]) -> Picture | None:
    paired = next((view for view in frames if len(view.frame.clouds) > 1), None)
    return None if paired is None else pattern_picture(paired.frame)


def _points(objects: Mapping[str, Mapping[str, Any]]) -> Picture | None:
    having = {name: each for name, each in objects.items() if each.get("range_m")}
    if not having:
        return None
    limits = next(iter(having.values()))
    return Picture(
        figure_uri(points_against_range(having)),
        f"Points inside each annotated box over its range for {', '.join(having)}, found and missed in two colours",
        f"Each dot is one annotated object. Found: a prediction of score {limits.get('score_min', 0):g} or more lies "
        f"within {limits.get('distance_m', 2):g} m of it, seen from above.",
    )


def _fact_name(name: str) -> str:
    stem, _, unit = name.rpartition("_")
    return (f"{stem} ({unit})" if stem and unit in _UNITS else name).replace("_", " ")


def _shown(value: Any) -> str:
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "–"}[value]
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, str | int):
        return str(value)
    if isinstance(value, list | tuple) and all(isinstance(each, str | int | float) for each in value):
        return ", ".join(_shown(each) for each in value) or "none"
    if isinstance(value, Mapping):
        return ", ".join(f"{key}: {_shown(each)}" for key, each in value.items()) or "none"
    return json.dumps(value, default=str)


_FILTERS: dict[str, Callable[..., Any]] = {
    "range_name": range_name,
    "score_title": score_title,
    "shown": _shown,
    "fact_name": _fact_name,
    "pattern_title": words.pattern_title,
}

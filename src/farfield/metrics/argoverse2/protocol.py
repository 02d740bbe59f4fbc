"""Argoverse 2's detection metrics as a protocol."""

from collections.abc import Collection, Mapping
from typing import Any

from farfield.metrics.argoverse2.evaluation import (
    MEANS,
    Argoverse2Result,
    evaluate_argoverse2,
    weighted_argoverse2,
)
from farfield.metrics.argoverse2.settings import CATEGORIES, Argoverse2Settings
from farfield.metrics.bootstrap import Weighted
from farfield.metrics.detections import Detections
from farfield.metrics.frames import labels_of
from farfield.metrics.presenting import CurvePanel, HitRule, Presentation, Presenter, curve_level, panels
from farfield.metrics.result import figure_names, value_at
from farfield.metrics.several_classes import SeveralClassProtocol
from farfield.vocabulary.classes import CIRRUS_FROM_ARGOVERSE2


class Argoverse2Presenter(Presenter):
    """How Argoverse2Protocol is shown."""

    def title(self, figure: str) -> str:
        """Category and figure: ``mean of all CDS``, ``PEDESTRIAN AP 0.5 m``."""
        *path, last = figure.removeprefix("ap/").split("/")
        kind, _, distance = last.partition("_")
        words = f"{kind.upper()} {distance} m" if distance else kind.upper()
        return " ".join([*(word.replace("_", " ") for word in path), words])

    def unit(self, figure: str) -> str:
        """Metres and radians of the errors."""
        return {"ate": "m", "aoe": "rad"}.get(figure.rpartition("/")[2], "")

    def presentation(self, result: Mapping[str, Any]) -> Presentation:
        """CDS of the means and of each category, then what it is made of."""
        names, settings = figure_names(result), result.get("settings") or {}
        limit = settings.get("error_threshold_m")
        limit_m = float(limit) if isinstance(limit, int | float) else 2.0
        scores = [name for name in names if name.endswith("/cds")]
        return Presentation(
            figures=tuple(scores) or tuple(names),
            about="CDS is AP times the mean of how right place, size and heading of the matches are. The mean of all "
            "takes a category that nobody annotated for 0, as Argoverse 2's own kit does.",
            parts=tuple(name for name in names if name not in scores and _is_mean(name)),
            parts_title="AP and errors, means",
            about_parts=f"Errors are those of matches within {limit_m:g} m: distance, size and heading.",
            groups=tuple((_label_of(name), tuple(n for n in names if n.startswith(name[:-3]))) for name in scores),
            groups_title="Each category",
            about_curves="Each line is a largest distance between the centres.",
            glossary=_GLOSSARY,
            finding=HitRule("centre", limit_m),
        )

    def curves(self, result: Mapping[str, Any]) -> list[CurvePanel]:
        """A panel for each annotated category."""
        shown = []
        for label, node in curve_level((result.get("curves") or {}).get("overall"), "overall").items():
            named = {f"within {name} m": curve for name, curve in curve_level(node, label).items()}
            shown += [CurvePanel(label.replace("_", " "), panel.lines) for panel in panels(named)]
        return shown


class Argoverse2Protocol(SeveralClassProtocol):
    """Argoverse 2's AP, ATE, ASE, AOE and CDS."""

    name = "argoverse2"
    Settings = Argoverse2Settings
    presenter = Argoverse2Presenter()
    classes = CIRRUS_FROM_ARGOVERSE2

    def classes_of(self, detections: Detections, relabel: Mapping[str, str]) -> tuple[str, ...]:
        """The 26 categories where any of them occurs; else the classes that are annotated, as one's own data have."""
        present = [name for name, _ in labels_of(detections.annotated, relabel)]
        if not present or set(present) & set(CATEGORIES):
            return CATEGORIES
        return tuple(sorted(name for name in present if "/" not in name))

    def labels(self, boxes: Any, **options: Any) -> tuple[str, ...]:
        """The classes that occur, the most frequent first."""
        options = self.with_own_relabel(options)
        chosen = options.get("classes")
        names = (name for name, _ in labels_of(boxes, options.get("relabel") or {}))
        return tuple(name for name in names if chosen is None or name in chosen)

    def evaluate(self, detections: Detections, settings: Argoverse2Settings) -> Argoverse2Result:
        """The figures by category and range."""
        return evaluate_argoverse2(detections.boxes, detections.annotated, settings, drives=detections.drives)

    def weighted(self, detections: Detections, settings: Argoverse2Settings) -> Weighted:
        """The figures of the whole and of each range bin as functions of group weights."""
        return weighted_argoverse2(detections.boxes, detections.annotated, settings, drives=detections.drives)

    def headline(self, result: Mapping[str, Any]) -> Mapping[str, float | None]:
        """CDS and AP: of all categories, of the annotated ones, then of each."""
        names = [name for name in figure_names(result) if name.rpartition("/")[2] in ("cds", "ap")]
        return {name: value_at(result, name) for name in sorted(names, key=_rank)}

    def compared(self, result: Mapping[str, Any]) -> tuple[str, ...]:
        """The two means, then the categories that are annotated."""
        counts = (result.get("counts") or {}).get("classes") or {}
        classes = (result.get("settings") or {}).get("classes") or ()
        return (*MEANS, *(name for name in classes if (counts.get(name) or {}).get("annotated", 1)))

    def inert(self, settings: Mapping[str, Any]) -> Collection[str]:
        """As of every protocol of several classes; the categories bear on the means."""
        return [name for name in super().inert(settings) if name != "classes"]

    def convention_text(self, settings: Mapping[str, Any], *, by_range: bool = False) -> str:
        """The settings on which figures depend in one line, the 26 categories in a word."""
        whole = tuple(settings.get("classes") or ()) == CATEGORIES
        shown = {**settings, "classes": "all 26"} if whole else settings
        return super().convention_text(shown, by_range=by_range)


_GLOSSARY = (
    ("CDS", "Composite detection score: AP times the mean of 1 - ATE / 2 m, 1 - ASE and 1 - AOE / pi."),
    ("ATE, ASE, AOE", "Mean errors of the matches: distance in metres, size from 0 to 1, heading in radians."),
)


def _label_of(name: str) -> str:
    """The category or mean of a figure, ``ap/BUS/cds``; of a name without one, as in a changed file, all of it."""
    return name.split("/")[1] if "/" in name else name


def _is_mean(name: str) -> bool:
    return _label_of(name) in MEANS


def _rank(name: str) -> tuple[bool, bool, int]:
    label = _label_of(name)
    return not _is_mean(name), not name.endswith("/cds"), MEANS.index(label) if label in MEANS else 0

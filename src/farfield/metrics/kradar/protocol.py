"""K-Radar's average precision as protocols: by condition and visibility, and as the development kit computes it."""

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

from farfield.errors import ConfigError
from farfield.frame.drive import Key
from farfield.metrics.bootstrap import Weighted
from farfield.metrics.detections import Detections, Protocol
from farfield.metrics.frames import BoxesByFrame, labels_of
from farfield.metrics.kradar.evaluation import KRadarResult, evaluate_kradar, weighted_kradar
from farfield.metrics.kradar.settings import VARIANTS, KRadarSettings, kradar_settings
from farfield.metrics.options import option_text
from farfield.metrics.presenting import CurvePanel, HitRule, Presentation, Presenter, curve_level, panels
from farfield.metrics.result import figure_names
from farfield.vocabulary.classes import CIRRUS_FROM_ANY_KRADAR, CIRRUS_FROM_KRADAR
from farfield.vocabulary.counts import count_of

_FIRST = ("label_version", "region", "azimuth_deg", "score_cut", "recall_points", "empty_frames", "yaw")
_UNSAID = ("relabel", "origin_m")


class KRadarPresenter(Presenter):
    """How KRadarProtocol is shown."""

    per_cent = True

    def title(self, figure: str) -> str:
        """Class, overlap and its least value: ``vehicle AP3D 0.3``."""
        path = figure.removeprefix("ap/").split("/")
        if len(path) < 2 or path[-2] not in _MEASURES:
            return super().title(figure)
        return " ".join([*(word.replace("_", " ") for word in path[:-2]), _MEASURES[path[-2]], path[-1]])

    def presentation(self, result: Mapping[str, Any]) -> Presentation:
        """AP at the least overlap by class, by weather first; then the stricter overlaps."""
        names, settings = figure_names(result), result.get("settings") or {}
        ious = [iou for iou in settings.get("ious") or () if isinstance(iou, int | float)]
        least = min(ious, default=0.3)
        first = [name for name in names if name.endswith(f"/{least:g}")]
        return Presentation(
            figures=tuple(sorted(first, key=_bev_last)) or tuple(names),
            about=f"A prediction finds a box that it overlaps by more than {least:g}, in space (AP3D) or seen from "
            f"above (APBEV). AP is the mean precision at {settings.get('recall_points', 'several')} recalls.",
            parts=tuple(name for name in names if name not in first),
            parts_title="At stricter overlaps",
            about_parts="The number is the overlap that a prediction must exceed.",
            about_curves="Each line is for another least overlap.",
            glossary=_GLOSSARY,
            kinds=("weather", "road", "time", "visibility", "azimuth"),
            conditions_first=True,
            finding=HitRule("3d", float(least)),
        )

    def curves(self, result: Mapping[str, Any]) -> list[CurvePanel]:
        """A panel for each class and overlap, in space first."""
        shown = []
        for label, node in curve_level((result.get("curves") or {}).get("overall"), "overall").items():
            measures = curve_level(node, label)
            for measure in sorted(measures):
                title = f"{label.replace('_', ' ')}, {_MEASURES.get(measure, measure)}"
                named = {f"overlap {iou}": curve for iou, curve in curve_level(measures[measure], title).items()}
                shown += [CurvePanel(title, panel.lines) for panel in panels(named)]
        return shown


class KRadarProtocol(Protocol):
    """K-Radar's average precision with boxes as they stand."""

    name = "kradar"
    family = "kradar"
    Settings = KRadarSettings
    presenter = KRadarPresenter()
    uses = frozenset({"conditions", "visibility"})
    several_classes = True
    classes = CIRRUS_FROM_KRADAR

    @property
    def fixed(self) -> Mapping[str, Any]:
        """Settings that cannot be chosen."""
        return {}

    def settings(self, detections: Detections, **options: Any) -> KRadarSettings:
        """The settings; unless given, the classes are those that the detector knows, as far as it says so.

        The coordinates of the boxes and the annotations' version are those of the detections. ``label`` is one class.
        """
        options = self.with_own_relabel(options)
        label, relabel = options.pop("label", None), options.get("relabel", CIRRUS_FROM_ANY_KRADAR)
        if label is not None:
            options["classes"] = (relabel.get(label, label),)
        defaults: dict[str, Any] = {}
        if detections.classes and "classes" not in self.fixed:
            defaults["classes"] = tuple(dict.fromkeys(relabel.get(name, name) for name in detections.classes))
        if detections.reference:
            defaults["boxes_in"] = "radar" if detections.reference == "radar" else "os2-64"
            named = detections.reference in ("radar", "os2-64")
            if named and options.get("boxes_in", detections.reference) != detections.reference:
                raise ConfigError(
                    f"boxes_in: expected {defaults['boxes_in']}, as the boxes say that they stand in the coordinates "
                    f"of {detections.reference}; got {options['boxes_in']}. Leave boxes_in out"
                )
        settings = kradar_settings(str(self), **{**defaults, **options})
        version = detections.facts.get("label_version")
        return replace(settings, label_version=version) if version and "label_version" not in options else settings

    def labels(self, boxes: BoxesByFrame, **options: Any) -> tuple[str, ...]:
        """The classes of the settings that occur, the most frequent first."""
        options = self.with_own_relabel(options)
        settings = kradar_settings(
            str(self), **{name: options[name] for name in ("relabel", "classes") if name in options}
        )
        return tuple(name for name, _ in labels_of(boxes, settings.relabel) if name in settings.classes)

    def each(self, detections: Detections, *, label: str | None = None, **options: Any) -> list[KRadarSettings]:
        """One result for all classes; refused if none of them is annotated but others are."""
        settings = self.settings(detections, label=label, **options)
        present = [name for name, _ in labels_of(detections.annotated, settings.relabel)]
        if present and not set(present) & set(settings.classes):
            raise ConfigError(
                f"{self}: expected annotated boxes of {' or '.join(settings.classes)}, got {', '.join(present[:8])}. "
                "Choose with --label, --options classes=a,b or rename with --options relabel=old:new"
            )
        return [settings]

    def evaluate(self, detections: Detections, settings: KRadarSettings) -> KRadarResult:
        """AP by class, measure and overlap, by range, and by condition and visibility where these are known."""
        visibility = _visibility(detections)
        result = evaluate_kradar(
            detections.boxes,
            detections.annotated,
            settings,
            conditions=detections.conditions,
            visibility=visibility or None,
            protocol=str(self),
            drives=detections.drives,
        )
        notes = []
        lacking = [
            key for key, annotation in detections.annotations.items() if len(annotation) and key not in visibility
        ]
        if visibility and lacking:
            notes.append(
                f"{len(lacking)} of {count_of(len(detections.annotations), 'annotated frame')} "
                "do not say which sensor sees their "
                f"boxes (the first: {' '.join(lacking[0])}); in the figures by visibility these may be found or not"
            )
        if settings.label_version != self.fixed.get("label_version", settings.label_version):
            published = self.fixed["label_version"]
            notes.append(f"{self} stands for results on labels {published}; these are {settings.label_version}")
        return replace(result, notes=(*result.notes, *notes))

    def weighted(self, detections: Detections, settings: KRadarSettings) -> Weighted:
        """AP of the whole, by range, condition and visibility as functions of group weights."""
        return weighted_kradar(
            detections.boxes,
            detections.annotated,
            settings,
            conditions=detections.conditions,
            visibility=_visibility(detections) or None,
            drives=detections.drives,
        )

    def inert(self, settings: Mapping[str, Any]) -> Collection[str]:
        """Besides those of every protocol: overlaps and classes, which have figures of their own.

        The classes bear on all figures where frames without any of them are dropped.
        """
        names = [*super().inert(settings), "ious", "boxes_in", "range_bins_m"]
        names += ["azimuth_deg", "outside"] if settings.get("region") == "none" else []
        return [*names, *(["classes"] if settings.get("empty_frames") == "counted" else [])]

    def convention_text(self, settings: Mapping[str, Any], *, by_range: bool = False) -> str:
        """The settings on which figures depend in one line, those that vary between publications first."""
        shown = self.depends_on(settings, by_range=by_range)
        shown = {name: value for name, value in shown.items() if name not in _UNSAID}
        return option_text({name: shown[name] for name in _FIRST if name in shown} | shown)


_MEASURES = {"3d": "AP3D", "bev": "APBEV"}
_GLOSSARY = (
    (
        "Overlap",
        "The intersection of two boxes over their union (IoU): 1 for equal boxes, 0 for boxes apart.",
    ),
    ("AP3D, APBEV", "Average precision of boxes that overlap in space, or seen from above."),
    ("Region", "Boxes count by their place seen from the radar: in a narrow corridor, or in a wide field."),
    (
        "Visibility",
        "Which sensor sees an annotated object: the radar, the LiDAR alone, or not known. What is of the other kinds "
        "may be found or not.",
    ),
)


def _bev_last(name: str) -> bool:
    return "/bev/" in name


def _visibility(detections: Detections) -> dict[Key, tuple[str, ...]]:
    """Which sensor sees each annotated box, of the frames that say so."""
    return {key: tuple(a.visibility) for key, a in detections.annotations.items() if a.visibility is not None}


class KRadarCompat(KRadarProtocol):
    """K-Radar's average precision as its development kit computes it, by variant.

    Args:
        variant: One of :data:`farfield.metrics.kradar.settings.VARIANTS`.
    """

    name = "kradar-compat"

    def __init__(self, variant: str = "") -> None:
        self.variant = variant

    def __str__(self) -> str:
        return f"{self.name}:{self.variant}" if self.variant else self.name

    @property
    def fixed(self) -> Mapping[str, Any]:
        """Settings that the variant fixes."""
        return VARIANTS.get(self.variant, {})

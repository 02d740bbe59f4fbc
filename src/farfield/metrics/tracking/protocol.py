"""Scores of tracks as a protocol."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from farfield.metrics.detections import Detections, Protocol
from farfield.metrics.options import json_options
from farfield.metrics.presenting import Presenter
from farfield.metrics.result import Result, table, value_at
from farfield.metrics.tracking.clear import Figures, count, integrate, match
from farfield.metrics.tracking.hota import Hota, identity_f1, without_ignored
from farfield.metrics.tracking.scene import TrackingSettings, gather

_HEADLINE = ("sAMOTA", "AMOTA", "AMOTP", "MOTA", "MOTP", "HOTA", "DetA", "AssA", "IDF1")
_OF_TRACKS = ("MT", "ML", "tracks")
"""Counts of whole tracks, which no range bin has."""


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class TrackingResult(Result):
    """Scores of tracks; figures lie in [0, 1] or are counts, the table shows per cent and counts."""

    def __str__(self) -> str:
        parts = [*self.ranges, "overall"]
        rows = [[name.replace("/", " "), *(self._cell(part, name) for part in parts)] for name in self.figures]
        title = f"Tracks of {self.label!r}: rates in per cent, and counts, by range in metres; '-': not there"
        return f"{title}\n\n{table(['', *parts], rows)}\n\n{self.footer()}"

    def _cell(self, part: str, name: str) -> str:
        value = (self.figures if part == "overall" else self.ranges[part]).get(name)
        if name.split("/")[1] in ("IDS", "FRAG", "TP", "FP", "FN", *_OF_TRACKS):
            return "-" if value is None else f"{value:.0f}"
        return self.cell(part, name, scale=1.0 if name.endswith("threshold") else 100.0)


class TrackingPresenter(Presenter):
    """How Tracking is shown."""

    def title(self, figure: str) -> str:
        """The rate's own name."""
        return figure.removeprefix("tracking/").replace("/", " ")


class Tracking(Protocol):
    """CLEAR MOT with AB3DMOT's integrals, HOTA and identity F1.

    ``tracking/MOTA``, ``MOTP``, ``IDS``, ``FRAG`` and counts are those of the tracks whose score reaches
    ``tracking/threshold``, the one with the best MOTA; ``all_tracks/...`` are those of all tracks. HOTA, its parts and
    identity F1 take all tracks, or those from ``least_track_score`` on.
    """

    name = "tracking"
    Settings = TrackingSettings
    presenter = TrackingPresenter()
    uses = frozenset({"details"})

    def evaluate(self, detections: Detections, settings: TrackingSettings) -> TrackingResult:
        """Score the tracks of one class.

        Raises:
            ConfigError: If boxes have no track, or a track has two boxes in a frame.
        """
        scene = gather(detections, settings)
        every = match(scene, settings.iou)
        integrals = integrate(scene, settings.iou, count_ignored=settings.count_ignored)
        counted = without_ignored(scene)
        hota = Hota(counted)
        figures: dict[str, float | None] = {f"tracking/{name}": value for name, value in integrals.figures.items()}
        parts: dict[str, tuple[float, float] | None] = {"overall": None, **settings.bins_m}
        ranges: dict[str, dict[str, float | None]] = {}
        for part, bin_m in parts.items():
            figures_of_part: Figures = count(scene, integrals.matched, bin_m).figures() | hota.figures(bin_m)
            named = {f"tracking/{name}": value for name, value in figures_of_part.items()}
            named |= {f"all_tracks/{name}": v for name, v in count(scene, every, bin_m).figures().items()}
            is_whole = bin_m is None
            ranges[part] = {name: v for name, v in named.items() if is_whole or name.split("/")[1] not in _OF_TRACKS}
        figures |= ranges.pop("overall")
        figures["tracking/IDF1"] = identity_f1(counted, settings.iou)
        figures["tracking/threshold"] = integrals.thresholds[integrals.best] if integrals.best >= 0 else None
        return TrackingResult(
            protocol=str(self),
            label=settings.label,
            settings=json_options(asdict(settings)),
            convention="",
            figures=figures,
            ranges=ranges,
            counts={
                "annotated": int((~scene.annotated.aside).sum()),
                "ignored": int(scene.annotated.aside.sum()),
                "predictions": len(scene.predicted),
                "frames": len(detections.annotations),
                "thresholds": len(integrals.thresholds),
            },
            notes=scene.notes,
        )

    def headline(self, result: Mapping[str, Any]) -> Mapping[str, float | None]:
        """The rates of the whole."""
        return {f"tracking/{name}": value_at(result, f"tracking/{name}") for name in _HEADLINE}

    def inert(self, settings: Mapping[str, Any]) -> tuple[str, ...]:
        """Range bins, the label, and the distance where boxes are compared by their overlap."""
        return ("label", "range_bins_m", *(["distance_m"] * (settings.get("similarity") != "centre")))

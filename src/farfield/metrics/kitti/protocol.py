"""KITTI's average precision as a protocol: the 2D facts of the annotation make its difficulties."""

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from farfield.frame.annotation import Annotation
from farfield.metrics.bootstrap import Weighted
from farfield.metrics.kitti.evaluation import KittiResult, evaluate_kitti, weighted_kitti
from farfield.metrics.kitti.settings import KittiSettings
from farfield.metrics.protocol import Protocol
from farfield.metrics.result import figure_names, value_at

if TYPE_CHECKING:
    from farfield.metrics.detections import Detections

FACTS = ("truncation", "occlusion", "box_px")


class Kitti(Protocol):
    """KITTI's average precision."""

    name = "kitti"
    Settings = KittiSettings
    uses = frozenset({"details"})
    per_cent = True

    def evaluate(self, found: "Detections", settings: KittiSettings) -> KittiResult:
        """AP by overlap, recall points and difficulty; one difficulty, and a note, where there are no 2D facts."""
        result = evaluate_kitti(
            found.boxes,
            found.annotated,
            settings,
            prediction_details=found.prediction_details,
            annotation_details={key: facts_of(annotation) for key, annotation in found.annotations.items()},
            drives=found.drives,
        )
        some = [annotation for annotation in found.annotations.values() if len(annotation)]
        if not some or all(name in annotation.details for annotation in some for name in FACTS):
            return result
        note = f"boxes are annotated without {', '.join(FACTS)}, so all are of one difficulty, all"
        return replace(result, notes=(*result.notes, note))

    def weighted(self, found: "Detections", settings: KittiSettings) -> Weighted:
        """AP of the whole and of each range bin as functions of group weights."""
        return weighted_kitti(
            found.boxes,
            found.annotated,
            settings,
            prediction_details=found.prediction_details,
            annotation_details={key: facts_of(annotation) for key, annotation in found.annotations.items()},
            drives=found.drives,
        )

    def headline(self, result: Mapping[str, Any]) -> Mapping[str, float | None]:
        """AP over 40 recalls, by overlap and difficulty."""
        return {name: value_at(result, name) for name in figure_names(result) if "r40" in name}


def facts_of(annotation: Annotation) -> dict[str, Any]:
    """What KITTI's measure takes of an annotation besides boxes: its 2D facts and the DontCare regions."""
    known = {name: annotation.details[name] for name in FACTS if name in annotation.details}
    regions = {name: annotation.unboxed[name] for name in ("dontcare_px",) if name in annotation.unboxed}
    return known | regions

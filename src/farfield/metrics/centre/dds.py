"""DDS and wDDS, the scores of the Cirrus paper (section IV.A).

DDS is the mean of mAP and aIoU. mAP averages the AP at centre distances of 0.5, 1, 2 and 4 m; aIoU is the overlap of
matched boxes with centres aligned. wDDS widens each threshold by omega = exp(epsilon d) (equation 2), so that a
far object may be located less exactly. What the paper leaves open is an option of :class:`DdsSettings`.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from farfield.metrics.bootstrap import Statistics, intervals
from farfield.metrics.centre.evaluation import (
    Part,
    binned,
    match_scene,
    mean_of_parts,
    statistics,
    whole,
    with_confidences,
)
from farfield.metrics.centre.scene import BoxesByFrame, Scene, gather
from farfield.metrics.centre.settings import CentreSettings
from farfield.metrics.curves import Ranking
from farfield.metrics.result import Result, table


@dataclass(frozen=True, kw_only=True)
class DdsSettings(CentreSettings):
    """The options of DDS and wDDS; the defaults are Farfield's reading of the paper (see :class:`CentreSettings`)."""


@dataclass(frozen=True, eq=False, kw_only=True)
class DdsResult(Result):
    """DDS and wDDS by range and epsilon."""

    def __str__(self) -> str:
        counts = self.counts["ranges"] | {"overall": self.counts}
        rows = []
        for part in [*self.ranges, "overall", "mean_of_bins"]:
            found = counts.get(part, {"annotated": "", "predictions": ""})
            for row, epsilon in enumerate(self.settings["epsilons"]):
                name = part.replace("_", " ") if row == 0 else ""
                boxes = [str(found["annotated"]), str(found["predictions"])] if row == 0 else ["", ""]
                figures = [self.cell(part, f"dds/{epsilon:g}/{figure}") for figure in ("dds", "map", "aiou")]
                rows.append([name, *boxes, f"{epsilon:g}", *figures])
        title = f"DDS (epsilon 0) and wDDS of {self.label!r}, by range in metres; '-': nothing annotated"
        head = ["range", "annotated", "predicted", "epsilon", "DDS", "mAP", "aIoU"]
        return f"{title}\n\n{table(head, rows)}\n\n{self.footer()}"


def evaluate_dds(
    predictions: BoxesByFrame, annotations: BoxesByFrame, settings: DdsSettings | None = None
) -> DdsResult:
    """Score predictions with DDS and wDDS.

    Args:
        predictions: Scored boxes by (sequence, frame). A frame without an entry has no detections.
        annotations: Annotated boxes by (sequence, frame): every frame that counts, those without boxes too.
        settings: The options; None takes the defaults.

    Returns:
        Figures named ``ap/THRESHOLD``, ``errors/NAME`` (first epsilon) and ``dds/EPSILON/dds|map|aiou``.

    Raises:
        ConfigError: If predictions lie in frames that are not annotated, or lack scores.
    """
    settings = settings or DdsSettings()
    return DdsResult(**evaluate_centre(predictions, annotations, settings, protocol="dds"))


def evaluate_centre(
    predictions: BoxesByFrame, annotations: BoxesByFrame, settings: CentreSettings, *, protocol: str
) -> dict[str, Any]:
    """Evaluate the region and each of its range bins; returns the fields of a :class:`Result`."""
    scene = gather(predictions, annotations, settings)
    parts = _parts(scene, settings)

    def figures(weight: Float[np.ndarray, " groups"]) -> dict[str, Statistics]:
        found = {name: statistics(part, settings, weight) for name, part in parts.items()}
        return found | {"mean_of_bins": mean_of_parts([v for name, v in found.items() if name != "overall"])}

    def flat(weight: Float[np.ndarray, " groups"]) -> Statistics:
        return {f"{part}|{name}": v for part, named in figures(weight).items() for name, v in named.items()}

    point = figures(np.ones(scene.n_groups))
    drawn: dict[str, dict[str, list[float] | None]] = {}
    for key, interval in intervals(flat, scene.n_groups, settings.bootstrap).items():
        part, _, name = key.partition("|")
        drawn.setdefault(part, {})[name] = interval
    frames = np.union1d(scene.predicted_frame, scene.annotated_frame[~scene.ignored])
    return {
        "protocol": protocol,
        "label": settings.label,
        "settings": settings.to_json(),
        "convention": settings.convention(),
        "figures": point["overall"],
        "ranges": {name: v for name, v in point.items() if name not in ("overall", "mean_of_bins")},
        "mean_of_bins": point["mean_of_bins"],
        "counts": {
            "frames": len(frames),
            "frames_given": len(annotations),
            **_counts(parts["overall"]),
            "predictions_over_limit": scene.over_limit,
            "ranges": {name: _counts(part) for name, part in parts.items() if name != "overall"},
        },
        "intervals": drawn,
        "grouped_by": scene.grouped_by,
        "curves": {name: _curves(part, settings) for name, part in parts.items()},
    }


def _parts(scene: Scene, settings: CentreSettings) -> dict[str, Part]:
    scene = with_confidences(scene, settings)
    matches = match_scene(scene, settings)
    parts = {"overall": whole(scene, matches, settings)}
    for low_m, high_m in settings.bins_m:
        name = f"{low_m:g}-{high_m:g}"
        if settings.range_assign == "match_then_bin":
            parts[name] = binned(scene, matches, settings, low_m, high_m)
        else:
            inside = scene.cut_range(low_m, high_m)
            if inside is scene:  # the bin holds everything
                parts[name] = parts["overall"]
            else:
                parts[name] = whole(inside, match_scene(inside, settings), settings)
    return parts


def _counts(part: Part) -> dict[str, int]:
    return {"annotated": part.annotated, "predictions": part.predicted, "ignored": part.ignored}


def _curves(part: Part, settings: CentreSettings) -> dict[str, dict[str, Ranking]]:
    return {
        f"{epsilon:g}": {str(float(threshold)): part.ranking[epsilon, threshold] for threshold in settings.thresholds_m}
        for epsilon in settings.epsilons
    }

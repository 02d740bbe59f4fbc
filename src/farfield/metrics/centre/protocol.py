"""The protocols that match boxes by the distance of their centres: what DDS and nuScenes share."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from farfield.frame.drive import Drive
from farfield.metrics.bootstrap import Statistics, Weighted, intervals
from farfield.metrics.centre.evaluation import (
    PartRankings,
    binned,
    match_scene,
    mean_of_parts,
    mean_of_parts_of_many,
    statistics,
    statistics_of_many,
    whole,
    with_confidences,
)
from farfield.metrics.centre.scene import CentreScene, gather
from farfield.metrics.centre.settings import CentreSettings
from farfield.metrics.curves import FIRST, RECALL, Ranking
from farfield.metrics.frames import BoxesByFrame
from farfield.metrics.presenting import CurveLine, CurvePanel, curve_line
from farfield.metrics.protocol import Protocol

if TYPE_CHECKING:
    from farfield.metrics.detections import Detections


class CentreProtocol(Protocol):
    """A protocol whose settings are :class:`CentreSettings`."""

    def depends_on(self, settings: Mapping[str, Any], *, by_range: bool = False) -> dict[str, Any]:
        """As of every protocol; of the epsilons the first, for which AP and errors hold: wDDS names its own."""
        kept = super().depends_on(settings, by_range=by_range)
        if isinstance(kept.get("epsilons"), list):
            kept["epsilons"] = kept["epsilons"][:1]
        return kept

    def curves(self, result: Mapping[str, Any]) -> list[CurvePanel]:
        """Curves by largest distance, a panel for each epsilon that the page shows."""
        known = (result.get("curves") or {}).get("overall") or {}
        return [
            CurvePanel(self.panel_title(name), _lines(name, known[name])) for name in self.shown_epsilons(list(known))
        ]

    def shown_epsilons(self, names: Sequence[str]) -> list[str]:
        """Of the epsilons that have curves, those that the page shows."""
        return list(names)

    def panel_title(self, epsilon: str) -> str:
        """What a panel of curves is called."""
        del epsilon
        return ""

    def title(self, figure: str) -> str:
        """AP with its distance; other names in full."""
        kind, _, rest = figure.partition("/")
        return f"AP {float(rest):g} m" if kind == "ap" and _is_number(rest) else super().title(figure)

    def weighted(self, found: "Detections", settings: CentreSettings) -> Weighted:
        """The figures of the region, of each bin and the mean of the bins as functions of group weights."""
        scene = gather(found.boxes, found.annotated, settings, found.drives)
        parts = _parts(scene, settings)
        each = {name: partial(statistics, part, settings) for name, part in parts.items()}
        mean = partial(_mean_of_bins, parts, _reached(settings, found.reach_m), settings)
        groups = tuple(scene.group.tolist())
        return Weighted(parts={**each, "mean_of_bins": mean}, groups=groups, grouped_by=scene.grouped_by)


def _lines(epsilon: str, curves: Mapping[str, Any]) -> tuple[CurveLine, ...]:
    named = {f"within {float(name):g} m": curves[name] for name in sorted(curves, key=float)}
    lines = (curve_line(name, curve, (f"of epsilon {epsilon}",)) for name, curve in named.items())
    return tuple(line for line in lines if line is not None)


def _is_number(text: str) -> bool:
    return text.replace(".", "", 1).isdecimal()


def distances(result: Mapping[str, Any]) -> tuple[str, ...]:
    """Names of the APs of a result, by rising distance."""
    return tuple(f"ap/{name}" for name in sorted(result.get("ap") or {}, key=float))


def distance_words(result: Mapping[str, Any]) -> str:
    """The distances of a result's APs, such as ``"0.5, 1, 2 or 4 m"``."""
    names = [f"{float(name):g}" for name in sorted(result.get("ap") or {}, key=float)]
    return f"{' or '.join([', '.join(names[:-1]), names[-1]] if len(names) > 1 else names)} m" if names else "a limit"


def evaluate_centre(
    predictions: BoxesByFrame,
    annotations: BoxesByFrame,
    settings: CentreSettings,
    *,
    protocol: str,
    drives: Sequence[Drive] = (),
    reach_m: float | None = None,
) -> dict[str, Any]:
    """Evaluate the region and each of its range bins; returns the fields of a :class:`Result`.

    Args:
        predictions: Scored boxes by (sequence, frame).
        annotations: Annotated boxes by (sequence, frame): every frame that counts.
        settings: The options.
        protocol: What the result is to be called.
        drives: Drives of the data, which the bootstrap draws; without them sequences are drawn.
        reach_m: Range bins that begin here or beyond are not in the mean of the bins.
    """
    scene = gather(predictions, annotations, settings, drives)
    parts = _parts(scene, settings)
    figures = partial(_figures, parts, _reached(settings, reach_m), settings)
    point = figures(np.ones(scene.n_groups))
    drawn: dict[str, dict[str, list[float] | None]] = {}
    many = partial(_flat_of_many, parts, _reached(settings, reach_m), settings)
    for key, interval in intervals(partial(_flat, figures), scene.n_groups, settings.bootstrap, many=many).items():
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
        "notes": tuple(too_little_found(parts, point, settings)),
    }


def too_little_found(
    parts: Mapping[str, PartRankings], point: Mapping[str, Statistics], settings: CentreSettings
) -> list[str]:
    """Why figures are 0 or 1, the worst, in parts where something was found: recall ends before the averages begin.

    nuScenes' averages begin at a recall of 0.11 (``calc_ap`` and ``calc_tp`` of its devkit).
    """
    least, limit = float(RECALL[FIRST]), settings.error_thresholds_m[0]
    said = list[str]()
    for name, part in parts.items():
        ranking = part.ranking[settings.epsilons[0], limit]
        reached = float(ranking.recall[-1]) if len(ranking.recall) else 0.0
        worst = settings.with_aiou and point[name].get(f"dds/{settings.epsilons[0]:g}/aiou") == 0
        if part.annotated and 0 < reached < least and (worst or not settings.with_aiou):
            where = "over all ranges" if name == "overall" else f"at {name} m"
            score = "aIoU counts as 0" if settings.with_aiou else "errors count as 1"
            said.append(
                f"{where} only {reached:.2f} of the {part.annotated} objects are found within {limit:g} m, and "
                f"averages begin at a recall of {least:g}: AP there is 0, and {score}"
            )
    return said


def _figures(
    parts: Mapping[str, PartRankings],
    reached: Sequence[str],
    settings: CentreSettings,
    weight: Float[np.ndarray, " groups"],
) -> dict[str, Statistics]:
    once = {id(part): statistics(part, settings, weight) for part in {id(p): p for p in parts.values()}.values()}
    found = {name: once[id(part)] for name, part in parts.items()}
    return found | {"mean_of_bins": mean_of_parts([found[name] for name in reached])}


def _reached(settings: CentreSettings, reach_m: float | None) -> list[str]:
    """Names of the bins that begin within the detector's reach."""
    return [f"{low_m:g}-{high_m:g}" for low_m, high_m in settings.bins_m if reach_m is None or low_m < reach_m]


def _mean_of_bins(
    parts: Mapping[str, PartRankings],
    reached: Sequence[str],
    settings: CentreSettings,
    weight: Float[np.ndarray, " groups"],
) -> Statistics:
    return mean_of_parts([statistics(parts[name], settings, weight) for name in reached])


def _flat(figures: "partial[dict[str, Statistics]]", weight: Float[np.ndarray, " groups"]) -> Statistics:
    return {f"{part}|{name}": v for part, named in figures(weight).items() for name, v in named.items()}


def _flat_of_many(
    parts: Mapping[str, PartRankings],
    reached: Sequence[str],
    settings: CentreSettings,
    weights: Float[np.ndarray, "replicates groups"],
) -> dict[str, Float[np.ndarray, " replicates"]]:
    """What :func:`_flat` gives, under each row of weights."""
    once = {
        id(part): statistics_of_many(part, settings, weights) for part in {id(p): p for p in parts.values()}.values()
    }
    found = {name: once[id(part)] for name, part in parts.items()}
    found["mean_of_bins"] = mean_of_parts_of_many([found[name] for name in reached])
    return {f"{part}|{name}": values for part, named in found.items() for name, values in named.items()}


def _parts(scene: CentreScene, settings: CentreSettings) -> dict[str, PartRankings]:
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


def _counts(part: PartRankings) -> dict[str, int]:
    return {"annotated": part.annotated, "predictions": part.predicted, "ignored": part.ignored}


def _curves(part: PartRankings, settings: CentreSettings) -> dict[str, dict[str, Ranking]]:
    return {
        f"{epsilon:g}": {str(float(threshold)): part.ranking[epsilon, threshold] for threshold in settings.thresholds_m}
        for epsilon in settings.epsilons
    }

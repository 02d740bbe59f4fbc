"""DDS and wDDS, the scores of the Cirrus paper (Wang et al., ICRA 2021, section IV.A), for one class.

A prediction matches the nearest free annotated box if their centres are nearer than omega t, for a threshold t:

    omega = exp(epsilon d)                          (equation 2; d: range of the box, epsilon 0: DDS, more: wDDS)
    mAP   = mean of AP(t) over t = 0.5, 1, 2, 4 m
    aIoU  = mean over the matches at 2 m of the IoU of the two boxes, their centres put on each other
    DDS   = (mAP + aIoU) / 2

so that with wDDS a far object may be located less exactly: at epsilon 0.006 and 250 m thresholds are 4.5 times as
wide. AP and the mean over the matches are those of nuScenes, see :mod:`farfield.metrics.curves`. What the paper leaves
open is an option of :class:`DdsSettings`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from farfield.frame.drive import Drive
from farfield.metrics.centre.evaluation import evaluate_centre
from farfield.metrics.centre.protocol import CentrePresenter, CentreProtocol, distance_words, distances
from farfield.metrics.centre.settings import CentreSettings
from farfield.metrics.detections import Detections
from farfield.metrics.frames import BoxesByFrame
from farfield.metrics.presenting import Presentation, Words, by_number
from farfield.metrics.result import Result, table, value_at
from farfield.vocabulary.counts import count_of


@dataclass(frozen=True, kw_only=True)
class DdsSettings(CentreSettings):
    """The options of DDS and wDDS; the defaults are Farfield's reading of the paper (see :class:`CentreSettings`)."""


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class DdsResult(Result):
    """DDS and wDDS by range and epsilon."""

    def __str__(self) -> str:
        counts = self.counts["ranges"] | {"overall": self.counts}
        first, *others = (f"{epsilon:g}" for epsilon in self.settings["epsilons"])
        score = "DDS" if first == "0" else f"wDDS {first}"
        rows, weighted = [], []
        for part in [*self.ranges, "overall", "mean_of_bins"]:
            boxes = counts.get(part, {"annotated": "", "predictions": ""})
            figures = [self.cell(part, f"dds/{first}/{figure}") for figure in ("dds", "map", "aiou")]
            rows.append([part.replace("_", " "), str(boxes["annotated"]), str(boxes["predictions"]), *figures])
            weighted.append([rows[-1][0], *(self.cell(part, f"dds/{epsilon}/dds") for epsilon in others)])
        title = f"{score} of {self.label!r}, by range in metres; '-': nothing annotated"
        tables = table(["range", "annotated", "predicted", score, "mAP", "aIoU"], rows)
        if others:
            tables += "\n\n" + table(["range", *(f"wDDS {epsilon}" for epsilon in others)], weighted)
        limit = self.settings["aiou_threshold_m"]
        within = f"within {limit:g} m" if isinstance(limit, int | float) else "within the least threshold"
        matches = f"aIoU of the whole: mean over {count_of(self.counts['matches'], 'match', 'matches')} {within}"
        return f"{title}\n\n{tables}\n\n{matches}\n{self.footer()}"


def evaluate_dds(
    predictions: BoxesByFrame,
    annotations: BoxesByFrame,
    settings: DdsSettings | None = None,
    *,
    drives: Sequence[Drive] = (),
    reach_m: float | None = None,
) -> DdsResult:
    """Score predictions with DDS and wDDS.

    Args:
        predictions: Scored boxes by (sequence, frame). A frame without an entry has no detections.
        annotations: Annotated boxes by (sequence, frame): every frame that counts, those without boxes too.
        settings: The options; None takes the defaults.
        drives: Drives of the data, which the bootstrap draws; without them sequences are drawn.
        reach_m: Range bins that begin here or beyond are not in the mean of the bins.

    Returns:
        Figures named ``ap/THRESHOLD``, ``errors/NAME`` (first epsilon) and ``dds/EPSILON/dds|map|aiou``.

    Raises:
        ConfigError: If predictions lie in frames that are not annotated, or lack scores.
    """
    settings = settings or DdsSettings()
    fields = evaluate_centre(predictions, annotations, settings, protocol=Dds.name, drives=drives, reach_m=reach_m)
    return DdsResult(**fields)


class DdsPresenter(CentrePresenter):
    """How Dds is shown."""

    def title(self, figure: str) -> str:
        """DDS, wDDS with its epsilon, mAP, aIoU."""
        path = figure.split("/")
        if path[0] != "dds" or len(path) != 3:
            return super().title(figure)
        score = "DDS" if path[1] == "0" else f"wDDS {path[1]}"
        return {"dds": score, "map": "mAP", "aiou": "aIoU"}.get(path[2], path[2])

    def presentation(self, result: Mapping[str, Any]) -> Presentation:
        """DDS with its mAP, wDDS, and what they are made of."""
        epsilons = by_number(result.get("dds") or {}, "dds")
        scores = [f"dds/{epsilon}/dds" for epsilon in epsilons]
        first = epsilons[0] if epsilons else "0"
        return Presentation(
            figures=(*scores[:1], *([f"dds/{first}/map"] if scores else []), *scores[1:]),
            beside=f"dds/{first}/map" if scores else "",
            about="DDS is the mean of how reliably objects are found (mAP) and how well their boxes fit. wDDS allows "
            "more metres of error the farther an object is; the number beside it is epsilon, how fast the allowance "
            "grows.",
            parts=(f"dds/{first}/map", f"dds/{first}/aiou", *distances(result)) if scores else (),
            about_parts="mAP is the mean of the APs, each for another largest distance between predicted and annotated "
            "centre. aIoU says how well size and heading of the found boxes fit.",
            groups=tuple(
                (f"epsilon {e}", tuple(f"dds/{e}/{part}" for part in ("dds", "map", "aiou"))) for e in epsilons
            ),
            groups_title="Score, mAP and aIoU for every epsilon",
            about_curves="Each line allows another distance between the predicted and the annotated centre.",
            glossary=_glossary(result),
        )

    def shown_epsilons(self, names: Sequence[str]) -> list[str]:
        """The first, and 0.006 or else the last one."""
        return list(dict.fromkeys([*names[:1], *(["0.006"] if "0.006" in names else names[-1:])]))

    def panel_title(self, epsilon: str) -> str:
        """The score and its epsilon."""
        return f"{'DDS' if float(epsilon) == 0 else 'wDDS'} (epsilon {epsilon})"


class Dds(CentreProtocol):
    """DDS and wDDS of the Cirrus paper."""

    name = "dds"
    Settings = DdsSettings
    presenter = DdsPresenter()

    def evaluate(self, detections: Detections, settings: DdsSettings) -> DdsResult:
        """DDS and wDDS by range and epsilon."""
        return evaluate_dds(
            detections.boxes, detections.annotated, settings, drives=detections.drives, reach_m=detections.reach_m
        )

    def headline(self, result: Mapping[str, Any]) -> Mapping[str, float | None]:
        """DDS and wDDS by epsilon, then mAP and aIoU of plain DDS."""
        names = [f"dds/{epsilon}/dds" for epsilon in result.get("dds") or ()]
        plain = ["dds/0/map", "dds/0/aiou"] if "0" in (result.get("dds") or ()) else []
        return {name: value_at(result, name) for name in [*names, *plain]}


def _glossary(result: Mapping[str, Any]) -> Words:
    return (
        (
            "AP",
            "Average precision: the area under the precision-recall curve, for predictions whose centre lies within "
            f"{distance_words(result)} of the annotated one. mAP is the mean over these distances.",
        ),
        (
            "aIoU",
            "Aligned overlap: how well size and heading of the found boxes fit, once their centres are put on each "
            "other.",
        ),
        ("DDS", "Mean of mAP and aIoU, from 0 (nothing) to 1 (perfect)."),
        (
            "wDDS",
            "DDS that allows more metres of error the farther an object is: thresholds grow as exp(epsilon x range). "
            "At epsilon 0.006 and 250 m they are 4.5 times as wide.",
        ),
    )

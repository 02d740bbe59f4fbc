"""The protocols that match boxes by the distance of their centres: what DDS and nuScenes share."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float

from farfield.metrics.bootstrap import Draws, Weighted
from farfield.metrics.centre.evaluation import (
    PartRankings,
    bins_in_reach,
    figures_of_part,
    gather,
    mean_of_bins,
    rank_parts,
)
from farfield.metrics.centre.settings import CentreSettings
from farfield.metrics.detections import Detections, Protocol
from farfield.metrics.presenting import CurveLine, CurvePanel, Presenter, by_number, curve_level, curve_line


class CentrePresenter(Presenter):
    """How CentreProtocol is shown."""

    def curves(self, result: Mapping[str, Any]) -> list[CurvePanel]:
        """Curves by largest distance, a panel for each epsilon that the page shows."""
        curves = curve_level((result.get("curves") or {}).get("overall"), "overall")
        by_number(curves, "curves")
        return [
            CurvePanel(self.panel_title(name), _lines(name, curves[name])) for name in self.shown_epsilons(list(curves))
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
        is_distance = kind == "ap" and rest.replace(".", "", 1).isdecimal()
        return f"AP {float(rest):g} m" if is_distance else super().title(figure)


class CentreProtocol(Protocol):
    """A protocol whose settings are :class:`CentreSettings`."""

    presenter = CentrePresenter()

    def depends_on(self, settings: Mapping[str, Any], *, by_range: bool = False) -> dict[str, Any]:
        """As of every protocol; of the epsilons the first, for which AP and errors hold: wDDS names its own."""
        options = super().depends_on(settings, by_range=by_range)
        if isinstance(options.get("epsilons"), list):
            options["epsilons"] = options["epsilons"][:1]
        return options

    def weighted(self, detections: Detections, settings: CentreSettings) -> Weighted:
        """The figures of the region, of each bin and the mean of the bins as functions of group weights."""
        boxes = gather(detections.boxes, detections.annotated, settings, detections.drives)
        parts = rank_parts(boxes, settings)
        figures = {name: partial(figures_of_part, part, settings) for name, part in parts.items()}
        reached = {name: parts[name] for name in bins_in_reach(settings, detections.reach_m)}
        mean = partial(_mean_of_bins, reached, settings)
        groups = tuple(boxes.group.tolist())
        return Weighted(parts={**figures, "mean_of_bins": mean}, groups=groups, grouped_by=boxes.grouped_by)


def _mean_of_bins(
    bins: Mapping[str, PartRankings], settings: CentreSettings, weights: Float[np.ndarray, "r g"]
) -> Draws:
    return mean_of_bins([figures_of_part(part, settings, weights) for part in bins.values()])


def _lines(epsilon: str, node: Any) -> tuple[CurveLine, ...]:
    curves = curve_level(node, f"of epsilon {epsilon}")
    named = {f"within {float(name):g} m": curves[name] for name in by_number(curves, "curves")}
    lines = (curve_line(name, curve, (f"of epsilon {epsilon}",)) for name, curve in named.items())
    return tuple(line for line in lines if line is not None)


def distances(result: Mapping[str, Any]) -> tuple[str, ...]:
    """Names of the APs of a result, by rising distance."""
    return tuple(f"ap/{name}" for name in by_number(result.get("ap") or {}, "ap"))


def distance_words(result: Mapping[str, Any]) -> str:
    """The distances of a result's APs, such as ``"0.5, 1, 2 or 4 m"``."""
    names = [f"{float(name):g}" for name in by_number(result.get("ap") or {}, "ap")]
    return f"{' or '.join([', '.join(names[:-1]), names[-1]] if len(names) > 1 else names)} m" if names else "a limit"

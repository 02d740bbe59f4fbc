"""How results are shown: a protocol's presenter gives titles, units, words and curves to tables and pages.

A page knows no protocol: it asks the :class:`Presenter` of the one that made the result. A protocol without a presenter
of its own has the plain one, which shows every figure under its name.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np
from jaxtyping import Float, Int

from farfield.errors import ConfigError, plain
from farfield.geometry.boxes import Boxes
from farfield.geometry.iou import pairwise_iou

Words = tuple[tuple[str, str], ...]
"""Words and what they mean, for readers who are new to them."""

BASICS: Words = (
    (
        "Box",
        "Where an object is, how large it is and which way it faces. Annotated boxes are the truth to be found; "
        "predicted boxes are what the detector says, each with a score of how sure it is.",
    ),
    ("Recall", "Of all annotated objects, the share that was found."),
    (
        "Precision",
        "Of all predictions, the share that is right. Asking for more recall means accepting less sure predictions, so "
        "precision falls along the curve.",
    ),
    (
        "Interval",
        "How far the score might move had other drives been recorded: the middle 95 % of scores over resampled "
        "sequences; of a single sequence over its resampled frames, which differ less than drives do.",
    ),
)


@dataclass(frozen=True)
class HitRule:
    """When an annotated box counts as found in pictures; scores have their own rules.

    Args:
        kind: Compare centres seen from above (``"centre"``), or overlap from above (``"bev"``) or in space (``"3d"``).
        limit: A prediction must be nearer than this many metres, or overlap by more than this share.
    """

    kind: Literal["centre", "bev", "3d"] = "centre"
    limit: float = 2.0

    def __str__(self) -> str:
        if self.kind == "centre":
            return f"within {self.limit:g} m"
        return f"by a box that overlaps by more than {self.limit:g}{'' if self.kind == '3d' else ' seen from above'}"

    def found_by(self, predictions: Boxes, annotated: Boxes) -> Int[np.ndarray, " m"]:
        """Index of the prediction that found each annotated box of a frame, or -1, shape (m,).

        Predictions take turns by falling score; each takes the free annotated box that is nearest or overlaps most.

        Args:
            predictions: Boxes of a detector.
            annotated: m annotated boxes of the same frame.
        """
        finder = np.full(len(annotated), -1, dtype=np.int64)
        if not len(predictions) or not len(annotated):
            return finder
        fit, least = self._fit(predictions, annotated)
        score = np.zeros(len(predictions)) if predictions.score is None else predictions.score
        for row in np.argsort(-score, kind="stable"):
            free = np.where(finder < 0, fit[row], -np.inf)
            best = int(free.argmax())
            if free[best] > least:
                finder[best] = row
        return finder

    def _fit(self, predictions: Boxes, annotated: Boxes) -> tuple[Float[np.ndarray, "n m"], float]:
        """How well each pair fits, the more the better, and what it must exceed."""
        if self.kind != "centre":
            return pairwise_iou(predictions, annotated, kind=self.kind), self.limit
        apart_m = predictions.centre_m[:, None, :2] - annotated.centre_m[None, :, :2]
        return -np.hypot(apart_m[..., 0], apart_m[..., 1]), -self.limit


@dataclass(frozen=True)
class CurveLine:
    """A curve of precision over recall: its name, and values of equal length."""

    name: str
    recall: Sequence[float]
    precision: Sequence[float]


@dataclass(frozen=True)
class CurvePanel:
    """Curves that are drawn into one pair of axes; without lines nothing is annotated."""

    title: str
    lines: tuple[CurveLine, ...]


@dataclass(frozen=True, kw_only=True)
class Presentation:
    """What a page shows of a result.

    Args:
        figures: Columns of the table by range, the main figure first; none: the protocol's headline.
        about: What they are, in sentences; plain text.
        beside: A figure that belongs beside the main one, or nothing.
        parts: Columns of a second table, of what the figures are made of.
        about_parts: What those are.
        parts_title: What stands above them.
        groups: Columns of a third table that is folded away: titles over columns.
        groups_title: What it is called.
        about_curves: What a line of the curves is.
        glossary: The protocol's own words.
        kinds: By which parts of the data there are tables, in their order.
        conditions_first: Whether these stand before the table by range.
        finding: When a box of a picture counts as found.
    """

    figures: tuple[str, ...] = ()
    about: str = ""
    beside: str = ""
    parts: tuple[str, ...] = ()
    about_parts: str = ""
    parts_title: str = "What the score is made of"
    groups: tuple[tuple[str, tuple[str, ...]], ...] = ()
    groups_title: str = ""
    about_curves: str = ""
    glossary: Words = ()
    kinds: tuple[str, ...] = ("weather", "road", "time", "azimuth")
    conditions_first: bool = False
    finding: HitRule = field(default_factory=HitRule)

    @property
    def main(self) -> str:
        """The figure that stands for a result; nothing where there are no figures."""
        return next(iter(self.figures), "")


class Presenter:
    """How the results of a protocol are shown; the plain one, from which those of the protocols inherit."""

    per_cent: ClassVar[bool] = False
    """Whether tables show the figures in per cent."""

    def title(self, figure: str) -> str:
        """What a figure's column is called.

        Args:
            figure: Its name, of a result of several classes without the class: ``"3d/0.3"``.
        """
        return " ".join(figure.removeprefix("ap/").split("/")).replace("3d", "3D").replace("bev", "BEV")

    def unit(self, figure: str) -> str:
        """The unit in which a figure is shown: ``"%"``, ``"m"``, ``"rad"``..., or nothing for a share.

        Args:
            figure: Its name.
        """
        del figure
        return "%" if self.per_cent else ""

    def setting_title(self, name: str) -> str:
        """What a setting is called on a page, with its unit at the end as in ``limit_m``."""
        return name

    def presentation(self, result: Mapping[str, Any]) -> Presentation:
        """What a page shows of a result: columns, words, and when a box of a picture counts as found.

        Args:
            result: Result JSON.
        """
        del result
        return Presentation()

    def curves(self, result: Mapping[str, Any]) -> list[CurvePanel]:
        """The curves of the whole, by panel.

        Args:
            result: Result JSON.

        Raises:
            ConfigError: If a curve is damaged.
        """
        return panels((result.get("curves") or {}).get("overall"))


def panels(tree: Any, titles: Sequence[str] = ()) -> list[CurvePanel]:
    """The curves of a result's JSON as panels: the innermost level gives the lines, those above name the panel.

    Args:
        tree: Part of the result's curves.
        titles: Names of the levels so far.

    Raises:
        ConfigError: If a curve's recall and precision are not lists of equal length.
    """
    if not isinstance(tree, Mapping):
        return []
    below = {name: inner for name, inner in tree.items() if isinstance(inner, Mapping)}
    if below and not any("recall" in inner for inner in below.values()):
        return [panel for name, inner in below.items() for panel in panels(inner, (*titles, str(name)))]
    lines = (curve_line(str(name), curve, titles) for name, curve in tree.items())
    return [CurvePanel(" ".join(titles), tuple(line for line in lines if line is not None))] if tree else []


def curve_line(name: str, curve: Any, titles: Sequence[str] = ()) -> CurveLine | None:
    """A curve of a result's JSON; None where nothing is annotated.

    Raises:
        ConfigError: If recall and precision are not lists of equal length.
    """
    if curve is None:
        return None
    values = curve if isinstance(curve, Mapping) else {}
    recall, precision = values.get("recall"), values.get("precision")
    if not (isinstance(recall, list) and isinstance(precision, list) and len(recall) == len(precision)):
        raise ConfigError(
            f"result, curve {' '.join([*titles, name])}: expected lists 'recall' and 'precision' of equal length. "
            "Score the predictions again."
        )
    return CurveLine(name, recall, precision)


def curve_level(node: Any, where: str) -> Mapping[str, Any]:
    """One level of a result's curves; empty where nothing is annotated.

    Raises:
        ConfigError: If something else stands there.
    """
    if node is None:
        return {}
    if not isinstance(node, Mapping):
        raise ConfigError(f"result, curves {where}: expected an object of curves. Score the predictions again.")
    return node


def by_number(names: Iterable[str], where: str) -> list[str]:
    """Names of distances, overlaps or epsilons, by rising number.

    Raises:
        ConfigError: If a name is no number.
    """
    try:
        return sorted(names, key=float)
    except ValueError as error:
        raise ConfigError(f"result, {where}: expected numbers as names, {plain(error)}. Score again.") from None


def edges_m(result: Mapping[str, Any]) -> tuple[float, ...]:
    """Edges of a result's range bins, without the one at 0 and without an open one; none where it has no bins."""
    edges = (result.get("settings") or {}).get("range_bins_m") or ()
    numbers = [float(edge) for edge in edges if isinstance(edge, int | float) and not isinstance(edge, bool)]
    return tuple(edge for edge in numbers if 0 < edge < math.inf)

"""The tables of a reproduction's page on what the two scan patterns are for."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from farfield.vocabulary.conditions import CONDITIONS

NOTHING = "–"


@dataclass(frozen=True, kw_only=True)
class ScenarioRow:
    """A road or direction, or a fixed choice that the rule is compared with; texts, empty where there is nothing."""

    what: str
    difference: str
    interval: str
    verdict: str
    annotated: str = ""
    means: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Scenarios:
    """Both tables.

    Args:
        names: The patterns.
        claim: What the differences are asked.
        rows: Roads and directions.
        choices: Which pattern the rule took on which road, and how often.
        mean: The rule's figure.
        rule: The rule against each fixed choice.
    """

    names: tuple[str, ...]
    claim: str
    rows: tuple[ScenarioRow, ...]
    choices: str = ""
    mean: str = ""
    rule: tuple[ScenarioRow, ...] = ()


def scenarios(tree: Mapping[str, Any]) -> Scenarios | None:
    """The tables of what ``reproduction.json`` holds under ``scenarios``; None where it holds nothing."""
    if not tree.get("parts"):
        return None
    names = tuple(tree["parts"][0]["means"])
    switching = tree.get("switching") or {}
    return Scenarios(
        names=names,
        claim=f"{names[0]} above {names[1]}",
        rows=tuple(_part(each, names) for each in tree["parts"]),
        choices=_choices(switching.get("choices", ())),
        mean=_figure(switching.get("mean")),
        rule=tuple(_decided(name, decision) for name, decision in switching.get("gains", {}).items()),
    )


def _part(each: Mapping[str, Any], names: Sequence[str]) -> ScenarioRow:
    value = str(each["value"]).replace("_", " ")
    row = _decided(value if each["kind"] in CONDITIONS else f"{value} degrees", each["decision"])
    means = tuple(_figure(each["means"][name]) for name in names)
    return ScenarioRow(**{**vars(row), "annotated": f"{each['annotated']:,}", "means": means})


def _decided(what: str, decision: Mapping[str, Any] | None) -> ScenarioRow:
    if decision is None:
        return ScenarioRow(what=what, difference=NOTHING, interval="", verdict="nothing annotated")
    found = decision["difference"]
    interval = found.get("interval")
    return ScenarioRow(
        what=what,
        difference=_figure(found.get("estimate"), signed=True),
        interval=f"{interval[0]:+.3f} to {interval[1]:+.3f}" if interval else "",
        verdict=decision["words"],
    )


def _choices(choices: Sequence[Mapping[str, str]]) -> str:
    counts = Counter((road, pattern) for choice in choices for road, pattern in choice.items())
    found = [
        f"{road.replace('_', ' ')} {pattern} ({count} of {len(choices)})" for (road, pattern), count in counts.items()
    ]
    return ", ".join(sorted(found))


def _figure(value: float | None, *, signed: bool = False) -> str:
    return NOTHING if value is None else f"{value:+.3f}" if signed else f"{value:.3f}"

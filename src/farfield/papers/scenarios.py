"""What the two scan patterns are for: scores by road and direction, a rule that switches by road, and their tables.

Cirrus, section I: the patterns are for different scenarios. Each is scored by the detector that was trained on it.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from farfield.errors import ConfigError
from farfield.metrics import Bootstrap, Detections
from farfield.metrics.breakdown import AZIMUTHS_DEG, parts
from farfield.metrics.deciding import decide, difference, figure, switched, switching_gains
from farfield.papers.grid import Score, Tree
from farfield.papers.jobs import TrainingJob
from farfield.vocabulary.conditions import CONDITIONS
from farfield.vocabulary.patterns import PATTERNS

REPLICATES = 300
_KINDS, _SWITCHED_BY = ("road", "azimuth"), "road"
_DDS = figure("dds/0/dds")


def seeds_of(jobs: Iterable[TrainingJob]) -> dict[int, dict[str, TrainingJob]]:
    """Jobs of the rows that are named as the patterns, by seed; those seeds that have all of them."""
    seeds: dict[int, dict[str, TrainingJob]] = {}
    for job in jobs:
        for name in PATTERNS:
            if name in job.runs:
                seeds.setdefault(job.seed, {})[name] = job
    return {seed: patterns for seed, patterns in sorted(seeds.items()) if len(patterns) == len(PATTERNS)}


def scenarios_of(runs: Mapping[str, Sequence[Detections]], score: Score, *, replicates: int = REPLICATES) -> Tree:
    """Scores of both patterns by road and direction, their differences, and what switching by road gains.

    Args:
        runs: Detections by pattern, seed by seed.
        score: How runs are scored; without the DDS protocol there are no scenarios.
        replicates: Draws of the drives.

    Returns:
        ``parts``: kind, value, annotated boxes, mean figure by pattern and the decision on the difference of the first
        pattern and the second. ``switching``: the chosen pattern by road for each seed and fold, the mean figure of the
        rule, and the decision on its difference to either pattern; None where the drives do not allow it.
    """
    if score.protocol != "dds" or not runs or not all(runs.values()):
        return {}
    settings = {**score.settings_of(score.tables[0]), "epsilons": (0.0,)}
    edges_m = settings.get("range_bins_m") or ()
    if edges_m:
        settings["range_bins_m"] = (edges_m[0], edges_m[-1])
    return {
        "figure": "DDS",
        "seeds": len(next(iter(runs.values()))),
        "parts": _by_part(runs, settings, replicates),
        "switching": _switching(runs, settings, replicates),
    }


def _by_part(runs: Mapping[str, Sequence[Detections]], settings: Tree, replicates: int) -> list[Tree]:
    by_part = {
        name: [parts(detections, _KINDS, azimuths_deg=AZIMUTHS_DEG) for detections in seeds]
        for name, seeds in runs.items()
    }
    first = next(iter(by_part.values()))[0]
    return [
        {"kind": kind, "value": value, **_compare(kind, value, by_part, settings, replicates)}
        for kind, values in first.items()
        if len(values) > 1
        for value in values
    ]


def _compare(kind: str, value: str, by_part: Mapping[str, Sequence[Any]], settings: Tree, replicates: int) -> Tree:
    """Means of both patterns in a part, and the decision on their difference; None where nothing is annotated."""
    sides = {name: [part[kind][value] for part in seeds] for name, seeds in by_part.items()}
    means, annotated = {}, 0
    for name, seeds in sides.items():
        means[name], counts = _mean_dds(seeds, settings)
        annotated = int(counts["annotated"])
    a, b = sides.values()
    try:
        decision = decide(difference(a, b, _DDS, replicates=replicates, **settings)).to_json()
    except ConfigError:  # nothing is annotated there
        decision = None
    return {"annotated": annotated, "means": means, "decision": decision}


def _switching(runs: Mapping[str, Sequence[Detections]], settings: Tree, replicates: int) -> Tree | None:
    seeds = [dict(zip(runs, patterns, strict=True)) for patterns in zip(*runs.values(), strict=True)]
    try:
        rules = [switched(patterns, _SWITCHED_BY, **settings) for patterns in seeds]
        gains = switching_gains(runs, _SWITCHED_BY, replicates=replicates, **settings)
    except ConfigError:  # too few drives, or frames without a kind of road
        return None
    return {
        "by": _SWITCHED_BY,
        "choices": [dict(choice) for rule in rules for choice in rule.choices],
        "mean": _mean_dds([rule.detections for rule in rules], settings)[0],
        "gains": {name: decide(gain).to_json() for name, gain in gains.items()},
    }


def _mean_dds(seeds: Sequence[Detections], settings: Tree) -> tuple[float | None, Mapping[str, Any]]:
    """Mean DDS over seeds, None where one has none, and the counts of the first seed."""
    results = [detections.score("dds", bootstrap=Bootstrap(replicates=0), **settings) for detections in seeds]
    values = [_DDS.of({"overall": result.figures}) for result in results]
    figures = [value for value in values if value is not None]
    mean = sum(figures) / len(figures) if figures and len(figures) == len(values) else None
    return mean, results[0].counts


# The tables of the page

NOTHING = "–"


def scenario_tables(tree: Mapping[str, Any]) -> dict[str, Any] | None:
    """The tables of the page as texts; None where there is nothing.

    Args:
        tree: What ``reproduction.json`` holds under ``scenarios``.

    Returns:
        ``names``: the patterns. ``claim``: what is claimed of the differences. ``rows``: roads and directions.
        ``choices``: which pattern the rule chose on which road, and how often. ``mean``: the rule's figure. ``rule``:
        the rule against each fixed choice.
    """
    if not tree.get("parts"):
        return None
    names = tuple(tree["parts"][0]["means"])
    switching = tree.get("switching") or {}
    rows = []
    for part in tree["parts"]:
        value = str(part["value"]).replace("_", " ")
        row = _scenario_row(value if part["kind"] in CONDITIONS else f"{value} degrees", part["decision"])
        means = [_figure(part["means"][name]) for name in names]
        rows.append({**row, "annotated": f"{part['annotated']:,}", "means": means})
    choices = switching.get("choices", ())
    counts = Counter((road, pattern) for choice in choices for road, pattern in choice.items())
    by_road = [
        f"{road.replace('_', ' ')} {pattern} ({count} of {len(choices)})" for (road, pattern), count in counts.items()
    ]
    return {
        "names": names,
        "claim": f"{names[0]} above {names[1]}",
        "rows": rows,
        "choices": ", ".join(sorted(by_road)),
        "mean": _figure(switching.get("mean")),
        "rule": [_scenario_row(name, decision) for name, decision in switching.get("gains", {}).items()],
    }


def _scenario_row(name: str, decision: Mapping[str, Any] | None) -> dict[str, Any]:
    if decision is None:
        return {"what": name, "difference": NOTHING, "interval": "", "verdict": "nothing annotated"}
    estimate, interval = (decision["difference"].get(key) for key in ("estimate", "interval"))
    return {
        "what": name,
        "difference": NOTHING if estimate is None else f"{estimate:+.3f}",
        "interval": f"{interval[0]:+.3f} to {interval[1]:+.3f}" if interval else "",
        "verdict": decision["words"],
    }


def _figure(value: float | None) -> str:
    return NOTHING if value is None else f"{value:.3f}"

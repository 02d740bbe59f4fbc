"""What the two scan patterns are for: scores by road and direction, and a rule that switches by road.

Cirrus, section I: the patterns are for different scenarios. Each is seen by the detector that was trained on it.
"""

from collections.abc import Iterable, Mapping, Sequence

from farfield.errors import ConfigError
from farfield.metrics import Bootstrap, Detections
from farfield.metrics.breakdown import AZIMUTHS_DEG, parts
from farfield.metrics.deciding import decide, difference, figure, switched, switching_gains
from farfield.papers.grid import Score, Tree
from farfield.papers.jobs import TrainingJob
from farfield.vocabulary.patterns import PATTERNS

REPLICATES = 300
_KINDS, _SWITCHED_BY = ("road", "azimuth"), "road"
_DDS = figure("dds/0/dds")


def seeds_of(jobs: Iterable[TrainingJob]) -> dict[int, dict[str, TrainingJob]]:
    """Jobs of the rows that are named as the patterns, by seed; those seeds that have all of them."""
    found: dict[int, dict[str, TrainingJob]] = {}
    for job in jobs:
        for name in PATTERNS:
            if name in job.runs:
                found.setdefault(job.seed, {})[name] = job
    return {seed: each for seed, each in sorted(found.items()) if len(each) == len(PATTERNS)}


def scenarios_of(runs: Mapping[str, Sequence[Detections]], score: Score, *, replicates: int = REPLICATES) -> Tree:
    """Scores of both patterns by road and direction, their differences, and what switching by road gains.

    Args:
        runs: Detections by pattern, seed by seed.
        score: How runs are scored; of a protocol other than DDS nothing is said.
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
    parted = {name: [parts(found, _KINDS, azimuths_deg=AZIMUTHS_DEG) for found in row] for name, row in runs.items()}
    first = next(iter(parted.values()))[0]
    rows = []
    for kind, values in first.items():
        for value in values if len(values) > 1 else ():
            sides = {name: [found[kind][value] for found in row] for name, row in parted.items()}
            rows.append({"kind": kind, "value": value, **_compared(sides, settings, replicates)})
    return rows


def _compared(sides: Mapping[str, Sequence[Detections]], settings: Tree, replicates: int) -> Tree:
    means, counts = {}, 0
    for name, row in sides.items():
        scored = [found.score("dds", bootstrap=Bootstrap(replicates=0), **settings) for found in row]
        means[name] = _mean([_DDS.of({"overall": result.figures}) for result in scored])
        counts = int(scored[0].counts["annotated"])
    a, b = sides.values()
    return {"annotated": counts, "means": means, "decision": _decided(a, b, settings, replicates)}


def _decided(a: Sequence[Detections], b: Sequence[Detections], settings: Tree, replicates: int) -> Tree | None:
    try:
        return decide(difference(a, b, _DDS, replicates=replicates, **settings)).to_json()
    except ConfigError:  # nothing is annotated there
        return None


def _switching(runs: Mapping[str, Sequence[Detections]], settings: Tree, replicates: int) -> Tree | None:
    seeds = [dict(zip(runs, each, strict=True)) for each in zip(*runs.values(), strict=True)]
    try:
        rules = [switched(found, _SWITCHED_BY, **settings) for found in seeds]
        gains = switching_gains(runs, _SWITCHED_BY, replicates=replicates, **settings)
    except ConfigError:  # too few drives, or roads that nobody states
        return None
    scored = [rule.found.score("dds", bootstrap=Bootstrap(replicates=0), **settings) for rule in rules]
    return {
        "by": _SWITCHED_BY,
        "choices": [dict(choice) for rule in rules for choice in rule.choices],
        "mean": _mean([_DDS.of({"overall": result.figures}) for result in scored]),
        "gains": {name: decide(gain).to_json() for name, gain in gains.items()},
    }


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known and len(known) == len(values) else None

"""All that a grid found as one JSON tree, in which no clock has a part: equal runs give equal files."""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from farfield.frame.provenance import environment
from farfield.papers.claims import Claim, Claims
from farfield.papers.deciding import DecidedComparison, Scores, to_json, verdict_of
from farfield.papers.grid import ExperimentGrid, Score, SimulatedSet, Tree
from farfield.papers.statistics import AnnotatedObjects
from farfield.papers.tables import classes_of, tables_of
from farfield.vocabulary.patterns import PATTERNS


@dataclass(frozen=True, kw_only=True)
class ReproductionSummary:
    """What was done.

    Args:
        paper: The paper.
        budget: Name of the budget.
        simulated: Whether runs were scored on simulated frames.
        steps: Steps by network.
        planned: Number of trainings that were planned.
        done: Number of those that are done.
        sets: Fingerprint of each set, and what was simulated for it.
        failed: Run, seed and reason of trainings that diverged.
        trained_on: Of each finished training's weights, their provenance.
    """

    paper: str
    budget: str
    simulated: bool
    steps: Mapping[str, int]
    planned: int
    done: int
    sets: Mapping[str, tuple[str, SimulatedSet | None]]
    failed: Sequence[tuple[str, int, str]] = ()
    trained_on: Sequence[Tree] = ()


def summary_of(
    made: ReproductionSummary,
    grid: ExperimentGrid,
    claims: Claims,
    scores: Scores,
    objects: AnnotatedObjects,
    decided: Sequence[DecidedComparison],
) -> Tree:
    """Tables, classes, claims and decisions as JSON values.

    Args:
        made: What was done.
        grid: The grid.
        claims: The claims.
        scores: Scores of the finished runs.
        objects: The annotated objects.
        decided: All comparisons.
    """
    settings = grid.budgets[made.budget]
    return {
        "paper": made.paper,
        "budget": made.budget,
        "words": settings.words,
        "simulated": made.simulated,
        "scaled": settings.scaled,
        "seeds": settings.seeds,
        "steps": dict(made.steps),
        "batch": settings.batch,
        "runs": {"planned": made.planned, "done": made.done},
        "left_out": {name: run.words for name, run in grid.runs.items() if name not in grid.runs_of(made.budget)},
        "failed": [{"run": run, "seed": seed, "why": why} for run, seed, why in made.failed],
        "claims_sha256": claims.sha256,
        "score": settings.score.model_dump(mode="json"),
        "networks": settings.networks,
        "sets": {name: _set(*known) for name, known in made.sets.items()},
        "tables": tables_of(claims, grid, settings, scores),
        "classes": classes_of(grid, settings, Counter(objects.label.tolist())),
        "claims": [_claim(claim, claims, decided) for claim in claims],
        "trained_on": _trainings(made.trained_on),
        "environment": environment(),
    }


def _trainings(provenances: Sequence[Tree]) -> list[Tree]:
    """On what runs were trained, from which frames and by which code, and how many each."""
    counts = Counter(json.dumps(_training(each), sort_keys=True) for each in provenances)
    return [{**json.loads(said), "runs": count} for said, count in sorted(counts.items(), key=_most)]


def _training(provenance: Tree) -> Tree:
    known = provenance.get("environment", {})
    return {
        "device": provenance.get("device") or known.get("processor"),
        "precision": provenance.get("precision"),
        "torch": known.get("versions", {}).get("torch"),
        "commit": known.get("commit"),
    }


def _most(item: tuple[str, int]) -> tuple[int, str]:
    return -item[1], item[0]


def _set(fingerprint: str, simulated: SimulatedSet | None) -> Tree:
    return {"fingerprint": fingerprint, "simulated": None if simulated is None else simulated.model_dump(mode="json")}


def _claim(claim: Claim, claims: Claims, decided: Sequence[DecidedComparison]) -> Tree:
    own = [each for each in decided if each.claim.id == claim.id]
    first = [each for each in own if each.first and each.role == "comparison"]
    return {
        "id": claim.id,
        "words": claim.words,
        "table": claim.table,
        "note": claim.note,
        "verdict": verdict_of(claim, first),
        "metrics": {name: claims.metrics[name].words for name in claim.metrics},
        "decided": [to_json(each) for each in own],
    }


def curves_of(scores: Scores, score: Score) -> dict[str, Tree]:
    """Results with their curves, of the first seed: each pattern by the detector that was trained on it."""
    found = {}
    for name in PATTERNS:
        clouds = scores.by_run.get(name, {}).get(0, {}).get("clouds", {})
        kept = clouds.get(name, {}).get("results", {}).get(score.tables[0])
        if kept and kept.get("curves"):
            found[name] = kept
    return found

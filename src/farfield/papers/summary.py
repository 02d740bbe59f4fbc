"""All that a grid found as one JSON tree, in which no clock has a part: equal runs give equal files.

Its tables are the paper's again: each row's published figures, ours with their spread over seeds, and the control rows.
"""

import json
import statistics
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from farfield.files.json_text import plain_json
from farfield.frame.provenance import environment
from farfield.metrics.result import at, value_at
from farfield.papers.claims import Claim, Claims
from farfield.papers.deciding import DecidedComparison, Scores, verdict_of
from farfield.papers.grid import BudgetSettings, ExperimentGrid, Score, SimulatedSet, Tree
from farfield.papers.jobs import cloud_of
from farfield.papers.statistics import AnnotatedObjects
from farfield.vocabulary.classes import CIRRUS_CLASSES
from farfield.vocabulary.patterns import PATTERNS
from farfield.vocabulary.published_tables import OVERALL, PUBLISHED_TABLES, PublishedTable


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
        validation: Curves of scores along the trainings, where there are any.
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
    validation: Sequence[Tree] = ()


def summary_of(
    summary: ReproductionSummary,
    grid: ExperimentGrid,
    claims: Claims,
    scores: Scores,
    objects: AnnotatedObjects,
    comparisons: Sequence[DecidedComparison],
) -> Tree:
    """Tables, classes, claims and decisions as JSON values.

    Args:
        summary: What was done.
        grid: The grid.
        claims: The claims.
        scores: Scores of the finished runs.
        objects: The annotated objects.
        comparisons: All comparisons with their decisions.
    """
    settings = grid.budgets[summary.budget]
    return {
        "paper": summary.paper,
        "budget": summary.budget,
        "words": settings.words,
        "simulated": summary.simulated,
        "scaled": settings.scaled,
        "seeds": settings.seeds,
        "steps": dict(summary.steps),
        "batch": settings.batch,
        "runs": {"planned": summary.planned, "done": summary.done},
        "left_out": {name: run.words for name, run in grid.runs.items() if name not in grid.runs_of(summary.budget)},
        "failed": [{"run": run, "seed": seed, "why": why} for run, seed, why in summary.failed],
        "claims_sha256": claims.sha256,
        "score": settings.score.model_dump(mode="json"),
        "networks": settings.networks,
        "sets": {
            name: {
                "fingerprint": fingerprint,
                "simulated": None if simulated is None else simulated.model_dump(mode="json"),
            }
            for name, (fingerprint, simulated) in summary.sets.items()
        },
        "tables": tables_of(claims, grid, settings, scores),
        "classes": classes_of(grid, settings, Counter(objects.label.tolist())),
        "claims": [_claim(claim, claims, comparisons) for claim in claims],
        "trained_on": _trained_on(summary.trained_on),
        **({"validation": list(summary.validation)} if summary.validation else {}),
        "environment": environment(),
    }


def _trained_on(provenances: Sequence[Tree]) -> list[Tree]:
    """Devices, precisions and versions that runs were trained with, and how many each; most runs first."""
    groups: Counter[str] = Counter()
    for provenance in provenances:
        machine = provenance.get("environment", {})
        group = {
            "device": provenance.get("device") or machine.get("processor"),
            "precision": provenance.get("precision"),
            "torch": machine.get("versions", {}).get("torch"),
            "commit": machine.get("commit"),
        }
        groups[json.dumps(group, sort_keys=True)] += 1
    return [{**plain_json(text), "runs": -count} for count, text in sorted((-n, text) for text, n in groups.items())]


def _claim(claim: Claim, claims: Claims, comparisons: Sequence[DecidedComparison]) -> Tree:
    own = [row for row in comparisons if row.claim.id == claim.id]
    deciding = [row for row in own if row.first and row.role == "comparison"]
    return {
        "id": claim.id,
        "words": claim.words,
        "table": claim.table,
        "note": claim.note,
        "verdict": verdict_of(claim, deciding),
        "metrics": {name: claims.metrics[name].words for name in claim.metrics},
        "decided": [row.to_json() for row in own],
    }


def curves_of(scores: Scores, score: Score) -> dict[str, Tree]:
    """Results with their curves, of the first seed: each pattern by the detector that was trained on it."""
    curves = {}
    for name in PATTERNS:
        clouds = scores.by_run.get(name, {}).get(0, {}).get("clouds", {})
        result = clouds.get(name, {}).get("results", {}).get(score.tables[0])
        if result and result.get("curves"):
            curves[name] = result
    return curves


# The paper's tables


class PaperTableRow(NamedTuple):
    """A row of a table: a run on a cloud, and the paper's row; empty for one that the paper does not print."""

    run: str
    cloud: str
    published: str = ""


def tables_of(claims: Claims, grid: ExperimentGrid, settings: BudgetSettings, scores: Scores) -> list[Tree]:
    """All tables of the paper whose rows were run, as JSON values."""
    trees = []
    for number, table in PUBLISHED_TABLES[claims.paper].items():
        rows = [_row(row, number, table, claims, grid, settings, scores) for row in _rows(number, claims, grid)]
        if any(row["n"] for row in rows):
            parts, bins = _parts(table), settings.score.parts(settings.score.table(number))
            trees.append(
                {
                    "number": number,
                    "title": table.title,
                    "parts": parts,
                    "bins": {part: bins[part] for part in parts if part in bins},
                    "metrics": {name: claims.metrics[name].words for name in _metrics(table) if name in claims.metrics},
                    "rows": [row for row in rows if row["n"] or row["published"]],
                }
            )
    return trees


def _metrics(table: PublishedTable) -> list[str]:
    cells = [metrics for row in table.figures.values() for metrics in row.values()]
    return list(dict.fromkeys(name for metrics in cells for name in metrics))


def _parts(table: PublishedTable) -> list[str]:
    parts = list(dict.fromkeys(part for row in table.figures.values() for part in row))
    return sorted(parts, key=OVERALL.__eq__)  # overall last; the order of the others stays


def _rows(number: str, claims: Claims, grid: ExperimentGrid) -> list[PaperTableRow]:
    """Rows of a table in the paper's order, then its controls and twins, without repetition."""
    printed: dict[str, PaperTableRow] = {}
    others: list[PaperTableRow] = []
    for claim, pair in claims.pairs:
        for row in (pair.a, pair.b):
            if row.run not in grid.runs:
                continue
            table, _, name = row.published.partition(" ")
            if table == number:
                printed.setdefault(name, PaperTableRow(row.run, cloud_of(row, grid), name))
            elif claim.table == number:
                others.append(PaperTableRow(row.run, cloud_of(row, grid)))
    for name, run in grid.runs.items():
        if number in run.tables:
            others += [PaperTableRow(name, cloud) for cloud in run.scored]
    first = [printed[name] for name in PUBLISHED_TABLES[claims.paper][number].figures if name in printed]
    shown = {(row.run, row.cloud) for row in first}
    return [*first, *(row for row in dict.fromkeys(others) if (row.run, row.cloud) not in shown)]


def _row(
    row: PaperTableRow,
    number: str,
    table: PublishedTable,
    claims: Claims,
    grid: ExperimentGrid,
    settings: BudgetSettings,
    scores: Scores,
) -> Tree:
    """A row as JSON values: in each part and metric the paper's figure, and ours over seeds."""
    by_seed = scores.by_run.get(row.run, {})
    table_name = settings.score.table(number)
    parts = settings.score.parts(table_name)
    results = {seed: at(tree, ("clouds", row.cloud, "results", table_name)) for seed, tree in by_seed.items()}
    cells: Tree = {}
    for part in _parts(table):
        for metric in _metrics(table):
            published = table.at(row.published, part, metric) if row.published else None
            declared = claims.metrics.get(metric)
            values = {}
            if declared is not None:
                name = parts.get(part, part)
                values = {seed: _value(result, name, declared.figure) for seed, result in results.items() if result}
            cells.setdefault(part, {})[metric] = {"published": published, **spread_of(values)}
    return {
        "run": row.run,
        "words": grid.runs[row.run].words,
        "cloud": row.cloud,
        "published": row.published,
        "n": len(by_seed),
        "cells": cells,
    }


def _value(result: Mapping[str, Any], part: str, name: str) -> float | None:
    if part == OVERALL:
        return value_at(result, name)
    kind, _, value = part.partition("/")
    figures = at(result, ("conditions", kind, value)) if value else at(result, ("ranges", part))
    return None if figures is None else value_at(figures, name)


def spread_of(values: Mapping[int, float | None]) -> Tree:
    """Mean and standard deviation over seeds; null where a seed has no figure."""
    figures = [value for value in values.values() if value is not None]
    figures = figures if len(figures) == len(values) else []
    return {
        "mean": statistics.fmean(figures) if figures else None,
        "s": statistics.stdev(figures) if len(figures) > 1 else None,
        "by_seed": {str(seed): value for seed, value in values.items()},
    }


def classes_of(grid: ExperimentGrid, settings: BudgetSettings, annotated: Mapping[str, int]) -> list[Tree]:
    """Every class of the data set: how many are annotated where runs are scored, and whether the grid learns it.

    Args:
        grid: The grid.
        settings: The budget.
        annotated: Number of annotated objects by class.
    """
    learnt = set(_learnt_classes(settings))
    names = CIRRUS_CLASSES if grid.paper == "cirrus" else tuple(sorted({*annotated, *learnt}))
    return [{"label": name, "annotated": int(annotated.get(name, 0)), "learnt": name in learnt} for name in names]


def _learnt_classes(settings: BudgetSettings) -> Iterator[str]:
    """Classes that any network of a budget has an anchor or a size of."""
    for tree in settings.networks.values():
        classes: Mapping[str, Any] = tree.get("anchors") or tree.get("sizes_m") or {"vehicle": None}
        yield from classes

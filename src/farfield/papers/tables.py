"""The paper's tables again: each row's published figures, ours with their spread over seeds, and the control rows."""

import statistics
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from farfield.metrics.result import at, value_at
from farfield.papers.claims import Claims
from farfield.papers.deciding import Scores
from farfield.papers.grid import BudgetSettings, ExperimentGrid, Tree
from farfield.papers.needs import cloud_of, pairs_of
from farfield.vocabulary.classes import CIRRUS_CLASSES
from farfield.vocabulary.published_tables import OVERALL, PUBLISHED_TABLES, PublishedTable


@dataclass(frozen=True)
class PaperTableRow:
    """A row of a table: a run on a cloud.

    Args:
        run: The run.
        cloud: The cloud that it is scored on.
        published: The paper's row; empty for one that the paper does not print.
    """

    run: str
    cloud: str
    published: str = ""


def tables_of(claims: Claims, grid: ExperimentGrid, settings: BudgetSettings, scores: Scores) -> list[Tree]:
    """All tables of the paper whose rows were run, as JSON values."""
    found = []
    for number, table in PUBLISHED_TABLES[claims.paper].items():
        rows = _rows(number, claims, grid)
        lines = [
            line for row in rows if (line := _line(row, number, table, claims, grid, settings, scores)) is not None
        ]
        if any(line["n"] for line in lines):
            title, metrics = table.title, _metrics(table)
            parts = _parts(table)
            bins = settings.score.parts(settings.score.table(number))
            found.append(
                {
                    "number": number,
                    "title": title,
                    "parts": parts,
                    "bins": {part: bins[part] for part in parts if part in bins},
                    "metrics": {name: claims.metrics[name].words for name in metrics if name in claims.metrics},
                    "rows": lines,
                }
            )
    return found


def _metrics(table: PublishedTable) -> list[str]:
    parts = [metrics for row in table.figures.values() for metrics in row.values()]
    return list(dict.fromkeys(name for metrics in parts for name in metrics))


def _parts(table: PublishedTable) -> list[str]:
    found = list(dict.fromkeys(part for row in table.figures.values() for part in row))
    return sorted(found, key=OVERALL.__eq__)  # overall last; the order of the others stays


def _rows(number: str, claims: Claims, grid: ExperimentGrid) -> list[PaperTableRow]:
    """Rows of a table in the paper's order, then its controls and twins, each once."""
    printed, others = dict[str, PaperTableRow](), list[PaperTableRow]()
    for claim, pair in pairs_of(claims):
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
    order = [name for name in PUBLISHED_TABLES[claims.paper][number].figures if name in printed]
    first = [printed[name] for name in order]
    known = {(row.run, row.cloud) for row in first}
    return [*first, *(row for row in dict.fromkeys(others) if (row.run, row.cloud) not in known)]


def _line(
    row: PaperTableRow,
    number: str,
    table: PublishedTable,
    claims: Claims,
    grid: ExperimentGrid,
    settings: BudgetSettings,
    scores: Scores,
) -> Tree | None:
    by_seed = scores.by_run.get(row.run, {})
    kept = settings.score.table(number)
    parts = settings.score.parts(kept)
    cells: Tree = {}
    for part in _parts(table):
        for metric in _metrics(table):
            published = table.at(row.published, part, metric) if row.published else None
            declared = claims.metrics.get(metric)
            values = {}
            if declared is not None:
                named = parts.get(part, part)
                results = {seed: at(each, ("clouds", row.cloud, "results", kept)) for seed, each in by_seed.items()}
                values = {seed: _value(found, named, declared.figure) for seed, found in results.items() if found}
            cells.setdefault(part, {})[metric] = {"published": published, **spread_of(values)}
    if not by_seed and not row.published:
        return None
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
    home = at(result, ("conditions", kind, value)) if value else at(result, ("ranges", part))
    return None if home is None else value_at(home, name)


def spread_of(values: Mapping[int, float | None]) -> Tree:
    """Mean and standard deviation over seeds; null where a seed has no figure."""
    known = [value for value in values.values() if value is not None]
    whole = known if len(known) == len(values) else []
    return {
        "mean": statistics.fmean(whole) if whole else None,
        "s": statistics.stdev(whole) if len(whole) > 1 else None,
        "by_seed": {str(seed): value for seed, value in values.items()},
    }


def classes_of(grid: ExperimentGrid, settings: BudgetSettings, annotated: Mapping[str, int]) -> list[Tree]:
    """Every class of the data set: how many are annotated where runs are scored, and whether the grid learns it.

    Args:
        grid: The grid.
        settings: The budget.
        annotated: Number of annotated objects by class.
    """
    learnt = set(_learnt(settings))
    names = CIRRUS_CLASSES if grid.paper == "cirrus" else tuple(sorted({*annotated, *learnt}))
    return [{"label": name, "annotated": int(annotated.get(name, 0)), "learnt": name in learnt} for name in names]


def _learnt(settings: BudgetSettings) -> Iterator[str]:
    """Classes that any network of a budget has an anchor or a size of."""
    for tree in settings.networks.values():
        named: Mapping[str, Any] = tree.get("anchors") or tree.get("sizes_m") or {"vehicle": None}
        yield from named

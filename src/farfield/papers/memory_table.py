"""Peak memory of the processes that trained and scored the runs of a reproduction, as K-Radar's Table 9 has it."""

import statistics
from collections.abc import Mapping
from typing import Any

MEMORY = "memory_mb"
"""The figure as published tables call it."""
MEMORY_WORDS = "peak memory of the process (paper: of the GPU)"


def peaks_mb(timing: Mapping[str, Any]) -> dict[str, list[float]]:
    """Peak memory by run, 10^6 bytes, a figure a seed. A run that was gone on with counts with its highest.

    A run whose weights were brought from elsewhere has none: to score takes less than to train.

    Args:
        timing: What ``timing.json`` holds.
    """
    peaks: dict[str, list[float]] = {}
    for run in timing["runs"].values():
        if brought(run):
            continue
        known = [clock["peak_memory_mb"] for clock in run["clock"] if clock.get("peak_memory_mb")]
        for name in run["runs"] if known else []:
            peaks.setdefault(name, []).append(max(known))
    return peaks


def brought(run: Mapping[str, Any]) -> bool:
    """Whether a finished run was only scored here: its weights were there.

    Args:
        run: One of the runs of ``timing.json``.
    """
    return bool(run["clock"]) and all(clock.get("brought") for clock in run["clock"])


def with_memory(table: Mapping[str, Any], timing: Mapping[str, Any]) -> Mapping[str, Any]:
    """A table whose rows hold our peak beside the published memory; one that publishes none stays as it is.

    Args:
        table: One of the summary's tables.
        timing: What ``timing.json`` holds.
    """
    rows = [row for row in table["rows"] if _published(row) is not None]
    if not rows:
        return table
    peaks = peaks_mb(timing)
    filled = [_filled(row, peaks.get(row["run"], [])) if row in rows else row for row in table["rows"]]
    return {**table, "metrics": {**table["metrics"], MEMORY: MEMORY_WORDS}, "rows": filled}


def _published(row: Mapping[str, Any]) -> float | None:
    return row["cells"].get("overall", {}).get(MEMORY, {}).get("published")


def _filled(row: Mapping[str, Any], peaks: list[float]) -> Mapping[str, Any]:
    ours = {
        "published": _published(row),
        "mean": statistics.fmean(peaks) if peaks else None,
        "s": statistics.stdev(peaks) if len(peaks) > 1 else None,
    }
    return {**row, "cells": {**row["cells"], "overall": {**row["cells"]["overall"], MEMORY: ours}}}


def memory_rows(timing: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Median over seeds of the peak of each run, in words."""
    found = peaks_mb(timing)
    return [(name.replace("_", " "), f"{statistics.median(values):,.0f} MB") for name, values in found.items()]


def unmeasured(summary: Mapping[str, Any], timing: Mapping[str, Any]) -> list[str]:
    """Runs of which no peak is known, and why; a sentence each kind.

    Args:
        summary: What ``reproduction.json`` holds.
        timing: What ``timing.json`` holds.
    """
    known, left_out = peaks_mb(timing), summary.get("left_out", {})
    runs = list(timing["runs"].values())
    done = {name for run in runs for name in run["runs"]}
    elsewhere = {name for run in runs if brought(run) for name in run["runs"]} - set(known)
    rows = {row["run"] for table in summary["tables"] for row in table["rows"]}
    kinds = {
        "Not run at this budget": [name for name in left_out if name not in done],
        "Not finished": sorted(rows - done - set(left_out)),
        "Trained elsewhere": sorted(elsewhere),
        "Done where the system does not say it": sorted(done - set(known) - elsewhere),
    }
    return [f"{kind}: {', '.join(each.replace('_', ' ') for each in names)}." for kind, names in kinds.items() if names]

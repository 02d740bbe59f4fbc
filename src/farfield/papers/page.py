"""The page of a reproduction: the paper's figure, ours, the decision on each claim, and plainly what was simulated.

Of memory it shows the peak of the processes that trained and scored, as K-Radar's Table 9 has it of the GPU.
"""

import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from farfield.figures.dataset_plots import features_apart, points_by_range, ranges_of_classes, returns_by_weather
from farfield.figures.plots import precision_recall
from farfield.figures.style import figure_uri
from farfield.figures.training_plots import validation_curves
from farfield.files.atomic import write_text
from farfield.pages.template import PageImage, render_template
from farfield.papers.scenarios import NOTHING, scenario_tables
from farfield.papers.sheets import SheetGroup
from farfield.vocabulary.counts import count_of
from farfield.vocabulary.patterns import PATTERNS

MEMORY = "memory_mb"
"""The figure as published tables call it."""
MEMORY_WORDS = "peak memory of the process (paper: of the GPU)"
_TITLES = {"cirrus": "Cirrus, put to the test", "kradar": "K-Radar, put to the test"}
_RELATIONS = {"above": "above", "not_below": "not below", "equivalent": "as good as"}
_TONES = {"holds": "good", "holds by construction": "good", "holds not": "bad"}


View = dict[str, Any]
"""Texts that the template shows, by name."""


def write_page(
    path: Path,
    summary: Mapping[str, Any],
    timing: Mapping[str, Any],
    *,
    curves: Mapping[str, Mapping[str, Any]] | None = None,
    objects: Mapping[str, Any] | None = None,
    sheets: Sequence[SheetGroup] = (),
) -> Path:
    """Write the page, all or nothing.

    Args:
        path: The HTML file.
        summary: What ``reproduction.json`` holds.
        timing: What ``timing.json`` holds.
        curves: Results with their curves, by pattern.
        objects: Range, class, weather and points of every annotated object, for pictures of the data.
        sheets: Figures of single moments.
    """
    claims = [_claim(claim) for claim in summary["claims"]]
    simulated, scaled = summary["simulated"], summary["scaled"]
    caption = ", ".join(word for word, holds in (("simulated", simulated), ("scaled", scaled)) if holds)
    clocks = [clock for run in timing["runs"].values() for clock in run["clock"]]
    page = render_template(
        "reproduction.html",
        package="farfield.papers",
        title=_TITLES.get(summary["paper"], summary["paper"]),
        caption=caption or "real data",
        summary=summary,
        headline=_headline(claims, summary),
        claims=claims,
        tables=[_table(table, summary, timing) for table in summary["tables"]],
        classes=summary["classes"],
        scenarios=scenario_tables(summary.get("scenarios") or {}),
        validation=_validation(summary.get("validation", ())),
        pictures=[
            *_learning(summary.get("validation", ())),
            *_pictures(summary["paper"], curves or {}, objects or {}),
            *_features(summary.get("features", ())),
        ],
        sheets=[(group, group.pictures()) for group in sheets],
        memory=memory_rows(timing),
        unmeasured=missing_memory(summary, timing),
        minutes=sum(float(clock["processor_s"]) for clock in clocks) / 60,
        brought=sum(map(only_scored, timing["runs"].values())),
        facts=_facts(summary, timing),
    )
    write_text(path, page)
    return path


def _headline(claims: Sequence[View], summary: Mapping[str, Any]) -> str:
    verdicts = [claim["verdict"] for claim in claims]
    holding = verdicts.count("holds") + verdicts.count("holds by construction")
    undecided, refuted = verdicts.count("undecided"), verdicts.count("holds not")
    rest = len(claims) - holding - undecided - refuted
    runs = summary["runs"]
    return (
        f"Of {len(claims)} claims {holding} hold, {refuted} hold not, {undecided} are undecided and "
        f"{rest} could not be put to the test at this size. {runs['done']} of {runs['planned']} trainings are done."
    )


def _claim(claim: Mapping[str, Any]) -> View:
    comparisons = [_comparison(comparison, claim["metrics"]) for comparison in claim["decided"]]
    return {**claim, "tone": _TONES.get(claim["verdict"], ""), "comparisons": comparisons}


def _comparison(comparison: Mapping[str, Any], metrics: Mapping[str, str]) -> View:
    """A difference between two rows with its decision, as texts; empty where there is none."""
    decision, adjusted = comparison["decision"], comparison["adjusted"]
    difference = decision["difference"] if decision else {}
    interval, spreads = difference.get("interval"), difference.get("s_seed") or {}
    margin = f" (margin {comparison['margin']:g})" if comparison["margin"] else ""
    own = spreads.get("own")
    relation = _RELATIONS[comparison["kind"]]
    return {
        "what": f"{_row_words(comparison['a'])} {relation} {_row_words(comparison['b'])}{margin}",
        "control": comparison["role"] == "control",
        "metric": metrics[comparison["metric"]],
        "published": _signed(comparison["published"]),
        "difference": _signed(difference.get("estimate")),
        "interval": f"{_signed(interval[0])} to {_signed(interval[1])}" if interval else "",
        "seeds": str(difference["n"]) if difference.get("trained") else "",
        "spread": NOTHING if own is None else f"{own:.3f}",
        "verdict": decision["words"] if decision else "not run",
        "adjusted": adjusted["verdict"] if adjusted else "",
        "power": NOTHING if comparison["power"] is None else f"{comparison['power']:.0%}",
        "excludes": comparison["excludes"],
        "tone": _TONES.get(decision["verdict"], "") if decision else "",
    }


def _row_words(row: Mapping[str, Any]) -> str:
    words = [row["run"].replace("_", " "), f"on {row['cloud']}" if row["cloud"] else ""]
    part, minus = (row[key].removeprefix("weather/").replace("_", " ") for key in ("part", "minus"))
    unit, subtracted = " m" if part[:1].isdigit() else "", f" minus {minus}" if minus else ""
    words.append("" if part == "overall" else f"({part}{unit}{subtracted})")
    words += ["[frames matched]"] if row["matched"] else []
    words += [f"[{row['metric']}]"] if row["metric"] else []
    return " ".join(word for word in words if word)


def _signed(value: float | None) -> str:
    return NOTHING if value is None else f"{value:+.3f}"


def _table(tree: Mapping[str, Any], summary: Mapping[str, Any], timing: Mapping[str, Any]) -> View:
    """A table of the paper again: columns, lines (a row and a metric each), and rows without a figure of ours."""
    table = with_memory(tree, timing)
    metrics, rows, left_out = table["metrics"], table["rows"], summary.get("left_out", {})
    parts = [part for part in table["parts"] if any(_has(row, part, metric) for row in rows for metric in metrics)]
    columns = []
    for part in parts:
        name = "all" if part == "overall" else part.removeprefix("weather/").replace("_", " ")
        columns.append(f"{name} (ours {table['bins'][part]} m)" if part in table["bins"] else name)
    lines, lacking = [], []
    for row in rows:
        name = f"{row['words']}, on {row['cloud']}"
        if not row["n"]:
            reason = "not run at this budget" if row["run"] in left_out else "no finished run yet"
            lacking.append(f"{name} ({reason})")
        if row["n"] or row["published"]:
            for index, (metric, words) in enumerate(_shown_metrics(row, parts, metrics)):
                line = {
                    "name": "" if index else name,  # empty where the row goes on in another metric
                    "metric": words,
                    "printed": bool(row["published"]),
                    "seeds": None if index else row["n"],
                    "cells": [_cell(row["cells"].get(part, {}).get(metric), metric) for part in parts],
                }
                lines.append(line)
    title = f"Table {table['number']}: {table['title']}"
    return {"title": title, "columns": columns, "lines": lines, "lacking": lacking}


def _shown_metrics(row: Mapping[str, Any], parts: Sequence[str], metrics: Mapping[str, str]) -> list[tuple[str, str]]:
    """Metrics of a row: those that the paper prints for it; of one that it does not print the first and wDDS."""
    of_row = [(name, words) for name, words in metrics.items() if any(_has(row, part, name) for part in parts)]
    if not row["published"]:
        return [metric for metric in of_row if metric[0] in (next(iter(metrics)), "wdds")]
    return of_row


def _has(row: Mapping[str, Any], part: str, metric: str) -> bool:
    """Whether the paper or a run has a figure in a cell."""
    cell = row["cells"].get(part, {}).get(metric)
    return cell is not None and (cell["published"] is not None or cell["mean"] is not None)


def _cell(cell: Mapping[str, Any] | None, metric: str) -> View:
    """The paper's figure, our mean over seeds and its standard deviation, as texts."""
    if cell is None:
        return {"published": NOTHING, "ours": NOTHING, "spread": ""}
    in_mb = metric == MEMORY
    return {
        "published": _figure(cell["published"], in_mb=in_mb),
        "ours": "nothing found" if cell["mean"] == 0 else _figure(cell["mean"], in_mb=in_mb),
        "spread": f"s {_figure(cell['s'], in_mb=in_mb)}" if cell["s"] else "",
    }


def _figure(value: float | None, *, in_mb: bool) -> str:
    if value is None:
        return NOTHING
    return f"{value:,.0f} MB" if in_mb else f"{value:.3f}"


def _facts(summary: Mapping[str, Any], timing: Mapping[str, Any]) -> list[tuple[str, str]]:
    steps = ", ".join(f"{name} {count}" for name, count in summary["steps"].items())
    sets = []
    for name, data in summary["sets"].items():
        simulated, source = data["simulated"], "real"
        if simulated:
            frames = f"{simulated['sequences']} x {count_of(simulated['frames'], 'frame')}"
            source = f"{frames} of {simulated['preset']}, seed {simulated['seed']}"
        sets.append(f"{name}: {source} ({data['fingerprint'][:12]})")
    groups = []
    for group in summary["trained_on"]:
        device = group["device"] or "a device that its weights do not name"
        machine = ", ".join(word for word in (device, group["precision"], f"torch {group['torch']}") if word)
        runs = count_of(group["runs"], "run")
        groups.append(f"{runs}: {machine}, commit {group['commit']}")
    here, planned, options = summary["environment"], timing["planned"], timing.get("options", {})
    cost = f"{planned['core_minutes']:.0f} core minutes" if planned["core_minutes"] else "all trainings were there"
    chosen = {name: options.get(name, "") for name in ("device", "precision")}
    flags = ", ".join(f"{name} {value}" for name, value in chosen.items() if value not in ("", "auto"))
    return [
        ("budget", f"{summary['budget']}: {summary['words']}"),
        ("seeds", str(summary["seeds"])),
        ("steps", f"{steps}; {count_of(summary['batch'], 'frame')} a step of one pattern"),
        ("data", "; ".join(sets)),
        ("claims", f"declared before the runs, SHA-256 {summary['claims_sha256']}"),
        ("planned", f"{cost}, {count_of(planned['workers'], 'worker')}{f'; asked for: {flags}' if flags else ''}"),
        ("trained on", "; ".join(groups) or NOTHING),
        ("commit", str(here["commit"])),
        ("versions", ", ".join(f"{name} {version}" for name, version in here["versions"].items())),
        ("machine", f"{here['processor']}, Python {here['python']}"),
    ]


def _validation(curves: Sequence[Mapping[str, Any]]) -> list[View]:
    """Of each run the score after the last step, the gain over the last third and what the rule says, seed by seed."""
    rows = []
    for curve in curves:
        sides = [("mean over seeds", curve["mean"]), *((f"seed {seed['seed']}", seed) for seed in curve["seeds"])]
        for index, (name, side) in enumerate(sides):
            interval = side["interval"]
            row = {
                "run": "" if index else curve["run"].replace("_", " "),
                "side": name,
                "score": _figure(side["scores"][-1] if side["scores"] else None, in_mb=False),
                "gain": _signed(side["gain"]),
                "interval": f"{_signed(interval[0])} to {_signed(interval[1])}" if interval else "",
                "words": side["words"],
            }
            rows.append(row)
    return rows


def _learning(curves: Sequence[Mapping[str, Any]]) -> list[PageImage]:
    """The curves of the runs that were scored while they trained."""
    if not curves:
        return []
    named = {
        f"{curve['run'].replace('_', ' ')}: {curve['mean']['words']}": [
            (seed["steps"], seed["scores"]) for seed in curve["seeds"]
        ]
        for curve in curves
    }
    return [
        PageImage(
            figure_uri(validation_curves(named)),
            "Score on held-out roads over the steps of each training, a panel a row of the table and a line a seed",
            f"nuScenes' mean AP over classes on {count_of(curves[0]['frames'], 'frame')} "
            "of roads that were held out of the "
            "training; the frozen split that decides has no part in it. Shaded: the last third, over which the "
            "gain is taken.",
            heading="Scores while they trained",
        )
    ]


def _features(pairs: Sequence[Mapping[str, Any]]) -> list[PageImage]:
    """Features before and after the adaptations."""
    return [
        PageImage(
            figure_uri(features_apart(pair)),
            f"Features of occupied cells on two axes, coloured by {pair['by']}, before and after adaptation",
            "Features that enter the head, at cells that hold points, on the two axes along which they vary most; left "
            "before, right after. Told apart: balanced accuracy of a linear probe on other frames; 50 % is chance.",
            heading=f"Features by {pair['by']}",
        )
        for pair in pairs
    ]


def _pictures(paper: str, curves: Mapping[str, Mapping[str, Any]], objects: Mapping[str, Any]) -> list[PageImage]:
    pictures = []
    if paper == "cirrus" and objects and set(PATTERNS) & set(objects["points"]):
        pictures.append(
            PageImage(
                figure_uri(points_by_range(objects)),
                "Density of the number of points inside annotated boxes over range, for each pattern",
                "Every annotated object of the frames that runs are scored on. Darker: more objects. The line is the "
                "mean number of points in 25 m of range.",
                heading="Figure 4: points inside annotated boxes",
            )
        )
        pictures.append(
            PageImage(
                figure_uri(ranges_of_classes(objects)),
                "Histograms of the distance of annotated objects, and of their classes",
                "What is annotated in these frames.",
                heading="Figure 6: annotated objects",
            )
        )
    if curves:
        pictures.append(
            PageImage(
                figure_uri(precision_recall(curves)),
                "Precision over recall of the detectors of both patterns, one line for each distance",
                "Each pattern by the detector that was trained on it, first seed.",
                heading="Figure 7: precision and recall",
            )
        )
    if paper == "kradar" and objects and "os2-64" in objects["points"]:
        pictures.append(
            PageImage(
                figure_uri(returns_by_weather(objects, "os2-64")),
                "Share of annotated objects with at least five LiDAR returns, by weather",
                "Objects on which the os2-64 has five returns or more. Where data are simulated, the ice on its window "
                "is an input of the simulation.",
                heading="Returns on objects by weather",
            )
        )
    return pictures


# Peak memory


def peaks_mb(timing: Mapping[str, Any]) -> dict[str, list[float]]:
    """Peak memory by run, 10^6 bytes, a figure a seed. A run that was gone on with counts with its highest.

    A run whose weights were brought from elsewhere has none: to score takes less than to train.

    Args:
        timing: What ``timing.json`` holds.
    """
    peaks: dict[str, list[float]] = {}
    for run in timing["runs"].values():
        if only_scored(run):
            continue
        of_run = [clock["peak_memory_mb"] for clock in run["clock"] if clock.get("peak_memory_mb")]
        for name in run["runs"] if of_run else []:
            peaks.setdefault(name, []).append(max(of_run))
    return peaks


def only_scored(run: Mapping[str, Any]) -> bool:
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
    filled = []
    for row in table["rows"]:
        of_row = peaks.get(row["run"], [])
        ours = {
            "published": _published(row),
            "mean": statistics.fmean(of_row) if of_row else None,
            "s": statistics.stdev(of_row) if len(of_row) > 1 else None,
        }
        cells = {**row["cells"], "overall": {**row["cells"].get("overall", {}), MEMORY: ours}}
        filled.append({**row, "cells": cells} if row in rows else row)
    return {**table, "metrics": {**table["metrics"], MEMORY: MEMORY_WORDS}, "rows": filled}


def _published(row: Mapping[str, Any]) -> float | None:
    return row["cells"].get("overall", {}).get(MEMORY, {}).get("published")


def memory_rows(timing: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Median over seeds of the peak of each run, in words."""
    peaks = peaks_mb(timing)
    return [(name.replace("_", " "), f"{statistics.median(values):,.0f} MB") for name, values in peaks.items()]


def missing_memory(summary: Mapping[str, Any], timing: Mapping[str, Any]) -> list[str]:
    """Runs without a measured peak, and why; a sentence a reason.

    Args:
        summary: What ``reproduction.json`` holds.
        timing: What ``timing.json`` holds.
    """
    measured, left_out = peaks_mb(timing), summary.get("left_out", {})
    runs = list(timing["runs"].values())
    finished = {name for run in runs for name in run["runs"]}
    elsewhere = {name for run in runs if only_scored(run) for name in run["runs"]} - set(measured)
    rows = {row["run"] for table in summary["tables"] for row in table["rows"]}
    reasons = {
        "Not run at this budget": [name for name in left_out if name not in finished],
        "Not finished": sorted(rows - finished - set(left_out)),
        "Trained elsewhere": sorted(elsewhere),
        "Done where the system does not say it": sorted(finished - set(measured) - elsewhere),
    }
    shown = {reason: [name.replace("_", " ") for name in names] for reason, names in reasons.items() if names}
    return [f"{reason}: {', '.join(names)}." for reason, names in shown.items()]

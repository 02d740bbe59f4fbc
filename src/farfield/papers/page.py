"""The page of a reproduction: the paper's figure, ours, the decision on each claim, and plainly what was simulated."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from farfield.figures.dataset_plots import features_apart, points_by_range, ranges_of_classes, returns_by_weather
from farfield.figures.plots import precision_recall
from farfield.figures.style import figure_uri
from farfield.files.atomic import write_text
from farfield.pages.template import PageImage, render_template
from farfield.papers.memory_table import MEMORY, brought, memory_rows, unmeasured, with_memory
from farfield.papers.radar_sheets import SheetGroup
from farfield.papers.scenario_tables import scenarios
from farfield.vocabulary.patterns import PATTERNS

NOTHING = "–"
_TITLES = {"cirrus": "Cirrus, put to the test", "kradar": "K-Radar, put to the test"}
_RELATIONS = {"above": "above", "not_below": "not below", "equivalent": "as good as"}
_TONES = {"holds": "good", "holds by construction": "good", "holds not": "bad"}


@dataclass(frozen=True, kw_only=True)
class ScoreCell:
    """A figure of a table.

    Args:
        published: The paper's.
        ours: Our mean over seeds.
        spread: Its standard deviation over seeds.
    """

    published: str
    ours: str
    spread: str


@dataclass(frozen=True, kw_only=True)
class TableLine:
    """A row of a table.

    Args:
        name: What the run is, and the cloud that it was scored on; empty where it goes on in another metric.
        metric: The metric.
        printed: Whether the paper prints the row.
        seeds: Number of seeds; None where it goes on.
        cells: Figures in the order of the table's columns.
    """

    name: str
    metric: str
    printed: bool
    seeds: int | None
    cells: tuple[ScoreCell, ...]


@dataclass(frozen=True, kw_only=True)
class PaperTable:
    """A table of the paper again.

    Args:
        title: Its title.
        columns: Heads of its columns: ranges or weathers.
        lines: Its rows, controls last.
        lacking: Rows that the page has no figure of ours for, and why.
    """

    title: str
    columns: tuple[str, ...]
    lines: tuple[TableLine, ...]
    lacking: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class ComparisonView:
    """A difference between two rows, as the page shows it; texts of figures, empty where there are none."""

    what: str
    control: bool
    metric: str
    published: str
    difference: str
    interval: str
    seeds: str
    spread: str
    verdict: str
    adjusted: str
    power: str
    excludes: str
    tone: str = ""


@dataclass(frozen=True, kw_only=True)
class ClaimView:
    """A claim with its comparisons."""

    id: str
    words: str
    table: str
    verdict: str
    note: str
    tone: str
    comparisons: tuple[ComparisonView, ...] = field(default=())


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
    claims = [_claim(each) for each in summary["claims"]]
    page = render_template(
        "reproduction.html",
        package="farfield.papers",
        title=_TITLES.get(summary["paper"], summary["paper"]),
        caption="simulated, scaled" if summary["simulated"] and summary["scaled"] else _caption(summary),
        summary=summary,
        headline=_headline(claims, summary),
        claims=claims,
        tables=[_table(each, summary, timing) for each in summary["tables"]],
        classes=summary["classes"],
        scenarios=scenarios(summary.get("scenarios") or {}),
        pictures=[*_pictures(summary["paper"], curves or {}, objects or {}), *_features(summary.get("features", ()))],
        sheets=[(group, group.pictures()) for group in sheets],
        memory=memory_rows(timing),
        unmeasured=unmeasured(summary, timing),
        minutes=_minutes(timing),
        brought=sum(map(brought, timing["runs"].values())),
        facts=_facts(summary, timing),
    )
    write_text(path, page)
    return path


def _caption(summary: Mapping[str, Any]) -> str:
    return "simulated" if summary["simulated"] else "scaled" if summary["scaled"] else "real data"


def _headline(claims: Sequence[ClaimView], summary: Mapping[str, Any]) -> str:
    counts = {
        word: sum(claim.verdict.startswith(word) and not claim.verdict.startswith(f"{word} not") for claim in claims)
        for word in ("holds", "undecided")
    }
    fails = sum(claim.verdict == "holds not" for claim in claims)
    rest = len(claims) - counts["holds"] - counts["undecided"] - fails
    runs = summary["runs"]
    return (
        f"Of {len(claims)} claims {counts['holds']} hold, {fails} hold not, {counts['undecided']} are undecided and "
        f"{rest} could not be put to the test at this size. {runs['done']} of {runs['planned']} trainings are done."
    )


def _claim(claim: Mapping[str, Any]) -> ClaimView:
    return ClaimView(
        id=claim["id"],
        words=claim["words"],
        table=claim["table"],
        verdict=claim["verdict"],
        note=claim["note"],
        tone=_TONES.get(claim["verdict"], ""),
        comparisons=tuple(_comparison(each, claim["metrics"]) for each in claim["decided"]),
    )


def _comparison(each: Mapping[str, Any], metrics: Mapping[str, str]) -> ComparisonView:
    decision, adjusted = each["decision"], each["adjusted"]
    found = decision["difference"] if decision else {}
    interval, spreads = found.get("interval"), found.get("s_seed") or {}
    margin = f" (margin {each['margin']:g})" if each["margin"] else ""
    own = spreads.get("own")
    return ComparisonView(
        what=f"{_row(each['a'])} {_RELATIONS[each['kind']]} {_row(each['b'])}{margin}",
        control=each["role"] == "control",
        metric=metrics[each["metric"]],
        published=_signed(each["published"]),
        difference=_signed(found.get("estimate")),
        interval=f"{_signed(interval[0])} to {_signed(interval[1])}" if interval else "",
        seeds=str(found["n"]) if found.get("trained") else "",
        spread=NOTHING if own is None else f"{own:.3f}",
        verdict=decision["words"] if decision else "not run",
        adjusted=adjusted["verdict"] if adjusted else "",
        power=NOTHING if each["power"] is None else f"{each['power']:.0%}",
        excludes=each["excludes"],
        tone=_TONES.get(decision["verdict"], "") if decision else "",
    )


def _row(row: Mapping[str, Any]) -> str:
    words = [row["run"].replace("_", " "), f"on {row['cloud']}" if row["cloud"] else ""]
    part = row["part"].removeprefix("weather/").replace("_", " ")
    words.append("" if part == "overall" else f"({part}{' m' if part[:1].isdigit() else ''}{_minus(row)})")
    words += ["[frames matched]"] if row["matched"] else []
    words += [f"[{row['metric']}]"] if row["metric"] else []
    return " ".join(word for word in words if word)


def _minus(row: Mapping[str, Any]) -> str:
    return f" minus {row['minus'].removeprefix('weather/').replace('_', ' ')}" if row["minus"] else ""


def _signed(value: float | None) -> str:
    return NOTHING if value is None else f"{value:+.3f}"


def _table(bare: Mapping[str, Any], summary: Mapping[str, Any], timing: Mapping[str, Any]) -> PaperTable:
    table = with_memory(bare, timing)
    metrics, rows, left_out = table["metrics"], table["rows"], summary.get("left_out", {})
    parts = [part for part in table["parts"] if any(_known(row, part, metric) for row in rows for metric in metrics)]
    shown = [row for row in rows if row["n"] or row["published"]]
    return PaperTable(
        title=f"Table {table['number']}: {table['title']}",
        columns=tuple(_part(part, table["bins"]) for part in parts),
        lines=tuple(
            _line(row, parts, metric, words, first=place == 0)
            for row in shown
            for place, (metric, words) in enumerate(_shown(row, parts, metrics))
        ),
        lacking=tuple(
            f"{_called(row)} ({'not run at this budget' if row['run'] in left_out else 'no finished run yet'})"
            for row in rows
            if not row["n"]
        ),
    )


def _shown(row: Mapping[str, Any], parts: Sequence[str], metrics: Mapping[str, str]) -> list[tuple[str, str]]:
    """Metrics of a row: those that the paper prints for it; of one that it does not print the first and wDDS."""
    known = [(name, words) for name, words in metrics.items() if any(_known(row, part, name) for part in parts)]
    if not row["published"]:
        return [each for each in known if each[0] in (next(iter(metrics)), "wdds")]
    return known


def _part(part: str, bins: Mapping[str, str]) -> str:
    name = "all" if part == "overall" else part.removeprefix("weather/").replace("_", " ")
    return f"{name} (ours {bins[part]} m)" if part in bins else name


def _known(row: Mapping[str, Any], part: str, metric: str) -> bool:
    cell = row["cells"].get(part, {}).get(metric)
    return cell is not None and (cell["published"] is not None or cell["mean"] is not None)


def _called(row: Mapping[str, Any]) -> str:
    return f"{row['words']}, on {row['cloud']}"


def _line(row: Mapping[str, Any], parts: Sequence[str], metric: str, words: str, *, first: bool) -> TableLine:
    return TableLine(
        name=_called(row) if first else "",
        metric=words,
        printed=bool(row["published"]),
        seeds=row["n"] if first else None,
        cells=tuple(_cell(row["cells"].get(part, {}).get(metric), metric) for part in parts),
    )


def _cell(cell: Mapping[str, Any] | None, metric: str) -> ScoreCell:
    if cell is None:
        return ScoreCell(published=NOTHING, ours=NOTHING, spread="")
    in_mb = metric == MEMORY
    return ScoreCell(
        published=_figure(cell["published"], in_mb=in_mb),
        ours="nothing found" if cell["mean"] == 0 else _figure(cell["mean"], in_mb=in_mb),
        spread=f"s {_figure(cell['s'], in_mb=in_mb)}" if cell["s"] else "",
    )


def _figure(value: float | None, *, in_mb: bool) -> str:
    if value is None:
        return NOTHING
    return f"{value:,.0f} MB" if in_mb else f"{value:.3f}"


def _minutes(timing: Mapping[str, Any]) -> float:
    """Minutes of the processor that the finished runs took."""
    clocks = [clock for run in timing["runs"].values() for clock in run["clock"]]
    return sum(float(clock["processor_s"]) for clock in clocks) / 60


def _facts(summary: Mapping[str, Any], timing: Mapping[str, Any]) -> list[tuple[str, str]]:
    steps = ", ".join(f"{name} {count}" for name, count in summary["steps"].items())
    sets = []
    for name, each in summary["sets"].items():
        made = each["simulated"]
        what = f"{made['sequences']} x {made['frames']} frames of {made['preset']}, seed {made['seed']}" if made else ""
        sets.append(f"{name}: {what or 'real'} ({each['fingerprint'][:12]})")
    known = summary["environment"]
    return [
        ("budget", f"{summary['budget']}: {summary['words']}"),
        ("seeds", str(summary["seeds"])),
        ("steps", f"{steps}; {summary['batch']} frames a step of one pattern"),
        ("data", "; ".join(sets)),
        ("claims", f"declared before the runs, SHA-256 {summary['claims_sha256']}"),
        ("planned", f"{timing['planned']['core_minutes']:.0f} core minutes, {timing['planned']['workers']} workers"),
        ("trained on", "; ".join(map(_trained, summary["trained_on"])) or NOTHING),
        ("commit", str(known["commit"])),
        ("versions", ", ".join(f"{name} {version}" for name, version in known["versions"].items())),
        ("machine", f"{known['processor']}, Python {known['python']}"),
    ]


def _trained(group: Mapping[str, Any]) -> str:
    known = [group["device"] or "a device that its weights do not name", group["precision"], f"torch {group['torch']}"]
    runs = f"{group['runs']} run{'' if group['runs'] == 1 else 's'}"
    return f"{runs}: {', '.join(word for word in known if word)}, commit {group['commit']}"


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
    found = []
    if paper == "cirrus" and objects and set(PATTERNS) & set(objects["points"]):
        found.append(
            PageImage(
                figure_uri(points_by_range(objects)),
                "Density of the number of points inside annotated boxes over range, for each pattern",
                "Every annotated object of the frames that runs are scored on. Darker: more objects. The line is the "
                "mean number of points in 25 m of range.",
                heading="Figure 4: points inside annotated boxes",
            )
        )
        found.append(
            PageImage(
                figure_uri(ranges_of_classes(objects)),
                "Histograms of the distance of annotated objects, and of their classes",
                "What is annotated in these frames.",
                heading="Figure 6: annotated objects",
            )
        )
    if curves:
        found.append(
            PageImage(
                figure_uri(precision_recall(curves)),
                "Precision over recall of the detectors of both patterns, one line for each distance",
                "Each pattern by the detector that was trained on it, first seed.",
                heading="Figure 7: precision and recall",
            )
        )
    if paper == "kradar" and objects and "os2-64" in objects["points"]:
        found.append(
            PageImage(
                figure_uri(returns_by_weather(objects, "os2-64")),
                "Share of annotated objects with at least five LiDAR returns, by weather",
                "Objects on which the os2-64 has five returns or more. Where data are simulated, the ice on its window "
                "is an input of the simulation.",
                heading="Returns on objects by weather",
            )
        )
    return found

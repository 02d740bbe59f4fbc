"""Write docs/claims.md: every claim of both papers in a line, of what benchmarks/results/reproduce.txt recorded.

python tools/claims.py            print the page
python tools/claims.py --write    write it

Nothing is run here. ``farfield reproduce --summary`` prints the same rows of finished folders.
"""

import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from farfield.papers.claim_rows import (
    HOLDING,
    ClaimRow,
    RecordedGrid,
    check_claims,
    claim_rows,
    comparisons_of,
    counts_of,
)
from farfield.papers.claims import CLAIMS, Claim, Claims, ClaimSide, load
from farfield.papers.grid import ExperimentGrid, load_grid

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "claims.md"
RESULTS = ROOT / "benchmarks" / "results" / "reproduce.txt"
TITLES = {"cirrus": "Cirrus", "kradar": "K-Radar"}
METRICS = {"cirrus": "DDS of vehicles", "kradar": "AP3D of vehicles at IoU 0.3"}
VERDICTS = "holds by construction|holds not|holds|undecided|no decision|not run"
LINE = re.compile(
    r"     (?P<names>.+?): (?:no figure|(?P<estimate>[+-][\d.]+) \[(?P<low>[+-][\d.na]+), (?P<high>[+-][\d.na]+)\])"
    rf"(?:, paper [+-][\d.]+)?(?:, power (?P<power>\d+)%)?: (?P<verdict>{VERDICTS})"
)
HEAD = """# Claims

Every claim of the Cirrus and K-Radar papers in a line, printed by `tools/claims.py` of what
`benchmarks/results/reproduce.txt` recorded. Your own runs in the same form:

```bash
farfield reproduce --summary                        # of the finished folders runs/reproduce-*
farfield reproduce cirrus --summary --out my-run
```

- **All figures are of simulated frames**, and stand for the simulation; of the paper's, only the sign of a difference
  is compared.
- *paper*, *ours*: the difference between two rows in the claim's first metric (Cirrus: DDS; K-Radar: AP3D; C0, K7:
  statistics of the data), ours as the mean over seeds with its 95 % interval. A claim of several comparisons holds if
  all do; a verdict stands beside one where it is not the claim's.
- *decision*: by [a rule](reproduce.md#the-decision) that was fixed before, at the largest size that is finished; then
  another metric and smaller sizes where they say otherwise. *Power*: how likely this size was to say "holds", were the
  paper's difference the truth.
- *controls*: the row without the claimed cause. A control that holds excludes the explanation it is named by; one that
  does not leaves it open.
- *to run it again*: how many of the size's trainings the claim needs, controls included, and the core minutes of all
  of the size's with scoring.
- *what would decide it*: the smallest larger budget of which `--plan` says so, by the paper's difference and the
  spreads that a plan expects; core hours are those planned on a core without a GPU.

[Reproduce](reproduce.md#what-the-laptops-budget-found-for-cirrus) says what explains these results, and
[the desk's report](reproduce_cirrus_desk.html) has all of its tables.
"""


class Recorded(NamedTuple):
    """A section of the results, and the grid that it says was decided."""

    head: dict[str, str]
    grid: RecordedGrid


def sections() -> dict[str, str]:
    """The sections of the results by name, earlier runs of the same left out."""
    parts = re.split(r"^==== (.+)\n", RESULTS.read_text("utf-8"), flags=re.MULTILINE)[1:]
    latest = [re.split(r"^== ", text, flags=re.MULTILINE)[0] for text in parts[1::2]]
    return dict(zip(parts[::2], latest, strict=True))


def planned_minutes(text: str) -> dict[tuple[str, str], float]:
    """Core minutes by paper and budget, of the section of plans."""
    minutes = {}
    for block in re.split(r"^\$ ", text, flags=re.MULTILINE)[1:]:
        paper, budget = re.search("|".join(CLAIMS), block), re.search(r"^budget (\w+):", block, re.MULTILINE)
        cost = re.search(r": (\d+) core minutes", block)
        if paper and budget and cost:
            minutes[paper[0], budget[1]] = float(cost[1])
    return minutes


def side_words(side: ClaimSide) -> str:
    """A row as ``benchmarks/reproduce.py`` prints it."""
    return " ".join(word for word in (side.run, side.cloud, side.part, side.metric) if word)


def decided_of(claim: Claim, lines: Sequence[str]) -> list[dict[str, Any]]:
    """What was decided on a claim, of the lines below its own; those that were not run have none."""
    rows, left = [], list(lines)
    for role, metric, pair in comparisons_of(claim):
        names = f"{'control: ' * (role == 'control')}{side_words(pair.a)} - {side_words(pair.b)}, {metric}"
        match = LINE.fullmatch(left[0]) if left else None
        row: dict[str, Any] = {"role": role, "metric": metric}
        if match and match["names"] == names:
            left.pop(0)
            interval = None if "nan" in (match["low"] or "nan") else (float(match["low"]), float(match["high"]))
            estimate = match["estimate"] and float(match["estimate"])
            row["decision"] = {"verdict": match["verdict"], "difference": {"estimate": estimate, "interval": interval}}
            row["power"] = match["power"] and float(match["power"]) / 100
        rows.append(row)
    if left:
        raise SystemExit(f"{RESULTS}: {claim.id}: expected a comparison that its claims declare, got {left[0]!r}")
    return rows


def recorded_of(text: str, budget: str, claims: Claims, grid: ExperimentGrid, planned: float | None) -> Recorded:
    """The grid that a section says was decided."""
    head = dict(re.findall(r"^(\w+) +(.+(?:\n {9}.+)*)", text.partition("\n\n")[0], flags=re.MULTILINE))
    settings, runs = grid.budgets[budget], grid.runs_of(budget)
    steps = {run.network: settings.steps_for(run.network) for run in runs.values()}
    steps |= {name: int(count) for name, count in re.findall(r"(\w+) (\d+)(?=,|$)", head.get("size", ""))}
    decided = head.get("decided") or head["trained"]
    done = re.search(r"(\d+) of (\d+) runs", decided) or re.search(r"'done': (\d+)", decided)
    trainings = len(runs) * settings.seeds
    by_claim = re.split(rf"^([CK]\d+) +({VERDICTS}) .*\n", text, flags=re.MULTILINE)[1:]
    trees = []
    for name, verdict, lines in zip(by_claim[::3], by_claim[1::3], by_claim[2::3], strict=True):
        below = [line for line in lines.splitlines() if re.search(", (?:" + "|".join(claims.metrics) + "): ", line)]
        seeds = settings.seeds if claims[name].runs else 0
        rows = decided_of(claims[name], below)
        for row in rows:
            if "decision" in row:
                row["decision"]["difference"] |= {"n": seeds, "trained": bool(seeds)}
        trees.append({"id": name, "verdict": verdict, "decided": rows})
    elsewhere = "trained elsewhere" in head["cost"]
    one = RecordedGrid.model_validate(
        {
            "paper": claims.paper,
            "budget": budget,
            "simulated": "real data" not in head.get("size", ""),
            "seeds": settings.seeds,
            "steps": steps,
            "runs": {"planned": trainings, "done": int(done[1]) if done else trainings},
            "claims_sha256": (re.search(r"claims (\w+)", decided) or ["", ""])[1],
            "claims": trees,
            "core_minutes": planned if elsewhere else minutes_of(head),
            "planned_minutes": elsewhere,
        }
    )
    check_claims(one, claims, RESULTS)
    return Recorded(head, one)


def minutes_of(head: dict[str, str]) -> float | None:
    """Core minutes of a whole grid: as they were added up by hand, or as the clocks of its runs say."""
    whole = re.search(r"([\d,]+) core minutes in all", head.get("besides", ""))
    whole = whole or re.search(r"([\d,]+) min of processor in all", head["cost"])
    parts = re.search(r"([\d,]+) min of processor in training, ([\d,]+) min by the clock in scoring", head["cost"])
    figures = (whole[1],) if whole else parts.groups() if parts else ()
    return sum(float(figure.replace(",", "")) for figure in figures) or None


def table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown."""
    return "\n".join(f"| {' | '.join(row)} |" for row in (columns, ["---"] * len(columns), *rows))


def cells_of(row: ClaimRow) -> list[str]:
    """A row of the page."""
    decision = "; ".join([row.decision, *(f"{budget}: {verdict}" for budget, verdict in row.elsewhere)])
    words = f"**{row.claim.id}** {row.claim.words}"
    ours, controls = "; ".join(row.ours()) or "-", "; ".join(row.controls) or "none"
    return [words, row.published, ours, decision, controls, row.size, row.again]


def reasons_of(row: ClaimRow, minutes: dict[str, float]) -> str:
    """Why a claim does not hold, and what would decide it."""
    words = {
        "holds not": "the interval lies wholly on the other side of what is claimed",
        "undecided": "an interval reaches to both sides of what is claimed",
        "no decision": "too few sequences or seeds have a figure",
        "not run": "no size that was run has its trainings",
    }
    which = f" ({', '.join(row.labelled(row.verdict))})" if row.labelled(row.verdict) else ""
    parts = [f"- **{row.claim.id}** {row.verdict}: {words[row.verdict]}{which}.", row.claim.note]
    would = row.would_decide(minutes)
    parts += [f"What would decide it: {would}."] if would else []
    if row.verdict == "holds not" and row.larger:
        costs = {name: f" ({minutes[name] / 60:,.0f} core hours)" if name in minutes else "" for name in row.larger}
        parts += [f"Larger budgets that have its rows: {', '.join(f'{name}{cost}' for name, cost in costs.items())}."]
    return " ".join(part for part in parts if part)


def differing(rows: Sequence[ClaimRow]) -> list[list[str]]:
    """What further sizes said where it was something else."""
    pairs = [(row, grid) for row in rows for grid in row.others]
    verdicts = [(row, grid, grid.by_id[row.claim.id].verdict) for row, grid in pairs]
    return [
        [f"**{row.claim.id}**", "; ".join(row.ours(grid)), verdict, grid.budget]
        for row, grid, verdict in verdicts
        if verdict != row.verdict
    ]


def page() -> str:
    """The whole page."""
    texts, parts = sections(), [HEAD.rstrip()]
    planned, sizes = planned_minutes(texts.get("plans", "")), []
    for paper in CLAIMS:
        claims, grid = load(paper), load_grid(paper)
        recorded = []
        for budget in grid.budgets:
            if f"{paper}, {budget}" in texts:
                text = texts[f"{paper}, {budget}"]
                recorded.append(recorded_of(text, budget, claims, grid, planned.get((paper, budget))))
        rows = claim_rows(claims, grid, [one.grid for one in recorded])
        minutes = {budget: cost for (of, budget), cost in planned.items() if of == paper}
        columns = ["claim", "paper", "ours", "decision", "controls", "size", "to run it again"]
        parts += [f"## {TITLES[paper]}", counts_of(rows), table(columns, [cells_of(row) for row in rows])]
        rest = [reasons_of(row, minutes) for row in rows if row.verdict not in HOLDING]
        if rest:
            parts += [f"### What does not hold of {TITLES[paper]}, and what is undecided", "\n".join(rest)]
        others = differing(rows)
        if others:
            parts += [f"### Where smaller sizes said otherwise of {TITLES[paper]}"]
            parts += [table(["claim", "ours", "decision", "size"], others)]
        for head, one in recorded:
            steps = " or ".join(f"{count:,}" for count in sorted(set(one.steps.values())))
            sizes.append(
                [
                    f"{TITLES[paper]}, `{one.budget}`",
                    f"{one.runs.done} of {one.runs.planned}, {steps} steps, {one.seeds} seeds",
                    f"{one.core_minutes or 0:,.0f}{' as planned; trained elsewhere' if one.planned_minutes else ''}",
                    f"{head['date']}, {head['machine']}",
                    f"`farfield reproduce {paper} --budget {one.budget}`",
                ]
            )
    parts += ["## The sizes", table(["size", "trainings", "core minutes", "decided", "command"], sizes)]
    return "\n\n".join(parts) + "\n"


def main() -> None:
    """Print the page, or write it."""
    if "--write" not in sys.argv[1:]:
        print(page(), end="")
        return
    PAGE.write_text(page(), encoding="utf-8")
    print(f"written: {PAGE.relative_to(ROOT)}")


if __name__ == "__main__":
    main()

"""What a finished ``farfield reproduce`` found."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from _report import Part, part_parser, run_parts


def cost(folder: Path) -> str:
    """Processor and wall time of all trainings and their scoring, added up over the runs."""
    lines = [json.loads(line) for clock in folder.glob("runs/*/clock.jsonl") for line in clock.read_text().splitlines()]
    total = {
        name: sum(line.get(name, 0.0) for line in lines) / 60 for name in ("processor_s", "training_s", "scoring_s")
    }
    peak = max(line.get("peak_memory_mb", 0.0) for line in lines)
    minutes = {name: f"{value:.0f} min" for name, value in total.items()}
    if not total["training_s"]:
        return (
            f"{minutes['processor_s']} of processor to score ({minutes['scoring_s']} by the clock); trained elsewhere"
        )
    return (
        f"{minutes['processor_s']} of processor in all, {minutes['scoring_s']} by the clock in scoring "
        f"({minutes['training_s']} of training by it), peak {peak:,.0f} MB a process"
    )


def trained(group: dict[str, Any]) -> str:
    """On what some runs were trained, in a line."""
    known = (group["device"], group["precision"], f"torch {group['torch']}", f"commit {group['commit']}")
    return f"{group['runs']} runs: {', '.join(word or 'unknown' for word in known)}"


def row(side: dict[str, Any]) -> str:
    """A row of a comparison in words."""
    words = [str(side[name]) for name in ("run", "cloud", "part", "metric", "area") if side.get(name)]
    return " ".join(words) or json.dumps(side)


def lines_of(claim: dict[str, Any]) -> Iterator[str]:
    """The claim, then its comparisons and controls in its metrics."""
    yield f"{claim['id']:4} {claim['verdict']:12} {claim['words']}"
    for found in claim["decided"]:
        decision = found["decision"]
        if decision is None:
            continue
        figures = decision["difference"]
        low, high = figures["interval"] or (float("nan"), float("nan"))
        paper = "" if found["published"] is None else f", paper {found['published']:+.3f}"
        power = "" if found["power"] is None else f", power {found['power']:.0%}"
        role = "control: " if found["role"] == "control" else ""
        value = "no figure" if figures["estimate"] is None else f"{figures['estimate']:+.3f} [{low:+.3f}, {high:+.3f}]"
        names = f"{role}{row(found['a'])} - {row(found['b'])}, {found['metric']}"
        yield f"     {names}: {value}{paper}{power}: {decision['verdict']}"


def run_reproduced(arguments: Sequence[str]) -> None:
    """What a finished ``farfield reproduce`` found: its claims, decisions and cost, from the folder that it wrote.

        farfield reproduce cirrus --budget laptop --out runs/reproduce-cirrus-laptop
        python benchmarks/reproduce.py runs/reproduce-cirrus-laptop --section 'cirrus, laptop'

    Each comparison: our mean difference over seeds with its 95 % interval, the paper's, the verdict, the probability of
    "holds" were the paper's difference the truth. Controls are marked.
    """
    parser = part_parser(run_reproduced.__doc__)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args(arguments).folder
    found = json.loads((folder / "reproduction.json").read_text())
    for group in found["trained_on"]:
        print(f"trained  {trained(group)}")
    runs = f"{found['runs']['done']} of {found['runs']['planned']} runs"
    print(f"decided  commit {found['environment']['commit']}, {runs}, claims {found['claims_sha256'][:16]}")
    steps = ", ".join(f"{network} {count}" for network, count in found["steps"].items())
    print(f"size     {'' if found['simulated'] else 'real data; '}{found['seeds']} seeds; steps: {steps}")
    print(f"cost     {cost(folder)}\n")
    for claim in found["claims"]:
        print("\n".join(lines_of(claim)))
    for part in (found.get("scenarios") or {}).get("parts", ()):
        figures = part["decision"]["difference"]
        low, high = figures["interval"]
        means = " - ".join(f"{name} {value:.3f}" for name, value in part["means"].items())
        print(f"     {part['kind']} {part['value']}: {means}: {figures['estimate']:+.3f} [{low:+.3f}, {high:+.3f}]")
    switching = (found.get("scenarios") or {}).get("switching")
    for other, decision in (switching or {"gains": {}})["gains"].items():
        low, high = decision["difference"]["interval"]
        gain = f"{decision['difference']['estimate']:+.3f} [{low:+.3f}, {high:+.3f}]"
        print(f"     the rule that switches by {switching['by']} - always {other}: {gain}")
        print(f"          it chose {switching['choices'][0]}")


if __name__ == "__main__":
    raise SystemExit(
        run_parts(
            __doc__,
            {
                "reproduced": Part(run_reproduced),
            },
        )
    )

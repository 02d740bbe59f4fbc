"""The table of transfer between radars on one self-contained page: sentences, curves, rows, decisions, what made it."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from farfield.figures.style import PATTERNS, figure_uri, house_style, new_figure
from farfield.files.atomic import write_text
from farfield.pages.template import PageImage, render_template
from farfield.vocabulary.counts import count_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_NO_INTERVAL = "-"
_LINES = ("-", "--", ":")  # equal curves show through one another, and more curves than colours differ


def write_transfer(path: Path, tree: Mapping[str, Any]) -> Path:
    """Write the page, all or nothing.

    Args:
        path: The HTML file.
        tree: What ``transfer.json`` holds.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, render(tree))
    return path


def render(tree: Mapping[str, Any]) -> str:
    """Return the page as HTML.

    Args:
        tree: What ``transfer.json`` holds.
    """
    verdicts = [comparison["decision"]["verdict"] for comparison in tree["comparisons"]]
    above, below, too_few = (verdicts.count(verdict) for verdict in ("holds", "holds not", "no decision"))
    shares = sorted({score["share"] for score in tree["figures"]})
    scores = {(score["row"], score["share"]): score for score in tree["figures"]}
    return render_template(
        "transfer.html",
        package="farfield.papers",
        tree=tree,
        metric=metric_words(tree["metric"]),
        headline=(
            f"Of {len(verdicts)} comparisons the first row lies above the second in {above}, below it in {below}; in "
            f"{verdicts.count('undecided')} the interval of the difference holds 0, so neither is shown"
            + (f", and {too_few} have too few seeds or drives." if too_few else ".")
        ),
        rows=[{**row, "cells": [_cell(scores.get((row["name"], share))) for share in shares]} for row in tree["rows"]],
        shares=[f"{100 * share:g} %" for share in shares],
        decisions=[_decision(comparison) for comparison in tree["comparisons"]],
        pictures=_pictures(tree),
    )


def _cell(score: Mapping[str, Any] | None) -> dict[str, str]:
    if score is None:
        return {"value": "", "interval": "", "seeds": "", "frames": ""}
    return {
        "value": f"{score['mean']:.3f}",
        "interval": _between(score["interval"]),
        "seeds": f"({' '.join(f'{value:.3f}' for value in score['values'])})",
        "frames": f"{count_of(score['frames'], 'frame', spec=',')}",
    }


def _between(interval: Sequence[float] | None, *, signed: bool = False) -> str:
    form = "{:+.3f}" if signed else "{:.3f}"
    return _NO_INTERVAL if interval is None else f"{form.format(interval[0])} to {form.format(interval[1])}"


def _decision(comparison: Mapping[str, Any]) -> dict[str, Any]:
    decision = comparison["decision"]
    estimate, interval = decision["difference"]["estimate"], decision["difference"]["interval"]
    return {
        "id": comparison["id"],
        "words": comparison["words"],
        "share": f"{100 * comparison['share']:g} %",
        "frames": f"{comparison['frames']:,}",
        "difference": _NO_INTERVAL if estimate is None else f"{estimate:+.3f}",
        "interval": _between(interval, signed=True),
        "seeds": decision["difference"]["n"],
        "verdict": decision["words"],
        "decided": decision["verdict"] in ("holds", "holds not"),
        "adjusted": comparison["adjusted"],
    }


def _pictures(tree: Mapping[str, Any]) -> list[PageImage]:
    """A panel of curves for each world that a row starts in from elsewhere."""
    if not any(len(_course(tree, row["name"])) > 1 for row in tree["rows"]):
        return []
    return [
        PageImage(
            uri=figure_uri(curves(tree)),
            alt="AP against the number of frames of the target, one curve a row, a panel a target",
            caption=(
                f"{metric_words(tree['metric'])}, against the number of the target's frames, mean over seeds; bars: "
                "95 % under draws of the scored drives."
            ),
            heading="By number of frames",
        )
    ]


def curves(tree: Mapping[str, Any]) -> "Figure":
    """AP against the number of frames, one curve a row with several shares, a panel a world.

    Args:
        tree: What ``transfer.json`` holds.
    """
    shown = [row for row in tree["rows"] if len(_course(tree, row["name"])) > 1]
    worlds = list(dict.fromkeys(row["world"] for row in shown))
    with house_style():
        figure = new_figure(4.2 * len(worlds), 4.2)
        panels = figure.subplots(1, len(worlds), squeeze=False, sharey=True)[0]
        for axes, world in zip(panels, worlds, strict=True):
            for number, row in enumerate(row for row in shown if row["world"] == world):
                colour, line = PATTERNS[number % len(PATTERNS)], _LINES[number % len(_LINES)]
                course = _course(tree, row["name"])
                frames, means = ([score[key] for score in course] for key in ("frames", "mean"))
                axes.plot(frames, means, line, marker="o", ms=3.5, lw=1.4, color=colour, label=row["words"])
                for score in course:
                    if score["interval"] is not None:
                        axes.plot([score["frames"]] * 2, score["interval"], color=colour, lw=0.8, alpha=0.5)
            axes.set(xscale="log", xlabel="frames of the target", ylim=(0, None))
            axes.set_xticks(_counts(tree, [row["name"] for row in shown if row["world"] == world]))
            axes.xaxis.set_major_formatter("{x:.0f}")
            axes.tick_params(axis="x", which="minor", bottom=False, labelbottom=False)
            axes.set_title(world)
            axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=1)
        panels[0].set_ylabel(metric_words(tree["metric"]))
    return figure


def metric_words(name: str) -> str:
    """The words of a figure: ``ap/vehicle/bev/0.3`` is the AP of vehicles in the bird's-eye view at an overlap of 0.3.

    Args:
        name: Its name in a protocol's result.
    """
    metric, *rest = name.split("/")
    if metric != "ap" or len(rest) != 3:
        return name
    label, view, overlap = rest
    views = {"bev": "bird's-eye view", "3d": "3D"}
    return f"AP of {label.replace('_', ' ')}s, {views.get(view, view)}, overlap of {overlap}"


def _counts(tree: Mapping[str, Any], rows: Sequence[str]) -> list[int]:
    """Numbers of frames that stand far enough apart to be labelled."""
    labelled = list[int]()
    for count in sorted({_frames(score) for row in rows for score in _course(tree, row)}, reverse=True):
        if not labelled or count < 0.7 * labelled[-1]:
            labelled.append(count)
    return labelled


def _course(tree: Mapping[str, Any], row: str) -> list[Mapping[str, Any]]:
    """A row's scores by number of frames."""
    return sorted((score for score in tree["figures"] if score["row"] == row), key=_frames)


def _frames(score: Mapping[str, Any]) -> int:
    return int(score["frames"])

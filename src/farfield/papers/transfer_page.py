"""The table of transfer between radars on one self-contained page: sentences, curves, rows, decisions, what made it."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from farfield.figures.style import PATTERNS, figure_uri, house_style, new_figure
from farfield.files.atomic import write_text
from farfield.pages.template import PageImage, render_template

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_NO_INTERVAL = "-"
_LINES = ("-", "--", ":")  # equal curves are seen through one another, and more curves than colours differ


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
    decided = [each["decision"]["verdict"] for each in tree["comparisons"]]
    above, below, too_few = (decided.count(word) for word in ("holds", "holds not", "no decision"))
    return render_template(
        "transfer.html",
        package="farfield.papers",
        tree=tree,
        metric=metric_words(tree["metric"]),
        headline=(
            f"Of {len(decided)} comparisons the first row lies above the second in {above}, below it in {below}; in "
            f"{decided.count('undecided')} the interval of the difference holds 0, so neither is shown"
            + (f", and {too_few} have too few seeds or drives." if too_few else ".")
        ),
        rows=[_row(row, tree) for row in tree["rows"]],
        shares=[f"{100 * share:g} %" for share in _shares(tree)],
        decisions=[_decision(each) for each in tree["comparisons"]],
        pictures=_pictures(tree),
    )


def _shares(tree: Mapping[str, Any]) -> list[float]:
    return sorted({each["share"] for each in tree["figures"]})


def _row(row: Mapping[str, Any], tree: Mapping[str, Any]) -> dict[str, Any]:
    found = {each["share"]: each for each in tree["figures"] if each["row"] == row["name"]}
    return {**row, "cells": [_cell(found.get(share)) for share in _shares(tree)]}


def _cell(found: Mapping[str, Any] | None) -> dict[str, str]:
    if found is None:
        return {"value": "", "interval": "", "seeds": "", "frames": ""}
    return {
        "value": f"{found['mean']:.3f}",
        "interval": _between(found["interval"]),
        "seeds": f"({' '.join(f'{value:.3f}' for value in found['values'])})",
        "frames": f"{found['frames']:,} frames",
    }


def _between(interval: Sequence[float] | None, *, signed: bool = False) -> str:
    form = "{:+.3f}" if signed else "{:.3f}"
    return _NO_INTERVAL if interval is None else f"{form.format(interval[0])} to {form.format(interval[1])}"


def _decision(each: Mapping[str, Any]) -> dict[str, Any]:
    found = each["decision"]["difference"]
    estimate, interval = found["estimate"], found["interval"]
    return {
        "id": each["id"],
        "words": each["words"],
        "share": f"{100 * each['share']:g} %",
        "frames": f"{each['frames']:,}",
        "difference": _NO_INTERVAL if estimate is None else f"{estimate:+.3f}",
        "interval": _between(interval, signed=True),
        "seeds": found["n"],
        "verdict": each["decision"]["words"],
        "decided": each["decision"]["verdict"] in ("holds", "holds not"),
        "adjusted": each["adjusted"],
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
                frames, means = [each["frames"] for each in course], [each["mean"] for each in course]
                axes.plot(frames, means, line, marker="o", ms=3.5, lw=1.4, color=colour, label=row["words"])
                for each in course:
                    if each["interval"] is not None:
                        axes.plot([each["frames"]] * 2, each["interval"], color=colour, lw=0.8, alpha=0.5)
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
    what, *where = name.split("/")
    if what != "ap" or len(where) != 3:
        return name
    views = {"bev": "bird's-eye view", "3d": "3D"}
    return f"AP of {where[0].replace('_', ' ')}s, {views.get(where[1], where[1])}, overlap of {where[2]}"


def _counts(tree: Mapping[str, Any], rows: Sequence[str]) -> list[int]:
    """Numbers of frames that stand far enough apart to be labelled."""
    kept = list[int]()
    for count in sorted({_frames(each) for row in rows for each in _course(tree, row)}, reverse=True):
        if not kept or count < 0.7 * kept[-1]:
            kept.append(count)
    return kept


def _course(tree: Mapping[str, Any], row: str) -> list[Mapping[str, Any]]:
    return sorted((each for each in tree["figures"] if each["row"] == row), key=_frames)


def _frames(each: Mapping[str, Any]) -> int:
    return int(each["frames"])

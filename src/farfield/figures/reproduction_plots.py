"""Pictures of the data of a reproduction: points inside boxes, ranges and classes of objects, returns by weather."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from farfield.figures.style import ANNOTATED, INK, PATTERNS, house_style, new_figure
from farfield.figures.words import pattern_title
from farfield.vocabulary.conditions import WEATHERS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_REACH_M = 250.0
_STEP_M = 25.0
_LEAST = 5  # returns from which an object counts as seen


def points_by_range(objects: Mapping[str, Any]) -> "Figure":
    """Hexagons of the number of points inside each box over its range, a panel a cloud (Cirrus, Figure 4).

    Args:
        objects: ``range_m`` (n,) and ``points`` by cloud, (n,) each, -1 where a frame lacks the cloud.
    """
    clouds = {name: count for name, count in objects["points"].items() if name in ("gaussian", "uniform")}
    range_m = np.asarray(objects["range_m"], dtype=np.float64)
    with house_style():
        figure = new_figure(5.3 * len(clouds), 3.6)
        panels = figure.subplots(1, len(clouds), squeeze=False, sharex=True, sharey=True)[0]
        for axes, (name, count), colour in zip(panels, clouds.items(), PATTERNS, strict=False):
            shown = (count >= 0) & (range_m < _REACH_M)
            points = np.maximum(count[shown], 0.5)
            if shown.any():
                axes.hexbin(
                    range_m[shown],
                    points,
                    yscale="log",
                    gridsize=36,
                    bins="log",
                    cmap="Blues",
                    mincnt=1,
                    extent=(0, _REACH_M, np.log10(0.5), 4),
                )
                axes.plot(*_means(range_m[shown], count[shown]), color=colour, lw=1.8)
            axes.set(xlim=(0, _REACH_M), ylim=(0.4, 1e4), xlabel="range (m)")
            axes.set_title(f"{pattern_title(name)}: {int(shown.sum()):,} boxes")
        panels[0].set_ylabel("points inside the annotated box")
    return figure


def _means(range_m: Any, count: Any) -> tuple[list[float], list[float]]:
    """Middles of the steps of range that hold objects, and the mean number of points there."""
    edges = np.arange(0.0, _REACH_M + _STEP_M, _STEP_M)
    steps = [(low, (range_m >= low) & (range_m < low + _STEP_M)) for low in edges[:-1]]
    filled = [(low, inside) for low, inside in steps if inside.any() and count[inside].mean() > 0]
    return [float(low + _STEP_M / 2) for low, _ in filled], [float(count[inside].mean()) for _, inside in filled]


def ranges_of_classes(objects: Mapping[str, Any]) -> "Figure":
    """Distances of annotated vehicles, and how many objects each class has (Cirrus, Figure 6).

    Args:
        objects: ``range_m`` and ``label``, shape (n,) each.
    """
    label, range_m = np.asarray(objects["label"]), np.asarray(objects["range_m"], dtype=np.float64)
    vehicles = np.isin(label, ("vehicle", "large_vehicle"))
    names, counts = np.unique(label, return_counts=True)
    with house_style():
        figure = new_figure(11.0, 3.2)
        first, second = figure.subplots(1, 2)
        first.hist(range_m[vehicles], bins=np.arange(0.0, 260.0, 10.0).tolist(), color=ANNOTATED)
        first.set(xlabel="range (m)", ylabel="annotated vehicles", xlim=(0, _REACH_M))
        order = np.argsort(counts)
        second.barh([str(names[each]).replace("_", " ") for each in order], counts[order], color=ANNOTATED)
        second.set(xscale="log", xlabel="annotated objects", xlim=(0.7, None))
    return figure


def features_apart(pair: Mapping[str, Any]) -> "Figure":
    """Features of two domains on their two main axes, before and after an adaptation.

    Args:
        pair: ``runs``, two names, and ``sides``: of each run ``domains``, rows of two numbers by name, and ``probe``.
    """
    with house_style():
        figure = new_figure(10.6, 4.2)
        panels = figure.subplots(1, 2)
        for axes, run, side in zip(panels, pair["runs"], pair["sides"], strict=True):
            for (name, rows), colour in zip(side["domains"].items(), PATTERNS, strict=False):
                points = np.asarray(rows, dtype=np.float64).reshape(-1, 2)
                axes.scatter(*points.T, s=7, c=colour, alpha=0.5, linewidths=0, label=name, rasterized=True)
            probe = "" if side["probe"] is None else f": told apart {side['probe']:.0%}"
            axes.set_title(run.replace("_", " ") + probe)
            axes.set(xlabel="first axis", ylabel="second axis")
        handles, names = panels[0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside lower center", ncols=2, markerscale=2.0)
    return figure


def returns_by_weather(objects: Mapping[str, Any], cloud: str) -> "Figure":
    """Share of objects with enough returns, by weather (K-Radar, appendix A.1).

    Args:
        objects: ``weather`` (n,) and ``points`` by cloud.
        cloud: The cloud.
    """
    weather, count = np.asarray(objects["weather"]), np.asarray(objects["points"][cloud])
    present = [name for name in WEATHERS if ((weather == name) & (count >= 0)).any()]
    shares = [float((count[(weather == name) & (count >= 0)] >= _LEAST).mean()) for name in present]
    with house_style():
        figure = new_figure(8.0, 2.8)
        axes = figure.subplots()
        bars = axes.bar([name.replace("_", " ") for name in present], shares, color=ANNOTATED)
        axes.bar_label(bars, labels=[f"{share:.0%}" for share in shares], color=INK)
        axes.set(ylim=(0, 1.08), ylabel="share of objects")
    return figure

"""The figures of one data set's annotations, from plain numbers; of a census, one without data is None."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from farfield.figures.report_text import pattern_title
from farfield.figures.style import ANNOTATED, INK, MUTED, PAPER, PATTERNS, house_style, new_figure
from farfield.vocabulary.conditions import TIME_COLOURS, WEATHER_COLOURS, WEATHERS
from farfield.vocabulary.counts import count_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Summary = Mapping[str, Any]
Table = Mapping[str, Mapping[str, int]]

_SIGHT = ("#0b6e99", "#e67700", "#adb5bd", "#dee2e6")  # seen well, seen in part, hardly, not known
_MOST_CLASSES = 10


def spoken(name: str) -> str:
    """A name as people read it: ``"heavy_snow"`` becomes ``"heavy snow"``."""
    return name.replace("_", " ")


def frames_by_condition(summary: Summary) -> "Figure | None":
    """Frames by weather, road and time: the distribution of K-Radar's Table 5."""
    kinds = {kind: counts for kind, counts in summary["frames_by"].items() if counts}
    if not kinds:
        return None
    with house_style():
        figure = new_figure(11.0, 0.9 + 0.36 * max(len(counts) for counts in kinds.values()))
        panels = figure.subplots(1, len(kinds), squeeze=False)[0]
        for axes, (kind, counts) in zip(panels, kinds.items(), strict=True):
            names = list(counts)[::-1]
            palette, other = (WEATHER_COLOURS, MUTED) if kind == "weather" else (TIME_COLOURS, PATTERNS[0])
            colours = [palette.get(name, other) for name in names]
            bars = axes.barh([spoken(name) for name in names], [counts[name] for name in names], color=colours)
            shares = [counts[name] / max(summary["frames"], 1) for name in names]
            texts = [f"{counts[name]:,}  ({share:.0%})" for name, share in zip(names, shares, strict=True)]
            axes.bar_label(bars, texts, padding=3, fontsize=8, color=INK)
            axes.set_xlim(0, 1.45 * max(counts.values()))
            axes.set_xticks([])
            axes.spines["bottom"].set_visible(False)
            axes.set_title(f"Frames by {'time of day' if kind == 'time' else kind}")
    return figure


def sequences(summary: Summary) -> "Figure | None":
    """Frames of each sequence, coloured by weather, a dark foot where it was recorded at night."""
    rows = summary["table_5"]
    if not 2 <= len(rows) <= 120 or "weather" not in summary["frames_by"]:
        return None
    with house_style():
        figure = new_figure(11.0, 3.3)
        axes = figure.subplots()
        at, frames = np.arange(len(rows)), np.array([row["frames"] for row in rows])
        colours = [WEATHER_COLOURS.get(row["weather"], MUTED) for row in rows]
        axes.bar(at, frames, 0.82, color=colours)
        night = np.array([row["time"] == "night" for row in rows])
        foot = 0.03 * frames.max()
        axes.bar(at[night], np.full(night.sum(), -foot), 0.82, color=TIME_COLOURS["night"])
        step = max(1, len(rows) // 30)
        axes.set_xticks(at[::step], [row["sequence"] for row in rows][::step], fontsize=7)
        axes.set(xlim=(-0.7, len(rows) - 0.3), ylim=(-1.3 * foot, None), xlabel="sequence", ylabel="frames")
        axes.grid(visible=True, axis="y")
        names = [name for name in WEATHER_COLOURS if name in {row["weather"] for row in rows}]
        handles = [axes.bar(0, 0, color=WEATHER_COLOURS[name], label=spoken(name)) for name in names]
        if night.any():
            handles.append(axes.bar(0, 0, color=TIME_COLOURS["night"], label="recorded at night"))
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), handlelength=1.0)
    return figure


def classes(summary: Summary) -> "Figure | None":
    """Boxes of each class, divided by how they are seen where that is known."""
    counts = {name: row["objects"] for name, row in summary["classes"].items()}
    if not counts:
        return None
    table = summary["objects_by"].get("class_and_visibility")
    names = list(counts)[:_MOST_CLASSES][::-1]
    with house_style():
        figure = new_figure(11.0, 1.1 + 0.34 * len(names))
        left, right = figure.subplots(1, 2, width_ratios=[1, 1.1]) if table else (figure.subplots(), None)
        bars = left.barh([spoken(name) for name in names], [counts[name] for name in names], color=PATTERNS[0])
        left.bar_label(bars, [f"{counts[name]:,}" for name in names], padding=3, fontsize=8, color=INK)
        left.set(xscale="log", xlim=(0.7, 6 * max(counts.values())), xlabel="boxes, logarithmic")
        left.set_title("Boxes by class")
        left.minorticks_off()
        if table and right is not None:
            _draw_shares(right, {name: table[name] for name in names})
            right.set_title("How they are seen")
            _legend(figure, right)
    return figure


def ranges(summary: Summary, arrays: Mapping[str, np.ndarray]) -> "Figure | None":
    """Boxes by range of the most frequent classes in steps of 10 m, and how they are seen by range."""
    if not len(arrays["range_m"]):
        return None
    names, table = list(summary["classes"])[:5], summary["visibility_by"].get("range")
    reach_m = 10.0 * np.ceil(max(float(np.quantile(arrays["range_m"], 0.9995)), 10.0) / 10.0)
    edges = np.arange(0.0, reach_m + 10.0, 10.0)
    with house_style():
        figure = new_figure(11.0, 3.8)
        left, right = figure.subplots(1, 2) if table else (figure.subplots(), None)
        colours = (*PATTERNS, MUTED)
        for name, colour in zip(names, colours, strict=False):
            count, _ = np.histogram(arrays["range_m"][arrays["name"] == name], edges)
            left.stairs(np.maximum(count, 0.5), edges, baseline=None, color=colour, lw=1.8, label=spoken(name))
        left.set(yscale="log", ylim=(0.7, None), xlim=(0, reach_m), xlabel="range (m)", ylabel="boxes in each 10 m")
        left.grid(visible=True)
        left.legend(loc="upper right")
        left.set_title("Boxes by range")
        if table and right is not None:
            _draw_shares(right, dict(reversed(list(table.items()))))
            right.set_title("How they are seen, by range")
            _legend(figure, right)
    return figure


def matrix(summary: Summary) -> "Figure | None":
    """Boxes by class and weather, and boxes by class and range, as numbers on a logarithmic shade."""
    tables = {kind: summary["objects_by"].get(f"class_and_{kind}") for kind in ("weather", "range")}
    drawn = {kind: table for kind, table in tables.items() if table}
    if not drawn or not summary["objects"]:
        return None
    rows = min(len(summary["classes"]), _MOST_CLASSES)
    with house_style():
        figure = new_figure(11.0, len(drawn) * (0.9 + 0.34 * rows))
        panels = figure.subplots(len(drawn), 1, squeeze=False)[:, 0]
        for axes, (kind, table) in zip(panels, drawn.items(), strict=True):
            _draw_matrix(axes, {name: table[name] for name in list(table)[:_MOST_CLASSES]})
            axes.set_title(f"Boxes by class and {kind}")
    return figure


def visibility_by_weather(summary: Summary) -> "Figure | None":
    """How boxes are seen in each weather, and objects in a frame by weather."""
    table = summary["visibility_by"].get("weather")
    if not table:
        return None
    with house_style():
        figure = new_figure(11.0, 1.2 + 0.34 * len(table))
        left, right = figure.subplots(1, 2)
        names = list(table)[::-1]
        _draw_shares(left, {name: table[name] for name in names})
        left.set_title("How boxes are seen, by weather")
        frames = summary["frames_by"]["weather"]
        means = [sum(table[name].values()) / max(frames[name], 1) for name in names]
        bars = right.barh(
            [spoken(name) for name in names], means, color=[WEATHER_COLOURS.get(name, MUTED) for name in names]
        )
        right.bar_label(bars, [f"{mean:.2f}" for mean in means], padding=3, fontsize=8, color=INK)
        right.set(xlim=(0, 1.2 * max(means)), xlabel="boxes in a frame, empty frames included")
        right.set_title("Boxes in a frame, by weather")
        _legend(figure, left)
    return figure


def per_frame(arrays: Mapping[str, np.ndarray]) -> "Figure | None":
    """How many objects a frame has."""
    objects = arrays["objects"][arrays["objects"] >= 0]
    if len(objects) < 2:
        return None
    with house_style():
        figure = new_figure(11.0, 2.9)
        axes = figure.subplots()
        top = int(objects.max())
        step = max(1, -(-(top + 1) // 60))
        count, edges = np.histogram(objects, np.arange(0, top + step + 1, step) - 0.5)
        axes.bar(edges[:-1] + step / 2, count, 0.85 * step, color=PATTERNS[0])
        axes.set(xlabel="objects in a frame", ylabel="frames", xlim=(-0.8, top + 0.8))
        axes.grid(visible=True, axis="y")
        empty = int((objects == 0).sum())
        axes.set_title(f"Objects in a frame: mean {objects.mean():.2f}, most {top}, {empty:,} empty frames")
    return figure


def _draw_shares(axes: "Axes", table: Table) -> None:
    """Stacked bars of shares, one a row of the table."""
    columns = list(next(iter(table.values())))
    totals = np.array([max(sum(row.values()), 1) for row in table.values()])
    start = np.zeros(len(table))
    for column, colour in zip(columns, _SIGHT, strict=False):
        share = np.array([row[column] for row in table.values()]) / totals
        axes.barh([spoken(name) for name in table], share, left=start, color=colour, label=column)
        for row, (low, width) in enumerate(zip(start, share, strict=True)):
            if width > 0.08:
                dark = colour in _SIGHT[:2]
                axes.text(
                    low + width / 2,
                    row,
                    f"{width:.0%}",
                    ha="center",
                    va="center",
                    fontsize=7.5,
                    color=PAPER if dark else INK,
                )
        start = start + share
    axes.set_xlim(0, 1)
    axes.set_xticks(np.linspace(0, 1, 5), ["0", "25 %", "50 %", "75 %", "100 %"])


def _draw_matrix(axes: "Axes", table: Table) -> None:
    columns = list(next(iter(table.values())))
    counts = np.array([[row[column] for column in columns] for row in table.values()], dtype=np.float64)
    shade = np.log10(np.maximum(counts, 1.0))
    axes.imshow(shade, cmap="Blues", aspect="auto", vmin=0.0, vmax=max(shade.max() * 1.15, 1.0))
    axes.set_xticks(range(len(columns)), [spoken(column) for column in columns])
    axes.set_yticks(range(len(table)), [spoken(name) for name in table])
    axes.tick_params(length=0)
    for side in axes.spines.values():
        side.set_visible(False)
    limit = 0.6 * max(float(shade.max()), 1.0)
    for row, column in np.ndindex(*counts.shape):
        text = f"{counts[row, column]:,.0f}" if counts[row, column] else "–"
        colour = PAPER if shade[row, column] > limit else INK
        axes.text(column, row, text, ha="center", va="center", fontsize=8, color=colour)


def _legend(figure: "Figure", axes: "Axes") -> None:
    handles, names = axes.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=max(len(names), 1), handlelength=1.0)


# Pictures of the data of a reproduction: points inside boxes, ranges and classes of objects, returns by weather.

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
            axes.set_title(f"{pattern_title(name)}: {count_of(int(shown.sum()), 'box', 'boxes', spec=',')}")
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
        second.barh([str(names[row]).replace("_", " ") for row in order], counts[order], color=ANNOTATED)
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

"""The figures of a comparison, each from plain numbers; a figure that no side has the data for is None."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from farfield.figures.style import INK, MUTED, SIDES, house_style, new_figure
from farfield.inspection.comparison import ComparedDataset, ToldApartClouds
from farfield.vocabulary.conditions import CONDITIONS, WEATHER_COLOURS, condition_name
from farfield.vocabulary.counts import count_of
from farfield.vocabulary.patterns import PATTERNS
from farfield.vocabulary.published_tables import ROW_QUANTILES_DB, SHARES_NEAR_HORIZON

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_DASHES: tuple[Any, ...] = ("-", (0, (4, 2)), (0, (1, 1.5)), (0, (5, 1.5, 1, 1.5)))
_MAPS = ("Blues", "Oranges")
LEAST_BOXES = 5
"""In a distance bin, of which a median is drawn."""
_SHARES = {limit: float(share) for limit, share in SHARES_NEAR_HORIZON.items()}
_QUANTILES = {quantile: float(level) for quantile, level in ROW_QUANTILES_DB.items()}


def _series(sides: Sequence[ComparedDataset]) -> Iterator[tuple[ComparedDataset, str, Mapping[str, Any], str, Any]]:
    """Every cloud of every side: side, cloud, its figures, colour (by side) and dashes (by cloud)."""
    names = list(dict.fromkeys(name for side in sides for name in side.summary["clouds"]))
    for side, colour in zip(sides, SIDES, strict=False):
        for name, cloud in side.summary["clouds"].items():
            yield side, name, cloud, colour, _DASHES[names.index(name) % len(_DASHES)]


def _legend(figure: "Figure", axes: "Axes", *, columns: int = 2) -> None:
    handles, names = axes.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=columns, handlelength=2.6)


def elevation(sides: Sequence[ComparedDataset]) -> "Figure | None":
    """Density of returns over elevation, and the shares near the horizon."""
    series = list(_series(sides))
    if not series:
        return None
    with house_style():
        figure = new_figure(11.0, 4.3)
        left, right = figure.subplots(1, 2, width_ratios=[1.5, 1])
        for column, (side, name, cloud, colour, dash) in enumerate(series):
            edges = np.asarray(cloud["elevation"]["edges_deg"])[::4]  # whole degrees: finer ones show each line
            count = np.asarray(cloud["elevation"]["count"], dtype=np.float64).reshape(-1, 4).sum(axis=1)
            density = count / max(count.sum(), 1) / np.diff(edges)
            left.stairs(density, edges, color=colour, lw=1.7, ls=dash, label=f"{side.title}, {name}", baseline=None)
            shares = [cloud["far_share_of_horizon"][limit] for limit in _SHARES]
            width = 0.8 / len(series)
            at = np.arange(3) + (column - (len(series) - 1) / 2) * width
            bars = right.bar(at, shares, width * 0.92, color=colour, alpha=1.0 if dash == "-" else 0.45)
            right.bar_label(bars, [f"{share:.2f}" for share in shares], fontsize=7.5, color=INK, padding=1)
        if any(name == PATTERNS[0] for _, name, *_ in series):
            right.plot(np.arange(3), list(_SHARES.values()), ls="none", marker="x", ms=9, mew=2, color=INK)
        right.set_xticks(np.arange(3), [f"within {limit}°" for limit in _SHARES])
        right.set(ylim=(0, 1.1), ylabel="share of returns beyond 8 m")
        right.set_title("Shares about the horizon")
        left.set(xlim=(-25, 15), ylim=(0, None), xlabel="elevation (degrees)", ylabel="share of returns per degree")
        left.grid(visible=True)
        left.set_title("All returns")
        _legend(figure, left)
    return figure


def roadside(sides: Sequence[ComparedDataset]) -> "Figure | None":
    """Cumulative share of patches by their thickness."""
    series = [(*one[:2], *one[3:]) for one in _series(sides) if one[1] in one[0].background]
    drawn = [(*one, np.concatenate([sample.patches[:, 0] for sample in one[0].background[one[1]]])) for one in series]
    drawn = [one for one in drawn if len(one[-1])]
    if not drawn:
        return None
    with house_style():
        figure = new_figure(7.0, 4.3)
        axes = figure.subplots()
        for side, name, colour, dash, log_variance in drawn:
            thickness_cm = np.sort(100 * np.exp(log_variance / 2))
            share = (np.arange(len(thickness_cm)) + 0.5) / len(thickness_cm)
            axes.plot(thickness_cm, share, color=colour, ls=dash, lw=1.7, label=f"{side.title}, {name}")
        axes.set(xscale="log", xlim=(0.3, 40), ylim=(0, 1), xlabel="thickness (cm)", ylabel="share of patches")
        axes.set_xticks([0.5, 1, 2, 5, 10, 20], ["0.5", "1", "2", "5", "10", "20"])
        axes.minorticks_off()
        axes.grid(visible=True)
        _legend(figure, axes)
    return figure


def telling_features(roadsides: ToldApartClouds) -> "Figure | None":
    """Area under the ROC of each feature of the roadside's patches, and of a classifier of all; a panel a cloud."""
    if not roadsides.apart:
        return None
    with house_style():
        figure = new_figure(11.0, 0.5 + 3.2 * len(roadsides.apart))
        panels = figure.subplots(len(roadsides.apart), 1, squeeze=False).ravel()
        for axes, (cloud, apart) in zip(panels, roadsides.apart.items(), strict=True):
            rows = np.arange(len(apart.features))
            axes.plot([*apart.features.values()], rows, ls="none", marker="o", color=SIDES[0], label="one feature")
            results = [("of all seven", apart, SIDES[0])]
            if cloud in roadsides.floor:
                floor = roadsides.floor[cloud]
                at = [floor.features[name] for name in apart.features]
                axes.plot(at, rows, ls="none", marker="o", mfc="none", color=MUTED, label="one feature, the floor")
                results.append(("of all seven, the floor", floor, MUTED))
            for label, result, colour in results:
                if result.by_classifier is not None:
                    axes.axvline(result.by_classifier, color=colour, lw=1.4, label=label)
                if result.classifier_interval is not None:
                    axes.axvspan(*result.classifier_interval, color=colour, alpha=0.15, lw=0)
            axes.set_yticks(rows, [*apart.features])
            axes.invert_yaxis()
            axes.set(xlim=(0.48, 1.0), xlabel="area under the ROC", title=cloud)
            axes.grid(visible=True, axis="x")
        _legend(figure, panels[0], columns=4)
    return figure


def points_in_vehicles(sides: Sequence[ComparedDataset]) -> "Figure | None":
    """Hexagons of boxes over distance and points, their medians and fitted lines; the last panel overlays them.

    Without a median or a line there is no such panel.
    """
    drawn = [
        (series, series[0].arrays[f"points/{series[1]}"])
        for series in _series(sides)
        if len(series[0].arrays.get(f"points/{series[1]}", {}).get("range_m", ()))
    ]
    if not drawn:
        return None
    fits = [cloud["points_in_vehicles"] for (_, _, cloud, *_), _ in drawn]
    # Boxes are enough for a median or a line.
    overlaid = any(fit["slope"] is not None or any(count >= LEAST_BOXES for count in fit["boxes"]) for fit in fits)
    count = len(drawn) + overlaid
    columns = min(count, 2 if count in (2, 4) else 3)
    rows = -(-count // columns)
    with house_style():
        figure = new_figure(11.0, 0.5 + 3.5 * rows)
        grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
        panels = list(grid.ravel())
        for axes in panels[count:]:
            axes.set_visible(False)
        for axes, ((side, name, cloud, colour, dash), boxes) in zip(panels, drawn, strict=False):
            _draw_boxes(axes, boxes, _MAPS[SIDES.index(colour)])
            fit = cloud["points_in_vehicles"]
            _draw_medians(axes, fit, INK, "-")
            slope = "too few boxes for a line"
            if fit["slope"] is not None:
                slope = f"slope {fit['slope']:.2f}, {fit['level']:.0f} at 50 m"
            axes.set_title(
                f"{side.title}, {name}\n{count_of(len(boxes['range_m']), 'box', 'boxes', spec=',')}; {slope}"
            )
            if overlaid:
                _draw_medians(panels[len(drawn)], fit, colour, dash, label=f"{side.title}, {name}")
        for axes in panels[:count]:
            axes.set(xscale="log", yscale="log", xlim=(5, 320), ylim=(0.4, 2e4))
            axes.set_xticks([5, 10, 20, 50, 100, 200], ["5", "10", "20", "50", "100", "200"])
            axes.set_yticks([0.5, 1, 10, 100, 1000, 10000], ["0", "1", "10", "100", "1,000", "10,000"])
            axes.minorticks_off()
            axes.grid(visible=True)
            axes.tick_params(labelbottom=True)
            axes.set_xlabel("distance (m)")
        for axes in grid[:, 0]:
            axes.set_ylabel("points in the box")
        if overlaid:
            panels[len(drawn)].set_title("Medians and lines together\n")
            _legend(figure, panels[len(drawn)])
    return figure


def _draw_boxes(axes: "Axes", boxes: Mapping[str, np.ndarray], colours: str) -> None:
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    range_m, count = boxes["range_m"], np.maximum(boxes["count"], 0.5)
    axes.hexbin(
        np.clip(range_m, 5, 320),
        count,
        xscale="log",
        yscale="log",
        gridsize=(30, 20),
        extent=(np.log10(5), np.log10(320), np.log10(0.4), np.log10(2e4)),
        mincnt=1,
        bins="log",
        cmap=ListedColormap(colormaps[colours](np.linspace(0.25, 0.95, 128))),
        linewidths=0.1,
    )


def _draw_medians(axes: "Axes", fit: Mapping[str, Any], colour: str, dash: Any, *, label: str = "") -> None:
    edges = np.asarray(fit["edges_m"])
    centre = np.sqrt(edges[:-1] * edges[1:])
    enough = [(x, max(y, 0.5)) for x, y, n in zip(centre, fit["median"], fit["boxes"], strict=True) if n >= LEAST_BOXES]
    if enough:
        x, y = np.array(enough).T
        axes.plot(x, y, ls="none", marker="o", ms=3.6, mfc="white" if dash != "-" else colour, mec=colour, zorder=4)
    if fit["slope"] is None:
        axes.plot([], [], color=colour, lw=1.6, ls=dash, label=label or None)
        return
    ends = np.array(fit["fitted_m"])
    axes.plot(ends, fit["level"] * (ends / 50.0) ** fit["slope"], color=colour, lw=1.6, ls=dash, zorder=3, label=label)


def ranges(sides: Sequence[ComparedDataset]) -> "Figure | None":
    """Share of returns by range."""
    series = list(_series(sides))
    if not series:
        return None
    with house_style():
        figure = new_figure(11.0, 3.6)
        axes = figure.add_subplot()
        for side, name, cloud, colour, dash in series:
            count = np.asarray(cloud["range"]["count"], dtype=np.float64)
            share = np.maximum(count / max(count.sum(), 1), 1e-7)
            axes.stairs(
                share,
                cloud["range"]["edges_m"],
                color=colour,
                ls=dash,
                lw=1.7,
                baseline=None,
                label=f"{side.title}, {name}",
            )
        axes.set(yscale="log", ylim=(1e-6, 1), xlim=(0, 360), xlabel="range (m)", ylabel="share of returns in 5 m")
        axes.grid(visible=True)
        _legend(figure, axes)
    return figure


def objects(sides: Sequence[ComparedDataset]) -> "Figure | None":
    """Distances of vehicles and shares of classes."""
    having = [(side, colour) for side, colour in zip(sides, SIDES, strict=False) if side.summary["boxes"]["count"]]
    if not having:
        return None
    with house_style():
        figure = new_figure(11.0, 3.9)
        left, right = figure.subplots(1, 2)
        for side, colour in having:
            distance = side.summary["boxes"]["vehicle_distance"]
            count = np.asarray(distance["count"], dtype=np.float64)
            left.stairs(
                100 * count / max(count.sum(), 1),
                distance["edges_m"],
                color=colour,
                lw=1.8,
                label=side.title,
                baseline=None,
            )
        left.set(xlim=(0, 350), ylim=(0, None), xlabel="distance (m)", ylabel="vehicles in 10 m (%)")
        left.grid(visible=True)
        left.set_title("Distance of vehicles")
        shares = {
            side.title: {name: row["share"] for name, row in side.summary["boxes"]["classes"].items()}
            for side, _ in having
        }
        _bars(right, shares, [colour for _, colour in having], percent=True)
        right.set_title("Classes")
        right.set_xlabel("boxes (%)")
        _legend(figure, left)
    return figure


def _bars(
    axes: "Axes", shares: Mapping[str, Mapping[str, float]], colours: Sequence[str], *, percent: bool = False
) -> None:
    """Horizontal bars, one group a name, one bar a side, the figure at its end."""
    names = list(dict.fromkeys(name for values_by_name in shares.values() for name in values_by_name))
    height = 0.8 / len(shares)
    for side_index, (side, values_by_name) in enumerate(shares.items()):
        at = np.arange(len(names)) + (side_index - (len(shares) - 1) / 2) * height
        values = [100 * values_by_name.get(name, 0.0) for name in names]
        bars = axes.barh(at, values, height * 0.9, color=colours[side_index], label=side)
        form = [f"{value:.1f}" if percent and 0 < value < 10 else f"{value:.0f}" for value in values]
        axes.bar_label(bars, form, fontsize=7.5, color=MUTED, padding=2)
    axes.set_yticks(np.arange(len(names)), [name.replace("_", " ") for name in names])
    axes.invert_yaxis()
    axes.set_xlim(0, 112)


def sizes(sides: Sequence[ComparedDataset]) -> "Figure | None":
    """Mean and spread of length, width and height by class."""
    tables = [
        {name: class_row for name, class_row in side.summary["boxes"]["classes"].items() if class_row["count"] >= 3}
        for side in sides
    ]
    names = list(dict.fromkeys(name for table in tables for name in table))
    if not names:
        return None
    with house_style():
        figure = new_figure(11.0, 1.3 + 0.34 * len(names))
        panels = figure.subplots(1, 3, sharey=True)
        for axes, kind in zip(panels, ("length", "width", "height"), strict=True):
            for side_index, (side, table) in enumerate(zip(sides, tables, strict=True)):
                rows = [(k, table[name][f"{kind}_m"]) for k, name in enumerate(names) if name in table]
                if rows:
                    at = [k + 0.15 * (2 * side_index - 1) for k, _ in rows]
                    mean, std = [row["mean"] for _, row in rows], [row["std"] for _, row in rows]
                    axes.errorbar(mean, at, xerr=std, fmt="o", ms=5, lw=1.6, color=SIDES[side_index], label=side.title)
            axes.set_title(kind.capitalize())
            axes.set_xlabel("m")
            axes.set_xlim(left=0)
            axes.grid(visible=True, axis="x")
        panels[0].set_yticks(np.arange(len(names)), [name.replace("_", " ") for name in names])
        panels[0].set_ylim(len(names) - 0.5, -0.5)
        _legend(figure, panels[0])
    return figure


def survival(sides: Sequence[ComparedDataset]) -> "Figure | None":
    """Ratio of points in vehicle boxes to normal weather by distance, a panel a cloud with two weathers or more."""
    drawn = [
        (side, name, cloud["survival"])
        for side, name, cloud, _, _ in _series(sides)
        if sum(row["overall"] is not None for row in cloud["survival"]["weather"].values()) >= 2
    ]
    if not drawn:
        return None
    with house_style():
        columns = min(len(drawn), 2)
        rows = -(-len(drawn) // columns)
        figure = new_figure(11.0 if columns == 2 else 7.5, 0.7 + 3.1 * rows)
        panels = list(figure.subplots(rows, columns, squeeze=False, sharey=True).ravel())
        for axes in panels[len(drawn) :]:
            axes.set_visible(False)
        for axes, (side, name, table) in zip(panels, drawn, strict=False):
            positions = np.arange(len(table["edges_m"]) - 1)
            for weather, row in table["weather"].items():
                ratio = np.array([np.nan if value is None else value for value in row["ratio"]], dtype=np.float64)
                label = weather.replace("_", " ")
                axes.plot(
                    positions,
                    ratio,
                    marker="o",
                    ms=4,
                    lw=1.7,
                    color=WEATHER_COLOURS.get(condition_name(weather), INK),
                    label=label,
                )
            axes.set_xticks(positions, [f"{a:g}-{b:g}" for a, b in pairwise(table["edges_m"])])
            axes.set(xlabel="distance (m)", ylabel="points over normal")
            axes.set_title(f"{side.title}, {name}")
            axes.grid(visible=True)
        panels[0].set_ylim(0, min(panels[0].get_ylim()[1], 2.0))
        shown = {line.get_label(): line for axes in panels for line in axes.lines}
        figure.legend(list(shown.values()), list(shown), loc="outside lower center", ncols=7, handlelength=2.0)
    return figure


def conditions(sides: Sequence[ComparedDataset]) -> "Figure | None":
    """Shares of frames by weather, road and time of day."""
    kinds = [kind for kind in CONDITIONS if any(side.summary["conditions"][kind] for side in sides)]
    if not kinds:
        return None
    with house_style():
        most = max(len({n for side in sides for n in side.summary["conditions"][kind]}) for kind in kinds)
        figure = new_figure(11.0, 1.4 + 0.38 * most)
        panels = figure.subplots(1, len(kinds), squeeze=False)[0]
        for axes, kind in zip(panels, kinds, strict=True):
            having = [(side, c) for side, c in zip(sides, SIDES, strict=False) if side.summary["conditions"][kind]]
            shares = {side.title: side.summary["conditions"][kind] for side, _ in having}
            _bars(axes, shares, [colour for _, colour in having])
            axes.set_ylim(most - 0.5, -0.5)
            axes.set_title(kind.capitalize())
            axes.set_xlabel("frames (%)")
        _legend(figure, panels[0])
    return figure


def radar_maps(sides: Sequence[ComparedDataset]) -> "Figure | None":
    """The first range-azimuth map of each side."""
    drawn = [(side, side.arrays["radar"]) for side in sides if side.arrays.get("radar")]
    if not drawn:
        return None
    with house_style():
        figure = new_figure(5.5 * len(drawn), 4.8)
        panels = figure.subplots(1, len(drawn), squeeze=False)[0]
        for axes, (side, radar) in zip(panels, drawn, strict=True):
            far = (radar["range_m"] >= 15.0) & (radar["range_m"] <= 107.0)
            above_db = radar["map_db"] - np.median(radar["map_db"][far])
            image = axes.pcolormesh(
                radar["azimuth_deg"], radar["range_m"], above_db, vmin=-4, vmax=12, cmap="viridis", rasterized=True
            )
            axes.invert_xaxis()  # left is positive, as one would see it
            axes.set(xlabel="azimuth (degrees; left is positive)", ylabel="range (m)")
            axes.set_title(side.title)
        figure.colorbar(image, ax=list(panels), label="dB above the floor", extend="both", shrink=0.9)
    return figure


def radar_levels(sides: Sequence[ComparedDataset]) -> "Figure | None":
    """Range profile above the floor, and quantiles of the strongest object's row."""
    drawn = [(s, c, s.arrays["radar"]) for s, c in zip(sides, SIDES, strict=False) if s.arrays.get("radar")]
    if not drawn:
        return None
    with house_style():
        figure = new_figure(11.0, 3.9)
        left, right = figure.subplots(1, 2, width_ratios=[1.5, 1])
        for side, colour, radar in drawn:
            left.plot(radar["range_m"], radar["profile_db"], color=colour, lw=1.5, label=side.title)
            row = side.summary["radar"]["row_quantiles_db"]
            right.plot([float(q) for q in row], list(row.values()), color=colour, marker="o", ms=4, lw=1.5)
        right.plot(
            [float(q) for q in _QUANTILES], list(_QUANTILES.values()), ls="none", marker="x", ms=8, mew=2, color=INK
        )
        left.set(xlim=(0, 119), ylim=(-8, 12), xlabel="range (m)", ylabel="dB above the floor")
        right.set(xlabel="quantile of the row (%)", ylabel="dB above the floor", xlim=(0, 100))
        for axes in (left, right):
            axes.grid(visible=True)
        _legend(figure, left)
    return figure


# Sweeps of two data sets from above on one scale, and the time that their reach leaves (Cirrus, Figure 2).

SPEED_MPH = 75.0
"""The speed of the Cirrus paper's example, at which 250, 120 and 70 m leave 7.5, 3.5 and 2 s."""
_MPH_M_S = 0.44704
_REACHED_SHARE = 0.999


def effective_range_m(cloud: Mapping[str, Any]) -> float | None:
    """Range within which 99.9 % of a cloud's returns lie, metres; None without returns.

    The farthest return is one echo of a bridge; a share of all returns is what a detector can live on.
    """
    count = np.asarray(cloud["range"]["count"], dtype=np.float64)
    edges = np.asarray(cloud["range"]["edges_m"], dtype=np.float64)
    if not count.sum():
        return None
    share = np.concatenate([[0.0], np.cumsum(count) / count.sum()])
    return float(np.interp(_REACHED_SHARE - 1e-9, share, edges))


def reaction_s(range_m: float, *, speed_m_s: float = SPEED_MPH * _MPH_M_S) -> float:
    """Seconds until what is seen at a range is reached.

    >>> [round(reaction_s(each), 1) for each in (250.0, 120.0, 70.0)]
    [7.5, 3.6, 2.1]
    """
    return range_m / speed_m_s


def from_above(sides: Sequence[ComparedDataset]) -> "Figure | None":
    """One sweep of each cloud, rings every 50 m, its effective range as a dashed ring."""
    panels = [
        (side, name, colour)
        for side, colour in zip(sides, SIDES, strict=False)
        for name in side.summary["clouds"]
        if f"sweep/{name}" in side.arrays
    ]
    if not panels:
        return None
    reaches_m = [effective_range_m(side.summary["clouds"][name]) for side, name, _ in panels]
    window_m = max([50.0, *(1.1 * reach_m for reach_m in reaches_m if reach_m)])
    across = min(len(panels), 4)
    down = -(-len(panels) // across)
    with house_style():
        figure = new_figure(11.0, 11.0 / across * down + 0.3)
        grid = figure.subplots(down, across, squeeze=False).ravel()
        for axes in grid[len(panels) :]:
            axes.set_axis_off()
        for axes, (side, name, colour), reach_m in zip(grid, panels, reaches_m, strict=False):
            points = side.arrays[f"sweep/{name}"]["xy_m"]
            axes.scatter(points[:, 1], points[:, 0], s=0.25, c=colour, linewidths=0, rasterized=True)
            for ring in np.arange(50.0, window_m, 50.0):
                axes.add_patch(_circle(ring, MUTED, "-", 0.4))
            if reach_m:
                axes.add_patch(_circle(reach_m, INK, (0, (4, 2)), 1.0))
            axes.set(xlim=(window_m, -window_m), ylim=(-window_m, window_m), aspect="equal")  # y points left
            axes.set(xlabel="y (m)", ylabel="x (m)")
            title = f"{side.title}, {name}"
            if reach_m is not None:
                title += f"\n{reach_m:.0f} m: {reaction_s(reach_m):.1f} s at {SPEED_MPH:.0f} mph"
            axes.set_title(title)
    return figure


def _circle(radius: float, colour: str, dash: Any, width: float) -> Any:
    from matplotlib.patches import Circle

    return Circle((0.0, 0.0), radius, fill=False, ec=colour, ls=dash, lw=width)

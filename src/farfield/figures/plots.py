"""Plots of scores and of sensors: precision-recall curves, points per box, the two scan patterns side by side."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from farfield.evaluation.report_data import returns_word
from farfield.figures.birds_eye import RANGES_M, draw_birdseye
from farfield.figures.report_text import pattern_title
from farfield.figures.style import ANNOTATED, INK, MUTED, PATTERNS, PREDICTED, THRESHOLDS, house_style, new_figure
from farfield.frame import Cloud
from farfield.metrics.detections import protocol_of
from farfield.metrics.presenting import CurvePanel
from farfield.vocabulary.counts import count_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap
    from matplotlib.figure import Figure

_RANGE_BINS_M = np.arange(0.0, 260.0, 10.0)
_VIEW_DEG = ((-62, 62), (-22, 14))
_VIEW_PIXELS_DEG = (8, 12)
_VIEW_END_M = 250.0


def precision_recall(results: Mapping[str, Mapping[str, Any]]) -> "Figure":
    """Overall precision over recall: the panels that a result's protocol draws, a line each of their curves.

    Args:
        results: Result JSON by name.
    """
    drawn = [
        (name, panel) for name, result in results.items() for panel in protocol_of(result).presenter.curves(result)
    ]
    columns = 2 if len(drawn) > 1 else 1
    with house_style():
        rows = max(1, -(-len(drawn) // columns))
        width_in, height_in = 10.2, 0.9 + 2.5 * rows
        figure = new_figure(width_in, height_in, fixed=True)
        figure.subplots_adjust(
            left=0.55 / width_in, right=1 - 0.15 / width_in, bottom=0.85 / height_in, top=1 - 0.3 / height_in
        )
        figure.subplots_adjust(wspace=0.06, hspace=0.2)
        grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
        for panel_index, axes in enumerate(grid.ravel()):
            if panel_index >= len(drawn):
                axes.set_axis_off()
                continue
            name, panel = drawn[panel_index]
            _draw_curves(axes, panel)
            axes.set_title(", ".join(filter(None, [pattern_title(name), panel.title])))
            axes.set_ylabel("precision" if panel_index % columns == 0 else "")
            axes.set_xlabel("recall" if panel_index + columns >= len(drawn) else "")
        shown: dict[str, Any] = {}
        for axes in grid.ravel():
            for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
                shown.setdefault(str(label), handle)
        if shown:
            figure.legend([*shown.values()], [*shown], loc="lower center", ncols=len(shown), handlelength=1.6)
    return figure


def _draw_curves(axes: "Axes", panel: CurvePanel) -> None:
    axes.grid(visible=True)
    axes.set(xlim=(0, 1), ylim=(0, 1.02))
    axes.set_xticks(np.linspace(0, 1, 6))
    if not panel.lines:
        axes.text(0.5, 0.5, "nothing annotated", ha="center", va="center", color=MUTED, transform=axes.transAxes)
    for index, line in enumerate(panel.lines):
        recall, precision = (np.asarray(values, dtype=np.float64) for values in (line.recall, line.precision))
        reached = np.flatnonzero(precision > 0)
        end = int(reached[-1]) + 1 if len(reached) else 0
        colour = THRESHOLDS[min(index, len(THRESHOLDS) - 1)]
        axes.plot(recall[:end], precision[:end], color=colour, lw=1.8, label=line.name)
        if 0 < end < len(recall):
            axes.plot(recall[end - 1], precision[end - 1], marker="o", ms=3.5, color=colour)


def points_against_range(objects: Mapping[str, Mapping[str, Any]], *, edges_m: Sequence[float] = RANGES_M) -> "Figure":
    """Points inside each annotated box over its range, found or missed: why far objects are hard.

    Args:
        objects: Lists ``range_m``, ``point_count``, ``is_found`` by result name, see
            :func:`farfield.evaluation.report_data.annotated_objects`.
        edges_m: Ranges to mark.
    """
    farthest_m = max(edges_m, default=RANGES_M[-1])
    with house_style():
        figure = new_figure(5.3 * len(objects), 3.9)
        panels = figure.subplots(1, len(objects), squeeze=False, sharex=True, sharey=True)[0]
        for axes, (name, rows) in zip(panels, objects.items(), strict=True):
            range_m = np.asarray(rows["range_m"], dtype=np.float64)
            count = np.asarray(rows["point_count"], dtype=np.float64)
            is_found = np.asarray(rows["found"], dtype=bool)
            size = float(np.clip(6000 / max(len(range_m), 1), 4, 22))
            for mask, colour, label in ((is_found, ANNOTATED, "found"), (~is_found, PREDICTED, "missed")):
                shown = np.maximum(count[mask], 0.5)  # empty boxes stand on the lowest line
                axes.scatter(
                    range_m[mask], shown, s=size, c=colour, alpha=0.55, linewidths=0, label=label, rasterized=True
                )
            axes.set_yscale("log")
            axes.set_ylim(0.4, max(float(count.max(initial=10.0)), 10.0) * 1.6)
            axes.set_yticks([0.5, 1, 10, 100, 1000], ["0", "1", "10", "100", "1000"])
            axes.minorticks_off()
            axes.set_xlim(0, 1.02 * farthest_m)
            axes.grid(visible=True)
            _mark_ranges(axes, edges_m)
            share = f"{is_found.mean():.0%} of {len(is_found)} found" if len(is_found) else "no objects"
            axes.set_title(f"{pattern_title(name)}: {share}")
            axes.set_xlabel("range (m)")
        units = {returns_word(str(rows.get("kind", "")), many=True) for rows in objects.values()}
        panels[0].set_ylabel(f"{' or '.join(sorted(units))} inside the annotated box")
        handles, names = panels[0].get_legend_handles_labels()
        legend = figure.legend(handles, names, loc="outside lower center", ncols=2, markerscale=1.6)
        for handle in legend.legend_handles:
            if handle is not None:
                handle.set_alpha(1.0)
    return figure


def _mark_ranges(axes: "Axes", edges_m: Sequence[float]) -> None:
    for edge_m in edges_m:
        axes.axvline(edge_m, color=INK, lw=0.8, ls=(0, (1, 3)), zorder=1.5)


def scan_patterns(clouds: Mapping[str, Cloud], *, edges_m: Sequence[float] = RANGES_M) -> "Figure":
    """The scan patterns side by side: as the sensor sees them, from above, and their number of points by range.

    Args:
        clouds: One cloud a pattern, of the same moment.
        edges_m: Ranges to mark.
    """
    with house_style():
        figure = new_figure(11.0, 8.3, fixed=True)
        grid = figure.add_gridspec(
            3,
            len(clouds),
            height_ratios=[3, 2.6, 2],
            left=0.06,
            right=0.92,
            bottom=0.065,
            top=0.96,
            hspace=0.32,
            wspace=0.1,
        )
        for column, (name, cloud) in enumerate(clouds.items()):
            view, above = figure.add_subplot(grid[0, column]), figure.add_subplot(grid[1, column])
            _draw_view(view, cloud)
            view.set_title(f"{pattern_title(name)}: {count_of(len(cloud), 'point', spec=',')}")
            view.set_ylabel("elevation (degrees)" if column == 0 else "")
            draw_birdseye(above, cloud, point_size=0.6, rings_m=edges_m)
            above.set_ylabel("y left (m)" if column == 0 else "")
        _draw_range_scale(figure, view)
        _draw_range_counts(figure.add_subplot(grid[2, :]), clouds, edges_m)
    return figure


def _draw_view(axes: "Axes", cloud: Cloud) -> None:
    """One picture of the nearest return's range a pixel; a point is four pixels, about as large as a marker."""
    x, y, z = cloud.points_m.astype(np.float64).T
    ground_range_m = np.hypot(x, y)
    angles_deg = np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, np.maximum(ground_range_m, 1e-6)))
    (right, left), (low, high) = _VIEW_DEG
    shape = (high - low) * _VIEW_PIXELS_DEG[1], (left - right) * _VIEW_PIXELS_DEG[0]
    column = np.floor((left - angles_deg[0]) * _VIEW_PIXELS_DEG[0]).astype(np.int64)
    row = np.floor((angles_deg[1] - low) * _VIEW_PIXELS_DEG[1]).astype(np.int64)
    inside = (column >= 0) & (column < shape[1] - 1) & (row >= 0) & (row < shape[0] - 1)
    near_last = np.flatnonzero(inside)[np.argsort(-ground_range_m[inside])]
    picture = np.zeros((*shape, 4), dtype=np.uint8)
    colours = _range_colours()(ground_range_m[near_last] / _VIEW_END_M, bytes=True)
    for across, up in ((0, 0), (0, 1), (1, 0), (1, 1)):
        picture[row[near_last] + up, column[near_last] + across] = colours
    extent = (float(left), float(right), float(low), float(high))  # left is positive, as one would see it
    axes.imshow(picture, origin="lower", extent=extent, interpolation="none", aspect="auto", zorder=2)
    axes.grid(visible=True)
    axes.set_xlabel("azimuth (degrees; left is positive)")


def _range_colours() -> "Colormap":
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    return ListedColormap(colormaps["viridis_r"](np.linspace(0.18, 1.0, 256)))  # palest yellows vanish on white


def _draw_range_scale(figure: "Figure", beside: "Axes") -> None:
    """What the colours of a view mean, as a bar at its right."""
    rectangle = beside.get_position()
    axes = figure.add_axes(
        (rectangle.x1 + 0.012, rectangle.y0 + 0.05 * rectangle.height, 0.012, 0.9 * rectangle.height)
    )
    scale = _range_colours()(np.linspace(0, 1, 256), bytes=True)[:, None]
    axes.imshow(scale, origin="lower", extent=(0, 1, 0, _VIEW_END_M), interpolation="none", aspect="auto")
    axes.set_xticks([])
    axes.yaxis.tick_right()
    axes.yaxis.set_label_position("right")
    axes.set_ylabel("range (m)")


def _draw_range_counts(axes: "Axes", clouds: Mapping[str, Cloud], edges_m: Sequence[float]) -> None:
    for index, (name, cloud) in enumerate(clouds.items()):
        ground_range_m = np.hypot(cloud.points_m[:, 0], cloud.points_m[:, 1])
        count, _ = np.histogram(ground_range_m, bins=_RANGE_BINS_M)
        colour = PATTERNS[index % len(PATTERNS)]
        axes.stairs(
            np.maximum(count, 0.5), _RANGE_BINS_M, baseline=None, color=colour, lw=1.8, label=pattern_title(name)
        )
    axes.set_yscale("log")
    axes.set_ylim(bottom=1)
    axes.set_xlim(0, 250)
    axes.grid(visible=True)
    _mark_ranges(axes, edges_m)
    axes.set_title("Points returned from each 10 m of range")
    axes.set_xlabel("range (m)")
    axes.set_ylabel("points")
    axes.legend(loc="upper right")

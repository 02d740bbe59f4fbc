"""What ``farfield sync`` writes: tables of matches, one JSON, and a page of residuals, gaps and clocks."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from farfield.errors import ConfigError, FarfieldError
from farfield.figures.style import ANNOTATED, INK, MUTED, PREDICTED, RULE, figure_uri, house_style, new_figure
from farfield.files.atomic import write_text
from farfield.files.clock_logs import read_clock_log
from farfield.jobs.folders import held
from farfield.pages.template import PageImage, render_template
from farfield.sync.clocks import ExchangeClock, summarised
from farfield.sync.sources import RecordedStreams
from farfield.sync.synchronising import (
    StreamPair,
    SyncResult,
    best_reference,
    describe,
    match_table,
    over_time,
    synchronise,
)
from farfield.vocabulary.counts import count_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HEADS = (
    "stream",
    "stamps",
    "rate, Hz",
    "gaps",
    "lost",
    "matched",
    "distance, median, ms",
    "distance, largest, ms",
    "offset (+ later), ms",
    "drift (+ faster), ppm",
)
ARRIVAL_HEADS = ("stream", "recorded after its stamp, ms", "this includes", "the computer's clock against it, ppm")

_FEW = 200
"""So few pairs are drawn one by one."""


def write_sync_page(path: Path | str, results: Sequence[SyncResult], *, title: str) -> None:
    """Write the page, all or nothing.

    Args:
        path: The file.
        results: What was found, a recording each.
        title: Title of the page.
    """
    pictures = []
    for result in results:
        head = result.name if len(results) > 1 else "Streams"
        alt = f"When each stream of {result.name} has messages, and where it has gaps"
        caption = "Orange: intervals longer than one and a half periods."
        pictures.append(PageImage(figure_uri(timeline(result)), alt, caption, f"{head}: when they ran"))
        if any(len(pair.times_ns) for pair in result.pairs.values()):
            alt = f"Histogram and course of the residuals of each stream against {result.reference}"
            caption = (
                f"How much later than {result.reference} each stream's message is; below 0: earlier. "
                "Right: median, and the band that "
                "holds 80 % of them; dashed: the fitted offset and drift."
            )
            pictures.append(PageImage(figure_uri(residuals(result)), alt, caption, f"{head}: residual offsets"))
    page = render_template(
        "sync.html",
        title=title,
        found=results,
        heads=HEADS,
        tables=[table(result) for result in results],
        arrival_heads=ARRIVAL_HEADS,
        arrivals=[arrivals(result) for result in results],
        pictures=pictures,
    )
    write_text(path, page)


def table(result: SyncResult) -> list[tuple[str, ...]]:
    """A row a stream, under :data:`HEADS`, as words."""
    rows = []
    for name, health in result.streams.items():
        rate = "" if not health.tick_ns else f"{1e9 / health.tick_ns:.3f}"
        row = [name, f"{health.count:,}", rate, f"{health.gaps:,}", f"{health.lost:,}"]
        pair = result.pairs.get(name)
        row += ["reference", "", "", "", ""] if pair is None else _matched(pair)
        rows.append(tuple(row))
    return rows


def _matched(pair: StreamPair) -> list[str]:
    size = np.abs(pair.residual_ns) / 1e6
    quantile = f"{np.median(size):.3f}" if len(size) else ""
    worst = f"{pair.worst_ns / 1e6:.3f}" if len(size) else ""
    clock = pair.clock
    if clock is None:
        return [f"{pair.matched:,}", quantile, worst, "", ""]
    drift = f"{clock.drift_ppm:+.3f} ± {clock.drift_se_ppm:.3f}"
    turns = "" if clock.modulo_ns is None else f" + k {clock.modulo_ns / 1e6:.1f}"
    return [f"{pair.matched:,}", quantile, worst, f"{clock.offset_ns / 1e6:+.3f}{turns}", drift]


def arrivals(result: SyncResult) -> list[tuple[str, ...]]:
    """A row a stream whose messages were recorded by a computer, under :data:`ARRIVAL_HEADS`, as words."""
    return [
        (
            name,
            f"{clock.offset_ns / 1e6:+.3f}",
            clock.offset_includes,
            f"{clock.drift_ppm:+.3f} ± {clock.drift_se_ppm:.3f}",
        )
        for name, clock in result.arrivals.items()
    ]


def residuals(result: SyncResult) -> "Figure":
    """A row a stream: the histogram of its residuals, and their course over time."""
    shown = {name: pair for name, pair in result.pairs.items() if len(pair.times_ns)}
    with house_style():
        figure = new_figure(10.2, 0.4 + 2.1 * len(shown))
        grid = figure.subplots(len(shown), 2, squeeze=False, width_ratios=(1, 1.8))
        for (left, right), (name, pair) in zip(grid, shown.items(), strict=True):
            _histogram(left, name, pair)
            _course(right, pair)
        grid[-1, 0].set_xlabel("later than the reference (below 0: earlier), ms")
        grid[-1, 1].set_xlabel("since the first pair, s")
    return figure


def _histogram(axes: "Axes", name: str, pair: StreamPair) -> None:
    values = pair.residual_ns / 1e6
    low, high = float(values.min()), float(values.max())
    spare = max(0.1 * (high - low), 1e-3)
    low, high = low - spare, high + spare
    if max(low, -high, 0.0) < 2 * (high - low):  # zero is near: show it
        low, high = min(low, 0.0), max(high, 0.0)
        axes.axvline(0, color=RULE, lw=0.8)
    axes.hist(values, bins=np.linspace(low, high, int(np.clip(len(values) // 3, 8, 60)) + 1).tolist(), color=ANNOTATED)
    axes.set_title(f"{name}: {count_of(pair.matched, 'pair')} within {pair.tolerance_ns / 1e6:.3g} ms")
    axes.set_ylabel("pairs")
    axes.locator_params(axis="y", integer=True)
    axes.locator_params(axis="x", nbins=4)  # 3.99925 is long


def _course(axes: "Axes", pair: StreamPair) -> None:
    if len(pair.times_ns) < _FEW:
        axes.plot((pair.times_ns - pair.times_ns[0]) / 1e9, pair.residual_ns / 1e6, "o", color=ANNOTATED, ms=3.5)
    else:
        middle_s, bands = over_time(pair.times_ns, pair.residual_ns / 1e6)
        axes.fill_between(middle_s, bands[:, 0], bands[:, 2], color=ANNOTATED, alpha=0.2, lw=0)
        axes.plot(middle_s, bands[:, 1], color=ANNOTATED, lw=1.2)
    clock = pair.clock
    if clock is not None and clock.modulo_ns is not None:
        since = pair.times_ns - pair.times_ns[0]
        line = clock.offset_ns + (pair.times_ns - clock.middle_ns) * (clock.drift_ppm * 1e-6)
        wrapped = (line - clock.modulo_ns * np.rint(line / clock.modulo_ns)) / 1e6
        wrapped[1:][np.abs(np.diff(wrapped)) > clock.modulo_ns / 2e6] = np.nan
        axes.plot(since / 1e9, wrapped, color=INK, lw=0.9, ls="--")
    axes.set_ylabel("ms")
    axes.grid(visible=True)


def timeline(result: SyncResult) -> "Figure":
    """A line a stream from its first to its last stamp, with its gaps, in seconds from the reference's first."""
    start = result.streams[result.reference].first_ns or 0
    with house_style():
        figure = new_figure(10.2, 0.7 + 0.32 * len(result.streams))
        axes = figure.subplots()
        names = list(result.streams)
        for row, name in enumerate(names):
            health = result.streams[name]
            if health.first_ns is None or health.last_ns is None:
                continue
            first, last = ((time - start) / 1e9 for time in (health.first_ns, health.last_ns))
            colour = INK if name == result.reference else ANNOTATED
            axes.plot([first, max(last, first)], [row, row], color=colour, lw=5, solid_capstyle="butt")
            starts_s = (health.gap_starts_ns - start) / 1e9
            axes.hlines(
                np.full(len(starts_s), row), starts_s, starts_s + health.gap_lengths_ns / 1e9, color=PREDICTED, lw=5
            )
        axes.set_yticks(range(len(names)), names)
        axes.set_ylim(len(names) - 0.4, -0.6)
        axes.set_xlabel(f"seconds from the first stamp of {result.reference}", color=MUTED)
    return figure


# What ``farfield sync`` writes: a table of matches a recording, one JSON and one page.


def write_synchronised(
    folder: Path | str, recordings: Sequence[RecordedStreams], *, to: str | None, tolerance_ns: int | None, title: str
) -> list[SyncResult]:
    """Match each recording and write ``matches.csv`` (``matches-NAME.csv`` of several), ``sync.json``, ``sync.html``.

    Args:
        folder: Made if absent.
        recordings: The recordings.
        to: The stream to which the others are matched; None takes the best.
        tolerance_ns: Largest distance; None takes half the period of the faster stream of each pair.
        title: Title of the page.

    Raises:
        ConfigError: If a recording has no such stream, or two recordings have one name.
    """
    folder = Path(folder)
    names = [recording.name for recording in recordings]
    if len(set(names)) < len(names):
        raise ConfigError(f"expected recordings of different names, got {', '.join(names)}")
    tables = [folder / ("matches.csv" if len(recordings) == 1 else f"matches-{name}.csv") for name in names]
    with held(folder):
        results = [
            _synchronise(path, recording, to, tolerance_ns) for path, recording in zip(tables, recordings, strict=True)
        ]
        content = {"recordings": [result.to_json() for result in results]}
        write_text(folder / "sync.json", json.dumps(content, indent=2, allow_nan=False) + "\n")
        write_sync_page(folder / "sync.html", results, title=title)
    return results


def _synchronise(path: Path, recording: RecordedStreams, to: str | None, tolerance_ns: int | None) -> SyncResult:
    reference = best_reference(describe(recording)) if to is None else to
    labels = {name: source.labels for name, source in recording.streams.items() if source.labels is not None}
    with match_table(path, reference, labels) as table:
        return synchronise(
            recording,
            to=reference,
            tolerance_ns=tolerance_ns,
            exchanges={log.name: _exchange_clock(log) for log in recording.logs},
            row=table.add,
        )


def _exchange_clock(log: Path) -> ExchangeClock:
    try:
        return summarised(read_clock_log(log))
    except FarfieldError as error:
        raise ConfigError(f"the log of a clock beside the stamps cannot be used: {error}") from error

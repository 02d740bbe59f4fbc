"""Two data sets side by side: a table of their statistics, figures, and one self-contained HTML page."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from farfield.figures import comparison_plots
from farfield.figures.style import figure_uri
from farfield.figures.sweeps_plot import SPEED_MPH, effective_range_m, from_above, reaction_s
from farfield.files.atomic import write_text
from farfield.inspection.side import ComparedDataset
from farfield.pages.template import PageImage, render_template
from farfield.vocabulary.conditions import CONDITIONS
from farfield.vocabulary.patterns import PATTERNS
from farfield.vocabulary.published import RADAR_LEVELS, RAISED_SHARES, ROW_QUANTILES_DB, SHARES_NEAR_HORIZON

_RADAR_WORDS = {
    "floor_db": "noise floor (dB)",
    "floor_std_db": "spread of the floor (dB)",
    "peak_db": "strongest object above the floor (dB)",
    "peak_m": "range of the strongest object (m)",
    "leakage_db": "leakage below 0.5 m, above the floor (dB)",
    "ring_db": "1 to 5 m, above the floor (dB)",
    "dip_db": "6 to 11 m, above the floor (dB)",
    "rolloff_db": "110 to 114 m, above the floor (dB)",
    "wrap_db": "beyond 116 m, above the floor (dB)",
    "cell_median_to_mean": "single cells, median over mean",
}
NOTHING = "–"


@dataclass(frozen=True)
class ComparisonLine:
    """One line of the table.

    Args:
        topic: What group it belongs to.
        what: What was measured.
        values: One text a side.
        published: The figure known from real data, or nothing.
    """

    topic: str
    what: str
    values: tuple[str, ...]
    published: str = ""


def table_lines(sides: Sequence[ComparedDataset]) -> list[ComparisonLine]:
    """The table of all statistics; lines that neither side has are left out."""
    lines = [
        *_line(sides, "data", "frames", "frames", digits=0),
        *_line(sides, "data", "sequences", "sequences", digits=0),
        ComparisonLine("data", "simulated", tuple(_simulated_text(side.summary.get("simulated")) for side in sides)),
        *_line(sides, "data", "boxes are", "box_protocol"),
    ]
    for cloud in _names(sides, "clouds"):
        lines += _cloud_lines(sides, cloud)
    lines += _line(sides, "LiDAR", "points in vehicles beyond 50 m, gaussian over uniform", "pattern_ratio_beyond_50_m")
    lines += _line(sides, "boxes", "a frame", "boxes", "per_frame", digits=1)
    lines += _line(sides, "boxes", "most in a frame", "boxes", "most_in_a_frame", digits=0)
    for name in _names(sides, "boxes", "classes")[:8]:
        lines += _line(sides, "boxes", f"share of {name}", "boxes", "classes", name, "share", digits=3)
    for axis in ("length_m", "width_m", "height_m"):
        what = f"mean {axis.removesuffix('_m')} of vehicle (m)"
        lines += _line(sides, "boxes", what, "boxes", "classes", "vehicle", axis, "mean")
    for kind in CONDITIONS:
        for name in _names(sides, "conditions", kind):
            lines += _line(sides, kind, f"share of frames, {name}", "conditions", kind, name, digits=3)
    for key, words in _RADAR_WORDS.items():
        published = RADAR_LEVELS.get(key, "")
        lines += _line(sides, "radar", words, "radar", key, published=published)
    for quantile, published in ROW_QUANTILES_DB.items():
        words = f"strongest object's row, {quantile} % quantile (dB)"
        lines += _line(sides, "radar", words, "radar", "row_quantiles_db", quantile, published=published)
    for within, published in RAISED_SHARES.items():
        words = f"share of cells 2 dB above the floor, {within} m"
        lines += _line(sides, "radar", words, "radar", "raised_share", within, digits=3, published=published)
    for weather in _names(sides, "radar_survival", "weather"):
        if weather != "normal":
            words = f"vehicles above the floor, {weather} minus normal (dB)"
            lines += _line(sides, "radar", words, "radar_survival", "weather", weather, "overall")
    return lines


def _cloud_lines(sides: Sequence[ComparedDataset], cloud: str) -> list[ComparisonLine]:
    base = ("clouds", cloud)
    topic = f"LiDAR, {cloud}"
    lines = [
        *_line(sides, topic, "points a frame", *base, "points_per_frame", digits=0),
        *_line(sides, topic, "share of shots that return", *base, "return_rate", digits=3),
        *_line(sides, topic, "farthest return (m)", *base, "longest_m", digits=0),
        *_reach_lines(sides, topic, cloud),
    ]
    far_m = next((side.summary["clouds"][cloud]["far_m"] for side in sides if cloud in side.summary["clouds"]), 0.0)
    focus = next((side.summary["clouds"][cloud]["focus_deg"] for side in sides if cloud in side.summary["clouds"]), 0.0)
    kinds = {
        "far_share_of_horizon": f"|elevation| < {{}}°, beyond {far_m:g} m",
        "share_of_horizon": "|elevation| < {}°, all returns",
        "far_share_of_focus": f"within {{}}° of {focus:g}°, beyond {far_m:g} m",
        "share_of_focus": f"within {{}}° of {focus:g}°, all returns",
    }
    for key, words in kinds.items():
        for limit, share in SHARES_NEAR_HORIZON.items():
            published = share if PATTERNS[0] in cloud.split(" : ") and key == "far_share_of_horizon" else ""
            lines += _line(sides, topic, words.format(limit), *base, key, limit, digits=3, published=published)
    points = (*base, "points_in_vehicles")
    lines += _line(sides, topic, "points in vehicles: slope in log-log", *points, "slope")
    lines += _line(sides, topic, "points in vehicles: level at 50 m", *points, "level", digits=1)
    for weather in _names(sides, *base, "survival", "weather"):
        if weather == "normal":
            continue
        words = f"points in vehicles, {weather} over normal"
        lines += _line(sides, topic, words, *base, "survival", "weather", weather, "overall")
    return lines


def _reach_lines(sides: Sequence[ComparedDataset], topic: str, cloud: str) -> list[ComparisonLine]:
    """Effective range and the time that it leaves."""
    clouds = [side.summary["clouds"].get(cloud) for side in sides]
    reaches = [None if each is None or "range" not in each else effective_range_m(each) for each in clouds]
    if not any(reaches):
        return []
    times = [None if reach is None else reaction_s(reach) for reach in reaches]
    leaves = f"time that leaves at {SPEED_MPH:.0f} mph (s)"
    return [
        ComparisonLine(topic, "99.9 % of returns lie within (m)", tuple(_text(reach, 0) for reach in reaches)),
        ComparisonLine(topic, leaves, tuple(_text(each, 1) for each in times)),
    ]


def _line(
    sides: Sequence[ComparedDataset], topic: str, what: str, *path: str, digits: int = 2, published: str = ""
) -> list[ComparisonLine]:
    values = tuple(_text(_find(side.summary, path), digits) for side in sides)
    return [] if set(values) == {NOTHING} else [ComparisonLine(topic, what, values, published)]


def _find(tree: Any, path: Sequence[str]) -> Any:
    for key in path:
        tree = tree.get(key) if isinstance(tree, Mapping) else None
    return tree


def _names(sides: Sequence[ComparedDataset], *path: str) -> list[str]:
    """Keys that any side has there, in the order of their first appearance."""
    return list(dict.fromkeys(name for side in sides for name in _find(side.summary, path) or {}))


def _text(value: Any, digits: int) -> str:
    if value is None:
        return NOTHING
    return f"{value:,.{digits}f}" if isinstance(value, int | float) else str(value)


def _simulated_text(simulated: bool | None) -> str:
    return {True: "yes", False: "no", None: "not said"}[simulated]


def sensor_pictures_of(sides: Sequence[ComparedDataset]) -> list[PageImage]:
    """Every figure that at least one side has the data for."""
    found = []
    for draw, heading, caption in (
        (
            from_above,
            "Sweeps from above",
            "One sweep of each, on one scale; thin rings every 50 m. The dashed ring holds 99.9 % of the returns "
            "of all frames: the effective range, and beside it the time that it leaves at a speed.",
        ),
        (
            comparison_plots.elevation,
            "Where the returns lie in elevation",
            "Left: share of returns per degree of elevation, as the origin of the frame sees it. Right: shares near "
            "the horizon, of returns beyond 8 m; nearer ones shift where several sensors were merged into one cloud. "
            "The crosses are the published figures of real Luminar sweeps.",
        ),
        (
            comparison_plots.points_in_vehicles,
            "Points in vehicle boxes over distance",
            "Darker hexagons hold more boxes; empty boxes stand on the lowest line. Dots are medians of distance bins, "
            "lines are fitted to the medians. A sensor that sees whole objects has slope -2.",
        ),
        (comparison_plots.ranges, "Range of the returns", "Share of returns in each 5 m of range."),
        (
            comparison_plots.objects,
            "Objects",
            "Distance of annotated vehicles over the ground, and the classes that were annotated.",
        ),
        (
            comparison_plots.sizes,
            "Box sizes",
            "Mean and standard deviation by class, in metres, of classes with 3 boxes or more.",
        ),
        (
            comparison_plots.survival,
            "What weather leaves of a vehicle's points",
            "Mean points in vehicle boxes over those in normal weather at the same distance; 1 is no loss. Boxes of "
            "visible parts only hide the loss of whole objects.",
        ),
        (comparison_plots.conditions, "Conditions", "Shares of frames by weather, road and time of day."),
        (
            comparison_plots.radar_maps,
            "Radar: power by range and azimuth",
            "Mean over Doppler and elevation of the first frame, in dB above that frame's floor.",
        ),
        (
            comparison_plots.radar_levels,
            "Radar: floor, edges and side lobes",
            "Left: median over azimuth by range, above the floor. Right: quantiles of the strongest object's azimuth "
            "row; the crosses are the published real frame.",
        ),
    ):
        figure = draw(sides)
        if figure is not None:
            alt = f"{heading}: {' and '.join(side.title for side in sides)}"
            found.append(PageImage(figure_uri(figure), alt, caption, heading))
    return found


def render_comparison(sides: Sequence[ComparedDataset], *, title: str) -> str:
    """Return the page as HTML."""
    return render_template(
        "comparison.html",
        title=title,
        sides=sides,
        lines=table_lines(sides),
        pictures=sensor_pictures_of(sides),
        any_simulated=any(side.simulated for side in sides),
    )


def write_comparison(folder: Path | str, sides: Sequence[ComparedDataset], *, title: str) -> Path:
    """Write ``comparison.json`` and ``comparison.html`` into a folder, each all or nothing.

    Args:
        folder: Made if absent.
        sides: The two data sets.
        title: Title of the page.

    Returns:
        The page.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    tree = {"title": title, "sides": [{"name": s.name, "path": s.path, **s.summary} for s in sides]}
    write_text(folder / "comparison.json", json.dumps(tree, indent=1, allow_nan=False) + "\n")
    write_text(folder / "comparison.html", render_comparison(sides, title=title))
    return folder / "comparison.html"

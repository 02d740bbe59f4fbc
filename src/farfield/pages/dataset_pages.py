"""Data sets on self-contained pages: the statistics of one, and two side by side."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from farfield.figures import comparison_plots, dataset_plots
from farfield.figures.comparison_plots import SPEED_MPH, effective_range_m, from_above, reaction_s
from farfield.figures.rig import placement_figure
from farfield.figures.style import figure_bytes, figure_uri
from farfield.files.atomic import write_bytes, write_text
from farfield.inspection.comparison import ComparedDataset, ToldApartClouds, told_apart
from farfield.inspection.placement import RigPlacement
from farfield.inspection.statistics.background import ToldApart
from farfield.jobs.folders import held
from farfield.pages.template import PageImage, render_template
from farfield.vocabulary.conditions import CONDITIONS
from farfield.vocabulary.patterns import PATTERNS
from farfield.vocabulary.published_tables import RADAR_LEVELS, RAISED_SHARES, ROW_QUANTILES_DB, SHARES_NEAR_HORIZON

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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


def table_lines(sides: Sequence[ComparedDataset], roadsides: ToldApartClouds | None = None) -> list[ComparisonLine]:
    """The table of all statistics; lines that neither side has are left out.

    Args:
        sides: One data set or two.
        roadsides: How well two are told apart (default: computed).
    """
    roadsides = told_apart(sides) if roadsides is None else roadsides
    simulated_text = {True: "yes", False: "no", None: "not said"}
    lines = [
        *_line(sides, "data", "frames", "frames", digits=0),
        *_line(sides, "data", "sequences", "sequences", digits=0),
        ComparisonLine("data", "simulated", tuple(simulated_text[side.summary.get("simulated")] for side in sides)),
        *_line(sides, "data", "boxes are", "box_protocol"),
    ]
    for cloud in _names(sides, "clouds"):
        lines += _cloud_lines(sides, cloud)
        lines += _background_lines(sides, cloud, roadsides)
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
    for key, label in _RADAR_WORDS.items():
        published = RADAR_LEVELS.get(key, "")
        lines += _line(sides, "radar", label, "radar", key, published=published)
    for quantile, published in ROW_QUANTILES_DB.items():
        label = f"strongest object's row, {quantile} % quantile (dB)"
        lines += _line(sides, "radar", label, "radar", "row_quantiles_db", quantile, published=published)
    for within, published in RAISED_SHARES.items():
        label = f"share of cells 2 dB above the floor, {within} m"
        lines += _line(sides, "radar", label, "radar", "raised_share", within, digits=3, published=published)
    for weather in _names(sides, "radar_survival", "weather"):
        if weather != "normal":
            label = f"vehicles above the floor, {weather} minus normal (dB)"
            lines += _line(sides, "radar", label, "radar_survival", "weather", weather, "overall")
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
    for key, what in kinds.items():
        for limit, share in SHARES_NEAR_HORIZON.items():
            published = share if PATTERNS[0] in cloud.split(" : ") and key == "far_share_of_horizon" else ""
            lines += _line(sides, topic, what.format(limit), *base, key, limit, digits=3, published=published)
    points = (*base, "points_in_vehicles")
    lines += _line(sides, topic, "points in vehicles: slope in log-log", *points, "slope")
    lines += _line(sides, topic, "points in vehicles: level at 50 m", *points, "level", digits=1)
    for weather in _names(sides, *base, "survival", "weather"):
        if weather == "normal":
            continue
        what = f"points in vehicles, {weather} over normal"
        lines += _line(sides, topic, what, *base, "survival", "weather", weather, "overall")
    return lines


_ROADSIDE = {
    "thickness_m": ("patches above the ground: thickness T (cm)", 100.0, 1, "6 to 15"),
    "scatter": ("points about which lies no plane: S", 1.0, 3, "0.35 to 0.65"),
    "scatter_of_all": ("of all points: S_all", 1.0, 3, "0.08 to 0.30"),
    "clusters": ("clusters of a car's size a sector: C", 1.0, 1, "2 to 6"),
    "thickness_in_boxes_m": ("patches in annotated boxes: thickness (cm)", 100.0, 1, ""),
}
"""Lines of the roadside: words, factor, digits, and what eight real sets of five sensors show."""


def _background_lines(sides: Sequence[ComparedDataset], cloud: str, roadsides: ToldApartClouds) -> list[ComparisonLine]:
    """The roadside without annotated objects, and how well the two are told apart by it."""
    topic, lines = f"roadside, {cloud}", []
    for key, (what, factor, digits, real) in _ROADSIDE.items():
        rows = [_find(side.summary, ("clouds", cloud, "background", key)) for side in sides]
        values = tuple(NOTHING if row is None else _with_interval(row, factor, digits) for row in rows)
        lines += [] if set(values) == {NOTHING} else [ComparisonLine(topic, what, values, real)]
    if cloud in roadsides.apart:
        apart, floor = roadsides.apart[cloud], roadsides.floor.get(cloud)
        lines += _apart_lines(topic, apart, "")
        telling = next(iter(apart.features.items()))
        lines.append(ComparisonLine(topic, "most telling feature alone", ("", f"{telling[0]} ({telling[1]:.2f})")))
        if apart.lost_without:
            lost = ", ".join(f"{name} ({area:.2f})" for name, area in [*apart.lost_without.items()][:3])
            lines.append(ComparisonLine(topic, "what the classifier loses most by (its area without it)", ("", lost)))
        if floor is not None:
            lines += _apart_lines(topic, floor, f"floor, {sides[1].name} and {roadsides.floor_name}: ")
    return lines


def _apart_lines(topic: str, apart: ToldApart, before: str) -> list[ComparisonLine]:
    areas = (apart.by_thickness, apart.thickness_interval), (apart.by_classifier, apart.classifier_interval)
    thickness, classifier = (
        _with_interval({"value": area, "low": span and span[0], "high": span and span[1]}, 1.0, 2)
        for area, span in areas
    )
    return [
        ComparisonLine(topic, f"{before}told apart by thickness: AUC_T", ("", thickness), "0.5 to 0.7"),
        ComparisonLine(topic, f"{before}by a classifier of seven features, on {apart.tried_on}", ("", classifier)),
    ]


def _with_interval(row: Mapping[str, float | None], factor: float, digits: int) -> str:
    numbers = (row[key] for key in ("value", "low", "high"))
    value, low, high = (None if number is None else factor * number for number in numbers)
    return _text(value, digits) + (f" ({_text(low, digits)} to {_text(high, digits)})" if low is not None else "")


def _reach_lines(sides: Sequence[ComparedDataset], topic: str, cloud: str) -> list[ComparisonLine]:
    """Effective range and the time that it leaves."""
    clouds = [side.summary["clouds"].get(cloud) for side in sides]
    reaches_m = [
        None if cloud_summary is None or "range" not in cloud_summary else effective_range_m(cloud_summary)
        for cloud_summary in clouds
    ]
    if not any(reaches_m):
        return []
    times = [None if reach_m is None else reaction_s(reach_m) for reach_m in reaches_m]
    leaves = f"time that leaves at {SPEED_MPH:.0f} mph (s)"
    return [
        ComparisonLine(topic, "99.9 % of returns lie within (m)", tuple(_text(reach_m, 0) for reach_m in reaches_m)),
        ComparisonLine(topic, leaves, tuple(_text(cloud_summary, 1) for cloud_summary in times)),
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


def sensor_pictures(sides: Sequence[ComparedDataset]) -> list[PageImage]:
    """Every figure that at least one side has the data for."""
    images = []
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
        (
            comparison_plots.roadside,
            "Thickness of the roadside",
            "Small patches above the ground, without annotated objects: share of them that are thinner. Walls and "
            "sheets stand on the left, hedges and bushes on the right.",
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
            images.append(PageImage(figure_uri(figure), alt, caption, heading))
    return images


def render_comparison(sides: Sequence[ComparedDataset], *, title: str, roadsides: ToldApartClouds | None = None) -> str:
    """Return the page as HTML."""
    roadsides = told_apart(sides) if roadsides is None else roadsides
    pictures = sensor_pictures(sides)
    drawn = comparison_plots.telling_features(roadsides)
    if drawn is not None:
        heading = "What tells the roadsides apart"
        tried_on = sorted({apart.tried_on for apart in (*roadsides.apart.values(), *roadsides.floor.values())})
        caption = (
            "Dots: area under the ROC of each feature of a small patch alone; 0.5 tells nothing apart. Line: of a "
            f"classifier of all seven, tried on {' or '.join(tried_on)} that it did not learn from, with its 95 % "
            "interval."
        )
        pictures.append(PageImage(figure_uri(drawn), f"{heading}: areas under the ROC by feature", caption, heading))
    return render_template(
        "comparison.html",
        title=title,
        sides=sides,
        lines=table_lines(sides, roadsides),
        pictures=pictures,
        any_simulated=any(side.simulated for side in sides),
    )


def write_comparison(
    folder: Path | str, sides: Sequence[ComparedDataset], *, title: str, roadsides: ToldApartClouds | None = None
) -> Path:
    """Write ``comparison.json`` and ``comparison.html`` into a folder, each all or nothing.

    Args:
        folder: Made if absent.
        sides: The two data sets.
        title: Title of the page.
        roadsides: How well the two are told apart (default: computed).

    Returns:
        The page.
    """
    folder = Path(folder)
    roadsides = told_apart(sides) if roadsides is None else roadsides
    with held(folder):
        folder.mkdir(parents=True, exist_ok=True)
        tree: dict[str, Any] = {"title": title, "sides": [{"name": s.name, "path": s.path, **s.summary} for s in sides]}
        tree["told_apart"] = roadsides.to_json()
        write_text(folder / "comparison.json", json.dumps(tree, indent=1, allow_nan=False) + "\n")
        write_text(folder / "comparison.html", render_comparison(sides, title=title, roadsides=roadsides))
    return folder / "comparison.html"


# One data set's figures on one self-contained page: its annotations over every frame, its sensors over some.

_TITLES = {
    "class_and_weather": "Boxes by class and weather",
    "class_and_road": "Boxes by class and road",
    "class_and_time": "Boxes by class and time of day",
    "class_and_range": "Boxes by class and range",
    "class_and_visibility": "Boxes by class and visibility",
}


@dataclass(frozen=True)
class DatasetFigures:
    """What the page shows.

    Args:
        name: What the data set is called.
        format: Its format.
        path: Where it was read from.
        census: ``Census.summary()`` of :mod:`farfield.inspection.statistics.census`.
        arrays: ``name``, ``range_m`` of every box and ``objects`` of every frame.
        sensors: Clouds, boxes and radar of some frames, as :mod:`farfield.pages.dataset_pages` takes them; None where
            none was read.
        notes: Sentences on what is special: label versions, where conditions come from.
        placed: Where the sensors stand; None where that is not known.
    """

    name: str
    format: str
    path: str
    census: Mapping[str, Any]
    arrays: Mapping[str, np.ndarray]
    sensors: ComparedDataset | None = None
    notes: tuple[str, ...] = ()
    placed: RigPlacement | None = None


def figures(dataset: DatasetFigures) -> "Iterator[tuple[str, Figure, str, str]]":
    """The census' figures: file name, figure, heading and caption."""
    summary, arrays = dataset.census, dataset.arrays
    drawn = (
        (
            "frames_by_condition",
            dataset_plots.frames_by_condition(summary),
            "Frames by weather, road and time",
            "How many frames were recorded in each condition; K-Radar tells them for whole sequences.",
        ),
        (
            "sequences",
            dataset_plots.sequences(summary),
            "Sequences",
            "Frames of each sequence in the colour of its weather.",
        ),
        (
            "classes",
            dataset_plots.classes(summary),
            "Classes",
            "Boxes of each class as the data set names it, and how much of them the sensors see.",
        ),
        (
            "class_tables",
            dataset_plots.matrix(summary),
            "Classes by weather and range",
            "Number of boxes; darker is more, on a logarithmic scale. A dash is none.",
        ),
        (
            "ranges",
            dataset_plots.ranges(summary, arrays),
            "Range",
            "Ground distance of each box's centre from the sensor in whose frame the boxes are.",
        ),
        (
            "visibility_by_weather",
            dataset_plots.visibility_by_weather(summary),
            "Visibility by weather",
            "Shares of boxes, and how many boxes a frame has.",
        ),
        (
            "per_frame",
            dataset_plots.per_frame(arrays),
            "Objects in a frame",
            "Frames without annotation are left out.",
        ),
        ("sensor_placement", placement_figure(dataset.placed), "Sensor placement", _placed_caption(dataset.placed)),
    )
    for name, figure, heading, caption in drawn:
        if figure is not None:
            yield name, figure, heading, caption


def _placed_caption(placed: RigPlacement | None) -> str:
    if placed is None:
        return ""
    lacks = f" Not known: {', '.join(placed.unknown)}." if placed.unknown else ""
    return f"Where the sensors stand in the coordinates of {placed.reference} (cross), metres.{lacks}"


def tables(census: Mapping[str, Any]) -> list[tuple[str, list[str], list[list[str]]]]:
    """The page's tables: title, heads, rows of text."""
    classes = [
        [
            name,
            row["farfield_class"],
            f"{row['objects']:,}",
            "–" if row["tracks"] is None else f"{row['tracks']:,}",
            " × ".join(f"{side:.2f}" for side in row["mean_size_m"]),
        ]
        for name, row in census["classes"].items()
    ]
    titled = [("Classes", ["class", "in Farfield", "boxes", "tracks", "mean length × width × height (m)"], classes)]
    for key, table in census["objects_by"].items():
        heads = ["class", *(dataset_plots.spoken(name) for name in next(iter(table.values()), {})), "all"]
        rows = [
            [name, *(f"{count:,}" for count in row.values()), f"{sum(row.values()):,}"] for name, row in table.items()
        ]
        if rows:
            titled.append((_TITLES[key], heads, rows))
    heads = ["sequence", "frames", "weather", "road", "time", "boxes"]
    keys = ("sequence", "frames", "weather", "road", "time", "objects")
    rows = [
        [dataset_plots.spoken(f"{value:,}" if isinstance(value, int) else value) for value in map(row.get, keys)]
        for row in census["table_5"]
    ]
    return [*titled, ("Sequences", heads, rows)]


def render_statistics(dataset: DatasetFigures, drawn: list[PageImage]) -> str:
    """Return the page as HTML."""
    side = dataset.sensors
    lines: list[ComparisonLine] = [] if side is None else [line for line in table_lines([side]) if line.topic != "data"]
    return render_template(
        "statistics.html",
        found=dataset,
        census=dataset.census,
        pictures=drawn,
        tables=tables(dataset.census),
        sensor_pictures=[] if side is None else sensor_pictures([side]),
        sensor_lines=lines,
        simulated=side is not None and side.simulated,
    )


def write_statistics(folder: Path | str, dataset: DatasetFigures) -> Path:
    """Write ``statistics.html``, ``statistics.json`` and ``figures/*.png`` into a folder, each all or nothing.

    Args:
        folder: Made if absent.
        dataset: What was counted.

    Returns:
        The page.
    """
    folder = Path(folder)
    with held(folder):
        (folder / "figures").mkdir(parents=True, exist_ok=True)
        drawn = []
        for name, figure, heading, caption in figures(dataset):
            write_bytes(folder / "figures" / f"{name}.png", figure_bytes(figure, "png"))
            drawn.append(PageImage(figure_uri(figure), f"{heading} of {dataset.name}", caption, heading))
        tree = {"name": dataset.name, "format": dataset.format, "path": dataset.path, "notes": list(dataset.notes)}
        content = {**tree, "annotations": dataset.census, "sensors": dataset.sensors and dataset.sensors.summary}
        content |= {"placement": None if dataset.placed is None else dataset.placed.to_json()}
        write_text(folder / "statistics.json", json.dumps(content, indent=1, allow_nan=False) + "\n")
        write_text(folder / "statistics.html", render_statistics(dataset, drawn))
    return folder / "statistics.html"

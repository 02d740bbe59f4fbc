"""One data set's figures on one self-contained page: its annotations over every frame, its sensors over some."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from farfield.figures import statistics_plots
from farfield.figures.placement_plot import placement_figure
from farfield.figures.style import figure_bytes, figure_uri
from farfield.files.atomic import write_bytes, write_text
from farfield.inspection.placement import RigPlacement
from farfield.inspection.side import ComparedDataset
from farfield.pages.comparison import ComparisonLine, table_lines
from farfield.pages.comparison import sensor_pictures_of as sensor_pictures
from farfield.pages.template import PageImage, render_template

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
        sensors: Clouds, boxes and radar of some frames, as :mod:`farfield.pages.comparison` takes them; None where
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


def figures(found: DatasetFigures) -> "Iterator[tuple[str, Figure, str, str]]":
    """The census' figures: file name, figure, heading and caption."""
    summary, arrays = found.census, found.arrays
    drawn = (
        (
            "frames_by_condition",
            statistics_plots.frames_by_condition(summary),
            "Frames by weather, road and time",
            "How many frames were recorded in each condition; K-Radar tells them for whole sequences.",
        ),
        (
            "sequences",
            statistics_plots.sequences(summary),
            "Sequences",
            "Frames of each sequence in the colour of its weather.",
        ),
        (
            "classes",
            statistics_plots.classes(summary),
            "Classes",
            "Boxes of each class as the data set names it, and how much of them the sensors see.",
        ),
        (
            "class_tables",
            statistics_plots.matrix(summary),
            "Classes by weather and range",
            "Number of boxes; darker is more, on a logarithmic scale. A dash is none.",
        ),
        (
            "ranges",
            statistics_plots.ranges(summary, arrays),
            "Range",
            "Ground distance of each box's centre from the sensor in whose frame the boxes are.",
        ),
        (
            "visibility_by_weather",
            statistics_plots.visibility_by_weather(summary),
            "Visibility by weather",
            "Shares of boxes, and how many boxes a frame has.",
        ),
        (
            "per_frame",
            statistics_plots.per_frame(arrays),
            "Objects in a frame",
            "Frames without annotation are left out.",
        ),
        ("sensor_placement", placement_figure(found.placed), "Sensor placement", _placed_caption(found.placed)),
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
    found = [("Classes", ["class", "in Farfield", "boxes", "tracks", "mean length × width × height (m)"], classes)]
    for key, table in census["objects_by"].items():
        heads = ["class", *(statistics_plots.spoken(name) for name in next(iter(table.values()), {})), "all"]
        rows = [
            [name, *(f"{count:,}" for count in row.values()), f"{sum(row.values()):,}"] for name, row in table.items()
        ]
        if rows:
            found.append((_TITLES[key], heads, rows))
    heads = ["sequence", "frames", "weather", "road", "time", "boxes"]
    keys = ("sequence", "frames", "weather", "road", "time", "objects")
    rows = [[statistics_plots.spoken(_count_text(row[key])) for key in keys] for row in census["table_5"]]
    return [*found, ("Sequences", heads, rows)]


def _count_text(value: str | int) -> str:
    return f"{value:,}" if isinstance(value, int) else value


def render_statistics(found: DatasetFigures, drawn: list[PageImage]) -> str:
    """Return the page as HTML."""
    side = found.sensors
    lines: list[ComparisonLine] = [] if side is None else [line for line in table_lines([side]) if line.topic != "data"]
    return render_template(
        "statistics.html",
        found=found,
        census=found.census,
        pictures=drawn,
        tables=tables(found.census),
        sensor_pictures=[] if side is None else sensor_pictures([side]),
        sensor_lines=lines,
        simulated=side is not None and side.simulated,
    )


def write_statistics(folder: Path | str, found: DatasetFigures) -> Path:
    """Write ``statistics.html``, ``statistics.json`` and ``figures/*.png`` into a folder, each all or nothing.

    Args:
        folder: Made if absent.
        found: What was counted.

    Returns:
        The page.
    """
    folder = Path(folder)
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    drawn = []
    for name, figure, heading, caption in figures(found):
        write_bytes(folder / "figures" / f"{name}.png", figure_bytes(figure, "png"))
        drawn.append(PageImage(figure_uri(figure), f"{heading} of {found.name}", caption, heading))
    tree = {"name": found.name, "format": found.format, "path": found.path, "notes": list(found.notes)}
    content = {**tree, "annotations": found.census, "sensors": found.sensors and found.sensors.summary}
    content |= {"placement": None if found.placed is None else found.placed.to_json()}
    write_text(folder / "statistics.json", json.dumps(content, indent=1, allow_nan=False) + "\n")
    write_text(folder / "statistics.html", render_statistics(found, drawn))
    return folder / "statistics.html"

"""The frames and objects on which an evaluation lost most: tables, and a gallery of crops where data are at hand."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from farfield.datasets.base import Dataset
from farfield.errors import ConfigError
from farfield.evaluation.lost import KINDS, Lost
from farfield.figures.lost_gallery import lost_gallery
from farfield.figures.style import figure_uri
from farfield.files.atomic import write_text
from farfield.frame import Frame
from farfield.pages.template import PageImage, render_template
from farfield.vocabulary.counts import count_of
from farfield.vocabulary.studio import studio_link

Table = tuple[str, tuple[str, ...], list[tuple[str, tuple[str, ...]]]]
_PICTURED = 12


def frame_table(lost: Lost, top: int) -> Table:
    """The frames that lost most: a title, the heads, and rows with a link into the studio each."""
    rows: list[tuple[str, tuple[str, ...]]] = [
        (
            studio_link(row["sequence"], row["frame"]),
            (
                f"{row['sequence']}/{row['frame']}",
                f"{row['loss']:.2f}",
                str(row.get("missed", "")),
                str(row.get("false", "")),
                " ".join(str(row[name]) for name in ("weather", "road", "time") if name in row),
            ),
        )
        for row in lost.frames[:top]
    ]
    return "Worst frames", ("frame", "loss", "missed", "false", "conditions"), rows


def object_table(lost: Lost, top: int) -> Table:
    """The objects that lost most, likewise."""
    rows: list[tuple[str, tuple[str, ...]]] = [
        (
            studio_link(row["sequence"], row["frame"]),
            (
                f"{row['sequence']}/{row['frame']}",
                f"{row['kind']} {row['label']}",
                f"{row['loss']:.2f}",
                _number(row, "range_m", ".0f"),
                _number(row, "points", ".0f"),
                _number(row, "x_m", ".1f"),
                _number(row, "y_m", ".1f"),
            ),
        )
        for row in lost.objects[:top]
    ]
    return "Worst objects", ("frame", "what", "loss", "range m", "points", "x m", "y m"), rows


def sum_table(lost: Lost, kind: str) -> Table:
    """Losses summed by a property, likewise; see :meth:`Lost.by`."""
    rows: list[tuple[str, tuple[str, ...]]] = [
        ("", (row["value"], f"{row['loss']:.1f}", str(row["missed"]), str(row["false"]), str(row["unsure"])))
        for row in lost.by(kind)
    ]
    return f"By {kind}", (kind, "loss", *KINDS), rows


def gallery(lost: Lost, data: Dataset, kind: str) -> PageImage | None:
    """Crops of the objects of a kind that lost most; None where there are none.

    Args:
        lost: What was lost.
        data: The data that were evaluated, in the coordinates in which they were.
        kind: ``"missed"`` or ``"false"``.

    Raises:
        ConfigError: If the data do not hold a frame of the evaluation.
    """
    objects = [row for row in lost.objects if row["kind"] == kind and "x_m" in row][:_PICTURED]
    if not objects:
        return None
    index = {key: number for number, key in enumerate(data.keys)}
    keys = {(row["sequence"], row["frame"]) for row in objects}
    strangers = sorted(keys - set(index))
    if strangers:
        raise ConfigError(f"{data.root}: expected the data that were evaluated, found no frame {strangers[0]}")
    frames: Mapping[tuple[str, str], Frame] = {key: data[index[key]] for key in keys}
    uri = figure_uri(lost_gallery(frames, objects, lost.cloud), "png", dpi=80)
    caption = "Each from above (ahead is to the right), from the side, and in the camera where one sees it."
    return PageImage(uri, f"{kind} objects of {lost.cloud}", caption, f"{kind.capitalize()}, {lost.cloud}")


def write_worst(
    path: Path, parts: Sequence[Lost], *, title: str, top: int, by: Sequence[str], data: Dataset | None = None
) -> Path:
    """Write the page, all or nothing.

    Args:
        path: The HTML file.
        parts: What was lost, cloud by cloud.
        title: Its title.
        top: Rows of each table at most.
        by: Properties by which losses are summed.
        data: The data, of which the crops are drawn; None draws none.

    Returns:
        The path.
    """
    tables: list[Any] = []
    pictures: list[PageImage] = []
    for lost in parts:
        own = [frame_table(lost, top), object_table(lost, top), *(sum_table(lost, kind) for kind in by)]
        tables += [(f"{name}, {lost.cloud}", heads, rows) for name, heads, rows in own]
        for kind in () if data is None else ("missed", "false"):
            picture = gallery(lost, data, kind) if data is not None else None
            pictures += [] if picture is None else [picture]
    first = parts[0] if parts else None
    page = render_template(
        "worst.html",
        title=title,
        headline="; ".join(headline(lost) for lost in parts),
        scope="" if first is None else f"found: {first.finding}",
        pictures=pictures,
        tables=tables,
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, page)
    return path


def headline(lost: Lost) -> str:
    """What was lost, in a sentence."""
    missed = sum(row["kind"] == "missed" for row in lost.objects)
    false = sum(row["kind"] == "false" for row in lost.objects)
    among = f" among the {len(lost.objects):,} that lost most" if lost.objects_in_all > len(lost.objects) else ""
    return (
        f"{lost.cloud}: {count_of(missed, 'missed object', spec=',')} and "
        f"{count_of(false, 'false box', 'false boxes', spec=',')}{among} in {count_of(len(lost.frames), 'frame')}"
        f"{_of_classes(lost)}"
    )


def _of_classes(lost: Lost) -> str:
    """Which classes count, where others are annotated too."""
    if not lost.other_classes:
        return ""
    others = ", ".join(f"{name} ({count})" for name, count in lost.other_classes.items())
    return f", of {' and '.join(lost.classes)} alone; also annotated: {others} (farfield evaluate --label CLASS)"


def _number(row: Mapping[str, Any], name: str, spec: str) -> str:
    return format(row[name], spec) if name in row else "-"

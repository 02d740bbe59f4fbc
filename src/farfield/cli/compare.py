"""``farfield compare``: the statistics of two data sets side by side, such as simulated and real."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from tyro.conf import Positional

from farfield.cli._flags import ALL_CORES, AS_THEY_ARE, Jobs, PointTimes, Reading, ReadingFlags, parse_pairs
from farfield.cli._output import check_outputs, console, write_json
from farfield.files.json_text import read_json

if TYPE_CHECKING:
    from farfield.inspection.comparison import ComparedDataset
    from farfield.pages.dataset_pages import ComparisonLine

_UNASKED = " (--clouds A:B sets others side by side)"


def run(
    a: Positional[Path],
    b: Positional[Path],
    *,
    frames: int = 200,
    names: str = "",
    vehicle_labels: str = "vehicle",
    focus_deg: float = -2.0,
    clouds: Annotated[str, tyro.conf.arg(aliases=["--cloud"])] = "",
    jobs: Jobs = ALL_CORES,
    reading: Reading = AS_THEY_ARE,
    mapping_a: Path | None = None,
    mapping_b: Path | None = None,
    columns_a: str | None = None,
    columns_b: str | None = None,
    intensity_scale_a: float | None = None,
    intensity_scale_b: float | None = None,
    point_times_a: PointTimes = "auto",
    point_times_b: PointTimes = "auto",
    floor: Path | None = None,
    out: Path | None = None,
    json: Path | None = None,
) -> int:
    """Set the statistics of two data sets side by side: elevation, points in boxes, ranges, sizes, weather, radar.

    examples:
      farfield compare data/sim Cirrus_dataset1
      farfield compare data/sim Cirrus_dataset1 --frames 0 --names simulator,Cirrus --out runs/compare
      farfield compare data/kradar K-Radar --frames 500
      farfield compare data/sim data/kitti --clouds gaussian:lidar
      farfield compare data/sim data/kitti --floor data/view_of_delft

    Measures how close a simulated roadside is to a real one: thickness, scatter, clutter, and how well a classifier of
    small patches separates the two on held-out sequences (held-out sweeps, where one has a single sequence), with the
    features that separate them. Two real data sets can be separated to some degree as well: --floor names a second real
    set to measure that. What one of them lacks is named and left out. Writes comparison.html, one self-contained page,
    and comparison.json.

    Args:
        a: One data set; its format is recognised.
        b: The other.
        frames: Frames to read of each, spread evenly; 0 reads all.
        names: Names of both, and then of the floor, separated by commas (default: their folders' names).
        vehicle_labels: Classes that count as vehicles, separated by commas.
        focus_deg: Elevation about which shares of returns are also counted.
        clouds: Which cloud of A to compare with which of B, as A:B, comma-separated, such as gaussian:lidar (default:
            clouds of the same name, else the first of each).
        jobs: Who does the work.
        reading: How the files of all are read; what one reader does not know counts for the others.
        mapping_a: Mapping YAML of a alone, of its classes or its layout.
        mapping_b: The same of b.
        columns_a: Columns per point in .bin files of a, or their names (default: detected).
        columns_b: The same of b.
        intensity_scale_a: Value of full reflectance in all clouds of a (default: detected: 1, 255 or 65535).
        intensity_scale_b: The same of b.
        point_times_a: Unit of the points' times of a; auto decides by the sweeps' period, none leaves the column as it
            is.
        point_times_b: The same of b.
        floor: Another real data set: how well b is told apart from it stands beside how well from a.
        out: Folder to write into (default: runs/compare-A-B).
        json: Write what is in comparison.json into this file too; - prints it.
    """
    from farfield.errors import ConfigError
    from farfield.inspection.comparison import count_dataset, pair_clouds, told_apart
    from farfield.pages.dataset_pages import table_lines, write_comparison

    if frames < 0:
        raise ConfigError(f"--frames: expected 0 (all) or more, got {frames}")
    labels = tuple(word.strip() for word in vehicle_labels.split(",") if word.strip())
    if not labels:
        raise ConfigError(f"--vehicle-labels: expected at least one class, got {vehicle_labels!r}")
    paths = (a, b) if floor is None else (a, b, floor)
    called = _names(names, paths)
    reading_a = ReadingFlags(
        mapping=mapping_a, columns=columns_a, intensity_scale=intensity_scale_a, point_times=point_times_a
    )
    reading_b = ReadingFlags(
        mapping=mapping_b, columns=columns_b, intensity_scale=intensity_scale_b, point_times=point_times_b
    )
    folder = out or Path("runs") / f"compare-{'-'.join(called[:2])}".replace(" ", "_")
    sources = (a, b, floor, *reading.paths, mapping_a, mapping_b)
    check_outputs(sources, files={"--json": json}, folders={"--out": folder})
    opened = reading.open_both(paths, (reading_a, reading_b, ReadingFlags())[: len(paths)])
    sides: Sequence[ComparedDataset] = [
        count_dataset(data, name, frames, jobs.options(name), vehicle_labels=labels, focus_deg=focus_deg)
        for data, name in zip(opened[:2], called[:2], strict=True)
    ]
    sides, pairs = pair_clouds(sides, parse_pairs(clouds, "--clouds") if clouds else None)
    third = None
    if floor is not None:
        third = count_dataset(opened[2], called[2], frames, jobs.options(called[2]))
    roadsides = told_apart(sides, third)
    page = write_comparison(folder, sides, title=f"{called[0]} and {called[1]}", roadsides=roadsides)
    _print(table_lines(sides, roadsides), sides)
    if pairs:
        print(f"clouds side by side: {', '.join(f'{a} : {b}' for a, b in pairs)}{'' if clouds else _UNASKED}")
    for side in sides:
        print("".join(f"note: {side.title}: {text}\n" for text in side.summary["missing"]), end="")
    if json is not None:
        write_json(json, read_json(folder / "comparison.json"))
    print(f"written: {folder / 'comparison.json'}\nreport: {page.resolve()}")
    return 0


def _names(names: str, paths: Sequence[Path]) -> tuple[str, ...]:
    from farfield.errors import ConfigError
    from farfield.files.atomic import readable

    titles = (
        tuple(word.strip() for word in names.split(","))
        if names
        else tuple(readable(path.resolve().name) for path in paths)
    )
    if len(titles) != len(paths) or not all(titles):
        expected = "two names separated by a comma" if len(paths) == 2 else "three names separated by commas"
        raise ConfigError(f"--names: expected {expected}, got {names!r}")
    if len(set(titles)) < len(titles):
        titles = tuple(
            f"{readable(path.resolve().parent.name)}/{name}" for path, name in zip(paths, titles, strict=True)
        )
    if len(set(titles)) < len(titles):
        titles = tuple(f"{letter}: {name}" for letter, name in zip("ABC", titles, strict=False))
    return titles


def _print(lines: "Sequence[ComparisonLine]", sides: "Sequence[ComparedDataset]") -> None:
    from rich.table import Table
    from rich.text import Text

    table = Table(title=f"{sides[0].title} and {sides[1].title}", title_justify="left")
    table.add_column("topic", no_wrap=True)
    table.add_column("what", overflow="fold")
    for side in sides:
        table.add_column(Text(side.title), justify="right", overflow="fold")
    table.add_column("published", justify="right", style="dim")
    topic = ""
    for line in lines:
        if line.topic != topic and topic:
            table.add_section()
        shown = Text("" if line.topic == topic else line.topic)
        table.add_row(shown, Text(line.what), *(Text(value) for value in line.values), line.published)
        topic = line.topic
    console(width=160).print(table)

"""``farfield stats``: the figures and tables of one data set."""

from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from farfield.cli._flags import ALL_CORES, AS_THEY_ARE, JobFlags, Jobs, Reading
from farfield.cli._output import check_outputs, console, write_json
from farfield.files.json_text import read_json
from farfield.vocabulary.counts import count_of

if TYPE_CHECKING:
    from farfield.datasets import Dataset
    from farfield.pages.dataset_pages import DatasetFigures


def run(
    path: Positional[Path],
    /,
    *,
    out: Path | None = None,
    name: str = "",
    sweeps: int = 20,
    where: str = "",
    jobs: Jobs = ALL_CORES,
    format: str | None = None,
    reading: Reading = AS_THEY_ARE,
    json: Path | None = None,
) -> int:
    """Count a data set: frames by weather, road and time, boxes by class, weather, range and visibility, sensors.

    examples:
      farfield stats Cirrus_dataset1
      farfield stats K-Radar --labels v2.1 --out runs/kradar
      farfield stats K-Radar --where 'weather == "sleet" and range_m > 50'
      farfield stats KRadar_revised_visibility
      farfield stats dir_1to20 --roots dir_2to5 dir_21to37 dir_38to58

    Writes statistics.html, one self-contained page, statistics.json and figures/*.png.

    Args:
        path: Folder of the data set; its format is recognised. Annotations alone are enough.
        out: Folder to write into (default: runs/stats-NAME).
        name: What to call the data set (default: its folder's name).
        sweeps: Number of frames whose clouds and radar are read, spread evenly; 0 reads annotations alone.
        where: Only frames and objects that fulfil a condition, such as 'range_m > 100 and weather == "sleet"'; columns
            as of farfield evaluate, points only where the labels count them.
        jobs: Who does the work.
        format: Format, if it is not to be recognised.
        reading: How the files are read.
        json: Write what is in statistics.json into this file too; - prints it.
    """
    from farfield.datasets.maps.where import fulfilling
    from farfield.errors import ConfigError
    from farfield.files.atomic import readable
    from farfield.frame.where import Where
    from farfield.pages.dataset_pages import write_statistics

    if sweeps < 0:
        raise ConfigError(f"--sweeps: expected 0 (annotations alone) or more, got {sweeps}")
    called = name or readable(path.resolve().name)
    folder = out or Path("runs") / f"stats-{called}".replace(" ", "_")
    check_outputs((path, *reading.paths), files={"--json": json}, folders={"--out": folder})
    if where:
        Where(where)  # says what is wrong with it before anything is read
    dataset = fulfilling(reading.open(path, format=format), where)
    called += f" where {where}" if where else ""
    figures = _count(dataset, called, path, sweeps, jobs)
    page = write_statistics(folder, figures)
    _print(figures)
    if json is not None:
        write_json(json, read_json(folder / "statistics.json"))
    print(f"written: {folder / 'statistics.json'}, {folder / 'figures'}\nreport: {page.resolve()}")
    return 0


def _count(dataset: "Dataset", called: str, path: Path, sweeps: int, jobs: JobFlags) -> "DatasetFigures":
    from farfield.inspection.comparison import count_dataset, has_sensors
    from farfield.inspection.placement import placement
    from farfield.inspection.statistics.census import dataset_notes, take_census
    from farfield.pages.dataset_pages import DatasetFigures

    census = take_census(dataset, jobs.options("annotations"))
    sensors = None
    if sweeps and has_sensors(dataset):
        sensors = count_dataset(dataset, called, sweeps, jobs.options(called))
    return DatasetFigures(
        name=called,
        format=dataset.name,
        path=str(path),
        census=census.summary(),
        arrays={"name": census.name, "range_m": census.range_m, "objects": census.objects},
        sensors=sensors,
        notes=dataset_notes(dataset),
        placed=placement(dataset),
    )


def _print(figures: "DatasetFigures") -> None:
    from rich.table import Table
    from rich.text import Text

    from farfield.pages.dataset_pages import tables

    census, out = figures.census, console(width=160)
    annotated = f"{census['annotated_frames']:,} annotated, {census['empty_frames']:,} of them empty"
    out.print(
        f"{figures.format}: {count_of(census['frames'], 'frame', spec=',')} of "
        f"{count_of(census['sequences'], 'sequence')}, {annotated}"
    )
    for kind, counts in census["frames_by"].items():
        out.print(f"{kind}: " + ", ".join(f"{name} {count:,}" for name, count in counts.items()))
    for title, heads, rows in tables(census):
        if title == "Sequences" and len(rows) > 1:
            continue  # on the page
        table = Table(title=title, title_justify="left")
        for column, head in enumerate(heads):
            table.add_column(head, justify="right" if column else "left", overflow="fold")
        for row in rows:
            table.add_row(*map(Text, row))
        out.print(table)
    for text in figures.notes:
        out.print(f"note: {text}")
    for text in census["damaged"][:10]:
        out.print(f"damaged: {text}")

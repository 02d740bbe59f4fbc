"""``farfield doctor``: say what a data set holds, what is missing and how to mend it."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro

from farfield.cli._progress import hands
from farfield.cli._words import OUTPUT, write_json

if TYPE_CHECKING:
    from farfield.inspection.doctor import DoctorReport

_COLOURS = {"ok": "green", "warn": "yellow", "fail": "bold red"}


def run(
    path: tyro.conf.Positional[Path],
    /,
    *,
    mapping: Path | None = None,
    format: str | None = None,
    labels: str | None = None,
    roots: tuple[Path, ...] = (),
    columns: int | None = None,
    frames: int = 20,
    calibration: int = 0,
    workers: int = 0,
    engine: str = "local",
    json: Path | None = None,
) -> int:
    """Say what a data set holds, what is missing and how to mend it.

    examples:
      farfield doctor Cirrus_dataset1
      farfield doctor Cirrus_dataset1 --mapping mapping.yaml
      farfield doctor data/kitti --frames 0 --json report.json
      farfield doctor K-Radar --calibration 80
      farfield doctor dir_1to20 --roots dir_2to5 dir_21to37 dir_38to58 --labels v2.1

    Exit status 1 when training would fail or score zero.

    Args:
        path: Folder of the data set; its format is recognised.
        mapping: Mapping file of a Cirrus copy that deviates from the documented layout, or of an own folder's classes.
        format: Format, if it is not to be recognised: cirrus, kitti, view_of_delft, kitti_tracking, argoverse2, kradar,
            radiate or folder.
        labels: Version of K-Radar's annotations, such as v2.0; the newest that each sequence has unless given.
        roots: Further folders of a K-Radar that is spread over several disks.
        columns: Columns of .bin files; what the numbers themselves show unless given.
        frames: Number of frames whose clouds are read, spread evenly; 0 reads all.
        calibration: Number of frames with which to check cameras and K-Radar's radar: whether the given calibration
            fits, and whether a sensor moved during the first drive; 0 does not. Cameras need about 24, a radar 80.
        workers: Processes; 0 takes as many as there are cores, frames and memory for.
        engine: Where the frames are read.
        json: Also write the report as JSON into this file; - prints it instead of the table.
    """
    from farfield.datasets import open_dataset
    from farfield.inspection.doctor import examine

    given: dict[str, Any] = {"mapping": mapping, "labels": labels, "roots": roots, "bin_columns": columns}
    dataset = open_dataset(path, format=format, **{name: value for name, value in given.items() if value})
    report = examine(dataset, max_clouds=frames, calibration=calibration, bulk=hands(workers, engine, "reading"))
    if json is not None:
        write_json(json, report.to_json())
    if json != OUTPUT:
        _print(report)
    return int(report.failed)


def _print(report: "DoctorReport") -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(title=f"{report.path} ({report.format})", title_justify="left")
    for name in ("", "topic", "found", "how to mend"):
        table.add_column(name, overflow="fold")
    for finding in report.present:
        severity = Text(finding.severity, style=_COLOURS[finding.severity])
        what = f"{finding.what} [{finding.where}]" if finding.where else finding.what
        table.add_row(severity, Text(finding.topic), Text(what), Text(finding.mend))
    console = Console(width=None if sys.stdout.isatty() else 160)
    console.print(table)
    if report.absent:
        console.print(f"not there: {', '.join(report.absent)}", highlight=False)
    from farfield.inspection.doctor.survey import counted

    failures = sum(finding.severity == "fail" for finding in report.findings)
    console.print(
        f"{counted(failures, 'finding')} would make training fail or score zero." if failures else "Ready for training."
    )

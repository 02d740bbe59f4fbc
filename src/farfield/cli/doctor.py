"""``farfield doctor``: say what a data set holds, what is missing and how to fix it."""

from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from farfield.cli._flags import ALL_CORES, AS_THEY_ARE, Jobs, Reading
from farfield.cli._output import OUTPUT, check_outputs, console, write_json

if TYPE_CHECKING:
    from farfield.inspection.doctor import DoctorReport

_COLOURS = {"ok": "green", "warn": "yellow", "fail": "bold red"}


def run(
    path: tyro.conf.Positional[Path],
    /,
    *,
    reading: Reading = AS_THEY_ARE,
    format: str | None = None,
    frames: int = 20,
    calibration: int = 0,
    jobs: Jobs = ALL_CORES,
    json: Path | None = None,
) -> int:
    """Say what a data set holds, what is missing and how to fix it.

    examples:
      farfield doctor Cirrus_dataset1
      farfield doctor Cirrus_dataset1 --mapping mapping.yaml
      farfield doctor data/kitti --frames 0 --json report.json
      farfield doctor K-Radar --calibration 80
      farfield doctor dir_1to20 --roots dir_2to5 dir_21to37 dir_38to58 --labels v2.1

    Exit status 1 when training would fail or score zero.

    Args:
        path: Folder of the data set; its format is recognised.
        reading: How the files are read.
        format: Format, if it is not to be recognised: cirrus, kitti, view_of_delft, kitti_tracking, argoverse2, kradar,
            radiate or folder.
        frames: Number of frames whose clouds are read, spread evenly; 0 reads all.
        calibration: Number of frames with which to check cameras and K-Radar's radar: whether the given calibration
            fits, and whether a sensor moved during the first drive; 0 does not. Cameras need about 24, a radar 80.
        jobs: Who does the work.
        json: Also write the report as JSON into this file; - prints it instead of the table.
    """
    from farfield.inspection.doctor import examine

    check_outputs((path, *reading.paths), files={"--json": json})
    dataset = reading.open(path, format=format)
    report = examine(dataset, max_clouds=frames, calibration=calibration, bulk=jobs.options("reading"))
    if json is not None:
        write_json(json, report.to_json())
    if json != OUTPUT:
        _print(report)
    return int(report.failed)


def _print(report: "DoctorReport") -> None:
    from rich.table import Table
    from rich.text import Text

    table = Table(title=f"{report.path} ({report.format})", title_justify="left")
    for name in ("", "topic", "found", "how to fix"):
        table.add_column(name, overflow="fold")
    for finding in report.present:
        severity = Text(finding.severity, style=_COLOURS[finding.severity])
        what = f"{finding.what} [{finding.where}]" if finding.where else finding.what
        table.add_row(severity, Text(finding.topic), Text(what), Text(finding.fix))
    out = console(width=160)
    out.print(table)
    if report.absent:
        out.print(f"not there: {', '.join(report.absent)}")
    from farfield.vocabulary.counts import count_of

    failures = sum(finding.severity == "fail" for finding in report.findings)
    out.print(
        f"{count_of(failures, 'finding')} would make training fail or score zero."
        if failures
        else "Ready for training."
    )

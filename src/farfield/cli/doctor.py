"""``farfield doctor``: say what a data set holds, what is missing and how to mend it."""

import json as json_text
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

if TYPE_CHECKING:
    from farfield.datasets.doctor import Report

_COLOURS = {"ok": "green", "warn": "yellow", "fail": "bold red"}


def run(
    path: tyro.conf.Positional[Path],
    /,
    *,
    mapping: Path | None = None,
    format: str | None = None,
    clouds: int = 20,
    json: bool = False,
) -> int:
    """Say what a data set holds, what is missing and how to mend it.

    examples:
      farfield doctor Cirrus_dataset1
      farfield doctor Cirrus_dataset1 --mapping mapping.yaml
      farfield doctor data/kitti --clouds 0 --json > report.json

    Exit status 1 when training would fail or score zero.

    Args:
        path: Folder of the data set; its format is recognised.
        mapping: Mapping file of a Cirrus copy that deviates from the documented layout.
        format: Format, if it is not to be recognised: cirrus, kitti, kitti_tracking, argoverse2 or folder.
        clouds: Number of frames whose clouds are read, spread evenly; 0 reads all.
        json: Print the report as JSON instead of a table.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from farfield.datasets import open_dataset
    from farfield.datasets.doctor import examine

    dataset = open_dataset(path, format=format) if mapping is None else open_dataset(path, mapping=mapping)
    columns = (TextColumn("reading"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("reading", total=len(dataset))
        report = examine(dataset, max_clouds=clouds, progress=lambda done, _: bar.update(task, completed=done))
    if json:
        sys.stdout.write(json_text.dumps(report.to_json(), indent=1) + "\n")
    else:
        _print(report)
    return int(report.failed)


def _print(report: "Report") -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(title=f"{report.path} ({report.format})", title_justify="left")
    for name in ("", "topic", "found", "how to mend"):
        table.add_column(name, overflow="fold")
    for finding in report.findings:
        severity = Text(finding.severity, style=_COLOURS[finding.severity])
        what = f"{finding.what} [{finding.where}]" if finding.where else finding.what
        table.add_row(severity, Text(finding.topic), Text(what), Text(finding.mend))
    console = Console(width=None if sys.stdout.isatty() else 160)
    console.print(table)
    failures = sum(finding.severity == "fail" for finding in report.findings)
    console.print(f"{failures} findings would make training fail or score zero." if failures else "Ready for training.")

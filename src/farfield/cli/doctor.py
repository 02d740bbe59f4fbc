"""``farfield doctor``: say what a data set or a file holds, what is missing and how to fix it; bundles for helpers."""

from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from farfield.cli._flags import ALL_CORES, AS_THEY_ARE, Jobs, Reading
from farfield.cli._output import OUTPUT, check_outputs, console, write_json

if TYPE_CHECKING:
    from farfield.datasets import Dataset
    from farfield.inspection.doctor import DoctorReport
    from farfield.inspection.doctor.survey import Severity

_WEIGHTS = (".pt", ".pth", ".ckpt", ".safetensors")
_COLOURS = {"ok": "green", "open": "dim", "warn": "yellow", "fail": "bold red"}


def run(
    path: tyro.conf.Positional[Path],
    /,
    *,
    reading: Reading = AS_THEY_ARE,
    format: str | None = None,
    frames: int = 20,
    calibration: int = 0,
    jobs: Jobs = ALL_CORES,
    bundle: Path | None = None,
    mask: bool = False,
    json: Path | None = None,
) -> int:
    """Say what a data set or one file holds, what is missing and how to fix it.

    examples:
      farfield doctor Cirrus_dataset1
      farfield doctor Cirrus_dataset1 --mapping mapping.yaml
      farfield doctor data/kitti --frames 0 --json report.json
      farfield doctor K-Radar --calibration 80
      farfield doctor dir_1to20 --roots dir_2to5 dir_21to37 dir_38to58 --labels v2.1
      farfield doctor K-Radar --bundle kradar.json --mask
      farfield doctor kradar.json
      farfield doctor K-Radar/1/radar_tesseract/tesseract_00033.mat
      farfield doctor RTNH_wide_10.pt

    Exit status 1 when training would fail or score zero, or no reader takes the one file.

    Args:
        path: Folder of the data set, whose format is recognised; one file, to see what the readers make of it and which
            expectation fails; weights (.pt, .pth, .ckpt, .safetensors), to see whose they are and what import-weights
            would do with them; or a bundle, which is read back.
        reading: How the files are read.
        format: Format, if it is not to be recognised: a name that farfield formats lists, such as kitti or folder.
        frames: Number of frames whose clouds are read, spread evenly; 0 reads all.
        calibration: Number of frames with which to check cameras and K-Radar's radar: whether the given calibration
            fits, and whether a sensor moved during the first drive; 0 does not. Cameras need about 24, a radar 80.
        jobs: Who does the work.
        bundle: Also write a bundle into this file, for whoever helps from afar: listing, headers, shapes, ranges, names
            of classes and steps of stamps, without data and without paths of this machine, at most 1 MB of JSON. It is
            written where the data set cannot be opened too.
        mask: Mask the names of files and the stamps in the bundle.
        json: Also write the report as JSON into this file; - prints it instead of the table.
    """
    from farfield.errors import ConfigError, FarfieldError
    from farfield.inspection.doctor import examine

    check_outputs((path, *reading.paths), files={"--json": json, "--bundle": bundle})
    if mask and bundle is None:
        raise ConfigError("--mask: expected --bundle, whose names it masks")
    if path.is_file():
        if bundle is not None:
            raise ConfigError(f"--bundle: expected a data set's folder, got the file {path}")
        return _report(_of_file(path), json)
    unnamed = path.is_dir() and format is None and reading.mapping is None
    if unnamed and (downloads := _of_downloads(path, reading.roots)) is not None:
        if bundle is not None:
            _write_bundle(bundle, path, None, downloads, "", mask)
        return _report(downloads, json)
    dataset = None
    try:
        dataset = reading.open(path, format=format)
        report = examine(dataset, max_clouds=frames, calibration=calibration, bulk=jobs.options("reading"))
    except FarfieldError as error:
        if bundle is not None and path.is_dir():
            _write_bundle(bundle, path, dataset, None, str(error), mask)
        raise
    if bundle is not None:
        _write_bundle(bundle, path, dataset, report, "", mask)
    return _report(report, json)


def _of_file(path: Path) -> "DoctorReport":
    """What one file is, or what a bundle says."""
    from farfield.inspection.bundle import bundle_findings, is_bundle, read_bundle
    from farfield.inspection.doctor import DoctorReport
    from farfield.inspection.single_file import examine_file

    if path.suffix.lower() in _WEIGHTS:
        return _of_weights(path)
    if path.suffix.lower() != ".json" or not is_bundle(path):
        return examine_file(path)
    read = read_bundle(path)
    facts = read.model_dump(mode="json", include={"format", "masked", "facts", "groups", "left_out"})
    return DoctorReport(
        path=str(path),
        format=f"a bundle of {read.format or 'no data set that was recognised'}",
        findings=bundle_findings(read),
        facts=facts,
    )


def _of_weights(path: Path) -> "DoctorReport":
    """Whose network a file of weights is, and what would become of it."""
    import dataclasses

    from farfield.detectors import DETECTORS
    from farfield.errors import FarfieldError
    from farfield.files.sizes import sized
    from farfield.inspection.doctor import DoctorReport, Finding
    from farfield.vocabulary.counts import count_of

    _ = DETECTORS["rtnh"].network_class  # without torch, says how to install it
    from farfield.detectors.importing import NAMES, examine_checkpoint

    findings = [Finding(severity="ok", topic="file", what=sized(path.stat().st_size))]
    try:
        facts = examine_checkpoint(path)
    except FarfieldError as error:
        findings.append(Finding(severity="fail", topic="weights", what=str(error)))
        return DoctorReport(path=str(path), format="one file", findings=tuple(findings), facts={"read_as": []})
    parts = ", ".join(f"{name} {count}" for name, count in list(facts.parts.items())[:12])
    tensors = f"{count_of(facts.tensors, 'tensor')} with {count_of(facts.numbers, 'number', spec=',')} in all: {parts}"
    readable = f"Weights that are read: Farfield's, {', '.join(NAMES.values())}."
    settings = "--settings names another training's grid and anchors, --allow-unknown leaves keys out."
    fix = readable if facts.what == "unknown" else settings
    fate = f"{facts.fate}: {facts.fault}" if facts.fault else facts.fate
    worst: Severity = "fail" if facts.fault else "ok"
    findings += [
        Finding(severity="fail" if facts.what == "unknown" else "ok", topic="weights", what=facts.what),
        Finding(severity="ok", topic="tensors", what=tensors),
        Finding(severity=worst, topic="import", what=fate, fix=fix if facts.fault else ""),
        *(Finding(severity="ok", topic="note", what=note) for note in facts.notes),
    ]
    read_as = [] if facts.fault else [facts.what]
    report = dataclasses.asdict(facts) | {"read_as": read_as}
    return DoctorReport(path=str(path), format="one file", findings=tuple(findings), facts=report)


def _of_downloads(path: Path, further: tuple[Path, ...]) -> "DoctorReport | None":
    """What a folder's archives hold, where it holds no data set besides."""
    from farfield.datasets.recognition import recognise
    from farfield.inspection.downloads import examine_downloads

    return examine_downloads(path, further) if recognise(path) is None else None


def _write_bundle(
    target: Path, path: Path, dataset: "Dataset | None", report: "DoctorReport | None", error: str, mask: bool
) -> None:
    import sys

    from farfield.files.sizes import sized
    from farfield.inspection.bundle import make_bundle, write_bundle
    from farfield.jobs.folders import held

    with held(target, file=True):
        size = write_bundle(target, make_bundle(path, dataset, report, error=error, masked=mask))
    words = "names are masked" if mask else "it names files, folders and classes: --mask hides them"
    print(f"{target}: a bundle of {sized(size)}; {words}. Read it before you send it.", file=sys.stderr)


def _report(report: "DoctorReport", json: Path | None) -> int:
    """Print and write a report; the exit status."""
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
    if report.format == "one file":
        takers = report.facts["read_as"]
        out.print(f"Taken as {', '.join(takers)}." if takers else "No reader takes this file.")
        return
    if report.format == "downloads":
        words = "cannot be used" if failures else "All archives can be used"
        out.print(f"{count_of(failures, 'archive')} {words}." if failures else f"{words}.")
        return
    if report.format.startswith("a bundle"):
        out.print(f"{count_of(len(report.findings), 'finding')}, of which {count_of(failures, 'is', 'are')} grave.")
        return
    out.print(
        f"{count_of(failures, 'finding')} would make training fail or score zero."
        if failures
        else "Ready for training."
    )

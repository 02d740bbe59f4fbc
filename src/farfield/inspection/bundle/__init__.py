"""A bundle: what a data set is like, in one file without its data, for whoever helps from afar; and what it shows."""

import json
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from farfield.datasets.base import Dataset
from farfield.errors import ConfigError, FarfieldError
from farfield.files.atomic import write_text
from farfield.inspection.bundle.listing import LOOKED_AT, files_by_folder, group_of, pairs_of
from farfield.inspection.bundle.masking import Scrubber
from farfield.inspection.bundle.record import (
    BUNDLE_VERSION,
    MAX_BUNDLE_BYTES,
    Bundle,
    BundleFinding,
    FileGroup,
    is_bundle,
    read_bundle,
)
from farfield.inspection.doctor.survey import DoctorReport, Finding
from farfield.vocabulary.counts import count_of

__all__ = ["MAX_BUNDLE_BYTES", "Bundle", "bundle_findings", "is_bundle", "make_bundle", "read_bundle", "write_bundle"]

_READ_ME = (
    "What a data set is like, written by farfield doctor DATA --bundle: a listing, headers, shapes, ranges, names of "
    "classes, steps between stamps. No point, pixel, box or position of the data is in it, and no path of the machine.",
    "Names of files, folders and classes are in it, unless it was written with --mask, and so may be a few words of a "
    "text that a reader refused. Read it before you send it. farfield doctor FILE shows what it says.",
)
_MOST_GROUPS = 600
_SHARED_FORMS = (
    "numbers by key",
    "points",
    "arrDREA",
    "arr_zyx",
    "float",
    "int",
    "uint",
)  # which all files should have
_NUMBERS = re.compile(r"\d+")
_RARE, _SERIES = 0.34, 4
"""Share of files at most that are odd ones, and how many files make a series: of fewer all are kinds of their own."""


def make_bundle(
    root: Path, dataset: Dataset | None, report: DoctorReport | None, *, error: str = "", masked: bool = False
) -> Bundle:
    """Describe a data set without its data.

    Args:
        root: Its folder.
        dataset: The data set; None where it could not be opened.
        report: What the doctor says of it; None where it could not be examined.
        error: Why not.
        masked: Mask names of files and stamps.
    """
    from farfield import __version__

    files, whole = files_by_folder(root)
    names = [part for (folder, _), paths in files.items() for part in (*folder.split("/"), *(p.name for p in paths))]
    if dataset is not None:
        names += [*dataset.sequences, *dataset.frame_ids]
    scrub = Scrubber(root, names, masked=masked)
    left_out = [] if whole else [f"files beyond the first {sum(map(len, files.values()))}"]
    groups = []
    for row, ((folder, suffix), paths) in enumerate(files.items()):
        if row == _MOST_GROUPS:
            left_out.append(count_of(len(files) - row, "folder"))
            break
        groups.append(_scrubbed(group_of(folder, suffix, paths, look_at=LOOKED_AT), scrub))
    tree: dict[str, Any] = {} if report is None else report.to_json()
    findings = [
        BundleFinding(
            severity=finding.severity,
            topic=scrub.text(finding.topic),
            what=scrub.text(finding.what)[:2000],
            where=scrub.text(finding.where)[:300],
            fix=scrub.text(finding.fix)[:600],
        )
        for finding in (() if report is None else report.present)
    ]
    pairs = [
        pair.model_copy(
            update={
                "one": scrub.name(pair.one),
                "other": scrub.name(pair.other),
                "examples": tuple(scrub.name(name) for name in pair.examples),
            }
        )
        for pair in pairs_of(files)
    ]
    remarks: list[str] = []
    with suppress(FarfieldError):
        remarks = [] if dataset is None else [scrub.text(f"{kind}: {text}") for kind, text in dataset.remarks]
    return Bundle(
        farfield_bundle=BUNDLE_VERSION,
        read_me=_READ_ME,
        farfield=__version__,
        format="" if dataset is None else dataset.name,
        masked=masked,
        error=scrub.text(error)[:4000],
        remarks=tuple(remarks[:50]),
        findings=tuple(findings),
        facts=_plain(scrub.tree(tree.get("facts", {}))),
        groups=tuple(groups),
        pairs=tuple(pairs),
        left_out=tuple(left_out),
    )


def _plain(facts: Mapping[str, Any]) -> dict[str, Any]:
    """Figures as JSON takes them; lists of more than a few entries as their length."""
    tree: dict[str, Any] = json.loads(json.dumps(facts, default=str).replace("NaN", "null").replace("Infinity", "null"))
    return {name: _short(value) for name, value in tree.items()}


def _short(value: Any) -> Any:
    if isinstance(value, dict):
        entries = {name: _short(part) for name, part in list(value.items())[:200]}
        return entries | ({"...": f"{len(value) - 200} more"} if len(value) > 200 else {})
    if isinstance(value, list):
        return [_short(part) for part in value] if len(value) <= 20 else count_of(len(value), "entry", "entries")
    return value


def _scrubbed(group: FileGroup, scrub: Scrubber) -> FileGroup:
    forms = [
        form.model_copy(update={"examples": tuple(scrub.name(name) for name in form.examples)}) for form in group.forms
    ]
    faults = [
        fault.model_copy(update={"file": scrub.name(fault.file), "fault": scrub.text(fault.fault)})
        for fault in group.faults
    ]
    return group.model_copy(
        update={
            "folder": scrub.name(group.folder),
            "first": scrub.name(group.first),
            "last": scrub.name(group.last),
            "forms": tuple(form.model_copy(update={"form": scrub.text(form.form)}) for form in forms),
            "faults": tuple(faults),
            "odd_sizes": tuple(scrub.name(name) for name in group.odd_sizes),
        }
    )


def write_bundle(path: Path, bundle: Bundle) -> int:
    """Write a bundle, of at most :data:`MAX_BUNDLE_BYTES`; what makes it larger is left out, and said.

    Args:
        path: The file.
        bundle: The bundle.

    Returns:
        Its size in bytes.

    Raises:
        ConfigError: If not even the listing fits.
    """
    for share in (1.0, 0.5, 0.25, 0.1, 0.02):
        count = max(int(len(bundle.groups) * share), 10)
        smaller = bundle
        if share < 1:
            lost = len(bundle.groups) - len(bundle.groups[:count])
            note = f"{count_of(lost, 'folder')} and the doctor's figures, for the file's size"
            smaller = bundle.model_copy(
                update={"groups": bundle.groups[:count], "facts": {}, "left_out": (*bundle.left_out, note)}
            )
        text = smaller.model_dump_json(indent=1, exclude_defaults=True) + "\n"
        if len(text.encode()) <= MAX_BUNDLE_BYTES:
            write_text(path, text)
            return len(text.encode())
    raise ConfigError(
        f"{path}: expected a bundle of at most {MAX_BUNDLE_BYTES} bytes, got more: name a part of the set"
    )


def bundle_findings(bundle: Bundle) -> tuple[Finding, ...]:
    """What a bundle shows to be wrong, from its record alone: the doctor's findings, and faults of the listing.

    Args:
        bundle: The bundle.
    """
    return (*_of_the_doctor(bundle), *_of_files(bundle), *_of_pairs(bundle))


def _of_the_doctor(bundle: Bundle) -> Iterator[Finding]:
    if bundle.error:
        yield Finding(severity="fail", topic="opening", what=bundle.error)
    for finding in bundle.findings:
        if finding.severity != "ok":
            yield Finding(**finding.model_dump())


def _of_files(bundle: Bundle) -> Iterator[Finding]:
    for group in bundle.groups:
        where = f"{group.folder}/*{group.suffix}"
        for fault in group.faults[:5]:
            yield Finding(severity="fail", topic="file", what=f"{fault.file}: {fault.fault}", where=where)
        odd = [name for name in group.odd_sizes if name not in {fault.file for fault in group.faults}]
        if odd:
            records = f", where most are whole records of {group.record_bytes} bytes" if group.record_bytes else ""
            what = f"{count_of(len(odd), 'file')} of another size than most{records}: {', '.join(odd[:5])}"
            yield Finding(severity="warn", topic="size", what=what, where=where)
        usual = next((form for form in group.forms if form.form.startswith(_SHARED_FORMS)), None)
        for form in group.forms if group.looked_at >= _SERIES else ():
            if usual is not None and form != usual and form.files <= _RARE * group.looked_at and form.form != "damaged":
                what = f"{form.examples[0] if form.examples else 'a file'}: {form.form}; most have {usual.form}"
                yield Finding(severity="warn", topic="form", what=what, where=where)
        yield from _of_widths(group, where)


def _of_widths(group: FileGroup, where: str) -> Iterator[Finding]:
    """Of texts: a few whose longest lines have another number of columns than those of most."""
    widths = {
        form.form: max(map(int, _NUMBERS.findall(form.form))) for form in group.forms if form.form[:9] == "lines of "
    }
    counts = Counter[int]()
    for form in group.forms:
        counts[widths.get(form.form, 0)] += form.files
    usual, files = counts.most_common(1)[0] if counts else (0, 0)
    if not usual or group.looked_at < _SERIES or files < (1 - _RARE) * group.looked_at:
        return
    for form in group.forms:
        if (width := widths.get(form.form, usual)) != usual:
            what = f"{form.examples[0] if form.examples else 'a file'}: lines of {count_of(width, 'column')}"
            what += f"; most have lines of {count_of(usual, 'column')}"
            yield Finding(severity="warn", topic="form", what=what, where=where)


def _of_pairs(bundle: Bundle) -> Iterator[Finding]:
    for pair in bundle.pairs:
        counts = [
            f"{count} only in {name}" for name, count in ((pair.one, pair.only_one), (pair.other, pair.only_other))
        ]
        shown = f", such as {', '.join(pair.examples)}" if pair.examples else ""
        what = f"{count_of(pair.both, 'name')} in both, {' and '.join(counts)}{shown}"
        yield Finding(severity="warn", topic="names", what=what, where=f"{pair.one} and {pair.other}")

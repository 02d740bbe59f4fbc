"""A folder of downloads: what lies in each archive, which cannot be used, and what to do with the others."""

from collections.abc import Sequence
from pathlib import Path

from farfield.datasets.downloads import archives_in, content_of, split_parts
from farfield.inspection.doctor.survey import DoctorReport, Finding

FORMAT_NAME = "downloads"
"""Stands for the format of such a folder."""


def examine_downloads(root: Path, further: Sequence[Path] = ()) -> DoctorReport | None:
    """Say what lies in the archives of a folder, without unpacking any; None where there is no archive.

    Args:
        root: The folder.
        further: Folders of further disks.

    Returns:
        A finding for each archive: ``"fail"`` where it is empty, cut or no archive, ``"warn"`` where members are
        refused or nothing is recognised.
    """
    findings = []
    for path in archives_in([root, *further]):
        content = content_of(path)
        listing, what = content.listing, str(content)
        if listing.fault:
            findings.append(Finding(severity="fail", topic="archive", what=what, fix="All others can be used."))
            continue
        store = "tesseracts" in what or "cubes" in what or "polar maps" in what
        fix = "farfield convert FOLDER STORE --to radar-store, or unpack it." if store else "Unpack it."
        if listing.refused:
            what += f", such as {listing.refused[0]}"
        severe = bool(listing.refused) or not content.datasets
        findings.append(Finding(severity="warn" if severe else "ok", topic="archive", what=what, fix=fix))
    for path in split_parts(root):
        fix = f"Join the parts: zip -s 0 {path.stem}.zip --out WHOLE.zip"
        findings.append(Finding(severity="fail", topic="archive", what=f"{path.name}: a part of an archive", fix=fix))
    if not findings:
        return None
    return DoctorReport(path=str(root), format=FORMAT_NAME, findings=tuple(findings), facts={"archives": len(findings)})

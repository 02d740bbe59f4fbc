"""The listing of a folder: its files by folder and suffix, what some of them are like, and names that do not match."""

import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from statistics import median_low

import numpy as np

from farfield.files.atomic import readable
from farfield.inspection.bundle.file_facts import FileFacts, file_facts
from farfield.inspection.bundle.record import FileFault, FileForm, FileGroup, GroupPair

MOST_FILES = 200_000
"""Files that are listed; a folder of more is listed in part."""
LOOKED_AT = 12
"""Files of a group that are looked into, spread evenly, besides those of odd sizes."""

_EXAMPLES, _MOST_FORMS, _MOST_FAULTS = 3, 6, 20
_RECORDS = (28, 24, 20, 32, 16, 12)  # bytes of a point: 7, 6, 5, 8, 4, 3 of float32
_MOSTLY = 0.8
_FIXED = (".bin", ".npy", ".mat")  # of which files of one size are no accident

Files = Mapping[tuple[str, str], Sequence[Path]]
"""Files by their folder from the root on and their suffix."""


def files_by_folder(root: Path) -> tuple[Files, bool]:
    """Files below a folder, without hidden ones and those behind links; and whether these are all.

    Args:
        root: The folder.
    """
    files: dict[tuple[str, str], list[Path]] = {}
    count = 0
    for folder, folders, names in os.walk(root):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        for name in sorted(names):
            path = Path(folder, name)
            if name.startswith(".") or (path.is_symlink() and not path.is_file()):
                continue
            if count == MOST_FILES:
                return files, False
            count += 1
            relative = path.parent.relative_to(root).as_posix()
            files.setdefault((readable(relative), path.suffix.lower()), []).append(path)
    return files, True


def group_of(folder: str, suffix: str, paths: Sequence[Path], *, look_at: int = LOOKED_AT) -> FileGroup:
    """What the files of one suffix in one folder are like.

    Args:
        folder: The folder from the root on.
        suffix: The suffix.
        paths: The files, in order.
        look_at: How many are looked into, besides those of odd sizes.
    """
    sizes = [path.stat().st_size if path.is_file() else 0 for path in paths]
    record, odd = _odd_sizes(suffix, sizes)
    rows = {*np.linspace(0, len(paths) - 1, min(look_at, len(paths))).astype(int).tolist(), *odd[:_MOST_FAULTS]}
    looked = {paths[row]: file_facts(paths[row]) for row in sorted(rows)} if look_at else {}
    faults = [FileFault(file=readable(path.name), fault=facts.fault) for path, facts in looked.items() if facts.fault]
    return FileGroup(
        folder=folder,
        suffix=suffix,
        files=len(paths),
        bytes=(min(sizes), median_low(sizes), max(sizes)),
        first=readable(paths[0].name),
        last=readable(paths[-1].name),
        looked_at=len(looked),
        forms=tuple(_forms(looked)),
        figures=_merged({name: (value, value) for name, value in facts.figures.items()} for facts in looked.values()),
        ranges=_merged(facts.ranges for facts in looked.values()),
        faults=tuple(faults[:_MOST_FAULTS]),
        odd_sizes=tuple(readable(paths[row].name) for row in odd[:_MOST_FAULTS]),
        record_bytes=record,
    )


def _odd_sizes(suffix: str, sizes: Sequence[int]) -> tuple[int, list[int]]:
    """Bytes of a record, and the rows of files that are empty or of an odd size."""
    odd = {row for row, size in enumerate(sizes) if not size}
    usual, count = Counter(sizes).most_common(1)[0]
    if suffix in _FIXED and usual and 1 < len(sizes) * _MOSTLY <= count:
        odd |= {row for row, size in enumerate(sizes) if size != usual}
    record = 0
    if suffix == ".bin" and len(sizes) > 1:
        share = {bytes_: sum(size % bytes_ == 0 for size in sizes) / len(sizes) for bytes_ in _RECORDS}
        record = max(share, key=lambda bytes_: (share[bytes_] >= _MOSTLY, share[bytes_], bytes_ == 16, bytes_))
        record = record if share[record] >= 0.6 else 0
        odd |= {row for row, size in enumerate(sizes) if record and size % record}
    return record, sorted(odd)


def _forms(looked: Mapping[Path, FileFacts]) -> Iterator[FileForm]:
    """The forms, the most frequent first."""
    names: dict[str, list[str]] = {}
    for path, facts in looked.items():
        names.setdefault(facts.form, []).append(readable(path.name))
    ordered = sorted(names.items(), key=lambda entry: -len(entry[1]))
    for form, files in ordered[:_MOST_FORMS]:
        yield FileForm(form=form[:3000], files=len(files), examples=tuple(files[:_EXAMPLES]))


def _merged(
    parts: Iterable[Mapping[str, tuple[int | float, int | float]]],
) -> dict[str, tuple[int | float, int | float]]:
    merged: dict[str, tuple[int | float, int | float]] = {}
    for part in parts:
        for name, (low, high) in part.items():
            least, most = merged.get(name, (low, high))
            merged[name] = (min(least, low), max(most, high))
    return merged


def pairs_of(files: Files) -> tuple[GroupPair, ...]:
    """Groups of which most files bear the same names, but some do not.

    Args:
        files: What :func:`files_by_folder` lists.
    """
    stems = {f"{folder}/*{suffix}": {path.stem for path in paths} for (folder, suffix), paths in files.items()}
    named = sorted(stems.items(), key=lambda entry: -len(entry[1]))
    pairs = []
    for row, (one, own) in enumerate(named):
        for other, theirs in named[row + 1 : row + 60]:
            both = len(own & theirs)
            if both >= 2 and 2 * both > len(theirs) and 0 < len(own ^ theirs) <= both:
                strays = sorted(theirs - own) + sorted(own - theirs)
                pairs.append(
                    GroupPair(
                        one=one,
                        other=other,
                        both=both,
                        only_one=len(own - theirs),
                        only_other=len(theirs - own),
                        examples=tuple(readable(name) for name in strays[:_EXAMPLES]),
                    )
                )
    return tuple(pairs[:100])

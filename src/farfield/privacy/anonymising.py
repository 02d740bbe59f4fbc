"""Cover faces in all pictures of a folder: find, link over time, cover, write; originals are only read.

Two passes in bulk. The first looks at each picture and keeps what it found in a journal; the second covers what the
whole series says. Interrupted anywhere, the same call goes on and ends with the same bytes.
"""

import hashlib
import json
import secrets
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from farfield.errors import ConfigError
from farfield.files.atomic import open_atomic, write_bytes
from farfield.files.images import read_image, write_image
from farfield.jobs import HERE, JobJournal, JobOptions, Unit, UnitResult, run
from farfield.privacy.covering import covered, mask_of
from farfield.privacy.films import FilmCovering, anonymise_films
from farfield.privacy.hits import ImageBoxes
from farfield.privacy.linking import CoveredBoxes
from farfield.privacy.looking import (
    AnonymizeOptions,
    PictureFindings,
    PictureSummary,
    covers_of,
    left_of,
    rows_of,
)
from farfield.privacy.partners import partners, side_by_side
from farfield.privacy.sources import Series, Sources, holds_two_eyes

LOG, JOURNAL, FOUND, SECRET = "anonymized.jsonl", ".journal.jsonl", ".found.jsonl", ".secret"
_QUALITY = 95


@dataclass(frozen=True)
class _PictureSearch:
    """Looks at a picture."""

    chosen: AnonymizeOptions

    memory_bytes = 1_000_000_000

    def __call__(self, unit: Unit) -> UnitResult:
        image = read_image(unit.sources[0], upright=True)
        return UnitResult(value=PictureFindings.at(image, self.chosen.finders()).to_json())


@dataclass(frozen=True)
class _Task:
    """What the second pass knows of a picture.

    Args:
        file: Below the folders.
        cover: What its own series says: rows of box, score, kind.
        other: The other eye's picture and what its series says; none without.
        both: Whether the picture may hold both eyes side by side.
    """

    file: str
    cover: list[list[Any]]
    other: tuple[str, list[list[Any]]] | None = None
    both: bool = False


@dataclass(frozen=True)
class _PictureCovering:
    """Covers a picture and writes it; the unit's parameters are the task."""

    root: Path
    out: Path
    how: str
    secret: bytes

    memory_bytes = 1_000_000_000

    def __call__(self, unit: Unit) -> UnitResult:
        task: _Task = unit.parameters
        image = read_image(self.root / task.file, upright=True)
        hits = ImageBoxes.from_rows(task.cover)
        if task.other is not None:
            other = read_image(self.root / task.other[0], upright=True)
            hits = ImageBoxes.joined([hits, partners(other, ImageBoxes.from_rows(task.other[1]), image, hits).hits])
        height, width = image.shape[:2]
        if task.both and holds_two_eyes(width, height):
            hits = ImageBoxes.joined([hits, side_by_side(image, hits)])
        hits = hits.within(width, height)
        path = self.out / task.file
        path.parent.mkdir(parents=True, exist_ok=True)
        noise = noise_of(self.secret, task.file)
        write_image(path, covered(image, hits, self.how, noise), quality=_QUALITY)
        share = float(mask_of(hits, width, height).mean())
        value = {"size_px": [width, height], "share": round(share, 6), "rows": hits.to_rows()}
        return UnitResult(files=(path,), value=value)


def noise_of(secret: bytes, name: str) -> np.random.Generator:
    """Noise of a picture, from a secret that is removed when all is done."""
    return np.random.default_rng(int.from_bytes(hashlib.sha256(secret + name.encode()).digest(), "little"))


def anonymise(
    sources: Sources,
    out: Path,
    chosen: AnonymizeOptions | None = None,
    *,
    pairs: Sequence[tuple[int, int]] = (),
    both: Sequence[int] = (),
    find: JobOptions = HERE,
    cover: JobOptions = HERE,
) -> list[PictureSummary]:
    """Cover all pictures and films and write them below another folder, with a log that holds no picture.

    Args:
        sources: Pictures and films.
        out: Folder to write into; not the root, nor below it.
        chosen: How.
        pairs: Numbers of series that are two eyes of one pair: what is covered in one is covered in the other.
        both: Numbers of series whose pictures hold both eyes side by side.
        find: Who looks for faces.
        cover: Who covers and writes.

    Returns:
        What became of each picture.

    Raises:
        ConfigError: If the folder to write into is the root, or below it.
    """
    chosen = chosen or AnonymizeOptions()
    root, folders, films = sources.root, sources.folders, sources.films
    check_apart(root, out)
    found = _found(folders, out, chosen, find)
    covers: dict[str, CoveredBoxes] = {}
    for series in folders:
        names = [file.as_posix() for file in series.files]
        covers |= dict(zip(names, covers_of([found[name] for name in names], series.times_s, chosen), strict=True))
    secret = _secret(out)
    done = _covered(root, out, chosen, _tasks(folders, covers, pairs, both), covers, secret, cover)
    done = [replace(each, left=left_of(found[each.file].hits, _hits(each))) for each in done]
    if films:
        done += anonymise_films(root, films, out, FilmCovering(chosen, secret), find=find, cover=cover)
    _write_log(out / LOG, done, chosen)
    (out / SECRET).unlink()
    return done


def check_apart(root: Path, out: Path) -> None:
    """See that nothing is written where is read.

    Raises:
        ConfigError: If the folder to write into is the root, or below it.
    """
    here, there = root.resolve(), out.resolve()
    if there == here or here in there.parents:
        raise ConfigError(f"anonymize: expected a folder to write into that is not {root} nor below it; got {out}")


def _found(
    folders: Sequence[Series], out: Path, chosen: AnonymizeOptions, bulk: JobOptions
) -> dict[str, PictureFindings]:
    """What the first pass says of each picture."""
    units = [Unit(file.as_posix(), (each.root / file,)) for each in folders for file in each.files]
    journal = JobJournal(out / FOUND, chosen.setting(), files=False)
    run(_PictureSearch(chosen), units, bulk, journal=journal)
    names = [unit.name for unit in units]
    told = zip(names, journal.values(names), strict=True) if names else ()
    return {name: PictureFindings.from_json(each) for name, each in told}


def _tasks(
    folders: Sequence[Series], covers: Mapping[str, CoveredBoxes], pairs: Sequence[tuple[int, int]], both: Sequence[int]
) -> list[_Task]:
    """A task for each picture, with the other eye's where there is one of the same name."""
    partner: dict[str, str] = {}
    for one, other in pairs:
        left, right = ({file.stem: file.as_posix() for file in folders[number].files} for number in (one, other))
        for stem in left.keys() & right.keys():
            partner |= {left[stem]: right[stem], right[stem]: left[stem]}
    told = {file: cover.hits.to_rows() for file, cover in covers.items()}
    double = {file.as_posix() for number in both for file in folders[number].files}
    others = {file: (name, told[name]) for file, name in partner.items()}
    return [_Task(file, told[file], others.get(file), file in double) for file in told]


def _covered(
    root: Path,
    out: Path,
    chosen: AnonymizeOptions,
    tasks: Sequence[_Task],
    covers: Mapping[str, CoveredBoxes],
    secret: bytes,
    bulk: JobOptions,
) -> list[PictureSummary]:
    """Cover and write all pictures."""
    units = [Unit(f"{task.file} {_digest(task)}", _sources(root, task), task) for task in tasks]
    journal = JobJournal(out / JOURNAL, chosen.setting())
    run(_PictureCovering(root, out, chosen.how, secret), units, bulk, journal=journal)
    values = journal.values(unit.name for unit in units) if units else ()
    done = []
    for task, value in zip(tasks, values, strict=True):
        width, height = value["size_px"]
        rows = rows_of(ImageBoxes.from_rows(value["rows"]), covers[task.file])
        done.append(PictureSummary(task.file, (width, height), float(value["share"]), rows))
    return done


def _hits(each: PictureSummary) -> ImageBoxes:
    return ImageBoxes.from_rows([[*row["box_px"], row["score"], row["kind"]] for row in each.rows])


def _sources(root: Path, task: _Task) -> tuple[Path, ...]:
    files = (task.file,) if task.other is None else (task.file, task.other[0])
    return tuple(root / file for file in files)


def _digest(task: _Task) -> str:
    """Tells what is covered in a picture: the other pictures of its series decide with it."""
    return hashlib.sha256(json.dumps(asdict(task)).encode()).hexdigest()[:16]


def _secret(out: Path) -> bytes:
    """The seed of the noise: kept until all is done, so that an interrupted call goes on, and removed then."""
    path = out / SECRET
    if not path.is_file():
        write_bytes(path, secrets.token_bytes(32))
    return path.read_bytes()


def _write_log(path: Path, done: Iterable[PictureSummary], chosen: AnonymizeOptions) -> None:
    """A line of settings, then one a picture: no picture, no hash of covered pixels."""
    with open_atomic(path) as file:
        for line in [{"settings": asdict(chosen), "models": chosen.models()}, *(each.to_json() for each in done)]:
            file.write(json.dumps(line).encode() + b"\n")

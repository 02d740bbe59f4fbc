"""Films: looked at and covered in segments, each in a process of its own with a limit of memory, then joined.

Frames keep their stamps. Sound, subtitles, chapters and all metadata stay behind.
"""

import hashlib
import json
import shutil
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from farfield.errors import ConfigError
from farfield.files.videos import WRITTEN, Film, film_frames, join_films, read_film, write_film
from farfield.jobs import JobJournal, JobOptions, Unit, UnitResult, run
from farfield.privacy.covering import covered, mask_of
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

SEGMENT = 300
_FOUND, _PARTS_JOURNAL, _DONE, _PARTS = ".found-films.jsonl", "parts.jsonl", ".films.jsonl", ".unfinished-films"
_LIMIT_BYTES = 8 << 30
_Picture = UInt8[np.ndarray, "height width 3"]


@dataclass(frozen=True)
class FilmCovering:
    """How films are covered.

    Args:
        chosen: As pictures are.
        secret: Seed of the noise.
    """

    chosen: AnonymizeOptions
    secret: bytes

    def noise(self, file: str, frame: int) -> np.random.Generator:
        """Noise of a frame."""
        digest = hashlib.sha256(self.secret + f"{file} {frame}".encode()).digest()
        return np.random.default_rng(int.from_bytes(digest, "little"))


@dataclass(frozen=True)
class _Span:
    """Frames of a film: from the first up to the last, and what is covered in each."""

    file: str
    first: int
    last: int
    rows: tuple[list[list[Any]], ...] = ()


@dataclass(frozen=True)
class _SegmentSearch:
    """Looks at a segment of a film."""

    chosen: AnonymizeOptions

    memory_bytes, own_process = 2_000_000_000, True

    def __call__(self, unit: Unit) -> UnitResult:
        limited()
        span: _Span = unit.parameters
        finders = self.chosen.finders()
        frames = film_frames(read_film(unit.sources[0]), span.first, span.last)
        return UnitResult(value=[PictureFindings.at(frame, finders).to_json() for frame in frames])


@dataclass(frozen=True)
class _SegmentCovering:
    """Covers a segment of a film and writes it as a part."""

    covering: FilmCovering
    folder: Path

    memory_bytes, own_process = 2_000_000_000, True

    def __call__(self, unit: Unit) -> UnitResult:
        limited()
        span: _Span = unit.parameters
        film, path = read_film(unit.sources[0]), self.folder / _part(span)
        shares: list[float] = []
        stamps = film.stamps[span.first : span.last].tolist()
        write_film(path, self._pictures(film, span, shares), stamps, film.time_base)
        return UnitResult(files=(path,), value=[round(share, 6) for share in shares])

    def _pictures(self, film: Film, span: _Span, shares: list[float]) -> Iterator[_Picture]:
        for number, picture in enumerate(film_frames(film, span.first, span.last)):
            height, width = picture.shape[:2]
            hits = ImageBoxes.from_rows(span.rows[number]).within(width, height)
            shares.append(float(mask_of(hits, width, height).mean()))
            noise = self.covering.noise(span.file, span.first + number)
            yield covered(picture, hits, self.covering.chosen.how, noise)


def _part(span: _Span) -> str:
    """The name of a part: of a film and what is covered in it."""
    return f"{_named(span.file)}-{span.first:09}.mkv"


def _named(file: str) -> str:
    return hashlib.sha256(file.encode()).hexdigest()[:16]


def limited() -> None:
    """Let this process take so much memory and no more: a hostile film ends it, not the machine."""
    with suppress(ImportError, ValueError, OSError):
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (_LIMIT_BYTES, _LIMIT_BYTES))


def written_as(file: Path) -> Path:
    """The name of the covered film: H.264 goes into the containers that take it, others get ``.mp4``."""
    return file if file.suffix.lower() in WRITTEN else file.with_name(file.name + ".mp4")


def anonymise_films(
    root: Path, files: Sequence[Path], out: Path, covering: FilmCovering, *, find: JobOptions, cover: JobOptions
) -> list[PictureSummary]:
    """Cover films and write them below another folder.

    Args:
        root: The folder of the films.
        files: The films below it.
        out: The folder to write into.
        covering: How.
        find: Who looks for faces.
        cover: Who covers and writes.

    Returns:
        What became of each frame.

    Raises:
        FileFormatError: If a film is damaged.
        MissingExtraError: If PyAV is not installed.
    """
    films = {file.as_posix(): read_film(root / file) for file in files}
    looked = _found(films, out, covering.chosen, find)
    done = []
    journal = JobJournal(out / _DONE, covering.chosen.setting())
    for file, film in films.items():
        covers = covers_of(looked[file], film.times_s, covering.chosen)
        unit = Unit(f"{file} {_digest(covers)}", (film.path,), (file, film, covers))
        run(_FilmTask(out, covering, cover), [unit], journal=journal)
        (shares,) = journal.values([unit.name])
        name = written_as(Path(file)).as_posix()
        frames = zip(looked[file], covers, shares, strict=True)
        done += [
            PictureSummary(
                name, each.size_px, float(share), rows_of(cover.hits, cover), frame, left_of(each.hits, cover.hits)
            )
            for frame, (each, cover, share) in enumerate(frames)
        ]
    shutil.rmtree(out / _PARTS, ignore_errors=True)
    return done


def _spans(file: str, film: Film) -> list[_Span]:
    starts = range(0, len(film), SEGMENT)
    return [_Span(file, first, min(first + SEGMENT, len(film))) for first in starts]


def _found(
    films: dict[str, Film], out: Path, chosen: AnonymizeOptions, bulk: JobOptions
) -> dict[str, list[PictureFindings]]:
    spans = [span for file, film in films.items() for span in _spans(file, film)]
    units = [Unit(f"{span.file} {span.first}", (films[span.file].path,), span) for span in spans]
    journal = JobJournal(out / _FOUND, chosen.setting(), files=False)
    run(_SegmentSearch(chosen), units, bulk, journal=journal)
    looked: dict[str, list[PictureFindings]] = {file: [] for file in films}
    for span, told in zip(spans, journal.values(unit.name for unit in units), strict=True):
        looked[span.file] += [PictureFindings.from_json(each) for each in told]
    return looked


def _digest(covers: Sequence[CoveredBoxes]) -> str:
    told = json.dumps([cover.hits.to_rows() for cover in covers])
    return hashlib.sha256(told.encode()).hexdigest()[:16]


@dataclass(frozen=True)
class _FilmTask:
    """Covers a film in segments, in bulk, and joins them."""

    out: Path
    covering: FilmCovering
    bulk: JobOptions

    def __call__(self, unit: Unit) -> UnitResult:
        file, film, covers = unit.parameters
        folder = self.out / _PARTS / _named(unit.name)
        spans = [
            _Span(file, span.first, span.last, tuple(cover.hits.to_rows() for cover in covers[span.first : span.last]))
            for span in _spans(file, film)
        ]
        units = [Unit(f"{span.first}", (film.path,), span) for span in spans]
        journal = JobJournal(folder / _PARTS_JOURNAL, self.covering.chosen.setting())
        run(_SegmentCovering(self.covering, folder), units, self.bulk, journal=journal)
        shares = [share for part in journal.values(each.name for each in units) for share in part]
        if len(shares) != len(film):
            raise ConfigError(f"{file}: expected {len(film)} covered frames, got {len(shares)}")
        path = self.out / written_as(Path(file))
        path.parent.mkdir(parents=True, exist_ok=True)
        join_films(path, [folder / _part(span) for span in spans])
        return UnitResult(files=(path,), value=shares)

"""Cover faces and number plates in pictures and films: find, link, cover, write; originals are only read.

Two passes of jobs. The first runs the detectors on each picture by itself and keeps their boxes in a journal; the
second covers what the whole series says. Interrupted anywhere, the same call goes on and ends with the same bytes.

Films go the same way in segments, each in a process of its own with a limit of memory, and the covered segments are
joined. Frames keep their stamps. Sound, subtitles, chapters and all metadata stay behind.
"""

import hashlib
import json
import secrets
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from farfield.errors import ConfigError
from farfield.files.atomic import open_atomic, write_bytes
from farfield.files.images import read_image, write_image
from farfield.files.videos import WRITTEN, Film, film_frames, join_films, read_film, write_film
from farfield.jobs import HERE, JobJournal, JobOptions, Unit, UnitResult, run
from farfield.jobs.folders import held
from farfield.privacy.covering import How, box_mask, cover_boxes
from farfield.privacy.detectors import FaceDetector, ImageFinder, PlateDetector, why_no_plates
from farfield.privacy.image_boxes import ImageBoxes, pairwise_iou
from farfield.privacy.linking import (
    ORIGINS,
    CoveredBoxes,
    LinkSettings,
    PictureFindings,
    find_partners,
    find_partners_in_halves,
    link_series,
)
from farfield.privacy.sources import Series, Sources, holds_two_eyes

LOG, SECRET = "anonymized.jsonl", ".secret"
PICTURE_FINDINGS, PICTURE_JOURNAL = ".found.jsonl", ".journal.jsonl"
FILM_FINDINGS, FILM_JOURNAL, SEGMENT_JOURNAL = ".found-films.jsonl", ".films.jsonl", "parts.jsonl"
UNFINISHED_FILMS = ".unfinished-films"

SEGMENT_FRAMES = 300
_QUALITY = 95
_DOUBTFUL, _HIDDEN_IOU = 0.3, 0.3
_MEMORY_LIMIT_BYTES = 8 << 30
_Picture = UInt8[np.ndarray, "height width 3"]


@dataclass(frozen=True, kw_only=True)
class AnonymizeOptions:
    """How pictures are covered.

    Args:
        how: See :func:`~farfield.privacy.covering.cover_boxes`.
        small_faces: Look at the picture at twice its size too.
        plates: Cover number plates too, where torch is installed (:func:`without_plates` says why not).
        least_score: Weaker boxes are ignored from the start.
        linking: How boxes become tracks.
        together: Whether the pictures of a folder follow one another; else each stands alone.
    """

    how: How = "fill"
    small_faces: bool = False
    plates: bool = True
    least_score: float = 0.1
    linking: LinkSettings = field(default_factory=LinkSettings)
    together: bool = True

    def finders(self) -> list[ImageFinder]:
        """The detectors.

        Raises:
            MissingExtraError: If OpenCV is not installed.
            FarfieldError: If a model is missing.
        """
        sizes = (1.0, 2.0) if self.small_faces else (1.0,)
        faces = FaceDetector(least_score=self.least_score, sizes=sizes)
        if not self.plates or self.without_plates():
            return [faces]
        return [faces, PlateDetector(least_score=self.least_score)]

    def without_plates(self) -> str:
        """Why plates stay as they are, in words; empty where they are covered or shall stay."""
        return why_no_plates() if self.plates else ""

    def setting(self) -> str:
        """All that decides the result besides the pictures."""
        return json.dumps([asdict(self), self.models()], sort_keys=True)

    def models(self) -> dict[str, str]:
        """SHA-256 of each detector's model."""
        return {finder.kind: finder.digest for finder in self.finders()}


@dataclass(frozen=True)
class PictureSummary:
    """What became of a picture.

    Args:
        file: Below the folder that is written into.
        size_px: Width and height.
        share: Share of its pixels that is covered.
        rows: What is covered: kind, box_px, score, track, how it came about.
        frame: Its number, of a film's.
        left: Weak boxes that are not covered: kind, box_px, score.
    """

    file: str
    size_px: tuple[int, int]
    share: float
    rows: tuple[Mapping[str, Any], ...]
    frame: int | None = None
    left: tuple[Mapping[str, Any], ...] = ()

    @property
    def doubtful(self) -> list[Mapping[str, Any]]:
        """Weak boxes, and those that no detector found in this very picture."""
        return [row for row in self.rows if row["score"] < _DOUBTFUL or row["how"] != ORIGINS[0]]

    def to_json(self) -> dict[str, Any]:
        """The line of the log."""
        frame = {} if self.frame is None else {"frame": self.frame}
        rows = {"size_px": list(self.size_px), "covered": [dict(row) for row in self.rows]}
        return {"file": self.file, **frame, **rows} | ({"left": [dict(row) for row in self.left]} if self.left else {})


def count_covers(summaries: Iterable[PictureSummary], kind: str, *, together: bool = True) -> tuple[int, int]:
    """How many tracks of a kind there are, and how many covers: one a picture or frame for as long as a track lasts.

    A track is one object that is followed; an object lost for longer than a gap counts again. A cover that comes
    from the other eye has no track of its own.

    Args:
        summaries: From :func:`anonymise`.
        kind: ``face`` or ``plate``.
        together: Whether tracks go on from one picture to the next (:class:`AnonymizeOptions`).
    """
    tracks, covers = set(), 0
    for summary in summaries:
        series = summary.file if summary.frame is not None else Path(summary.file).parent.as_posix()
        track_series = series if together else f"{summary.file} {summary.frame}"
        rows = [row for row in summary.rows if row["kind"] == kind]
        covers += len(rows)
        tracks |= {(track_series, row["track"]) for row in rows if row["track"] is not None}
    return len(tracks), covers


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
        find: Who runs the detectors.
        cover: Who covers and writes.

    Returns:
        What became of each picture.

    Raises:
        ConfigError: If the folder to write into is the root, or below it.
        FileFormatError: If a picture or film is damaged.
        MissingExtraError: If there are films and PyAV is not installed.
    """
    options = chosen or AnonymizeOptions()
    check_apart(sources.root, out)
    with held(out):
        # 1. Find boxes in each picture by itself.
        findings = _find_in_pictures(sources.folders, out, options, find)
        # 2. Link them over time: the whole series says what is covered in each of its pictures.
        covers: dict[str, CoveredBoxes] = {}
        for series in sources.folders:
            names = [file.as_posix() for file in series.files]
            in_order = [findings[name] for name in names]
            linked = link_series(in_order, series.times_s, options.linking, together=options.together)
            covers |= dict(zip(names, linked, strict=True))
        # 3. Take over what the other eye of a pair shows; cover and write.
        secret = _noise_secret(out)
        tasks = _covering_tasks(sources.folders, covers, pairs, both)
        summaries = []
        for task, covering in zip(
            tasks, _cover_pictures(sources.root, out, options, tasks, secret, cover), strict=True
        ):
            boxes = ImageBoxes.from_rows(covering["rows"])
            rows, left = _covered_rows(boxes, covers[task.file]), uncovered_rows(findings[task.file].boxes, boxes)
            width, height = covering["size_px"]
            summaries.append(PictureSummary(task.file, (width, height), float(covering["share"]), rows, left=left))
        # 4. The same for films, a segment a job.
        if sources.films:
            summaries += _anonymise_films(sources.root, sources.films, out, options, secret, find=find, cover=cover)
        # 5. Log, and forget the seed of the noise.
        _write_log(out / LOG, summaries, options)
        (out / SECRET).unlink()
    return summaries


def check_apart(root: Path, out: Path) -> None:
    """See that nothing is written where is read.

    Raises:
        ConfigError: If the folder to write into is the root, or below it.
    """
    source, target = root.resolve(), out.resolve()
    if target == source or source in target.parents:
        raise ConfigError(f"anonymize: expected a folder to write into that is not {root} nor below it; got {out}")


# Pictures


@dataclass(frozen=True)
class _PictureSearch:
    """Runs the detectors on a picture."""

    options: AnonymizeOptions

    memory_bytes = 1_000_000_000

    def __call__(self, unit: Unit) -> UnitResult:
        image = read_image(unit.sources[0], upright=True)
        return UnitResult(value=PictureFindings.in_image(image, self.options.finders()).to_json())


def _find_in_pictures(
    folders: Sequence[Series], out: Path, options: AnonymizeOptions, jobs: JobOptions
) -> dict[str, PictureFindings]:
    """The first pass: what the detectors say of each picture."""
    units = [Unit(file.as_posix(), (series.root / file,)) for series in folders for file in series.files]
    journal = JobJournal(out / PICTURE_FINDINGS, options.setting(), files=False)
    run(_PictureSearch(options), units, jobs, journal=journal)
    names = [unit.name for unit in units]
    entries = zip(names, journal.values(names), strict=True) if names else ()
    return {name: PictureFindings.from_json(entry) for name, entry in entries}


@dataclass(frozen=True)
class _CoverTask:
    """What the second pass covers in a picture.

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

    def unit(self, root: Path) -> Unit:
        """The job; its name says what is covered, for the other pictures of the series decide with it."""
        files = (self.file,) if self.other is None else (self.file, self.other[0])
        return Unit(f"{self.file} {_digest(json.dumps(asdict(self)))}", tuple(root / file for file in files), self)


def _covering_tasks(
    folders: Sequence[Series], covers: Mapping[str, CoveredBoxes], pairs: Sequence[tuple[int, int]], both: Sequence[int]
) -> list[_CoverTask]:
    """A task for each picture, with the other eye's where there is one of the same name."""
    partner: dict[str, str] = {}
    for one, other in pairs:
        left, right = ({file.stem: file.as_posix() for file in folders[number].files} for number in (one, other))
        for stem in left.keys() & right.keys():
            partner |= {left[stem]: right[stem], right[stem]: left[stem]}
    rows = {file: cover.boxes.to_rows() for file, cover in covers.items()}
    side_by_side = {file.as_posix() for number in both for file in folders[number].files}
    others = {file: (name, rows[name]) for file, name in partner.items()}
    return [_CoverTask(file, rows[file], others.get(file), file in side_by_side) for file in rows]


def _cover_pictures(
    root: Path, out: Path, options: AnonymizeOptions, tasks: Sequence[_CoverTask], secret: bytes, jobs: JobOptions
) -> Sequence[Mapping[str, Any]]:
    """The second pass: size, share and rows of each covered picture."""
    units = [task.unit(root) for task in tasks]
    journal = JobJournal(out / PICTURE_JOURNAL, options.setting())
    run(_PictureCovering(root, out, options.how, secret), units, jobs, journal=journal)
    return list(journal.values(unit.name for unit in units)) if units else []


@dataclass(frozen=True)
class _PictureCovering:
    """Covers a picture and writes it; the unit's parameters are the task."""

    root: Path
    out: Path
    how: str
    secret: bytes

    memory_bytes = 1_000_000_000

    def __call__(self, unit: Unit) -> UnitResult:
        task: _CoverTask = unit.parameters
        image = read_image(self.root / task.file, upright=True)
        boxes = ImageBoxes.from_rows(task.cover)
        if task.other is not None:
            other = read_image(self.root / task.other[0], upright=True)
            partners = find_partners(other, ImageBoxes.from_rows(task.other[1]), image, boxes).boxes
            boxes = ImageBoxes.concatenate([boxes, partners])
        height, width = image.shape[:2]
        if task.both and holds_two_eyes(width, height):
            boxes = ImageBoxes.concatenate([boxes, find_partners_in_halves(image, boxes)])
        boxes = boxes.within(width, height)
        path = self.out / task.file
        path.parent.mkdir(parents=True, exist_ok=True)
        write_image(path, cover_boxes(image, boxes, self.how, _noise(self.secret, task.file)), quality=_QUALITY)
        share = float(box_mask(boxes, width, height).mean())
        value = {"size_px": [width, height], "share": round(share, 6), "rows": boxes.to_rows()}
        return UnitResult(files=(path,), value=value)


# Films


@dataclass(frozen=True)
class _Segment:
    """Frames of a film: from the first up to the last, and what is covered in each."""

    file: str
    first: int
    last: int
    rows: tuple[list[list[Any]], ...] = ()

    @property
    def part_name(self) -> str:
        """File of the covered segment."""
        return f"{_digest(self.file)}-{self.first:09}.mkv"


def _segments(file: str, film: Film, covers: Sequence[CoveredBoxes] = ()) -> list[_Segment]:
    starts = range(0, len(film), SEGMENT_FRAMES)
    spans = [(first, min(first + SEGMENT_FRAMES, len(film))) for first in starts]
    return [_Segment(file, *span, tuple(cover.boxes.to_rows() for cover in covers[slice(*span)])) for span in spans]


def _anonymise_films(
    root: Path,
    files: Sequence[Path],
    out: Path,
    options: AnonymizeOptions,
    secret: bytes,
    *,
    find: JobOptions,
    cover: JobOptions,
) -> list[PictureSummary]:
    """Cover films and write them below another folder; what became of each frame."""
    films = {file.as_posix(): read_film(root / file) for file in files}
    findings = _find_in_films(films, out, options, find)
    summaries = []
    journal = JobJournal(out / FILM_JOURNAL, options.setting())
    for file, film in films.items():
        covers = link_series(findings[file], film.times_s, options.linking, together=options.together)
        digest = _digest(json.dumps([frame.boxes.to_rows() for frame in covers]))
        unit = Unit(f"{file} {digest}", (film.path,), (file, film, covers))
        run(_FilmCovering(out, options, secret, cover), [unit], journal=journal)
        (shares,) = journal.values([unit.name])
        name = _output_name(Path(file)).as_posix()
        for frame, (finding, covered, share) in enumerate(zip(findings[file], covers, shares, strict=True)):
            rows = _covered_rows(covered.boxes, covered)
            left = uncovered_rows(finding.boxes, covered.boxes)
            summaries.append(PictureSummary(name, finding.size_px, float(share), rows, frame, left))
    shutil.rmtree(out / UNFINISHED_FILMS, ignore_errors=True)
    return summaries


def _find_in_films(
    films: Mapping[str, Film], out: Path, options: AnonymizeOptions, jobs: JobOptions
) -> dict[str, list[PictureFindings]]:
    """The first pass: what the detectors say of each frame."""
    segments = [segment for file, film in films.items() for segment in _segments(file, film)]
    units = [Unit(f"{segment.file} {segment.first}", (films[segment.file].path,), segment) for segment in segments]
    journal = JobJournal(out / FILM_FINDINGS, options.setting(), files=False)
    run(_SegmentSearch(options), units, jobs, journal=journal)
    findings: dict[str, list[PictureFindings]] = {file: [] for file in films}
    for segment, entries in zip(segments, journal.values(unit.name for unit in units), strict=True):
        findings[segment.file] += [PictureFindings.from_json(entry) for entry in entries]
    return findings


@dataclass(frozen=True)
class _SegmentSearch:
    """Runs the detectors on a segment of a film."""

    options: AnonymizeOptions

    memory_bytes, own_process = 2_000_000_000, True

    def __call__(self, unit: Unit) -> UnitResult:
        _limit_memory()
        segment: _Segment = unit.parameters
        finders = self.options.finders()
        frames = film_frames(read_film(unit.sources[0]), segment.first, segment.last)
        return UnitResult(value=[PictureFindings.in_image(frame, finders).to_json() for frame in frames])


@dataclass(frozen=True)
class _FilmCovering:
    """Covers a film in segments, a job each, and joins them; the value is each frame's covered share."""

    out: Path
    options: AnonymizeOptions
    secret: bytes
    jobs: JobOptions

    def __call__(self, unit: Unit) -> UnitResult:
        file, film, covers = unit.parameters
        folder = self.out / UNFINISHED_FILMS / _digest(unit.name)
        segments = _segments(file, film, covers)
        units = [Unit(f"{segment.first}", (film.path,), segment) for segment in segments]
        journal = JobJournal(folder / SEGMENT_JOURNAL, self.options.setting())
        run(_SegmentCovering(folder, self.options.how, self.secret), units, self.jobs, journal=journal)
        shares = [share for part in journal.values(part.name for part in units) for share in part]
        if len(shares) != len(film):
            raise ConfigError(f"{file}: expected {len(film)} covered frames, got {len(shares)}")
        path = self.out / _output_name(Path(file))
        path.parent.mkdir(parents=True, exist_ok=True)
        join_films(path, [folder / segment.part_name for segment in segments])
        return UnitResult(files=(path,), value=shares)


@dataclass(frozen=True)
class _SegmentCovering:
    """Covers a segment of a film and writes it as a part."""

    folder: Path
    how: str
    secret: bytes

    memory_bytes, own_process = 2_000_000_000, True

    def __call__(self, unit: Unit) -> UnitResult:
        _limit_memory()
        segment: _Segment = unit.parameters
        film, path = read_film(unit.sources[0]), self.folder / segment.part_name
        shares: list[float] = []
        stamps = film.stamps[segment.first : segment.last].tolist()
        write_film(path, self._covered_frames(film, segment, shares), stamps, film.time_base)
        return UnitResult(files=(path,), value=[round(share, 6) for share in shares])

    def _covered_frames(self, film: Film, segment: _Segment, shares: list[float]) -> Iterator[_Picture]:
        """Covered frames one by one, for a film does not fit into memory; the shares grow with them."""
        frames = film_frames(film, segment.first, segment.last)
        for number, (picture, rows) in enumerate(zip(frames, segment.rows, strict=False), segment.first):
            height, width = picture.shape[:2]
            boxes = ImageBoxes.from_rows(rows).within(width, height)
            shares.append(float(box_mask(boxes, width, height).mean()))
            yield cover_boxes(picture, boxes, self.how, _noise(self.secret, f"{segment.file} {number}"))


def _limit_memory() -> None:
    """Let this process take so much memory and no more: a hostile film ends it, not the machine."""
    with suppress(ImportError, ValueError, OSError):
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (_MEMORY_LIMIT_BYTES, _MEMORY_LIMIT_BYTES))


def _output_name(film: Path) -> Path:
    """The name of the covered film: H.264 goes into the containers that take it, others get ``.mp4``."""
    return film if film.suffix.lower() in WRITTEN else film.with_name(film.name + ".mp4")


# Noise and log


def _noise_secret(out: Path) -> bytes:
    """The seed of the noise: on disk until all is done, so that an interrupted call goes on, and removed then."""
    path = out / SECRET
    if not path.is_file():
        write_bytes(path, secrets.token_bytes(32))
    return path.read_bytes()


def _noise(secret: bytes, name: str) -> np.random.Generator:
    """Noise of a picture or frame."""
    return np.random.default_rng(
        int.from_bytes(hashlib.sha256(secret + name.encode(errors="surrogateescape")).digest(), "little")
    )


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode(errors="surrogateescape")).hexdigest()[:16]


def _covered_rows(boxes: ImageBoxes, cover: CoveredBoxes) -> tuple[dict[str, Any], ...]:
    """What is covered, a row a box: those of the cover first, then those that come from the other eye."""
    rows = []
    for number, (*box_px, score, kind) in enumerate(boxes.to_rows()):
        own = number < len(cover.boxes)
        how = ORIGINS[int(cover.origin[number])] if own else "partner"
        track = int(cover.track[number]) if own else None
        rows.append({"kind": kind, "box_px": box_px, "score": score, "track": track, "how": how})
    return tuple(rows)


def uncovered_rows(boxes: ImageBoxes, covered: ImageBoxes) -> tuple[dict[str, Any], ...]:
    """The boxes of the first pass that are not covered, for no strong one is on their track: the strongest first."""
    hidden = pairwise_iou(boxes.box_px, covered.box_px).max(axis=1, initial=0.0) >= _HIDDEN_IOU
    centre = (boxes.box_px[:, None, :2] + boxes.box_px[:, None, 2:]) / 2
    inside = (centre >= covered.box_px[None, :, :2]) & (centre <= covered.box_px[None, :, 2:])
    left = boxes[~hidden & ~inside.all(axis=2).any(axis=1)]
    order = np.argsort(-left.score, kind="stable")
    return tuple({"kind": kind, "box_px": box_px, "score": score} for *box_px, score, kind in left[order].to_rows())


def _write_log(path: Path, summaries: Iterable[PictureSummary], options: AnonymizeOptions) -> None:
    """A line of settings, then one a picture: no picture, no hash of covered pixels."""
    settings = {"settings": asdict(options), "models": options.models()}
    with open_atomic(path) as file:
        for line in [settings, *(summary.to_json() for summary in summaries)]:
            file.write(json.dumps(line).encode() + b"\n")

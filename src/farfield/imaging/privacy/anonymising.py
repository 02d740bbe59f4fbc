"""Cover faces in all pictures of a folder: find, link over time, cover, write; originals are only read.

Two passes in bulk. The first looks at each picture and keeps what it found in a journal; the second covers what the
whole series says. Interrupted anywhere, the same call goes on and ends with the same bytes.
"""

import hashlib
import json
import secrets
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from farfield.bulk import HERE, Bulk, Done, Journal, Unit, run
from farfield.errors import ConfigError
from farfield.files.atomic import open_atomic, write_bytes
from farfield.files.images import read_image, write_image
from farfield.imaging.privacy.covering import How, covered, mask_of
from farfield.imaging.privacy.faces import FaceDetector
from farfield.imaging.privacy.hits import Hits
from farfield.imaging.privacy.linking import HOWS, Cover, Linking, linked
from farfield.imaging.privacy.partners import partners
from farfield.imaging.privacy.sources import Series

LOG, JOURNAL, FOUND, SECRET = "anonymized.jsonl", ".journal.jsonl", ".found.jsonl", ".secret"
_DOUBTFUL = 0.3
_QUALITY = 95
_LOOKS, _CUT, _APART_S = 4, 28.0, 1e4


@runtime_checkable
class Finder(Protocol):
    """Finds one kind of thing in a picture."""

    kind: str
    digest: str

    def __call__(self, image: np.ndarray) -> Hits:
        """The boxes in an RGB picture, shape (height, width, 3), uint8."""


@dataclass(frozen=True, kw_only=True)
class Anonymising:
    """How pictures are covered.

    Args:
        how: See :func:`~farfield.imaging.privacy.covering.covered`.
        small_faces: Look at the picture at twice its size too.
        least_score: Weaker boxes are not even kept in mind.
        linking: How boxes become tracks; with ``together=False`` each picture stands alone.
        together: Whether the pictures of a folder follow one another.
    """

    how: How = "fill"
    small_faces: bool = False
    least_score: float = 0.1
    linking: Linking = field(default_factory=Linking)
    together: bool = True

    def finders(self) -> list[Finder]:
        """The detectors.

        Raises:
            MissingExtraError: If OpenCV is not installed.
            FarfieldError: If a model is missing.
        """
        sizes = (1.0, 2.0) if self.small_faces else (1.0,)
        return [FaceDetector(least_score=self.least_score, sizes=sizes)]

    def setting(self, finders: Sequence[Finder]) -> str:
        """All that decides the result besides the pictures."""
        return json.dumps([asdict(self), [(finder.kind, finder.digest) for finder in finders]], sort_keys=True)


@dataclass(frozen=True)
class _Finding:
    """Finds what may have to be covered in a picture; the unit's parameters are nothing."""

    chosen: Anonymising

    memory_bytes = 1_000_000_000

    def __call__(self, unit: Unit) -> Done:
        image = read_image(unit.sources[0], upright=True)
        hits = Hits.joined([finder(image) for finder in self.chosen.finders()])
        size = [image.shape[1], image.shape[0]]
        return Done(value={"size_px": size, "looks": _looks(image), "hits": _told(hits)})


def _looks(image: np.ndarray) -> list[int]:
    """Mean grey of sixteen parts of a picture: enough to see that the next one shows something else."""
    rows = np.array_split(image.mean(axis=2), _LOOKS)
    return [round(float(part.mean())) for row in rows for part in np.array_split(row, _LOOKS, axis=1) if part.size]


def _told(hits: Hits) -> list[list[Any]]:
    return [[*np.round(b, 2).tolist(), round(float(s), 4), str(k)] for b, s, k in zip(*_columns(hits), strict=True)]


def _columns(hits: Hits) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return hits.box_px, hits.score, hits.kind


def _heard(rows: Sequence[Sequence[Any]]) -> Hits:
    boxes = np.array([row[:4] for row in rows], dtype=float).reshape(-1, 4)
    return Hits(boxes, np.array([row[4] for row in rows], dtype=float), np.array([row[5] for row in rows], dtype="<U8"))


@dataclass(frozen=True, eq=False)
class _Looked:
    """What the first pass says of a picture."""

    size_px: tuple[int, int]
    looks: np.ndarray
    hits: Hits

    def cut(self, other: "_Looked") -> bool:
        """Whether another picture shows something else."""
        alike = self.size_px == other.size_px and self.looks.shape == other.looks.shape
        return not alike or bool(np.abs(self.looks - other.looks).mean() > _CUT)


@dataclass(frozen=True)
class _Task:
    """What the second pass knows of a picture.

    Args:
        file: Below the folders.
        cover: What its own series says: rows of box, score, kind.
        other: The other eye's picture and what its series says; none without.
    """

    file: str
    cover: list[list[Any]]
    other: tuple[str, list[list[Any]]] | None = None


@dataclass(frozen=True)
class _Covering:
    """Covers a picture and writes it."""

    root: Path
    out: Path
    how: How
    secret: bytes

    memory_bytes = 1_000_000_000

    def __call__(self, unit: Unit) -> Done:
        task: _Task = unit.parameters
        image = read_image(self.root / task.file, upright=True)
        hits, rows = _heard(task.cover), task.cover
        if task.other is not None:
            found = partners(read_image(self.root / task.other[0], upright=True), _heard(task.other[1]), image, hits)
            hits = Hits.joined([hits, found.hits])
            rows = _told(hits)
        height, width = image.shape[:2]
        path = self.out / task.file
        path.parent.mkdir(parents=True, exist_ok=True)
        write_image(path, covered(image, hits, self.how, self._noise(task.file)), quality=_QUALITY)
        share = float(mask_of(hits, width, height).mean())
        return Done(files=(path,), value={"size_px": [width, height], "covered": round(share, 6), "rows": rows})

    def _noise(self, file: str) -> np.random.Generator:
        """Noise of a picture, from a secret that is removed when all is done."""
        digest = hashlib.sha256(self.secret + file.encode()).digest()
        return np.random.default_rng(int.from_bytes(digest, "little"))


@dataclass(frozen=True)
class Covered:
    """What became of a picture.

    Args:
        file: Below the folders.
        size_px: Width and height.
        share: Share of its pixels that is covered.
        rows: What is covered: box, score, kind, track, how it was known.
    """

    file: str
    size_px: tuple[int, int]
    share: float
    rows: tuple[Mapping[str, Any], ...]

    @property
    def doubtful(self) -> list[Mapping[str, Any]]:
        """Weak boxes, and those that no detector saw in this very picture."""
        return [row for row in self.rows if row["score"] < _DOUBTFUL or row["how"] != HOWS[0]]


def anonymise(
    folders: Sequence[Series],
    out: Path,
    chosen: Anonymising | None = None,
    *,
    pairs: Sequence[tuple[int, int]] = (),
    find: Bulk = HERE,
    cover: Bulk = HERE,
) -> list[Covered]:
    """Cover all pictures and write them below another folder, with a log that holds no picture.

    Args:
        folders: Series of pictures below one root.
        out: Folder to write into; not the root, nor below it.
        chosen: How.
        pairs: Numbers of series that are two eyes of one pair: what is covered in one is covered in the other.
        find: Who looks for faces.
        cover: Who covers and writes.

    Returns:
        What became of each picture.

    Raises:
        ConfigError: If the folder to write into is the root's, or below it.
    """
    chosen = chosen or Anonymising()
    root = folders[0].root
    _check_apart(root, out)
    finders = chosen.finders()
    setting = chosen.setting(finders)
    found = _found(folders, out, chosen, setting, find)
    covers: dict[str, Cover] = {}
    for series in folders:
        looked = [found[file.as_posix()] for file in series.files]
        together = zip(series.files, looked, _linked(looked, series, chosen), strict=True)
        covers |= {file.as_posix(): cover.within(*each.size_px) for file, each, cover in together}
    tasks = _tasks(folders, covers, pairs)
    units = [Unit(f"{task.file} {_digest(task)}", _sources(root, task), task) for task in tasks]
    journal = Journal(out / JOURNAL, setting)
    run(_Covering(root, out, chosen.how, _secret(out)), units, cover, journal=journal)
    values = journal.values(unit.name for unit in units)
    done = [_covered(task, covers[task.file], value) for task, value in zip(tasks, values, strict=True)]
    _write_log(out / LOG, done, chosen, finders)
    (out / SECRET).unlink()
    return done


def _check_apart(root: Path, out: Path) -> None:
    here, there = root.resolve(), out.resolve()
    if there == here or here in there.parents:
        raise ConfigError(f"anonymize: expected a folder to write into that is not {root} nor below it; got {out}")


def _found(folders: Sequence[Series], out: Path, chosen: Anonymising, setting: str, bulk: Bulk) -> dict[str, _Looked]:
    """What the first pass says of each picture."""
    units = [Unit(file.as_posix(), (each.root / file,)) for each in folders for file in each.files]
    journal = Journal(out / FOUND, setting, files=False)
    run(_Finding(chosen), units, bulk, journal=journal)
    names = [unit.name for unit in units]
    told = zip(names, journal.values(names), strict=True)
    return {
        name: _Looked((each["size_px"][0], each["size_px"][1]), np.array(each["looks"]), _heard(each["hits"]))
        for name, each in told
    }


def _linked(looked: Sequence[_Looked], series: Series, chosen: Anonymising) -> list[Cover]:
    """What tracks say of a series; where the picture is suddenly another one, all tracks end."""
    hits = [each.hits for each in looked]
    if not chosen.together:
        return [linked([each], np.zeros(1), chosen.linking)[0] for each in hits]
    cuts = [0.0, *(float(one.cut(other)) for one, other in pairwise(looked))]
    return linked(hits, series.times_s + np.cumsum(cuts) * _APART_S, chosen.linking)


def _tasks(folders: Sequence[Series], covers: Mapping[str, Cover], pairs: Sequence[tuple[int, int]]) -> list[_Task]:
    """A task for each picture, with the other eye's where there is one of the same name."""
    partner: dict[str, str] = {}
    for one, other in pairs:
        left, right = ({file.stem: file.as_posix() for file in folders[number].files} for number in (one, other))
        for stem in left.keys() & right.keys():
            partner |= {left[stem]: right[stem], right[stem]: left[stem]}
    told = {file: _told(cover.hits) for file, cover in covers.items()}
    return [_Task(file, told[file], (partner[file], told[partner[file]]) if file in partner else None) for file in told]


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


def _covered(task: _Task, cover: Cover, value: Mapping[str, Any]) -> Covered:
    rows = []
    for number, row in enumerate(value["rows"]):
        own = number < len(cover.hits)
        how = HOWS[int(cover.how[number])] if own else "partner"
        track = int(cover.track[number]) if own else None
        rows.append({"kind": row[5], "box_px": row[:4], "score": row[4], "track": track, "how": how})
    return Covered(task.file, (value["size_px"][0], value["size_px"][1]), float(value["covered"]), tuple(rows))


def _write_log(path: Path, done: Iterable[Covered], chosen: Anonymising, finders: Sequence[Finder]) -> None:
    """A line of settings, then one a picture: no picture, no hash of covered pixels."""
    head = {"settings": asdict(chosen), "models": {finder.kind: finder.digest for finder in finders}}
    with open_atomic(path) as file:
        for line in [head, *({"file": each.file, "size_px": each.size_px, "covered": each.rows} for each in done)]:
            file.write(json.dumps(line).encode() + b"\n")

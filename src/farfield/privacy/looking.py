"""The first pass: what may have to be covered in a picture, and what a whole series says of it."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, UInt8

from farfield.privacy.covering import How
from farfield.privacy.faces import FaceDetector
from farfield.privacy.hits import ImageBoxes, overlap
from farfield.privacy.linking import HOWS, CoveredBoxes, LinkSettings, linked
from farfield.privacy.plates import PlateDetector, available

_DOUBTFUL, _HIDDEN_IOU = 0.3, 0.3
_PARTS, _CUT, _APART_S = 4, 28.0, 1e4


@runtime_checkable
class ImageFinder(Protocol):
    """Finds one kind of thing in a picture."""

    kind: str
    digest: str

    def __call__(self, image: np.ndarray) -> ImageBoxes:
        """The boxes in an RGB picture, shape (height, width, 3), uint8."""


@dataclass(frozen=True, kw_only=True)
class AnonymizeOptions:
    """How pictures are covered.

    Args:
        how: See :func:`~farfield.privacy.covering.covered`.
        small_faces: Look at the picture at twice its size too.
        plates: Cover number plates too, where torch is installed (:func:`without_plates` says why not).
        least_score: Weaker boxes are not even kept in mind.
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
        """Why plates stay as they are, in words; empty where they are covered or were not asked for."""
        return available() if self.plates else ""

    def setting(self) -> str:
        """All that decides the result besides the pictures."""
        return json.dumps([asdict(self), self.models()], sort_keys=True)

    def models(self) -> dict[str, str]:
        """SHA-256 of each detector's model."""
        return {finder.kind: finder.digest for finder in self.finders()}


@dataclass(frozen=True, eq=False)
class PictureFindings:
    """What the first pass says of a picture.

    Args:
        size_px: Width and height.
        looks: Mean grey of sixteen parts: enough to see that the next picture shows something else.
        hits: What may have to be covered.
    """

    size_px: tuple[int, int]
    looks: np.ndarray
    hits: ImageBoxes

    @classmethod
    def at(cls, image: UInt8[np.ndarray, "height width 3"], finders: Iterable[ImageFinder]) -> "PictureFindings":
        """Look at a picture."""
        rows = np.array_split(image.mean(axis=2), _PARTS)
        looks = [float(part.mean()) for row in rows for part in np.array_split(row, _PARTS, axis=1) if part.size]
        hits = ImageBoxes.joined([finder(image) for finder in finders])
        return cls((image.shape[1], image.shape[0]), np.array(looks).round(), hits)

    @classmethod
    def from_json(cls, told: Mapping[str, Any]) -> "PictureFindings":
        """From what :meth:`to_json` gave."""
        width, height = told["size_px"]
        return cls((int(width), int(height)), np.array(told["looks"], dtype=float), ImageBoxes.from_rows(told["hits"]))

    def to_json(self) -> dict[str, Any]:
        """As JSON takes it."""
        return {"size_px": list(self.size_px), "looks": self.looks.tolist(), "hits": self.hits.to_rows()}

    def cut(self, other: "PictureFindings") -> bool:
        """Whether another picture shows something else."""
        alike = self.size_px == other.size_px and self.looks.shape == other.looks.shape
        return not alike or bool(np.abs(self.looks - other.looks).mean() > _CUT)


def covers_of(
    looked: Sequence[PictureFindings], times_s: Float[np.ndarray, " n"], chosen: AnonymizeOptions
) -> list[CoveredBoxes]:
    """What to cover in each picture of a series; where the picture is suddenly another one, all tracks end."""
    hits = [each.hits for each in looked]
    if chosen.together:
        cuts = np.cumsum([0.0, *(float(one.cut(other)) for one, other in pairwise(looked))])[: len(looked)]
        covers = linked(hits, times_s + cuts * _APART_S, chosen.linking)
    else:
        covers = [linked([each], np.zeros(1), chosen.linking)[0] for each in hits]
    return [cover.within(*each.size_px) for cover, each in zip(covers, looked, strict=True)]


@dataclass(frozen=True)
class PictureSummary:
    """What became of a picture.

    Args:
        file: Below the folder that is written into.
        size_px: Width and height.
        share: Share of its pixels that is covered.
        rows: What is covered: kind, box_px, score, track, how it was known.
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
        """Weak boxes, and those that no detector saw in this very picture."""
        return [row for row in self.rows if row["score"] < _DOUBTFUL or row["how"] != HOWS[0]]

    def to_json(self) -> dict[str, Any]:
        """The line of the log."""
        at = {} if self.frame is None else {"frame": self.frame}
        return {"file": self.file, **at, "size_px": list(self.size_px), "covered": [dict(row) for row in self.rows]} | (
            {"left": [dict(row) for row in self.left]} if self.left else {}
        )


def left_of(seen: ImageBoxes, covered: ImageBoxes) -> tuple[dict[str, Any], ...]:
    """The boxes of the first pass that are not covered, for no strong one is on their track: the strongest first."""
    hidden = overlap(seen.box_px, covered.box_px).max(axis=1, initial=0.0) >= _HIDDEN_IOU
    centre = (seen.box_px[:, None, :2] + seen.box_px[:, None, 2:]) / 2
    inside = (centre >= covered.box_px[None, :, :2]) & (centre <= covered.box_px[None, :, 2:])
    left = seen[~hidden & ~inside.all(axis=2).any(axis=1)]
    order = np.argsort(-left.score, kind="stable")
    return tuple({"kind": row[5], "box_px": row[:4], "score": row[4]} for row in left[order].to_rows())


def rows_of(hits: ImageBoxes, cover: CoveredBoxes) -> tuple[dict[str, Any], ...]:
    """What is covered, a row a box: those of the cover first, then those that come from the other eye."""
    rows = []
    for number, row in enumerate(hits.to_rows()):
        own = number < len(cover.hits)
        how = HOWS[int(cover.how[number])] if own else "partner"
        track = int(cover.track[number]) if own else None
        rows.append({"kind": row[5], "box_px": row[:4], "score": row[4], "track": track, "how": how})
    return tuple(rows)

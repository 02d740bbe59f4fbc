"""Follow boxes over the pictures of a camera, so that one that is missed once does not uncover a face.

Weak boxes count only on a track that has a strong one. Gaps are bridged, both ends are prolonged: a detector finds a
face late and loses it early.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment

from farfield.privacy.hits import ImageBoxes, overlap

HOWS = ("found", "bridged", "extended")


@dataclass(frozen=True, kw_only=True)
class LinkSettings:
    """How boxes become tracks.

    Args:
        strong: Score that one box of a track must have.
        gap_s: Longest time that a track is bridged over, and from which on it has ended.
        extend_s: How long both ends are prolonged.
        growth: Share by which a prolonged box grows a picture.
        iou: Overlap from which two boxes may be one object.
    """

    strong: float = 0.3
    gap_s: float = 1.0
    extend_s: float = 0.3
    growth: float = 0.05
    iou: float = 0.3


@dataclass(eq=False)
class _Track:
    """Boxes of one object.

    Args:
        kind: Face or plate.
        places: Numbers of the pictures, rising.
        boxes: A box for each.
        scores: Their scores.
    """

    kind: str
    places: list[int] = field(default_factory=list)
    boxes: list[Float[np.ndarray, " 4"]] = field(default_factory=list)
    scores: list[float] = field(default_factory=list)

    def add(self, place: int, box: Float[np.ndarray, " 4"], score: float) -> None:
        self.places.append(place)
        self.boxes.append(box)
        self.scores.append(score)

    def speed(self, times_s: Float[np.ndarray, " n"], *, first: bool = False) -> Float[np.ndarray, " 4"]:
        """Change of the box a second at the track's end, or at its begin."""
        one, other = (0, 1) if first else (-2, -1)
        if len(self.places) < 2:
            return np.zeros(4)
        time_s = times_s[self.places[other]] - times_s[self.places[one]]
        return (self.boxes[other] - self.boxes[one]) / max(float(time_s), 1e-6)

    def at(self, times_s: Float[np.ndarray, " n"], place: int) -> Float[np.ndarray, " 4"]:
        """Where the box is expected next, going on as it went."""
        return self.boxes[-1] + self.speed(times_s) * (times_s[place] - times_s[self.places[-1]])


@dataclass(frozen=True, eq=False)
class CoveredBoxes:
    """What is covered in a picture.

    Args:
        hits: The boxes.
        track: Number of each one's track.
        how: Whether each was found, bridged or is a prolonged end, as a number of ``HOWS``.
    """

    hits: ImageBoxes
    track: np.ndarray
    how: np.ndarray

    def within(self, width: int, height: int) -> "CoveredBoxes":
        """The boxes cut at a picture's edges, without those that lie outside."""
        seen = self.hits.touch(width, height)
        return CoveredBoxes(self.hits[seen].within(width, height), self.track[seen], self.how[seen])


def linked(
    found: Sequence[ImageBoxes], times_s: Float[np.ndarray, " n"], linking: LinkSettings | None = None
) -> list[CoveredBoxes]:
    """What to cover in the pictures of one camera.

    Args:
        found: Boxes of each picture, in order of time, weak ones included.
        times_s: When each was taken, rising.
        linking: How boxes become tracks.
    """
    linking = linking or LinkSettings()
    tracks = [track for track in _tracks(found, times_s, linking) if max(track.scores) >= linking.strong]
    rows: list[list[tuple[Float[np.ndarray, " 4"], float, str, int, int]]] = [[] for _ in found]
    for number, track in enumerate(tracks):
        for place, box, score, how in _whole(track, times_s, linking):
            rows[place].append((box, score, track.kind, number, how))
    return [_cover(each) for each in rows]


def _cover(rows: list[tuple[Float[np.ndarray, " 4"], float, str, int, int]]) -> CoveredBoxes:
    boxes, scores, kinds, tracks, hows = zip(*rows, strict=True) if rows else ((), (), (), (), ())
    hits = ImageBoxes(np.array(boxes).reshape(-1, 4), np.array(scores, dtype=float), np.array(kinds, dtype="<U8"))
    return CoveredBoxes(hits, np.array(tracks, dtype=np.int64), np.array(hows, dtype=np.int64))


def _tracks(found: Sequence[ImageBoxes], times_s: Float[np.ndarray, " n"], linking: LinkSettings) -> list[_Track]:
    ended: list[_Track] = []
    running: list[_Track] = []
    for place, hits in enumerate(found):
        still = [t for t in running if times_s[place] - times_s[t.places[-1]] <= linking.gap_s]
        ended += [track for track in running if track not in still]
        running, taken = still, set[int]()
        for track, row in _pairs(running, hits, times_s, place, linking):
            running[track].add(place, hits.box_px[row], float(hits.score[row]))
            taken.add(row)
        for row in set(range(len(hits))) - taken:
            running.append(_Track(str(hits.kind[row]), [place], [hits.box_px[row]], [float(hits.score[row])]))
    return ended + running


def _pairs(
    tracks: Sequence[_Track], hits: ImageBoxes, times_s: Float[np.ndarray, " n"], place: int, linking: LinkSettings
) -> list[tuple[int, int]]:
    """Tracks and boxes that belong together: overlapping, or centres nearer than the box is large."""
    if not tracks or not len(hits):
        return []
    expected = np.stack([track.at(times_s, place) for track in tracks])
    iou = overlap(expected, hits.box_px)
    off = (expected[:, None, :2] + expected[:, None, 2:] - hits.box_px[None, :, :2] - hits.box_px[None, :, 2:]) / 2
    size = np.sqrt(np.maximum((hits.box_px[:, 2:] - hits.box_px[:, :2]).prod(axis=1), 1.0))
    near = np.linalg.norm(off, axis=-1) / size[None]
    alike = np.array([[track.kind == kind for kind in hits.kind] for track in tracks])
    allowed = ((iou >= linking.iou) | (near < 1)) & alike
    cost = np.where(allowed, near - iou, 1e6)
    return [(int(i), int(j)) for i, j in zip(*linear_sum_assignment(cost), strict=True) if allowed[i, j]]


def _whole(
    track: _Track, times_s: Float[np.ndarray, " n"], linking: LinkSettings
) -> list[tuple[int, Float[np.ndarray, " 4"], float, int]]:
    """A track's boxes with its gaps bridged and both ends prolonged."""
    rows = [(p, b, s, 0) for p, b, s in zip(track.places, track.boxes, track.scores, strict=True)]
    for (one, a), (other, b) in pairwise(zip(track.places, track.boxes, strict=True)):
        for place in range(one + 1, other):
            share = (times_s[place] - times_s[one]) / max(float(times_s[other] - times_s[one]), 1e-6)
            rows.append((place, a + share * (b - a), min(track.scores), 1))
    rows += _end(track, times_s, linking, step=1) + _end(track, times_s, linking, step=-1)
    return sorted(rows, key=_place)


def _place(row: tuple[int, Float[np.ndarray, " 4"], float, int]) -> int:
    return row[0]


def _end(
    track: _Track, times_s: Float[np.ndarray, " n"], linking: LinkSettings, *, step: int
) -> list[tuple[int, Float[np.ndarray, " 4"], float, int]]:
    """The prolonged end, or begin, of a track."""
    last, box = (track.places[-1], track.boxes[-1]) if step > 0 else (track.places[0], track.boxes[0])
    speed, rows = track.speed(times_s, first=step < 0), []
    place = last + step
    while 0 <= place < len(times_s) and abs(times_s[place] - times_s[last]) <= linking.extend_s + 1e-9:
        moved = box + speed * (times_s[place] - times_s[last])
        half = np.maximum(moved[2:] - moved[:2], 1.0) / 2 * (1 + linking.growth * abs(place - last))
        middle = (moved[:2] + moved[2:]) / 2
        rows.append((place, np.concatenate([middle - half, middle + half]), min(track.scores), 2))
        place += step
    return rows

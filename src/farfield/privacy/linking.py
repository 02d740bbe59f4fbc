"""Link boxes over the pictures of a camera, so that a face missed once stays covered, and over the eyes of a pair.

Over time: weak boxes count only on a track that has a strong one, and what is a plate in one picture of many is none.
Gaps are bridged, both ends are prolonged: a detector
finds a face late and loses it early. Where the picture suddenly shows something else, all tracks end.

Over the eyes: what is covered in one picture of a stereo pair, or one half of a picture that holds both eyes, is
covered in the other too.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, UInt8
from scipy.optimize import linear_sum_assignment

from farfield.privacy.detectors import ImageFinder, find_boxes
from farfield.privacy.image_boxes import PLATE, ImageBoxes, pairwise_iou

ORIGINS = ("found", "bridged", "extended")
"""How a covered box came about: detected, between two detections, or beyond the ends of a track."""

MANY_PICTURES = 5
_GREY_PARTS, _CUT_GREY, _CUT_S = 4, 28.0, 1e4
_PARTNER_ROWS, _PARTNER_COLUMNS = 0.02, 0.25  # how far off a partner may lie, over the picture's height and width
_PARTNER_CORRELATION, _PARTNER_IOU = 0.6, 0.2
_PARTNER_LEAST_PX = 6
_Picture = UInt8[np.ndarray, "height width 3"]
_Box = Float[np.ndarray, " 4"]
_Times = Float[np.ndarray, " n"]


@dataclass(frozen=True, kw_only=True)
class LinkSettings:
    """How boxes become tracks.

    Args:
        strong: Score that one box of a track must have.
        gap_s: Longest time that a track is bridged over, and from which on it has ended.
        extend_s: How long both ends are prolonged.
        growth: Share by which a prolonged box grows a picture.
        iou: Overlap from which two boxes may be one object.
        plate_sightings: In how many pictures a plate must be detected, where :data:`MANY_PICTURES` or more lie within
            half of ``gap_s`` of it: a plate stays on its vehicle, what shines for a moment does not.
    """

    strong: float = 0.3
    gap_s: float = 1.0
    extend_s: float = 0.3
    growth: float = 0.05
    iou: float = 0.3
    plate_sightings: int = 2


@dataclass(frozen=True, eq=False)
class PictureFindings:
    """What the detectors say of a picture by itself.

    Args:
        size_px: Width and height.
        greys: Mean grey of sixteen parts: enough to tell that the next picture shows something else.
        boxes: What may have to be covered.
    """

    size_px: tuple[int, int]
    greys: np.ndarray
    boxes: ImageBoxes

    @classmethod
    def in_image(cls, image: _Picture, finders: Iterable[ImageFinder]) -> "PictureFindings":
        """Run the detectors on a picture."""
        bands = np.array_split(image.mean(axis=2), _GREY_PARTS)
        parts = [part for band in bands for part in np.array_split(band, _GREY_PARTS, axis=1)]
        greys = [float(part.mean()) for part in parts if part.size]
        return cls((image.shape[1], image.shape[0]), np.array(greys).round(), find_boxes(image, finders))

    @classmethod
    def from_json(cls, entry: Mapping[str, Any]) -> "PictureFindings":
        """From :meth:`to_json`."""
        width, height = entry["size_px"]
        greys, boxes = np.array(entry["looks"], dtype=float), ImageBoxes.from_rows(entry["hits"])
        return cls((int(width), int(height)), greys, boxes)

    def to_json(self) -> dict[str, Any]:
        """As JSON takes it."""
        return {"size_px": list(self.size_px), "looks": self.greys.tolist(), "hits": self.boxes.to_rows()}

    def is_cut_to(self, following: "PictureFindings") -> bool:
        """Whether the following picture shows something else."""
        comparable = self.size_px == following.size_px and self.greys.shape == following.greys.shape
        return not comparable or bool(np.abs(self.greys - following.greys).mean() > _CUT_GREY)


@dataclass(frozen=True, eq=False)
class CoveredBoxes:
    """What is covered in a picture.

    Args:
        boxes: The boxes.
        track: Number of each box's track.
        origin: Index in :data:`ORIGINS` of each box.
    """

    boxes: ImageBoxes
    track: np.ndarray
    origin: np.ndarray

    def within(self, width: int, height: int) -> "CoveredBoxes":
        """The boxes cut at a picture's edges, without those that lie outside."""
        inside = self.boxes.touches(width, height)
        return CoveredBoxes(self.boxes[inside].within(width, height), self.track[inside], self.origin[inside])


def link_series(
    findings: Sequence[PictureFindings], times_s: _Times, linking: LinkSettings, *, together: bool = True
) -> list[CoveredBoxes]:
    """What to cover in each picture of a series, cut at its edges.

    Args:
        findings: Of each picture, in order of time.
        times_s: When each was taken, rising.
        linking: How boxes become tracks.
        together: Whether the pictures follow one another; else each stands alone.
    """
    boxes = [finding.boxes for finding in findings]
    if together:
        cuts = np.cumsum([0.0, *(float(one.is_cut_to(other)) for one, other in pairwise(findings))])[: len(findings)]
        covers = link_boxes(boxes, times_s + cuts * _CUT_S, linking)
    else:
        covers = [link_boxes([alone], np.zeros(1), linking)[0] for alone in boxes]
    return [cover.within(*finding.size_px) for cover, finding in zip(covers, findings, strict=True)]


class _TrackBox(NamedTuple):
    """A box of a track in one picture."""

    picture: int
    box: _Box
    score: float
    origin: int


@dataclass(eq=False)
class _BoxTrack:
    """Boxes of one object in rising order of pictures."""

    kind: str
    pictures: list[int]
    boxes: list[_Box]
    scores: list[float]

    def velocity(self, times_s: _Times, *, at_start: bool = False) -> _Box:
        """Change of the box a second at the track's end, or at its start."""
        if len(self.pictures) < 2:
            return np.zeros(4)
        one, other = (0, 1) if at_start else (-2, -1)
        step_s = times_s[self.pictures[other]] - times_s[self.pictures[one]]
        return (self.boxes[other] - self.boxes[one]) / max(float(step_s), 1e-6)

    def counts(self, times_s: _Times, linking: LinkSettings) -> bool:
        """Whether it is covered: one strong box, and of a plate several boxes where there are many pictures."""
        if max(self.scores) < linking.strong:
            return False
        first_s, last_s = times_s[self.pictures[0]] - linking.gap_s / 2, times_s[self.pictures[-1]] + linking.gap_s / 2
        near = int(((times_s >= first_s) & (times_s <= last_s)).sum())
        return self.kind != PLATE or near < MANY_PICTURES or len(self.pictures) >= linking.plate_sightings

    def predict(self, times_s: _Times, picture: int) -> _Box:
        """The box at constant velocity."""
        return self.boxes[-1] + self.velocity(times_s) * (times_s[picture] - times_s[self.pictures[-1]])


def link_boxes(boxes: Sequence[ImageBoxes], times_s: _Times, linking: LinkSettings | None = None) -> list[CoveredBoxes]:
    """What to cover in the pictures of one camera.

    Args:
        boxes: Of each picture, in order of time, weak ones included.
        times_s: When each was taken, rising.
        linking: How boxes become tracks.
    """
    linking = linking or LinkSettings()
    # 1. Tracks by assignment, picture after picture; weak boxes count only on a track with a strong one.
    tracks = [track for track in _build_tracks(boxes, times_s, linking) if track.counts(times_s, linking)]
    rows: list[list[tuple[int, str, _TrackBox]]] = [[] for _ in boxes]
    for number, track in enumerate(tracks):
        # 2. Bridge the gaps. 3. Prolong the start and the end.
        prolonged = _prolong(track, times_s, linking, step=1) + _prolong(track, times_s, linking, step=-1)
        for row in (*_bridge(track, times_s), *prolonged):
            rows[row.picture].append((number, track.kind, row))
    return [_covered_boxes(picture) for picture in rows]


def _covered_boxes(rows: list[tuple[int, str, _TrackBox]]) -> CoveredBoxes:
    """The boxes of one picture, in the order of their tracks."""
    box_px = np.array([row.box for *_, row in rows]).reshape(-1, 4)
    kinds = np.array([kind for _, kind, _ in rows], dtype="<U8")
    boxes = ImageBoxes(box_px, np.array([row.score for *_, row in rows], dtype=float), kinds)
    tracks = np.array([number for number, *_ in rows], dtype=np.int64)
    return CoveredBoxes(boxes, tracks, np.array([row.origin for *_, row in rows], dtype=np.int64))


def _build_tracks(boxes: Sequence[ImageBoxes], times_s: _Times, linking: LinkSettings) -> list[_BoxTrack]:
    """Tracks of detected boxes: those that ended first, then those that reach the last picture."""
    ended: list[_BoxTrack] = []
    active: list[_BoxTrack] = []
    for picture, detections in enumerate(boxes):
        alive = [track for track in active if times_s[picture] - times_s[track.pictures[-1]] <= linking.gap_s]
        ended += [track for track in active if track not in alive]
        active, matched = alive, set[int]()
        for number, row in _match(active, detections, times_s, picture, linking):
            track = active[number]
            track.pictures.append(picture)
            track.boxes.append(detections.box_px[row])
            track.scores.append(float(detections.score[row]))
            matched.add(row)
        for row in set(range(len(detections))) - matched:
            kind, score = str(detections.kind[row]), float(detections.score[row])
            active.append(_BoxTrack(kind, [picture], [detections.box_px[row]], [score]))
    return ended + active


def _match(
    tracks: Sequence[_BoxTrack], detections: ImageBoxes, times_s: _Times, picture: int, linking: LinkSettings
) -> list[tuple[int, int]]:
    """Tracks and boxes that belong together: overlapping, or centres nearer than the box is large."""
    if not tracks or not len(detections):
        return []
    predicted, box_px = np.stack([track.predict(times_s, picture) for track in tracks]), detections.box_px
    iou = pairwise_iou(predicted, box_px)
    offset_px = (predicted[:, None, :2] + predicted[:, None, 2:] - box_px[None, :, :2] - box_px[None, :, 2:]) / 2
    size_px = np.sqrt(np.maximum((box_px[:, 2:] - box_px[:, :2]).prod(axis=1), 1.0))
    distance = np.linalg.norm(offset_px, axis=-1) / size_px[None]
    same_kind = np.array([[track.kind == kind for kind in detections.kind] for track in tracks])
    allowed = ((iou >= linking.iou) | (distance < 1)) & same_kind
    cost = np.where(allowed, distance - iou, 1e6)
    return [(int(i), int(j)) for i, j in zip(*linear_sum_assignment(cost), strict=True) if allowed[i, j]]


def _bridge(track: _BoxTrack, times_s: _Times) -> list[_TrackBox]:
    """A track's own boxes, and between them boxes on a straight line."""
    rows = [_TrackBox(*row, 0) for row in zip(track.pictures, track.boxes, track.scores, strict=True)]
    for (first, before), (last, after) in pairwise(zip(track.pictures, track.boxes, strict=True)):
        for picture in range(first + 1, last):
            share = (times_s[picture] - times_s[first]) / max(float(times_s[last] - times_s[first]), 1e-6)
            rows.append(_TrackBox(picture, before + share * (after - before), min(track.scores), 1))
    return rows


def _prolong(track: _BoxTrack, times_s: _Times, linking: LinkSettings, *, step: int) -> list[_TrackBox]:
    """Growing boxes beyond the end of a track, or before its start."""
    end = -1 if step > 0 else 0
    last, box = track.pictures[end], track.boxes[end]
    velocity, rows = track.velocity(times_s, at_start=step < 0), []
    picture = last + step
    while 0 <= picture < len(times_s) and abs(times_s[picture] - times_s[last]) <= linking.extend_s + 1e-9:
        moved = box + velocity * (times_s[picture] - times_s[last])
        half = np.maximum(moved[2:] - moved[:2], 1.0) / 2 * (1 + linking.growth * abs(picture - last))
        centre = (moved[:2] + moved[2:]) / 2
        rows.append(_TrackBox(picture, np.concatenate([centre - half, centre + half]), min(track.scores), 2))
        picture += step
    return rows


class Partners(NamedTuple):
    """What the other eye's picture lacks.

    Attributes:
        boxes: Boxes to cover there besides.
        lost: Boxes of this picture without a partner: hidden there, or outside of it.
    """

    boxes: ImageBoxes
    lost: ImageBoxes


def find_partners(image: _Picture, boxes: ImageBoxes, other: _Picture, covered: ImageBoxes) -> Partners:
    """Find the partners of a picture's boxes in the other eye's, which are not among those covered there anyway.

    A partner lies in about the same rows and looks alike: normalised correlation of at least 0.6.

    Args:
        image: This eye's picture, uncovered.
        boxes: Its boxes.
        other: The other eye's, of the same size and time.
        covered: The boxes that are covered there anyway.
    """
    partners, rows, lost = list[_Box](), list[int](), list[int]()
    for row in range(len(boxes)):
        partner = _match_template(image, boxes.box_px[row].clip(min=0), other)
        if partner is None:
            lost.append(row)
        elif not len(covered) or pairwise_iou(partner[None], covered.box_px).max() < _PARTNER_IOU:
            partners.append(partner)
            rows.append(row)
    sources = boxes[np.array(rows, dtype=np.int64)]
    partner_boxes = ImageBoxes(np.array(partners).reshape(-1, 4), sources.score, sources.kind)
    return Partners(partner_boxes, boxes[np.array(lost, dtype=np.int64)])


def find_partners_in_halves(image: _Picture, boxes: ImageBoxes) -> ImageBoxes:
    """What the halves of a picture that holds both eyes, left and right, lack of one another.

    Args:
        image: Both eyes' picture, uncovered; an odd column in the middle belongs to none.
        boxes: Boxes of the whole picture; those that reach over the middle are in both eyes already.

    Returns:
        Boxes to cover besides, in the whole picture's pixels.
    """
    half = image.shape[1] // 2
    shift = np.array([image.shape[1] - half, 0.0] * 2)
    left, right = image[:, :half], image[:, -half:]
    is_left = boxes.box_px[:, [0, 2]].mean(axis=1) < image.shape[1] / 2
    left_boxes, right_boxes = boxes[is_left], replace(boxes[~is_left], box_px=boxes[~is_left].box_px - shift)
    to_right = find_partners(left, left_boxes, right, right_boxes).boxes
    to_left = find_partners(right, right_boxes, left, left_boxes).boxes
    return ImageBoxes.concatenate([replace(to_right, box_px=to_right.box_px + shift), to_left])


def _match_template(image: _Picture, box: _Box, other: _Picture) -> _Box | None:
    """Where the other picture looks like the inside of a box; None where nothing is alike."""
    import cv2

    left, top = np.floor(box[:2]).astype(int)
    right, bottom = np.ceil(box[2:]).astype(int)
    template = image[top:bottom, left:right]
    if min(template.shape[:2]) < _PARTNER_LEAST_PX or float(template.std()) < 1.0:
        return None
    height, width = other.shape[:2]
    margin_y, margin_x = max(2, round(_PARTNER_ROWS * height)), round(_PARTNER_COLUMNS * width)
    first_row, first_column = max(0, top - margin_y), max(0, left - margin_x)
    region = other[first_row : min(height, bottom + margin_y), first_column : min(width, right + margin_x)]
    if region.shape[0] < template.shape[0] or region.shape[1] < template.shape[1]:
        return None
    scores = cv2.matchTemplate(np.ascontiguousarray(region), np.ascontiguousarray(template), cv2.TM_CCOEFF_NORMED)
    row, column = np.unravel_index(int(scores.argmax()), scores.shape)
    if not scores[row, column] >= _PARTNER_CORRELATION:
        return None
    corner = np.array([first_column + column, first_row + row], dtype=float)
    return np.concatenate([corner, corner + np.array([right - left, bottom - top])])

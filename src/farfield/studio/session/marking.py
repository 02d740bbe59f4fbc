"""Which frames are worth a look: where a set of predictions misses boxes, or finds what is not there."""

from collections.abc import Sequence
from functools import partial

from farfield.studio.messages import requests as asked
from farfield.studio.messages.replies import Matches
from farfield.studio.messages.rows import BoxRow, MatchRow
from farfield.studio.session.desk import Session
from farfield.studio.session.window import ClientWindow
from farfield.studio.showing.predictions import Predictions
from farfield.studio.showing.rows import annotated_rows

_AT_ONCE = 20
"""Frames of a part: few, so that marks appear soon and a thread is free for what a person waits for."""


async def match_list(desk: Session, window: ClientWindow, request: asked.MatchList) -> None:
    """Match all frames of all sets, part by part."""
    window.matching = token = object()
    desk.aside(window, None, _matched(desk, window, request.threshold, token))


async def _matched(desk: Session, window: ClientWindow, threshold: float, token: object) -> None:
    places = {key: index for index, key in enumerate(desk.book.data.keys)}
    for found in list(desk.book.sets.values()):
        frames = sorted(places[key] for key in list(found.boxes) if key in places)
        for start in range(0, max(1, len(frames)), _AT_ONCE):
            rows = await desk.in_thread(partial(_rows, desk, found, frames[start : start + _AT_ONCE], threshold))
            if window.matching is not token or desk.windows.get(window.id) is not window:
                return
            window.send(Matches(set=found.about.name, first=start == 0, rows=rows))


def _rows(desk: Session, found: Predictions, frames: Sequence[int], threshold: float) -> tuple[MatchRow, ...]:
    reference = desk.book.data[frames[0]].reference if frames else ""
    return tuple(row for index in frames if (row := _row(desk, found, index, reference, threshold)) is not None)


def _row(desk: Session, found: Predictions, index: int, reference: str, threshold: float) -> MatchRow | None:
    """Of one frame; None where nothing is wrong, or nothing was annotated and so nothing can be."""
    shown = found.frame(desk.book.data.keys[index], _truth(desk, index), reference, threshold=threshold)
    if shown is None:
        return None
    wrong = sum(row.match == "false" for row in shown.rows)
    return MatchRow(frame=index, missed=len(shown.missed), wrong=wrong) if shown.missed or wrong else None


def _truth(desk: Session, index: int) -> tuple[BoxRow, ...]:
    """The annotated boxes of a frame as they stand, no cloud read."""
    if desk.annotating is not None:
        return desk.annotating.outlines(index)
    annotation = desk.book.data.annotation(index)
    return () if annotation is None else annotated_rows(annotation)

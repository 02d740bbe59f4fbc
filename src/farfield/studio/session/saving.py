"""From the journal to the label files: at a request, every half minute, and when the studio ends."""

import asyncio
import time
from functools import partial

from farfield.annotation.saving import SaveSummary, UnwrittenError
from farfield.annotation.store import Author
from farfield.errors import FarfieldError
from farfield.studio.messages import requests
from farfield.studio.messages.replies import Failure, Saved
from farfield.studio.messages.rows import UnwrittenRow
from farfield.studio.session.session import ClientWindow, Session, handles
from farfield.studio.showing.annotations import AnnotationService, SaveChoice
from farfield.studio.showing.opened import plain_error
from farfield.studio.showing.rows import box_id
from farfield.vocabulary.counts import count_of

AUTOSAVE_S = 30.0
_EDITS_SAFE = "your edits are safe in the journal; fix the cause and save again"


@handles(requests.SaveChoose)
async def choose(session: Session, window: ClientWindow, request: requests.SaveChoose) -> None:
    """Choose where labels are written to; all windows hear of it."""
    del window
    annotation = session.annotation
    annotation.choose(SaveChoice(request.folder, request.format, request.at_exit))
    session.broadcast(await session.in_thread(partial(annotation.labels, request.id)))


@handles(requests.Save)
async def save(session: Session, window: ClientWindow, request: requests.Save) -> None:
    """Write the label files."""
    session.aside(window, request.id, _save(session, window, session.annotation, request))


async def _save(session: Session, window: ClientWindow, annotation: AnnotationService, request: requests.Save) -> None:
    choice = annotation.choice
    if request.folder is not None or request.format:
        choice = SaveChoice(request.folder, request.format)
    author = Author(window.annotator, window.id)
    written = partial(session.in_thread, partial(_written, annotation, author, request.id, choice))
    summary = await session.once(request, written)
    files = f"{count_of(summary.files, 'label file')} written to {summary.folder}"
    window.send(_saved(session, request.id, summary, files))
    session.broadcast(await session.in_thread(annotation.labels))


def _written(annotation: AnnotationService, author: Author, id: str, choice: SaveChoice) -> SaveSummary:
    """What a save wrote, also where not all could be."""
    try:
        return annotation.annotator.save(author, id, folder=choice.folder, format=choice.format)
    except UnwrittenError as error:
        return error.summary


def _saved(session: Session, id: str, summary: SaveSummary, sentence: str = "") -> Saved:
    """That label files were written, and which boxes were not."""
    store, data = session.annotation.store, session.data
    rows = []
    for key, name, reason in summary.unwritten:
        index = store.index_of[key]
        rows.append(
            UnwrittenRow(frame=index, box=box_id(index, name) if name else None, sentence=plain_error(reason, data))
        )
    return Saved(
        id=id,
        seq=summary.seq,
        files=summary.files,
        saved_ns=str(time.time_ns()),
        folder=summary.folder,
        sentence=sentence,
        unwritten=tuple(rows),
    )


async def autosave(session: Session) -> None:
    """Write label files every half minute, where saves go into them: what is in the journal is safe without."""
    while True:
        await asyncio.sleep(AUTOSAVE_S)
        await save_now(session)


async def save_now(session: Session) -> str:
    """Write label files that lack edits, where saves go into them; what went wrong, empty if nothing did."""
    annotation = session.annotating
    if annotation is None or not annotation.in_place:
        return ""
    return await _save_lacking(session, annotation, SaveChoice())


async def _save_lacking(session: Session, annotation: AnnotationService, choice: SaveChoice) -> str:
    """Save where the label files of a choice lack edits; what went wrong, empty if nothing did."""
    lacking = partial(annotation.annotator.unwritten, folder=choice.folder, format=choice.format)
    return await _save_by_itself(session, annotation, choice) if await session.in_thread(lacking) else ""


async def _save_by_itself(session: Session, annotation: AnnotationService, choice: SaveChoice) -> str:
    """Save without being asked by a window, and tell all of them; what went wrong, empty if nothing did."""
    id, author = f"autosave-{time.time_ns()}", Author(session.annotator, "")
    try:
        summary = await session.in_thread(partial(_written, annotation, author, id, choice))
    except Exception as error:  # noqa: BLE001 - whatever it is: the next save comes in half a minute
        foreign = not isinstance(error, FarfieldError)
        reason = session.refusal(None, error).sentence if foreign else plain_error(error, session.data)
        session.broadcast(Failure(sentence=f"the label files could not be saved: {reason}", mend=_EDITS_SAFE))
        return reason if foreign else str(error)
    session.broadcast(_saved(session, id, summary))
    session.broadcast(await session.in_thread(annotation.labels))
    return ""


async def save_at_exit(session: Session) -> str:
    """Write what label files lack, where saves go into them or where it was asked for; what is where, in words."""
    annotation = session.annotating
    if annotation is None:
        return ""
    failures = [await save_now(session)]
    if annotation.choice.at_exit:
        failures.append(await _save_lacking(session, annotation, annotation.choice))
    failure = " ".join(filter(None, dict.fromkeys(failures)))
    why = f" The labels could not be written: {failure}" if failure else ""
    labels = await session.in_thread(annotation.labels)
    edits = count_of(labels.unwritten, "edit")
    if labels.unwritten:
        return (
            f"{edits} kept in the journal ({annotation.store.folder}) and in no label file: open the data set again "
            f"and press Ctrl+S, or end with --save-at-exit.{why}"
        )
    if labels.left:
        return f"labels written to {labels.folder}; {labels.left} boxes cannot be, and are in the journal.{why}"
    return (
        f"labels written to {labels.folder} as {labels.format}.{why}" if labels.written_ns is not None else why.strip()
    )

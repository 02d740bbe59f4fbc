"""Exports on demand: films of pictures that the page sent, one HTML file of some frames, labels in a format."""

import traceback
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from farfield.annotation.saving import FORMATS, pack
from farfield.datasets.base import Dataset
from farfield.errors import ConfigError, FarfieldError
from farfield.files.atomic import write_text
from farfield.files.images import write_animation
from farfield.studio.exports import MOST_FRAMES, ExportedFile, standalone
from farfield.studio.messages import requests
from farfield.studio.messages.replies import FrameState, Job
from farfield.studio.messages.rows import Layer
from farfield.studio.options import StudioSettings
from farfield.studio.session.detecting import detect_in
from farfield.studio.session.frame_cache import FrameCache, first_of
from farfield.studio.session.session import ClientWindow, Session, handles
from farfield.studio.session.viewing import welcome
from farfield.studio.showing.opened import STATIC, plain_error


@handles(requests.Export)
async def export(session: Session, window: ClientWindow, request: requests.Export) -> None:
    """Make a file; its link comes with the job that is done."""
    work = _film if request.kind in ("gif", "webp") else _page if request.kind == "html" else _labels
    session.aside(window, request.id, _export(session, window, request, work))


Work = Callable[[Session, ClientWindow, requests.Export], tuple[str, ExportedFile]]


async def _export(session: Session, window: ClientWindow, request: requests.Export, work: Work) -> None:
    window.send(Job(id=request.id, job=f"make-{request.id}", kind="export", state="running", total=1))
    window.send(await session.once(request, partial(_made, session, window, request, work)))


async def _made(session: Session, window: ClientWindow, request: requests.Export, work: Work) -> Job:
    """The job of a file that is made, or could not be."""
    job = Job(id=request.id, job=f"make-{request.id}", kind="export", state="failed", total=1)
    try:
        name, file = await session.in_thread(lambda: work(session, window, request))
    except FarfieldError as error:
        return replace(job, message=plain_error(error, session.data))
    except Exception:  # noqa: BLE001
        traceback.print_exc()
        return replace(job, message="the studio met an error of its own; its terminal shows it")
    size = file.path.stat().st_size / 1e6
    message = f"{file.name}: {size:.1f} MB"
    return replace(job, state="done", done=1, url=f"export/{name}", message=message)


def _film(session: Session, window: ClientWindow, request: requests.Export) -> tuple[str, ExportedFile]:
    del window
    name, file = session.exports.new(request.name, f".{request.kind}")
    write_animation(file.path, session.exports.shots(request.shots), rate_hz=request.rate_hz)
    return name, file


def _page(session: Session, window: ClientWindow, request: requests.Export) -> tuple[str, ExportedFile]:
    text = page_of(session, window, request.frames)
    name, file = session.exports.new(request.name, ".html")
    write_text(file.path, text)
    return name, file


def page_of(session: Session, window: ClientWindow, frames: tuple[int, ...]) -> str:
    """The HTML file of some frames.

    Raises:
        ConfigError: If there are none or too many.
    """
    if len(frames) > MOST_FRAMES:
        raise ConfigError(f"html: expected at most {MOST_FRAMES} frames, got {len(frames)}: choose fewer")
    states = [session.frames.state(index, window.threshold) for index in dict.fromkeys(frames)]
    payloads = {layer.url: _body(session.frames, state, layer) for state in states for layer in state.layers}
    first = states[0].frame.index if states else 0
    hello = replace(welcome(session, window), mode="view", detectors=(), first=first, written=None, bookmarks=())
    return standalone(STATIC, replace(hello, store=""), states, payloads)


def write_page(data: Dataset, settings: StudioSettings, frames: Sequence[str], path: Path) -> None:
    """Write the HTML file of some frames without a browser, with the boxes of the detectors that the settings name.

    Args:
        data: The data set.
        settings: As of a studio.
        frames: Numbers of the frames, or ``sequence/frame``; the first one where there are none.
        path: The file.

    Raises:
        FarfieldError: If there is no such frame, there are too many, a detector fails, or the page is not built.
    """
    session = Session(settings)
    try:
        session.open(data)
        indices = tuple(first_of(frame, data) for frame in frames or ("",))
        if len(indices) <= MOST_FRAMES:  # else they are refused below
            detect_in(session, indices)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, page_of(session, ClientWindow(id="file", annotator="", threshold=settings.threshold), indices))
    finally:
        session.threads.end()
        session.exports.close()


def _body(frames: FrameCache, state: FrameState, layer: Layer) -> bytes:
    index, opened = state.frame.index, frames.opened
    if layer.kind == "points":
        return opened.cloud(index, layer.id).body
    if layer.kind == "image":
        return opened.picture(index, layer.id).body
    return opened.radar_map(index, layer.kind).body


def _labels(session: Session, window: ClientWindow, request: requests.Export) -> tuple[str, ExportedFile]:
    if session.annotating is None:
        raise ConfigError("export: labels are exported in `farfield annotate`; `farfield convert` converts data sets")
    del window
    name, file = session.exports.new(request.name, ".zip")
    format = request.format or FORMATS[0]
    pack(session.annotating.store, format, request.frames, session.exports.folder / name, file.path)
    return name, file

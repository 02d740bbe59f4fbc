"""Exports on demand: films of pictures that the page sent, one HTML file of some frames, labels in a format."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from farfield.datasets.base import Dataset
from farfield.errors import ConfigError, FarfieldError
from farfield.files.animations import write_animation
from farfield.files.atomic import write_text
from farfield.studio.annotating.saves import FORMATS, pack
from farfield.studio.exports import MOST_FRAMES, ExportedFile, standalone
from farfield.studio.messages import requests as asked
from farfield.studio.messages.replies import FrameState, Job
from farfield.studio.messages.rows import Layer
from farfield.studio.options import StudioSettings
from farfield.studio.session.frame_cache import FrameCache, first_of
from farfield.studio.session.session import ClientWindow, Session
from farfield.studio.session.viewing import welcome
from farfield.studio.showing.opened import STATIC, plain_error

_NUMBERS = itertools.count(1)


async def export(desk: Session, window: ClientWindow, request: asked.Export) -> None:
    """Make a file; its link comes with the job that is done."""
    work = _film if request.kind in ("gif", "webp") else _page if request.kind == "html" else _labels
    desk.aside(window, request.id, _made(desk, window, request, work))


Work = Callable[[Session, ClientWindow, asked.Export], tuple[str, ExportedFile]]


async def _made(desk: Session, window: ClientWindow, request: asked.Export, work: Work) -> None:
    job = Job(id=request.id, job=f"make-{next(_NUMBERS)}", kind="export", state="running", total=1)
    window.send(job)
    try:
        name, made = await desk.in_thread(lambda: work(desk, window, request))
    except FarfieldError as error:
        window.send(replace(job, state="failed", message=plain_error(error, desk.data)))
        return
    except Exception:
        window.send(replace(job, state="failed", message="the studio met an error of its own"))
        raise
    size = made.path.stat().st_size / 1e6
    message = f"{made.name}: {size:.1f} MB"
    window.send(replace(job, state="done", done=1, url=f"export/{name}", message=message))


def _film(desk: Session, window: ClientWindow, request: asked.Export) -> tuple[str, ExportedFile]:
    del window
    name, made = desk.exports.new(request.name, f".{request.kind}")
    write_animation(made.path, desk.exports.shots(request.shots), rate_hz=request.rate_hz)
    return name, made


def _page(desk: Session, window: ClientWindow, request: asked.Export) -> tuple[str, ExportedFile]:
    text = page_of(desk, window, request.frames)
    name, made = desk.exports.new(request.name, ".html")
    made.path.write_text(text, "utf-8")
    return name, made


def page_of(desk: Session, window: ClientWindow, frames: tuple[int, ...]) -> str:
    """The HTML file of some frames.

    Raises:
        ConfigError: If there are none or too many.
    """
    if len(frames) > MOST_FRAMES:
        raise ConfigError(f"html: expected at most {MOST_FRAMES} frames, got {len(frames)}: choose fewer")
    states = [desk.book.state(index, window.threshold) for index in dict.fromkeys(frames)]
    payloads = {layer.url: _body(desk.book, state, layer) for state in states for layer in state.layers}
    first = states[0].frame.index if states else 0
    hello = replace(welcome(desk, window), mode="view", detectors=(), first=first, saves_to="", bookmarks=())
    return standalone(STATIC, hello, states, payloads)


def write_page(data: Dataset, settings: StudioSettings, frames: Sequence[str], path: Path) -> None:
    """Write the HTML file of some frames without a browser.

    Args:
        data: The data set.
        settings: As of a studio.
        frames: Numbers of the frames, or ``sequence/frame``; the first one where there are none.
        path: The file.

    Raises:
        FarfieldError: If there is no such frame, there are too many, or the page is not built.
    """
    desk = Session(settings, {})
    try:
        desk.open(data)
        chosen = tuple(first_of(frame, data) for frame in frames or ("",))
        write_text(path, page_of(desk, ClientWindow(id="file", annotator="", threshold=settings.threshold), chosen))
    finally:
        desk.threads.end()
        desk.exports.close()


def _body(book: FrameCache, state: FrameState, layer: Layer) -> bytes:
    index, opened = state.frame.index, book.opened
    if layer.kind == "points":
        return opened.cloud(index, layer.id).body
    if layer.kind == "image":
        return opened.picture(index, layer.id).body
    return opened.radar_map(index, layer.kind).body


def _labels(desk: Session, window: ClientWindow, request: asked.Export) -> tuple[str, ExportedFile]:
    if desk.annotating is None:
        raise ConfigError("export: labels are exported in `farfield annotate`; `farfield convert` converts data sets")
    del window
    name, made = desk.exports.new(request.name, ".zip")
    format = request.format or FORMATS[0]
    pack(desk.annotating.store, format, request.frames, desk.exports.folder / name, made.path)
    return name, made

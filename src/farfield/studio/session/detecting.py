"""Detectors on what is shown: single frames as they are opened, sequences on demand, two beside each other."""

import itertools
from collections import deque
from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path

from farfield.datasets.base import Dataset
from farfield.errors import ConfigError, FarfieldError
from farfield.frame import Boxes
from farfield.studio.inferring.jobs import InferJob, Jobs
from farfield.studio.inferring.worker import Worker
from farfield.studio.messages import requests
from farfield.studio.messages.replies import Job, Predicted
from farfield.studio.messages.rows import DetectorRow, PredictionSet
from farfield.studio.options import StudioSettings
from farfield.studio.session.annotating import propose
from farfield.studio.session.checking import check_detected
from farfield.studio.session.session import ClientWindow, Session, handles
from farfield.studio.showing.opened import plain_error
from farfield.studio.showing.predictions import Predictions, colour

_NUMBERS = itertools.count(1)


def offered(settings: StudioSettings, data: Dataset) -> tuple[DetectorRow, ...]:
    """The detectors that windows may run, the default first. None without torch.

    Those named at the start come first, then the ones that ship: on frames with a radar's tensor first those that read
    the radar (RTNH), on other frames those that read a LiDAR; of either those that learnt K-Radar's sensors first on
    K-Radar's own frames.

    Args:
        settings: What was named at the start.
        data: The frames; the first one is asked for a tensor.
    """
    from importlib.util import find_spec

    if find_spec("torch") is None:
        return ()
    shipped = shipped_detectors(data.name, tensors=has_tensors(data))
    names = dict.fromkeys((*settings.detectors, *shipped))
    return tuple(
        DetectorRow(
            name=name, title=Path(name).name if name in settings.detectors else name, cloud=shipped.get(name, "")
        )
        for name in names
    )


def shipped_detectors(format_name: str, *, tensors: bool) -> dict[str, str]:
    """The detectors that ship, the one that suits the data best first, and what each reads: LiDAR or radar.

    Args:
        format_name: Format of the data.
        tensors: Whether frames have a radar's tensor.
    """
    from farfield.detectors.catalogue import by_weather, catalogue

    shipped = [name for entry in catalogue() for name in (entry.weights, *entry.further) if name]
    of_kradar = {scores.weights: scores.cloud for scores in by_weather()}
    reads = {name: "radar" if of_kradar.get(name) == "radar" else "LiDAR" for name in shipped}
    own = format_name == "kradar"
    order = sorted(shipped, key=lambda name: ((reads[name] == "radar") != tensors, (name in of_kradar) != own))
    return {name: reads[name] for name in order}


def has_tensors(data: Dataset) -> bool:
    """Whether the first frame has a radar's tensor, cube or sparse points of one; no when it cannot be read."""
    try:
        return len(data) > 0 and bool(data[0].radar)
    except (FarfieldError, OSError):
        return False  # reported when the frame is opened


def _jobs(session: Session) -> Jobs:
    if session.jobs is None:
        session.jobs = Jobs(
            Worker(session.frames.data),
            _DetectionSink(session),
            lambda job: session.broadcast(_job_reply(session, job)),
        )
    return session.jobs


def _job_reply(session: Session, job: InferJob) -> Job:
    predictions = session.frames.sets.get(set_name(job.detector))
    message = plain_error(job.message, session.data)
    return replace(job.reply(), message=message, set=None if predictions is None else predictions.about)


def set_name(detector: str) -> str:
    """Name of a detector's set."""
    return f"detector-{Path(detector).name}"


def predictions_of(session: Session, detector: str) -> Predictions:
    """The set that a detector fills, made when it first runs."""
    name = set_name(detector)
    if name not in session.frames.sets:
        about = PredictionSet(
            name=name,
            title=Path(detector).name,
            kind="detections",
            protocol=session.frames.protocol,
            colour=colour(len(session.frames.sets)),
        )
        session.frames.sets[name] = Predictions(about)
    return session.frames.sets[name]


def detect_shown(session: Session, window: ClientWindow, frame: int) -> None:
    """Run the detectors named at the start on a frame that somebody looks at, unless that was done."""
    key = session.frames.data.keys[frame]
    for name in session.settings.detectors:
        predictions = session.frames.sets.get(set_name(name))
        asked_for = session.jobs is not None and any(
            frame in job.frames and job.detector == name for job in session.jobs.jobs.values()
        )
        if not asked_for and (predictions is None or key not in predictions.boxes):
            _start(session, window, "", name, [frame])


@handles(requests.InferStart)
async def infer(session: Session, window: ClientWindow, request: requests.InferStart) -> None:
    """Run a detector on frames.

    Raises:
        ConfigError: If the detector is not on offer, or there are no such frames.
    """
    rows = await session.in_thread(partial(offered, session.settings, session.frames.data))  # it reads a frame
    if request.detector not in {row.name for row in rows}:
        raise ConfigError("infer: expected one of the detectors on offer; name others with --detector at the start")
    session.opened.check(request.first)
    session.opened.check(request.last)
    if request.last < request.first:
        raise ConfigError(f"infer: expected the last frame after the first, got {request.first} to {request.last}")
    if request.propose and session.annotating is None:
        raise ConfigError("infer: boxes can be proposed in `farfield annotate` only")
    jobs = [] if session.jobs is None else session.jobs.jobs.values()
    repeated = next((job for job in jobs if job.id == request.id), None)
    if repeated is not None:  # it came before
        window.send(_job_reply(session, repeated))
        return
    frames = list(range(request.first, request.last + 1))
    _start(session, window, request.id, request.detector, frames, request.threshold, request.propose)


def _start(
    session: Session,
    window: ClientWindow,
    name: str,
    detector: str,
    frames: list[int],
    threshold: float = 0.0,
    propose: bool = False,
) -> None:
    predictions_of(session, detector)
    job = InferJob(
        id=name,
        name=f"job-{next(_NUMBERS)}",
        detector=detector,
        frames=deque(frames),
        window=window.id,
        by=window.annotator,
        threshold=threshold,
        propose=propose,
    )
    _jobs(session).add(job)


@handles(requests.InferCancel)
async def cancel(session: Session, window: ClientWindow, request: requests.InferCancel) -> None:
    """Stop a job.

    Raises:
        ConfigError: If there is none of this name that still runs.
    """
    del window
    if session.jobs is None or not session.jobs.cancel(request.job):
        raise ConfigError("infer: there is no such job that still runs")


def _with_boxes(session: Session, detector: str, index: int, boxes: Boxes) -> Predictions:
    """A detector's set, with its boxes of one frame."""
    predictions = predictions_of(session, detector)
    predictions.boxes[session.frames.data.keys[index]] = boxes
    check_detected(session, session.frames.data.keys[index])
    classes = sorted({*predictions.about.classes, *map(str, boxes.label)})
    predictions.about = replace(predictions.about, frames=len(predictions.boxes), classes=tuple(classes))
    return predictions


def detect_in(session: Session, indices: Iterable[int]) -> None:
    """Run the detectors named at the start on some frames, and wait for their boxes.

    Raises:
        FarfieldError: If a detector cannot be loaded, or fails in a frame.
    """
    worker = Worker(session.frames.data)
    try:
        for detector, index in itertools.product(session.settings.detectors, indices):
            boxes = worker.ask(detector, index)
            if boxes.score is not None:
                boxes = boxes[boxes.score >= session.settings.threshold]
            _with_boxes(session, detector, index, boxes)
    finally:
        worker.stop()


class _DetectionSink:
    """Takes what was found in a frame: into its set, to the windows that show it, into the annotation."""

    def __init__(self, session: Session) -> None:
        self.session = session

    async def __call__(self, job: InferJob, index: int, boxes: Boxes) -> None:
        session = self.session
        if boxes.score is not None:
            boxes = boxes[boxes.score >= min(session.settings.threshold, job.threshold or 1.0)]
        predictions = _with_boxes(session, job.detector, index, boxes)
        if job.propose and session.annotating is not None:
            await propose(session, job, index, boxes)
        for window in list(session.windows.values()):
            if window.frame == index:
                await self._show(window, predictions, index)

    async def _show(self, window: ClientWindow, predictions: Predictions, index: int) -> None:
        frames = self.session.frames
        shown = await self.session.in_thread(
            lambda: frames.predicted_by(predictions, index, frames.boxes(index), window.threshold)
        )
        if shown is not None:
            window.send(Predicted(frame=index, predicted=shown, set=predictions.about))

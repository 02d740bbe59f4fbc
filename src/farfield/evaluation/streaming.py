"""A detector over sweeps as they come: from a bag or data set, a folder that fills, or any iterator.

Three hands, a thread each: one takes sweeps in, one prepares the next of them, and the caller's own thread asks the
network. Sweeps that come faster than boxes are made are dropped by a rule, and that is said.
"""

import queue
import threading
import time
import warnings
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from farfield.datasets.base import Dataset
from farfield.detectors.info import DescribedDetector, DetectorFunction, as_detector
from farfield.detectors.onnx.detector import OnnxDetector
from farfield.errors import ConfigError, DatasetError
from farfield.evaluation.views import as_trained
from farfield.files.remote_paths import as_path
from farfield.frame import Cloud, Frame
from farfield.frame.cloud import CLOUD_SUFFIXES, read_cloud
from farfield.geometry.boxes import Boxes
from farfield.vocabulary.counts import count_of

DROP_RULES = ("oldest", "newest", "none")
"""Which sweep is dropped where too many wait: the one that waits longest, the one that comes, or none: then its source
waits."""
_MOST_LATENCIES = 10_000  # that count for the quantiles: memory stays as it is however long a stream runs
_POLL_S = 0.05


@dataclass(frozen=True)
class StreamReport:
    """What a stream has done so far.

    Args:
        sweeps: Sweeps that came.
        detected: Sweeps whose boxes were given.
        dropped: Sweeps that were dropped.
        p50_ms: Median time from a sweep's coming to its boxes, milliseconds; NaN where there are none.
        p99_ms: The 99th percentile of it.
        largest_ms: The largest; all three of the last 10,000 sweeps.
    """

    sweeps: int
    detected: int
    dropped: int
    p50_ms: float
    p99_ms: float
    largest_ms: float

    def __str__(self) -> str:
        """One line."""
        return (
            f"{count_of(self.sweeps, 'sweep')}, {self.detected} detected, {self.dropped} dropped; latency p50 "
            f"{self.p50_ms:.0f} ms, p99 {self.p99_ms:.0f} ms, largest {self.largest_ms:.0f} ms"
        )


@dataclass(frozen=True)
class _Sweep:
    """A sweep on its way, with the time at which it came; ``content`` is prepared by the second hand."""

    name: str
    came_s: float
    content: Any


class _End:
    """The last of a line; with the error that ended it."""

    def __init__(self, error: BaseException | None = None) -> None:
        self.error = error


class SweepStream:
    """Boxes of sweeps as they come; iterate over it once.

    Args:
        detector: A detector.
        sweeps: Names and frames, as they come.
        rate_hz: Sweeps a second at which they are taken from their source; None takes them as they come.
        drop: Which sweep is dropped where too many wait.
        waiting: How many may wait.
        cloud: Which of a frame's clouds to read.

    Attributes:
        sweep: Name of the sweep whose boxes were given last.
        latency_ms: Its time from coming to boxes.
    """

    def __init__(
        self,
        detector: DescribedDetector,
        sweeps: Iterable[tuple[str, Frame | Cloud]],
        *,
        rate_hz: float | None,
        drop: str,
        waiting: int,
        cloud: str | None,
    ) -> None:
        self._detector = detector if cloud is None else detector.with_cloud(cloud)
        self._sweeps, self._rate_hz, self._drop, self._waiting = sweeps, rate_hz, drop, waiting
        self._line: deque[_Sweep | _End] = deque()
        self._changed, self._stopped = threading.Condition(), threading.Event()
        self._prepared: queue.Queue[_Sweep | _End] = queue.Queue(maxsize=1)
        self._latencies_ms: deque[float] = deque(maxlen=_MOST_LATENCIES)
        self._came = self._given = self._dropped = 0
        self.sweep, self.latency_ms = "", float("nan")

    @property
    def report(self) -> StreamReport:
        """What it has done so far."""
        times = np.array(self._latencies_ms or [np.nan])
        p50, p99 = np.percentile(times, [50, 99])
        return StreamReport(self._came, self._given, self._dropped, float(p50), float(p99), float(times.max()))

    def __iter__(self) -> Iterator[Boxes]:
        """The boxes of each sweep that is not dropped, in their order.

        Raises:
            FarfieldError: If a sweep cannot be read or detected in.
        """
        hands = [threading.Thread(target=work, daemon=True) for work in (self._take_in, self._prepare)]
        for hand in hands:
            hand.start()
        try:
            while not isinstance(item := self._prepared.get(), _End):
                boxes = _detected(self._detector, item.content)
                self.latency_ms, self.sweep = (time.monotonic() - item.came_s) * 1000, item.name
                self._latencies_ms.append(self.latency_ms)
                self._given += 1
                yield boxes
            if item.error is not None:
                raise item.error
        finally:
            self._stop()
            for hand in hands:
                hand.join(timeout=5)
        if self._dropped:
            warnings.warn(f"stream: {self.report}; a sweep came while others waited", stacklevel=2)

    def _stop(self) -> None:
        self._stopped.set()
        with self._changed:
            self._changed.notify_all()
        with self._prepared.mutex:
            self._prepared.queue.clear()
            self._prepared.not_full.notify_all()

    def _take_in(self) -> None:
        """The first hand: sweeps into the line, at their rate, by the rule where it is full."""
        end, start = _End(), time.monotonic()
        try:
            for name, content in self._sweeps:
                if self._rate_hz is not None:
                    self._stopped.wait(max(start + self._came / self._rate_hz - time.monotonic(), 0))
                if self._stopped.is_set():
                    return
                self._came += 1
                self._line_up(_Sweep(name, time.monotonic(), content))
        except BaseException as error:  # noqa: BLE001 - raised again where the boxes are asked for
            end = _End(error)
        finally:
            with self._changed:
                self._line.append(end)
                self._changed.notify_all()

    def _line_up(self, sweep: _Sweep) -> None:
        with self._changed:
            while len(self._line) >= self._waiting and self._drop == "none" and not self._stopped.is_set():
                self._changed.wait(_POLL_S)
            if len(self._line) >= self._waiting:
                self._dropped += 1
                if self._drop == "newest":
                    return
                self._line.popleft()
            self._line.append(sweep)
            self._changed.notify_all()

    def _prepare(self) -> None:
        """The second hand: what the network reads of the next sweep, while it works on this one."""
        while not self._stopped.is_set():
            with self._changed:
                while not self._line and not self._stopped.is_set():
                    self._changed.wait(_POLL_S)
                if self._stopped.is_set():
                    return
                item = self._line.popleft()
                self._changed.notify_all()
            if not isinstance(item, _End):
                try:
                    item = _Sweep(item.name, item.came_s, _prepared(self._detector, item.content))
                except BaseException as error:  # noqa: BLE001 - likewise
                    item = _End(error)
            self._prepared.put(item)
            if isinstance(item, _End):
                return


def _prepared(detector: DescribedDetector, content: Frame | Cloud) -> Any:
    """What can be made of a sweep before the network is asked; of other detectors the frame with its cloud read."""
    if isinstance(detector, OnnxDetector):
        points = detector.points_of(content)
        return points, detector.record.reading.inputs(points)
    if isinstance(content, Frame) and detector.info.columns:
        for name in content.clouds:
            content.cloud(name)
    return content


def _detected(detector: DescribedDetector, content: Any) -> Boxes:
    if isinstance(detector, OnnxDetector):
        points, inputs = content
        return detector.finished(points, detector.record.reading.detect(points, detector.run, inputs))
    return detector(content)


def stream(
    detector: DescribedDetector | DetectorFunction,
    source: Any,
    *,
    rate_hz: float | None = None,
    drop: str | None = None,
    waiting: int = 1,
    cloud: str | None = None,
    idle_s: float | None = None,
) -> SweepStream:
    """Detect in sweeps as they come.

    Args:
        detector: A detector, or a function from a frame to boxes. Of an exported one the voxels of the next sweep are
            made beside the network of this one.
        source: A data set or bag, or its path; with ``idle_s`` a folder of cloud files that fills; or an iterable of
            frames or clouds, such as a generator that waits for a sensor.
        rate_hz: Take sweeps at this rate, as a sensor gives them (default: as they come).
        drop: ``"oldest"``, ``"newest"`` or ``"none"``: which sweep is dropped where ``waiting`` others wait; unless
            given none, but with ``rate_hz`` the oldest.
        waiting: Sweeps that may wait to be prepared.
        cloud: Which of a frame's clouds to read.
        idle_s: Read the path as a folder that fills, until no file came for so long.

    Returns:
        An iterable of boxes, with ``report``, ``sweep`` and ``latency_ms``.

    Raises:
        ConfigError: If a choice is not possible.
        DatasetError: If there is no such source.
    """
    if rate_hz is not None and not 0 < rate_hz <= 10_000:
        raise ConfigError(f"rate_hz: expected more than 0 and up to 10,000, got {rate_hz}.")
    rule = drop or ("none" if rate_hz is None else "oldest")
    if rule not in DROP_RULES or waiting < 1:
        raise ConfigError(f"expected drop oldest, newest or none and waiting 1 or more; got {drop!r} and {waiting}.")
    described = as_detector(detector)
    sweeps = _sweeps_of(described, source, idle_s)
    return SweepStream(described, sweeps, rate_hz=rate_hz, drop=rule, waiting=waiting, cloud=cloud)


def _sweeps_of(detector: DescribedDetector, source: Any, idle_s: float | None) -> Iterable[tuple[str, Frame | Cloud]]:
    if isinstance(source, Path | str):
        from farfield.datasets import open_dataset

        path = as_path(source)
        if not path.exists():
            raise DatasetError(f"{path}: expected a data set, a bag or a folder that fills, found nothing.")
        if path.is_dir() and idle_s is not None:
            return _filling(path, idle_s)
        source = open_dataset(path)
    if isinstance(source, Dataset):
        return _frames_of(as_trained(source, detector.info))
    if not isinstance(source, Iterable):
        kind = type(source).__name__
        raise ConfigError(f"stream: expected a data set, a path or frames one after the other, got {kind}.")
    return ((str(number), content) for number, content in enumerate(source))


def _frames_of(data: Any) -> Iterator[tuple[str, Frame | Cloud]]:
    for index in range(len(data)):
        frame = data[index]
        yield "/".join(frame.key), frame


def _filling(folder: Path, idle_s: float) -> Iterator[tuple[str, Frame | Cloud]]:
    """Cloud files of a folder in the order of their names as they come, those first that are there.

    A file counts when two looks at it tell one size; what is hidden, such as a file that is being written under another
    name, does not.
    """
    finished: set[str] = set()
    sizes: dict[str, int] = {}
    last = time.monotonic()
    while time.monotonic() - last < idle_s:
        names = sorted(path.name for path in folder.iterdir() if path.suffix.lower() in CLOUD_SUFFIXES)
        for name in (name for name in names if name not in finished and not name.startswith(".")):
            size = (folder / name).stat().st_size
            if sizes.get(name) != size:
                sizes[name], last = size, time.monotonic()
                continue
            finished.add(name)
            del sizes[name]
            yield name, read_cloud(folder / name)
            last = time.monotonic()
        finished &= set(names)  # of files that are taken away nothing is kept
        time.sleep(_POLL_S)

"""Sweeps as they come: order, drops by rule, errors, and a folder that fills."""

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import farfield as ff
from farfield.errors import ConfigError, DatasetError, FarfieldError
from farfield.frame import Boxes, Cloud, Frame


def numbered(number: int) -> Cloud:
    """A cloud that says its number by its points."""
    return Cloud(np.full((number + 1, 3), 1.0, dtype=np.float32))


def counting(frame: Frame | Cloud) -> Boxes:
    """A detector that gives as many boxes as the cloud has points."""
    cloud = frame if isinstance(frame, Cloud) else frame.cloud()
    count = len(cloud)
    return Boxes(
        centre_m=np.zeros((count, 3)), size_m=np.ones((count, 3)), yaw_rad=np.zeros(count), score=np.ones(count)
    )


def test_boxes_come_in_order_and_none_is_dropped_unless_asked() -> None:
    stream = ff.stream(counting, map(numbered, range(20)))
    assert [len(boxes) for boxes in stream] == list(range(1, 21))
    report = stream.report
    assert (report.sweeps, report.detected, report.dropped) == (20, 20, 0)
    assert 0 <= report.p50_ms <= report.p99_ms <= report.largest_ms
    assert stream.sweep == "19"


@pytest.mark.parametrize(("rule", "expected"), [("oldest", 9), ("newest", 1)])
def test_a_full_line_drops_by_its_rule(rule: str, expected: int) -> None:
    """All sweeps come while the first is worked on: what is left of those that wait is the last, or the first."""
    arrived, release = threading.Event(), threading.Event()

    def sweeps() -> Iterator[Cloud]:
        for number in range(10):
            yield numbered(number)
            if number == 3:
                time.sleep(0.05)
        arrived.set()

    def slow(frame: Frame | Cloud) -> Boxes:
        arrived.wait(5)
        return counting(frame)

    stream = ff.stream(slow, sweeps(), drop=rule, waiting=1)  # type: ignore[arg-type]
    with pytest.warns(UserWarning, match="dropped"):
        counts = [len(boxes) for boxes in stream]
    release.set()
    report = stream.report
    assert report.dropped == 10 - len(counts) > 0
    assert counts == sorted(counts)
    assert (counts[-1] - 1 == expected) if rule == "oldest" else counts[-1] < 10


def test_the_error_of_a_source_or_a_detector_is_raised() -> None:
    def torn() -> Iterator[Cloud]:
        yield numbered(0)
        raise FarfieldError("the sensor is gone")

    stream = ff.stream(counting, torn())
    with pytest.raises(FarfieldError, match="the sensor is gone"):
        list(stream)
    assert stream.report.detected == 1

    def faulty(frame: Frame | Cloud) -> Boxes:
        raise ConfigError("no cloud suits")

    with pytest.raises(ConfigError, match="no cloud suits"):
        list(ff.stream(faulty, map(numbered, range(3))))


def test_a_stream_that_is_left_ends_its_threads() -> None:
    before = threading.active_count()
    for _ in ff.stream(counting, map(numbered, range(1000))):
        break
    deadline = time.monotonic() + 10
    while threading.active_count() > before and time.monotonic() < deadline:
        time.sleep(0.01)
    assert threading.active_count() == before


def test_a_folder_is_read_as_it_fills_and_ends_when_idle(tmp_path: Path) -> None:
    np.save(tmp_path / "0.npy", np.ones((3, 4), dtype=np.float32))
    stream = ff.stream(counting, tmp_path, idle_s=0.6)
    names = []
    for boxes in stream:
        names.append((stream.sweep, len(boxes)))
        if len(names) == 1:
            np.save(tmp_path / ".hidden.npy", np.ones((1, 4), dtype=np.float32))
            np.save(tmp_path / "1.npy", np.ones((5, 4), dtype=np.float32))
    assert names == [("0.npy", 3), ("1.npy", 5)]


def test_wrong_choices_are_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="rate_hz"):
        ff.stream(counting, [], rate_hz=0.0)
    with pytest.raises(ConfigError, match="drop"):
        ff.stream(counting, [], drop="some")
    with pytest.raises(DatasetError, match="nothing"):
        ff.stream(counting, tmp_path / "none")
    with pytest.raises(ConfigError, match="int"):
        ff.stream(counting, 3)

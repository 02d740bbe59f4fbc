"""A stream by its own stamps, and streams that do not overlap."""

import numpy as np
import pytest

from farfield.sync.stamps import StreamCounter, apart, drives_in, health

MS = 1_000_000


def test_gaps_losses_duplicates_and_steps_back() -> None:
    times = np.arange(0, 100) * 100 * MS
    times = np.delete(times, [20, 50, 51])
    times = np.insert(times, [5, 5], times[4])
    times = np.insert(times, 60, times[30])
    found = health(times)
    assert (found.count, found.period_ns, found.duplicates, found.backwards) == (100, 100 * MS, 2, 1)
    assert (found.gaps, found.lost, found.longest_gap_ns) == (2, 3, 300 * MS)
    assert found.step_ns == 100 * MS
    assert found.gap_starts_ns.tolist() == [1900 * MS, 4900 * MS]
    assert found.to_json()["rate_hz"] == 10
    assert found.tick_ns == 100 * MS


def test_jitter_and_losses_do_not_bias_the_rate(rng: np.random.Generator) -> None:
    times = np.arange(5000) * 100 * MS + rng.normal(0, 5 * MS, 5000).astype(np.int64)
    found = health(times[rng.random(5000) > 0.05])
    assert found.tick_ns == pytest.approx(100 * MS, rel=1e-4)


@pytest.mark.parametrize("block", [1, 13, 100])
def test_blocks_count_as_the_whole(block: int, rng: np.random.Generator) -> None:
    times = np.cumsum(rng.integers(-20, 400, 500)) * MS
    whole, parts = health(times), StreamCounter()
    parts.period = whole.period_ns  # the median is of the first block
    for begin in range(0, 500, block):
        parts.add(times[begin : begin + block])
    assert parts.result().to_json() == whole.to_json()


def test_nothing_and_one() -> None:
    assert health(np.zeros(0, np.int64)).first_ns is None
    one = health(np.array([7]))
    assert (one.first_ns, one.last_ns, one.period_ns, one.gaps) == (7, 7, None, 0)


def test_long_gaps_begin_new_drives() -> None:
    times = np.concatenate([np.arange(5), np.arange(5) + 100]) * 100
    assert drives_in(times) == [slice(0, 5), slice(5, 10)]
    assert drives_in(times[:1]) == [slice(0, 1)]


def test_streams_without_a_common_moment_are_named() -> None:
    streams = {"radar": health(np.arange(10) * 10**9), "gps": health(np.arange(10) * 10**9 + 64 * 10**9)}
    found = apart(streams | {"none": health(np.zeros(0, np.int64))}, "radar", 10**8)
    assert found["gps"].startswith("gps does not overlap with radar: it begins 64.000 s after it")
    assert found["none"] == "none has no stamps"
    assert not apart({"a": streams["radar"], "b": streams["radar"]}, "a", 0)

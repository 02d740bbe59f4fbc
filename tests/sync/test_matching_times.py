"""Matching against oracles: all matchings of small cases, scipy's assignment, and the batch for blocks and streams."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from farfield.errors import ConfigError
from farfield.sync import StreamMatcher, match_blocks, match_times, matching, streaming
from farfield.sync.matching import assign, cost_ns, nearest, windows

small = st.lists(st.integers(0, 60), max_size=9, unique=True).map(sorted)


def array(values: object) -> np.ndarray:
    return np.array(values, dtype=np.int64)


def scipy_cost(a: np.ndarray, b: np.ndarray, tolerance: int) -> int:
    """Least cost of any one-to-one matching, crossing or not: each reference may also take a place of its own."""
    far = 10**12
    distance = np.abs(a[:, None] - b[None, :])
    own = np.where(np.eye(len(a), dtype=bool), tolerance, far)
    costs = np.hstack([np.where(distance <= tolerance, distance, far), own])
    rows, columns = linear_sum_assignment(costs)
    return int(costs[rows, columns].sum())


def sound(a: np.ndarray, b: np.ndarray, partner: np.ndarray, tolerance: int) -> None:
    """Within the tolerance, each used once, in order."""
    rows = np.flatnonzero(partner >= 0)
    assert (np.abs(a[rows] - b[partner[rows]]) <= tolerance).all()
    assert (np.diff(partner[rows]) > 0).all()


@given(small, small, st.integers(0, 25))
def test_cost_is_the_least_of_all_matchings(a_list: list[int], b_list: list[int], tolerance: int) -> None:
    a, b = array(a_list), array(b_list)
    partner = assign(a, b, tolerance)
    sound(a, b, partner, tolerance)
    assert cost_ns(a, b, partner, tolerance) == scipy_cost(a, b, tolerance)


def stream(
    rng: np.random.Generator, rate: float, jitter_ms: float, phase: float = 0.0, span_s: float = 20
) -> np.ndarray:
    """Stamps with jitter and 5 % lost, in order, without duplicates."""
    count = int(span_s * rate)
    times = (np.arange(count) + phase) / rate * 1e9 + rng.normal(0, jitter_ms * 1e6, count)
    return np.unique(times[rng.random(count) > 0.05].astype(np.int64))


CASES = [
    (10, 30, 2, 17, 0.0),
    (10, 10, 2, 50, 0.5),
    (10, 10, 20, 50, 0.5),
    (10, 10, 100, 50, 0.3),
    (30, 10, 2, 50, 0.0),
    (10, 15, 10, 60, 0.2),
    (4, 10, 60, 130, 0.0),
]


@pytest.mark.parametrize("case", CASES)
def test_cost_is_the_least_at_the_rates_of_sensors(case: tuple[float, ...], rng: np.random.Generator) -> None:
    own, other, jitter, tolerance_ms, phase = case
    for _ in range(4):
        a, b = stream(rng, own, jitter), stream(rng, other, jitter, phase)
        tolerance = int(tolerance_ms * 1e6)
        partner = assign(a, b, tolerance)
        sound(a, b, partner, tolerance)
        assert cost_ns(a, b, partner, tolerance) == scipy_cost(a, b, tolerance)


def test_nearest_is_not_enough() -> None:
    """Two references claim one message: the nearer gets it, the other goes without or takes the next."""
    a, b = array([0, 10]), array([7, 18])
    assert nearest(a, b, windows(a, b, 13)).tolist() == [0, 0]
    assert assign(a, b, 13).tolist() == [0, 1]  # 7 + 8 is less than 3 + 13
    assert assign(a, b, 9).tolist() == [-1, 0]


def test_halfway_takes_the_earlier_one() -> None:
    assert assign(array([10]), array([5, 15]), 9).tolist() == [0]
    assert assign(array([10]), array([5, 15]), 4).tolist() == [-1]


def test_compiled_and_plain_program_agree(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("numba")
    a, b = stream(rng, 10, 100), stream(rng, 10, 100, 0.5)
    plain = assign(a, b, 80_000_000)
    monkeypatch.setattr(matching, "_COMPILED_FROM", 0)
    assert assign(a, b, 80_000_000).tolist() == plain.tolist()


def test_too_many_candidates_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(matching, "MAX_CELLS", 100)
    with pytest.raises(ConfigError, match="smaller tolerance"):
        assign(array(range(50)), array(range(0, 100, 2)), 20)


def test_streams_are_matched_by_name_and_place() -> None:
    times = {"camera": array([0, 33, 66, 66, 100]), "lidar": array([64, 1]), "gps": array([])}
    found = match_times(times, reference="lidar", tolerance_ns=5)
    assert found.reference_ns.tolist() == [1, 64]
    assert found.reference_index.tolist() == [1, 0]  # out of order, as it was given
    assert found.names == ("camera", "gps")
    assert found.index.tolist() == [[0, -1], [2, -1]]  # of two equal stamps the first
    assert found.residual_ns.tolist() == [[-1, 0], [2, 0]]
    assert found.cost_ns == {"camera": 3, "gps": 10}
    assert match_times(times, reference="lidar").tolerance_ns["camera"] == 17  # half of 33, the faster one's period
    with pytest.raises(ConfigError, match="expected a stream"):
        match_times(times, reference="radar")
    with pytest.raises(ConfigError, match="0 or more"):
        match_times(times, reference="lidar", tolerance_ns=-1)


@pytest.mark.parametrize("block", [1, 7, 1000])
@pytest.mark.parametrize("jitter_ms", [2, 40])
def test_blocks_give_what_the_whole_gives(block: int, jitter_ms: float, rng: np.random.Generator) -> None:
    times = {
        "lidar": stream(rng, 10, jitter_ms),
        "camera": stream(rng, 30, jitter_ms),
        "radar": stream(rng, 10, jitter_ms, 0.5),
        "none": array([]),
    }
    whole = match_times(times, reference="lidar", tolerance_ns=40_000_000)
    cut = {name: iter([values[k : k + block] for k in range(0, len(values), block)]) for name, values in times.items()}
    parts = list(match_blocks(cut, reference="lidar", tolerance_ns=40_000_000))
    assert len(parts) > 1 or block == 1000
    np.testing.assert_array_equal(np.concatenate([part.reference_ns for part in parts]), whole.reference_ns)
    np.testing.assert_array_equal(np.concatenate([part.index for part in parts]), whole.index)
    np.testing.assert_array_equal(np.concatenate([part.residual_ns for part in parts]), whole.residual_ns)


def test_endless_clusters_are_cut_in_blocks_too(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streaming, "LONGEST", 50)
    a, b = np.arange(2000) * 100 + rng.integers(0, 60, 2000), np.arange(2000) * 100 + 50 + rng.integers(0, 60, 2000)
    parts = match_blocks(
        {"a": (a[k : k + 20] for k in range(0, 2000, 20)), "b": iter([b])}, reference="a", tolerance_ns=120
    )
    partner = np.concatenate([part.index[:, 0] for part in parts])
    sound(a, b, partner, 120)
    best = cost_ns(a, b, assign(a, b, 120), 120)
    assert best <= cost_ns(a, b, partner, 120) <= 1.01 * best


def streamed(times: dict[str, np.ndarray], late_ns: int, tolerance: int, rng: np.random.Generator, **options: int):
    """Push all messages, each by up to ``late_ns`` after its stamp; give the groups and the matcher."""
    order = sorted(
        (int(stamp) + int(rng.integers(0, late_ns + 1)), name, int(stamp))
        for name, values in times.items()
        for stamp in values
    )
    matcher = StreamMatcher(tuple(times), reference="lidar", tolerance_ns=tolerance, **options)
    groups, most = [], 0
    for _, name, stamp in order:
        groups += matcher.push(name, stamp)
        most = max(most, matcher.held)
    return groups + matcher.close(), matcher, most


many = st.lists(st.tuples(st.integers(0, 300), st.integers(0, 20)), max_size=40, unique_by=lambda row: row[0])


@given(many, many, many, st.integers(0, 30))
def test_any_disorder_within_the_lateness_is_mended(a: list, b: list, c: list, tolerance: int) -> None:
    rows = {"a": a, "b": b, "c": c}
    order = sorted((stamp + late, name, stamp) for name, values in rows.items() for stamp, late in values)
    far = 10**9
    matcher = StreamMatcher(
        ("a", "b", "c"),
        reference="a",
        tolerance_ns=tolerance,
        lateness_ns=20,
        stall_ns=far,
        jump_ns=far,
        longest_ns=far,
    )
    groups = [group for _, name, stamp in order for group in matcher.push(name, stamp)] + matcher.close()
    assert not matcher.counts
    times = {name: array(sorted(stamp for stamp, _ in values)) for name, values in rows.items()}
    whole = match_times(times, reference="a", tolerance_ns=tolerance)
    assert [group.stamp_ns for group in groups] == whole.reference_ns.tolist()
    for column, name in enumerate(whole.names):
        expected = [None if k < 0 else int(times[name][k]) for k in whole.index[:, column]]
        got = [None if (partner := group.partners[name]) is None else partner[0] for group in groups]
        assert got == expected


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("tolerance_ms", [16, 45])
def test_streaming_equals_batch_within_the_lateness(seed: int, tolerance_ms: int) -> None:
    rng = np.random.default_rng(seed)
    times = {
        "lidar": stream(rng, 10, 2, span_s=60),
        "other": stream(rng, 10, 2, 0.2, span_s=60),
        "camera": stream(rng, 30, 2, span_s=60),
        "gps": stream(rng, 1, 1, span_s=60),
    }
    tolerance = tolerance_ms * 1_000_000
    groups, matcher, most = streamed(times, 90_000_000, tolerance, rng, stall_ns=10_000_000_000)
    whole = match_times(times, reference="lidar", tolerance_ns=tolerance)
    assert not matcher.counts
    assert [group.stamp_ns for group in groups] == whole.reference_ns.tolist()
    for column, name in enumerate(whole.names):
        expected = [
            None if k < 0 else int(times[name][k]) for k in whole.index[:, column]
        ]  # places differ: they are counted as messages arrive
        got = [group.partners[name] for group in groups]
        assert [None if partner is None else partner[0] for partner in got] == expected
    assert most < 300  # of 2,900: some seconds of a GPS at 1 Hz hold up the rest


def test_streaming_cuts_endless_clusters_and_stays_near_the_optimum(rng: np.random.Generator) -> None:
    times = {"lidar": stream(rng, 10, 20, span_s=120), "other": stream(rng, 10, 20, 0.5, span_s=120)}
    tolerance = 140_000_000
    groups, matcher, most = streamed(times, 50_000_000, tolerance, rng)
    assert matcher.counts["cut", "lidar"] > 0
    assert most < 100
    whole = match_times(times, reference="lidar", tolerance_ns=tolerance)
    pairs = [(group.stamp_ns, group.partners["other"]) for group in groups]
    cost = sum(tolerance if partner is None else abs(partner[0] - stamp) for stamp, partner in pairs)
    assert whole.cost_ns["other"] <= cost <= 1.01 * whole.cost_ns["other"]
    used = [partner[0] for _, partner in pairs if partner is not None]
    assert used == sorted(set(used))


def test_late_duplicate_and_silent_are_counted() -> None:
    matcher = StreamMatcher(("lidar", "camera"), reference="lidar", tolerance_ns=10, lateness_ns=100, stall_ns=1000)
    groups = []
    for stamp in range(0, 5000, 100):
        groups += matcher.push("lidar", stamp)
        if stamp < 2000:
            groups += matcher.push("camera", stamp + 1)
    groups += matcher.push("lidar", 4850)
    groups += matcher.push("lidar", 4850)
    groups += matcher.push("lidar", 4300)
    groups += matcher.close()
    assert matcher.counts["duplicate", "lidar"] == 1
    assert matcher.counts["late", "lidar"] == 1
    assert matcher.needed_ns == 4900 - 4300
    assert len(matcher.warnings) == 1
    assert matcher.warnings[0].startswith("camera: silent after 1901 ns")
    partners = {group.stamp_ns: group.partners["camera"] for group in groups}
    assert partners[1900] == (1901, 19)
    assert partners[2000] is None
    assert len(groups) == 51


def test_a_stray_stamp_is_dropped_and_a_set_clock_is_noted() -> None:
    matcher = StreamMatcher(("a", "b"), reference="a", tolerance_ns=10, lateness_ns=0, stall_ns=500, jump_ns=10_000)
    groups = []
    for stamp in range(0, 1000, 100):
        groups += matcher.push("a", stamp)
        groups += matcher.push("b", stamp)
    groups += matcher.push("a", 10**9)  # alone, in the far future
    for stamp in range(1000, 2000, 100):
        groups += matcher.push("a", stamp)
        groups += matcher.push("b", stamp)
    assert matcher.counts["astray", "a"] == 1
    for stamp in range(10**6, 10**6 + 500, 100):  # all go on far later: a gap
        groups += matcher.push("a", stamp)
        groups += matcher.push("b", stamp)
    for stamp in range(0, 500, 100):
        groups += matcher.push("a", stamp)
        groups += matcher.push("b", stamp)
    groups += matcher.close()
    assert [warning.split(" by ")[0] for warning in matcher.warnings] == ["a: its clock was set back"] * 1
    assert all(group.partners["b"] is not None for group in groups)
    assert len(groups) == 30

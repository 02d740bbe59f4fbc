"""Points' times in every number type, unit and epoch: a turn of 100 ms gives offsets of 0 to 100 ms, or a refusal."""

from pathlib import Path

import numpy as np
import pytest

from farfield.errors import ConfigError, FileFormatError
from farfield.files.point_times import UNITS_NS, PointTimeColumn, check_point_times, point_time_column

STAMP_NS = 1_700_000_000_123_456_789
TURN_NS = 100_000_000
POINTS = 500
TRUE_NS = np.linspace(0, TURN_NS, POINTS).round().astype(np.int64)


def column(values: np.ndarray, *, stamp_ns: int | None = STAMP_NS, name: str = "t") -> PointTimeColumn:
    return PointTimeColumn(name, values, "memory", stamp_ns, TURN_NS)


def written(dtype: str, unit: str, epoch_ns: int) -> np.ndarray:
    """The turn as a driver writes it, counted from so many nanoseconds before the stamp."""
    whole = TRUE_NS + epoch_ns
    if np.dtype(dtype).kind == "f":
        return (whole.astype(np.longdouble) / UNITS_NS[unit]).astype(dtype)
    return (whole // UNITS_NS[unit]).astype(dtype)


@pytest.mark.parametrize("unit", UNITS_NS)
@pytest.mark.parametrize("dtype", ["f4", "f8", "u4", "i4", "u8", "i8"])
@pytest.mark.parametrize("epoch", ["stamp", "end", "hour", "1970"])
def test_a_turn_gives_offsets_of_a_turn(dtype: str, unit: str, epoch: str) -> None:
    """Every combination gives the true offsets to its own resolution, or is refused where its type cannot hold it."""
    start_ns = {"stamp": 0, "end": -TURN_NS, "hour": STAMP_NS % (3600 * 10**9), "1970": STAMP_NS}[epoch]
    largest = (start_ns + TURN_NS) / UNITS_NS[unit]
    whole = np.dtype(dtype).kind != "f"
    if whole and (unit == "s" or (start_ns < 0 and dtype[0] == "u") or largest > np.iinfo(dtype).max):
        return  # nothing that a driver could write
    values = written(dtype, unit, start_ns)
    step_ns = UNITS_NS[unit] if whole else float(np.spacing(np.abs(values).max())) * UNITS_NS[unit]
    if step_ns > 3 * TURN_NS / 20:
        with pytest.raises(FileFormatError, match="--point-times"):
            column(values).offsets_ns()
        return
    expected = TRUE_NS - (TURN_NS if epoch == "end" else 0)
    offsets = column(values).offsets_ns()
    assert offsets.dtype == np.int64
    assert np.abs(offsets - expected).max() <= 2 * step_ns + 2, (offsets[:3], expected[:3])


def test_seconds_since_1970_in_float32_are_refused() -> None:
    with pytest.raises(FileFormatError, match=r"tell points apart.*float32"):
        column(written("f4", "s", STAMP_NS)).offsets_ns()


def test_integers_do_not_overflow() -> None:
    wide = np.array([2**64 - 1 - TURN_NS, 2**64 - 1], np.uint64)
    assert column(wide, stamp_ns=None).offsets_ns().tolist() == [0, TURN_NS]
    with pytest.raises(FileFormatError, match="another clock"):
        column(wide).offsets_ns()
    both = np.array([-(2**63), 2**63 - 1], np.int64)
    with pytest.raises(FileFormatError, match="--point-times"):
        column(both).offsets_ns()


def test_what_fits_no_unit_is_refused_and_a_unit_given_overrules() -> None:
    share = np.linspace(0, 1, POINTS)  # of the turn, not a time: 1 s would be ten turns
    with pytest.raises(FileFormatError, match="--point-times s, ms, us or ns, or none"):
        column(share).offsets_ns()
    assert column(share * 0.6).offsets_ns("s").max() == 600_000_000
    with pytest.raises(FileFormatError, match="in ns"):
        column(np.linspace(0, 0.1, POINTS), name="time_ns").offsets_ns()


def test_another_clock_is_refused_where_the_stamp_is_known() -> None:
    since_boot = TRUE_NS + 5_000 * 10**9
    with pytest.raises(FileFormatError, match="another clock"):
        column(since_boot).offsets_ns()
    np.testing.assert_array_equal(column(since_boot, stamp_ns=None).offsets_ns(), TRUE_NS)


def test_times_that_are_all_one() -> None:
    assert column(np.zeros(3)).offsets_ns().tolist() == [0, 0, 0]
    assert column(np.full(3, STAMP_NS + 9)).offsets_ns().tolist() == [9, 9, 9]
    with pytest.raises(FileFormatError, match="differ from point to point"):
        column(np.full(3, 7)).offsets_ns()
    with pytest.raises(FileFormatError, match="finite"):
        column(np.array([0.0, np.nan])).offsets_ns()
    assert column(np.zeros(0)).offsets_ns().tolist() == []


@pytest.mark.parametrize("dtype", ["f4", "i4", "u4", "u8", "i8"])
def test_a_sweep_without_points_shows_no_unit(dtype: str) -> None:
    """One in which nothing returned, in whatever number type its times stand."""
    empty = np.zeros(0, dtype=dtype)
    assert column(empty).unit() is None
    assert column(empty, name="t_us").unit() == "us"
    assert column(empty).offsets_ns().tolist() == []


def test_keyframes_do_not_pass_for_turns() -> None:
    """A sweep of 50 ms every 20 s: 50 is milliseconds, not seconds."""
    values = np.linspace(0, 50, POINTS)
    assert PointTimeColumn("t", values, "memory", None, 20 * 10**9).unit() == "ms"


@pytest.mark.parametrize("name", ["times", "timestamps", "Times"])
def test_a_plural_is_no_unit_of_seconds(name: str) -> None:
    values = written("i8", "us", STAMP_NS)
    assert column(values, name=name).unit() == "us"
    assert column(written("u4", "ns", 0), name=name).offsets_ns().tolist() == TRUE_NS.tolist()


def test_names() -> None:
    assert point_time_column(["x", "Timestamp"]) == "Timestamp"
    assert point_time_column(["x", "range_ns", "columns"]) is None
    with pytest.raises(ConfigError, match="auto, s, ms, us, ns, none"):
        check_point_times("minutes")


def test_a_real_sweep_of_a_velodyne(shared_real: Path) -> None:
    """Its timestamps are float64 seconds since 1970."""
    from farfield.files.pcd import read_pcd

    fields = read_pcd(shared_real / "pcd" / "radar2lidar" / "lidar.pcd")
    offsets = PointTimeColumn("timestamp", fields["timestamp"], "memory").offsets_ns()
    assert 50_000_000 < np.ptp(offsets) < 150_000_000

"""Several stamps of one message stay together, and a sensor has no drift against itself."""

from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from farfield.sync.sources import RecordedStreams, StampSource, recordings
from farfield.sync.synchronising import synchronise

START_NS = 1_317_042_145_000_000_000
TURN_NS = 103_000_000


def _write(path: Path, times_ns: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = [
        datetime.fromtimestamp(int(t) // 10**9, tz=UTC).strftime("%Y-%m-%d %H:%M:%S") + f".{int(t) % 10**9:09d}"
        for t in times_ns
    ]
    path.write_text("\n".join(lines) + "\n")


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """Turns with start, middle and end, half a turn apart, and a camera that looks 16 ms after the middle."""
    rng = np.random.default_rng(0)
    edges = START_NS + np.arange(109) * TURN_NS + rng.integers(-40_000, 40_000, 109)
    middle = (edges[:-1] + edges[1:]) // 2
    folder = tmp_path / "2011_09_26_drive_0001_sync"
    _write(folder / "velodyne_points" / "timestamps_start.txt", edges[:-1])
    _write(folder / "velodyne_points" / "timestamps_end.txt", edges[1:])
    _write(folder / "velodyne_points" / "timestamps.txt", middle)
    _write(folder / "image_00" / "timestamps.txt", middle + 16_000_000 + rng.integers(-20_000, 20_000, 108))
    return tmp_path


def _rows(names: list[str], index: dict[str, list[int]], others: list[str], rows: object) -> None:
    names[:] = others
    for column, name in enumerate(others):
        index.setdefault(name, []).extend(rows.index[:, column].tolist())  # type: ignore[attr-defined]


@pytest.mark.parametrize("to", ["velodyne_points", "velodyne_points/end", "image_00"])
def test_start_and_end_of_a_turn_go_with_its_middle(drive: Path, to: str) -> None:
    (recording,) = recordings(drive)
    index: dict[str, list[int]] = {}
    result = synchronise(recording, to=to, row=partial(_rows, [], index))
    for name, pair in result.pairs.items():
        assert pair.matched == 108, name
        assert index[name] == list(range(108)), name
        if name.startswith("velodyne_points") and to.startswith("velodyne_points"):
            assert pair.clock is None
            assert "one sensor" in pair.untold
    assert not any("would be possible" in finding for finding in result.findings)
    turns = [pair.clock is not None for name, pair in result.pairs.items() if name.startswith("velodyne_points")]
    assert sum(turns) == (1 if to == "image_00" else 0)  # one clock, not three


def test_rows_that_do_not_count_alike_are_matched_by_time_and_said(drive: Path) -> None:
    path = drive / "2011_09_26_drive_0001_sync" / "velodyne_points" / "timestamps_end.txt"
    path.write_text("\n".join(path.read_text().splitlines()[:-3]) + "\n")
    (recording,) = recordings(drive)
    result = synchronise(recording, to="velodyne_points")
    assert result.pairs["velodyne_points/start"].matched == 108
    assert any("105 and 108" in finding for finding in result.findings)


def test_equal_stamps_are_one_clock() -> None:
    times_ns = START_NS + np.arange(60) * TURN_NS
    streams = {name: StampSource(blocks=partial(iter, [times_ns])) for name in ("frames", "lidar")}
    pair = synchronise(RecordedStreams(name="drive", streams=streams), to="frames").pairs["lidar"]
    assert pair.matched == 60
    assert pair.clock is None
    assert "the same stamps" in pair.untold


def test_real_turns_of_kitti_raw(shared_real: Path) -> None:
    (recording,) = recordings(shared_real / "kitti_raw" / "2011_09_26")
    result = synchronise(recording, to="velodyne_points")
    for name in ("velodyne_points/start", "velodyne_points/end"):
        assert result.pairs[name].matched == 108
        assert result.pairs[name].clock is None

"""Lists of stamps and logs of clocks: exact values, every form, hostile text."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.errors import FarfieldError, FileFormatError
from farfield.files import stamps as module
from farfield.files.clock_logs import is_clock_log, read_clock_log
from farfield.files.stamps import Unit, read_stamps, recognise_stamps


def read(path: Path, text: str | bytes, unit: Unit = "auto") -> list[int]:
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    known = recognise_stamps(path, unit=unit)
    assert known is not None
    return [int(value) for block in read_stamps(known) for value in block]


@pytest.mark.parametrize(
    ("text", "unit", "expected"),
    [
        ("1574859771744660272\n1574859771977525228\n", "auto", [1574859771744660272, 1574859771977525228]),
        ("1574859771.744660272\n1574859771.5", "auto", [1574859771744660272, 1574859771500000000]),
        ("0.1\n1.25\n-0.000000001\n\n2\n", "auto", [100000000, 1250000000, -1, 2000000000]),
        ("1574859771744660\r\n1574859771744661\r\n", "auto", [1574859771744660000, 1574859771744661000]),
        ("5\n70\n", "ms", [5000000, 70000000]),
        ("1.5\n", "ms", [1500000]),
        ("0.1234567891234\n", "s", [123456789]),  # digits below a nanosecond are cut
        ("time_us\n17\n", "auto", [17000]),
        ("frame,timestamp_ns,x\n0,12,1.5\n1,14,2\n", "auto", [12, 14]),
        ("2011-09-26 13:02:25.964389445\n2011-09-26 13:02:26\n", "auto", [1317042145964389445, 1317042146000000000]),
        ("Frame: 000001 Time: 12.000000005\nFrame: 000002 Time: 12.7\n", "auto", [12000000005, 12000000007]),
    ],
)
def test_every_form_is_exact(tmp_path: Path, text: str, unit: Unit, expected: list[int]) -> None:
    assert read(tmp_path / "list.txt", text, unit) == expected


@given(st.lists(st.integers(-4 * 10**18, 4 * 10**18), min_size=1, max_size=40))
def test_nanoseconds_come_back(tmp_path_factory: pytest.TempPathFactory, values: list[int]) -> None:
    path = tmp_path_factory.getbasetemp() / "numbers.txt"
    assert read(path, "".join(f"{value}\n" for value in values), "ns") == values
    seconds = "".join(f"{'-' if v < 0 else ''}{abs(v) // 10**9}.{abs(v) % 10**9:09d}\n" for v in values)
    assert read(path, seconds, "s") == values


def test_blocks_cut_no_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    values = [10**k for k in range(18)] * 5
    monkeypatch.setattr(module, "BLOCK_BYTES", 37)
    assert read(tmp_path / "list.txt", "\n".join(map(str, values)), "ns") == values


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("1574859771744660272\n15748597x1744660272\n", "line 2"),
        ("1.5\n\n1.5.5\n", "line 3"),
        ("1.5\n1.\n", "line 2"),
        ("1.5\n.5\n", "line 2"),
        ("1.5\n--5\n", "line 2"),
        ("1.5\n99999999999.0\n", "line 2"),
        ("1.5\n" + "1" * 60 + "\n", "line 2"),
        ("time_s,x\n1.5,2\n1.5\nb\n", "line 4"),
        ("x,time_s\n1,2.5\n1\n", "line 3"),
        ("2011-09-26 13:02:25.9\n2011-13-26 13:02:25.9\n", "line 1"),
        ("2011-09-26 13:02:25.9\n2911-09-26 13:02:25.9\n", "line 1"),
        ("2011-09-26 13:02:25.9\nyesterday\n", "line 2"),
        ("12\n13\n", "first stamp"),
    ],
)
def test_other_lines_are_named(tmp_path: Path, text: str, where: str) -> None:
    with pytest.raises(FileFormatError, match=where):
        read(tmp_path / "list.txt", text)


def test_what_is_no_list_is_none(tmp_path: Path) -> None:
    for text in ("", "\n", "name,size\na,5\n", "hello\n1.5\n", "{}"):
        path = tmp_path / "other.txt"
        path.write_text(text)
        assert recognise_stamps(path) is None


PTP = """
Jan 01 host ptp4l: [85.100] port 1 (eth0): LISTENING to UNCALIBRATED on RS_SLAVE
ptp4l[85.240]: master offset      -1200 s0 freq   +1234 path delay      5671
ptp4l[86.240]: master offset        -23 s2 freq   +1250 path delay       567
ptp4l[87.240]: master offset         27 s2 freq   +1240 path delay       565
"""


def test_logs_of_clocks(tmp_path: Path) -> None:
    path = tmp_path / "ptp4l.log"
    path.write_text(PTP)
    assert is_clock_log(path)
    log = read_clock_log(path)
    assert (log.program, log.summary, len(log), log.others) == ("ptp4l", False, 3, 2)
    assert log.time_ns.tolist() == [85240000000, 86240000000, 87240000000]
    assert log.offset_ns.tolist() == [-1200, -23, 27]
    assert log.delay_ns.tolist() == [5671, 567, 565]
    assert log.locked.tolist() == [False, True, True]
    path.write_text("phc2sys[12.5]: CLOCK_REALTIME phc offset  -12 s2 freq +345 delay 1234\n")
    assert read_clock_log(path).program == "phc2sys"
    path.write_text("ptp4l[12.500]: rms  12 max   34 freq  -123 +/-   4 delay   567 +/-   8\n")
    summary = read_clock_log(path)
    assert (summary.summary, summary.offset_ns.tolist(), summary.freq_ppb.tolist()) == (True, [12], [-123])


def test_hostile_logs_are_refused(tmp_path: Path, rng: np.random.Generator) -> None:
    path = tmp_path / "ptp4l.log"
    path.write_text("ptp4l[85.240]: port 1: nothing\n")
    with pytest.raises(FileFormatError, match="found none"):
        read_clock_log(path)
    path.write_text(PTP + "phc2sys[12.5]: CLOCK_REALTIME phc offset  -12 s2 freq +345 delay 1234\n")
    with pytest.raises(FileFormatError, match="a file of its own"):
        read_clock_log(path)
    path.write_text(PTP + "x" * 2000)
    with pytest.raises(FileFormatError, match="1000 characters"):
        read_clock_log(path)
    path.write_text("ptp4l[85.240]: master offset 9999999999999999999 s2 freq 0 path delay 1\n")
    with pytest.raises(FileFormatError, match="9e18"):
        read_clock_log(path)


def test_mutated_lists_and_logs_give_values_or_clear_errors(tmp_path: Path, rng: np.random.Generator) -> None:
    texts = [PTP, "1574859771.744660272\n" * 5, "a,time_s\n1,1.5\n2,2.5\n", "2011-09-26 13:02:25.964389445\n" * 3]
    path = tmp_path / "list.txt"
    outcomes = set()
    for number in range(1500):
        content = bytearray(texts[number % len(texts)].encode())
        for _ in range(int(rng.integers(1, 5))):
            content[int(rng.integers(len(content)))] = int(rng.integers(256))
        path.write_bytes(bytes(content[: int(rng.integers(1, len(content) + 1))]))
        try:
            if number % len(texts) == 0:
                read_clock_log(path)
            elif (known := recognise_stamps(path)) is not None:
                assert all(block.dtype == np.int64 for block in read_stamps(known))
            outcomes.add("read")
        except FarfieldError:
            outcomes.add("refused")
    assert outcomes == {"read", "refused"}


MICROSECONDS = [1558131117608556 + 100_000 * row for row in range(3)]


def test_names_of_16_digits_are_microseconds_everywhere(tmp_path: Path) -> None:
    from farfield.datasets import in_memory, open_dataset
    from farfield.datasets.cirrus.layout import time_of
    from farfield.datasets.convert import _times
    from farfield.frame import Frame
    from farfield.privacy.sources import _series

    expected = [1000 * value for value in MICROSECONDS]
    assert read(tmp_path / "list.txt", "".join(f"{value}\n" for value in MICROSECONDS)) == expected
    paths = [Path(f"{value}.xyz") for value in MICROSECONDS]
    assert [time_of(path) for path in paths] == expected
    assert _series(tmp_path, paths).times_s.tolist() == pytest.approx([0.0, 0.1, 0.2], abs=1e-6)
    frames = [Frame(sequence="s", frame_id=path.stem) for path in paths]
    assert _times(in_memory(frames)) == expected
    own = tmp_path / "own"
    own.mkdir()
    for path in paths:
        np.save(own / f"{path.stem}.npy", np.ones((5, 4), np.float32))
    assert [frame.time_ns for frame in open_dataset(own)] == expected


def test_counters_of_16_digits_are_no_times(tmp_path: Path) -> None:
    from farfield.files.stamps import name_time_ns

    assert name_time_ns("0000000000000005") is None
    assert name_time_ns("9999999999999999999") is None, "beyond 64 bits"
    assert name_time_ns("12345678901234567") == 12345678901234567
    assert read(tmp_path / "list.txt", "12345678901234567\n") == [12345678901234567]
    assert name_time_ns("155813111760855") is None
    assert name_time_ns("\u0661" * 16) is None

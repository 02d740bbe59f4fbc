"""Headerless ASCII clouds."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.errors import FileFormatError
from farfield.files.xyz import read_xyz, write_xyz

ROWS = np.array([[1.5, -2.25, 0.0, 0.5, 0.0], [100.0, 3.0, -1.0, 0.25, 7.0]])


def write(tmp_path: Path, text: str | bytes) -> Path:
    path = tmp_path / "cloud.xyz"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


@pytest.mark.parametrize(
    "text",
    [
        "1.5,-2.25,0,.5,0\n100,3,-1,0.25,7\n",
        "1.5,-2.25,0,.5,0\n100,3,-1,0.25,7",
        "1.5,-2.25,0,.5,0\r\n100,3,-1,0.25,7\r\n",
        "1.5,-2.25,0,.5,0\r100,3,-1,0.25,7\r",
        "1.5, -2.25, 0, .5, 0\n+1e2, 3, -1, 25e-2, 7\n\n  \n",
        "1.5;-2.25;0;.5;0\n100;3;-1;0.25;7\n",
        "1.5\t-2.25\t0\t.5\t0\n100\t3\t-1\t0.25\t7\n",
        "  1.5   -2.25 0 .5 0\n100 3 -1 0.25 7 \n",
    ],
    ids=["plain", "no-last-end", "crlf", "cr", "spaces-and-blank-end", "semicolon", "tab", "white-space"],
)
def test_ways_to_write_the_same_cloud(tmp_path: Path, text: str) -> None:
    np.testing.assert_array_equal(read_xyz(write(tmp_path, text)), ROWS)


def test_eight_columns_are_recognised_and_others_on_request(tmp_path: Path) -> None:
    assert read_xyz(write(tmp_path, "1,2,3,4,5,6,7,8\n")).tolist() == [[1, 2, 3, 4, 5, 6, 7, 8]]
    assert read_xyz(write(tmp_path, "1,2,3\n4,5,6\n"), columns=3).shape == (2, 3)
    assert read_xyz(write(tmp_path, "1 2 3\n4 5 6\n"), columns=3, delimiter=" ").shape == (2, 3)


@pytest.mark.parametrize(
    ("text", "where", "message"),
    [
        ("", "line 1", "at least one point, found an empty file"),
        (" \n\n", "line 1", "at least one point"),
        ("1,2,3,4\n", "line 1", r"5 columns \(Gaussian\) or 8 \(uniform\), found 4 .*Pass columns="),
        ("1,2,3,4,5\n1,2,3,4,5\n1,2,3,4\n", "line 3", "5 columns, found 4 in '1,2,3,4'.*truncated"),
        ("1,2,3,4,5\n1,2,3,4,5,6\n1,2,3,4,5\n", "line 2", "5 columns, found 6"),
        ("1,2,3,4,5\n\n1,2,3,4,5\n", "line 2", "5 columns, found 1 in ''"),
        ("1,2,3,4,5\n1,2,x,4,5\n", "line 2", "a number.*found 'x'"),
        ("1,2,3,4,5\n1,2,,4,5\n", "line 2", "a number.*found ''"),
        ("1,2,3,4,5\n1,2,1_0,4,5\n", "line 2", "a number.*found '1_0'"),
        ("1,2,3,4,5\n1,2,3\x00,4,5\n", "line 2", "a number"),
        ("1,2,3,4,5\n1,2,٣,4,5\n", "line 2", "a number"),
        ("1,2,3,4,5\n1,2,0x3,4,5\n", "line 2", "a number"),
        ("1,2,3,4,5\n1,nan,3,4,5\n", "line 2", "finite numbers, found .*on_nan='drop'"),
        ("1,2,3,4,5\n1,2,3,4,-inf\n", "line 2", "finite numbers"),
        ("1,2,3,4,5\n1,2,3,4,1e999\n", "line 2", "finite numbers"),
        ("1,5;2,5;3;4;5\n", "line 1", "a number.*found '1,5'"),
        ("x,y,z,intensity,extra\n1,2,3,4,5\n", "line 1", "a number.*found 'x'"),
    ],
)
def test_faults_are_named_with_their_line(tmp_path: Path, text: str, where: str, message: str) -> None:
    with pytest.raises(FileFormatError, match=message) as caught:
        read_xyz(write(tmp_path, text))
    assert caught.value.where == where
    assert str(caught.value).startswith(str(tmp_path / "cloud.xyz"))


def test_faults_far_down_a_long_file_have_the_right_line(tmp_path: Path) -> None:
    lines = ["1.25,2,3,4,5"] * 60_000
    lines[54_320] = "1.25,2,3,4"
    with pytest.raises(FileFormatError, match="line 54321: expected 5 columns, found 4"):
        read_xyz(write(tmp_path, "\n".join(lines)))
    lines[54_320] = "1.25,2,3,4,nan"
    path = write(tmp_path, "\n".join(lines))
    with pytest.raises(FileFormatError, match="line 54321: expected finite"):
        read_xyz(path)
    assert len(read_xyz(path, on_nan="drop")) == 59_999


def test_dropping_every_point_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="at least one point with finite numbers"):
        read_xyz(write(tmp_path, "nan,nan,nan,0,0\n"), on_nan="drop")


def test_no_line_may_be_endless(tmp_path: Path) -> None:
    path = write(tmp_path, "1,2,3,4,5\n" + "1," * 200_000)
    with pytest.raises(FileFormatError, match="line 2: expected a line of numbers, found more than 131072 bytes"):
        read_xyz(path)


def test_the_limit_on_the_size_is_the_caller_s(tmp_path: Path) -> None:
    path = write(tmp_path, "1,2,3,4,5\n")
    assert len(read_xyz(path, max_bytes=10)) == 1
    with pytest.raises(FileFormatError, match="at most 9 bytes, found 10"):
        read_xyz(path, max_bytes=9)


def test_an_unknown_delimiter_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"expected delimiter 'auto'.*got '\|'"):
        read_xyz(write(tmp_path, "1|2\n"), delimiter="|")


def test_real_frames_equal_numpy_s_own_parser(shared_real: Path, tmp_path: Path) -> None:
    for path in sorted((shared_real / "cirrus_layout").rglob("*.xyz")):
        rows = read_xyz(path)
        np.testing.assert_array_equal(rows, np.loadtxt(path, delimiter=","))
        write_xyz(tmp_path / "again.xyz", rows, decimals=(4, 4, 4, 6, 0))
        assert (tmp_path / "again.xyz").read_bytes() == path.read_bytes()


def test_written_text_is_what_printf_writes(tmp_path: Path, rng: np.random.Generator) -> None:
    rows = rng.normal(size=(2000, 5)) * [250, 50, 3, 1, 1e5]
    write_xyz(tmp_path / "a.xyz", rows, decimals=(4, 3, 2, 6, 0))
    expected = "".join(f"{a:.4f},{b:.3f},{c:.2f},{d:.6f},{e:.0f}\n" for a, b, c, d, e in rows).replace(
        "-0.00,", "0.00,"
    )
    assert (tmp_path / "a.xyz").read_text() == expected.replace(",-0\n", ",0\n")


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(*[st.floats(-1e12, 1e12)] * 5), min_size=1, max_size=20),
    st.integers(0, 9),
)
def test_round_trip_to_half_of_the_last_digit(
    tmp_path_factory: pytest.TempPathFactory, table: list[tuple[float, ...]], decimals: int
) -> None:
    path = tmp_path_factory.mktemp("xyz") / "a.xyz"
    rows = np.array(table)
    write_xyz(path, rows, decimals=decimals)
    error = np.abs(read_xyz(path) - rows)
    assert (error <= 0.5 * 10.0**-decimals + 1e-15 * np.abs(rows)).all()


def test_blocks_of_lines_join_without_a_seam(tmp_path: Path) -> None:
    rows = np.arange(70_000 * 5, dtype=np.float64).reshape(-1, 5) / 8
    write_xyz(tmp_path / "a.xyz", rows, decimals=3)
    np.testing.assert_array_equal(read_xyz(tmp_path / "a.xyz"), rows)


@pytest.mark.parametrize("rows", [np.zeros((0, 5)), np.zeros(5), np.array([[1.0, np.nan, 0, 0, 0]])], ids=str)
@pytest.mark.usefixtures("without_shape_checks")
def test_what_could_not_be_read_back_is_not_written(tmp_path: Path, rows: np.ndarray) -> None:
    with pytest.raises(ValueError, match="table of finite numbers"):
        write_xyz(tmp_path / "a.xyz", rows)
    assert not (tmp_path / "a.xyz").exists()


@pytest.mark.parametrize("decimals", [-1, 16, (4, 4)])
def test_decimals_must_fit(tmp_path: Path, decimals: int | tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"expected 0\.\.15 decimals for 5 columns"):
        write_xyz(tmp_path / "a.xyz", ROWS, decimals=decimals)

"""Boxes as comma-separated text: round trips, optional columns, and everything that can be wrong."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from farfield.errors import FileFormatError
from farfield.files.boxes_csv import BoxRows, read_boxes_csv, write_boxes_csv

HEADER = "sequence,frame,label,x,y,z,l,w,h,yaw_rad,score"
ROW = "a,0001,vehicle,10.5,-2,0.25,4.5,1.9,1.6,0.1,0.9"


def write(tmp_path: Path, text: str | bytes) -> Path:
    path = tmp_path / "boxes.csv"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def rows(rng: np.random.Generator, n: int) -> BoxRows:
    return BoxRows(
        frame=np.array([f"{i:04d}" for i in range(n)]),
        label=rng.choice(["vehicle", "a, quoted label"], n),
        centre_m=rng.normal(0, 100, (n, 3)),
        size_m=rng.uniform(1, 9, (n, 3)),
        yaw_rad=rng.uniform(-3, 3, n),
        sequence=rng.choice(["s1", "ü"], n),
        score=rng.uniform(0, 1, n),
        track_id=rng.integers(-1, 9, n),
        point_count=rng.integers(-1, 999, n),
    )


def test_round_trip_is_exact(tmp_path: Path, rng: np.random.Generator) -> None:
    original = rows(rng, 40)
    write_boxes_csv(tmp_path / "boxes.csv", original)
    again = read_boxes_csv(tmp_path / "boxes.csv")
    for name in ("frame", "label", "centre_m", "size_m", "yaw_rad", "sequence", "score", "track_id", "point_count"):
        np.testing.assert_array_equal(getattr(original, name), getattr(again, name), err_msg=name)


def test_no_boxes_round_trip(tmp_path: Path, rng: np.random.Generator) -> None:
    write_boxes_csv(tmp_path / "boxes.csv", rows(rng, 0))
    again = read_boxes_csv(tmp_path / "boxes.csv")
    assert len(again) == 0
    assert again.centre_m.shape == (0, 3)


def test_optional_columns_and_order(tmp_path: Path) -> None:
    found = read_boxes_csv(write(tmp_path, "label,frame,yaw_rad,x,y,z,l,w,h\r\ncar, 7 ,0.5,1,2,3,4,2,1\r\n\r\n"))
    assert found.sequence is None
    assert found.score is None
    assert found.frame.tolist() == ["7"]
    assert found.centre_m.tolist() == [[1.0, 2.0, 3.0]]
    assert found.yaw_rad.tolist() == [0.5]


def test_empty_scores_are_none_and_a_byte_order_mark_is_fine(tmp_path: Path) -> None:
    found = read_boxes_csv(write(tmp_path, "\ufeff" + f"{HEADER}\n{ROW[:-3]}\n{ROW[:-3]}\n"))
    assert found.score is None
    assert len(found) == 2


def test_annotations_are_written_with_an_empty_score(tmp_path: Path) -> None:
    write_boxes_csv(tmp_path / "boxes.csv", read_boxes_csv(write(tmp_path, f"{HEADER}\n{ROW[:-3]}\n")))
    assert (tmp_path / "boxes.csv").read_text() == f"{HEADER}\na,0001,vehicle,10.5,-2.0,0.25,4.5,1.9,1.6,0.1,\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "line 1.*an empty file"),
        (ROW, "line 1"),
        (HEADER.replace(",h,", ",") + "\n", "Missing: h"),
        (HEADER.replace("yaw_rad", "heading") + "\n", "Missing: yaw_rad. Perhaps rename 'heading' to 'yaw_rad'."),
        (HEADER.replace("label", "class") + "\n", "Missing: label. Perhaps rename 'class' to 'label'."),
        (HEADER + ",colour\n", "colour"),
        (HEADER + ",score\n", "score"),
        (f"{HEADER}\n{ROW},1", "line 2.*11 columns.*12"),
        (f"{HEADER}\n{ROW}\n{ROW.replace('10.5', 'far')}", "line 3.*as x.*'far'"),
        (f"{HEADER}\n{ROW.replace('10.5', 'nan')}", "line 2.*finite"),
        (f"{HEADER}\n{ROW.replace('4.5', '0')}", "line 2.*positive size as l"),
        (f"{HEADER}\n{ROW.replace('4.5', '1e-9')}", "line 2.*positive size as l"),
        (f"{HEADER}\n{ROW.replace('10.5', '1e300')}", "line 2.*within 1e.07"),
        (f"{HEADER}\n{ROW.replace('0001', '')}", "line 2.*a frame.*empty"),
        (f"{HEADER}\n{ROW}\n{ROW[:-3]}", "column score.*both"),
        (f'{HEADER}\n"{ROW}', "line 2"),
        (f"{HEADER},track_id\n{ROW},1.5", "whole number as track_id"),
        (HEADER.encode() + b"\n\xff", "byte 47.*0xff"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str | bytes, said: str) -> None:
    with pytest.raises(FileFormatError, match=said):
        read_boxes_csv(write(tmp_path, text))


def test_mutated_files_give_one_clear_error_or_valid_rows(tmp_path: Path, rng: np.random.Generator) -> None:
    data = f"{HEADER}\n{ROW}\n{ROW}\n".encode()
    letters = np.frombuffer(b"\x00 \n,.-+eE_xn0123456789\xff\"'", dtype=np.uint8)
    for _ in range(400):
        broken = bytearray(data[: rng.integers(0, len(data) + 1)] if rng.integers(2) else data)
        for place in rng.integers(0, max(len(broken), 1), rng.integers(0, 4)):
            if len(broken):
                broken[place] = rng.choice(letters)
        try:
            found = read_boxes_csv(write(tmp_path, bytes(broken)))
        except FileFormatError:
            continue
        assert (found.size_m > 0).all()
        assert np.isfinite(found.centre_m).all()


@pytest.mark.parametrize("axes", [2, 3])
def test_velocities_round_trip_and_unknown_ones_are_empty(tmp_path: Path, rng: np.random.Generator, axes: int) -> None:
    velocity = rng.normal(0, 9, (5, axes))
    velocity[1], velocity[3, 0] = np.nan, np.nan
    write_boxes_csv(tmp_path / "boxes.csv", replace(rows(rng, 5), velocity_m_s=velocity))
    again = read_boxes_csv(tmp_path / "boxes.csv")
    velocity[3] = np.nan  # of which a part is not known
    np.testing.assert_array_equal(again.velocity_m_s, velocity)
    lines = (tmp_path / "boxes.csv").read_text().splitlines()
    assert lines[0].endswith(",point_count,vx_m_s,vy_m_s,vz_m_s"[: None if axes == 3 else -7])
    assert lines[2].endswith("," * axes)
    assert "nan" not in "".join(lines)


def test_files_without_velocities_are_as_they_were(tmp_path: Path, rng: np.random.Generator) -> None:
    write_boxes_csv(tmp_path / "boxes.csv", rows(rng, 2))
    assert read_boxes_csv(tmp_path / "boxes.csv").velocity_m_s is None
    assert "m_s" not in (tmp_path / "boxes.csv").read_text()


def test_velocities_of_no_boxes_round_trip(tmp_path: Path, rng: np.random.Generator) -> None:
    write_boxes_csv(tmp_path / "boxes.csv", replace(rows(rng, 0), velocity_m_s=np.zeros((0, 3))))
    assert read_boxes_csv(tmp_path / "boxes.csv").velocity_m_s.shape == (0, 3)


@pytest.mark.parametrize(
    ("columns", "cells", "said"),
    [
        ("vx_m_s,vy_m_s", "1,fast", "line 2.*a finite number as vy_m_s.*'fast'"),
        ("vx_m_s,vy_m_s", "nan,1", "line 2.*a finite number as vx_m_s"),
        ("vx_m_s,vy_m_s", "inf,1", "line 2.*a finite number as vx_m_s"),
        ("vx_m_s,vy_m_s", "1,1e300", "line 2.*within 1e.06 as vy_m_s"),
        ("vx_m_s,vy_m_s", "1,", "box 1.*vx_m_s, vy_m_s all with a number or all empty"),
        ("vx_m_s,vy_m_s,vz_m_s", "1,2,", "box 1.*vz_m_s all with a number or all empty"),
        ("vx_m_s", "1", "line 1.*vx_m_s and vy_m_s, or no velocities"),
        ("vx_m_s,vz_m_s", "1,2", "line 1.*vx_m_s and vy_m_s, or no velocities"),
        ("vx,vy", "1,2", "line 1.*perhaps.*vx_m_s"),
    ],
)
def test_wrong_velocities_are_named(tmp_path: Path, columns: str, cells: str, said: str) -> None:
    with pytest.raises(FileFormatError, match=said):
        read_boxes_csv(write(tmp_path, f"{HEADER},{columns}\n{ROW},{cells}\n"))

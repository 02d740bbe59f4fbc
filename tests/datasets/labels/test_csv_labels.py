"""Boxes in one CSV file: what is not edited keeps its bytes."""

from dataclasses import replace
from pathlib import Path

import pytest

from farfield.datasets.labels import BoxLabel, CsvLabels
from farfield.errors import ConfigError, FileFormatError
from farfield.files.boxes_csv import parse_boxes_csv

FILE = Path("boxes.csv")
KEY, OTHER = ("a", "0001"), ("a", "0002")
TEXT = (
    b"sequence,frame,label,x,y,z,l,w,h,yaw_rad,score,track_id,point_count\r\n"
    b"a,0001,car,10.50,2,0,4.20,1.8,1.50,0.5236,,7,31\r\n"
    b'a,0002,"a ""big"" car",1,2,3,4,2,1,0,,,\r\n'
    b"\r\n"
    b"a,0001,car,20,-2,0,4.2,1.8,1.5,-3,,8,5"
)
LABELS = CsvLabels(FILE)


def test_parsed_in_the_order_of_the_file() -> None:
    found = LABELS.parse(TEXT, FILE, [KEY, OTHER, ("a", "none")])
    assert [(label.id, label.track, label.box[0]) for label in found[KEY]] == [("0", "7", 10.5), ("1", "8", 20.0)]
    assert found[OTHER][0].label == 'a "big" car'
    assert found[OTHER][0].track == ""
    assert found["a", "none"] == ()


def test_nothing_changed_nothing_written_anew() -> None:
    found = LABELS.parse(TEXT, FILE, [KEY, OTHER])
    assert LABELS.render(TEXT, FILE, found) == TEXT


def test_one_box_moved_changes_one_line() -> None:
    first, second = LABELS.parse(TEXT, FILE, [KEY])[KEY]
    moved = replace(first, box=(10.625, *first.box[1:]))
    lines = LABELS.render(TEXT, FILE, {KEY: [moved, second]}).split(b"\n")
    before = TEXT.split(b"\n")
    assert lines[1] == b"a,0001,car,10.625,2,0,4.20,1.8,1.50,0.5236,,7,\r"
    assert lines[0] == before[0]
    assert lines[2:] == before[2:]


def test_deleted_and_added() -> None:
    first, second = LABELS.parse(TEXT, FILE, [KEY])[KEY]
    new = BoxLabel(id="n1", label="bus", box=(1.0, 2.0, 3.0, 11.5, 2.5, 3.3, 0.1), track="12")
    written = LABELS.render(TEXT, FILE, {KEY: [second, new]})
    assert written.endswith(
        b"a,0001,car,20,-2,0,4.2,1.8,1.5,-3,,8,5\r\na,0001,bus,1.0,2.0,3.0,11.5,2.5,3.3,0.1,,12,\r\n"
    )
    assert [label.label for label in LABELS.parse(written, FILE, [KEY])[KEY]] == ["car", "bus"]
    assert first.id == "0"
    assert LABELS.render(TEXT, FILE, {KEY: [first]}).endswith(b'car",1,2,3,4,2,1,0,,,\r\n\r\n')


def test_a_new_file() -> None:
    label = BoxLabel(id="n1", label="car", box=(1.5, 2.0, 3.0, 4.0, 2.0, 1.5, 0.25))
    written = LABELS.render(None, FILE, {KEY: [label]})
    rows = parse_boxes_csv(written, FILE)
    assert (rows.frame.tolist(), rows.yaw_rad.tolist()) == (["0001"], [0.25])
    assert LABELS.parse(written, FILE, [KEY])[KEY][0].box == label.box


def test_what_cannot_be_written_is_refused() -> None:
    short = b"frame,label,x,y,z,l,w,h,yaw_rad\n0001,car,1,2,3,4,2,1,0\n"
    (label,) = LABELS.parse(short, FILE, [KEY])[KEY]
    with pytest.raises(ConfigError, match="no column track_id"):
        LABELS.render(short, FILE, {KEY: [replace(label, track="3")]})
    with pytest.raises(ConfigError, match="whole number"):
        LABELS.render(TEXT, FILE, {KEY: [replace(label, track="three")]})
    with pytest.raises(FileFormatError):
        LABELS.parse(b"frame,label\n", FILE, [KEY])

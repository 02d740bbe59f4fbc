"""K-Radar's label files opened and saved again: the same bytes but for what was edited."""

import tarfile
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from farfield.datasets.kradar.label_format import KRadarLabelFormat
from farfield.datasets.kradar.labels import parse_labels
from farfield.datasets.kradar.reader import KRadar
from farfield.datasets.labels import BoxLabel
from farfield.errors import ConfigError, DatasetError, FileFormatError

HEADER = (
    b"* idx(tesseract_os2-64_cam-front_os1-128_cam-lrr)=00033_00001_00002_00001_00004, timestamp=1643292946.710046076"
)
FIRST = b"*, R, 2, Bus or Truck, 43.07651046365939, -7.6391785542268090, 0.6, 190.50, 4.79, 1.36, 1.70\n"
LINES = HEADER + b"\n" + FIRST + b"*, LL, 3, Tank, 20.10, 5, -1e-1, -2.5, 2.1, 0.9, 0.8"
KEY = ("1", "00033_00001")
NEW = BoxLabel(id="new", label="vehicle", box=(10.5, 2.0, 0.1, 4.5, 1.8, 1.5, 0.5), track="9")


def tree(root: Path, text: bytes, folder: str = "KRadar_revised_visibility/1") -> KRadarLabelFormat:
    path = root / folder / "00033_00001.txt"
    path.parent.mkdir(parents=True)
    path.write_bytes(text)
    return KRadarLabelFormat(KRadar(root))


@pytest.fixture
def labels(tmp_path: Path) -> KRadarLabelFormat:
    return tree(tmp_path, LINES)


def read(labels: KRadarLabelFormat, data: bytes = LINES) -> list[BoxLabel]:
    return list(labels.parse(data, labels.path(KEY), [KEY])[KEY])


def write(labels: KRadarLabelFormat, wanted: list[BoxLabel], data: bytes | None = LINES) -> bytes:
    return labels.render(data, labels.path(KEY), {KEY: wanted})


def test_parsed_as_the_reader_does(labels: KRadarLabelFormat) -> None:
    found = read(labels)
    boxes = parse_labels(LINES, "labels").boxes
    assert [label.label for label in found] == ["Bus or Truck", "Tank"]
    assert [label.track for label in found] == ["2", "3"]
    assert [label.attributes["availability"] for label in found] == ["R", "L"]
    assert np.allclose([label.box[:6] for label in found], np.column_stack([boxes.centre_m, boxes.size_m]), atol=0)
    assert found[0].box[6] == pytest.approx(np.deg2rad(190.5), abs=0)  # as it stands, not wrapped
    assert labels.name == "kradar-v2.1"
    assert labels.path(KEY).name == "00033_00001.txt"


@pytest.mark.parametrize(
    "data", [LINES, LINES + b"\n", HEADER, HEADER + b"\n", LINES.replace(b"\n", b"\r\n"), LINES + b",\n\n", b""]
)
def test_what_is_not_edited_keeps_its_bytes(labels: KRadarLabelFormat, data: bytes) -> None:
    assert write(labels, read(labels, data), data) == data
    assert labels.render(data, labels.path(KEY), {}) == data


def test_one_box_moved_is_one_line_changed_and_in_it_one_number(labels: KRadarLabelFormat) -> None:
    found = read(labels)
    moved = replace(found[0], box=(found[0].box[0] + 0.25, *found[0].box[1:]))
    assert write(labels, [moved, found[1]]) == LINES.replace(b"43.07651046365939", b"43.32651046365939")
    turned = replace(found[1], box=(*found[1].box[:6], 0.5))
    assert write(labels, [found[0], turned]) == LINES.replace(b"-2.5,", repr(float(np.rad2deg(0.5))).encode() + b",")


def test_a_yaw_wrapped_by_the_page_is_the_same_yaw(labels: KRadarLabelFormat) -> None:
    found = read(labels)
    wrapped = replace(found[0], box=(*found[0].box[:6], found[0].box[6] - 2 * np.pi))
    assert write(labels, [wrapped, found[1]]) == LINES


def test_class_track_and_availability_are_edited_alone(labels: KRadarLabelFormat) -> None:
    first, second = read(labels)
    new = replace(first, label="Sedan", track="7", attributes={"availability": "L1"})
    assert write(labels, [new, second]) == LINES.replace(b"R, 2, Bus or Truck", b"L1, 7, Sedan")
    assert write(labels, [replace(first, label="large_vehicle"), second]) == LINES  # ours for the same class


def test_objects_come_and_go(labels: KRadarLabelFormat) -> None:
    first, second = read(labels)
    assert write(labels, [first]) == HEADER + b"\n" + FIRST
    assert write(labels, [second]) == LINES.replace(FIRST, b"")
    assert write(labels, []) == HEADER + b"\n"
    line = b"*, R, 9, Sedan, 10.5, 2.0, 0.1, 28.64788975654116, 2.25, 0.9, 0.75\n"
    assert write(labels, [first, second, NEW]) == LINES + b"\n" + line
    assert write(labels, [NEW], HEADER) == HEADER + b"\n" + line


def test_a_new_file_gets_its_header(tmp_path: Path) -> None:
    labels = tree(tmp_path, HEADER)
    made = write(labels, [NEW], None)
    found = parse_labels(made, "labels")
    assert found.indices["radar"] == 33
    assert found.boxes.size_m[0] == pytest.approx([4.5, 1.8, 1.5])
    assert found.boxes.yaw_rad[0] == pytest.approx(0.5)
    assert write(labels, read(labels, made), made) == made


def test_older_versions_and_objects_seen_from_above(tmp_path: Path) -> None:
    old = HEADER + b" *, 5, 5, Sedan, 1, 2, 0, 30, 2, 1, 0.8\n#, 6, 6, Sedan, 5, 6, 7, 2, 1\n"
    old += b"*, 7, -1, Pedestrian, 9, 2, 0, 30, .4, .3, .9\n"
    labels = tree(tmp_path, old, "1/info_label")
    found = read(labels, old)
    assert labels.attributes == {}
    assert [label.track for label in found] == ["", ""]
    assert write(labels, found, old) == old
    moved = [found[0], replace(found[1], box=(9.5, *found[1].box[1:]))]
    assert write(labels, moved, old) == old.replace(b" 9, 2", b" 9.5, 2")
    assert b"*, 3, 3, Sedan, 10.5" in write(labels, [*found, replace(NEW, track="")], old)


def test_what_the_files_cannot_hold_is_refused(labels: KRadarLabelFormat) -> None:
    found = read(labels)
    for wrong in (
        replace(NEW, label="animal"),
        replace(NEW, track=""),
        replace(NEW, track="a, b"),
        replace(NEW, attributes={"availability": "R, 1"}),
    ):
        with pytest.raises(ConfigError, match="expected"):
            write(labels, [*found, wrong])
    with pytest.raises(DatasetError, match="expected a frame"):
        labels.path(("1", "none"))
    with pytest.raises(FileFormatError):
        write(labels, found, b"* nothing that is a header\n")


def published(real: Path) -> Iterator[tuple[str, bytes]]:
    with tarfile.open(real / "kradar" / "labels_v2_1.tar.gz") as archive:
        for member in archive:
            file = archive.extractfile(member) if member.isfile() else None
            if file is not None:
                yield member.name, file.read()


def saved_again(labels: KRadarLabelFormat, name: str, data: bytes) -> None:
    """Nothing edited: nothing changed. One box moved: one line changed."""
    path = Path(name)
    found = labels.parse(data, path, [KEY])[KEY]
    assert labels.render(data, path, {KEY: found}) == data, name
    if not found:
        return
    moved, chosen = list(found), len(found) // 2
    x, y, *rest = found[chosen].box
    moved[chosen] = replace(found[chosen], box=(x, y - 0.37, *rest))
    changed = labels.render(data, path, {KEY: moved})
    lines = zip(data.split(b"\n"), changed.split(b"\n"), strict=True)
    assert sum(old != new for old, new in lines) == 1, name
    assert labels.parse(changed, path, [KEY])[KEY] == tuple(moved)


def test_every_hundredth_published_file(shared_real: Path, labels: KRadarLabelFormat) -> None:
    count = 0
    for name, data in islice(published(shared_real), 0, None, 100):
        saved_again(labels, name, data)
        count += 1
    assert count == 350


@pytest.mark.slow
@pytest.mark.whole
def test_all_published_files(shared_real: Path, labels: KRadarLabelFormat) -> None:
    count = 0
    for name, data in published(shared_real):
        saved_again(labels, name, data)
        count += 1
    assert count == 34_994

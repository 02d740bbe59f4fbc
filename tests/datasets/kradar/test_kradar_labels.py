"""K-Radar's annotation files: the real ones, their slips, and ours."""

import re
import tarfile
from collections import Counter
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from drive import boxes

from farfield.datasets.kradar.labels import KRadarLabels, format_labels, parse_labels
from farfield.datasets.kradar.layout import INDEX_NAMES
from farfield.errors import FileFormatError
from farfield.vocabulary.kradar import frame_difference

HEADER = (
    "* idx(tesseract_os2-64_cam-front_os1-128_cam-lrr)=00033_00001_00002_00001_00004, timestamp=1643292946.710046076"
)
VALUES = "24.5, -3.25, -0.5, 90, 1.75, 0.875, 0.5"
INDICES = dict(zip(INDEX_NAMES, (33, 1, 2, 1, 4), strict=True))
TIME_NS = 1_643_292_946_710_046_076
LINE = re.compile(r"\*, (R|L|L1), -?\d+, [A-Z][A-Za-z ]+(, -?\d+(\.\d+)?(e-\d+)?){7}")

OBJECTS = {  # kradar.md, 1.8: objects, and how many are R, L, L1; LL and l count as L, LR as L1
    "Sedan": (89_272, 52_822, 16_731, 19_719),
    "Bus or Truck": (18_380, 11_648, 3_908, 2_824),
    "Pedestrian": (5_863, 4_483, 599, 781),
    "Bicycle": (955, 706, 172, 77),
    "Motorcycle": (616, 323, 96, 197),
    "Pedestrian Group": (137, 110, 27, 0),
    "Bicycle Group": (6, 6, 0, 0),
}


@pytest.mark.parametrize(
    ("line", "track", "availability"),
    [
        (f"*, 5, 4, Sedan, {VALUES}", None, ()),  # v1 numbers the objects of a frame
        (f"*, 5, Sedan, {VALUES}", 5, ()),
        (f"*, R, 5, 4, Sedan, {VALUES}", None, ("R",)),
        (f"*, R, 5, Sedan, {VALUES}", 5, ("R",)),
        (f"*,L1,-1,Sedan,{VALUES},", -1, ("L1",)),
        (f" *,  l , 5,  Sedan ,{VALUES} ", 5, ("L",)),
        (f"*, LL, 5, Sedan, {VALUES}", 5, ("L",)),
        (f"*, LR, 5, Sedan, {VALUES}", 5, ("L1",)),
    ],
    ids=["v1.0", "v1.0-short-or-v2.0", "v1.1", "v2.1", "no-blanks", "blanks", "LL", "LR"],
)
@pytest.mark.parametrize("end", ["\n{}\n", "\r\n{}\r\n", " {}", "{}", "\n{}"])
def test_every_version_and_slip(line: str, track: int | None, availability: tuple[str, ...], end: str) -> None:
    labels = parse_labels((HEADER + end.format(line)).encode(), "a.txt")
    assert labels.indices == INDICES
    assert labels.time_ns == TIME_NS
    assert labels.raw_label == ("Sedan",)
    assert labels.availability == availability
    assert labels.boxes.label.tolist() == ["vehicle"]
    found = labels.boxes.track_id
    assert (found if found is None else found.tolist()) == (track if track is None else [track])
    assert labels.boxes.centre_m.tolist() == [[24.5, -3.25, -0.5]]
    assert labels.boxes.size_m.tolist() == [[3.5, 1.75, 1.0]]
    assert labels.boxes.yaw_rad.tolist() == [np.pi / 2]


def test_yaw_is_wrapped_and_boxes_without_height_stand_apart() -> None:
    above = "#, 3, 3, Bus or Truck, 40, 5.5, 180.4, 5, 1.25"
    turned = VALUES.replace("90", "457")
    labels = parse_labels(f"{HEADER}\n*, 0, Pedestrian Group, {turned}\n{above}\n".encode(), "a.txt")
    np.testing.assert_allclose(np.rad2deg(labels.boxes.yaw_rad), [97])
    assert labels.boxes.label.tolist() == ["pedestrian"]
    assert labels.from_above == (("Bus or Truck", (40.0, 5.5, 180.4, 5.0, 1.25)),)


def test_old_header_and_empty_frames() -> None:
    old = "* radar idx: 00857, lidar idx: 00834, camera idx: 02499, time: 1643, prev lidar idx: -1, sequence: 9"
    labels = parse_labels(f"{old}\n*, 5, 5, Sedan, {VALUES}\n".encode(), "a.txt")
    assert (labels.indices, labels.time_ns, len(labels.boxes)) == ({}, None, 1)
    assert len(parse_labels(HEADER.encode(), "a.txt").boxes) == 0
    assert len(parse_labels(b"", "a.txt").boxes) == 0


@pytest.mark.parametrize(
    ("text", "where", "expected"),
    [
        ("nonsense", "line 1", "the header"),
        (HEADER.replace("timestamp", "time"), "line 1", "the header"),
        (f"{HEADER}\n*, R, 5, Sedan, 1, 2, 3", "line 2", "a class and seven numbers"),
        (f"{HEADER}\n*, Q, 5, Sedan, {VALUES}", "line 2", "R, L or L1"),
        (f"{HEADER}\n*, R, Sedan, {VALUES}", "line 2", "one or two whole numbers"),
        (f"{HEADER}\n*, 5, 5, 5, {VALUES}", "line 2", "a class"),
        (f"{HEADER}\n*, 5, Sedan, nan{VALUES[4:]}", "line 2", "seven numbers"),
        (f"{HEADER}\n*, 5, Sedan, 1e300{VALUES[4:]}", "line 2", "seven numbers"),
        (f"{HEADER}\n\n*, 5, Sedan, {VALUES.replace('1.75', '-1.75')}", "line 3", "positive sizes"),
        (f"{HEADER}\n*, 5, Sedan, {VALUES}\nrubbish", "line 2", "seven numbers"),
        (f"{HEADER}\n#, 5, Sedan, 1, 2, 3", "line 2", "five numbers"),
    ],
)
def test_damage_is_named(text: str, where: str, expected: str) -> None:
    with pytest.raises(FileFormatError, match=re.escape(expected)) as caught:
        parse_labels(text.encode(), "a.txt")
    assert caught.value.where == where


def test_written_lines_have_the_real_form_and_read_back(rng: np.random.Generator) -> None:
    given, flags = boxes(rng), ["R", "L", "L1", "R", "R", "R"]
    kept = given[given.label != "animal"]
    for version in ("v1.0", "v2.1"):
        text = format_labels(given, INDICES, TIME_NS, version=version, availability=flags)
        header, *lines = text.splitlines()
        assert header == HEADER
        assert text.endswith("\n")
        assert len(lines) == 5
        if version == "v2.1":
            assert all(LINE.fullmatch(line) for line in lines)
        else:
            assert all(line.startswith(f"*, {k}, {k}, ") for k, line in zip(kept.track_id, lines, strict=True))
        back = parse_labels(text.encode(), "a.txt")
        assert back.indices == INDICES
        assert back.time_ns == TIME_NS
        assert back.availability == (tuple(flags[:5]) if version == "v2.1" else ())
        assert np.array_equal(back.boxes.centre_m, kept.centre_m)
        assert np.array_equal(back.boxes.size_m, kept.size_m)
        np.testing.assert_allclose(back.boxes.yaw_rad, kept.yaw_rad, rtol=0, atol=1e-15)
        assert back.boxes.label.tolist() == kept.label.tolist()
        if version == "v2.1":
            assert back.boxes.track_id.tolist() == kept.track_id.tolist()
        else:
            assert back.boxes.track_id is None
    assert format_labels(given[:0], INDICES, TIME_NS, version="v2.1") == HEADER


def test_example_of_version_1(shared_real: Path) -> None:
    path = shared_real / "kradar" / "example" / "label_example.txt"
    labels = parse_labels(path.read_bytes(), path)
    assert labels.indices == {"radar": 64, "os2-64": 31, "cam-front": 91, "os1-128": 31, "cam-lrr": 89}
    assert labels.raw_label == (*["Sedan"] * 5, "Bus or Truck", "Sedan", "Sedan", "Bus or Truck", "Sedan")
    np.testing.assert_allclose(labels.boxes.size_m[5], 2 * np.array([9.5863, 2.0376, 2.48]))
    np.testing.assert_allclose(np.rad2deg(labels.boxes.yaw_rad[5]), 180.3983 - 360)


def real_labels(shared_real: Path) -> Iterator[tuple[str, str, bytes]]:
    """Sequence, frame and content of the real files of version 2.1."""
    with tarfile.open(shared_real / "kradar" / "labels_v2_1.tar.gz") as archive:
        for member in archive:
            if member.isfile():
                yield Path(member.name).parts[1], Path(member.name).stem, archive.extractfile(member).read()


def parsed(sequence: str, stem: str, data: bytes) -> KRadarLabels:
    labels = parse_labels(data, stem)
    assert len(labels.boxes) == data.count(b"\n*,") == len(labels.availability)
    assert stem == f"{labels.indices['radar']:05d}_{labels.indices['os2-64']:05d}"
    assert labels.indices["radar"] - labels.indices["os2-64"] == frame_difference(sequence)
    return labels


def test_some_real_files_parse_and_are_written_again(shared_real: Path) -> None:
    objects = 0
    for sequence, stem, data in islice(real_labels(shared_real), 400):
        labels = parsed(sequence, stem, data)
        again = {"version": "v2.1", "availability": labels.availability}
        text = format_labels(labels.boxes, labels.indices, labels.time_ns, **again)
        assert text.splitlines()[0] == data.decode().splitlines()[0].rstrip()
        back = parse_labels(text.encode(), stem)
        np.testing.assert_allclose(back.boxes.yaw_rad, labels.boxes.yaw_rad, rtol=0, atol=1e-14)
        assert np.array_equal(back.boxes.centre_m, labels.boxes.centre_m)
        assert np.array_equal(back.boxes.size_m, labels.boxes.size_m)
        assert (back.availability, back.boxes.label.tolist()) == (labels.availability, labels.boxes.label.tolist())
        objects += len(labels.boxes)
    assert objects > 500


@pytest.mark.slow
def test_all_real_files_parse_and_their_totals_are_known(shared_real: Path) -> None:
    counts: Counter[tuple[str, str]] = Counter()
    frames = empty = written_alike = 0
    for sequence, stem, data in real_labels(shared_real):
        labels = parsed(sequence, stem, data)
        frames, empty = frames + 1, empty + (len(labels.boxes) == 0)
        counts.update(zip(labels.raw_label, labels.availability, strict=True))
        written_alike += sum(LINE.fullmatch(line) is not None for line in data.decode().splitlines()[1:])
    assert (frames, empty, counts.total()) == (34_994, 4_307, 115_229)
    assert written_alike == 115_229 - 3  # but for LL, LR and l
    for name, expected in OBJECTS.items():
        parts = tuple(counts[name, flag] for flag in ("R", "L", "L1"))
        assert (sum(parts), *parts) == expected

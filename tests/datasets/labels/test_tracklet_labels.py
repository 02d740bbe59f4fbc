"""Tracklets edited in their places: what changed and nothing else."""

import difflib
from dataclasses import replace
from pathlib import Path

import pytest

from farfield.datasets import open_dataset
from farfield.datasets.labels import BoxLabel, label_format
from farfield.datasets.labels.tracklet_labels import TrackletLabels
from farfield.errors import ConfigError, DatasetError, FileFormatError

FILE = Path("drive/tracklet_labels.xml")
KEYS = tuple(("drive", f"{frame:010d}") for frame in range(8))
LABELS = TrackletLabels({key: (FILE, frame) for frame, key in enumerate(KEYS)})
CAR = BoxLabel(id="n0", label="Car", box=(10.0, 2.0, -0.9, 4.2, 1.8, 1.6, 0.5), track="9")


def file_of(*tracks: tuple[str, int, int]) -> bytes:
    """Objects (class, first frame, frames) written by the format itself, then spelt as others spell."""
    labels: dict = {}
    for number, (name, first, count) in enumerate(tracks):
        for frame in range(first, first + count):
            box = (10.0 * number + frame, 3.0, -0.75, 4.0, 1.75, 1.5, 0.25)
            label = BoxLabel(id=f"n{number}", label=name, box=box, track=f"t{number}")
            labels.setdefault(KEYS[frame], []).append(label)
    return LABELS.render(None, FILE, labels).replace(b"<tz>-1.5</tz>", b"<tz>-1.50</tz>").replace(b"\n", b"\r\n")


@pytest.fixture
def content() -> bytes:
    return file_of(("Car", 0, 5), ("Van", 1, 5), ("Pedestrian", 2, 2))


def parsed(data: bytes) -> dict:
    return dict(LABELS.parse(data, FILE, KEYS))


def lines_changed(before: bytes, after: bytes) -> list[str]:
    found = difflib.ndiff(before.decode().splitlines(keepends=True), after.decode().splitlines(keepends=True))
    return [line[2:].strip() for line in found if line[0] in "+-"]


def moved(label: BoxLabel, by_m: float = 0.5) -> BoxLabel:
    return replace(label, box=(label.box[0] + by_m, *label.box[1:]))


def test_what_did_not_change_keeps_its_bytes(content: bytes) -> None:
    found = parsed(content)
    assert [len(found[key]) for key in KEYS] == [1, 2, 3, 3, 2, 1, 0, 0]
    assert LABELS.render(content, FILE, found) == content
    assert LABELS.render(content, FILE, {}) == content
    edited = {key: [replace(label, state="edited") for label in labels] for key, labels in found.items()}
    assert LABELS.render(content, FILE, edited) == content


def test_a_moved_box_is_one_number(content: bytes) -> None:
    key = KEYS[3]
    first, second, third = parsed(content)[key]
    changed = LABELS.render(content, FILE, {key: [first, moved(second), third]})
    assert lines_changed(content, changed) == ["<tx>13.0</tx>", "<tx>13.5</tx>"]
    assert parsed(changed)[key][1].box == pytest.approx(moved(second).box)
    seen = replace(first, attributes={"occlusion": 2.0, "truncation": 99.0})
    assert lines_changed(content, LABELS.render(content, FILE, {key: [seen, second, third]})) == [
        "<occlusion>-1</occlusion>",
        "<occlusion>2</occlusion>",
    ]


def test_class_and_size_change_in_all_frames_of_the_object(content: bytes) -> None:
    key = KEYS[2]
    first, *others = parsed(content)[key]
    longer = replace(first, label="Truck & trailer", box=(*first.box[:3], 9.5, *first.box[4:]))
    changed = LABELS.render(content, FILE, {key: [longer, *others]})
    assert len(lines_changed(content, changed)) == 4
    for frame in range(5):
        label = parsed(changed)[KEYS[frame]][0]
        assert (label.label, label.box[3]) == ("Truck & trailer", 9.5)
    other = replace(parsed(content)[KEYS[3]][0], box=(*first.box[:3], 8.0, *first.box[4:]))
    with pytest.raises(ConfigError, match="one size in all frames"):
        LABELS.render(content, FILE, {key: [longer, *others], KEYS[3]: [other]})


def test_an_object_whose_middle_goes_is_two(content: bytes) -> None:
    key = KEYS[2]
    first, *others = parsed(content)[key]
    again = parsed(LABELS.render(content, FILE, {key: others}))
    assert [label.label for label in again[key]] == ["Van", "Pedestrian"]
    assert [label.track for label in again[KEYS[1]]] == ["0", "1"]
    assert [(label.label, label.track) for label in again[KEYS[3]]][-1] == ("Car", "3")
    assert again[KEYS[4]][-1].box == parsed(content)[KEYS[4]][0].box
    assert first.box not in [label.box for label in again[key]]


def test_an_object_that_goes_everywhere_leaves_no_trace(content: bytes) -> None:
    found = parsed(content)
    gone = LABELS.render(content, FILE, {key: [one for one in found[key] if one.label != "Car"] for key in KEYS})
    assert gone[gone.index(b"<tracklets") :].split(b"<count>")[1].startswith(b"2<")
    again = parsed(gone)
    assert {label.label for labels in again.values() for label in labels} == {"Van", "Pedestrian"}
    assert gone.count(b'class_id="1"') == gone.count(b'class_id="2"') == gone.count(b'class_id="3"') == 1
    assert gone.index(b'class_id="1"') < gone.index(b"Van")  # the first object names the kinds now
    assert gone.endswith(content[content.index(b"</tracklets>") :])


def test_a_new_box_goes_on_with_its_object(content: bytes) -> None:
    found = parsed(content)
    follows = replace(moved(found[KEYS[4]][0], 1.0), id="n1")
    changed = LABELS.render(content, FILE, {KEYS[5]: [*found[KEYS[5]], follows]})
    assert {label.track: label.box for label in parsed(changed)[KEYS[5]]}["0"] == pytest.approx(follows.box)
    assert content.replace(b"<count>5</count>", b"<count>6</count>")[:400] == changed[:400]
    before = replace(moved(found[KEYS[2]][2], -1.0), id="n1")
    earlier = LABELS.render(content, FILE, {KEYS[1]: [*found[KEYS[1]], before]})
    assert [(label.label, label.track) for label in parsed(earlier)[KEYS[1]]] == [
        ("Car", "0"),
        ("Van", "1"),
        ("Pedestrian", "2"),
    ]
    assert parsed(earlier)[KEYS[5]] == found[KEYS[5]]


def test_new_objects_stand_at_the_end(content: bytes) -> None:
    wanted = {key: [*parsed(content)[key], moved(CAR, number)] for number, key in enumerate(KEYS[5:8])}
    changed = LABELS.render(content, FILE, wanted)
    again = parsed(changed)
    assert [again[key][-1].track for key in KEYS[5:8]] == ["3", "3", "3"]
    assert again[KEYS[7]][-1].box == pytest.approx(moved(CAR, 2).box)
    assert changed.startswith(content[: content.index(b"<count>3")])
    alone = LABELS.render(None, FILE, {KEYS[0]: [CAR]})
    assert parsed(alone)[KEYS[0]][0].box == pytest.approx(CAR.box)


def test_another_track_is_another_object(content: bytes) -> None:
    first, *others = parsed(content)[KEYS[4]]
    again = parsed(LABELS.render(content, FILE, {KEYS[4]: [replace(first, track="77"), *others]}))
    assert sorted(label.track for label in again[KEYS[4]]) == ["1", "3"]
    assert [label.track for label in again[KEYS[3]]] == ["0", "1", "2"]


def test_refusals(content: bytes) -> None:
    with pytest.raises(DatasetError, match="expected a frame"):
        LABELS.path(("drive", "none"))
    with pytest.raises(FileFormatError):
        LABELS.render(content[:300], FILE, {KEYS[0]: [CAR]})
    strange = replace(parsed(content)[KEYS[0]][0], attributes={"occlusion": 7.0})
    with pytest.raises(ConfigError, match="occlusion"):
        LABELS.render(content, FILE, {KEYS[0]: [strange]})


def test_a_real_drive(shared_real: Path) -> None:
    data = open_dataset(shared_real / "kitti_raw")
    labels = label_format(data)
    assert isinstance(labels, TrackletLabels)
    key = data.keys[len(data) // 2]
    path = labels.path(key)
    content = path.read_bytes()
    found = labels.parse(content, path, [key])[key]
    assert labels.render(content, path, {key: found}) == content
    changed = labels.render(content, path, {key: [moved(found[0]), *found[1:]]})
    assert len(lines_changed(content, changed)) == 2
    without = labels.parse(labels.render(content, path, {key: found[1:]}), path, [key])[key]
    assert sorted(label.box for label in without) == sorted(label.box for label in found[1:])

"""Label files of annotation tools, edited: what is not edited keeps its bytes."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from farfield.datasets.labels import BoxLabel
from farfield.datasets.labels.json_labels import DatumaroLabels, JsonLabels, OpenLabels, SustechLabels
from farfield.datasets.labels.tool_labels import SuperviselyLabels
from farfield.files.cuboids import Cuboid
from farfield.files.datumaro import format_datumaro
from farfield.files.openlabel import format_openlabel
from farfield.files.supervisely import format_episode
from farfield.files.sustechpoints import format_sustechpoints

A, B = ("seq", "0001"), ("seq", "0002")
YAW = math.radians(30)
CAR = Cuboid(frame="0001", label="Car", box=(10.5, -2.25, 0.3, 4.6, 1.9, 1.5, YAW), track="7")
BUS = Cuboid(frame="0001", label="Bus", box=(40.0, 8.0, 0.5, 11.5, 2.5, 3.3, -2.9), track="9")
LATER = replace(CAR, frame="0002", box=(11.5, *CAR.box[1:]))
NEW = BoxLabel(id="new", label="Van", box=(5.0, 1.0, 0.2, 5.0, 2.0, 2.2, -YAW), track="11")
FOLDER = Path("labels")
FORMATS: dict[str, tuple[JsonLabels, str]] = {
    "openlabel": (OpenLabels(FOLDER), format_openlabel([CAR, BUS, LATER], ["0001", "0002"])),
    "cvat": (DatumaroLabels(FOLDER), format_datumaro([CAR, BUS, LATER], ["0001", "0002"])),
    "sustechpoints": (SustechLabels(FOLDER), format_sustechpoints([CAR, BUS])),
    "supervisely": (
        SuperviselyLabels(dict.fromkeys((A, B), FOLDER), "supervisely", {A: "0", B: "1"}),
        format_episode([replace(CAR, frame="0"), replace(BUS, frame="0"), replace(LATER, frame="1")], 2),
    ),
}


@pytest.fixture(params=[(name, tight) for name in FORMATS for tight in (False, True)], ids=str)
def known(request: pytest.FixtureRequest) -> tuple[JsonLabels, bytes, list[BoxLabel]]:
    name, tight = request.param
    labels, text = FORMATS[name]
    data = (json.dumps(json.loads(text), separators=(",", ":")) if tight else text).encode()
    return labels, data, list(labels.parse(data, labels.path(A), [A, B])[A])


def test_saved_as_it_was(known: tuple[JsonLabels, bytes, list[BoxLabel]]) -> None:
    labels, data, found = known
    assert [label.label for label in found] == ["Car", "Bus"]
    assert [label.track for label in found] == ["7", "9"]
    assert found[0].box == pytest.approx(CAR.box)
    assert labels.render(data, labels.path(A), {A: found}) == data
    turned = [replace(found[0], box=(*found[0].box[:6], found[0].box[6] + 2 * math.pi)), found[1]]
    assert labels.render(data, labels.path(A), {A: turned}) == data


def test_one_number_changed_is_one_number_changed(known: tuple[JsonLabels, bytes, list[BoxLabel]]) -> None:
    labels, data, found = known
    moved = [found[0], replace(found[1], box=(41.25, *found[1].box[1:]))]
    changed = labels.render(data, labels.path(A), {A: moved})
    assert changed == data.replace(b"40.0", b"41.25")
    assert list(labels.parse(changed, labels.path(A), [A])[A]) == moved


def test_all_of_an_object_is_edited(known: tuple[JsonLabels, bytes, list[BoxLabel]]) -> None:
    labels, data, found = known
    edited = replace(found[0], label="Van", box=NEW.box)
    changed = labels.render(data, labels.path(A), {A: [edited, found[1]]})
    again = labels.parse(changed, labels.path(A), [A, B])
    assert again[A][0].box == pytest.approx(NEW.box)
    assert [label.label for label in again[A]] == ["Van", "Bus"]
    assert again[A][1] == found[1]


def test_objects_come_and_go(known: tuple[JsonLabels, bytes, list[BoxLabel]]) -> None:
    labels, data, found = known
    changed = labels.render(data, labels.path(A), {A: [found[1], NEW]})
    again = labels.parse(changed, labels.path(A), [A, B])
    assert [(label.label, label.track) for label in again[A]] == [("Bus", "9"), ("Van", "11")]
    assert again[A][1].box == pytest.approx(NEW.box)
    assert labels.parse(labels.render(data, labels.path(A), {A: []}), labels.path(A), [A])[A] == ()
    if labels.name != "sustechpoints":
        assert again[B] == labels.parse(data, labels.path(A), [B])[B]


def test_another_track_is_another_object(known: tuple[JsonLabels, bytes, list[BoxLabel]]) -> None:
    labels, data, found = known
    changed = labels.render(data, labels.path(A), {A: [replace(found[0], track="12"), found[1]]})
    again = labels.parse(changed, labels.path(A), [A, B])
    assert {label.track: label.label for label in again[A]} == {"12": "Car", "9": "Bus"}
    if labels.name != "sustechpoints":
        assert again[B][0].track == "7"


def test_a_new_file(known: tuple[JsonLabels, bytes, list[BoxLabel]]) -> None:
    labels = known[0]
    made = labels.render(None, labels.path(A), {A: [NEW], B: []})
    (found,) = labels.parse(made, labels.path(A), [A])[A]
    assert found.box == pytest.approx(NEW.box)
    assert (found.label, found.track) == ("Van", "11")
    assert labels.render(made, labels.path(A), {A: [found]}) == made


def test_nine_numbers_stay_nine() -> None:
    content: Any = json.loads(format_openlabel([CAR], ["0001"]))
    cuboid = content["openlabel"]["frames"]["0"]["objects"]["7"]["object_data"]["cuboid"][0]
    cuboid["val"] = [*CAR.box[:3], 0.01, 0.02, YAW, *CAR.box[3:6]]
    data, labels = json.dumps(content).encode(), OpenLabels(FOLDER)
    (found,) = labels.parse(data, labels.path(A), [A])[A]
    assert found.box == CAR.box
    changed = labels.render(data, labels.path(A), {A: [replace(found, box=(*found.box[:6], 0.75))]})
    assert changed == data.replace(repr(YAW).encode(), b"0.75")


def test_frames_may_be_numbered_without_zeros() -> None:
    data = format_openlabel([replace(CAR, frame="1")], ["1"]).encode()
    assert len(OpenLabels(FOLDER).parse(data, FOLDER, [A])[A]) == 1


def test_sustechpoints_own_files_come_back(shared_real: Path) -> None:
    labels = SustechLabels(shared_real / "sustechpoints", scene=True)
    paths = sorted((shared_real / "sustechpoints" / "label").glob("*.json"))
    assert len(paths) == 4
    for path in paths:
        key, data = ("scene", path.stem), path.read_bytes()
        assert labels.path(key) == path
        found = list(labels.parse(data, path, [key])[key])
        assert labels.render(data, path, {key: found}) == data
        found[0] = replace(found[0], box=(1.0, *found[0].box[1:]))
        changed = labels.render(data, path, {key: found})
        assert len(changed) != len(data)
        assert list(labels.parse(changed, path, [key])[key]) == found

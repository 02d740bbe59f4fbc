"""Boxes in the formats of annotation tools: asymmetric ones, turned by 30 degrees, come back as they were."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from farfield.errors import FileFormatError
from farfield.files import xml_tree
from farfield.files.cuboids import Cuboid, CuboidEntry
from farfield.files.datumaro import format_datumaro, parse_datumaro
from farfield.files.openlabel import format_openlabel, parse_openlabel
from farfield.files.supervisely import parse_supervisely
from farfield.files.sustechpoints import format_sustechpoints, parse_sustechpoints
from farfield.files.tracklets import parse_tracklets

YAW = math.radians(30)
CAR = Cuboid(frame="a1", label="Car", box=(10.5, -2.25, 0.3, 4.6, 1.9, 1.5, YAW), track="7")
BUS = Cuboid(
    frame="b2", label="Bus", box=(40.0, 8.0, 0.5, 11.5, 2.5, 3.3, -2.9), track="9", attributes={"occluded": True}
)
VAN = Cuboid(
    frame="3", label="Van", box=(10.0, 2.0, -0.8, 5.0, 1.8, 2.0, YAW), track="0", attributes={"occlusion": 1.0}
)
XML = """<?xml version="1.0"?><!DOCTYPE boost_serialization>
<boost_serialization version="9"><tracklets><count>1</count><item><objectType>Van</objectType>
<h>2.0</h><w>1.8</w><l>5.0</l><first_frame>3</first_frame><poses><count>2</count>
<item><tx>10</tx><ty>2</ty><tz>-1.8</tz><rx>0</rx><ry>0</ry><rz>0.5235987755982988</rz><occlusion>1</occlusion></item>
<item><tx>11</tx><ty>2</ty><tz>-1.8</tz><rx>0</rx><ry>0</ry><rz>0.6</rz></item>
</poses></item></tracklets></boost_serialization>"""
SLY: dict[str, Any] = {
    "objects": [{"key": "k1", "classTitle": "Car", "tags": [{"name": "parked", "value": "yes"}]}],
    "figures": [
        {
            "objectKey": "k1",
            "geometryType": "cuboid_3d",
            "geometry": {
                "position": {"x": 10.5, "y": -2.25, "z": 0.3},
                "rotation": {"x": 0, "y": 0, "z": YAW},
                "dimensions": {"x": 4.6, "y": 1.9, "z": 1.5},
            },
        },
        {"objectKey": "k1", "geometryType": "point_3d", "geometry": {}},
    ],
}


def near(found: Cuboid, wanted: Cuboid) -> None:
    assert found.box == pytest.approx(wanted.box, abs=1e-12)
    assert replace(found, box=wanted.box) == wanted


def plain(found: tuple[CuboidEntry, ...]) -> list[Cuboid]:
    return [placed.cuboid for placed in found]


def at(content: Any, steps: tuple[str | int, ...]) -> Any:
    for step in steps:
        content = content[step]
    return content


def test_openlabel_comes_back() -> None:
    text = format_openlabel([CAR, BUS], ["a1", "none", "b2"], [1_500_000_000, None, 7])
    found = parse_openlabel(text.encode(), "labels.json")
    for one, wanted in zip(plain(found), (CAR, BUS), strict=True):
        near(one, wanted)
    root = json.loads(text)["openlabel"]
    assert root["metadata"]["schema_version"] == "1.0.0"
    assert root["frames"]["0"]["frame_properties"] == {"frame_id": "a1", "timestamp": "1.500000000"}
    assert root["frames"]["1"]["objects"] == {}
    assert len(at(json.loads(text), found[0].steps)["val"]) == 10
    val = root["frames"]["0"]["objects"]["7"]["object_data"]["cuboid"][0]["val"]
    assert val[3:7] == pytest.approx([0, 0, math.sin(math.radians(15)), math.cos(math.radians(15))])


def test_openlabel_with_euler_angles_and_numbered_frames() -> None:
    val = [10.5, -2.25, 0.3, 0.01, 0.02, YAW, 4.6, 1.9, 1.5]
    frame = {"objects": {"7": {"object_data": {"cuboid": [{"name": "c", "val": val}]}}}}
    root = {"metadata": {}, "objects": {"7": {"type": "Car"}}, "frames": {"33": frame}}
    (found,) = parse_openlabel(json.dumps({"openlabel": root}).encode(), "labels.json")
    near(found.cuboid, replace(CAR, frame="33"))
    assert found.cuboid.box[6] == YAW  # as it stands there: no quaternion between


def test_objects_without_a_track_stay_apart() -> None:
    text = format_openlabel([replace(CAR, track=""), replace(CAR, track=""), replace(CAR, track="0")], ["a1"])
    assert sorted(cuboid.track for cuboid in plain(parse_openlabel(text.encode(), "x"))) == ["0", "1", "2"]


def test_sustechpoints_comes_back() -> None:
    parked = replace(BUS, attributes={"obj_attr": "parked"})
    found = plain(parse_sustechpoints(format_sustechpoints([CAR, parked]).encode(), "a1.json"))
    assert len(found) == 2
    near(found[0], replace(CAR, frame=""))
    near(found[1], replace(parked, frame=""))


def test_sustechpoints_own_sample(shared_real: Path) -> None:
    path = shared_real / "sustechpoints" / "label" / "000965.json"
    found = plain(parse_sustechpoints(path.read_bytes(), path))
    assert len(found) == 21
    assert found[0].box[:3] == (5.585192027760058, -48.75586246676285, 1.4203556999999993)
    assert found[0].box[6] == 1.4025025217488531
    assert found[0].track == "4"
    assert all(cuboid.box[3] > cuboid.box[4] for cuboid in found if cuboid.label == "Car")


def test_datumaro_comes_back() -> None:
    text = format_datumaro([CAR, BUS], ["a1", "none", "b2"])
    found = plain(parse_datumaro(text.encode(), "default.json"))
    near(found[0], replace(CAR, attributes={"occluded": False}))
    near(found[1], BUS)
    content = json.loads(text)
    assert [item["id"] for item in content["items"]] == ["a1", "none", "b2"]
    assert content["items"][0]["annotations"][0]["label_id"] == 1
    assert [each["name"] for each in content["categories"]["label"]["labels"]] == ["Bus", "Car"]


def test_supervisely_is_read() -> None:
    (entry,) = parse_supervisely(json.dumps(SLY).encode(), "a1.pcd.json")
    found = entry.cuboid
    near(found, replace(CAR, frame="", track="k1", attributes={"parked": "yes"}))
    assert (found.track, found.attributes) == ("k1", {"parked": "yes"})


def test_tracklets_stand_on_their_bottom() -> None:
    first, second = parse_tracklets(XML.encode(), "tracklet_labels.xml")
    near(first, VAN)
    assert (second.frame, second.box[0]) == ("4", 11.0)


def test_real_tracklets(shared_real: Path) -> None:
    path = next((shared_real / "kitti_raw").rglob("tracklet_labels.xml"))
    found = parse_tracklets(path.read_bytes(), path)
    assert len({cuboid.track for cuboid in found}) == 15
    car = found[0]
    assert (car.label, car.frame) == ("Car", "0")
    assert car.box[:3] == pytest.approx((25.212516, 8.603392, -1.792157 + 2.1672349 / 2), abs=1e-5)
    assert car.box[3:6] == (4.3293562, 1.7057118, 2.1672349)


BOMB = """<!DOCTYPE a [<!ENTITY b "bb"><!ENTITY c "&b;&b;&b;&b;">]><boost_serialization><tracklets>&c;</tracklets>
</boost_serialization>"""
OUTSIDE = """<!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/hostname">]><boost_serialization><tracklets>&b;</tracklets>
</boost_serialization>"""


@pytest.mark.parametrize(
    "text", [BOMB, OUTSIDE, "<a>" * 100, XML.replace("<tx>10", "<tx>nan"), XML.replace("<l>5.0", "<l>-5"), "", "<a/>"]
)
def test_hostile_xml_is_refused(text: str) -> None:
    with pytest.raises(FileFormatError):
        parse_tracklets(text.encode(), "tracklet_labels.xml")


OBJECT = ("openlabel", "frames", "0", "objects", "7")
OPENLABEL = json.loads(format_openlabel([CAR], ["a1"]))
DATUMARO = json.loads(format_datumaro([CAR], ["a1"]))
SUSTECH = json.loads(format_sustechpoints([CAR]))
WRONG: list[tuple[Callable[..., Any], Any, tuple[str | int, ...], Any]] = [
    (parse_openlabel, OPENLABEL, ("openlabel", "objects"), {}),
    (parse_openlabel, OPENLABEL, ("openlabel", "frames"), []),
    *(
        (
            parse_openlabel,
            OPENLABEL,
            ("openlabel", "frames", "0", "objects", "7", "object_data", "cuboid", 0, "val"),
            val,
        )
        for val in ([1] * 8, [1, 2, 3, 0, 0, 0, 0, 1, 1, 1], [1, 2, 3, 0, 0, 0, 1, 0, 1, 1], [None] * 10, "x" * 10)
    ),
    (parse_datumaro, DATUMARO, ("items", 0, "annotations", 0, "label_id"), 5),
    (parse_datumaro, DATUMARO, ("items", 0, "annotations", 0, "scale"), [1, 1, 1e9]),
    (parse_datumaro, DATUMARO, ("categories",), {}),
    (parse_datumaro, DATUMARO, ("items", 0, "id"), "line\nbreak"),
    (parse_sustechpoints, SUSTECH, (0, "psr", "scale", "x"), 0),
    (parse_sustechpoints, SUSTECH, (0, "obj_type"), None),
    (parse_sustechpoints, SUSTECH, (0,), []),
    (parse_supervisely, SLY, ("figures", 0, "objectKey"), "none"),
    (parse_supervisely, SLY, ("objects",), None),
]


@pytest.mark.parametrize(("parse", "content", "steps", "value"), WRONG)
def test_what_is_wrong_is_named(
    parse: Callable[..., Any], content: Any, steps: tuple[str | int, ...], value: Any
) -> None:
    damaged = json.loads(json.dumps(content))
    at(damaged, steps[:-1])[steps[-1]] = value
    with pytest.raises(FileFormatError, match=r"labels\.json"):
        parse(json.dumps(damaged).encode(), "labels.json")
    assert partial(parse, json.dumps(content).encode())("labels.json")


def test_xml_of_very_many_elements_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(xml_tree, "MAX_ELEMENTS", 100)
    assert len(xml_tree.parse_xml(b"<a>" + b"<b/>" * 99 + b"</a>", "a.xml").children) == 99
    with pytest.raises(FileFormatError, match="more than 100 elements"):
        xml_tree.parse_xml(b"<a>" + b"<b/>" * 100 + b"</a>", "a.xml")

"""Slips in own labels and those of tools: each is refused, as it would change a number in silence."""

import json
from pathlib import Path
from typing import Any

import pytest

from farfield.datasets.folder import read_boxes as read_own
from farfield.errors import FileFormatError
from farfield.files.boxes_csv import parse_boxes_csv
from farfield.files.datumaro import parse_datumaro
from farfield.files.openlabel import parse_openlabel
from farfield.files.tracklets import parse_tracklets

NAN, FAR = float("nan"), 2e7
TURNED, ON_ITS_SIDE = [0.0, 0.0, 3.0, 4.0], [0.6, 0.0, 0.0, 0.8]  # x, y, z, w


def written(path: Path, content: Any) -> Path:
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


# Own folders.


def test_classes_of_own_json_stand_on_one_line(tmp_path: Path) -> None:
    box = {"label": "C\0ar", "centre_m": [10, 2, -1], "size_m": [4, 2, 1.5], "yaw_rad": 1}
    with pytest.raises(FileFormatError, match="label"):
        read_own(written(tmp_path / "wrong.json", {"boxes": [box]}))


@pytest.mark.parametrize("value", ["4.5", True, "true", [4.5]])
@pytest.mark.parametrize("key", ["yaw_rad", "score", "track_id", "size_m", "centre_m", "velocity_m_s"])
def test_own_json(tmp_path: Path, key: str, value: Any) -> None:
    box: dict[str, Any] = {"label": "Car", "centre_m": [10, 2, -1], "size_m": [4, 2, 1.5], "yaw_rad": 1, "score": 1}
    box |= {"track_id": 3, "velocity_m_s": [1, 2]}
    assert read_own(written(tmp_path / "good.json", {"boxes": [box]})).track_id.tolist() == [3]
    holder = box[key] if isinstance(box[key], list) else box
    holder[0 if holder is not box else key] = value
    with pytest.raises(FileFormatError):
        read_own(written(tmp_path / "wrong.json", {"boxes": [box]}))


# Labelling tools.


def datumaro(**attributes: Any) -> bytes:
    entry = {"type": "cuboid_3d", "label_id": 0, "attributes": attributes, "position": [10, 2, -1]}
    entry |= {"rotation": [0, 0, 1], "scale": [4, 2, 1.5]}
    names = {"label": {"labels": [{"name": "Car"}]}}
    return json.dumps({"categories": names, "items": [{"id": "a", "annotations": [entry]}]}).encode()


@pytest.mark.parametrize("track", [2.5, True, -7, [2], 10**30])
def test_tracks_of_datumaro(track: Any) -> None:
    tracks = ("7", 2147483647, 7.0, "a b", None, -1)
    read = [parse_datumaro(datumaro(track_id=value), "a.json")[0].cuboid.track for value in tracks]
    assert read == ["7", "2147483647", "7", "a b", "", ""]
    with pytest.raises(FileFormatError, match="beyond 64 bits" if track == 10**30 else "track_id"):
        parse_datumaro(datumaro(track_id=track), "a.json")


def test_large_attributes_of_datumaro_are_read() -> None:
    assert parse_datumaro(datumaro(stamp=1.7e18), "a.json")[0].cuboid.attributes["stamp"] == 1.7e18


def test_openlabel_has_one_form_of_cuboids_in_a_file() -> None:
    values = [10, 2, -1, 0, 0, 0.6, 0.8, 4, 2, 1.5]
    objects = {name: {"object_data": {"cuboid": [{"val": values}]}} for name in "ab"}
    root: dict[str, Any] = {"objects": {name: {"type": "Car"} for name in "ab"}, "frames": {"0": {"objects": objects}}}
    assert len(parse_openlabel(json.dumps({"openlabel": root}).encode(), "a.json")) == 2
    objects["b"]["object_data"]["cuboid"] = [{"val": values[:1] + values[2:]}]
    with pytest.raises(FileFormatError, match=r"object b.*10 numbers"):
        parse_openlabel(json.dumps({"openlabel": root}).encode(), "a.json")
    objects["b"]["object_data"]["cuboid"] = [{"val": [*values[:5], 3, 4, *values[7:]]}]
    with pytest.raises(FileFormatError, match=r"object b.*quaternion"):
        parse_openlabel(json.dumps({"openlabel": root}).encode(), "a.json")


def test_digits_of_other_scripts_are_no_numbers(tmp_path: Path) -> None:
    table = "frame,label,x,y,z,l,w,h,yaw_rad\na,Car,\u0663,2,-1,4,2,1.5,0\n"
    with pytest.raises(FileFormatError, match="number as x"):
        parse_boxes_csv(table.encode(), "a.csv")
    pose = "<item><tx>\u0663</tx><ty>2</ty><tz>0</tz><rx>0</rx><ry>0</ry><rz>0</rz></item>"
    head = "<objectType>Car</objectType><h>1.5</h><w>1.8</w><l>4</l><first_frame>0</first_frame>"
    text = f"<b><tracklets><item>{head}<poses>{pose}</poses></item></tracklets></b>"
    with pytest.raises(FileFormatError, match="number as tx"):
        parse_tracklets(text.encode(), "a.xml")

"""Targets of the fuzzer: boxes in the formats of annotation tools."""

import json
import math
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from farfield.files.cuboids import Cuboid, CuboidEntry
from farfield.files.datumaro import format_datumaro, parse_datumaro
from farfield.files.openlabel import format_openlabel, parse_openlabel
from farfield.files.supervisely import parse_supervisely
from farfield.files.sustechpoints import format_sustechpoints, parse_sustechpoints
from farfield.files.tracklets import parse_tracklets

Parts = tuple[str, Callable[[Path], Any], tuple[bytes, ...], Callable[[Any], bool], tuple[bytes, ...]]
CARS = [
    Cuboid(frame=name, label="Car", box=(10.0 + number, -2.5, 0.3, 4.6, 1.9, 1.5, 0.52), track=str(number))
    for number, name in enumerate(("a", "a", "b"))
]
DEEP = b'{"a":' * 5000 + b"1" + b"}" * 5000
POSE = "<item><tx>10.0</tx><ty>2.0</ty><tz>-1.8</tz><rx>0</rx><ry>0</ry><rz>0.5</rz><occlusion>0</occlusion></item>"
OBJECT = (
    "<item><objectType>Car</objectType><h>1.5</h><w>1.9</w><l>4.6</l><first_frame>2</first_frame>"
    f"<poses><count>2</count>{POSE}{POSE}</poses></item>"
)
XML = f"<?xml version='1.0'?><!DOCTYPE b><b><tracklets><count>1</count>{OBJECT}</tracklets></b>"
LAUGHS = "".join(f"<!ENTITY a{n + 1} '{f'&a{n};' * 10}'>" for n in range(9))
BOMB = f"<!DOCTYPE b [<!ENTITY a0 'ha'>{LAUGHS}]><b><tracklets>&a9;</tracklets></b>"
FETCH = "<!DOCTYPE b [<!ENTITY a SYSTEM 'file:///dev/zero'>]><b><tracklets>&a;</tracklets></b>"
PLACE = {"x": 10.0, "y": 2.0, "z": 0.5}
GEOMETRY = {"position": PLACE, "rotation": {"x": 0, "y": 0, "z": 0.5}, "dimensions": {"x": 4.6, "y": 1.9, "z": 1.5}}
SUPERVISELY = {
    "objects": [{"key": "k", "classTitle": "Car", "tags": [{"name": "parked", "value": True}]}],
    "figures": [{"key": "f", "objectKey": "k", "geometryType": "cuboid_3d", "geometry": GEOMETRY}],
}


def exchange_targets() -> Mapping[str, Parts]:
    """Suffix, reader, good files, what a valid result is, and files that must be refused, by the reader's name."""
    parts = {
        "openlabel": (parse_openlabel, format_openlabel(CARS, ["a", "b"], [5, 6])),
        "sustechpoints": (parse_sustechpoints, format_sustechpoints(CARS)),
        "datumaro": (parse_datumaro, format_datumaro(CARS, ["a", "b"])),
        "supervisely": (parse_supervisely, json.dumps(SUPERVISELY)),
    }
    found: dict[str, Parts] = {
        name: (".json", partial(_read, parse), (text.encode(),), sound, (DEEP,))
        for name, (parse, text) in parts.items()
    }
    hostile = (BOMB.encode(), FETCH.encode(), b"<a>" * 100_000)
    return found | {"tracklets": (".xml", partial(_read, parse_tracklets), (XML.encode(),), sound, hostile)}


def _read(parse: Callable[[bytes, Path], Any], path: Path) -> Any:
    return parse(path.read_bytes(), path)


def sound(found: Any) -> bool:
    """Every box has finite numbers and positive sizes."""
    cuboids = [each.cuboid if isinstance(each, CuboidEntry) else each for each in found]
    return all(all(map(math.isfinite, one.box)) and min(one.box[3:6]) > 0 for one in cuboids)

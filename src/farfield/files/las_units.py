"""The units of LAS files: what their coordinate system says, in GeoTIFF's keys or in WKT; what is no metre is refused.

Sources: ASPRS, "LAS Specification 1.4 - R15" (2019), https://github.com/ASPRSorg/LAS (section on georeferencing); OGC,
"GeoTIFF standard 1.1", https://docs.ogc.org/is/19-008r4/19-008r4.html (keys and codes); OGC 12-063r5 (WKT 2).
"""

import re
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from farfield.errors import FileFormatError
from farfield.files.epsg_metres import is_in_metres

KEYS_RECORD, WKT_RECORD = ("LASF_Projection", 34735), ("LASF_Projection", 2112)
_MODEL, _PROJECTED, _LENGTH_UNIT, _VERTICAL, _HEIGHT_UNIT = 1024, 3072, 3076, 4096, 4099
_USER_DEFINED, _METRE = 32767, 9001
_UNITS = {9002: "feet", 9003: "US survey feet", 9005: "Clarke's feet", 9014: "fathoms", 9036: "kilometres"}
_HEIGHTS_IN_FEET = {6360: "US survey feet", 8228: "feet", 5702: "US survey feet"}
_OF_LENGTHS = ("PROJCS", "PROJCRS", "PROJECTEDCRS", "LOCAL_CS", "ENGCRS", "VERT_CS", "VERTCRS", "VERTICALCRS")
_MAX_WKT, _MAX_DEPTH = 1 << 16, 32
_WORD = re.compile(r'\s*("(?:[^"]|"")*"|[A-Za-z_][A-Za-z_0-9]*|[-+.0-9eE]+|[\[\](),])')
_FIX = (
    "Write the points in metres, such as with pdal translate IN.las OUT.las reprojection "
    "--filters.reprojection.out_srs=EPSG:32632, by the zone where they lie."
)


@dataclass
class _Node:
    """A keyword of WKT with what stands in its brackets."""

    name: str
    values: list[str] = field(default_factory=list)
    children: list["_Node"] = field(default_factory=list)

    def all_of(self, *names: str) -> list["_Node"]:
        return [child for child in self.children if child.name in names]


def check_metres(records: Mapping[tuple[str, int], bytes], *, path: Path | str) -> None:
    """See that coordinates are metres along x, y and z, as far as a file says anything on it.

    Args:
        records: A file's records by user and number.
        path: The file, for messages.

    Raises:
        FileFormatError: If they are degrees, feet or geocentric, their unit is not told by a system that is named, or
            what should tell it is damaged.
    """
    if KEYS_RECORD in records:
        _check_keys(_keys(records[KEYS_RECORD], path), path)
    if WKT_RECORD in records:
        text = records[WKT_RECORD].rstrip(b"\0 \n")
        if text:
            _check_system(_parsed(text, path), path)


def _keys(data: bytes, path: Path | str) -> dict[int, int]:
    """GeoTIFF's keys whose values are codes."""
    count = struct.unpack_from("<4H", data)[3] if len(data) >= 8 else -1
    if count < 0 or len(data) < 8 * (count + 1):
        expected, actual = f"{max(count, 0)} keys of 8 bytes", f"{len(data)} bytes"
        raise FileFormatError(path, where="GeoTIFF's keys", expected=expected, got=actual)
    rows = (struct.unpack_from("<4H", data, 8 * (row + 1)) for row in range(count))
    return {key: value for key, location, _, value in rows if location == 0}


def _check_keys(keys: Mapping[int, int], path: Path | str) -> None:
    where = "GeoTIFF's keys"
    if not keys:
        return
    model, code, unit = keys.get(_MODEL), keys.get(_PROJECTED), keys.get(_LENGTH_UNIT)
    if model == 2:
        raise _refused(path, where, "degrees (a geographic coordinate system)")
    if model == 3:
        raise _refused(path, where, "geocentric coordinates, whose z is not up")
    if unit is not None and unit != _METRE:
        raise _refused(path, where, _UNITS.get(unit, f"the unit of EPSG's code {unit}"))
    if unit is None and (model == 1 or code is not None):
        if code is None or code == _USER_DEFINED:
            raise _refused(path, where, "a projection whose unit is not told")
        if not is_in_metres(code):
            what = f"EPSG:{code} without its unit, which is none of EPSG's systems in metres east and north"
            raise _refused(path, where, what)
    height, vertical = keys.get(_HEIGHT_UNIT), keys.get(_VERTICAL, 0)
    if height is not None and height != _METRE:
        raise _refused(path, where, f"heights in {_UNITS.get(height, f'the unit of EPSG code {height}')}")
    if height is None and vertical in _HEIGHTS_IN_FEET:
        raise _refused(path, where, f"heights in {_HEIGHTS_IN_FEET[vertical]} (EPSG:{vertical})")


def _refused(path: Path | str, where: str, what: str) -> FileFormatError:
    return FileFormatError(path, where=where, expected="coordinates in metres", got=what, fix=_FIX)


def _parsed(data: bytes, path: Path | str) -> _Node:
    """A text of WKT as a tree."""
    fault = FileFormatError(path, where="the WKT", expected="one coordinate system", got=repr(data[:80]))
    if len(data) > _MAX_WKT:
        raise fault
    root = _Node("")
    open_nodes, text, at = [root], data.decode("utf-8", errors="replace"), 0
    while at < len(text.rstrip()):
        match = _WORD.match(text, at)
        if match is None:
            raise fault
        word, at, node = match[1], match.end(), open_nodes[-1]
        if word in "[(":
            if not node.values or len(open_nodes) > _MAX_DEPTH:
                raise fault
            node.children.append(_Node(node.values.pop().upper()))
            open_nodes.append(node.children[-1])
        elif word in "])":
            open_nodes.pop()
            if not open_nodes:
                raise fault
        elif word != ",":
            node.values.append(word)
    if len(open_nodes) != 1 or len(root.children) != 1:
        raise fault
    return root.children[0]


def _check_system(system: _Node, path: Path | str) -> None:
    where = f"the WKT, {system.name}"
    if system.name in ("COMPD_CS", "COMPOUNDCRS", "BOUNDCRS", "SOURCECRS"):
        parts = system.all_of(
            "PROJCS", "PROJCRS", "GEOGCS", "GEOGCRS", "GEODCRS", "GEOCCS", "VERT_CS", "VERTCRS", "LOCAL_CS", "ENGCRS",
            "SOURCECRS", "COMPD_CS", "COMPOUNDCRS", "BOUNDCRS", "PROJECTEDCRS", "VERTICALCRS", "GEOGRAPHICCRS",
        )  # fmt: skip
        if not parts:
            raise _refused(path, where, "a system whose parts are not known")
        for part in parts:
            _check_system(part, path)
    elif system.name in ("GEOGCS", "GEOGCRS", "GEOGRAPHICCRS"):
        raise _refused(path, where, "degrees (a geographic coordinate system)")
    elif system.name in ("GEOCCS", "GEODCRS", "GEODETICCRS"):
        raise _refused(path, where, "geocentric or geodetic coordinates, whose z is not up")
    elif system.name in _OF_LENGTHS:
        units = list(_units(system))
        if not units:
            raise _refused(path, where, "a system whose unit is not told")
        for name, factor in units:
            if factor is None or abs(factor - 1) > 1e-9:
                raise _refused(path, where, f"{name[:40]} ({'no' if factor is None else f'{factor:.9g}'} m each)")
    else:
        raise _refused(path, where, "a system of a kind that is not known")


def _units(system: _Node) -> Iterator[tuple[str, float | None]]:
    """The units of a system's axes: its own, or those of each axis."""
    names = ("UNIT", "LENGTHUNIT")
    units = system.all_of(*names) + [unit for axis in system.all_of("AXIS") for unit in axis.all_of(*names)]
    for unit in units:
        try:
            factor = float(unit.values[1])
        except (IndexError, ValueError):
            factor = None
        yield (unit.values[0].strip('"') if unit.values else "a unit without a name"), factor

"""Structural edits of PCD files, after the Point Cloud Library's description of the format, and its LZF."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from _structures import Case, Family, Oracle
from _structures_clouds import Sweeps, case_of, chosen_edits, make_sweeps, stems


def pcd(encoding: str, random: np.random.Generator, folder: Path) -> Case:
    """Sweeps as PCD files of one encoding."""
    sweeps = make_sweeps(random)
    edits = chosen_edits(random)
    if len(edits) == 1 or random.random() < 0.3:
        edits = edits[:1]
    for edit in edits:
        edit(random, sweeps)
    if len(edits) == 1:
        _edit_header(random, sweeps, encoding)
    for stem, columns in zip(stems(sweeps), sweeps.columns, strict=True):
        name = f"{stem}{'.PCD' if sweeps.layout.get('upper') else '.pcd'}"
        (folder / name).write_bytes(pcd_bytes(columns, encoding, **sweeps.layout))
    return case_of(sweeps, folder)


def _edit_header(random: np.random.Generator, sweeps: Sweeps, encoding: str) -> None:
    """One edit of the header or of the order of bytes."""
    count = min(map(len, sweeps.points))
    options: list[tuple[str, dict[str, Any], Oracle]] = [
        ("suffix .PCD", {"upper": True}, "same"),
        ("a comment in the header", {"comment": "# made by a driver"}, "same"),
        ("VERSION .7", {"version": ".7"}, "same"),
        ("COLUMNS for FIELDS", {"fields_key": "COLUMNS"}, "same"),
        ("WIDTH too large", {"width": count + 3}, "refused"),
        ("POINTS too large", {"points": 2, "width": 2}, "refused"),
        ("POINTS too small", {"points": -2, "width": -2}, "refused"),
        ("HEIGHT 2 without more points", {"height": 2}, "refused"),
        ("a SIZE missing", {"drop": "SIZE"}, "refused"),
        ("a TYPE missing", {"drop": "TYPE"}, "refused"),
        ("a COUNT missing", {"drop": "COUNT"}, "refused"),
        ("a name missing", {"drop": "FIELDS"}, "refused"),
        ("a name twice", {"double": True}, "refused"),
        ("DATA of another encoding", {"claimed": "binary" if encoding == "ascii" else "ascii"}, "refused"),
        ("an unknown TYPE", {"kind": "X"}, "refused"),
        ("lines end with CR LF", {"end": "\r\n"}, "same" if encoding == "ascii" else "either"),
    ]
    if encoding == "ascii":
        options += [("scientific notation", {"scientific": True}, "same"), ("a line less", {"cut": True}, "refused")]
    else:
        options += [("bytes missing", {"cut": True}, "refused"), ("padding _ in the points", {"padding": True}, "same")]
    organised = [("organised", {"organised": 2}, "same")] if count % 2 == 0 and count else []
    words, layout, oracle = [*options, *organised][random.integers(len(options) + len(organised))]
    if not count and oracle == "refused":
        oracle = "either"
    sweeps.layout |= layout
    sweeps.edit(words, oracle)


def pcd_bytes(
    columns: Mapping[str, np.ndarray],
    encoding: str,
    *,
    upper: bool = False,
    comment: str = "",
    version: str = "0.7",
    fields_key: str = "FIELDS",
    width: int = 0,
    points: int = 0,
    height: int = 1,
    organised: int = 0,
    drop: str = "",
    double: bool = False,
    claimed: str = "",
    kind: str = "",
    end: str = "\n",
    scientific: bool = False,
    cut: bool = False,
    padding: bool = False,
) -> bytes:
    """A PCD file as its description says, but for what is asked otherwise."""
    del upper
    parts = dict(columns)
    count = len(next(iter(parts.values())))
    if padding:
        parts = {**parts, "_": np.full((count, 3), 170, np.uint8)}
    names = [*parts]
    if double and len(names) > 1:
        names[-1] = names[0]
    lines = {
        "FIELDS": names,
        "SIZE": [str(values.dtype.itemsize) for values in parts.values()],
        "TYPE": [kind or values.dtype.kind.upper() for values in parts.values()],
        "COUNT": [str(values.shape[1] if values.ndim == 2 else 1) for values in parts.values()],
    }
    if drop:
        lines[drop] = lines[drop][:-1]
    grid = (count // organised, organised) if organised else (width if width > 0 and not points else count + width, 1)
    head = [f"# .PCD v{version} - Point Cloud Data file format", *([comment] if comment else []), f"VERSION {version}"]
    head += [f"{fields_key if key == 'FIELDS' else key} {' '.join(words)}" for key, words in lines.items()]
    head += [f"WIDTH {grid[0]}", f"HEIGHT {height if height > 1 else grid[1]}", "VIEWPOINT 0 0 0 1 0 0 0"]
    head += [f"POINTS {count + points}", f"DATA {claimed or encoding}", ""]
    body = _body(parts, encoding, end=end, scientific=scientific)
    if cut and encoding == "ascii":
        body = body[: body.rstrip().rfind(b"\n") + 1]
    return end.join(head).encode() + (body[:-3] if cut and encoding != "ascii" else body)


def _body(parts: Mapping[str, np.ndarray], encoding: str, *, end: str, scientific: bool) -> bytes:
    flat = [values if values.ndim == 2 else values[:, None] for values in parts.values()]
    if encoding == "ascii":
        style = "%.9e" if scientific else "%.9g"
        cells = [
            [(_text(value, style) if column.dtype.kind == "f" else str(value)) for value in column]
            for part in flat
            for column in part.T
        ]
        return "".join(" ".join(row) + end for row in zip(*cells, strict=True)).encode()
    if encoding == "binary":
        rows = [np.ascontiguousarray(part).view(np.uint8) for part in flat]
        return np.concatenate(rows, axis=1).tobytes() if len(rows[0]) else b""
    plain = b"".join(np.ascontiguousarray(part).tobytes() for part in flat)
    packed = lzf(plain)
    return len(packed).to_bytes(4, "little") + len(plain).to_bytes(4, "little") + packed


def _text(value: np.floating, style: str) -> str:
    return repr(float(value)) if value.dtype.itemsize == 8 else style % value


def lzf(data: bytes) -> bytes:
    """LZF as its author's description has it: literals, and copies of what stood at most 8192 bytes before."""
    output, literal, last, position = bytearray(), bytearray(), dict[bytes, int](), 0
    while position < len(data):
        key, back = data[position : position + 3], last.get(data[position : position + 3])
        last[key] = position
        if back is None or len(key) < 3 or position - back > 8191:
            literal.append(data[position])
            position += 1
        else:
            length = 3
            while length < 263 and position + length < len(data) and data[back + length] == data[position + length]:
                length += 1
            _flush(output, literal)
            distance = position - back - 1
            short = min(length - 2, 7)
            output.append(short << 5 | distance >> 8)
            if short == 7:
                output.append(length - 9)
            output.append(distance & 255)
            position += length
        if len(literal) == 32:
            _flush(output, literal)
    _flush(output, literal)
    return bytes(output)


def _flush(output: bytearray, literal: bytearray) -> None:
    if literal:
        output.append(len(literal) - 1)
        output += literal
        literal.clear()


FAMILIES = (
    Family("pcd ascii", partial(pcd, "ascii"), 8),
    Family("pcd binary", partial(pcd, "binary"), 7),
    Family("pcd compressed", partial(pcd, "binary_compressed"), 4),
)

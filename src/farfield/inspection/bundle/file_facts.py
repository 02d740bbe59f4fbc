"""What one file is like without its data: header, shape, columns, ranges; of texts how many numbers stand where.

A form is what files of one kind share (columns, shape, dtype, keys); a fault is why our reader refuses the file.
"""

import re
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Shaped

from farfield.errors import FarfieldError, FileFormatError
from farfield.files.atomic import read_bytes
from farfield.files.feather import feather_names
from farfield.files.images import image_size
from farfield.files.json_text import concatenated_json, read_json
from farfield.files.limits import MAX_NAME, open_file
from farfield.files.mat import open_mat
from farfield.files.npy import read_npy
from farfield.files.stamps import read_stamps, recognise_stamps
from farfield.files.stand_ins import HEAD_BYTES, PROMISED, stand_in
from farfield.frame.cloud import CLOUD_SUFFIXES, read_columns
from farfield.vocabulary.counts import count_of

PICTURES = (".png", ".jpg", ".jpeg")
TEXTS = (".txt", ".csv", ".calib", ".yaml", ".yml", ".xml", ".cfg", ".ini", ".md", ".log", "")
ARRAYS = ("arrDREA", "arr_zyx")
"""Variables that K-Radar's files of MATLAB hold."""

_MOST_TEXT, _MOST_LINES, _MOST_KEYS, _MOST_DEPTH = 4 << 20, 20_000, 40, 6
_FARTHEST_M = 1e5  # coordinates beyond are a map's, and say where the car was
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?$|[-+]?(nan|inf)$", re.IGNORECASE)
_KEY = re.compile(r"([A-Za-z][\w\-]{0,40})\s*:\s*(.*)$")
_IDENTITY = re.compile(r"[\w\-]*\d[\w\-]*")


class FileFacts(NamedTuple):
    """What one file is like.

    Args:
        bytes: Its size.
        form: What it shares with others of its kind: columns, shape, variable, keys; a text.
        figures: Numbers by name that are its own: points, lines, boxes.
        ranges: Least and largest number of each column.
        fault: Why it is refused: where, what was expected and what stands there; empty where it is not.
    """

    bytes: int
    form: str
    figures: Mapping[str, int | float] = {}
    ranges: Mapping[str, tuple[float, float]] = {}
    fault: str = ""


def file_facts(path: Path) -> FileFacts:
    """Look at one file; what cannot be read is a fault and no error.

    Args:
        path: The file, of any kind; of one that no reader takes the size alone is told.
    """
    suffix = path.suffix.lower()
    try:
        size = path.stat().st_size
        if not size:
            return FileFacts(0, "empty", fault="" if suffix in TEXTS else "byte 0: expected data, found an empty file")
        with open_file(path, max_bytes=None) as handle:
            other = stand_in(handle.read(HEAD_BYTES))
        if other is not None and suffix not in PROMISED.get(other, ()):
            return FileFacts(
                size, other.what, fault=f"byte 0: expected the file itself, found {other.what}. {other.fix}"
            )
        look = _LOOKS.get(suffix)
        if look is None:
            return FileFacts(size, f"a file *{suffix}" if suffix else "a file")
        return look(path, size)
    except (FarfieldError, OSError, ValueError, MemoryError) as error:
        size = path.stat().st_size if path.is_file() else 0
        return FileFacts(size, "damaged", fault=words_of(error, path))


def words_of(error: BaseException, path: Path) -> str:
    """An error of a reader without the file's folder: where, what was expected, what stands there."""
    if isinstance(error, FileFormatError):
        return f"{error.where}: expected {error.expected}, found {error.got}. {error.fix}".rstrip()
    return str(error).replace(str(path), path.name)[:400]


def _cloud(path: Path, size: int) -> FileFacts:
    if path.suffix.lower() == ".npy":
        array = read_npy(path, fields=True)
        if array.dtype.names is None and (array.ndim != 2 or not 3 <= array.shape[1] <= 16):
            ranges = _ranges({"values": array.reshape(-1)})
            return FileFacts(size, f"{array.dtype} of shape {_by(array.shape)}", {"numbers": array.size}, ranges)
    columns = read_columns(path)
    if isinstance(columns, np.ndarray):
        named: dict[str, np.ndarray] = {f"column {row + 1}": column for row, column in enumerate(columns.T)}
        form = f"points of {columns.shape[1]} columns without names"
    else:
        named = {str(name)[:MAX_NAME]: values for name, values in columns.items()}
        form = "points with " + " ".join(f"{name}:{values.dtype}" for name, values in named.items())
    flat = {name: values for name, values in named.items() if values.ndim == 1}
    count = len(next(iter(named.values()), ()))
    return FileFacts(size, form, {"points": count}, _ranges(flat))


def _ranges(columns: Mapping[str, Shaped[np.ndarray, " n"]]) -> dict[str, tuple[float, float]]:
    """Least and largest finite number of each column, to four digits; none of coordinates of a map."""
    ranges = {}
    for name, values in columns.items():
        if values.dtype.kind not in "fiu":
            continue
        finite = values[np.isfinite(values)] if values.dtype.kind == "f" else values
        if finite.size and np.abs(limits := (float(finite.min()), float(finite.max()))).max() < _FARTHEST_M:
            ranges[name] = (float(f"{limits[0]:.4g}"), float(f"{limits[1]:.4g}"))
    return ranges


def _by(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape))


def _matlab(path: Path, size: int) -> FileFacts:
    for name in ARRAYS:
        try:
            with open_mat(path, name) as stream:
                return FileFacts(size, f"{name}: {stream.dtype} of shape {_by(stream.shape)}")
        except FileFormatError as error:
            if not error.expected.startswith("an array") or error.fix:
                raise
            others = error.got
    return FileFacts(size, f"variables {others}")


def _picture(path: Path, size: int) -> FileFacts:
    width, height = image_size(path)
    return FileFacts(size, f"picture of {width} x {height} px")


def _json(path: Path, size: int) -> FileFacts:
    try:
        value = read_json(path, nan=True)
    except FileFormatError as error:
        try:
            values = [part for _, part in concatenated_json(read_bytes(path).decode("utf-8", "replace"))]
        except ValueError:
            raise error from None
        return FileFacts(size, "values one behind the other: " + _structure(values), {"entries": len(values)})
    parts = list(value.values()) if isinstance(value, dict) else [value]
    rows = next((part for part in parts if isinstance(part, list)), None)
    return FileFacts(size, _structure(value), {} if rows is None else {"entries": len(rows)})


def _structure(value: Any, depth: int = 0) -> str:
    """The keys and kinds of a JSON value, without any value; keys that are identities are one ``*``."""
    if isinstance(value, dict):
        if depth >= _MOST_DEPTH:
            return "{...}"
        entries: dict[str, str] = {}
        for key, part in list(value.items())[: 4 * _MOST_KEYS]:
            name = "*" if len(key) > 40 or (_IDENTITY.fullmatch(key) and len(value) > 3) else key
            if name not in entries:
                entries[name] = _structure(part, depth + 1)
        return "{" + ", ".join(f"{key}: {entries[key]}" for key in sorted(entries)[:_MOST_KEYS]) + "}"
    if isinstance(value, list):
        if not value:
            return "[]"
        numbers = all(isinstance(part, int | float) for part in value)
        return f"[{len(value)} numbers]" if numbers and len(value) <= 32 else f"[{_structure(value[0], depth + 1)}]"
    return "text" if isinstance(value, str) else "number" if isinstance(value, int | float) else "null"


def _text(path: Path, size: int) -> FileFacts:
    """Of a text: its stamps if it lists such; the numbers behind its keys; or the columns of its lines."""
    with suppress(FarfieldError):
        if (stamps := recognise_stamps(path)) is not None:
            times_ns = np.concatenate([*read_stamps(stamps), np.zeros(0, dtype=np.int64)])
            return FileFacts(size, f"stamps ({stamps.form}, {stamps.unit})", stamp_figures(times_ns))
    with open_file(path, max_bytes=None) as handle:
        text = handle.read(_MOST_TEXT).decode("utf-8", "replace")
    lines = [line.strip() for line in text.splitlines()[:_MOST_LINES] if line.strip()]
    keys = [match for line in lines if (match := _KEY.match(line)) is not None]
    figures = {"lines": len(lines)}
    if lines and 2 * len(keys) > len(lines):
        counts: Counter[str] = Counter()
        for match in keys[:_MOST_KEYS]:
            words = re.split(r"[\s,\[\]]+", match[2].strip())
            counts[match[1]] += sum(_NUMBER.fullmatch(word) is not None for word in words)
        return FileFacts(
            size, "numbers by key: " + ", ".join(f"{key} {count}" for key, count in counts.items()), figures
        )
    widths = Counter(_columns(line) for line in lines)
    shown = ", ".join(f"{count_of(width, 'column')}" for width, _ in sorted(widths.most_common(4)))
    figures |= {f"lines of {count_of(width, 'column')}": count for width, count in widths.most_common(4)}
    return FileFacts(size, f"lines of {shown}" if lines else "blank", figures)


def _columns(line: str) -> int:
    return len([word for word in (line.split(",") if "," in line else line.split()) if word.strip()])


def stamp_figures(times_ns: Shaped[np.ndarray, " n"]) -> dict[str, int | float]:
    """How many stamps, the steps between them in milliseconds, and how many double or run backwards; no time itself."""
    figures: dict[str, int | float] = {"stamps": len(times_ns)}
    steps_ms = np.diff(times_ns.astype(np.int64)) / 1e6
    if len(steps_ms):
        least, middle, most = (round(float(value), 3) for value in np.quantile(steps_ms, (0, 0.5, 1)))
        figures |= {"least step ms": least, "median step ms": middle, "largest step ms": most}
        figures |= {"doubled": int((steps_ms == 0).sum()), "backwards": int((steps_ms < 0).sum())}
    return figures


def _feather(path: Path, size: int) -> FileFacts:
    return FileFacts(size, f"columns {' '.join(feather_names(path))}"[:2000])


_LOOKS: dict[str, Callable[[Path, int], FileFacts]] = {
    **dict.fromkeys(CLOUD_SUFFIXES, _cloud),
    **dict.fromkeys(PICTURES, _picture),
    **dict.fromkeys(TEXTS, _text),
    ".mat": _matlab,
    ".json": _json,
    ".feather": _feather,
}

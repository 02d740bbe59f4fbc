"""Large tables of the nuScenes schema as arrays on the disk: those of the whole set take minutes to read from JSON.

``tables-*.npz`` in ``farfield`` below ``XDG_CACHE_HOME`` or ``~/.cache``, one a table, of no pickle. It counts for the
file of one size, time of change and inode, read for the same columns; one that is damaged is written anew.
"""

import hashlib
import json
import os
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from farfield.errors import FarfieldError
from farfield.files.atomic import open_atomic
from farfield.files.json_text import plain_json
from farfield.files.nuscenes_tables import TableColumns, TableField, TokenLists, read_table

LEAST_BYTES = 16 << 20
"""Smaller tables are read within a second or so, and leave nothing on the disk."""
_VERSION = 1
_DAMAGES = (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error, TypeError, NotImplementedError)
_OBJECTS = ("name", "text", "any")


def cached_table(path: Path, fields: Mapping[str, TableField]) -> TableColumns:
    """The columns of a table as :func:`read_table` gives them, from what an earlier command left where that holds.

    Args:
        path: The JSON file.
        fields: What is read, by column.

    Raises:
        FileFormatError: If the table is no list of such records.
    """
    before = path.stat()
    if before.st_size < LEAST_BYTES:
        return read_table(path, fields)
    key = _key(path, before, fields)
    cache = _cache_path(path)
    try:
        return _unpacked(cache, key, fields)
    except _DAMAGES:
        pass  # there is none yet, or of another table, or it is damaged
    columns = read_table(path, fields)
    if _key(path, path.stat(), fields) == key:  # nobody wrote the table meanwhile
        try:
            cache.parent.mkdir(parents=True, exist_ok=True)
            with open_atomic(cache) as handle:
                arrays: dict[str, Any] = _packed(columns, key, fields)
                np.savez(handle, **arrays)
        except (OSError, FarfieldError, ValueError):
            pass  # read again by the next command
    return columns


def _cache_path(path: Path) -> Path:
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")  # noqa: PTH111 - never raises
    digest = hashlib.sha256(os.fsencode(path.resolve())).hexdigest()[:24]
    return Path(home) / "farfield" / f"tables-{digest}.npz"


def _key(path: Path, status: os.stat_result, fields: Mapping[str, TableField]) -> str:
    columns = [[name, entry.kind, entry.count, entry.optional] for name, entry in fields.items()]
    file = [str(path.resolve()), status.st_size, status.st_mtime_ns, status.st_ino]
    return json.dumps([_VERSION, file, columns])


def _packed(columns: TableColumns, key: str, fields: Mapping[str, TableField]) -> dict[str, np.ndarray]:
    arrays = {"key": _bytes_of(key)}
    for name, entry in fields.items():
        values = columns[name]
        if isinstance(values, TokenLists):
            arrays |= {f"tokens {name}": values.tokens, f"starts {name}": values.starts}
        elif entry.kind in _OBJECTS:
            arrays[f"objects {name}"] = _bytes_of(json.dumps(values.tolist()))
        else:
            arrays[f"values {name}"] = values
    return arrays


def _unpacked(cache: Path, key: str, fields: Mapping[str, TableField]) -> TableColumns:
    """What a cache holds.

    Raises:
        ValueError: If it is of another table, or its columns are of different lengths; or another of the damages.
    """
    columns: TableColumns = {}
    with cache.open("rb") as handle, np.load(handle, allow_pickle=False) as arrays:
        if arrays["key"].tobytes().decode() != key:
            raise ValueError("another table")
        for name, entry in fields.items():
            if entry.kind == "tokens":
                columns[name] = TokenLists(arrays[f"tokens {name}"], arrays[f"starts {name}"])
            elif entry.kind in _OBJECTS:
                values: list[Any] = plain_json(arrays[f"objects {name}"].tobytes())
                columns[name] = np.empty(len(values), dtype=object)
                for row, value in enumerate(values):  # lists among them must not become axes
                    columns[name][row] = value
            else:
                columns[name] = arrays[f"values {name}"]
    lengths = {len(values.counts) if isinstance(values, TokenLists) else len(values) for values in columns.values()}
    if len(lengths) != 1:
        raise ValueError("columns of different lengths")
    return columns


def _bytes_of(text: str) -> np.ndarray:
    return np.frombuffer(text.encode(), dtype=np.uint8)

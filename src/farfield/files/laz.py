"""LAZ, the packed form of LAS: checked here, unpacked by lazrs in a process of its own; needs the extra ``las``.

Source: Martin Isenburg, "LASzip: lossless compression of LiDAR data" (2013), and the record that it writes into the
header of each file. The points are chunks, packed one by one; their table stands behind them. lazrs takes memory for as
many chunks as the table claims and falls on damaged points, with the process in which it runs: see ``laz_worker``.
"""

import os
import signal
import struct
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

from farfield.errors import FarfieldError, FileFormatError, MissingExtraError, plain
from farfield.files.laz_worker import HEAD, NO_MEMORY, REFUSED

RECORD = ("laszip encoded", 22204)
"""User and number of the record that says how the points are packed."""
_RECORD_HEAD = struct.Struct("<HHBBHIIqqH")
_CHUNKED, _LAYERED = 2, 3
_VARIABLE = 0xFFFFFFFF
_MOST_ITEMS, _TIMEOUT_S = 32, 150
_OWN_FALLS = ("SIGSEGV", "SIGBUS", "SIGILL", "SIGABRT", "SIGFPE", "SIGTRAP", "SIGSYS", "SIGXCPU")
"""Signals by which a process ends of what it does itself; others come from without."""
_BUSY = "The file is damaged, or this machine is busy: read it again when it is not, or fetch it again."
_FIX = "The file is damaged: fetch it again, or write it anew, such as with pdal translate IN.laz OUT.laz."


def unpack_laz(data: bytes, record: bytes, *, start: int, points: int, point_bytes: int, path: Path | str) -> bytes:
    """The points of a LAZ file as those of a LAS file stand there.

    Args:
        data: The file.
        record: How its points are packed: the data of :data:`RECORD`.
        start: Byte at which they begin.
        points: How many there are; the caller has seen that they fit into memory.
        point_bytes: Of each.
        path: The file, for messages.

    Raises:
        MissingExtraError: If lazrs is not installed.
        FileFormatError: If the record or the table of chunks contradicts the file, or the points do not unpack.
        FarfieldError: If the process that unpacks does not start, is ended from without or lacks memory.
    """
    spec = find_spec("lazrs")
    if spec is None or spec.origin is None:
        raise MissingExtraError("lazrs", "las", "Reading LAZ clouds")
    _check_table(data, start, _chunk_points(record, point_bytes, path), points, point_bytes, path)
    head = HEAD.pack(len(record), points, point_bytes, start, len(data))
    worker = Path(__file__).with_name("laz_worker.py")
    try:
        done = subprocess.run(  # noqa: S603 - Python itself, and a file of this package
            [sys.executable, "-I", "-S", str(worker), str(Path(spec.origin).parents[1])],
            input=head + record + data,
            capture_output=True,
            timeout=_TIMEOUT_S,
            check=False,
            env={**os.environ, "RUST_BACKTRACE": "0"},
        )
    except subprocess.TimeoutExpired as error:
        raise FileFormatError(
            path, where="the points", expected=f"points that unpack within {_TIMEOUT_S} s", got="longer", fix=_BUSY
        ) from error
    except OSError as error:
        raise _not_unpacked(path, f"its process does not start: {plain(error)}") from error
    if done.returncode == 0 and len(done.stdout) == points * point_bytes:
        return done.stdout
    message = done.stderr.decode("utf-8", errors="replace").strip()
    fault = _machine_fault(done.returncode, message)
    if fault:
        raise _not_unpacked(path, fault)
    refused = done.returncode == REFUSED and message
    got = message[:200] if refused else f"some on which the decoder falls (status {done.returncode})"
    raise FileFormatError(path, where=f"byte {start}", expected=f"{points} packed points", got=got, fix=_FIX)


def _machine_fault(status: int, message: str) -> str:
    """Why a process ended that unpacked points, where it is not by the points; empty where it is.

    Args:
        status: How it ended; the signal's number below 0 where one ended it.
        message: What it wrote to standard error.
    """
    if status == NO_MEMORY:
        return "its process finds no memory"
    if status == 1 and "panic" not in message.lower():  # Python's own errors; the decoder's are panics
        last = message.splitlines()[-1][:200] if message else "it says not why"
        return f"its process fails: {last}"
    names = {int(member): member.name for member in signal.Signals}
    name = names.get(-status, f"signal {-status}")
    if status >= 0 or name in _OWN_FALLS:
        return ""
    return f"its process was ended by {name}{' (perhaps for want of memory)' if name == 'SIGKILL' else ''}"


def _not_unpacked(path: Path | str, reason: str) -> FarfieldError:
    return FarfieldError(
        f"{path}: expected a process of its own that unpacks the points; {reason}. The file may be whole: end other "
        "programs, or take fewer --workers, and read it again."
    )


def _chunk_points(record: bytes, point_bytes: int, path: Path | str) -> int:
    """Points of a chunk, by the record; :data:`_VARIABLE` where chunks differ."""
    where, size = "the record 'laszip encoded'", _RECORD_HEAD.size
    if len(record) < size:
        raise FileFormatError(path, where=where, expected=f"{size} bytes or more", got=str(len(record)), fix=_FIX)
    compressor, coder, _, _, _, _, chunk_points, _, _, items = _RECORD_HEAD.unpack_from(record)
    if len(record) != size + 6 * items or items > _MOST_ITEMS:
        raise FileFormatError(path, where=where, expected=f"{items} items", got=f"{len(record)} bytes", fix=_FIX)
    item_bytes = sum(struct.unpack_from("<H", record, size + 6 * item + 2)[0] for item in range(items))
    if compressor not in (_CHUNKED, _LAYERED) or coder or not chunk_points or item_bytes != point_bytes:
        expected = f"points of {point_bytes} bytes in chunks (compressor 2 or 3, coder 0)"
        actual = f"of {item_bytes} bytes, compressor {compressor}, coder {coder}, {chunk_points} a chunk"
        raise FileFormatError(path, where=where, expected=expected, got=actual, fix=_FIX)
    return int(chunk_points)


def _check_table(data: bytes, start: int, chunk_points: int, points: int, point_bytes: int, path: Path | str) -> None:
    """See that the table of chunks stands in the file and has no more entries than there can be chunks."""
    if start + 8 > len(data):
        raise FileFormatError(path, where=f"byte {start}", expected="packed points", got="the end", fix=_FIX)
    at = struct.unpack_from("<q", data, start)[0]
    at = struct.unpack_from("<q", data, len(data) - 8)[0] if at == -1 else at  # written without going back
    if not start + 8 <= at <= len(data) - 8:
        expected, actual = f"a table of chunks behind byte {start}, in {len(data)} bytes", f"one at byte {at}"
        raise FileFormatError(path, where=f"byte {start}", expected=expected, got=actual, fix=_FIX)
    version, chunks = struct.unpack_from("<II", data, at)
    packed = at - start - 8
    most = packed // point_bytes if chunk_points == _VARIABLE else -(-points // chunk_points)
    # each chunk begins with a point that is not packed
    if version or chunks > min(most, packed // point_bytes) or (chunk_points != _VARIABLE and chunks != most):
        expected = f"a table of {'at most ' if chunk_points == _VARIABLE else ''}{most} chunks (version 0)"
        raise FileFormatError(
            path, where=f"byte {at}", expected=expected, got=f"{chunks} (version {version})", fix=_FIX
        )

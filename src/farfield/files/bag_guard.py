"""Bags that would fill the memory or the disk: sizes that records claim are checked before anything is unpacked.

A record is an opcode, its length (8 bytes) and its content; a chunk (opcode 6) holds two times, the size that it
unpacks to, a checksum, the name of the compression, and the packed bytes behind their length (https://mcap.dev/spec).
A chunk of a few kilobytes of zstd may unpack to terabytes, whatever size it claims.
"""

from functools import partial
from pathlib import Path
from typing import Any

from farfield.errors import FileFormatError, MissingExtraError

MOST_BYTES = 1 << 30
"""No chunk unpacks to more."""
FREE_BYTES, MOST_TIMES = 64 << 20, 256
"""Beyond so many bytes, a chunk unpacks to at most so many times its packed size."""
_MAGIC, _CHUNK, _HEAD = b"\x89MCAP0\r\n", 6, 36


def allowed_bytes(packed: int) -> int:
    """To how many bytes so many packed ones may unpack."""
    return min(MOST_BYTES, FREE_BYTES + MOST_TIMES * packed)


def check_records(path: Path) -> None:
    """Walk through a file's records without reading their content; a file that is no MCAP is left to its reader.

    Raises:
        FileFormatError: If a record claims to end beyond the file, or a chunk to unpack to absurdly much.
    """
    size, number = path.stat().st_size, 0
    with path.open("rb") as handle:
        if handle.read(len(_MAGIC)) != _MAGIC:
            return
        while handle.tell() < size - len(_MAGIC):
            head = handle.read(9)
            length, place = int.from_bytes(head[1:], "little"), handle.tell()
            if len(head) < 9 or place + length > size:
                raise _wrong(path, number, f"a record that ends within the file's {size} bytes", f"{length} bytes")
            if head[0] == _CHUNK:
                _check_chunk(path, number, handle.read(min(length, _HEAD + 64)), length)
            handle.seek(place + length)
            number += 1


def _check_chunk(path: Path, number: int, head: bytes, length: int) -> None:
    unpacked, name = int.from_bytes(head[16:24], "little"), int.from_bytes(head[28:32], "little")
    packed = int.from_bytes(head[32 + name : 40 + name], "little")
    if len(head) < 40 + name or packed > length:
        raise _wrong(path, number, f"a chunk within its record of {length} bytes", f"{packed} packed bytes")
    if unpacked > allowed_bytes(packed):
        expected = f"a chunk of {packed} bytes that unpacks to at most {allowed_bytes(packed)}"
        raise _wrong(path, number, expected, f"one that claims {unpacked}")


def _wrong(path: Path, number: int, expected: str, found: str) -> FileFormatError:
    return FileFormatError(path, where=f"record {number}", expected=expected, found=found)


def bounded() -> None:
    """Make rosbags unpack a chunk to no more than the size that it claims, which is refused where it is absurd."""
    from rosbags.rosbag2 import storage_mcap

    known: dict[str, Any] = storage_mcap.DECOMPRESSORS
    for name in ("zstd", "lz4"):
        if name in known and not isinstance(known[name], partial):
            known[name] = partial(unpacked, name)


def unpacked(name: str, data: bytes, size: int) -> bytes:
    """Unpack one chunk, never beyond its size.

    Args:
        name: "zstd" or "lz4".
        data: The packed bytes.
        size: What the chunk claims to unpack to.

    Raises:
        ValueError: If the size is absurd, or the bytes unpack to more.
    """
    if size > allowed_bytes(len(data)):
        raise ValueError(f"a chunk of {len(data)} bytes that claims to unpack to {size}")
    if name == "zstd":
        from rosbags.rosbag2.storage_mcap import zstd

        found: bytes = zstd.ZstdDecompressor().decompress(data, max_length=size + 1)
    else:
        from lz4.frame import LZ4FrameDecompressor

        found = LZ4FrameDecompressor().decompress(data, max_length=size + 1)
    if len(found) > size:
        raise ValueError(f"a chunk that unpacks to more than the {size} bytes that it claims")
    return found


def unpacked_message(data: bytes) -> bytes:
    """Unpack a message that was packed by itself (``compression_mode: message``).

    Raises:
        ValueError: If it unpacks to absurdly much.
    """
    from rosbags.rosbag2.storage_mcap import zstd

    most = allowed_bytes(len(data))
    found: bytes = zstd.ZstdDecompressor().decompress(data, max_length=most + 1)
    if len(found) > most:
        raise ValueError(f"a message of {len(data)} bytes that unpacks to more than {most}")
    return found


def check_packed_file(path: Path) -> None:
    """Unpack a file that was packed as a whole (``compression_mode: file``), without keeping anything, up to a bound.

    Raises:
        FileFormatError: If it unpacks to more than 256 times its size and 64 MiB.
    """
    try:
        from rosbags.rosbag2.storage_mcap import zstd
    except ImportError as error:
        raise MissingExtraError("rosbags", "bags", "Reading ROS 2 bags") from error
    size, found = path.stat().st_size, 0
    most = FREE_BYTES + MOST_TIMES * size
    try:
        with zstd.open(path, "rb") as handle:
            while block := handle.read(1 << 20):
                found += len(block)
                if found > most:
                    raise FileFormatError(
                        path, where="the file", expected=f"at most {most} bytes when unpacked", found="more"
                    )
    except (OSError, EOFError, zstd.ZstdError) as error:
        raise FileFormatError(path, where="the file", expected="a file packed with zstd", found=str(error)) from error

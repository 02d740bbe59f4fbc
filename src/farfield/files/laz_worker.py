"""Unpacks the points of one LAZ file in a process of its own: lazrs falls on damaged points, and takes memory unasked.

Run as a script by :mod:`farfield.files.laz`, without Farfield: ``laz_worker.py FOLDER_OF_LAZRS``. Standard input holds
five whole numbers (uint64, little-endian: bytes of laszip's record, points, bytes of a point, byte at which the points
begin, bytes of the file), the record and the file; standard output the points. Exit status 3 says on standard error
what is wrong, 4 that memory is lacking; any other than 0 that the decoder fell, or Python did.
"""

import io
import struct
import sys

HEAD = struct.Struct("<5Q")
REFUSED, NO_MEMORY = 3, 4
_LAYERED, _ITEMS_AT = 3, 34
_LAYERS, _BYTES = {10: 9, 11: 1, 12: 2, 13: 1}, 14  # points of 1.4, their colours, with near infrared, waves; bytes
_SPARE_BYTES, _MOST_SECONDS = 1 << 30, 120


def limit(needed_bytes: int) -> None:
    """Hold this process to the memory that the file needs, and to two minutes, where the system can."""
    try:
        import resource
    except ImportError:  # Windows
        return
    most = needed_bytes + _SPARE_BYTES
    for kind, value in ((resource.RLIMIT_AS, most), (resource.RLIMIT_CPU, _MOST_SECONDS), (resource.RLIMIT_CORE, 0)):
        _, hard = resource.getrlimit(kind)
        value = value if hard == resource.RLIM_INFINITY else min(value, hard)
        resource.setrlimit(kind, (value, hard))


def layers_of(record: bytes) -> int:
    """In how many layers the points of a chunk are packed; 0 where they are packed one by one."""
    if struct.unpack_from("<H", record)[0] != _LAYERED:
        return 0
    items = [struct.unpack_from("<HH", record, at) for at in range(_ITEMS_AT, len(record) - 5, 6)]
    return sum(size if kind == _BYTES else _LAYERS[kind] for kind, size in items)


def check_layers(
    data: bytes, at: int, table: "list[tuple[int, int]]", points: int, point_bytes: int, layers: int
) -> None:
    """See that each chunk of layers says itself how many points and bytes it has.

    Raises:
        ValueError: If one says anything else.
    """
    for number, (count, size) in enumerate(table):
        own_points, *sizes = struct.unpack_from(f"<{1 + layers}I", data, at + point_bytes)
        expected = min(count, points)
        points -= expected
        if own_points != expected or point_bytes + 4 * (1 + layers) + sum(sizes) != size:
            raise ValueError(
                f"chunk {number} of {own_points} points, {sum(sizes)} bytes, for {expected} and {size} in all"
            )
        at += size


def unpack(record: bytes, points: int, point_bytes: int, start: int, data: bytes) -> bytearray:
    """The points of a file as they are in memory.

    Raises:
        ValueError: If the table of chunks is of other points.
    """
    import lazrs

    source, layout = io.BytesIO(data), lazrs.LazVlr(record)
    source.seek(start)
    table = lazrs.read_chunk_table(source, layout)
    begins, size = source.tell(), sum(size for _, size in table)
    stops = struct.unpack_from("<q", data, start)[0]
    stops = struct.unpack_from("<q", data, len(data) - 8)[0] if stops == -1 else stops
    counted = sum(count for count, _ in table)
    chunk = layout.chunk_size()
    whole = -(-points // chunk) * chunk  # the table names the last chunk as long as all others
    if begins + size != stops or counted != (points if layout.uses_variable_size_chunks() else whole):
        raise ValueError(f"a table of {len(table)} chunks of {size} bytes, for {stops - begins} bytes, {points} points")
    layers = layers_of(record)
    if layers:
        check_layers(data, begins, table, points, point_bytes, layers)
    output = bytearray(points * point_bytes)
    source.seek(start)
    lazrs.LasZipDecompressor(source, record).decompress_many(output)
    return output


def main() -> int:
    """Read, unpack and write; returns the exit status."""
    sys.path.insert(0, sys.argv[1])
    record_bytes, points, point_bytes, start, size = HEAD.unpack(sys.stdin.buffer.read(HEAD.size))
    limit(2 * size + 2 * points * point_bytes)
    try:
        record, data = sys.stdin.buffer.read(record_bytes), sys.stdin.buffer.read(size)
        output = unpack(record, points, point_bytes, start, data)
    except MemoryError:  # the caller has seen that the points fit
        return NO_MEMORY
    except (RuntimeError, ValueError, TypeError, KeyError, OverflowError, struct.error) as error:
        sys.stderr.write(f"{type(error).__name__}: {error}"[:400])
        return REFUSED
    sys.stdout.buffer.write(output)
    sys.stdout.buffer.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""What a file holds, in two numbers."""

import zlib
from pathlib import Path

from farfield.files.limits import open_file

Mark = tuple[int, int]
"""Size and CRC-32 of a file."""


def mark_of(path: Path) -> Mark:
    """Size and CRC-32 of a file.

    Raises:
        FileFormatError: If it is no regular file.
    """
    size = crc = 0
    with open_file(path, max_bytes=None) as handle:
        while block := handle.read(1 << 20):
            size, crc = size + len(block), zlib.crc32(block, crc)
    return size, crc

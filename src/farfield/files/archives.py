"""Zip archives of numbers, as PyTorch and NumPy write them: members as they are, each with bytes of its own."""

import zipfile
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from farfield.errors import FileFormatError

_MAX_MEMBERS = 100_000


def check_archive(
    path: Path | str, file: BinaryIO | BytesIO, *, expected: str = "an archive of numbers as they are"
) -> bool:
    """See that what an archive holds is no more than the archive; whether it is one at all.

    Packed members unpack to a thousand times their size, and members that share their bytes hold them as often.

    Args:
        path: The file, for messages.
        file: The same, open; it stands anywhere afterwards.
        expected: What it should be, for messages.

    Raises:
        FileFormatError: If a member is packed, or all together are larger than the file.
    """
    size = file.seek(0, 2)
    try:
        with zipfile.ZipFile(file) as archive:
            members = archive.infolist()
    except (zipfile.BadZipFile, ValueError, OSError, EOFError, NotImplementedError, RuntimeError, IndexError):
        return False
    packed = next((member.filename for member in members if member.compress_type != zipfile.ZIP_STORED), None)
    total = sum(max(member.file_size, member.compress_size) for member in members)
    got = f"compressed numbers at {packed[:80]}" if packed is not None else ""
    if len(members) > _MAX_MEMBERS or total > size:
        got = got or f"{len(members)} members of {total} bytes in {size}"
    if got:
        raise FileFormatError(path, where="file", expected=expected, got=got)
    return True

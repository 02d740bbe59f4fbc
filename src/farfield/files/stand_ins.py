"""Files that stand in another's place: pointers of Git LFS and git-annex, error pages, packed and unfinished downloads.

They bear the name of what was meant, so every reader opens them and would call them damaged. One list of marks, looked
for in the first bytes of whatever is opened, says what stands there and how to get the file itself.
"""

import sys
from pathlib import Path
from typing import NamedTuple

from farfield.errors import FileFormatError
from farfield.files.limits import open_file

HEAD_BYTES = 256
_LFS_POINTER = b"version https://git-lfs.github.com/spec/"


class StandIn(NamedTuple):
    """What stands in a file's place, and how to get the file itself."""

    what: str
    fix: str


LFS = StandIn("a pointer of Git LFS, which stands for it", "Fetch the files: git lfs pull.")
ANNEX = StandIn("a pointer of git-annex, which stands for it", "Fetch the files: git annex get .")
PAGE = StandIn(
    "a page in HTML",
    "The server answered the download with a page, such as one that asks to log in: open the file in a browser to read "
    "it, then download anew.",
)
GZIP = StandIn("a file packed by gzip", "Unpack it: gunzip FILE.gz, or tar xzf FILE for a .tar.gz.")
ZIP = StandIn("a zip archive", "Unpack it: unzip FILE.")
ZSTD = StandIn("a file packed by zstd", "Unpack it: unzstd FILE.zst.")
XZ = StandIn("a file packed by xz", "Unpack it: unxz FILE.xz.")

PROMISED = {
    GZIP: (".gz", ".tgz"),
    ZIP: (".zip", ".npz", ".pt", ".pth", ".ckpt"),
    ZSTD: (".zst", ".zstd"),
    XZ: (".xz",),
    PAGE: (".html", ".htm"),
}
"""Suffixes of files that are such by nature: numpy's and torch's archives, and what is said to be packed."""

UNFINISHED = (".crdownload", ".part", ".partial", ".download", ".tmp", ".filepart", ".aria2")
"""Suffixes that browsers and copiers give to what they have not finished."""


def stand_in(head: bytes) -> StandIn | None:
    """What the first bytes of a file show to stand in its place; None where they show nothing of the kind.

    Args:
        head: The first bytes, :data:`HEAD_BYTES` or more of them where the file has as many.
    """
    if head.startswith(_LFS_POINTER):
        return LFS
    if head.startswith((b"/annex/objects/", b"../.git/annex/objects", b".git/annex/objects")):
        return ANNEX
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip()[:14].lower()
    if text.startswith((b"<!doctype html", b"<html")):
        return PAGE
    marks = {b"\x1f\x8b\x08": GZIP, b"PK\x03\x04": ZIP, b"\x28\xb5\x2f\xfd": ZSTD, b"\xfd7zXZ\0": XZ}
    return next((other for mark, other in marks.items() if head.startswith(mark)), None)


def refuse_stand_in(path: Path | str, head: bytes) -> None:
    """Refuse a file in whose place something else stands.

    Args:
        path: The file.
        head: Its first bytes.

    Raises:
        FileFormatError: If it is one of those of :func:`stand_in`, and its suffix promises another kind of file.
    """
    other = stand_in(head)
    if other is not None and Path(path).suffix.lower() not in PROMISED.get(other, ()):
        raise FileFormatError(path, where="byte 0", expected="the file itself", got=other.what, fix=other.fix)


def check_itself(path: Path | str) -> None:
    """Refuse a stand-in before a library opens the path by itself; what cannot be opened is left to that library.

    Raises:
        FileFormatError: If it is one of those of :func:`stand_in`, or no regular file.
    """
    try:
        with open_file(path, max_bytes=sys.maxsize) as handle:
            head = handle.read(HEAD_BYTES)
    except OSError:
        return
    refuse_stand_in(path, head)

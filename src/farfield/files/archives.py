"""Zip archives: of numbers, as PyTorch and NumPy write them, and downloads, listed and unpacked member by member."""

import stat
import sys
import zipfile
import zlib
from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO
from pathlib import Path, PurePosixPath
from typing import BinaryIO

from farfield.errors import FileFormatError
from farfield.files.atomic import open_atomic, readable
from farfield.files.limits import allowed_bytes, open_file
from farfield.files.stand_ins import HEAD_BYTES, ZIP, stand_in
from farfield.vocabulary.counts import count_of

_MAX_MEMBERS = 100_000
_MAX_LISTED = 1_000_000
_BLOCK_BYTES = 1 << 20
_ERRORS = (
    zipfile.BadZipFile,
    zlib.error,
    ValueError,
    OSError,
    EOFError,
    NotImplementedError,
    RuntimeError,
    IndexError,
    OverflowError,
)
_FRESH = "Download it anew; compare its size with that on the page."


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


@dataclass(frozen=True, kw_only=True)
class ArchiveMember:
    """One file of an archive.

    Args:
        archive: The archive.
        name: Its name there, ``/`` between folders; it leads nowhere but below the folder that it is unpacked into.
        bytes: Its size, unpacked.
        packed: Its size in the archive.
        crc: CRC-32 of what it unpacks to.
    """

    archive: Path
    name: str
    bytes: int
    packed: int
    crc: int


@dataclass(frozen=True, kw_only=True)
class ZipListing:
    """What lies in an archive, as its directory says.

    Args:
        path: The archive.
        members: Its files that may be unpacked.
        refused: Why others may not, a sentence each.
        fault: Why it cannot be used at all; empty where it can.
    """

    path: Path
    members: tuple[ArchiveMember, ...] = ()
    refused: tuple[str, ...] = ()
    fault: str = ""


def list_zip(path: Path) -> ZipListing:
    """List a zip archive without unpacking any of it; one that is empty, cut or no archive has a fault.

    Refused are members whose names lead out of the folder (absolute, ``..``, drives, backslashes) or stand twice,
    links, encrypted ones, and those that would unpack to more than any sensor's data do (zip bombs); members that share
    bytes with others refuse the whole archive.

    Args:
        path: The archive.
    """
    head = b""
    try:
        with open_file(path, max_bytes=None) as file:
            size = file.seek(0, 2)
            file.seek(0)
            head = file.read(HEAD_BYTES)
            if not size:
                return ZipListing(path=path, fault=f"an empty file (0 bytes). {_FRESH}")
            if (other := stand_in(head)) is not None and other != ZIP:
                return ZipListing(path=path, fault=f"{other.what}. {other.fix}")
            with zipfile.ZipFile(file) as archive:
                entries = archive.infolist()
    except FileFormatError as error:
        return ZipListing(path=path, fault=f"{error.got}")
    except _ERRORS as error:
        if isinstance(error, OSError) and error.errno is not None:
            return ZipListing(path=path, fault=f"cannot be read ({error.strerror}).")
        if head[:4] != b"PK\x03\x04":
            return ZipListing(path=path, fault=f"no zip archive, or one whose beginning is damaged. {_FRESH}")
        return ZipListing(path=path, fault=f"cut: the directory at its end is not there. {_FRESH}")
    files = [entry for entry in entries if not entry.is_dir()]
    if not files:
        return ZipListing(path=path, fault="an archive without any file.")
    if len(files) > _MAX_LISTED or sum(entry.compress_size for entry in files) > size:
        fault = f"{count_of(len(files), 'member')} that share their bytes: made to fill the disk. It is not unpacked."
        return ZipListing(path=path, fault=fault)
    members, refused, names = list[ArchiveMember](), list[str](), set[str]()
    for entry in files:
        reason = _refusal(entry) or ("a name that stands twice" if entry.filename in names else "")
        names.add(entry.filename)
        if reason:
            refused.append(f"{readable(entry.filename)[:100]}: {reason}")
        else:
            facts = {"bytes": entry.file_size, "packed": entry.compress_size, "crc": entry.CRC}
            members.append(ArchiveMember(archive=path, name=entry.filename, **facts))
    return ZipListing(path=path, members=tuple(members), refused=tuple(refused))


def _refusal(entry: zipfile.ZipInfo) -> str:
    """Why a member may not be unpacked; empty where it may."""
    name = PurePosixPath(entry.filename)
    outside = name.is_absolute() or ".." in name.parts or "\\" in entry.filename or ":" in entry.filename
    if outside or entry.filename != readable(entry.filename) or any(ord(letter) < 32 for letter in entry.filename):
        return "its name leads out of the folder"
    mode = entry.external_attr >> 16
    if mode and not (stat.S_ISREG(mode) or not stat.S_IFMT(mode)):
        return "a link or a device, no file"
    if entry.flag_bits & 1:
        return "encrypted"
    if entry.file_size > allowed_bytes(entry.compress_size, most=sys.maxsize):
        return f"{entry.compress_size} bytes that would unpack to {entry.file_size}"
    return ""


def unpack(member: ArchiveMember, target: Path) -> None:
    """Unpack one member, all or nothing; size and checksum are compared with what the directory says.

    Args:
        member: Of :func:`list_zip`.
        target: The file to write; its folder is made if it is missing.

    Raises:
        FileFormatError: If it is damaged, or not what the directory says.
    """
    fault = ""
    target.parent.mkdir(parents=True, exist_ok=True)
    status = member.archive.stat()
    with open_atomic(target) as out:
        count = 0
        try:
            archive = _opened(member.archive, status.st_size, status.st_mtime_ns)
            with archive.open(member.name) as source:
                while block := source.read(_BLOCK_BYTES):
                    count += len(block)
                    if count > member.bytes:
                        break
                    out.write(block)
        except _ERRORS as error:
            if isinstance(error, OSError) and error.errno is not None:
                raise  # of the disk
            fault = "damaged bytes"
        if fault or count != member.bytes:
            raise FileFormatError(
                member.archive,
                where=f"member {member.name}",
                expected=f"{member.bytes} bytes of the checksum {member.crc:08x}",
                got=fault or f"{count} bytes",
                fix=_FRESH,
            )


@lru_cache(maxsize=4)
def _opened(path: Path, size: int, changed_ns: int) -> zipfile.ZipFile:
    """An archive whose directory has been read: that of 35,000 members takes longer than unpacking one of them."""
    del size, changed_ns  # which tell it from what may stand under the name later
    open_file(path, max_bytes=None).close()  # a regular file
    return zipfile.ZipFile(path)

"""Numbers of the MATLAB v5 format ("MAT-File Format", The MathWorks, level 5) and its header."""

from pathlib import Path

from farfield.errors import FileFormatError

HEADER_BYTES = 128
INT8, INT32, UINT32, MATRIX, COMPRESSED = 1, 5, 6, 14, 15
STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""Dtype of each type that numbers are stored as."""
CLASSES = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8"}
"""Dtype of each numeric array class."""
COMPLEX_FLAG = 0x0800
MAX_AXES = 32
MAX_EXPANSION = 1032
"""No zlib stream expands further."""
TRUNCATED = "The file may be truncated."
_HDF5 = b"\x89HDF"


def check_header(data: bytes, path: Path | str) -> None:
    """Check a file's first 128 bytes.

    Raises:
        FileFormatError: If they are not a little-endian MATLAB v5 file's.
    """
    if data[:4] == _HDF5 or data[:10] == b"MATLAB 7.3":
        mend = "Save it in MATLAB with -v7."
        raise FileFormatError(path, where="byte 0", expected="a MATLAB v5 file", found="a v7.3 (HDF5) file", mend=mend)
    if len(data) < HEADER_BYTES or data[124:128] != b"\x00\x01IM":
        expected = "a little-endian MATLAB v5 header of 128 bytes"
        raise FileFormatError(path, where="byte 124", expected=expected, found=repr(data[124:128]))

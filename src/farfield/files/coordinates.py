"""In which coordinates the boxes of a folder stand, for formats whose files have no place for it, such as KITTI's text.

One line in a file beside them, ``COORDINATES``, whose name has no suffix, so that tools that list ``*.txt`` pass it by.
"""

from pathlib import Path

from farfield.errors import FileFormatError
from farfield.files.atomic import read_bytes, write_text

NAME = "COORDINATES"
_MAX_BYTES = 1000


def camera_words(camera: str, reference: str) -> str:
    """What KITTI's boxes stand in: a camera, or its axes at a sensor that has none.

    >>> camera_words("cam-front", "os2-64"), camera_words("", "os2-64")
    ('camera cam-front', "a camera's axes at os2-64")
    """
    return f"camera {camera}" if camera else f"a camera's axes at {reference}"


def write_coordinates(folder: Path, text: str) -> None:
    """Name the coordinates of the boxes in a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / NAME, text + "\n")


def read_coordinates(folder: Path) -> str:
    """What stands there; empty where nothing does.

    Raises:
        FileFormatError: If it is no line of text.
    """
    path = folder / NAME
    if not path.is_file():
        return ""
    data = read_bytes(path, max_bytes=_MAX_BYTES)
    try:
        text = data.decode().strip()
    except UnicodeDecodeError:
        text = ""
    if not text or not text.isprintable():
        raise FileFormatError(path, where="the file", expected="one line of text", got=repr(data[:40]))
    return text

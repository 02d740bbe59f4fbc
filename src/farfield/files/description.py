"""K-Radar's ``description.txt``: one line of road, time and weather for a sequence."""

from pathlib import Path

from farfield.errors import FileFormatError
from farfield.files.atomic import read_bytes
from farfield.vocabulary.kradar import DESCRIPTION_ORDER, parse_description

_MAX_BYTES = 4 << 20


def read_description(path: Path) -> dict[str, str]:
    """Read road, time and weather in our names; lines after the first one with text are not looked at.

    Raises:
        FileFormatError: If it is no line of three words, or no UTF-8 text.
    """
    try:
        text = read_bytes(path, max_bytes=_MAX_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        actual = f"byte 0x{error.object[error.start]:02x}"
        raise FileFormatError(path, where=f"byte {error.start}", expected="UTF-8 text", got=actual) from None
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    conditions = parse_description(lines[0]) if lines else None
    if conditions is None:
        raise FileFormatError(
            path, where="line 1", expected=",".join(DESCRIPTION_ORDER), got=repr("".join(lines[:1]))[:100]
        )
    return conditions

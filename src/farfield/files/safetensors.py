"""The digest that a safetensors file carries: the SHA-256 of all its bytes.

It stands in the file's metadata as ``sha256``, and is taken with zeros in its own place. A file is the length of its
header (8 bytes, little-endian), the header in JSON, padded by blanks to a multiple of 8 bytes, and the tensors, whose
places count from the header's end (safetensors, "Format").
"""

import hashlib
import json
from pathlib import Path
from typing import Any

from farfield.errors import FileFormatError, plain
from farfield.files.json_text import plain_json

KEY = "sha256"
"""Of the metadata."""
_ZEROS = "0" * 64


def with_digest(data: bytes) -> bytes:
    """The same file with the digest of its bytes, and its metadata in the order of their names.

    safetensors writes them as its hash table has them.

    Args:
        data: A whole safetensors file.
    """
    end, header = _header(data)
    header = {"__metadata__": dict(sorted({**header.pop("__metadata__", {}), KEY: _ZEROS}.items())), **header}
    text = json.dumps(header, separators=(",", ":"), ensure_ascii=False).encode(
        errors="backslashreplace"
    )  # which JSON reads
    text += b" " * (-len(text) % 8)
    data = len(text).to_bytes(8, "little") + text + data[end:]
    return data.replace(_entry(_ZEROS), _entry(hashlib.sha256(data).hexdigest()), 1)


def metadata_of(path: Path, data: bytes) -> dict[str, str]:
    """The texts of a file's header; empty where it has none.

    Args:
        path: Where it is from, for messages.
        data: All of it, or its header.

    Raises:
        FileFormatError: If there is no header, or its metadata are not texts.
    """
    try:
        metadata = _header(data)[1].get("__metadata__") or {}
        if not all(isinstance(text, str) for text in metadata.values()):
            raise TypeError("metadata that are no texts")
    except (ValueError, TypeError, AttributeError) as error:
        raise FileFormatError(path, where="header", expected="safetensors", got=plain(error)[:200]) from error
    return dict(metadata)


def check_digest(path: Path, data: bytes) -> None:
    """See that a file is what was written, as far as it carries a digest: those of earlier versions do not.

    Args:
        path: Where it is from, for messages.
        data: All of it.

    Raises:
        FileFormatError: If a bit changed since.
    """
    stated = metadata_of(path, data).get(KEY)
    if stated is None:
        return
    end = 8 + int.from_bytes(data[:8], "little")
    digest = hashlib.sha256(data[:end].replace(_entry(stated), _entry(_ZEROS), 1))
    digest.update(memoryview(data)[end:])
    if (actual := digest.hexdigest()) != stated:
        raise FileFormatError(
            path,
            where="digest",
            expected=f"the bytes as they were written, of the SHA-256 {stated[:16]}",
            got=actual[:16],
            fix="The file changed since: copy it anew, or export it again where it was made.",
        )


def _header(data: bytes) -> tuple[int, dict[str, Any]]:
    end = 8 + int.from_bytes(data[:8], "little")
    return end, plain_json(data[8:end])


def _entry(digest: str) -> bytes:
    """How the header states a digest; within its texts quotes are escaped, so that it stands there once."""
    return f'"{KEY}":"{digest}"'.encode()

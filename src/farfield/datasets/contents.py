"""A digest of what each frame measured: equal frames are recognised in another folder and under other names."""

import hashlib
from collections import Counter
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from farfield.datasets.base import Dataset

_DIGITS = 12
_FEWEST_BYTES = 64  # an empty cloud is not one certain frame
_BLOCK_BYTES, _BLOCKS = 1 << 15, 8  # of a large file: these, spread over it evenly, and its size
_TEXTS = (".txt", ".json", ".csv", ".yaml", ".yml", ".xml")
_PICTURES = (".png", ".jpg", ".jpeg")


def frame_digests(data: Dataset) -> tuple[str, ...]:
    """A digest of each frame's contents, 12 hexadecimal digits; empty where no file tells a frame from others.

    It is that of one file: the largest that only this frame is read from, a cloud or tensor before a picture, and a
    picture before a text. Neither labels nor names nor maps matter. Of files of more than 256 KiB eight blocks of
    32 KiB are read. Frames that share all files, as those of a bag do, have that of the largest and their own names.

    Args:
        data: Frames; none of those in memory has a digest.
    """
    if not data.stored:
        return ("",) * len(data)
    reader = data.unwrapped
    frames = Counter(path for index in range(len(reader)) for path in dict.fromkeys(reader.files(index)))
    return tuple(_digest(reader.files(origin), frames, reader.frame_ids[origin]) for origin in data.origins)


def _digest(files: Sequence[Path], frames: Counter[Path], frame_id: str) -> str:
    present = [path for path in files if path.is_file()]
    own = [path for path in present if frames[path] == 1]
    best = max(own or present, key=_rank, default=None)
    if best is None or best.stat().st_size < _FEWEST_BYTES:
        return ""
    contents = _contents(best, best.stat().st_size, best.stat().st_mtime_ns)
    return contents if own else hashlib.sha256(f"{contents}\0{frame_id}".encode()).hexdigest()[:_DIGITS]


def _rank(path: Path) -> tuple[int, int, str]:
    suffix = path.suffix.lower()
    return (0 if suffix in _TEXTS else 1 if suffix in _PICTURES else 2), path.stat().st_size, path.name


@lru_cache(maxsize=1 << 16)
def _contents(path: Path, size: int, changed_ns: int) -> str:
    """Digest of a file; a changed one is read anew."""
    del changed_ns
    digest = hashlib.sha256(str(size).encode())
    with path.open("rb") as file:
        if size <= _BLOCKS * _BLOCK_BYTES:
            digest.update(file.read())
        else:
            for number in range(_BLOCKS):
                file.seek(number * (size - _BLOCK_BYTES) // (_BLOCKS - 1))
                digest.update(file.read(_BLOCK_BYTES))
    return digest.hexdigest()[:_DIGITS]

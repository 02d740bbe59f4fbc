"""Digests of what each frame measured: equal frames are recognised in another folder and under other names."""

import hashlib
import zlib
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from weakref import WeakKeyDictionary

from farfield.datasets.base import Dataset
from farfield.files.limits import open_file

NONE = "?"
"""Stands for a frame that no file tells from others."""
_SHARED = "~"
"""Before the digest of a file that other frames are read from too, and the frame's name in it."""
_DIGITS = 12
_BLOCK_BYTES, _BLOCKS = 1 << 14, 4  # of a large file: these, spread over it evenly, and its size
_STRIDE, _FEWEST_BYTES = 7, 64  # every seventh byte, compressed: of a header alone, or of zeros, fewer are left
_TEXTS = (".txt", ".json", ".csv", ".yaml", ".yml", ".xml", ".calib", ".cfg", ".ini", ".toml")
_PICTURES = (".png", ".jpg", ".jpeg")

_DIGESTS_OF: "WeakKeyDictionary[Dataset, dict[int, str]]" = WeakKeyDictionary()
"""Of each reader, by the index of its frame: a training asks several times."""


def frame_digests(data: Dataset) -> tuple[str, ...]:
    """Digests of each frame's contents: those of its clouds and tensors, such as ``npy:0123456789ab``, joined by ``+``.

    They are of the files that only this frame is read from: of pictures where it has no such cloud, and of texts where
    it has no picture either. Neither names nor maps matter. Of files of more than 64 KiB four blocks of 16 KiB are
    read. Frames that share their clouds' file, as those of a bag do, have its digest with their own names, after ``~``,
    unless they are views of one measurement (:meth:`~farfield.datasets.base.Dataset.measurement`); a frame whose files
    hold next to nothing has ``?``.

    Args:
        data: Frames; those in memory have ``?``.
    """
    if not data.stored:
        return (NONE,) * len(data)
    reader = data.unwrapped
    digests = _DIGESTS_OF.setdefault(reader, {})
    lacking = [origin for origin in dict.fromkeys(data.origins) if origin not in digests]
    if lacking:
        measured = {(path, reader.measurement(index)) for index in range(len(reader)) for path in reader.files(index)}
        frames = Counter(path for path, _ in measured)
        digests |= {origin: _digest(reader.files(origin), frames, reader.frame_ids[origin]) for origin in lacking}
    return tuple(digests[origin] for origin in data.origins)


def common_frames(data: Dataset, digests: str) -> tuple[list[bool], bool]:
    """Which frames are among others, by the contents of their files.

    Args:
        data: The frames.
        digests: Those of :func:`frame_digests` of the others, with blanks between the frames.

    Returns:
        For each frame whether one of its files is one of theirs; and whether those without are other files for certain:
        of the same formats, each with a digest of its own.
    """
    others = {digest for frame in digests.split() for digest in frame.split("+")}
    own = [frame.split("+") for frame in frame_digests(data)]
    every = others.union(*own)
    same_formats = {_format(digest) for digest in every} == {_format(digest) for digest in others}
    certain = same_formats and not any(digest.startswith((NONE, _SHARED)) for digest in every)
    return [any(digest in others and digest != NONE for digest in frame) for frame in own], certain


def _format(digest: str) -> str:
    """The file format that stands before a digest."""
    return digest.rpartition(":")[0]


def _digest(files: Sequence[Path], frames: Counter[Path], frame_id: str) -> str:
    present = [path for path in dict.fromkeys(files) if path.is_file()]
    kind = max(map(_kind, present), default=0)
    measured = [path for path in present if _kind(path) == kind]
    if own := [path for path in measured if frames[path] == 1]:
        return "+".join(sorted({digest for path in own if (digest := _contents(path))})) or NONE
    shared = [digest for path in measured if (digest := _contents(path))]
    text = "\0".join([*sorted(shared), frame_id])
    return f"{_SHARED}:{hashlib.sha256(text.encode()).hexdigest()[:_DIGITS]}" if shared else NONE


def _kind(path: Path) -> int:
    """2 for a cloud or tensor, 1 for a picture, 0 for a text."""
    suffix = path.suffix.lower()
    return 0 if suffix in _TEXTS else 1 if suffix in _PICTURES else 2


def _contents(path: Path) -> str:
    """Digest of a file; empty where it holds too little to be one frame's alone."""
    size = path.stat().st_size
    with open_file(path, max_bytes=None) as file:
        if size <= _BLOCKS * _BLOCK_BYTES:
            data = file.read()
        else:
            data = b""
            for number in range(_BLOCKS):
                file.seek(number * (size - _BLOCK_BYTES) // (_BLOCKS - 1))
                data += file.read(_BLOCK_BYTES)
    sample = data[::_STRIDE]
    if len(zlib.compress(sample, 1)) < _FEWEST_BYTES + len(sample) // _STRIDE**2:
        return ""
    suffix = "".join(filter(str.isalnum, path.suffix.lower()))
    return f"{suffix}:{hashlib.sha256(b'%d' % size + data).hexdigest()[:_DIGITS]}"

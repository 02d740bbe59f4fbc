"""Splits of K-Radar: the official lists, and one of ours that keeps sequences whole.

The official lists cut every sequence into quarters, train, test, train, test: neighbouring quarters are one drive 0.1 s
apart, and there is no part for validation. Ours deals the 58 sequences out, about 68, 16 and 17 per cent of the frames,
with every weather in train and test and every weather but overcast (two sequences) in val.
"""

import re
from collections.abc import Iterable
from pathlib import Path

from farfield.datasets.kradar.texts import read_lines
from farfield.errors import FileFormatError

WHOLE_SEQUENCES: dict[str, tuple[int, ...]] = {
    "train": (
        *(1, 2, 3, 5, 6, 7, 11, 12, 13, 14, 15, 16, 18, 19, 20, 21, 24, 25, 27, 28, 30, 31, 32, 33, 34, 35, 36, 37),
        *(38, 40, 42, 44, 45, 47, 48, 52, 54, 56, 57, 58),
    ),
    "val": (8, 9, 17, 23, 39, 49, 50, 51, 55),
    "test": (4, 10, 22, 26, 29, 41, 43, 46, 53),
}
"""The published sequences by part: what ``whole_sequences`` gives for Table 5, written down so that it never moves."""

_LINE = re.compile(r"(\d{1,3})\s*,\s*(\d{5,9}_\d{5,9})(?:\.txt)?")


def split_of_sequences(sequences: Iterable[str]) -> dict[str, list[str]]:
    """The published sequences of a tree by part.

    Args:
        sequences: Names of the sequences that are there.

    Returns:
        ``train``, ``val`` and ``test``; nothing where a sequence is not a published one or a part would be empty.
    """
    known = {str(number): part for part, numbers in WHOLE_SEQUENCES.items() for number in numbers}
    parts: dict[str, list[str]] = {part: [] for part in WHOLE_SEQUENCES}
    for name in sorted(set(sequences), key=lambda name: (len(name), name)):
        if name not in known:
            return {}
        parts[known[name]].append(name)
    return parts if all(parts.values()) else {}


def read_split_list(path: Path) -> set[tuple[str, str]]:
    """Read an official list: (sequence, frame) of each line such as ``1,00033_00001.txt``.

    Raises:
        FileFormatError: If a line has another form.
    """
    keys = set()
    for number, line in enumerate(read_lines(path), start=1):
        found = _LINE.fullmatch(line)
        if found is None:
            expected = "a line such as 1,00033_00001.txt"
            raise FileFormatError(path, where=f"line {number}", expected=expected, found=repr(line[:80]))
        keys.add((found[1], found[2]))
    return keys

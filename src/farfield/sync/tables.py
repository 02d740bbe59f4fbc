"""The table of matches as CSV, a row a message of the reference, written as the rows come."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Int64

from farfield.files.atomic import open_atomic
from farfield.files.text_table import ROWS_AT_ONCE, Text, integers, join
from farfield.sync.blocks import MatchBlock


class MatchTable:
    """Rows of matches as text: of each stream the message and, in nanoseconds, how much later it is.

    Args:
        handle: Where they go.
        reference: Name of the stream to which the others are matched.
        labels: Names of a stream's messages, where they are not counted from 0.
    """

    def __init__(self, handle: BinaryIO, reference: str, labels: Mapping[str, Sequence[str]]) -> None:
        self.handle, self.reference, self.begun = handle, reference, False
        self.labels = {name: _texts(words) for name, words in labels.items()}

    def add(self, others: Sequence[str], rows: MatchBlock) -> None:
        """Write some rows; the header comes before the first."""
        if not self.begun:
            heads = [f"{self.reference}_frame", f"{self.reference}_ns"]
            heads += [f"{name}_{what}" for name in others for what in ("frame", "later_ns")]
            self.handle.write((",".join(head.replace(",", "_") for head in heads) + "\n").encode())
            self.begun = True
        for begin in range(0, len(rows.reference_ns), ROWS_AT_ONCE):
            part = slice(begin, begin + ROWS_AT_ONCE)
            columns = [self._named(self.reference, rows.reference_index[part]), integers(rows.reference_ns[part])]
            for column, name in enumerate(others):
                index = rows.index[part, column]
                later = integers(rows.residual_ns[part, column])
                later[index < 0] = 0
                columns += [self._named(name, index), later]
            self.handle.write(join(columns, ","))

    def _named(self, stream: str, index: Int64[np.ndarray, " n"]) -> Text:
        """The messages' names; nothing where there is none."""
        words = self.labels.get(stream)
        text = integers(np.maximum(index, 0)) if words is None else words[np.maximum(index, 0)]
        text[index < 0] = 0
        return text


def _texts(words: Sequence[str]) -> Text:
    """Words as rows of codes; commas and line ends, which a table has no room for, become low lines."""
    plain = [word.translate({ord(","): "_", ord("\n"): "_", ord("\r"): "_"}).encode() for word in words]
    lines = np.array(plain or [b"0"], dtype=np.bytes_)
    return lines.view(np.uint8).reshape(len(lines), -1)


@contextmanager
def match_table(path: Path, reference: str, labels: Mapping[str, Sequence[str]]) -> Iterator[MatchTable]:
    """A table that appears under its name when the block ends without an error."""
    with open_atomic(path) as handle:
        yield MatchTable(handle, reference, labels)


def read_match_table(path: Path | str) -> dict[str, list[str]]:
    """The columns of a table of matches, as text; a cell without a partner is empty."""
    rows = [line.split(",") for line in Path(path).read_text(encoding="utf-8").splitlines()]
    return dict(zip(rows[0], map(list, zip(*rows[1:], strict=True)), strict=True)) if len(rows) > 1 else {}

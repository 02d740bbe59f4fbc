"""Files of lines in which some objects change: the others keep their bytes, in their places."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from farfield.datasets.labels.contract import BoxLabel, Numbers
from farfield.frame import Key

_ALIKE = 1e-9  # metres or radians: a box that went to the page and came back unmoved


class FileSpan(NamedTuple):
    """A stretch of a file: one object's line or lines, or what stands between objects.

    Args:
        raw: Its bytes, with the end of its last line.
        key: The object's frame; None for what is no object.
        label: The object, as ``parse`` gives it.
    """

    raw: bytes
    key: Key | None = None
    label: BoxLabel | None = None


Writes = Callable[[Key, BoxLabel, FileSpan | None], bytes]
"""The line of an object with its end: from its frame, its values and, where the file has it, what stands there now."""


def replaced(
    parts: Sequence[FileSpan],
    labels: Mapping[Key, Sequence[BoxLabel]],
    *,
    write: Writes,
    same: Callable[[BoxLabel, BoxLabel], bool],
    end: bytes = b"\n",
) -> bytes:
    """The file with other labels in some frames, as :meth:`LabelFormat.render` promises.

    New objects stand behind the last of their frame, or at the end. A last line without its end stays so while nothing
    follows it.

    Args:
        parts: The whole file, in order.
        labels: All labels of the frames that changed.
        write: Gives an object's line.
        same: Whether two labels (the file's and the new one) stand in the file alike.
        end: End of a line.
    """
    left = {key: {label.id: label for label in wanted} for key, wanted in labels.items()}
    out: list[list[bytes]] = []
    last: dict[Key, int] = {}
    for part in parts:
        out.append([part.raw])
        if part.key is None or part.label is None or part.key not in left:
            continue
        last[part.key] = len(out) - 1
        new = left[part.key].pop(part.label.id, None)
        if new is None:
            out[-1] = []
        elif not same(part.label, new):
            out[-1] = [write(part.key, new, part)]
    out.append([])
    for key, added in left.items():
        out[last.get(key, -1)].extend(write(key, label, None) for label in added.values())
    return _joined([line for lines in out for line in lines if line], end)


def _joined(lines: Sequence[bytes], end: bytes) -> bytes:
    """All lines; one without its end gets it only where another follows."""
    closed = [line if line.endswith(b"\n") else line + end for line in lines[:-1]]
    return b"".join([*closed, *lines[-1:]])


def physical_lines(data: bytes) -> list[bytes]:
    r"""The lines of a file with their ends; only ``\n`` ends one, so that all bytes are kept.

    >>> physical_lines(b"a\r\nb")
    [b'a\r\n', b'b']
    """
    pieces = data.split(b"\n")
    return [piece + b"\n" for piece in pieces[:-1]] + ([pieces[-1]] if pieces[-1] else [])


def kept_numbers(old: Numbers, new: Numbers) -> Numbers:
    """The new box, with the old number wherever both differ by less than a nanometre or a full turn.

    >>> kept_numbers((1.0, 0.0, 0.0, 4.0, 2.0, 1.5, 4.0), (1.0, 2.0, 0.0, 4.0, 2.0, 1.5, 4.0 - 2 * math.pi))
    (1.0, 2.0, 0.0, 4.0, 2.0, 1.5, 4.0)
    """
    turn = math.remainder(new[6] - old[6], 2 * math.pi)
    x, y, z, length, width, height = (
        a if abs(b - a) <= _ALIKE else float(b) for a, b in zip(old[:6], new[:6], strict=True)
    )
    return x, y, z, length, width, height, old[6] if abs(turn) <= _ALIKE else float(new[6])

"""Where the elements of an XML file stand in its bytes, so that one of them can change and the rest keeps its own."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from farfield.files.xml_tree import parse_xml


@dataclass(slots=True)
class Span:
    """One element: its name, its bytes from ``start`` to ``end``, and what it holds from ``inner`` to ``close``."""

    name: str
    start: int
    inner: int
    close: int = 0
    end: int = 0
    children: list["Span"] = field(default_factory=list)

    def all(self, name: str) -> list["Span"]:
        """The elements of a name directly in it."""
        return [child for child in self.children if child.name == name]

    def one(self, name: str) -> "Span | None":
        """The first element of a name in it."""
        return next(iter(self.all(name)), None)


Edit = tuple[int, int, bytes]
"""Bytes from the first number to before the second, and what stands there instead."""


def parse_spans(data: bytes, path: Path | str) -> Span:
    """The outermost element with the places of all in it.

    Raises:
        FileFormatError: As :func:`~farfield.files.xml_tree.parse_xml`.
    """
    parse_xml(data, path)
    builder, parser = _SpanBuilder(data), expat.ParserCreate()
    builder.parser = parser
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.finish
    parser.Parse(data, True)
    return builder.open[0].children[0]


class _SpanBuilder:
    def __init__(self, data: bytes) -> None:
        self.data, self.open = data, [Span("", 0, 0)]
        self.parser = expat.ParserCreate()

    def start(self, name: str, attributes: dict[str, str]) -> None:
        del attributes
        at = self.parser.CurrentByteIndex
        element = Span(name, at, self.data.index(b">", at) + 1)
        self.open[-1].children.append(element)
        self.open.append(element)

    def finish(self, name: str) -> None:
        del name
        element, at = self.open.pop(), self.parser.CurrentByteIndex
        alone = self.data[element.inner - 2 : element.inner] == b"/>"
        element.close = element.inner if alone else at
        element.end = element.inner if alone else self.data.index(b">", at) + 1


def edited(data: bytes, edits: Iterable[Edit], start: int = 0, end: int | None = None) -> bytes:
    """A stretch of bytes with some of it replaced; edits outside the stretch are left out.

    >>> edited(b"abcdef", [(1, 2, b"X"), (4, 4, b"Y")])
    b'aXcdYef'
    """
    end = len(data) if end is None else end
    out, at = [], start
    for first, last, new in sorted(edits):
        if start <= first and last <= end:
            out += [data[at:first], new]
            at = last
    return b"".join([*out, data[at:end]])

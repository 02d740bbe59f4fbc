"""XML that strangers wrote, as a tree of plain elements: nothing is expanded, fetched or larger than allowed."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.parsers import expat

from farfield.errors import FileFormatError

MAX_BYTES = 64 << 20
MAX_ELEMENTS = 2_000_000  # in memory some 200 bytes each, with their places twice as many
_MAX_TAGS = 2 * MAX_ELEMENTS  # one that opens and one that closes
_DEPTH = 32


@dataclass(slots=True)
class Element:
    """One element: its name, its text without blanks around it, and the elements in it."""

    name: str
    text: str = ""
    children: list["Element"] = field(default_factory=list)

    def all(self, name: str) -> list["Element"]:
        """The elements of a name directly in it."""
        return [child for child in self.children if child.name == name]

    def get(self, name: str) -> str | None:
        """The text of the first element of a name in it, or None."""
        return next((child.text for child in self.children if child.name == name), None)


class _RefusedError(Exception):
    """What the parser met is not allowed."""


class _TreeBuilder:
    """Builds the tree as the parser goes along."""

    def __init__(self) -> None:
        self.root = Element("")
        self.open = [self.root]
        self.words: list[str] = []
        self.count = 0

    def start(self, name: str, attributes: dict[str, str]) -> None:
        del attributes
        if len(self.open) > _DEPTH:
            raise _RefusedError(f"elements nested deeper than {_DEPTH}")
        self.count += 1
        if self.count > MAX_ELEMENTS:
            raise _RefusedError(f"more than {MAX_ELEMENTS} elements")
        self.words.clear()
        element = Element(name)
        self.open[-1].children.append(element)
        self.open.append(element)

    def end(self, name: str) -> None:
        del name
        self.open.pop().text = "".join(self.words).strip()
        self.words.clear()

    def characters(self, text: str) -> None:
        self.words.append(text)

    def refuse(self, *arguments: Any) -> int:
        del arguments
        raise _RefusedError("a declared entity")


def parse_xml(data: bytes, path: Path | str, *, max_bytes: int = MAX_BYTES) -> Element:
    """The outermost element of an XML file. Attributes and comments are left out.

    Raises:
        FileFormatError: If it is no XML, too large, of too many elements, nested too deep, or declares entities, which
            could grow without bound or name other files.
    """
    if len(data) > max_bytes:
        raise FileFormatError(path, where="the file", expected=f"at most {max_bytes} bytes", got=f"{len(data)} bytes")
    if data.count(b"<") > _MAX_TAGS:  # counted before any is built: each costs a hundred times its four bytes
        expected = f"at most {MAX_ELEMENTS} elements"
        raise FileFormatError(path, where="the file", expected=expected, got=f"more than {_MAX_TAGS} tags and comments")
    builder, parser = _TreeBuilder(), expat.ParserCreate()
    parser.buffer_text = True
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    parser.CharacterDataHandler = builder.characters
    parser.EntityDeclHandler = parser.UnparsedEntityDeclHandler = builder.refuse
    parser.ExternalEntityRefHandler = parser.SkippedEntityHandler = builder.refuse
    try:
        parser.Parse(data, True)
    except (expat.ExpatError, _RefusedError, ValueError, LookupError) as error:
        where = f"line {parser.CurrentLineNumber}"
        raise FileFormatError(path, where=where, expected="XML without entities", got=str(error)[:200]) from error
    return builder.root.children[0]


# Where the elements of an XML file stand in its bytes, so that one of them can change and the rest keeps its own.


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

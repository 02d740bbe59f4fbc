"""What a pickle says, without running it: a walker of its op-codes that records calls and calls nothing.

Python's pickle is a program for a stack machine; its op-codes are described in the standard library's ``pickletools``.
Of them those are walked that plain values, tuples, lists, dictionaries and recorded calls need, in protocols 3 to 5.
Whatever names a function or a class becomes a :class:`Name`, whatever calls one a :class:`Call`; no name is looked up.

An op-code makes one value at most, of a fixed size or of bytes that stand in the stream, so what a pickle takes is
bounded by its size and its number of op-codes, however often it fetches, doubles or appends values. Values may hold
themselves: who reads them must not follow them to the end, nor print them.
"""

import struct
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from farfield.errors import FileFormatError

MAX_OPCODES = 1_000_000
MAX_MARKS = 64
_LONGEST_LINE, _LONGEST_TEXT = 200, 1 << 16


class Name(NamedTuple):
    """A function or class that a pickle names; it is not looked up."""

    module: str
    name: str

    def __str__(self) -> str:
        return f"{self.module}.{self.name}"


@dataclass(eq=False, repr=False, slots=True)
class Call:
    """A call recorded in a pickle, never executed.

    Args:
        called: What it calls.
        arguments: What it hands over.
        state: What is set on the result afterwards; None where nothing is.
    """

    called: Name
    arguments: tuple[Any, ...]
    state: Any = None


class _Refused(Exception):  # noqa: N818 - never leaves this module
    def __init__(self, expected: str, got: str) -> None:
        super().__init__(got)
        self.expected, self.got = expected, got


@dataclass(slots=True)
class _Walk:
    """The stream, where it stands, and the machine's stack, marks and memory."""

    data: memoryview
    names: Collection[Name]
    at: int = 0
    stack: list[Any] = field(default_factory=list)
    marks: list[int] = field(default_factory=list)
    memo: dict[int, Any] = field(default_factory=dict)

    def take(self, count: int) -> memoryview:
        if count > len(self.data) - self.at:
            raise _Refused(f"{count} bytes", f"{len(self.data) - self.at} to the end")
        self.at += count
        return self.data[self.at - count : self.at]

    def number(self, layout: str) -> Any:
        return struct.unpack(layout, self.take(struct.calcsize(layout)))[0]

    def line(self) -> str:
        line = bytes(self.data[self.at : self.at + _LONGEST_LINE]).partition(b"\n")
        if not line[1]:
            raise _Refused(f"a name of at most {_LONGEST_LINE} bytes", "a longer one")
        self.at += len(line[0]) + 1
        return _text(line[0])

    def pop(self, kind: type = object) -> Any:
        if len(self.stack) <= (self.marks[-1] if self.marks else 0):
            raise _Refused("a value on the stack", "none")
        value = self.stack.pop()
        if not isinstance(value, kind):
            raise _Refused(f"a {kind.__name__} on the stack", type(value).__name__)
        return value

    def top(self, kind: type) -> Any:
        value = self.pop(kind)
        self.stack.append(value)
        return value

    def since_mark(self) -> list[Any]:
        if not self.marks:
            raise _Refused("a mark on the stack", "none")
        start = self.marks.pop()
        values = self.stack[start:]
        del self.stack[start:]
        return values


def _text(data: bytes | memoryview) -> str:
    try:
        return str(data, "utf-8")
    except UnicodeDecodeError as error:
        raise _Refused("UTF-8", "other bytes") from error


def _push_text(walk: _Walk, layout: str) -> None:
    count = walk.number(layout)
    if count > _LONGEST_TEXT:
        raise _Refused(f"a text of at most {_LONGEST_TEXT} bytes", f"one of {count}")
    walk.stack.append(_text(walk.take(count)))


def _name(walk: _Walk, module: str, name: str) -> None:
    named = Name(module, name)
    if named not in walk.names:
        raise _Refused("a name that this reader knows", str(named)[:120])
    walk.stack.append(named)


def _long(walk: _Walk) -> None:
    count = walk.number("<B")
    if count > 8:
        raise _Refused("whole numbers of 64 bits", f"one of {count} bytes")
    walk.stack.append(int.from_bytes(walk.take(count), "little", signed=True))


def _tuple_of(walk: _Walk, count: int) -> None:
    values = [walk.pop() for _ in range(count)]
    walk.stack.append(tuple(reversed(values)))


def _stack_global(walk: _Walk) -> None:
    name, module = walk.pop(str), walk.pop(str)
    _name(walk, module, name)


def _call(walk: _Walk) -> None:
    arguments, called = walk.pop(tuple), walk.pop(Name)
    walk.stack.append(Call(called, arguments))


def _build(walk: _Walk) -> None:
    state = walk.pop()
    call = walk.top(Call)
    if call.state is not None:
        raise _Refused("one state a value", f"another for {call.called}")
    call.state = state


def _set_items(walk: _Walk, items: list[Any]) -> None:
    target = walk.top(dict)
    keys, values = items[::2], items[1::2]
    if len(keys) != len(values) or not all(isinstance(key, str) for key in keys):
        raise _Refused("texts as keys, each with a value", "others")
    target.update(zip(keys, values, strict=True))


def _set_item(walk: _Walk) -> None:
    value, key = walk.pop(), walk.pop()
    _set_items(walk, [key, value])


def _append(walk: _Walk) -> None:
    value = walk.pop()
    walk.top(list).append(value)


def _set_marked(walk: _Walk) -> None:
    _set_items(walk, walk.since_mark())


def _append_marked(walk: _Walk) -> None:
    values = walk.since_mark()
    walk.top(list).extend(values)


def _drop(walk: _Walk) -> None:
    walk.pop()


def _drop_marked(walk: _Walk) -> None:
    walk.since_mark()


def _mark(walk: _Walk) -> None:
    if len(walk.marks) >= MAX_MARKS:
        raise _Refused(f"values nested at most {MAX_MARKS} deep", "deeper ones")
    walk.marks.append(len(walk.stack))


def _remember(walk: _Walk, number: int) -> None:
    walk.memo[number] = walk.top(object)


def _fetch(walk: _Walk, number: int) -> None:
    if number not in walk.memo:
        raise _Refused("a value that was kept", f"number {number}, which was not")
    walk.stack.append(walk.memo[number])


def _frame(walk: _Walk) -> None:
    length = walk.number("<Q")
    if length > len(walk.data) - walk.at:
        raise _Refused(f"a frame of {length} bytes", f"{len(walk.data) - walk.at} to the end")


_STEPS: dict[int, Callable[[_Walk], None]] = {
    ord("("): _mark,
    ord("0"): _drop,
    ord("1"): _drop_marked,
    ord("N"): lambda walk: walk.stack.append(None),
    0x88: lambda walk: walk.stack.append(True),
    0x89: lambda walk: walk.stack.append(False),
    ord("J"): lambda walk: walk.stack.append(walk.number("<i")),
    ord("K"): lambda walk: walk.stack.append(walk.number("<B")),
    ord("M"): lambda walk: walk.stack.append(walk.number("<H")),
    0x8A: _long,
    ord("G"): lambda walk: walk.stack.append(walk.number(">d")),
    0x8C: lambda walk: _push_text(walk, "<B"),
    ord("X"): lambda walk: _push_text(walk, "<I"),
    0x8D: lambda walk: _push_text(walk, "<Q"),
    ord("C"): lambda walk: walk.stack.append(walk.take(walk.number("<B"))),
    ord("B"): lambda walk: walk.stack.append(walk.take(walk.number("<I"))),
    0x8E: lambda walk: walk.stack.append(walk.take(walk.number("<Q"))),
    0x96: lambda walk: walk.stack.append(walk.take(walk.number("<Q"))),
    ord("]"): lambda walk: walk.stack.append([]),
    ord("a"): _append,
    ord("e"): _append_marked,
    ord(")"): lambda walk: walk.stack.append(()),
    ord("t"): lambda walk: walk.stack.append(tuple(walk.since_mark())),
    0x85: lambda walk: _tuple_of(walk, 1),
    0x86: lambda walk: _tuple_of(walk, 2),
    0x87: lambda walk: _tuple_of(walk, 3),
    ord("}"): lambda walk: walk.stack.append({}),
    ord("s"): _set_item,
    ord("u"): _set_marked,
    ord("c"): lambda walk: _name(walk, walk.line(), walk.line()),
    0x93: _stack_global,
    ord("R"): _call,
    0x81: _call,
    ord("b"): _build,
    ord("q"): lambda walk: _remember(walk, walk.number("<B")),
    ord("r"): lambda walk: _remember(walk, walk.number("<I")),
    0x94: lambda walk: _remember(walk, len(walk.memo)),
    ord("h"): lambda walk: _fetch(walk, walk.number("<B")),
    ord("j"): lambda walk: _fetch(walk, walk.number("<I")),
    0x95: _frame,
}
_PROTOCOL, _STOP = 0x80, ord(".")


def walk_pickle(data: bytes, path: Path | str, names: Collection[Name], *, fix: str = "") -> Any:
    """The value that a pickle describes.

    Args:
        data: The pickle; values of bytes are views of it.
        path: The file, for messages.
        names: Functions and classes that it may name.
        fix: What to do about a pickle that is refused, for messages.

    Returns:
        None, booleans, numbers, texts, views of bytes, tuples, lists, dictionaries of texts, names and calls.

    Raises:
        FileFormatError: If it names another, uses another op-code or protocol, or more than :data:`MAX_OPCODES`.
    """
    if len(data) < 2 or data[0] != _PROTOCOL or not 3 <= data[1] <= 5:
        got = f"protocol {data[1]}" if data[:1] == bytes([_PROTOCOL]) and len(data) > 1 else "other bytes"
        raise FileFormatError(path, where="byte 0", expected="a pickle of protocol 3, 4 or 5", got=got, fix=fix)
    walk, start = _Walk(memoryview(data), names, at=2), 2
    try:
        for _ in range(MAX_OPCODES):
            start = walk.at
            opcode = walk.number("<B")
            if opcode == _STOP:
                break
            step = _STEPS.get(opcode)
            if step is None:
                raise _Refused("an op-code of plain values", f"{opcode:#04x}")
            step(walk)
        else:
            raise _Refused(f"at most {MAX_OPCODES} op-codes", "more")
        value = walk.pop()
        if walk.stack or walk.marks or walk.at != len(data):
            raise _Refused("one value and the end", "more")
    except _Refused as error:
        raise FileFormatError(path, where=f"byte {start}", expected=error.expected, got=error.got, fix=fix) from error
    return value

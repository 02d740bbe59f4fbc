"""YAML that strangers wrote: its values as YAML 1.2 reads them, each key once in its group, within bounds.

PyYAML follows YAML 1.1: it takes the last of two equal keys in silence, reads ``1:30:00`` as 5400, ``010`` as 8,
``no`` as false and ``00033_00001`` as 884737, and lets 306 bytes of aliases stand for 400 million values. Here a key is
the word that stands there, dates, clock times and such numbers are texts, and what a file stands for is counted.
"""

import math
import re
from typing import Any, get_args

import yaml
from pydantic import BaseModel, ConfigDict, field_validator
from yaml.events import AliasEvent
from yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from farfield.errors import plain
from farfield.files.limits import fits_64_bits

MAX_BYTES = 1 << 20  # of a file of settings
MAX_NODES = 100_000  # values and keys, those behind aliases at each use
MAX_DEPTH = 64
_TAG = "tag:yaml.org,2002:"


class RefusedYamlError(yaml.YAMLError):
    """YAML that is out of bounds, or means something else than it seems to."""


class _PlainLoader(yaml.SafeLoader):
    """A safe loader of bounded files whose keys are texts, each once in a group."""

    yaml_implicit_resolvers = {}  # noqa: RUF012 - as PyYAML declares it
    yaml_constructors = {None: yaml.SafeLoader.construct_undefined}  # noqa: RUF012
    yaml_multi_constructors = {}  # noqa: RUF012

    def __init__(self, text: str, *, finite: bool) -> None:
        super().__init__(text)
        self.finite = finite
        self._nodes, self._depth = 0, 0
        self._sizes: dict[str, int] = {}  # nodes that an anchor stands for, those behind aliases counted at each use

    def compose_node(self, parent: Node | None, index: Any) -> Node | None:
        """A node, counted; an alias counts as all that it repeats."""
        event, before = self.peek_event(), self._nodes
        line = event.start_mark.line + 1
        if isinstance(event, AliasEvent) and event.anchor in self.anchors:
            if event.anchor not in self._sizes:
                raise RefusedYamlError(f"the alias {str(event.anchor)[:40]!r} within its own value, in line {line}")
            self._nodes += self._sizes[event.anchor]
        self._nodes, self._depth = self._nodes + 1, self._depth + 1
        if self._nodes > MAX_NODES:
            raise RefusedYamlError(f"more than {MAX_NODES} values, those that aliases repeat counted, in line {line}")
        if self._depth > MAX_DEPTH:
            raise RefusedYamlError(f"groups nested deeper than {MAX_DEPTH}, in line {line}")
        node = super().compose_node(parent, index)
        self._depth -= 1
        if not isinstance(event, AliasEvent) and event.anchor is not None:
            self._sizes[event.anchor] = self._nodes - before
        return node

    def compose_mapping_node(self, anchor: Any) -> MappingNode:
        """A group; its keys as they are written."""
        node: MappingNode = super().compose_mapping_node(anchor)
        lines: dict[str, int] = {}
        for key, _ in node.value:
            if isinstance(key, ScalarNode) and key.tag != f"{_TAG}merge":
                key.tag = f"{_TAG}str"
                line = key.start_mark.line + 1
                if key.value in lines:
                    where = f"in lines {lines[key.value]} and {line}" if lines[key.value] != line else f"in line {line}"
                    fault = f"the key {key.value[:40]!r} twice in one group, {where}: remove one of them"
                    raise RefusedYamlError(fault)
                lines[key.value] = line
        return node


def _null(loader: _PlainLoader, node: ScalarNode) -> None:
    loader.construct_scalar(node)


def _truth(loader: _PlainLoader, node: ScalarNode) -> bool:
    word = str(loader.construct_scalar(node)).lower()
    if word not in ("true", "false"):
        raise RefusedYamlError(f"{word[:40]!r} as true or false, in line {node.start_mark.line + 1}")
    return word == "true"


def _digits(loader: _PlainLoader, node: ScalarNode) -> str:
    """A number's text; a tag may stand before what is none by YAML 1.2, such as ``!!int 1_000``."""
    text = str(loader.construct_scalar(node))
    if "_" in text or not text.isascii():
        raise RefusedYamlError(f"{text[:40]!r} as a number, in line {node.start_mark.line + 1}")
    return text


def _whole_number(loader: _PlainLoader, node: ScalarNode) -> int:
    text = _digits(loader, node)
    number = int(text, 16 if "x" in text else 10) if len(text) <= 40 else 1 << 64
    if not fits_64_bits(number):
        raise RefusedYamlError(f"a whole number beyond 64 bits, in line {node.start_mark.line + 1}")
    return number


def _number(loader: _PlainLoader, node: ScalarNode) -> float:
    text = _digits(loader, node)
    number = float(text.replace(".", "") if text[-1:].isalpha() else text)
    if loader.finite and not math.isfinite(number):
        raise RefusedYamlError(f"{text[:40]}, which is no finite number, in line {node.start_mark.line + 1}")
    return number


def _text(loader: _PlainLoader, node: ScalarNode) -> str:
    text = str(loader.construct_scalar(node))
    text.encode("utf-8")  # fails at halves of characters, which no file and no message can hold
    return text


def _opencv(loader: _PlainLoader, suffix: str, node: Node) -> Any:
    """OpenCV's tags are read as plain groups and lists."""
    del suffix
    if isinstance(node, MappingNode):
        return loader.construct_mapping(node, deep=True)
    return loader.construct_sequence(node, deep=True) if isinstance(node, SequenceNode) else None


for _kind, _pattern, _first in (
    ("null", r"^(?:~|null|Null|NULL|)$", ["~", "n", "N", ""]),
    ("bool", r"^(?:true|True|TRUE|false|False|FALSE)$", list("tTfF")),
    ("int", r"^[-+]?(?:0|[1-9][0-9]*|0x[0-9a-fA-F]+)$", list("-+0123456789")),
    ("float", r"^[-+]?(?:[0-9]+\.[0-9]*|\.[0-9]+|[1-9][0-9]*(?=[eE]))(?:[eE][-+]?[0-9]+)?$", list("-+.0123456789")),
    ("float", r"^(?:[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$", list("-+.")),
    ("merge", r"^<<$", ["<"]),
):
    _PlainLoader.add_implicit_resolver(_TAG + _kind, re.compile(_pattern), _first)
for _kind, _construct in (
    ("null", _null),
    ("bool", _truth),
    ("int", _whole_number),
    ("float", _number),
    ("str", _text),
    ("seq", yaml.SafeLoader.construct_yaml_seq),
    ("map", yaml.SafeLoader.construct_yaml_map),
):
    _PlainLoader.add_constructor(_TAG + _kind, _construct)
_PlainLoader.add_multi_constructor(f"{_TAG}opencv", _opencv)


def plain_yaml(text: str | bytes, *, finite: bool = True) -> Any:
    """The content of a YAML file of :data:`MAX_BYTES` at most.

    Nulls, ``true`` and ``false``, whole numbers of 64 bits without leading zeros, finite numbers with a point or an
    exponent, texts, lists and groups; all else that is no error is a text. Aliases and merge keys count as what they
    repeat.

    Args:
        text: The file's text, or its bytes in UTF-8.
        finite: Refuse numbers that are not finite wherever they stand; False: whoever reads a number checks it.

    Raises:
        yaml.YAMLError: If it is none, a key stands twice in one group, or it is larger or deeper than the limits here.
    """
    if len(text) > MAX_BYTES:
        raise RefusedYamlError(f"more than {MAX_BYTES} bytes")
    try:
        text = text.decode("utf-8-sig") if isinstance(text, bytes) else text
        loader = _PlainLoader(text, finite=finite)
        try:
            return loader.get_single_data()
        finally:
            loader.dispose()
    except (ValueError, TypeError) as error:  # what Python says of numbers, characters and keys
        raise RefusedYamlError(plain(error)) from error


class PlainSettings(BaseModel):
    """Settings whose numbers are finite and no true or false, which pydantic takes for 1 and 0."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _no_flag_for_a_number(cls, value: Any, info: Any) -> Any:
        field = cls.model_fields[str(info.field_name)]
        kinds = _kinds(field.annotation)
        flags = [item for item in (value if isinstance(value, list | tuple) else [value]) if isinstance(item, bool)]
        if flags and kinds & {int, float} and bool not in kinds:
            raise ValueError(f"expected a number, got {str(flags[0]).lower()}")
        return value


def _kinds(annotation: Any) -> set[Any]:
    """A type and those that it is made of."""
    inner = [_kinds(part) for part in get_args(annotation)]
    return {annotation if isinstance(annotation, type) else None}.union(*inner)

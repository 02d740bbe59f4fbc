"""YAML that people wrote: each key once in its group, and a key of a word is that word, as it stands there.

YAML itself takes the last of two equal keys in silence, and turns ``0``, ``no`` and ``1e3`` as keys into numbers and
truth values, which no setting and no class is called.
"""

from typing import Any

import yaml
from yaml.nodes import MappingNode, ScalarNode

_MERGE = "tag:yaml.org,2002:merge"


class DoubleKeyError(yaml.YAMLError):
    """A key stands twice in one group."""


class PlainLoader(yaml.SafeLoader):
    """A safe loader whose keys are texts, each once in a group."""

    def construct_mapping(self, node: MappingNode, deep: bool = False) -> dict[Any, Any]:
        """The group; its keys as they are written."""
        lines: dict[str, int] = {}
        for key, _ in node.value:
            if isinstance(key, ScalarNode) and key.tag != _MERGE:
                key.tag = "tag:yaml.org,2002:str"
                line = key.start_mark.line + 1
                if key.value in lines:
                    where = f"in lines {lines[key.value]} and {line}" if lines[key.value] != line else f"in line {line}"
                    raise DoubleKeyError(f"the key {key.value[:40]!r} twice in one group, {where}: remove one of them")
                lines[key.value] = line
        return super().construct_mapping(node, deep)


def plain_yaml(text: str | bytes) -> Any:
    """The content of a YAML file.

    Raises:
        yaml.YAMLError: If it is none, or a key stands twice in one group.
    """
    return yaml.load(text, Loader=PlainLoader)  # noqa: S506 - a SafeLoader

"""Which results may stand in one column: those whose settings agree in all that their figures depend on."""

from collections.abc import Mapping
from typing import Any

from farfield.metrics.protocol import protocol_of

Tree = Mapping[str, Any]


def protocol_family(result: Tree) -> str:
    """The protocol without its variant: figures of two families never share a column.

    >>> protocol_family({"protocol": "kradar-compat:old_as_shipped"})
    'kradar'
    """
    protocol = protocol_of(result)
    return protocol.family or str(protocol)


def convention_of(result: Tree, *, by_range: bool = False) -> dict[str, Any]:
    """The settings on which a result's figures depend, by its protocol.

    Args:
        result: Result JSON, as ``farfield score --json`` writes it.
        by_range: Whether figures of range bins are looked at, so that the bins matter.
    """
    return protocol_of(result).depends_on(result.get("settings") or {}, by_range=by_range)


def differing_settings(a: Tree, b: Tree, *, by_range: bool = False) -> dict[str, tuple[Any, Any]]:
    """Settings in which two results' conventions differ, with both values; None where one lacks the setting."""
    here, there = convention_of(a, by_range=by_range), convention_of(b, by_range=by_range)
    names = [*here, *(name for name in there if name not in here)]
    return {name: (here.get(name), there.get(name)) for name in names if here.get(name) != there.get(name)}


def convention_text(result: Tree, *, by_range: bool = False) -> str:
    """The convention as one line of ``name=value`` pairs, in the order in which its protocol prints them."""
    settings = result.get("settings") or {}
    return f"{result.get('protocol')}: " + protocol_of(result).convention_text(settings, by_range=by_range)

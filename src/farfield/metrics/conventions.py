"""Which results may stand in one column: those whose settings agree in all that their figures depend on."""

from collections.abc import Mapping
from typing import Any

from farfield.metrics.centre.settings import option_text

Tree = Mapping[str, Any]
_INERT = ("bootstrap", "label")


def protocol_family(result: Tree) -> str:
    """The protocol without its variant: figures of two families never share a column.

    >>> protocol_family({"protocol": "kradar-compat:old_as_shipped"})
    'kradar'
    """
    name = str(result.get("protocol", "")).partition(":")[0]
    return "kradar" if name == "kradar-compat" else name


def convention_of(result: Tree, *, by_range: bool = False) -> dict[str, Any]:
    """The settings on which a result's figures depend.

    Left out is what changes no figure: the bootstrap, the range bins where they do not bound the region, the window
    where there is none, the classes and overlaps of K-Radar's protocols, which have figures of their own (the classes
    do matter where frames without any of them are dropped).

    Args:
        result: Result JSON, as ``farfield score --json`` writes it.
        by_range: Whether figures of range bins are looked at, so that the bins matter.
    """
    settings = {name: value for name, value in dict(result.get("settings") or {}).items() if name not in _INERT}
    region = settings.get("region")
    if region != "window":
        settings.pop("window_m", None)
    if protocol_family(result) == "kradar":
        for name in ("ious", "boxes_in", *(("azimuth_deg", "outside") if region == "none" else ())):
            settings.pop(name, None)
        if settings.get("empty_frames") == "counted":
            settings.pop("classes", None)
        region = "none"  # its region does not depend on the bins
    if region == "none" and not by_range:
        settings.pop("range_bins_m", None)
    if isinstance(settings.get("epsilons"), list):
        settings["epsilons"] = settings["epsilons"][:1]  # AP and errors are those of the first; wDDS names its own
    return settings


def differing_settings(a: Tree, b: Tree, *, by_range: bool = False) -> dict[str, tuple[Any, Any]]:
    """Settings in which two results' conventions differ, with both values; None where one lacks the setting."""
    here, there = convention_of(a, by_range=by_range), convention_of(b, by_range=by_range)
    names = [*here, *(name for name in there if name not in here)]
    return {name: (here.get(name), there.get(name)) for name in names if here.get(name) != there.get(name)}


def convention_text(result: Tree, *, by_range: bool = False) -> str:
    """The convention as one line of ``name=value`` pairs, in the order in which its protocol prints them."""
    shown = convention_of(result, by_range=by_range)
    if protocol_family(result) == "kradar":
        first = ("label_version", "region", "azimuth_deg", "score_cut", "recall_points", "empty_frames", "yaw")
        shown.pop("relabel", None)
        shown.pop("origin_m", None)
        shown = {name: shown[name] for name in first if name in shown} | shown
    return f"{result.get('protocol')}: " + option_text(shown)

"""A small tree of each format by its name: what ``test_every_format`` opens, examines, draws and detects in.

Whoever adds a format adds a line: ``"module:function"`` of what writes one into a folder. A module that is not there,
or an extra that it needs, skips that format's test.
"""

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

FIXTURES: dict[str, str] = {
    "kitti": "trees:write_kitti",
    "kitti_tracking": "trees:write_kitti_tracking",
    "view_of_delft": "trees:write_delft",
    "radiate": "trees:write_sequence",
    "argoverse2": "trees:write_argoverse2",
    "labelcloud": "tool_trees:write_labelcloud",
    "supervisely": "tool_trees:write_supervisely",
    "xtreme1": "tool_trees:write_xtreme1",
    "openlabel": "tool_trees:write_openlabel",
    "segments_ai": "tool_trees:write_segments_ai",
    "scale": "datasets.generators.scale_trees:write_scale",
    "openpcdet": "openpcdet_tree:write_openpcdet",
    "bags": "ros1_bytes:write_ros1_bag",
    "kradar": "drive:write_kradar",
    "nuscenes": "datasets.generators.nuscenes_trees:write_nuscenes",
    "zod": "datasets.generators.zod:write_zod",
    "pandaset": "datasets.generators.pandaset:write_pandaset",
    "aimotive": "datasets.generators.aimotive:write_aimotive",
    "waymo": "datasets.generators.waymo:write_waymo",
    "argoverse1": "datasets.generators.argoverse1:write_argoverse1",
    "dual_radar": "datasets.generators.dual_radar:write_dual_radar",
}


def fixture_of(name: str) -> Callable[[Path], Any] | None:
    """What writes a tree of a format; None where nothing here does."""
    module, _, function = FIXTURES.get(name, "").partition(":")
    if not module:
        return None
    try:
        writer: Callable[[Path], Any] = getattr(import_module(module), function)
    except ModuleNotFoundError:
        return None
    return writer

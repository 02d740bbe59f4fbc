"""Settings that had another name: the old names stay accepted."""

from collections.abc import Mapping
from typing import Any


def renamed(settings: Any, names: Mapping[str, str]) -> Any:
    """Settings under today's names.

    Args:
        settings: A tree of settings; anything else comes back as it is. It is not changed.
        names: Today's places by the old ones, dotted, such as ``{"grid.voxel_m": "grid.cell_m"}``; both places of a
            pair lie in one group.

    Raises:
        ValueError: If a setting stands under both names.
    """
    for old, new in names.items():
        settings = _moved(settings, old.split("."), new.split("."))
    return settings


def today(path: str, names: Mapping[str, str]) -> str:
    """Today's dotted place of a setting, or of one within a group, such as ``grid.range_m`` for ``window.range_m``."""
    for old, new in names.items():
        if path == old or path.startswith(f"{old}."):
            return new + path[len(old) :]
    return path


def _moved(settings: Any, old: list[str], new: list[str]) -> Any:
    if not isinstance(settings, Mapping) or old[0] not in settings:
        return settings
    if len(old) > 1:
        return {**settings, old[0]: _moved(settings[old[0]], old[1:], new[1:])}
    if new[0] in settings:
        raise ValueError(f"{old[0]} is the old name of {new[0]}: give one of them")
    return {(new[0] if name == old[0] else name): value for name, value in settings.items()}

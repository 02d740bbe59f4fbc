"""How frames came about, and seeing other frames likewise: as a detector was trained to see them."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from farfield.datasets.base import Dataset
from farfield.datasets.frame_maps import MAPS, FrameMap, described, make
from farfield.errors import ConfigError
from farfield.files.remote_paths import as_path

RADAR_OPTIONS = ("radar_rate", "radar_region", "radar_over")
"""Options of ``open_dataset`` that become the map ``radar_view``."""


def maps_of_options(options: Mapping[str, Any]) -> list[FrameMap]:
    """The maps that options of ``open_dataset`` stand for: ``poses``, ``reference``, ``radar_rate``..., ``rotate_deg``.

    Args:
        options: Any options; those that stand for no map are passed over.

    Raises:
        ConfigError: If a value is not one of those possible.
    """
    maps: list[FrameMap] = []
    if options.get("poses") is not None:
        maps.append(MAPS["posed"](as_path(options["poses"])))
    if options.get("reference") is not None:
        maps.append(MAPS["coordinates"](str(options["reference"])))
    radar = {name.removeprefix("radar_"): options[name] for name in RADAR_OPTIONS if name in options}
    if radar:
        maps.append(make("radar_view", radar))
    if options.get("labels_at"):
        maps.append(MAPS["labels_at"](str(options["labels_at"])))
    if options.get("whole_bodies"):
        maps.append(MAPS["whole_bodies"]())
    if options.get("rotate_deg"):
        maps.append(MAPS["move"].turned(options["rotate_deg"]))
    return maps


def recipe_of_experiment(data: Mapping[str, Any]) -> dict[str, Any]:
    """The recipe of an experiment's ``data``: its reader's options and its sweeps.

    Args:
        data: The settings as the provenance of weights holds them: ``options``, ``sweeps``.
    """
    options, count = dict(data.get("options") or {}), int(data.get("sweeps", 1))
    maps = [described(function) for function in maps_of_options(options)]
    maps += [{"name": "sweeps", "settings": {"count": count}}] if count > 1 else []
    views = ("poses", "reference", "labels_at", "whole_bodies", "rotate_deg", *RADAR_OPTIONS)
    own = {name: value for name, value in options.items() if name not in views}
    return {"format": None, "options": own, "maps": maps}


def recipe_of_provenance(provenance: Mapping[str, Any]) -> Mapping[str, Any]:
    """The recipe of the data that a detector was trained on: of its first stream, where there are several.

    Args:
        provenance: What weights hold; those of earlier versions have the experiment's options and sweeps alone.
    """
    streams = provenance.get("streams") or {}
    recipe: Mapping[str, Any] | None = next((stream.get("recipe") for stream in streams.values()), None)
    return recipe or recipe_of_experiment((provenance.get("experiment") or {}).get("data") or {})


def replay(data: Dataset, recipe: Mapping[str, Any]) -> Dataset:
    """Return the data as those of another recipe were seen.

    Its maps are applied to the reader's frames, beneath those that the data have of their own. Of two of one name the
    recipe's coordinates and radar view take the place of the data's; sweeps that are stacked already, and frames that
    are moved already, stay as they are. What a format does not offer is passed over, such as a radar's view of Cirrus.
    Frames in memory stay as they are.

    Args:
        data: Any data set; itself is returned if nothing changes.
        recipe: ``Dataset.recipe`` of other data; only its maps matter, since its options belong to its files.

    Raises:
        ConfigError: If the recipe names an unknown map or setting.
    """
    if not data.stored:
        return data
    reader = data.unwrapped
    native = [described(function) for function in reader.maps]
    own = list(data.maps[len(native) :])
    recorded = [make(entry["name"], entry["settings"]) for entry in recipe.get("maps", ())]
    fitting = [function for function in recorded if described(function) not in native and _fits(function, reader)]
    merged = _merged(own, fitting)
    if [described(function) for function in merged] == [described(function) for function in own]:
        return data
    replayed = reader
    for function in merged:
        replayed = replayed.mapped(function)
    return replayed if data.origins == tuple(range(len(reader))) else replayed.select(data.origins)


def _fits(function: FrameMap, reader: Dataset) -> bool:
    fits = getattr(function, "fits", None)
    return fits is None or bool(fits(reader))


def _merged(own: Sequence[FrameMap], recorded: Sequence[FrameMap]) -> list[FrameMap]:
    """A recipe's maps, the data's own in the place of those that do not overrule them, and what else the data have."""
    merged: list[FrameMap] = []
    for function in recorded:
        present = [other for other in own if other.name == function.name]
        overrules = bool(getattr(function, "overrules", False))
        merged += present if present and not overrules else [function]
    names = {function.name for function in recorded}
    return merged + [function for function in own if function.name not in names]


def plain(value: Any) -> Any:
    """An option as JSON takes it: paths as text, settings as mappings.

    Raises:
        ConfigError: If there is no such form.
    """
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json")
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Mapping):
        return {str(name): plain(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if value is None or isinstance(value, str | int | float | bool):
        return value
    raise ConfigError(f"Expected an option that JSON can hold, got {type(value).__name__}: {value!r}")

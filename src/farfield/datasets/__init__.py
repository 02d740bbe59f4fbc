"""Data sets: disk to :class:`Frame` and back. ``open_dataset`` recognises the format."""

import inspect
from collections.abc import Mapping as Options
from pathlib import Path
from typing import Any

import numpy as np

from farfield.datasets.base import Dataset
from farfield.datasets.formats import DATASETS, Format, dataset, find_format, looked_for, recognise
from farfield.datasets.memory import InMemory, in_memory
from farfield.errors import ConfigError, DatasetError

_EVERYWHERE = ("poses", "rotate_deg")  # options of every format

__all__ = ["DATASETS", "Dataset", "Format", "InMemory", "dataset", "in_memory", "open_dataset", "recognise"]


def open_dataset(path: Path | str, *, format: str | None = None, **options: Any) -> Dataset:
    """Open a data set; its format is recognised from what the folder holds.

    Options that decide how frames are seen become maps, see :attr:`Dataset.maps`: ``poses`` and ``rotate_deg`` for
    every format, and ``reference``, ``radar_rate``, ``radar_region``, ``radar_over``, ``labels_at``,
    ``whole_bodies`` for those that offer them.

    Args:
        path: Its root folder.
        format: One of :data:`DATASETS`; None recognises it.
        **options: ``poses``, a file or folder of poses as ``farfield odometry`` writes them; ``rotate_deg``, which
            turns every frame counter-clockwise about z (180 looks backwards); and those of the format's reader, such as
            ``mapping=`` for Cirrus and own folders.

    Raises:
        DatasetError: If the folder does not exist or nothing in it is recognised; the message lists what was looked
            for.
        ConfigError: If the format or an option is unknown.

    >>> open_dataset("Cirrus_dataset1")[0].boxes  # doctest: +SKIP
    Boxes(95: 2 large_vehicle, 1 pedestrian, 92 vehicle)
    """
    from farfield.datasets.recipes import plain

    root = Path(path).expanduser()
    if not root.is_dir():
        kind = "a file" if root.exists() else "nothing"
        raise DatasetError(f"{path}: expected a data set's folder, found {kind}.")
    if format is None:
        format = recognise(root)
        if options.get("mapping") is not None and format != "folder":  # another layout: what it is like stands there
            format = "cirrus"
    if format is None:
        looked = "".join(f"\n  {name}: {what}" for name, what in looked_for().items())
        held = sorted(entry.name for entry in root.iterdir())
        shown = ", ".join(held[:8]) + (", ..." if len(held) > 8 else "") or "nothing"
        raise DatasetError(f"{root}: recognised no data set. It holds: {shown}. {_inside(root)}Looked for:{looked}")
    reader = find_format(format).load()
    known = _checked_options(format, reader, options)
    opened = reader(root, **{name: value for name, value in options.items() if name in known})
    opened.options = {name: plain(value) for name, value in options.items() if name in known}
    return _viewed(opened, {name: value for name, value in options.items() if name not in known})


def _inside(root: Path) -> str:
    """A sentence on data sets one folder deeper."""
    folders = sorted(entry for entry in root.iterdir() if entry.is_dir())[:50]
    known = {entry.name: name for entry in folders if (name := recognise(entry)) is not None}
    shown = ", ".join(f"{entry} ({name})" for entry, name in list(known.items())[:3])
    return f"One folder deeper there is {shown}: open that. " if known else ""


def _checked_options(format: str, reader: Any, options: Options[str, Any]) -> set[str]:
    """Options that are the reader's own; the others are views, of which it must offer each."""
    parameters = [*inspect.signature(reader).parameters.values()][1:]
    if any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters):
        return set(options) - {*_EVERYWHERE, *reader.view_options}
    own = [parameter.name for parameter in parameters]
    offered = [*own, *(name for name in reader.view_options if name not in own), *_EVERYWHERE]
    unknown = [name for name in options if name not in offered]
    if unknown:
        flag = " (--columns): its files say their columns themselves" if unknown[0] == "bin_columns" else ""
        raise ConfigError(
            f"open_dataset: the {format} reader does not know the option {unknown[0]!r}{flag}; it knows "
            f"{', '.join(offered)}"
        )
    return set(own)


def _viewed(dataset: Dataset, options: Options[str, Any]) -> Dataset:
    """The data set through the maps that options stand for, less those that change nothing."""
    from farfield.datasets.maps import described, make
    from farfield.datasets.recipes import maps_of_options

    turn = options.get("rotate_deg") or 0.0
    if any(abs(abs(turn) - part * np.pi) < 1e-3 for part in (0.25, 0.5, 0.75, 1, 1.5, 2)):
        raise ConfigError(
            f"open_dataset: expected rotate_deg in degrees, got {turn:g}: radians? That is {np.rad2deg(turn):g} degrees"
        )
    reference = options.get("reference")
    if reference is not None and reference not in dataset.references:
        known = " or ".join(dataset.references)
        raise ConfigError(f"open_dataset: expected reference {known} for {dataset.name}, got {reference!r}")
    usual = [("coordinates", {"reference": own}) for own in dataset.references[:1]]
    usual += [("radar_view", {})] if "radar_rate" in dataset.view_options else []
    changes_nothing = [described(make(name, settings)) for name, settings in usual]
    for function in maps_of_options(options):
        dataset = dataset if described(function) in changes_nothing else dataset.mapped(function)
    return dataset

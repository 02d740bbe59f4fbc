"""Data sets: disk to :class:`Frame` and back. ``open_dataset`` recognises the format."""

import inspect
from collections.abc import Mapping as Options
from importlib import import_module
from pathlib import Path
from typing import Any

from farfield.datasets.base import Dataset
from farfield.errors import ConfigError, DatasetError

__all__ = ["FORMATS", "Dataset", "open_dataset", "recognise"]


FORMATS: dict[str, str] = {
    "cirrus": "farfield.datasets.cirrus:Cirrus",
    "kitti": "farfield.datasets.kitti.object:Kitti",
    "view_of_delft": "farfield.datasets.view_of_delft.reader:ViewOfDelft",
    "kitti_tracking": "farfield.datasets.kitti.tracking:KittiTracking",
    "argoverse2": "farfield.datasets.argoverse2:Argoverse2",
    "kradar": "farfield.datasets.kradar:KRadar",
    "radiate": "farfield.datasets.radiate:Radiate",
    "folder": "farfield.datasets.folder:Folder",
}
"""Readers by format, imported when they are asked for."""

_LOOKED_FOR = {
    "cirrus": "dataset<N>_gaussian/*.xyz or dataset<N>_uniform/*.xyz, or the authors' dataset/raw_data/lidar/*.xyz",
    "kitti": "training/velodyne/*.bin",
    "view_of_delft": "[lidar|radar|radar_3frames|radar_5frames]/training/velodyne/*.bin, with training/pose/*.json",
    "kitti_tracking": "training/velodyne/<sequence>/*.bin, or label_02/*.txt or label/*.txt in KITTI's tracking format",
    "argoverse2": "<log>/sensors/lidar/*.feather",
    "kradar": "<sequence>/os2-64/*.pcd, <sequence>/radar_zyx_cube/*.mat, labels <radar>_<os2-64>.txt or another part",
    "radiate": "[<sequence>/]Navtech_Polar/*.png or [<sequence>/]Navtech_Cartesian/*.png",
    "folder": "*.pcd, *.bin, *.npy, *.xyz or *.ffcloud, directly in the folder",
}


def recognise(root: Path, *, mapping: Any = None) -> str | None:
    """Name the format of a folder, or None.

    Args:
        root: The folder.
        mapping: A mapping file makes it Cirrus.
    """
    if mapping is not None:
        return "cirrus"
    from farfield.datasets.cirrus.layout import find_parts
    from farfield.datasets.cirrus.mapping import Mapping
    from farfield.datasets.cloud_files import CLOUD_SUFFIXES

    if find_parts(root, Mapping()):
        return "cirrus"
    from farfield.datasets.view_of_delft.layout import is_view_of_delft

    if is_view_of_delft(root):
        return "view_of_delft"
    bases = [root, root / "training", root / "testing"]
    if any(_has(base, "velodyne/*.bin") for base in bases):
        return "kitti"
    tracking = ("velodyne/*/*.bin", "label_02/*.txt", "label/*.txt")
    if any(_has(base, pattern) for base in bases for pattern in tracking):
        return "kitti_tracking"
    if any(_has(root, prefix + "sensors/lidar/*.feather") for prefix in ("", "*/", "*/*/")):
        return "argoverse2"
    from farfield.datasets.kradar.index import find_sequences

    if find_sequences([root]):
        return "kradar"
    if any(_has(root, f"{prefix}Navtech_{kind}/*.png") for prefix in ("", "*/") for kind in ("Polar", "Cartesian")):
        return "radiate"
    return "folder" if any(_has(root, f"*{suffix}") for suffix in CLOUD_SUFFIXES) else None


def _has(root: Path, pattern: str) -> bool:
    return next(iter(root.glob(pattern)), None) is not None


def open_dataset(path: Path | str, *, format: str | None = None, **options: Any) -> Dataset:
    """Open a data set; its format is recognised from what the folder holds.

    Options that decide how frames are seen become maps, see :attr:`Dataset.maps`: ``rotate_deg`` for every format, and
    ``reference``, ``radar_rate``, ``radar_region``, ``radar_over`` for those that offer them.

    Args:
        path: Its root folder.
        format: One of :data:`FORMATS`; None recognises it.
        **options: ``rotate_deg``, which turns every frame counter-clockwise about z (180 looks backwards), and those of
            the format's reader, such as ``mapping=`` for Cirrus.

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
    format = format or recognise(root, mapping=options.get("mapping"))
    if format is None:
        looked = "".join(f"\n  {name}: {what}" for name, what in _LOOKED_FOR.items())
        held = sorted(entry.name for entry in root.iterdir())
        shown = ", ".join(held[:8]) + (", ..." if len(held) > 8 else "") or "nothing"
        raise DatasetError(f"{root}: recognised no data set. It holds: {shown}. Looked for:{looked}")
    reader = _reader(format)
    known = _checked_options(format, reader, options)
    dataset = reader(root, **{name: value for name, value in options.items() if name in known})
    dataset.options = {name: plain(value) for name, value in options.items() if name in known}
    return _viewed(dataset, {name: value for name, value in options.items() if name not in known})


def _reader(format: str) -> Any:
    if format not in FORMATS:
        raise ConfigError(f"open_dataset: expected format to be one of {', '.join(FORMATS)}; got {format!r}")
    module, _, name = FORMATS[format].partition(":")
    return getattr(import_module(module), name)


def _checked_options(format: str, reader: Any, options: Options[str, Any]) -> set[str]:
    """Options that are the reader's own; the others are views, of which it must offer each."""
    parameters = [*inspect.signature(reader).parameters.values()][1:]
    if any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters):
        return set(options) - {"rotate_deg", *reader.view_options}
    own = [parameter.name for parameter in parameters]
    offered = [*own, *(name for name in reader.view_options if name not in own), "rotate_deg"]
    unknown = [name for name in options if name not in offered]
    if unknown:
        raise ConfigError(
            f"open_dataset: the {format} reader does not know the option {unknown[0]!r}; it knows {', '.join(offered)}"
        )
    return set(own)


def _viewed(dataset: Dataset, options: Options[str, Any]) -> Dataset:
    """The data set through the maps that options stand for, less those that change nothing."""
    from farfield.datasets.maps import described, make
    from farfield.datasets.recipes import maps_of_options

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

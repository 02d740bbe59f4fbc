"""Data sets: disk to :class:`Frame` and back. ``open_dataset`` recognises the format."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from farfield.datasets.base import Dataset
from farfield.errors import ConfigError, DatasetError

__all__ = ["FORMATS", "Dataset", "open_dataset", "recognise"]


def _cirrus(root: Path, **options: Any) -> Dataset:
    from farfield.datasets.cirrus import Cirrus

    return Cirrus(root, **options)


def _kitti(root: Path, **options: Any) -> Dataset:
    from farfield.datasets.kitti.object import Kitti

    return Kitti(root, **options)


def _view_of_delft(root: Path, **options: Any) -> Dataset:
    from farfield.datasets.view_of_delft.reader import ViewOfDelft

    return ViewOfDelft(root, **options)


def _kitti_tracking(root: Path, **options: Any) -> Dataset:
    from farfield.datasets.kitti.tracking import KittiTracking

    return KittiTracking(root, **options)


def _argoverse2(root: Path, **options: Any) -> Dataset:
    from farfield.datasets.argoverse2 import Argoverse2

    return Argoverse2(root, **options)


def _kradar(root: Path, **options: Any) -> Dataset:
    from farfield.datasets.kradar import KRadar

    return KRadar(root, **options)


def _radiate(root: Path, **options: Any) -> Dataset:
    from farfield.datasets.radiate import Radiate

    return Radiate(root, **options)


def _folder(root: Path, **options: Any) -> Dataset:
    from farfield.datasets.folder import Folder

    return Folder(root, **options)


FORMATS: dict[str, Callable[..., Dataset]] = {
    "cirrus": _cirrus,
    "kitti": _kitti,
    "view_of_delft": _view_of_delft,
    "kitti_tracking": _kitti_tracking,
    "argoverse2": _argoverse2,
    "kradar": _kradar,
    "radiate": _radiate,
    "folder": _folder,
}

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


def open_dataset(
    path: Path | str, *, format: str | None = None, rotate_deg: float | int = 0, **options: Any
) -> Dataset:
    """Open a data set; its format is recognised from what the folder holds.

    Args:
        path: Its root folder.
        format: One of :data:`FORMATS`; None recognises it.
        rotate_deg: Turn every frame counter-clockwise about z by so much; 180 looks backwards.
        **options: Passed to the format's reader, such as ``mapping=`` for Cirrus.

    Raises:
        DatasetError: If the folder does not exist or nothing in it is recognised; the message lists what was looked
            for.
        ConfigError: If the format or an option is unknown.

    >>> open_dataset("Cirrus_dataset1")[0].boxes  # doctest: +SKIP
    Boxes(95: 2 large_vehicle, 1 pedestrian, 92 vehicle)
    """
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
    if format not in FORMATS:
        raise ConfigError(f"open_dataset: expected format to be one of {', '.join(FORMATS)}; got {format!r}")
    try:
        dataset = FORMATS[format](root, **options)
    except TypeError as error:
        if "unexpected keyword argument" not in str(error):
            raise
        raise ConfigError(f"open_dataset: the {format} reader does not know an option: {error}") from error
    return dataset.turned(rotate_deg) if rotate_deg else dataset

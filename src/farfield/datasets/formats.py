"""The formats of data sets: how each is recognised, what reads it, a registry open to packages, open_dataset."""

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from farfield.datasets.base import Dataset
from farfield.datasets.class_mapping import MAPPING_NAME, maps_classes, read_class_mapping
from farfield.datasets.frame_maps import described, make
from farfield.datasets.recipes import maps_of_options, plain
from farfield.datasets.unread import advice_on, unread_files
from farfield.errors import ConfigError, DatasetError
from farfield.files.suffixes import pattern_in_any_case
from farfield.registry import PluginError, Registry


@dataclass(frozen=True, kw_only=True)
class Format:
    """One format.

    Args:
        name: Its name.
        looked_for: What it is recognised by, for people: ``"training/velodyne/*.bin"``.
        recognises: Whether a folder is of this format; quick, and true of no other format.
        reader: The :class:`~farfield.datasets.base.Dataset` subclass that reads it, or ``"module:Class"`` of it.
    """

    name: str
    looked_for: str
    recognises: Callable[[Path], bool]
    reader: Any

    def load(self) -> Any:
        """The reader, imported if need be."""
        if isinstance(self.reader, str):
            module, _, name = self.reader.partition(":")
            return getattr(import_module(module), name)
        return self.reader


def is_cirrus(root: Path) -> bool:
    """Whether a folder holds Cirrus, as published or as its authors keep it."""
    from farfield.datasets.cirrus.layout import Mapping, find_parts

    return bool(find_parts(root, Mapping()))


def is_view_of_delft(root: Path) -> bool:
    """Whether a folder holds View-of-Delft."""
    from farfield.datasets.view_of_delft.layout import is_view_of_delft as looks_like_it

    return looks_like_it(root)


def is_tj4dradset(root: Path) -> bool:
    """Whether a folder holds TJ4DRadSet's radar."""
    from farfield.datasets.kitti.object import is_tj4dradset as looks_like_it

    return looks_like_it(root)


def is_kitti(root: Path) -> bool:
    """Whether a folder holds KITTI's object benchmark."""
    return any(_has(base, "velodyne/*.bin") for base in _parts(root))


def is_kitti_tracking(root: Path) -> bool:
    """Whether a folder holds KITTI's tracking benchmark, or its labels alone."""
    patterns = ("velodyne/*/*.bin", "label_02/*.txt", "label/*.txt")
    return any(_has(base, pattern) for base in _parts(root) for pattern in patterns)


def is_kitti_raw(root: Path) -> bool:
    """Whether a folder holds drives of KITTI's raw data."""
    from farfield.datasets.kitti.raw import drives_in

    return bool(drives_in(root))


def is_argoverse2(root: Path) -> bool:
    """Whether a folder holds logs of Argoverse 2."""
    patterns = ("sensors/lidar/*.feather", "annotations.feather", "annotations_with_ego.feather")
    return any(_has(root, prefix + pattern) for prefix in ("", "*/", "*/*/") for pattern in patterns)


def is_kradar(root: Path) -> bool:
    """Whether a folder holds K-Radar or a part of it."""
    from farfield.datasets.kradar.index import find_sequences, with_disks

    return bool(find_sequences(with_disks([root])))


def is_astyx(root: Path) -> bool:
    """Whether a folder holds Astyx HiRes2019."""
    from farfield.datasets.astyx import root_of

    return root_of(root) is not None


def is_radiate(root: Path) -> bool:
    """Whether a folder holds RADIATE."""
    kinds = ("Polar", "Cartesian")
    return any(_has(root, f"{prefix}Navtech_{kind}/*.png") for prefix in ("", "*/") for kind in kinds)


def is_bags(root: Path) -> bool:
    """Whether a folder is a ROS 2 bag or holds some."""
    from farfield.files.bags import SUFFIXES, is_bag

    inside = any(is_bag(path) for path in root.iterdir() if path.is_dir())
    return is_bag(root) or any(_has(root, f"*{suffix}") for suffix in SUFFIXES) or inside


def is_sustechpoints(root: Path) -> bool:
    """Whether a folder is a scene of SUSTechPOINTS or holds some."""
    from farfield.datasets.sustechpoints import scenes

    return bool(scenes(root))


def is_cvat(root: Path) -> bool:
    """Whether a folder is a point cloud task of CVAT or holds some."""
    from farfield.datasets.cvat import tasks

    return bool(tasks(root))


def is_folder(root: Path) -> bool:
    """Whether clouds lie directly in a folder."""
    from farfield.frame.cloud import CLOUD_SUFFIXES

    return any(_has(root, f"*{suffix}") for suffix in CLOUD_SUFFIXES)


def _parts(root: Path) -> tuple[Path, ...]:
    return root, root / "training", root / "testing"


def _has(root: Path, pattern: str) -> bool:
    return next(iter(root.glob(pattern_in_any_case(pattern))), None) is not None


CIRRUS = Format(
    name="cirrus",
    looked_for="dataset<N>_gaussian/*.xyz or dataset<N>_uniform/*.xyz, or the authors' dataset/raw_data/lidar/*.xyz",
    recognises=is_cirrus,
    reader="farfield.datasets.cirrus.reader:Cirrus",
)
VIEW_OF_DELFT = Format(
    name="view_of_delft",
    looked_for="[lidar|radar|radar_3frames|radar_5frames]/training/velodyne/*.bin, with training/pose/*.json",
    recognises=is_view_of_delft,
    reader="farfield.datasets.view_of_delft.reader:ViewOfDelft",
)
TJ4DRADSET = Format(
    name="tj4dradset",
    looked_for="training/velodyne/*.bin, eight columns of which the fifth is the range",
    recognises=is_tj4dradset,
    reader="farfield.datasets.kitti.object:Tj4dRadSet",
)
KITTI = Format(
    name="kitti",
    looked_for="training/velodyne/*.bin",
    recognises=is_kitti,
    reader="farfield.datasets.kitti.object:Kitti",
)
KITTI_TRACKING = Format(
    name="kitti_tracking",
    looked_for="training/velodyne/<sequence>/*.bin, or label_02/*.txt or label/*.txt in KITTI's tracking format",
    recognises=is_kitti_tracking,
    reader="farfield.datasets.kitti.tracking:KittiTracking",
)
KITTI_RAW = Format(
    name="kitti_raw",
    looked_for="[<date>/]<drive>/velodyne_points/data/*.bin with velodyne_points/timestamps.txt",
    recognises=is_kitti_raw,
    reader="farfield.datasets.kitti.raw:KittiRaw",
)
ARGOVERSE2 = Format(
    name="argoverse2",
    looked_for="<log>/sensors/lidar/*.feather, or <log>/annotations.feather alone",
    recognises=is_argoverse2,
    reader="farfield.datasets.argoverse2:Argoverse2",
)
KRADAR = Format(
    name="kradar",
    looked_for="<sequence>/os2-64/*.pcd, <sequence>/radar_zyx_cube/*.mat, labels <radar>_<os2-64>.txt or another part",
    recognises=is_kradar,
    reader="farfield.datasets.kradar.reader:KRadar",
)
RADIATE = Format(
    name="radiate",
    looked_for="[<sequence>/]Navtech_Polar/*.png or [<sequence>/]Navtech_Cartesian/*.png",
    recognises=is_radiate,
    reader="farfield.datasets.radiate:Radiate",
)
ASTYX = Format(
    name="astyx",
    looked_for="[dataset_astyx_hires2019/]radar_6455/*.txt",
    recognises=is_astyx,
    reader="farfield.datasets.astyx:Astyx",
)
BAGS = Format(
    name="bags",
    looked_for="metadata.yaml of a ROS 2 bag, or *.mcap or *.db3 in the folder, or bags in its folders",
    recognises=is_bags,
    reader="farfield.datasets.bags.reader:Bags",
)
SUSTECHPOINTS = Format(
    name="sustechpoints",
    looked_for="[<scene>/]lidar/*.pcd, with label/ or calib/ beside it",
    recognises=is_sustechpoints,
    reader="farfield.datasets.sustechpoints:SustechPoints",
)
CVAT = Format(
    name="cvat",
    looked_for="[<task>/]annotations/*.json with point_clouds/, ann/ with pointcloud/, or tracklet_labels.xml",
    recognises=is_cvat,
    reader="farfield.datasets.cvat:Cvat",
)
FOLDER = Format(
    name="folder",
    looked_for="*.pcd, *.bin, *.npy, *.xyz or *.ffcloud, directly in the folder",
    recognises=is_folder,
    reader="farfield.datasets.folder:Folder",
)

DATASETS: Registry[Format] = Registry(
    "farfield.datasets",
    "data set format",
    {
        name: f"farfield.datasets.formats:{name.upper()}"
        for name in (
            "cirrus",
            "view_of_delft",
            "tj4dradset",
            "kitti",
            "kitti_tracking",
            "kitti_raw",
            "argoverse2",
            "kradar",
            "radiate",
            "astyx",
            "bags",
            "sustechpoints",
            "cvat",
            "folder",
        )
    },
)
"""Formats by name, in the order in which folders are tried; those of other packages come before ``folder``."""


def dataset(name: str) -> Callable[[Any], Any]:
    """Register a :class:`~farfield.datasets.base.Dataset` subclass as a format of this process, as a decorator.

    The class says what it is recognised by: ``looked_for``, a text, and ``recognises(root)``, a static method.

    Args:
        name: The format's name.

    Raises:
        ConfigError: If the name is built in, or the class lacks one of the two.
    """
    return _Register(name)


class _Register:
    def __init__(self, name: str) -> None:
        self.name = name

    def __call__(self, reader: Any) -> Any:
        DATASETS.register(self.name)(format_of(self.name, reader))
        return reader


def format_of(name: str, registered: Any) -> Format:
    """What a package registered as a format: a :class:`Format`, or a reader class that describes itself.

    Raises:
        ConfigError: If it is neither.
    """
    if isinstance(registered, Format):
        return registered
    looked_for, recognises = getattr(registered, "looked_for", None), getattr(registered, "recognises", None)
    if not (isinstance(looked_for, str) and callable(recognises)):
        raise ConfigError(
            f"data set format {name!r}: expected a Format, or a Dataset class with looked_for and "
            f"recognises(root); got {registered!r}"
        )
    return Format(name=name, looked_for=looked_for, recognises=recognises, reader=registered)


def find_format(name: str) -> Format:
    """The format of a name.

    Raises:
        ConfigError: If there is none.
        PluginError: If another package's cannot be used.
    """
    return format_of(name, DATASETS[name])


def recognise(root: Path) -> str | None:
    """Name the format of a folder, or None: built-in formats first, then those of other packages, then loose clouds."""
    for name in DATASETS.builtin:
        if name != "folder" and find_format(name).recognises(root):
            return name
    for name in DATASETS.names():
        if name not in DATASETS.builtin and _foreign(name, root):
            return name
    return "folder" if FOLDER.recognises(root) else None


def _foreign(name: str, root: Path) -> bool:
    """Whether another package's format recognises a folder; one that cannot be used, or that fails, does not."""
    try:
        return bool(find_format(name).recognises(root))
    except Exception:  # noqa: BLE001 - a fault of one package must not keep others' data from opening
        return False


def looked_for() -> dict[str, str]:
    """What each format is recognised by; of one that cannot be used, why."""
    texts = {}
    for name in DATASETS.names():
        try:
            texts[name] = find_format(name).looked_for
        except (PluginError, ConfigError) as error:
            texts[name] = f"cannot be used: {error}"
    return texts


_EVERYWHERE = ("poses", "rotate_deg")  # options of every format
_CLOUD_FLAGS = {
    "bin_columns": " (--columns): its files say their columns themselves",
    "intensity_scale": " (--intensity-scale): its format says the full scale",
    "point_times": " (--point-times): its format says what its points' times are",
}


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
            ``columns``. ``mapping`` renames the classes of every format (``classes: {Auto: vehicle}``; without it
            ``mapping.yaml`` in the root, where it is such a file), or describes a Cirrus layout.

    Raises:
        DatasetError: If the folder does not exist or nothing in it is recognised; the message lists what was looked
            for.
        ConfigError: If the format or an option is unknown.

    >>> open_dataset("Cirrus_dataset1")[0].boxes  # doctest: +SKIP
    Boxes(95: 2 large_vehicle, 1 pedestrian, 92 vehicle)
    """
    root = Path(path).expanduser()
    if not root.is_dir():
        raise DatasetError(f"{path}: expected a data set's folder, found {_no_folder(root)}.")
    recognised = format or recognise(root)
    classes, options = _class_mapping(root, recognised, options)
    if format is None:
        format = recognised
        if options.get("mapping") is not None and format != "folder":  # another layout: what it is like stands there
            format = "cirrus"
    if format is None:
        looked = "".join(f"\n  {name}: {what}" for name, what in looked_for().items())
        held = sorted(entry.name for entry in root.iterdir())
        shown = ", ".join(held[:8]) + (", ..." if len(held) > 8 else "") or "nothing"
        hints = _unread(root) + _inside(root)
        raise DatasetError(f"{root}: recognised no data set. It holds: {shown}. {hints}Looked for:{looked}")
    reader = find_format(format).load()
    own = _checked_options(format, reader, options)
    opened = reader(root, **{name: value for name, value in options.items() if name in own})
    opened.options = {name: plain(value) for name, value in options.items() if name in own}
    opened = opened if not classes else opened.mapped(make("classes", {"classes": classes}))
    return _viewed(opened, {name: value for name, value in options.items() if name not in own})


def _class_mapping(
    root: Path, format: str | None, options: Mapping[str, Any]
) -> tuple[Mapping[str, str], dict[str, Any]]:
    """The classes of a mapping for any format, given or beside the data, and the options less that mapping.

    Own folders read it themselves; a mapping of a Cirrus layout stays an option.
    """
    mapping = options.get("mapping")
    if format in (None, "folder") or not (mapping is None or isinstance(mapping, str | Path)):
        return {}, dict(options)
    beside = root / MAPPING_NAME
    path = Path(mapping) if mapping is not None else beside if beside.is_file() else None
    beside_others = mapping is None and format != "cirrus"  # which has a mapping of another kind
    if path is None or not (beside_others or maps_classes(path)):
        return {}, dict(options)
    return read_class_mapping(path), {name: value for name, value in options.items() if name != "mapping"}


def _no_folder(root: Path) -> str:
    """What stands where a folder should, and what to do."""
    if root.is_symlink() and not root.exists():
        return f"a link to {root.readlink()}, which is not there or leads in a circle"
    if not root.exists():
        return "nothing"
    from farfield.files.bags import SUFFIXES
    from farfield.frame.cloud import CLOUD_SUFFIXES

    if root.suffix.lower() in (*SUFFIXES, *CLOUD_SUFFIXES):
        return f"one file. Name the folder that holds it: {root.parent}"
    advice = advice_on(root)
    return f"a file ({advice})" if advice else "a file"


def _unread(root: Path) -> str:
    """Sentences on files that no reader takes."""
    texts = unread_files(root)
    links = [entry for entry in root.iterdir() if entry.is_symlink() and not entry.exists()]
    if links:
        texts = (*texts, f"{links[0].name} is a link to {links[0].readlink()}, which is not there")
    return "".join(f"{text}. " for text in texts)


def _inside(root: Path) -> str:
    """A sentence on data sets one folder deeper."""
    folders = sorted(entry for entry in root.iterdir() if entry.is_dir())[:50]
    format_of_folder = {entry.name: name for entry in folders if (name := recognise(entry)) is not None}
    shown = ", ".join(f"{entry} ({name})" for entry, name in list(format_of_folder.items())[:3])
    return f"One folder deeper there is {shown}: open that. " if format_of_folder else ""


def _checked_options(format: str, reader: Any, options: Mapping[str, Any]) -> set[str]:
    """Options that are the reader's own; the others are views, of which it must offer each."""
    own = _parameters(reader)
    if own is None:
        return set(options) - {*_EVERYWHERE, *reader.view_options}
    offered = [*own, *(name for name in reader.view_options if name not in own), *_EVERYWHERE]
    unknown = [name for name in options if name not in offered]
    if unknown:
        flag = _CLOUD_FLAGS.get(unknown[0], "")
        raise ConfigError(
            f"open_dataset: the {format} reader does not know the option {unknown[0]!r}{flag}; it knows "
            f"{', '.join(offered)}"
        )
    return set(own)


def _parameters(reader: Any) -> list[str] | None:
    """The options of a reader's own; None where it takes any."""
    parameters = [*inspect.signature(reader).parameters.values()][1:]
    if any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters):
        return None
    return [parameter.name for parameter in parameters]


def known_options(path: Path | str, options: Iterable[str]) -> set[str]:
    """Those of some options of :func:`open_dataset` that a data set's format knows; all where it is not recognised."""
    root = Path(path).expanduser()
    format = recognise(root) if root.is_dir() else None
    reader = None if format is None else find_format(format).load()
    own = None if reader is None else _parameters(reader)
    if reader is None or own is None:
        return set(options)
    return set(options) & {*own, *reader.view_options, *_EVERYWHERE, "mapping"}


def _viewed(data: Dataset, options: Mapping[str, Any]) -> Dataset:
    """The data set through the maps that options stand for, less those that change nothing."""
    if not options:
        return data
    turn = options.get("rotate_deg") or 0.0
    if any(abs(abs(turn) - part * np.pi) < 1e-3 for part in (0.25, 0.5, 0.75, 1, 1.5, 2)):
        raise ConfigError(
            f"open_dataset: expected rotate_deg in degrees, got {turn:g}: radians? That is {np.rad2deg(turn):g} degrees"
        )
    reference = options.get("reference")
    if reference is not None and reference not in data.references:
        offered = " or ".join(data.references)
        raise ConfigError(f"open_dataset: expected reference {offered} for {data.name}, got {reference!r}")
    usual = [("coordinates", {"reference": own}) for own in data.references[:1]]
    usual += [("radar_view", {})] if "radar_rate" in data.view_options else []
    changes_nothing = [described(make(name, settings)) for name, settings in usual]
    for function in maps_of_options(options):
        data = data if described(function) in changes_nothing else data.mapped(function)
    return data

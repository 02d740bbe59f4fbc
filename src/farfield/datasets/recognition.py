"""Which format a folder is of: quick, by names and first bytes, without the extras that readers need.

A function that names no more than patterns stands here; one that knows its reader's layout stands beside the reader,
and the format's entry names it as ``"module:function"``.
"""

from itertools import islice
from pathlib import Path

from farfield.datasets.formats import DATASETS, find_format
from farfield.datasets.listing import ListedPath, listed_once
from farfield.files.remote_paths import RemotePath
from farfield.files.suffixes import pattern_in_any_case

_LABELS_LOOKED_AT, _LINE_BYTES = 20, 1000  # files of which one has a line; of a label


def recognise(root: Path) -> str | None:
    """Name the format of a folder, or None: built-in formats first, then those of other packages, then loose clouds.

    Formats ask one after another; a folder is listed once for all of them.
    """
    with listed_once():
        root = root if isinstance(root, RemotePath) else ListedPath(root)
        for name in DATASETS.builtin:
            if name != "folder" and find_format(name).matches(root):
                return name
        for name in DATASETS.names():
            if name not in DATASETS.builtin and _foreign(name, root):
                return name
        return "folder" if find_format("folder").matches(root) else None


def _foreign(name: str, root: Path) -> bool:
    """Whether another package's format recognises a folder; one that cannot be used, or that fails, does not."""
    try:
        return bool(find_format(name).matches(root))
    except Exception:  # noqa: BLE001 - a fault of one package must not keep others' data from opening
        return False


def is_cirrus(root: Path) -> bool:
    """Whether a folder holds Cirrus, as published or as its authors keep it."""
    from farfield.datasets.cirrus.layout import Mapping, find_parts

    return bool(find_parts(root, Mapping()))


def is_kitti(root: Path) -> bool:
    """Whether a folder holds KITTI's object benchmark."""
    return any(holds(base, "velodyne/*.bin") for base in _parts(root))


def is_kitti_tracking(root: Path) -> bool:
    """Whether a folder holds KITTI's tracking benchmark, or its labels alone."""
    if any(holds(base, "velodyne/*/*.bin") for base in _parts(root)):
        return True
    labels = ("label_02", "label")
    return any(_are_tracks(base / folder) for base in _parts(root) for folder in labels if (base / folder).is_dir())


def _are_tracks(folder: Path) -> bool:
    """Whether the first line of some text file is KITTI's of a tracked object: frame, track, class and 14 numbers."""
    for path in islice(folder.glob(pattern_in_any_case("*.txt")), _LABELS_LOOKED_AT):
        try:
            with path.open("rb") as file:
                words = file.readline(_LINE_BYTES).split()
        except OSError:
            continue
        if words:
            return len(words) in (17, 18) and all(word.lstrip(b"-").isdigit() for word in words[:2])
    return False


def is_kitti_raw(root: Path) -> bool:
    """Whether a folder holds drives of KITTI's raw data."""
    from farfield.datasets.kitti.raw import drives_in

    return bool(drives_in(root))


def is_argoverse2(root: Path) -> bool:
    """Whether a folder holds logs of Argoverse 2."""
    patterns = ("sensors/lidar/*.feather", "annotations.feather", "annotations_with_ego.feather")
    return any(holds(root, prefix + pattern) for prefix in ("", "*/", "*/*/") for pattern in patterns)


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
    return any(holds(root, f"{prefix}Navtech_{kind}/*.png") for prefix in ("", "*/") for kind in kinds)


def is_pandaset(root: Path) -> bool:
    """Whether a folder holds scenes of PandaSet."""
    from farfield.datasets.pandaset import scenes_in

    return any(holds(root, f"{prefix}lidar/poses.json") for prefix in ("", "*/")) and bool(scenes_in(root))


def is_waymo(root: Path) -> bool:
    """Whether a folder holds components of the Waymo Open Dataset v2."""
    from farfield.datasets.waymo import PARTS, segments_in

    return any(holds(root / part, "vehicle_pose/*.parquet") for part in ("", *PARTS)) and bool(segments_in(root))


def is_zod(root: Path) -> bool:
    """Whether a folder holds single frames of the Zenseact Open Dataset."""
    from farfield.datasets.zod import folders_in

    patterns = ("single_frames/*/lidar_velodyne/*.npy", "*/lidar_velodyne/*.npy", "lidar_velodyne/*.npy")
    return any(holds(root, pattern) for pattern in patterns) and bool(folders_in(root))


def is_bags(root: Path) -> bool:
    """Whether a folder is a ROS 2 bag or holds bags of ROS 2 or ROS 1."""
    from farfield.files.bags import FILE_SUFFIXES, is_bag

    inside = any(is_bag(path) for path in root.iterdir() if path.is_dir())
    return is_bag(root) or any(holds(root, f"*{suffix}") for suffix in FILE_SUFFIXES) or inside


def is_ouster(root: Path) -> bool:
    """Whether a folder holds captures of an Ouster with their metadata."""
    if not holds(root, "*.pcap"):
        return False
    from farfield.datasets.ouster import captures_in

    return bool(captures_in(root))


def is_osf(root: Path) -> bool:
    """Whether a folder holds recordings of Ouster's tools."""
    if not holds(root, "*.osf"):
        return False
    from farfield.datasets.osf import recordings_in

    return bool(recordings_in(root))


def is_captures(root: Path) -> bool:
    """Whether a folder holds captures of a Velodyne or a Hesai."""
    if not (holds(root, "*.pcap") or holds(root, "*.pcapng")):
        return False
    from farfield.datasets.captures import holds_sensor

    return holds_sensor(root)


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

    return any(holds(root, f"*{suffix}") for suffix in CLOUD_SUFFIXES)


def _parts(root: Path) -> tuple[Path, ...]:
    return root, root / "training", root / "testing"


def holds(root: Path, pattern: str) -> bool:
    """Whether a folder holds a file of a pattern, its suffix in either case."""
    return next(iter(root.glob(pattern_in_any_case(pattern))), None) is not None

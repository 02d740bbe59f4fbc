"""Where View-of-Delft keeps what: one KITTI-like tree a sensor, and the clips that its frames come from."""

from itertools import islice
from pathlib import Path

from farfield.files.suffixes import any_case

CLOUDS = ("lidar", "radar", "radar_3frames", "radar_5frames")
"""Folders of the data set's root. Images, labels and poses of the radars' folders are links into ``lidar``."""

LIDAR_COLUMNS, RADAR_COLUMNS = 4, 7
PARTS = ("training", "testing")

CLIPS: dict[str, tuple[int, int, str]] = {  # first frame, last frame, official part ("Sensors and Data", Scenes)
    "delft_1": (0, 543, "val"),
    "delft_2": (544, 1311, "train"),
    "delft_3": (1312, 1802, "train"),
    "delft_4": (1803, 2199, "train"),
    "delft_6": (2200, 2531, "train"),
    "delft_7": (2532, 2797, "test"),
    "delft_8": (2798, 3276, "test"),
    "delft_9": (3277, 3574, "train"),
    "delft_10": (3575, 3609, "val"),
    "delft_11": (3610, 4047, "train"),
    "delft_12": (4049, 4386, "train"),
    "delft_13": (4387, 4651, "train"),
    "delft_14": (4652, 5085, "val"),
    "delft_16": (6334, 6570, "test"),
    "delft_18": (6571, 6758, "test"),
    "delft_19": (6759, 7542, "train"),
    "delft_20": (7543, 7899, "test"),
    "delft_21": (7900, 8197, "test"),
    "delft_22": (8198, 8480, "val"),
    "delft_23": (8481, 8748, "train"),
    "delft_24": (8749, 9095, "train"),
    "delft_25": (9096, 9517, "test"),
    "delft_26": (9518, 9775, "train"),
    "delft_27": (9776, 9930, "train"),
}


def clip_of(frame_id: str) -> str | None:
    """Name the clip of a frame, None for what is in no clip.

    >>> clip_of("00549"), clip_of("06000")
    ('delft_2', None)
    """
    if not (frame_id.isascii() and frame_id.isdigit()):
        return None
    number = int(frame_id)
    return next((name for name, (first, last, _) in CLIPS.items() if first <= number <= last), None)


def find_trees(root: Path, part: str = "training") -> dict[str, Path]:
    """Folders with ``velodyne`` and its companions, by cloud name.

    Args:
        root: The data set's root, one of its folders, or that folder's ``training`` or ``testing``.
        part: ``"training"`` or ``"testing"``.
    """
    trees = {name: folder for name in CLOUDS if (folder := _tree(root / name, part)) is not None}
    if trees:
        return trees
    alone = _tree(root, part)
    return {} if alone is None else {_cloud_of(root, alone): alone}


def is_view_of_delft(root: Path) -> bool:
    """Whether a folder is View-of-Delft and no KITTI.

    It is where a sensor's folder holds KITTI's tree, where poses in JSON stand beside the clouds, or where the clouds
    are rows of seven numbers, which KITTI's are not.
    """
    for part in PARTS:
        trees = find_trees(root, part)
        if trees and trees != {"lidar": root / part} and trees != {"lidar": root}:
            return True
        if any(_first(tree / "pose", "*" + any_case(".json")) for tree in trees.values()):
            return True
    return False


def _tree(folder: Path, part: str) -> Path | None:
    folders = (folder / part, folder)
    return next((candidate for candidate in folders if _first(candidate / "velodyne", "*" + any_case(".bin"))), None)


def _cloud_of(root: Path, tree: Path) -> str:
    """Name the cloud of a folder opened by itself: by the bytes of its points, then by its name."""
    names = (tree.name, root.name, root.resolve().name, tree.resolve().parent.name)
    sizes = [path.stat().st_size for path in islice(sorted((tree / "velodyne").glob("*" + any_case(".bin"))), 16)]
    if any(size % (4 * RADAR_COLUMNS) for size in sizes):
        return "lidar"
    if any(size % (4 * LIDAR_COLUMNS) for size in sizes):
        return next((name for name in names if name in CLOUDS and name != "lidar"), "radar")
    return next((name for name in names if name in CLOUDS), "lidar")


def _first(folder: Path, pattern: str) -> bool:
    return next(iter(folder.glob(pattern)), None) is not None

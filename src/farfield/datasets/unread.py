"""Files that no reader takes: by their suffix what each is, and how it becomes something that is read."""

from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from farfield.files.bags import TO_ROS2
from farfield.files.stand_ins import UNFINISHED

_UNPACK = "an archive: unpack it"
_ADVICE = {
    ".ply": "PLY clouds: write .pcd, such as with pcl_ply2pcd IN.ply OUT.pcd, or with open3d.io.read_point_cloud and "
    "write_point_cloud",
    ".las": "LAS clouds: pdal translate IN.las OUT.pcd",
    ".laz": "LAZ clouds: pdal translate IN.laz OUT.pcd",
    ".e57": "E57 clouds: pdal translate IN.e57 OUT.pcd",
    ".pcap": "captured packets: the sensor's own tool writes .pcd, or its driver a ROS 2 bag",
    ".bag": f"ROS 1 bags: {TO_ROS2} (pip install rosbags)",
    ".tfrecord": "TFRecords: write .pcd or .npy with TensorFlow",
    **dict.fromkeys((".zip", ".tar", ".tgz", ".gz", ".bz2", ".xz", ".7z", ".rar", ".zst"), _UNPACK),
    **dict.fromkeys(UNFINISHED, "a download or copy that has not ended: fetch it anew"),
}


def advice_on(path: Path) -> str:
    """What a file is that no reader takes, and what to do; empty where nothing is known of its suffix."""
    return _ADVICE.get(path.suffix.lower(), "")


def unread_files(root: Path) -> tuple[str, ...]:
    """A sentence for each kind of file in a folder that no reader takes though it may hold data."""
    return tuple(sentences(path for path in root.iterdir() if not path.name.startswith(".")))


def sentences(paths: Iterable[Path]) -> list[str]:
    """A sentence for each kind among some files."""
    counts = Counter(path.suffix.lower() for path in paths if advice_on(path) and not path.is_dir())
    return [
        f"{count} file{'' if count == 1 else 's'} *{suffix} not read ({_ADVICE[suffix]})"
        for suffix, count in sorted(counts.items())
    ]

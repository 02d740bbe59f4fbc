"""Files that no reader takes: by their suffix what each is, and how it becomes something that is read."""

from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from farfield.files.stand_ins import UNFINISHED
from farfield.vocabulary.counts import count_of

_UNPACK = "an archive: unpack it"
_CAPTURES = (
    "captured packets: read are an Ouster's with the sensor's metadata beside them (NAME.json), a Velodyne's, and a "
    "Hesai's with its unit's angles (NAME.csv); of others the sensor's own tool writes .pcd, or its driver a ROS 2 bag"
)
_ADVICE = {
    ".e57": "E57 clouds: pdal translate IN.e57 OUT.pcd",
    **dict.fromkeys((".pcap", ".pcapng"), _CAPTURES),
    ".active": "a bag of ROS 1 whose recorder was killed: rosbag reindex FILE.bag.active, then name it FILE.bag",
    ".tfrecord": "TFRecords: write .pcd or .npy with TensorFlow",
    **dict.fromkeys((".zip", ".tar", ".tgz", ".gz", ".bz2", ".xz", ".7z", ".rar", ".zst"), _UNPACK),
    **dict.fromkeys(UNFINISHED, "a download or copy that has not ended: fetch it anew"),
}


def advice_on(path: Path) -> str:
    """What a file is that no reader takes, and what to do; empty where nothing is known of its suffix."""
    return _ADVICE.get(path.suffix.lower(), "")


def unread_files(root: Path, read: Iterable[Path] = ()) -> tuple[str, ...]:
    """A sentence for each kind of file in a folder that no reader takes though it may hold data.

    Args:
        root: The folder.
        read: Files of the kinds that its reader takes.
    """
    taken = {path.suffix.lower() for path in read}
    others = (path for path in root.iterdir() if not path.name.startswith(".") and path.suffix.lower() not in taken)
    return tuple(sentences(others))


def sentences(paths: Iterable[Path]) -> list[str]:
    """A sentence for each kind among some files."""
    counts = Counter(path.suffix.lower() for path in paths if advice_on(path) and not path.is_dir())
    return [
        f"{count_of(count, 'file')} *{suffix} not read ({_ADVICE[suffix]})" for suffix, count in sorted(counts.items())
    ]

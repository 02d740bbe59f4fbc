"""Lists of stamps, logs of clocks, films and ROS 2 bags for fuzz_readers.py."""

from collections.abc import Callable
from fractions import Fraction
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from farfield.files.bags import Bag
from farfield.files.clock_logs import read_clock_log
from farfield.files.sensor_messages import read_points
from farfield.files.stamps import read_stamps, recognise_stamps
from farfield.files.videos import film_frames, read_film, write_film

Recipe = tuple[str, Callable[[Path], Any], tuple[bytes, ...], Callable[[Any], bool], tuple[bytes, ...]]
LISTS = (
    b"1574859771.744660272\n1574859771.5\n" * 4,
    b"1574859771744660272\n" * 5,
    b"frame,time_us\n0,1574859771744660\n1,1574859771844660\n",
    b"2011-09-26 13:02:25.964389445\n2011-09-26 13:02:26\n",
    b"Frame: 000001 Time: 1574859771.744660272\nFrame: 000002 Time: 1574859771.977525228\n",
)
LOGS = (
    b"ptp4l[85.240]: master offset      -1200 s0 freq   +1234 path delay      5671\n"
    b"ptp4l[86.240]: master offset        -23 s2 freq   +1250 path delay       567\n",
    b"phc2sys[12.500]: CLOCK_REALTIME rms  12 max   34 freq  -123 +/-   4 delay   567 +/-   8\n",
)


def time_targets(folder: Path) -> dict[str, Recipe]:
    """By reader: suffix, reader, good files, whether a result is valid, and files that must be refused as they are."""
    found: dict[str, Recipe] = {
        "stamps": (".txt", stamps, LISTS, whole_numbers, ()),
        "clock logs": (".log", read_clock_log, LOGS, len, ()),
    }
    if find_spec("av") is not None:
        found["films"] = (".mp4", film_pictures, film_seeds(folder), finite_counts, ())
    if find_spec("rosbags") is not None:
        for suffix in (".mcap", ".db3"):
            found[f"bag{suffix}"] = (suffix, messages, bag_seeds(folder, suffix), finite_counts, ())
    return found


def stamps(path: Path) -> np.ndarray:
    """All stamps of a list; none where it is not recognised."""
    known = recognise_stamps(path)
    return np.concatenate([np.zeros(0, np.int64), *([] if known is None else read_stamps(known))])


def whole_numbers(values: np.ndarray) -> bool:
    return values.dtype == np.int64 and bool((np.abs(values) < 5 * 10**18).all())


def messages(path: Path) -> list[int]:
    """Points of each cloud of a bag, all of whose messages are decoded."""
    bag, found = Bag(path), []
    try:
        for topic, _, raw in bag.messages():
            message = bag.decode(topic, raw)
            if topic.kind == "sensor_msgs/msg/PointCloud2":
                found.append(len(next(iter(read_points(message, path).values()), ())))
    finally:
        bag.close()
    return found


def film_pictures(path: Path) -> list[int]:
    """Mean of each frame of a film, all of which are decoded."""
    return [int(picture.mean()) for picture in film_frames(read_film(path))]


def film_seeds(folder: Path) -> tuple[bytes, ...]:
    """Two small films."""
    rng, made = np.random.default_rng(2), []
    for suffix in (".mp4", ".mkv"):
        pictures = iter(rng.integers(0, 256, (6, 32, 48, 3), dtype=np.uint8))
        write_film(folder / f"film{suffix}", pictures, range(0, 600, 100), Fraction(1, 1000))
        made.append((folder / f"film{suffix}").read_bytes())
    return tuple(made)


def finite_counts(counts: list[int]) -> bool:
    return all(count >= 0 for count in counts)


def bag_seeds(folder: Path, suffix: str) -> tuple[bytes, ...]:
    """Small bags with three clouds and their stamps, as rosbags writes them; MCAP also with packed chunks."""
    return tuple(_bag_seed(folder, suffix, packed) for packed in ((False, True) if suffix == ".mcap" else (False,)))


def _bag_seed(folder: Path, suffix: str, packed: bool) -> bytes:
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types, kind = store.types, "sensor_msgs/msg/PointCloud2"
    plugin = StoragePlugin.MCAP if suffix == ".mcap" else StoragePlugin.SQLITE3
    place = folder / f"bag{suffix[1:]}{'-packed' if packed else ''}"
    if not place.exists():
        bag = Writer(place, version=9, storage_plugin=plugin)
        bag.set_compression(CompressionMode.STORAGE if packed else CompressionMode.NONE, CompressionFormat.ZSTD)
        with bag as writer:
            connection = writer.add_connection("/points", kind, typestore=store)
            for number in range(3):
                stamp = types["builtin_interfaces/msg/Time"](sec=1_700_000_000 + number, nanosec=5)
                field = types["sensor_msgs/msg/PointField"]
                cloud = types[kind](
                    header=types["std_msgs/msg/Header"](stamp=stamp, frame_id="lidar"),
                    height=1,
                    width=10,
                    fields=[field(name=n, offset=4 * k, datatype=7, count=1) for k, n in enumerate("xyz")],
                    is_bigendian=False,
                    point_step=12,
                    row_step=120,
                    data=np.arange(120, dtype=np.uint8),
                    is_dense=True,
                )
                writer.write(connection, 1_700_000_000_000_000_000 + number, store.serialize_cdr(cloud, kind))
    return (place / f"{place.name}{suffix}").read_bytes()

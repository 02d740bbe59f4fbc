"""Writing ROS 2 bags (MCAP) file by file: each appears whole, and ``metadata.yaml``, which makes them a bag, last."""

import shutil
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from farfield.errors import MissingExtraError
from farfield.files.atomic import write_text
from farfield.files.ros_messages import store

_VERSION = 9


def write_bag_part(
    path: Path, kinds: Mapping[str, str], messages: Iterable[tuple[str, int, bytes]], staging: Path
) -> dict[str, Any]:
    """Write one file of a bag; chunks of about a megabyte, compressed with zstd.

    Args:
        path: The file, ``.mcap``; its folder is made.
        kinds: Type of the messages of each topic; every file of a bag names the same.
        messages: Topic, time of recording, and bytes (CDR), by time of recording.
        staging: Folder that is made, and removed when it is done or fails.

    Returns:
        What :func:`write_bag_metadata` needs to know of it, as JSON takes it.

    Raises:
        MissingExtraError: If rosbags is not installed.
    """
    try:
        from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    except ImportError as error:
        raise MissingExtraError("rosbags", "bags", "Writing ROS 2 bags") from error
    shutil.rmtree(staging, ignore_errors=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    counts, first_ns, last_ns = dict.fromkeys(kinds, 0), None, 0
    try:
        writer = Writer(staging / path.stem, version=_VERSION, storage_plugin=StoragePlugin.MCAP)
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with writer:
            connections = {
                topic: writer.add_connection(topic, kind, typestore=store()) for topic, kind in kinds.items()
            }
            for topic, log_ns, raw in messages:
                writer.write(connections[topic], log_ns, raw)
                counts[topic] += 1
                first_ns, last_ns = log_ns if first_ns is None else first_ns, log_ns
        (staging / path.stem / path.name).replace(path)
    finally:
        shutil.rmtree(staging, ignore_errors=True)
    return {"path": path.name, "start_ns": first_ns or 0, "end_ns": last_ns, "counts": counts}


def write_bag_metadata(folder: Path, kinds: Mapping[str, str], parts: Sequence[Mapping[str, Any]]) -> Path:
    """Write what makes a folder of files a bag.

    Args:
        folder: The bag.
        kinds: Type of the messages of each topic.
        parts: What :func:`write_bag_part` returned of each file, in order.
    """
    full = [part for part in parts if sum(part["counts"].values())]
    start_ns = min((part["start_ns"] for part in full), default=0)
    totals = {topic: sum(part["counts"][topic] for part in parts) for topic in kinds}
    files = [
        {
            "path": part["path"],
            "starting_time": {"nanoseconds_since_epoch": part["start_ns"]},
            "duration": {"nanoseconds": part["end_ns"] - part["start_ns"]},
            "message_count": sum(part["counts"].values()),
        }
        for part in parts
    ]
    topics = [
        {
            "topic_metadata": {
                "name": topic,
                "type": kind,
                "serialization_format": "cdr",
                "offered_qos_profiles": [],
                "type_description_hash": store().hash_rihs01(kind),
            },
            "message_count": totals[topic],
        }
        for topic, kind in kinds.items()
    ]
    content = {
        "version": _VERSION,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": max((part["end_ns"] for part in full), default=0) - start_ns},
        "starting_time": {"nanoseconds_since_epoch": start_ns},
        "message_count": sum(totals.values()),
        "topics_with_message_count": topics,
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [part["path"] for part in parts],
        "files": files,
        "custom_data": None,
        "ros_distro": "humble",
    }
    path = folder / "metadata.yaml"
    write_text(path, yaml.safe_dump({"rosbag2_bagfile_information": content}, sort_keys=False))
    return path

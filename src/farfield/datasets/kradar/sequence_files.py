"""Files of a whole sequence and of the whole set, made from the records of the frames that stand on disk.

They depend on nothing else: the same frames give the same bytes, whichever processes wrote them and however often a run
was broken off.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from farfield.datasets.kradar.layout import (
    CAMERAS,
    EYES,
    LIDARS,
    RESOURCES,
    SEQUENCE_SPLIT,
    SPLIT_FOLDER,
    index_name,
    is_sequence,
    is_stem,
    product_path,
)
from farfield.datasets.kradar.record import FrameRecord, read_record
from farfield.datasets.kradar.texts import (
    format_camera,
    format_odometry,
    format_radar_calibration,
    format_times,
)
from farfield.datasets.splits import deal_out
from farfield.files.atomic import write_text
from farfield.vocabulary.kradar import DESCRIPTION_ORDER, format_description

PARTS = ("train", "val", "test")


def read_records(root: Path) -> dict[str, list[FrameRecord]]:
    """Read all records below a root: by sequence in the order of their numbers, each in the order of its frames.

    Raises:
        FileFormatError: If a record is damaged.
    """
    found: dict[str, list[FrameRecord]] = {}
    folders = [folder for folder in root.iterdir() if is_sequence(folder.name)] if root.is_dir() else []
    for folder in sorted(folders, key=lambda folder: int(folder.name)):
        paths = sorted(path for path in folder.glob("frame_record/*.json") if is_stem(path.stem))
        if paths:
            found[folder.name] = [read_record(path) for path in paths]
    return found


def sequence_files(sequence: str, records: Sequence[FrameRecord]) -> dict[Path, str]:
    """Texts of one sequence by path relative to the root: description, calibrations, times, odometry."""
    first = records[0]
    texts = {
        Path(sequence, "info_calib", "calib_radar_lidar.txt"): format_radar_calibration(
            first.indices["radar"] - first.indices["os2-64"]
        )
    }
    if set(DESCRIPTION_ORDER) <= set(first.conditions):
        texts[Path(sequence, "description.txt")] = format_description(first.conditions)
    for sensor in (*LIDARS, *CAMERAS):
        times = _times(sequence, sensor, records)
        if times:
            texts[Path(sequence, "time_info", f"{sensor}.txt")] = format_times(times)
    for name, number in EYES.items():
        seen = next((record.cameras[name] for record in records if name in record.cameras), None)
        if seen is not None:
            texts[camera_path(sequence, number)] = format_camera(seen.camera(), number)
    poses = [record.pose("world_T_lidar") for record in records]
    known = [pose for pose in poses if pose is not None]
    if len(known) == len(records):
        texts[odometry_path(sequence)] = format_odometry(known)
    return texts


def camera_path(sequence: str, number: int) -> Path:
    """Calibration of one eye, relative to the root."""
    return RESOURCES / "cam_calib" / "calib_seq_v2" / f"seq_{int(sequence):02d}" / f"cam_{number}.yml"


def odometry_path(sequence: str) -> Path:
    """Poses of a sequence's labelled frames, relative to the root."""
    return RESOURCES / "odometry" / "gt" / f"gt_{int(sequence):02d}.txt"


def _times(sequence: str, sensor: str, records: Sequence[FrameRecord]) -> dict[str, int]:
    times: dict[str, int] = {}
    for record in records:
        known = record.times_ns | ({} if "os2-64" in record.times_ns else {"os2-64": record.time_ns})
        if sensor in known and index_name(sensor) in record.indices:
            times[product_path(sensor, sequence, record.indices[index_name(sensor)]).name] = known[sensor]
    return times


def quarters(stems: Mapping[str, Sequence[str]]) -> dict[str, list[tuple[str, str]]]:
    """Cut sequences as K-Radar does: four runs of (nearly) equal length, train, test, train, test.

    Neighbouring runs are the same drive 0.1 s apart, so scores on such a test part come out too good.

    Args:
        stems: Frames of each sequence in order.

    Returns:
        (sequence, frame) of the parts ``train`` and ``test``.
    """
    parts: dict[str, list[tuple[str, str]]] = {"train": [], "test": []}
    for sequence, names in stems.items():
        for quarter in range(4):
            first, last = (len(names) * number // 4 for number in (quarter, quarter + 1))
            parts["test" if quarter % 2 else "train"] += [(sequence, name) for name in names[first:last]]
    return parts


def whole_sequences(frames: Mapping[str, int], weather: Mapping[str, str]) -> dict[str, list[str]]:
    """Deal whole sequences out to train, val and test, about 70, 15 and 15 per cent of the frames of every weather.

    A weather with two sequences has none in val, one with a single sequence is in train only. If a part stays empty,
    the weather is not looked at.

    Args:
        frames: How many frames each sequence has.
        weather: Weather of each sequence, where it is known.

    Returns:
        Sequences of each part, or nothing for fewer than three sequences.
    """
    if len(frames) < len(PARTS):
        return {}
    groups: dict[str, list[str]] = {}
    for sequence in frames:
        groups.setdefault(weather.get(sequence, ""), []).append(sequence)
    parts: dict[str, list[str]] = {part: [] for part in PARTS}
    for group in groups.values():
        if len(group) < len(PARTS):
            dealt = dict(zip(("train", "test"), ([name] for name in group), strict=False))
        else:
            dealt = deal_out([name for name in group for _ in range(frames[name])], root=Path())
        for part, names in dealt.items():
            parts[part] += names
    if not all(parts.values()):
        parts = deal_out([name for name, count in frames.items() for _ in range(count)], root=Path())
    return {part: sorted(names, key=int) for part, names in parts.items()}


def write_sequence_files(root: Path) -> list[Path]:
    """Write the files of all sequences that have records, and the splits; returns what was written.

    Raises:
        FileFormatError: If a record is damaged.
    """
    records = read_records(root)
    texts: dict[Path, str] = {}
    for sequence, frames in records.items():
        texts |= sequence_files(sequence, frames)
    if records:
        parts = quarters({sequence: [record.stem for record in frames] for sequence, frames in records.items()})
        for part, keys in parts.items():
            lines = [f"{sequence},{stem}.txt" for sequence, stem in keys]
            texts[SPLIT_FOLDER / f"{part}.txt"] = "\n".join(lines)
        weather = {name: frames[0].conditions.get("weather", "") for name, frames in records.items()}
        dealt = whole_sequences({name: len(frames) for name, frames in records.items()}, weather)
        if dealt:
            texts[SEQUENCE_SPLIT] = json.dumps(dealt, indent=1) + "\n"
    for path, text in texts.items():
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        write_text(root / path, text)
    return [root / path for path in texts]

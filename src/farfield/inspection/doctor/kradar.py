"""What a K-Radar tree holds by modality and sequence, and what its annotations show of their version and units."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np

from farfield.datasets.kradar import KRadar
from farfield.datasets.kradar.index import KRadarFiles, find_file, find_labels, numbered_files, spellings
from farfield.datasets.kradar.label_table import DEFECTS, SINGLE, LabelTable, read_label_table
from farfield.datasets.kradar.layout import (
    CAMERAS,
    LABEL_TREES,
    LIDARS,
    RADAR_PRODUCTS,
    SPLIT_FOLDER,
)
from farfield.datasets.kradar.sequence import SequenceFacts
from farfield.errors import FarfieldError
from farfield.frame import Drive
from farfield.frame.provenance import is_simulated
from farfield.inspection.doctor.survey import Finding, Severity, Survey
from farfield.vocabulary.counts import count_of
from farfield.vocabulary.kradar import HOURS, MEAN_SPEEDS_KMH, SEQUENCES, UTC_OFFSET_H

_LOOK_AT = {  # defects that are left as they are; the others are read as they were meant
    "odd_size": "Look at them in the pictures; leave them out of training.",
    "doubled_track": "Two objects share a track: a tracker's scores will count one as wrong.",
    "odd_index": "Header and name disagree about the frame: trust the name, which the split files use.",
    "without_height": "They have no height and are no boxes; annotation.unboxed['from_above'] has them.",
}
_SEDAN_LENGTH_M = (3.0, 6.5)
_LEAST_BOXES = 200
_ALONG_DEG = 30.0


def check_kradar(survey: Survey, facts: dict[str, Any]) -> Iterator[Finding]:
    """Tell what is there of each modality, which annotations there are, and what is wrong with them."""
    reader = survey.dataset.unwrapped
    if not isinstance(reader, KRadar):
        return
    names = list(dict.fromkeys(survey.dataset.sequences))
    kradar_facts = facts.setdefault("kradar", {"sequences": len(names)})
    entries = [reader.entries[index] for index in dict.fromkeys(survey.dataset.origins)]
    yield from _modalities(reader, Counter(survey.dataset.sequences), names, kradar_facts)
    yield from _sequence_files(reader, names, kradar_facts)
    if not is_simulated(reader.root):  # whose clock and speed mean nothing
        yield from condition_findings(survey.dataset.drives(), _conditions(reader, names))
    yield from _versions(reader, entries, names, kradar_facts)
    table = read_label_table(entries)
    if not len(table.stem):
        return
    yield from _defects(table, kradar_facts)
    yield from _published(reader, table, kradar_facts)
    yield from _units(table, kradar_facts)


def _conditions(dataset: KRadar, names: Iterable[str]) -> dict[str, dict[str, str]]:
    conditions: dict[str, dict[str, str]] = {}
    for name in names:
        with suppress(FarfieldError):  # damaged: told where the sequence's files are
            conditions[name] = dataset.of_sequence(name).conditions
    return conditions


def _modalities(
    dataset: KRadar, frames: Mapping[str, int], names: Sequence[str], kradar_facts: dict[str, Any]
) -> Iterator[Finding]:
    kradar_facts["files"] = {}
    for product in (*RADAR_PRODUCTS, *LIDARS, *CAMERAS):
        per = {name: count for name in names if (count := _count(dataset, product, name))}
        kradar_facts["files"][product] = per
        topic = f"radar {product}" if product in RADAR_PRODUCTS else product
        if not per:
            yield Finding(severity="ok", topic=topic, what="none", absent=True)
            continue
        what = f"{count_of(sum(per.values()), 'file')} in {_share_of(per, names)}"
        short = {name: count for name, count in per.items() if count < frames[name]}
        if short:
            what += f"; fewer than frames in {_listed(short)}"
        lacks = [name for name in names if name not in per]
        what += f"; missing in {_listed(lacks)}" if lacks else ""
        fix = "Frames lack what their sequence lacks: download the rest or select() the others." if short else ""
        yield Finding(severity="warn" if short else "ok", topic=topic, what=what, fix=fix)


def _count(dataset: KRadar, product: str, sequence: str) -> int:
    examples = spellings(product, sequence, 0)
    numbers = {n for root in dataset.roots for path in examples for n in numbered_files(root / path.parent, path)}
    return len(numbers)


def _sequence_files(dataset: KRadar, names: Sequence[str], kradar_facts: dict[str, Any]) -> Iterator[Finding]:
    shared: dict[str, SequenceFacts] = {}
    for name in names:
        try:
            shared[name] = dataset.of_sequence(name)
        except FarfieldError as error:
            fix = "Fix or remove the file: no frame of the sequence can be read."
            yield Finding(severity="fail", topic="damaged", what=str(error), where=f"sequence {name}", fix=fix)
    sequences_with = {
        "description": [n for n, one in shared.items() if one.conditions_from == "description.txt"],
        "published conditions": [n for n, one in shared.items() if one.conditions_from == "published table"],
        "radar calibration": [n for n in names if dataset.calibrated(n)],
        "time files": [n for n, one in shared.items() if one.times_ns],
        "camera calibration": [n for n, one in shared.items() if one.cameras],
        "odometry": [n for n, one in shared.items() if one.poses is not None],
        "GPS": [n for n, one in shared.items() if {"gps", "gps_local"} & set(one.motion)],
        "IMU": [n for n, one in shared.items() if "imu" in one.motion],
        "dash video": [n for n, one in shared.items() if one.video is not None],
    }
    kradar_facts["sequence_files"] = sequences_with
    for topic, having in sequences_with.items():
        lacks = [name for name in names if name not in having]
        what = "none" if not having else f"in {_share_of(having, names)}"
        what += f"; missing in {_listed(lacks)}" if having and lacks else ""
        stands_in = _standing_in(topic, having, lacks)
        yield Finding(severity="ok", topic=topic, what=what + stands_in, absent=not having and not stands_in)
    described = set(sequences_with["description"]) | set(sequences_with["published conditions"])
    silent = [name for name in names if name not in described]
    if silent:
        fix = "Scores by weather leave them out. Add description.txt: road,time,weather."
        yield Finding(severity="warn", topic="conditions", what=f"unknown in {_listed(silent)}", fix=fix)
    lists = [part for part in ("train", "test") if find_file(dataset.roots, SPLIT_FOLDER / f"{part}.txt")]
    what = f"official lists {', '.join(lists)}" if lists else "no official lists: quarters are cut as they cut them"
    yield Finding(severity="ok", topic="splits", what=what)


def _standing_in(topic: str, having: Sequence[str], lacks: Sequence[str]) -> str:
    if topic == "radar calibration" and lacks:
        return "; there the published offset 2.54, -0.3, -0.7 m stands in"
    return " (the supplement's Table 5)" if topic == "published conditions" and having else ""


def _versions(
    dataset: KRadar, entries: Iterable[KRadarFiles], names: Sequence[str], kradar_facts: dict[str, Any]
) -> Iterator[Finding]:
    read = Counter(entry.version for entry in entries if entry.label is not None)
    sequences_with = {
        version: [n for n in names if find_labels(dataset.roots, n, (version,))] for version in LABEL_TREES
    }
    kradar_facts["label_versions"] = {version: len(having) for version, having in sequences_with.items()}
    shown = ", ".join(
        f"{version} in {_share_of(having, names)}" for version, having in sequences_with.items() if having
    )
    if not shown:
        yield Finding(severity="ok", topic="label versions", what="none")
        return
    used = ", ".join(f"{version} ({count_of(number, 'frame')})" for version, number in read.most_common())
    mixed = len(read) > 1
    fix = "Scores of different versions must not be mixed: give --labels or labels=." if mixed else ""
    severity: Severity = "warn" if mixed else "ok"
    yield Finding(severity=severity, topic="label versions", what=f"{shown}; read: {used}", fix=fix)


def _defects(table: LabelTable, kradar_facts: dict[str, Any]) -> Iterator[Finding]:
    kradar_facts["defects"] = dict(table.defects) | {"damaged": len(table.damaged)}
    for name, count in table.defects.items():
        if count:
            fix = _LOOK_AT.get(name, "")
            noun, _, rest = DEFECTS[name].partition(" ")
            what = f"{count_of(count, SINGLE[noun], noun)} {rest}" + ("" if fix else "; read as they are meant")
            yield Finding(severity="warn" if fix else "ok", topic="label defects", what=what, fix=fix)
    if not any(table.defects.values()):
        yield Finding(severity="ok", topic="label defects", what="none of those that K-Radar is known for")


def _published(dataset: KRadar, table: LabelTable, kradar_facts: dict[str, Any]) -> Iterator[Finding]:
    """Compare numbers of frames with the published ones, and the frames' names with the calibration."""
    frames = Counter(table.sequence.tolist())
    short = [name for name, count in frames.items() if name in SEQUENCES and count != SEQUENCES[name].frames]
    kradar_facts["as_published"] = len(frames) - len(short)
    what = f"{len(frames) - len(short)} of {count_of(len(frames), 'sequence')} have as many frames as published"
    yield Finding(severity="ok", topic="completeness", what=what + (f"; not {_listed(short)}" if short else ""))
    stems = np.array([stem.split("_") for stem in table.stem.tolist()], dtype=np.int64)
    expected = np.array([dataset.frame_difference(name) for name in table.sequence.tolist()])
    off = dict.fromkeys(table.sequence[stems[:, 0] - stems[:, 1] != expected].tolist())
    what = "the frames' names differ from it in " + _listed(off) if off else "radar minus LiDAR index is as calibrated"
    fix = "Radar and LiDAR would not be of the same moment: check info_calib." if off else ""
    yield Finding(severity="warn" if off else "ok", topic="frame difference", what=what, fix=fix)


def _units(table: LabelTable, kradar_facts: dict[str, Any]) -> Iterator[Finding]:
    """Decide half or full sizes and degrees or radians, and whether headings follow the road."""
    sedan = table.name == "Sedan"
    if sedan.sum() < _LEAST_BOXES:
        what = f"{count_of(int(sedan.sum()), 'Sedan')}: too few to decide units and yaw"
        yield Finding(severity="ok", topic="label units", what=what)
        return
    length = float(np.median(table.size_m[sedan, 0]))
    kradar_facts["median_sedan_length_m"] = round(length, 3)
    good = _SEDAN_LENGTH_M[0] <= length <= _SEDAN_LENGTH_M[1]
    what = f"half lengths: twice the median of Sedans is {length:.2f} m"
    fix = "" if good else "The files seem to hold full lengths: halve them, as K-Radar does."
    yield Finding(severity="ok" if good else "fail", topic="label units", what=what, fix=fix)
    most = float(np.abs(table.yaw_deg).max())
    kradar_facts["largest_yaw"] = round(most, 2)
    degrees = most > 2.1 * np.pi
    what = f"yaw is in degrees: the largest is {most:.1f}" if degrees else f"no yaw is beyond {most:.2f}: radians?"
    fix = "" if degrees else "K-Radar writes degrees: multiply by 180 / pi."
    yield Finding(severity="ok" if degrees else "fail", topic="label yaw", what=what, fix=fix)
    if degrees:
        yield _headings(table.yaw_deg[sedan], kradar_facts)


def _headings(yaw_deg: np.ndarray, kradar_facts: dict[str, Any]) -> Finding:
    away = np.abs(np.mod(yaw_deg + 90.0, 180.0) - 90.0)  # from the x axis, 0 to 90
    along, across = float((away < _ALONG_DEG).mean()), float((away > 90.0 - _ALONG_DEG).mean())
    kradar_facts["sedans_along_x"], kradar_facts["sedans_across_x"] = round(along, 3), round(across, 3)
    what = f"{along:.0%} of Sedans lie within {_ALONG_DEG:g} degrees of the vehicle's own axis, {across:.0%} across"
    turned = across > along
    fix = "They seem to be turned by 90 degrees: length and width, or the axis of yaw, are mixed up." if turned else ""
    return Finding(severity="fail" if turned else "ok", topic="label yaw", what=what, fix=fix)


def _share_of(having: Iterable[str], names: Sequence[str]) -> str:
    number = len(list(having))
    return (
        f"all {count_of(len(names), 'sequence')}"
        if number == len(names)
        else f"{number} of {count_of(len(names), 'sequence')}"
    )


def _listed(names: Iterable[str]) -> str:
    """Sequences as runs of numbers.

    >>> _listed(["1", "2", "3", "7"])
    'sequences 1 to 3, 7'
    """
    runs: list[list[int]] = []
    for number in sorted(map(int, names)):
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    shown = [f"{a}" if a == b else f"{a} to {b}" if b > a + 1 else f"{a}, {b}" for a, b in runs]
    single = len(runs) == 1 and runs[0][0] == runs[0][1]
    return f"sequence{'' if single else 's'} " + ", ".join(shown[:12]) + (", ..." if len(shown) > 12 else "")


# Labels of conditions held against the drive's own clock and speed (K-Radar, supplement, Table 8).


def contradictions(
    conditions: Mapping[str, str], time_ns: int | None, mean_speed_m_s: float | None
) -> Iterator[tuple[str, str]]:
    """What speaks against a drive's labels.

    Args:
        conditions: ``time`` and ``road``.
        time_ns: Unix time of the drive, if it is known.
        mean_speed_m_s: Its mean speed, if it is known.

    Yields:
        The kind of label, and what speaks against it.
    """
    label = conditions.get("time", "")
    other = {"day": "night", "night": "day"}.get(label, "")
    if other and time_ns is not None:
        local = datetime.fromtimestamp(time_ns / 1e9, UTC) + timedelta(hours=UTC_OFFSET_H)
        begin, end = HOURS[other]
        if (local.hour - begin) % 24 < (end - begin) % 24:
            yield "time", f"labelled {label}, driven at {local:%H:%M} in Korea"
    bounds = MEAN_SPEEDS_KMH.get(conditions.get("road", ""))
    if bounds and mean_speed_m_s is not None and not bounds[0] <= mean_speed_m_s * 3.6 <= bounds[1]:
        yield "road", f"labelled {conditions['road']}, driven at {mean_speed_m_s * 3.6:.0f} km/h on average"


def condition_findings(drives: Iterable[Drive], conditions: Mapping[str, Mapping[str, str]]) -> Iterator[Finding]:
    """Findings on the drives whose clock or speed contradicts their conditions.

    Args:
        drives: The drives, with times and poses where they are known.
        conditions: Of each drive by its name.
    """
    contradictions_by_kind: dict[str, list[str]] = {"time": [], "road": []}
    for drive in drives:
        times = None if drive.times_ns is None else np.asarray(drive.times_ns)
        middle = None if times is None or not len(times) else int(np.median(times))
        for kind, what in contradictions(conditions.get(drive.name, {}), middle, _mean_speed(drive)):
            contradictions_by_kind[kind].append(f"{drive.name}: {what}")
    for kind, lines in contradictions_by_kind.items():
        if lines:
            shown = "; ".join(lines[:5]) + (f"; and {len(lines) - 5} more" if len(lines) > 5 else "")
            fix = (
                "Look at its pictures: the label or the clock is wrong." if kind == "time" else "Look at its pictures."
            )
            yield Finding(severity="warn", topic=f"label of {kind}", what=shown, fix=fix)


def _mean_speed(drive: Drive) -> float | None:
    """Way over time, where poses and times are known for 5 s or more."""
    if drive.times_ns is None or drive.world_T_frame is None or len(drive.times_ns) < 2:
        return None
    lasts_s = float(drive.times_ns[-1] - drive.times_ns[0]) * 1e-9
    positions_m = np.asarray(drive.world_T_frame)[:, :3, 3]
    way_m = float(np.linalg.norm(np.diff(positions_m, axis=0), axis=1).sum())
    return way_m / lasts_s if lasts_s >= 5.0 and np.isfinite(way_m) else None

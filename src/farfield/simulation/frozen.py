"""Frozen splits: named seeds whose frames have recorded checksums.

Rays are cast in single precision, and another processor may round a hit or an exponential differently in the last bit.
So there are two verdicts. ``identical``: every point rounded to a millimetre, every intensity and every box agrees with
the recorded digest. ``equivalent``: the counts of points agree within 0.2 % and those of boxes within one.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from farfield.errors import ConfigError, DatasetError
from farfield.files.json_text import plain_json
from farfield.frame import Frame

_HOME = files("farfield.simulation")
FROZEN = tuple(sorted(file.name.removesuffix(".json") for file in _HOME.iterdir() if file.name.endswith(".json")))
"""Splits of which a record lies here: ``tools/freeze_split.py`` writes one."""
_COUNT_TOLERANCE = 0.002


@dataclass(frozen=True)
class FrozenFrame:
    """The record of one frozen frame.

    Args:
        digest: First 16 hexadecimal digits of the SHA-256 of its rounded content.
        points: Number of Gaussian and uniform points.
        boxes: Number of annotated boxes.
    """

    digest: str
    points: tuple[int, int]
    boxes: int


def frame_record(frame: Frame) -> FrozenFrame:
    """Digest and counts of a frame: coordinates to 1 mm, intensities to 1/255, boxes to 1 mm and 0.001 degrees."""
    content = hashlib.sha256(frame.frame_id.encode())
    clouds = [frame.clouds[name] for name in ("gaussian", "uniform")]
    for cloud in clouds:
        content.update(np.round(cloud.points_m.astype(np.float64) * 1000).astype("<i4").tobytes())
        if cloud.intensity is None:
            raise DatasetError(f"frame {frame.key}: expected clouds with intensities, which the digest holds; got none")
        content.update(np.round(cloud.intensity * 255).astype("<u1").tobytes())
    annotation = frame.annotation
    if annotation is None or annotation.full_boxes is None:
        raise DatasetError(f"frame {frame.key}: expected full_boxes in its annotation, which the digest holds")
    boxes = annotation.boxes
    for annotated in (boxes, annotation.full_boxes):
        rows = np.column_stack([annotated.centre_m, annotated.size_m, np.degrees(annotated.yaw_rad)])
        text = "\n".join(str(label) for label in annotated.label)
        content.update(np.round(rows * 1000).astype("<i8").tobytes() + text.encode())
    return FrozenFrame(content.hexdigest()[:16], (len(clouds[0]), len(clouds[1])), len(boxes))


def split_digest(records: Mapping[tuple[int, int], FrozenFrame]) -> str:
    """SHA-256 over all frames' digests in the order of sequence and frame."""
    lines = [f"{sequence} {index} {records[sequence, index].digest}" for sequence, index in sorted(records)]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


@cache
def frozen_records(name: str) -> dict[tuple[int, int], FrozenFrame]:
    """The recorded frames of a frozen split, by (sequence, index).

    Raises:
        ConfigError: If there is no frozen split of that name, or its file does not match its own checksum.
    """
    if name not in FROZEN:
        raise ConfigError(f"frozen split: expected one of {', '.join(FROZEN)}; got {name!r}")
    stored: dict[str, Any] = plain_json(_HOME.joinpath(f"{name}.json").read_bytes())
    records = {
        (sequence, index): FrozenFrame(digest, (gaussian, uniform), boxes)
        for sequence, index, digest, gaussian, uniform, boxes in stored["frames"]
    }
    if split_digest(records) != stored["sha256"]:
        raise ConfigError(f"{name}.json: expected checksum {stored['sha256']}, found {split_digest(records)}")
    return records


def records_json(name: str, records: Mapping[tuple[int, int], FrozenFrame]) -> str:
    """The text of a frozen split's file."""
    rows = [
        json.dumps([sequence, index, record.digest, *record.points, record.boxes])
        for (sequence, index), record in sorted(records.items())
    ]
    columns = '["sequence", "index", "digest", "gaussian_points", "uniform_points", "boxes"]'
    head = f'{{"name": "{name}", "sha256": "{split_digest(records)}",\n "columns": {columns},\n "frames": [\n  '
    return head + ",\n  ".join(rows) + "\n]}\n"


def compare(record: FrozenFrame, expected: FrozenFrame) -> str:
    """``"identical"``, ``"equivalent"`` or ``"different"``."""
    if record == expected:
        return "identical"
    close = all(
        abs(count - expected_count) <= max(3, _COUNT_TOLERANCE * expected_count)
        for count, expected_count in zip(record.points, expected.points, strict=True)
    )
    return "equivalent" if close and abs(record.boxes - expected.boxes) <= 1 else "different"

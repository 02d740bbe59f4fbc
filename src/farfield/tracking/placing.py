"""Detections placed in a data set: its drives' stamps and poses, by the frames' names."""

from collections.abc import Sequence
from dataclasses import replace

from farfield.errors import ConfigError
from farfield.frame.drive import Drive
from farfield.metrics.detections import Detections


def with_drives(found: Detections, drives: Sequence[Drive]) -> Detections:
    """Detections with the drives that hold their frames.

    Args:
        found: Detections by (sequence, frame).
        drives: The drives of a data set. Those without any of these frames are left out.

    Raises:
        ConfigError: If there are no drives, or a frame of the detections is in none.
    """
    if not drives:
        raise ConfigError(
            "data: expected drives, frames in the order of time; this data set has none. Leave --data out"
        )
    known = {key for drive in drives for key in drive.keys}
    strange = sorted(set(found.boxes) - known)
    if strange:
        example = next(iter(drives[0].keys), ("", ""))
        named = ", ".join(f"{sequence}/{frame}" for sequence, frame in strange[:3])
        raise ConfigError(
            f"data: expected the detections' frames among the data set's, whose first is {example[0]}/{example[1]}; "
            f"{len(strange)} of {len(found.boxes)} are not there: {named}. "
            "Detect on this data set, or name sequences and frames as it does"
        )
    return replace(found, drives=tuple(drive for drive in drives if not set(drive.keys).isdisjoint(found.boxes)))

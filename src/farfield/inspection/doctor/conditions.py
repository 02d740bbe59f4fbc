"""Labels of conditions held against the drive's own clock and speed (K-Radar, supplement, Table 8)."""

from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime, timedelta

import numpy as np

from farfield.frame import Drive
from farfield.inspection.doctor.findings import Finding
from farfield.vocabulary.kradar import HOURS, MEAN_SPEEDS_KMH, UTC_OFFSET_H


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
    said: dict[str, list[str]] = {"time": [], "road": []}
    for drive in drives:
        times = None if drive.times_ns is None else np.asarray(drive.times_ns)
        middle = None if times is None or not len(times) else int(np.median(times))
        for kind, what in contradictions(conditions.get(drive.name, {}), middle, _mean_speed(drive)):
            said[kind].append(f"{drive.name}: {what}")
    for kind, lines in said.items():
        if lines:
            shown = "; ".join(lines[:5]) + (f"; and {len(lines) - 5} more" if len(lines) > 5 else "")
            mend = (
                "Look at its pictures: the label or the clock is wrong." if kind == "time" else "Look at its pictures."
            )
            yield Finding(severity="warn", topic=f"label of {kind}", what=shown, mend=mend)


def _mean_speed(drive: Drive) -> float | None:
    """Way over time, where poses and times are known for 5 s or more."""
    if drive.times_ns is None or drive.world_T_frame is None or len(drive.times_ns) < 2:
        return None
    lasts_s = float(drive.times_ns[-1] - drive.times_ns[0]) * 1e-9
    places = np.asarray(drive.world_T_frame)[:, :3, 3]
    way_m = float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())
    return way_m / lasts_s if lasts_s >= 5.0 and np.isfinite(way_m) else None

"""Why a tracker gave few tracks: what its settings left out of the detections, counted."""

from collections import Counter

import numpy as np

from farfield.metrics.detections import Detections
from farfield.tracking.presets import TrackerSettings
from farfield.vocabulary.counts import count_of

FEW = 0.5
"""Where fewer of the detections than this share are in tracks, the reasons are said."""
_SLOW_S = 0.5


def reasons_for_few(detections: Detections, tracks: Detections, settings: TrackerSettings) -> tuple[str, ...]:
    """Why few detections came into tracks, the weightiest reason first; none where half of them did.

    Args:
        detections: What was tracked.
        tracks: What came of it.
        settings: The tracker's.
    """
    total, tracked = (sum(map(len, side.boxes.values())) for side in (detections, tracks))
    if not total:
        return (f"no detection in {count_of(len(detections.boxes), 'frame')}",)
    if tracked >= FEW * total:
        return ()
    reasons: list[tuple[int, str]] = []
    scores = [boxes.score for boxes in detections.boxes.values() if boxes.score is not None]
    score = np.concatenate(scores) if scores else np.zeros(0)
    for name, least in (("least_score", settings.least_score), ("strong_score", settings.strong_score)):
        below = int((score < least).sum()) if least is not None else 0
        if below:
            what = "are left out" if name == "least_score" else "begin no track"
            highest = "" if below < total else f"; the highest is {score.max():.2g}"
            reasons.append((below, f"{below} of {total} detections {what}: scores below {name}={least:g}{highest}"))
    frames = Counter(sequence for sequence, _ in detections.boxes)
    short = {name: count for name, count in frames.items() if count < settings.min_hits}
    if short:
        count = sum(len(boxes) for (sequence, _), boxes in detections.boxes.items() if sequence in short)
        advice = " (is the column sequence the same for all frames of a drive?)" if max(frames.values()) == 1 else ""
        reasons.append(
            (
                count,
                f"{len(short)} of {count_of(len(frames), 'sequence')} have fewer frames than the min_hits="
                f"{settings.min_hits} matches from which on a track is reported{advice}",
            )
        )
    gap_s = _gap_s(detections, settings)
    if gap_s > _SLOW_S:
        reasons.append(
            (total // 2, f"frames lie {gap_s:.2g} s apart: detections of one object may be farther apart than the gate")
        )
    unposed = settings.ego_motion and not any(drive.world_T_frame is not None for drive in detections.drives)
    if unposed and len(detections.boxes) > 1:
        flags = "--poses, --preset unposed" if detections.drives else "--data, --poses, --preset unposed"
        reasons.append((total // 4, f"no poses: from a moving car standing objects move in each frame ({flags})"))
    if not reasons:
        reasons.append(
            (
                0,
                f"{total - tracked} of {total} detections had fewer than min_hits={settings.min_hits} matches within "
                f"the gate (-o min_hits=..., -o gate=...; gate={settings.gate:g}, similarity {settings.similarity})",
            )
        )
    return tuple(text for _, text in sorted(reasons, key=lambda one: -one[0]))


def _gap_s(detections: Detections, settings: TrackerSettings) -> float:
    """The median time between frames."""
    times = [np.asarray(drive.times_ns, dtype=np.float64) for drive in detections.drives if drive.times_ns is not None]
    steps = np.concatenate([np.abs(np.diff(one)) for one in times]) if times else np.zeros(0)
    return float(np.median(steps)) * 1e-9 if len(steps) else settings.step_s

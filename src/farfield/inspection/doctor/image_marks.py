"""The boxes in images beside the 3D boxes: how many there are, and whether both say the same."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from farfield.errors import FarfieldError
from farfield.frame.image_marks import image_marks, projected_overlap
from farfield.inspection.doctor.survey import Finding, Survey
from farfield.vocabulary.counts import count_of

LEAST_OVERLAP = 0.5
"""Median overlap below which 2D boxes and projected 3D boxes do not belong together. It is 0.98 and 0.99 on frames of
KITTI, 0.91 on View-of-Delft and 0.94 on TJ4DRadSet, and 0.18 to 0.40 with the camera turned by 2 degrees."""
_MOST_FRAMES, _FEW = 100, 5


def check_image_marks(survey: Survey, facts: dict[str, Any]) -> Iterator[Finding]:
    """Count the boxes in images and hold them against the projected 3D boxes, by up to 100 frames that are spread.

    Args:
        survey: What was read.
        facts: What was measured is noted here.
    """
    data = survey.dataset
    count = frames = ignored = 0
    overlaps: list[np.ndarray] = []
    for index in np.unique(np.linspace(0, len(data) - 1, min(len(data), _MOST_FRAMES)).round().astype(int)).tolist():
        try:
            frame = data[index]
            marks = image_marks(frame)
            if marks is None:
                continue
            frames += 1
            count += len(marks)
            ignored += len(marks.ignored_px)
            overlaps.append(projected_overlap(frame, marks))
        except (FarfieldError, OSError, ValueError):  # said by other checks
            continue
    if not count:
        return
    overlap = np.concatenate(overlaps)
    overlap = overlap[np.isfinite(overlap)]
    median = float(np.median(overlap)) if len(overlap) else None
    facts["image boxes"] = {"frames": frames, "boxes": count, "ignored": ignored, "median_overlap": median}
    what = f"{count_of(count, 'box', 'boxes')} in the images of {count_of(frames, 'frame')}"
    what += f", {count_of(ignored, 'region')} to be ignored" if ignored else ""
    if median is None or len(overlap) < _FEW:
        yield Finding(severity="ok", topic="image boxes", what=what)
        return
    what += f"; the projected 3D boxes overlap them by {median:.2f} (median of {len(overlap)})"
    low = median < LEAST_OVERLAP
    fix = (
        f"The camera's calibration may be off, or the boxes of another camera: farfield doctor {data.root} "
        "--calibration 5 holds the picture against the points."
    )
    yield Finding(severity="warn" if low else "ok", topic="image boxes", what=what, fix=fix if low else "")

"""Detection all around by detectors that look ahead: once as a frame is, and once with it turned by half a turn."""

import numpy as np

from farfield.detectors.info import DescribedDetector, DetectorFunction, as_detector
from farfield.errors import ConfigError
from farfield.frame import Boxes, Frame, transform_frame
from farfield.geometry.iou import pairwise_iou
from farfield.geometry.poses import pose_from_yaw


def detect_around(detector: DescribedDetector | DetectorFunction, frame: Frame) -> Boxes:
    """Detect objects ahead of a sensor and behind it, each half as the detector sees what lies ahead.

    Args:
        detector: The detector.
        frame: A frame whose cloud reaches all around.

    Returns:
        Scored boxes in the frame's coordinates. Of two of a class whose footprints overlap across the halves' seam it
        is the one of the higher score.
    """
    described, half_turn = as_detector(detector), pose_from_yaw(np.pi)
    ahead, behind = described(frame), described(transform_frame(frame, half_turn))
    ahead, behind = (boxes[boxes.centre_m[:, 0] >= 0] for boxes in (ahead, behind))
    behind = behind.transform(half_turn)
    if ahead.score is None or behind.score is None:
        raise ConfigError(f"{described.info.name or 'the detector'}: expected boxes with scores, got some without")
    labels = np.asarray(ahead.label)[:, None], np.asarray(behind.label)[None]
    same = (labels[0] == labels[1]) & (pairwise_iou(ahead, behind, kind="bev") > 0)
    better = ahead.score[:, None] >= behind.score[None]
    return Boxes.concatenate([ahead[~(same & ~better).any(axis=1)], behind[~(same & better).any(axis=0)]])

"""Where a detector sees something else than the annotators did."""

from collections.abc import Iterator

from farfield.annotation.checking.contract import Boxes, CheckedFrame, CheckSettings, LabelIssue
from farfield.annotation.checking.shapes import as_set, finding
from farfield.datasets.labels import BoxLabel
from farfield.geometry.iou import pairwise_iou

MEETS_IOU = 0.05
"""Below it, a detection is of no box at all."""


def disagreements(boxes: Boxes, scene: CheckedFrame, settings: CheckSettings) -> Iterator[LabelIssue]:
    """Detections without a box, and boxes that confident detections place otherwise."""
    found = [each for each in scene.detections if each.score > settings.detector_score]
    if not found:
        return
    theirs = as_set([BoxLabel(id="", label=each.label, box=each.box) for each in found])
    iou = pairwise_iou(theirs, as_set(boxes), kind="bev")
    for number, detected in enumerate(found):
        best = int(iou[number].argmax()) if len(boxes) else -1
        shared = float(iou[number, best]) if len(boxes) else 0.0
        score = f"score {detected.score:.2f}"
        if shared < MEETS_IOU:
            yield LabelIssue(
                check="detector",
                severity="info",
                sentence=f"The detector sees a {detected.label} without a box ({score}).",
                frame=scene.key,
                box=None,
                place=(detected.box[0], detected.box[1]),
            )
        elif shared < settings.detector_iou:
            label = boxes[best]
            sentence = f"{label.label} {label.track}: the detector places it otherwise (IoU {shared:.2f}, {score})."
            yield finding(scene, label, "detector", "info", sentence)

"""Why tracks are few: the reason is counted and named."""

import numpy as np

import farfield as ff
from farfield.metrics import Detections
from farfield.tracking import PRESETS, track
from farfield.tracking.reasons import reasons_for_few


def drive(*, sequences: bool = False, score: float = 0.9, step_m: float = 0.5) -> Detections:
    boxes = {}
    for number in range(8):
        row = np.array([[20.0 + step_m * number, 0, 0, 4.0, 2.0, 1.5, 0.0]])
        key = (f"s{number}" if sequences else "s", f"{number:03d}")
        boxes[key] = ff.Boxes.from_numpy(row, label="vehicle", score=np.array([score]))
    return Detections(boxes=boxes, annotations={})


def reasons(detections: Detections, **changes: object) -> tuple[str, ...]:
    settings = PRESETS["default"].changed(**changes)
    return reasons_for_few(detections, track(detections, settings), settings)


def test_a_good_drive_has_no_reasons() -> None:
    assert reasons(drive()) == ()


def test_each_reason_is_named() -> None:
    assert "no detection in 0 frames" in reasons(Detections(boxes={}, annotations={}))[0]
    assert (
        "8 of 8 detections are left out: scores below least_score=0.5; the highest is 0.1"
        in (reasons(drive(score=0.1), least_score=0.5)[0])
    )
    assert "fewer frames than the min_hits=3" in reasons(drive(sequences=True), warm_up=0)[0]
    assert any("2 s apart" in text for text in reasons(drive(step_m=60.0), step_s=2.0, warm_up=0))

"""The checks of protocols find what is wrong, and say how to fix it."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from farfield.metrics import Detections, Protocol, Result
from farfield.testing import check_protocol


class Counting(Protocol):
    """One minus the number of frames over 100: no score at all."""

    name = "counting"

    @dataclass(frozen=True)
    class Settings:
        label: str = "vehicle"

    def figure(self, found: Detections) -> float | None:
        return None

    def evaluate(self, found: Detections, settings: Any) -> Result:
        figures = {"figure": self.figure(found)}
        return Result(protocol=self.name, label=settings.label, settings={}, convention="", figures=figures)


class Constant(Counting):
    def figure(self, found: Detections) -> float | None:
        return 1.0


class Backwards(Counting):
    def figure(self, found: Detections) -> float | None:
        return 1.0 - sum(map(len, found.boxes.values())) / 100


class FirstBox(Counting):
    """Looks at the first box of the first frame."""

    def figure(self, found: Detections) -> float | None:
        boxes = [part for part in found.boxes.values() if len(part)]
        shift = [float(part.centre_m[0, 0]) % 1 for part in boxes[:1]]  # 0 unless moved by 0.8 m
        return (1.0 - shift[0] + float(boxes[0].yaw_rad[0])) if boxes else -2.0


class Infinite(Counting):
    def figure(self, found: Detections) -> float | None:
        return float(np.inf)


@pytest.mark.parametrize(
    ("protocol", "error", "message"),
    [
        (Counting(), AssertionError, r"headline\(\) must name figures"),
        (Constant(), AssertionError, "must score less than perfect ones"),
        (Backwards(), AssertionError, "figure is larger for boxes that are absent"),
        (FirstBox(), AssertionError, "the order of boxes and frames must not matter"),
        (Infinite(), AssertionError, "must be finite"),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, Protocol) else None,
)
def test_what_is_wrong_is_named(protocol: Protocol, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        check_protocol(protocol)

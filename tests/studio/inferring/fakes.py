"""Detectors for tests, loaded in the process that detects."""

import os
import time
from functools import partial

import numpy as np

from farfield.errors import ConfigError
from farfield.frame import Boxes, Frame


def load(name: str):
    """A detector that finds what is annotated, moved; ``slow`` takes its time, ``dies`` ends its process."""
    if name == "missing":
        raise ConfigError("/somewhere/weights: there is no detector of this name")
    return partial(detect, name)


def detect(name: str, frame: Frame) -> Boxes:
    if name == "slow":
        time.sleep(0.3)
    if name == "dies":
        os._exit(7)
    if name == "breaks":
        raise ZeroDivisionError("no pixels")
    boxes = frame.boxes
    return boxes.replace(
        centre_m=boxes.centre_m + np.array([0.1, 0, 0]), score=np.linspace(1, 0.5, len(boxes)), track_id=None
    )

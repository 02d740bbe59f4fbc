"""What a cloud's measurements are called: a LiDAR has points, a radar has cells of power."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float32

from farfield.frame import Frame
from farfield.radar.views import PRODUCTS, radar_views

_QUICK = ("cube", "cells")  # products that need no search for echoes
_WORDS = {"lidar": ("LiDAR point", "LiDAR points"), "radar": ("radar cell", "radar cells"), "": ("point", "points")}


def kind_of(frame: Frame, cloud: str | None) -> str:
    """Kind of the sensor that a cloud is of, ``"lidar"`` or ``"radar"``; empty where the frame does not say."""
    sensor = frame.sensors.get(cloud or next(iter(frame.clouds), ""))
    return "" if sensor is None else sensor.kind


def returns_word(kind: str, *, many: bool = False) -> str:
    """What one measurement of a cloud is called, or several."""
    return _WORDS.get(kind, _WORDS[""])[many]


def power_from_above(frame: Frame) -> Float32[np.ndarray, "y x"] | None:
    """A frame's mean power over height in dB, shape (400, 250), y and x of K-Radar's cube.

    Returns:
        None where the frame has no such product, or stands in other coordinates than the radar's.
    """
    if frame.reference != "radar" or not any(name in frame.radar for name in PRODUCTS):
        return None
    quick = next((name for name in _QUICK if name in frame.radar), None)
    products: Mapping[str, Any] = frame.radar if quick is None else {quick: frame.radar[quick]}
    views = radar_views(products)
    return None if views is None else views.bird_db

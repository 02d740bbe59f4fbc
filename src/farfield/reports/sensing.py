"""What a cloud's measurements are called: a LiDAR has points, a radar has cells of power."""

from farfield.frame import Frame

_WORDS = {"lidar": ("LiDAR point", "LiDAR points"), "radar": ("radar cell", "radar cells"), "": ("point", "points")}


def kind_of(frame: Frame, cloud: str | None) -> str:
    """Kind of the sensor that a cloud is of, ``"lidar"`` or ``"radar"``; empty where the frame does not say."""
    sensor = frame.sensors.get(cloud or next(iter(frame.clouds), ""))
    return "" if sensor is None else sensor.kind


def returns_word(kind: str, *, many: bool = False) -> str:
    """What one measurement of a cloud is called, or several."""
    return _WORDS.get(kind, _WORDS[""])[many]

"""How a detector sees a data set: as it was trained to, in the clouds that suit it."""

from collections.abc import Sequence
from typing import Any

from farfield.datasets.base import Dataset
from farfield.datasets.recipes import recipe_of_provenance, replay
from farfield.errors import ConfigError
from farfield.frame import Frame, Pose
from farfield.geometry.poses import invert
from farfield.vocabulary.patterns import PATTERNS

Frames = Sequence[Frame] | Dataset


def as_trained(data: Any, detector: Any) -> Any:
    """The data as the detector was trained to see them, by its provenance.

    That is with as many sweeps a frame, turned as far, in the same coordinates and with as dense a radar cloud. Frames
    that are not a data set's stay as they are, and what was done to the data already is not done again.

    Raises:
        DatasetError: If the detector wants several sweeps and the frames have no poses or times.
    """
    if not isinstance(data, Dataset):
        return data
    return replay(data, recipe_of_provenance(getattr(detector, "provenance", None) or {}))


def suitable_clouds(detector: Any, frame: Frame) -> tuple[str, ...]:
    """Clouds of a frame that a detector may read.

    They come from a sensor of its kind and stand in the frame's coordinates: those it learnt from, with the other scan
    pattern if it learnt from one, or, where the frame has none of them, all others of that kind.

    Args:
        detector: The detector; of a plain function nothing is known, and any cloud may do.
        frame: One of the frames.

    Raises:
        ConfigError: If no cloud of the frame suits.
    """
    kind = getattr(detector, "kind", None)
    if kind is None:
        return tuple(frame.clouds)
    fitting = [name for name in frame.clouds if _fits(frame, name, kind)]
    if not fitting:
        there = ", ".join(f"{name} ({_kind(frame, name)})" for name in frame.clouds) or "none"
        raise ConfigError(
            f"Expected a cloud of a {kind}, which the detector reads, in the frame's coordinates; frame {frame.key} "
            f"has {there}. Take a detector for these sensors, or data with a {kind}."
        )
    learnt = set(detector.learnt_clouds)
    learnt |= set(PATTERNS) if learnt & set(PATTERNS) else set()
    return tuple(name for name in fitting if name in learnt) or tuple(fitting)


def _fits(frame: Frame, name: str, kind: str) -> bool:
    sensor = frame.sensors.get(name)
    return sensor is None or (sensor.kind == kind and sensor.in_frame)


def _kind(frame: Frame, name: str) -> str:
    sensor = frame.sensors.get(name)
    if sensor is None:
        return "of an unknown sensor"
    return sensor.kind if sensor.in_frame else f"{sensor.kind}, in axes of its own"


def motion(source: Frame, target: Frame) -> Pose:
    """What maps a frame's coordinates to those of the same frame seen otherwise.

    Raises:
        ConfigError: If no sensor's place is known in both.
    """
    for name, sensor in source.sensors.items():
        there = target.sensors.get(name)
        if there is not None and sensor.frame_T_sensor is not None and there.frame_T_sensor is not None:
            return there.frame_T_sensor @ invert(sensor.frame_T_sensor)
    raise ConfigError(
        f"frame {target.key}: expected to know where a sensor stands in the coordinates of {source.reference} and of "
        f"{target.reference}, found none; boxes can be given in those of {source.reference} only"
    )

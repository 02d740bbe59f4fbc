"""How a detector sees a data set: as it was trained to, in the clouds that suit it."""

from farfield.datasets.base import Dataset
from farfield.datasets.recipes import recipe_of_provenance, replay
from farfield.detectors.info import DetectorInfo
from farfield.errors import ConfigError
from farfield.frame import Frame, Pose
from farfield.geometry.poses import invert
from farfield.vocabulary.patterns import PATTERNS


def as_trained(data: Dataset, info: DetectorInfo) -> Dataset:
    """The data as the detector was trained to see them, by its provenance.

    That is with as many sweeps a frame, turned as far, in the same coordinates and with as dense a radar cloud. Frames
    in memory stay as they are, and what was done to the data already is not done again.

    Raises:
        DatasetError: If the detector needs several sweeps and the frames have no poses or times.
    """
    return replay(data, recipe_of_provenance(info.provenance))


def suitable_clouds(info: DetectorInfo, frame: Frame) -> tuple[str, ...]:
    """Clouds of a frame that a detector may read.

    They come from a sensor of its kind and stand in the frame's coordinates: those it was trained on, with the other
    scan pattern if it was trained on one, or, where the frame has none of them, all others of that kind.

    Args:
        info: What is known of the detector; where its kind of sensor is not, any cloud may do.
        frame: One of the frames.

    Raises:
        ConfigError: If no cloud of the frame suits.
    """
    kind = info.sensor
    if kind is None:
        return tuple(frame.clouds)
    sensors = {name: frame.sensors.get(name) for name in frame.clouds}
    suitable = [name for name, sensor in sensors.items() if sensor is None or (sensor.kind == kind and sensor.in_frame)]
    if not suitable:
        present = ", ".join(f"{name} ({_sensor_text(frame, name)})" for name in frame.clouds) or "none"
        raise ConfigError(
            f"Expected a cloud of a {kind}, which the detector reads, in the frame's coordinates; frame {frame.key} "
            f"has {present}. Take a detector for these sensors, or data with a {kind}."
        )
    learnt = set(info.learnt_clouds)
    learnt |= set(PATTERNS) if learnt & set(PATTERNS) else set()
    return tuple(name for name in suitable if name in learnt) or tuple(suitable)


def _sensor_text(frame: Frame, name: str) -> str:
    sensor = frame.sensors.get(name)
    if sensor is None:
        return "of an unknown sensor"
    return sensor.kind if sensor.in_frame else f"{sensor.kind}, in axes of its own"


def motion(source: Frame, target: Frame) -> Pose:
    """What maps a frame's coordinates to those of the same frame seen otherwise, shape (4, 4).

    Raises:
        ConfigError: If no sensor's pose is known in both.
    """
    for name, sensor in source.sensors.items():
        other = target.sensors.get(name)
        if other is not None and sensor.frame_T_sensor is not None and other.frame_T_sensor is not None:
            return other.frame_T_sensor @ invert(sensor.frame_T_sensor)
    raise ConfigError(
        f"frame {target.key}: expected to know where a sensor stands in the coordinates of {source.reference} and of "
        f"{target.reference}, found none; boxes can be given in those of {source.reference} only"
    )

"""Named settings of the simulator."""

from dataclasses import dataclass, field, replace
from typing import Any

from farfield.errors import ConfigError
from farfield.simulation.lidar.model import LidarModel


@dataclass(frozen=True)
class Preset:
    """What to simulate.

    Args:
        name: Its name.
        road: "highway", "urban", or "mixed" (sequences take turns).
        sequences: How many sequences are written unless asked otherwise.
        frames: How many frames a sequence has unless asked otherwise.
        stride_s: Time between written frames; the sensor itself turns at 10 Hz.
        duration_s: How long the traffic of a sequence lasts.
        seed: Seed unless another is given.
        uniform_offset_ms: How much later the uniform pattern is taken; Cirrus' patterns are not simultaneous.
        uniform_origin_m: Where the second sensor sits, in the Gaussian sensor's frame.
        sensor_height_m: Range of the sensor's height above the road; each sequence draws one.
        lidar: The sensor.
    """

    name: str
    road: str = "mixed"
    sequences: int = 12
    frames: int = 20
    stride_s: float | int = 0.5
    duration_s: float | int = 60.0
    seed: int = 0
    uniform_offset_ms: float | int = 0.0
    uniform_origin_m: tuple[float | int, float | int, float | int] = (0.0, -0.5, 0.0)
    sensor_height_m: tuple[float, float] = (1.9, 2.1)
    lidar: LidarModel = field(default_factory=LidarModel)


PRESETS: dict[str, Preset] = {
    preset.name: preset
    for preset in (
        Preset("cirrus-sim"),
        Preset("cirrus-sim-highway", road="highway"),
        Preset("cirrus-sim-urban", road="urban"),
        Preset("mini", sequences=2, frames=3, lidar=LidarModel(lines=32, columns=235), duration_s=10.0),
        Preset("cirrus-sim-val-v1", sequences=20, frames=20, stride_s=1.0, duration_s=20.0, seed=731_001),
    )
}


def find_preset(name: str, **changes: Any) -> Preset:
    """Look a preset up by name and change some of its settings.

    Raises:
        ConfigError: If there is no such preset.
    """
    if name not in PRESETS:
        raise ConfigError(f"preset: expected one of {', '.join(PRESETS)}; got {name!r}")
    return replace(PRESETS[name], **changes)

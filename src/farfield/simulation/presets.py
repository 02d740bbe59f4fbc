"""Named settings of the simulator: which rig, which roads in which weather, how many frames."""

from dataclasses import asdict, dataclass, replace
from typing import Any

from farfield.errors import ConfigError
from farfield.simulation.rig import RIGS
from farfield.vocabulary.conditions import SIDES, TIMES, WEATHERS, WORLDS
from farfield.vocabulary.kradar import OUSTER_LINES, SEQUENCES
from farfield.vocabulary.patterns import PATTERNS

CIRRUS_SENSORS = (*PATTERNS, "camera")
KRADAR_SENSORS = (
    *OUSTER_LINES,
    "cam-front",
    "cam-left",
    "cam-right",
    "cam-rear",
    "cells",
    "sparse",
    "polar3d",
    "cube",
    "tesseract",
)
KITTI_SENSORS = ("lidar", "camera")
RADIATE_SENSORS = ("polar", "cartesian")
CIRRUS_SEGMENT_NAME = "segment_{sequence:02d}"
KRADAR_SEGMENT_NAME = "{number}"
KITTI_SEGMENT_NAME = "{sequence:04d}"
RADIATE_SEGMENT_NAME = "sim_{sequence}_0"
Number = float | int
Span = tuple[Number, Number]


@dataclass(frozen=True)
class Segment:
    """One sequence: where and when it is driven.

    Args:
        name: Its name; K-Radar numbers its sequences.
        road: One of the simulator's roads.
        condition: The weather, one of ``WEATHERS``.
        time: "day" or "night".
        frames: How many frames are written by default.
        duration_s: How long its traffic lasts.
    """

    name: str
    road: str
    condition: str = "normal"
    time: str = "day"
    frames: int = 20
    duration_s: Number = 60.0


@dataclass(frozen=True)
class Mounting:
    """How the sensors of each sequence are mounted and set; every span is drawn from once a sequence.

    Args:
        height_m: Height of the (Gaussian, os2-64, or only) LiDAR above the road.
        facing_deg: Directions that the Luminars may face; one is drawn.
        focus_deg: Elevation of the Gaussian pattern's densest lines.
        sigma_deg: Width of the Gaussian pattern.
        uniform_origin_m: Where the second Luminar sits, in the Gaussian one's frame.
        uniform_offset_ms: How much later the uniform pattern is taken. Cirrus' two patterns are not simultaneous (68 ms
            apart in the one public pair); (0, 0) is the ideal pair.
        radar_offset_ms: How much later the radar measures than the os2-64; K-Radar matches them to half a frame.
    """

    height_m: Span = (1.9, 2.1)
    facing_deg: tuple[Number, ...] = (0.0,)
    focus_deg: Span = (-2.0, -2.0)
    sigma_deg: Span = (5.0, 5.0)
    uniform_origin_m: tuple[Number, Number, Number] = (0.0, -0.5, 0.0)
    uniform_offset_ms: Span = (0.0, 100.0)
    radar_offset_ms: Span = (-50.0, 50.0)


@dataclass(frozen=True)
class Preset:
    """What to simulate.

    Args:
        name: Its name.
        rig: Name of its rig, one of :data:`farfield.simulation.rig.RIGS`.
        segments: Its sequences; further ones repeat them in turn, each with another world.
        sensors: What is written by default.
        stride_s: Time between frames; the sensors themselves turn at 10 Hz.
        seed: Seed unless another is given.
        sizes: Priors of the road users' sizes ("us", "korea", "kitti"); each sequence draws one.
        mountings: How the sensors are mounted and set; each sequence draws one.
        lines: Lines of a Luminar.
        columns: Shots a line of a Luminar, or columns of a LiDAR that turns.
        loose_boxes: Whether annotated full boxes are as much larger than the bodies as K-Radar's.
        traffic: On which side it keeps, "right" or "left"; the left is the mirror image of the right.
        world: What stands beside and on its roads: "v2", or "v3" with plants that rays enter, street furniture, rows of
            parked vehicles, and bodies with the surfaces of real ones.
    """

    name: str
    rig: str
    segments: tuple[Segment, ...]
    sensors: tuple[str, ...]
    stride_s: Number = 0.5
    seed: int = 0
    sizes: tuple[str, ...] = ("us",)
    mountings: tuple[Mounting, ...] = (Mounting(),)
    lines: int = 64
    columns: int = 938
    loose_boxes: bool = False
    traffic: str = "right"
    world: str = "v2"

    def as_json(self) -> dict[str, Any]:
        """All settings as JSON takes them; side and world only where they are others, so that names stay as before."""
        usual = {"traffic": "right", "world": "v2"}
        return {name: value for name, value in asdict(self).items() if usual.get(name) != value}

    def segment(self, sequence: int) -> Segment:
        """The segment of a sequence of any number."""
        segment = self.segments[sequence % len(self.segments)]
        if sequence < len(self.segments):
            return segment
        return replace(segment, name=segment_name(RIGS[self.rig].segment_name, sequence))

    def max_frames(self, sequence: int) -> int:
        """How many frames fit into a sequence, the sensors' offsets included."""
        return int((self.segment(sequence).duration_s - 0.2) / self.stride_s + 1e-9) + 1


def segment_name(template: str, sequence: int) -> str:
    """Name of a sequence: "segment_03" in Cirrus, "4" in K-Radar, "0003" in KITTI, "sim_3_0" in RADIATE.

    Args:
        template: Format of ``sequence`` (from 0) and ``number`` (from 1); a rig's ``segment_name``.
        sequence: Its number, from 0.
    """
    return template.format(sequence=sequence, number=sequence + 1)


def _segments(
    template: str, roads: tuple[str, ...], count: int, *, frames: int = 20, duration_s: Number = 60.0
) -> tuple[Segment, ...]:
    """Sequences on some roads in turn."""
    return tuple(
        Segment(segment_name(template, i), roads[i % len(roads)], frames=frames, duration_s=duration_s)
        for i in range(count)
    )


def _kradar_segments() -> tuple[Segment, ...]:
    """K-Radar's 58 sequences."""
    return tuple(
        Segment(name, info.road, info.weather, info.time, info.frames, duration_s=info.frames * 0.1 + 1.0)
        for name, info in SEQUENCES.items()
    )


_SEGMENT_FIELDS = ("road", "frames", "duration_s")
_BOTH = ("highway", "urban")
_MANY = (
    "highway",
    "urban",
    "suburban",
    "highway",
    "urban",
    "alleyway",
    "highway",
    "university",
    "parking_lot",
    "shoulder",
)
_VARIED = Mounting(
    height_m=(1.5, 2.2),
    facing_deg=(0.0, 0.0, 180.0),
    focus_deg=(-4.0, 0.0),
    sigma_deg=(3.5, 7.0),
    uniform_offset_ms=(0, 0),
)
_IDEAL = Mounting(uniform_offset_ms=(0.0, 0.0))
_KRADAR_RIG = Mounting(height_m=(1.55, 1.65))
_KITTI_RIG = Mounting(height_m=(1.73, 1.73))
_KITTI_ROADS = ("urban", "suburban", "alleyway", "highway")  # its city, residential and road drives
_RADIATE_RIG = Mounting(height_m=(1.8, 1.8))
_RADIATE_TOWNS = ("urban", "suburban", "highway", "university")
_RADIATE_ROADS = (*_RADIATE_TOWNS, *("mountain", "shoulder", "alleyway", "parking_lot"))
_KRADAR_DEFAULT = (*OUSTER_LINES, "cam-front", "sparse", "cube")

PRESETS: dict[str, Preset] = {
    preset.name: preset
    for preset in (
        Preset("cirrus-sim", "cirrus", _segments(CIRRUS_SEGMENT_NAME, _BOTH, 12), CIRRUS_SENSORS),
        Preset(
            "cirrus-sim-ideal", "cirrus", _segments(CIRRUS_SEGMENT_NAME, _BOTH, 12), CIRRUS_SENSORS, mountings=(_IDEAL,)
        ),
        Preset("cirrus-sim-highway", "cirrus", _segments(CIRRUS_SEGMENT_NAME, ("highway",), 12), CIRRUS_SENSORS),
        Preset("cirrus-sim-urban", "cirrus", _segments(CIRRUS_SEGMENT_NAME, ("urban",), 12), CIRRUS_SENSORS),
        Preset(
            "cirrus-sim-varied",
            "cirrus",
            _segments(CIRRUS_SEGMENT_NAME, _MANY, 40),
            PATTERNS,
            sizes=("us", "us", "kitti", "korea"),
            mountings=(_IDEAL, _VARIED),
        ),
        Preset(
            "cirrus-sim-mini",
            "cirrus",
            _segments(CIRRUS_SEGMENT_NAME, _BOTH, 2, frames=3, duration_s=10.0),
            PATTERNS,
            lines=32,
            columns=235,
        ),
        Preset(
            "cirrus-sim-val-v2",
            "cirrus",
            _segments(CIRRUS_SEGMENT_NAME, _BOTH, 20, duration_s=20.5),
            PATTERNS,
            stride_s=1.0,
            seed=731_002,
        ),
        Preset(
            "cirrus-sim-val-v3",
            "cirrus",
            _segments(CIRRUS_SEGMENT_NAME, _BOTH, 20, duration_s=20.5),
            PATTERNS,
            stride_s=1.0,
            seed=731_002,
            world="v3",
        ),
        Preset(
            "kradar-sim",
            "kradar",
            _kradar_segments(),
            _KRADAR_DEFAULT,
            stride_s=0.1,
            sizes=("korea",),
            mountings=(_KRADAR_RIG,),
            columns=2048,
            loose_boxes=True,
        ),
        Preset(
            "kradar-sim-mini",
            "kradar",
            tuple(
                Segment(str(i + 1), road, weather, time, frames=2, duration_s=6.0)
                for i, (road, weather, time) in enumerate(
                    (
                        ("urban", "normal", "day"),
                        ("highway", "heavy_snow", "night"),
                        ("mountain", "fog", "day"),
                    )
                )
            ),
            ("os2-64", "sparse", "polar3d"),
            stride_s=0.1,
            sizes=("korea",),
            mountings=(_KRADAR_RIG,),
            columns=512,
            loose_boxes=True,
        ),
        Preset(
            "kitti-sim",
            "kitti",
            _segments(KITTI_SEGMENT_NAME, _KITTI_ROADS, 12),
            KITTI_SENSORS,
            sizes=("kitti",),
            mountings=(_KITTI_RIG,),
            columns=2083,
        ),
        Preset(
            "kitti-sim-mini",
            "kitti",
            _segments(KITTI_SEGMENT_NAME, _KITTI_ROADS, 2, frames=2, duration_s=6.0),
            ("lidar",),
            sizes=("kitti",),
            mountings=(_KITTI_RIG,),
            columns=512,
        ),
        Preset(
            "radiate-sim",
            "radiate",
            _segments(RADIATE_SEGMENT_NAME, _RADIATE_ROADS, 16, frames=40, duration_s=20.0),
            RADIATE_SENSORS,
            stride_s=0.25,
            sizes=("kitti",),
            mountings=(_RADIATE_RIG,),
            traffic="left",
        ),
        Preset(
            "radiate-sim-mini",
            "radiate",
            _segments(RADIATE_SEGMENT_NAME, _RADIATE_ROADS, 2, frames=2, duration_s=6.0),
            RADIATE_SENSORS,
            stride_s=0.25,
            sizes=("kitti",),
            mountings=(_RADIATE_RIG,),
            traffic="left",
        ),
    )
}


def find_preset(name: str, *, weather: str | None = None, time: str | None = None, **changes: Any) -> Preset:
    """Look a preset up by name and change some of its settings.

    Args:
        name: One of ``PRESETS``.
        weather: Put every sequence into this weather; of several with commas between, each into the next in turn.
        time: Put every sequence into this time of day.
        **changes: Fields of :class:`Preset` to replace; fields of :class:`Mounting`, and ``road``, ``frames`` and
            ``duration_s`` of :class:`Segment`, may be named too and go to every sequence.

    Raises:
        ConfigError: If there is no such preset, weather, or setting.
    """
    if name not in PRESETS:
        raise ConfigError(f"preset: expected one of {', '.join(PRESETS)}; got {name!r}")
    preset = PRESETS[name]
    weathers = () if weather is None else tuple(name.strip() for name in weather.split(","))
    checks: list[tuple[str, Any, tuple[str, ...]]] = [("weather", name, WEATHERS) for name in weathers]
    checks += [("traffic", changes["traffic"], SIDES)] if "traffic" in changes else []
    checks += [("world", changes["world"], WORLDS)] if "world" in changes else []
    checks += [("time of day", time, TIMES)] if time is not None else []
    for what, value, allowed in checks:
        if value not in allowed:
            raise ConfigError(f"{what}: expected one of {', '.join(allowed)}; got {value!r}")
    segment_changes = {"time": time, **{name: changes.pop(name, None) for name in _SEGMENT_FIELDS}}
    segment_changes = {name: value for name, value in segment_changes.items() if value is not None}
    mounting_changes = {name: changes.pop(name) for name in list(changes) if name in Mounting.__dataclass_fields__}
    unknown = set(changes) - set(Preset.__dataclass_fields__)
    if unknown:
        fields = [*Preset.__dataclass_fields__, *_SEGMENT_FIELDS, *Mounting.__dataclass_fields__]
        raise ConfigError(f"preset: expected settings among {', '.join(fields)}; got {', '.join(sorted(unknown))}")
    segments = [replace(segment, **segment_changes) for segment in preset.segments]
    if weathers:
        segments = [replace(old, condition=weathers[i % len(weathers)]) for i, old in enumerate(segments)]
    changes.setdefault("segments", tuple(segments))
    changes.setdefault("mountings", tuple(replace(old, **mounting_changes) for old in preset.mountings))
    return replace(preset, **changes)


def check_sensors(preset: Preset, sensors: tuple[str, ...]) -> tuple[str, ...]:
    """The named sensors in the rig's own order.

    Raises:
        ConfigError: If the rig is unknown or lacks one of them, or none is named.
    """
    available = RIGS[preset.rig].sensors
    unknown = [name for name in sensors if name not in available]
    if unknown or not sensors:
        raise ConfigError(f"sensors: expected some of {', '.join(available)}; got {', '.join(unknown) or 'none'}")
    return tuple(name for name in available if name in sensors)

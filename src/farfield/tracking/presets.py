"""The options of the tracker, and trackers as published, by name."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Literal

import yaml
from pydantic import TypeAdapter, ValidationError

from farfield.errors import ConfigError, plain
from farfield.files.yaml_text import plain_yaml

_CHOICES = {
    "similarity": ("iou", "giou", "distance"),
    "assignment": ("hungarian", "greedy"),
    "motion": ("kalman", "detection"),
    "time": ("frames", "seconds"),
    "anchor": ("bottom", "centre"),
    "output": ("filtered", "detection"),
}

_POSITIVE_OR_NONE = (
    "gate_sigmas",
    "far_m",
    "range_sigma_m",
    "doppler_sigma_m_s",
    "doppler_span_m_s",
    "across_speed_m_s",
    "max_age_s",
)


@dataclass(frozen=True, kw_only=True)
class TrackerSettings:
    """Every choice of the tracker. The defaults are ours; published ones stand in ``farfield.tracking.PRESETS``.

    Args:
        similarity: How alike a track and a detection are: 3D IoU, generalised 3D IoU, or distance of the centres in x
            and y.
        gate: Least IoU or generalised IoU of a pair; largest distance in metres where no class is named.
        gates_m: For distances: the largest one by class.
        gate_speed_m_s: For distances: what the gate grows by for each second since the track's last match.
        gate_sigmas: Largest distance in standard deviations of both the track's position and the detection's, beside
            the gate; None for no such gate.
        gate_first: Whether pairs beyond the gate are taken out before the assignment (True) or after it (AB3DMOT).
        assignment: ``"hungarian"`` for the best sum, ``"greedy"`` for the detections' turn: they choose in their order.
        same_class: Whether a track and its detections are of one class.
        motion: ``"kalman"``: constant velocity; ``"detection"``: the last detection, moved by its own velocity.
        time: Steps of one frame each, so that velocities are metres a frame, or true seconds.
        step_s: Seconds between frames where the data have no stamps.
        ego_motion: Whether tracks are kept in the world, where the data have poses.
        anchor: Which point of the box is filtered.
        initial_variance: Of position, size and heading at birth, m^2 and rad^2.
        initial_speed_variance: Of the velocity at birth, (m/s)^2 or (m/frame)^2.
        process_variance: Of position, size and heading, added each step.
        process_speed_variance: Of the velocity, added each step.
        acceleration: White acceleration, (m/s^2)^2, instead of ``process_variance`` of positions and velocities.
        measurement_variance: Of position, size and heading of a detection.
        range_sigma_m: Instead of it, for positions: error along the ray; with ``azimuth_sigma_rad``.
        azimuth_sigma_rad: Error across the ray, as an angle. Errors along x and y are taken as independent.
        doppler_sigma_m_s: Error of measured radial velocities, where detections have them; None takes none.
        doppler_span_m_s: Span modulo which they are known; None where they are not ambiguous.
        across_speed_m_s: Deviation of the velocity across the ray at birth, where the radial one is measured; None
            takes that of ``initial_speed_variance``. 3 suits roads that lead away from the sensor.
        min_hits: Frames with a match, that of birth counted, from which on a track is reported.
        warm_up: First frames of a drive in which every track is reported at once.
        sure_score: Tracks whose best score so far is lower are reported from ``unsure_hits`` matches on, in the first
            frames too; a probability, also where scores are logits (any outside [0, 1]). None takes all as certain.
        unsure_hits: Matches from which on such a track is reported.
        far_m: Range from which ``far_min_hits`` and ``far_max_age`` hold instead; None for nowhere.
        far_min_hits: Of tracks that were last seen there.
        far_max_age: Likewise.
        max_age: Frames without a match at which a track dies.
        max_age_s: Seconds instead of frames, for data whose frames are not evenly apart; ``far_max_age`` is not read.
        report_coasted: Whether tracks are reported in frames without a match.
        forget_when_empty: Whether a frame without detections forgets all tracks.
        least_score: Detections of a lower score are left out.
        suppress_iou: Detections that overlap a better one of their frame by more 3D IoU are left out.
        strong_score: Detections of a lower score neither enter the first stage nor give birth.
        weak_gate: Gate of the second stage, in which tracks left over take weak detections; None for no second stage.
        weak_updates: Whether a weak detection updates a track (True) or keeps it alive only.
        output: Whether the filter's box is reported or the detection's.
    """

    similarity: Literal["iou", "giou", "distance"] = "distance"
    gate: float = 2.0
    gates_m: Mapping[str, float] = field(default_factory=dict)
    gate_speed_m_s: float = 15.0
    gate_sigmas: float | None = 4.0
    gate_first: bool = True
    assignment: Literal["hungarian", "greedy"] = "hungarian"
    same_class: bool = True
    motion: Literal["kalman", "detection"] = "kalman"
    time: Literal["frames", "seconds"] = "seconds"
    step_s: float = 0.1
    ego_motion: bool = True
    anchor: Literal["bottom", "centre"] = "centre"
    initial_variance: float = 1.0
    initial_speed_variance: float = 100.0
    process_variance: float = 0.01
    process_speed_variance: float = 0.04
    acceleration: float | None = 10.0
    measurement_variance: float = 0.05
    range_sigma_m: float | None = None
    azimuth_sigma_rad: float = 0.002
    doppler_sigma_m_s: float | None = 0.1
    doppler_span_m_s: float | None = None
    across_speed_m_s: float | None = None
    min_hits: int = 3
    warm_up: int = 3
    sure_score: float | None = 0.9
    unsure_hits: int = 5
    far_m: float | None = None
    far_min_hits: int = 3
    far_max_age: int = 5
    max_age: int = 3
    max_age_s: float | None = None
    report_coasted: bool = False
    forget_when_empty: bool = False
    least_score: float | None = None
    suppress_iou: float | None = None
    strong_score: float | None = None
    weak_gate: float | None = None
    weak_updates: bool = True
    output: Literal["filtered", "detection"] = "detection"

    def __post_init__(self) -> None:
        for name, choices in _CHOICES.items():
            if getattr(self, name) not in choices:
                raise ConfigError(f"{name}: expected one of {', '.join(choices)}, got {getattr(self, name)!r}")
        for name in ("step_s", "initial_variance", "initial_speed_variance", "measurement_variance"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name}: expected a positive number, got {getattr(self, name)!r}")
        for name in ("min_hits", "max_age", "unsure_hits", "far_min_hits", "far_max_age"):
            if not getattr(self, name) >= 1:
                raise ConfigError(f"{name}: expected 1 or more, got {getattr(self, name)!r}")
        if self.sure_score is not None and not 0 <= self.sure_score <= 1:
            raise ConfigError(f"sure_score: expected a probability between 0 and 1, got {self.sure_score!r}")
        for name in _POSITIVE_OR_NONE:
            if getattr(self, name) is not None and not getattr(self, name) > 0:
                raise ConfigError(f"{name}: expected a positive number, got {getattr(self, name)!r}")
        if not self.gate_speed_m_s >= 0:
            raise ConfigError(f"gate_speed_m_s: expected 0 or more, got {self.gate_speed_m_s!r}")

    def changed(self, **changes: Any) -> "TrackerSettings":
        """The same with other values.

        Raises:
            ConfigError: If an option is unknown or a value impossible.
        """
        names = {option.name for option in fields(self)}
        unknown = sorted(set(changes) - names)
        if unknown:
            raise ConfigError(f"tracker: expected options among {', '.join(sorted(names))}; got {', '.join(unknown)}")
        return TrackerSettings(**{name: getattr(self, name) for name in names} | changes)


_AB3DMOT: dict[str, Any] = {
    # Weng et al., IROS 2020: constant velocity in metres a frame in the sensor's own coordinates, no ego motion.
    "similarity": "giou",
    "gate": -0.2,
    "gate_first": False,
    "same_class": True,
    "time": "frames",
    "ego_motion": False,
    "anchor": "bottom",
    "initial_variance": 10.0,
    "initial_speed_variance": 1e4,
    "process_variance": 1.0,
    "process_speed_variance": 0.01,
    "acceleration": None,
    "measurement_variance": 1.0,
    "min_hits": 3,
    "warm_up": 3,
    "sure_score": None,
    "doppler_sigma_m_s": None,
    "gate_speed_m_s": 0.0,
    "gate_sigmas": None,
    "max_age": 2,
    "report_coasted": True,
    "output": "filtered",
}
_UNPOSED: dict[str, Any] = {"gate_speed_m_s": 50.0, "gate_sigmas": None, "initial_speed_variance": 600.0}
PRESETS: dict[str, TrackerSettings] = {
    "default": TrackerSettings(),
    # For smoothing, which sees whole tracks: they live longer, and scores are judged afterwards.
    "offline": TrackerSettings(max_age=5, min_hits=3, warm_up=3, sure_score=None),
    # For drives without poses: the car's own motion is in every track's speed.
    "unposed": TrackerSettings(**_UNPOSED),
    # For boxes that people drew, of such drives, without identities: all are objects, but classes slip. A lost track
    # ends soon, so that it takes no neighbour; `offline.ANNOTATED` finds it again by its size.
    "annotated": TrackerSettings(**_UNPOSED, min_hits=1, max_age=2, same_class=False),
    "ab3dmot": TrackerSettings(**_AB3DMOT),
    "ab3dmot-paper": TrackerSettings(**_AB3DMOT | {"similarity": "iou", "gate": 0.01}),
    # Yin et al., CVPR 2021: greedy on distances, the last centre moved by the detection's velocity.
    "centerpoint": TrackerSettings(
        similarity="distance",
        gate=4.0,
        gates_m={
            "car": 4.0,
            "truck": 4.0,
            "bus": 5.5,
            "trailer": 3.0,
            "pedestrian": 1.0,
            "motorcycle": 13.0,
            "bicycle": 3.0,
        },
        assignment="greedy",
        motion="detection",
        min_hits=1,
        warm_up=0,
        max_age=3,
        sure_score=None,
        doppler_sigma_m_s=None,
        gate_speed_m_s=0.0,
        gate_sigmas=None,
        acceleration=3.0,
        forget_when_empty=True,
    ),
    # Pang et al., ECCV workshops 2022, its Waymo settings: two stages on generalised IoU.
    "simpletrack": TrackerSettings(
        **_AB3DMOT
        | {"gate": -0.5, "ego_motion": True, "suppress_iou": 0.25, "strong_score": 0.7, "anchor": "centre"}
        | {"least_score": 0.1, "weak_gate": -0.5, "weak_updates": False, "report_coasted": False}
    ),
}


def preset(name: str) -> TrackerSettings:
    """The settings of a preset.

    Raises:
        ConfigError: If there is none of this name.
    """
    if name not in PRESETS:
        raise ConfigError(f"preset: expected one of {', '.join(PRESETS)}, got {name!r}")
    return PRESETS[name]


def with_options(settings: TrackerSettings, options: Iterable[str]) -> TrackerSettings:
    """Settings changed by options of the form ``name=value``, values as YAML reads them.

    >>> with_options(preset("default"), ["max_age=5", "gates_m={car: 3}", "gate_sigmas=null"]).gates_m
    {'car': 3.0}

    Raises:
        ConfigError: If an option has another form, has an unknown name, or holds an impossible value.
    """
    changes: dict[str, Any] = {}
    for option in options:
        name, equals, value = option.partition("=")
        if not equals:
            raise ConfigError(f"tracker: expected an option of the form name=value, got {option!r}")
        try:
            changes[name] = plain_yaml(value)
        except yaml.YAMLError as error:
            raise ConfigError(f"tracker: {name}: expected a value as YAML writes it, got {value!r}") from error
    current = {option.name: getattr(settings, option.name) for option in fields(settings)}
    unknown = sorted(changes.keys() - current.keys())
    if unknown:
        raise ConfigError(f"tracker: expected options among {', '.join(sorted(current))}; got {', '.join(unknown)}")
    try:
        return TypeAdapter(TrackerSettings).validate_python(current | changes)
    except ValidationError as error:
        raise ConfigError(f"tracker: {plain(error)}") from error

"""Trackers as published, by name."""

from collections.abc import Iterable
from dataclasses import fields
from typing import Any

import yaml
from pydantic import TypeAdapter, ValidationError

from farfield.errors import ConfigError, plain
from farfield.tracking.settings import TrackerSettings

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
    # ends soon, so that it takes no neighbour; `joining.ANNOTATED` finds it again by its size.
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
    """Settings changed by words of the form ``name=value``, values as YAML reads them.

    >>> with_options(preset("default"), ["max_age=5", "gates_m={car: 3}", "gate_sigmas=null"]).gates_m
    {'car': 3.0}

    Raises:
        ConfigError: If a word has another form, names no option, or holds an impossible value.
    """
    given: dict[str, Any] = {}
    for word in options:
        name, equals, value = word.partition("=")
        if not equals:
            raise ConfigError(f"tracker: expected an option of the form name=value, got {word!r}")
        try:
            given[name] = yaml.safe_load(value)
        except yaml.YAMLError as error:
            raise ConfigError(f"tracker: {name}: expected a value as YAML writes it, got {value!r}") from error
    known = {each.name: getattr(settings, each.name) for each in fields(settings)}
    unknown = sorted(given.keys() - known.keys())
    if unknown:
        raise ConfigError(f"tracker: expected options among {', '.join(sorted(known))}; got {', '.join(unknown)}")
    try:
        return TypeAdapter(TrackerSettings).validate_python(known | given)
    except ValidationError as error:
        raise ConfigError(f"tracker: {plain(error)}") from error

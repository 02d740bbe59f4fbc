"""Scores of 3D detections: DDS and wDDS (Cirrus), nuScenes, KITTI, K-Radar. One protocol is one file."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from farfield.errors import ConfigError
from farfield.metrics.bootstrap import Bootstrap
from farfield.metrics.centre.dds import DdsResult, DdsSettings, evaluate_dds
from farfield.metrics.centre.nuscenes import NuScenesResult, NuScenesSettings, evaluate_nuscenes
from farfield.metrics.centre.scene import BoxesByFrame, Key, labels_of
from farfield.metrics.kitti.evaluation import KittiResult, evaluate_kitti
from farfield.metrics.kitti.settings import KittiSettings
from farfield.metrics.kradar.evaluation import KRadarResult, evaluate_kradar
from farfield.metrics.kradar.settings import KRadarSettings, kradar_settings
from farfield.metrics.result import Result

__all__ = [
    "PROTOCOLS",
    "Bootstrap",
    "DdsResult",
    "DdsSettings",
    "KRadarResult",
    "KRadarSettings",
    "KittiResult",
    "KittiSettings",
    "NuScenesResult",
    "NuScenesSettings",
    "Result",
    "evaluate_dds",
    "evaluate_kitti",
    "evaluate_kradar",
    "evaluate_nuscenes",
    "kradar_settings",
    "score",
    "scored_labels",
]

_OneClass = DdsSettings | NuScenesSettings | KittiSettings
_ONE_CLASS: dict[str, type[_OneClass]] = {"dds": DdsSettings, "nuscenes": NuScenesSettings, "kitti": KittiSettings}
PROTOCOLS: dict[str, type[_OneClass | KRadarSettings]] = {**_ONE_CLASS, "kradar": KRadarSettings}
_Details = Mapping[tuple[str, str], Mapping[str, np.ndarray]]


def scored_labels(annotations: BoxesByFrame, protocol: str = "dds", **options: Any) -> tuple[str, ...]:
    """Classes that can be scored, the most annotated first: relabelled ones as one, ignored ones left out.

    K-Radar's protocols score the classes of their settings; those that occur are given.
    """
    chosen: dict[str, Any] = {key: options[key] for key in ("relabel", "ignore", "classes") if key in options}
    if _is_kradar(protocol):
        several = kradar_settings(protocol, **chosen)
        return tuple(name for name, _ in labels_of(annotations, several.relabel) if name in several.classes)
    default = _settings(protocol, chosen)
    names = (name for name, _ in labels_of(annotations, default.relabel))
    return tuple(name for name in names if name not in (default.ignore or ()))


def score(
    predictions: BoxesByFrame,
    annotations: BoxesByFrame,
    *,
    protocol: str = "dds",
    label: str | None = None,
    prediction_details: _Details | None = None,
    annotation_details: _Details | None = None,
    conditions: Mapping[Key, Mapping[str, str]] | None = None,
    visibility: Mapping[Key, Sequence[str]] | None = None,
    **options: Any,
) -> Result:
    """Score predictions by any protocol.

    Args:
        predictions: Scored boxes by (sequence, frame). A frame without an entry has no detections.
        annotations: Annotated boxes by (sequence, frame): every frame that counts, those without boxes too.
        protocol: ``"dds"``, ``"nuscenes"``, ``"kitti"``, ``"kradar"`` or ``"kradar-compat:VARIANT"``.
        label: The class; None takes the one with most annotated boxes, or for K-Radar's protocols all that their
            settings name, each for itself.
        prediction_details: For ``"kitti"``: ``box_px`` of the predictions, see :func:`evaluate_kitti`.
        annotation_details: For ``"kitti"``: what makes a box easy or hard, see :func:`evaluate_kitti`.
        conditions: For K-Radar's protocols: weather, road and time of the frames, see :func:`evaluate_kradar`.
        visibility: For K-Radar's protocols: which sensor sees each annotated box, see :func:`evaluate_kradar`.
        **options: Fields of the protocol's settings: ``range_bins_m``, ``epsilons``, ``region``, ``bootstrap``...

    Raises:
        ConfigError: If the protocol, an option or the label is unknown, or frames do not pair.
    """
    if _is_kradar(protocol):
        several = kradar_settings(protocol, **(options if label is None else {**options, "classes": (label,)}))
        return evaluate_kradar(
            predictions, annotations, several, conditions=conditions, visibility=visibility, protocol=protocol
        )
    default = _settings(protocol, options)
    if label is None:
        label = next(iter(scored_labels(annotations, protocol, **options)), default.label)
    settings = _settings(protocol, {**options, "label": label})
    if isinstance(settings, KittiSettings):
        return evaluate_kitti(
            predictions,
            annotations,
            settings,
            prediction_details=prediction_details,
            annotation_details=annotation_details,
        )
    if isinstance(settings, NuScenesSettings):
        return evaluate_nuscenes(predictions, annotations, settings)
    return evaluate_dds(predictions, annotations, settings)


def _is_kradar(protocol: str) -> bool:
    return protocol.partition(":")[0] in ("kradar", "kradar-compat")


def _settings(protocol: str, options: Mapping[str, Any]) -> _OneClass:
    if protocol not in _ONE_CLASS:
        names = ", ".join([*PROTOCOLS, "kradar-compat:VARIANT"])
        raise ConfigError(f"protocol: expected one of {names}, got {protocol!r}")
    kind = _ONE_CLASS[protocol]
    known = [option.name for option in fields(kind)]
    unknown = sorted(set(options) - set(known))
    if unknown:
        raise ConfigError(f"{protocol}: expected options among {', '.join(known)}; got {', '.join(unknown)}")
    return kind(**options)

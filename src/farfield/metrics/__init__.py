"""Scores of 3D detections: DDS and wDDS (Cirrus), nuScenes, KITTI. One protocol is one file."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from farfield.errors import ConfigError
from farfield.metrics.bootstrap import Bootstrap
from farfield.metrics.dds import DdsResult, DdsSettings, evaluate_dds
from farfield.metrics.kitti import KittiResult, evaluate_kitti
from farfield.metrics.kitti_settings import KittiSettings
from farfield.metrics.nuscenes import NuScenesResult, NuScenesSettings, evaluate_nuscenes
from farfield.metrics.result import Result
from farfield.metrics.scene import BoxesByFrame, labels_of

__all__ = [
    "PROTOCOLS",
    "Bootstrap",
    "DdsResult",
    "DdsSettings",
    "KittiResult",
    "KittiSettings",
    "NuScenesResult",
    "NuScenesSettings",
    "Result",
    "evaluate_dds",
    "evaluate_kitti",
    "evaluate_nuscenes",
    "score",
    "scored_labels",
]

PROTOCOLS: dict[str, type[DdsSettings | NuScenesSettings | KittiSettings]] = {
    "dds": DdsSettings,
    "nuscenes": NuScenesSettings,
    "kitti": KittiSettings,
}
_Details = Mapping[tuple[str, str], Mapping[str, np.ndarray]]


def scored_labels(annotations: BoxesByFrame, protocol: str = "dds", **options: Any) -> tuple[str, ...]:
    """Classes that can be scored, the most annotated first: relabelled ones as one, ignored ones left out."""
    default = _settings(protocol, {key: options[key] for key in ("relabel", "ignore") if key in options})
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
    **options: Any,
) -> Result:
    """Score predictions by any protocol.

    Args:
        predictions: Scored boxes by (sequence, frame). A frame without an entry has no detections.
        annotations: Annotated boxes by (sequence, frame): every frame that counts, those without boxes too.
        protocol: ``"dds"``, ``"nuscenes"`` or ``"kitti"``.
        label: The class; None takes the one with most annotated boxes.
        prediction_details: For ``"kitti"``: ``box_px`` of the predictions, see :func:`evaluate_kitti`.
        annotation_details: For ``"kitti"``: what makes a box easy or hard, see :func:`evaluate_kitti`.
        **options: Fields of the protocol's settings: ``range_bins_m``, ``epsilons``, ``region``, ``bootstrap``...

    Raises:
        ConfigError: If the protocol, an option or the label is unknown, or frames do not pair.
    """
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


def _settings(protocol: str, options: Mapping[str, Any]) -> DdsSettings | NuScenesSettings | KittiSettings:
    if protocol not in PROTOCOLS:
        raise ConfigError(f"protocol: expected one of {', '.join(PROTOCOLS)}, got {protocol!r}")
    kind = PROTOCOLS[protocol]
    known = [option.name for option in fields(kind)]
    unknown = sorted(set(options) - set(known))
    if unknown:
        raise ConfigError(f"{protocol}: expected options among {', '.join(known)}; got {', '.join(unknown)}")
    return kind(**options)

"""Scores of 3D detections: DDS (Cirrus), nuScenes, Argoverse 2, Waymo, KITTI, K-Radar, and those of other packages."""

from collections.abc import Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any

from farfield.frame.annotation import Annotation
from farfield.frame.drive import Key
from farfield.geometry.boxes import Boxes
from farfield.metrics.bootstrap import Bootstrap
from farfield.metrics.detections import PROTOCOLS, Detections, Protocol, protocol
from farfield.metrics.frames import BoxesByFrame, check_frames
from farfield.metrics.presenting import Presenter
from farfield.metrics.result import Result

if TYPE_CHECKING:
    from farfield.metrics.argoverse2.evaluation import Argoverse2Result, evaluate_argoverse2
    from farfield.metrics.argoverse2.settings import Argoverse2Settings
    from farfield.metrics.centre.dds import DdsResult, DdsSettings, evaluate_dds
    from farfield.metrics.centre.nuscenes import NuScenesResult, NuScenesSettings, evaluate_nuscenes
    from farfield.metrics.kitti.evaluation import KittiResult, KittiSettings, evaluate_kitti
    from farfield.metrics.kradar.evaluation import KRadarResult, evaluate_kradar
    from farfield.metrics.kradar.settings import KRadarSettings, kradar_settings
    from farfield.metrics.running import RunningMetric, running_metric
    from farfield.metrics.tracking.nuscenes import NuScenesTrackingResult, NuScenesTrackingSettings
    from farfield.metrics.tracking.protocol import TrackingResult
    from farfield.metrics.tracking.scene import TrackingSettings
    from farfield.metrics.waymo.evaluation import WaymoResult, evaluate_waymo
    from farfield.metrics.waymo.settings import WaymoLetSettings, WaymoSettings

__all__ = [
    "PROTOCOLS",
    "Argoverse2Result",
    "Argoverse2Settings",
    "Bootstrap",
    "DdsResult",
    "DdsSettings",
    "Detections",
    "KRadarResult",
    "KRadarSettings",
    "KittiResult",
    "KittiSettings",
    "NuScenesResult",
    "NuScenesSettings",
    "NuScenesTrackingResult",
    "NuScenesTrackingSettings",
    "Presenter",
    "Protocol",
    "Result",
    "RunningMetric",
    "TrackingResult",
    "TrackingSettings",
    "WaymoLetSettings",
    "WaymoResult",
    "WaymoSettings",
    "evaluate_argoverse2",
    "evaluate_dds",
    "evaluate_kitti",
    "evaluate_kradar",
    "evaluate_nuscenes",
    "evaluate_waymo",
    "kradar_settings",
    "protocol",
    "running_metric",
    "score",
    "scored_labels",
]

_MODULES = {
    "argoverse2.evaluation": ("Argoverse2Result", "evaluate_argoverse2"),
    "argoverse2.settings": ("Argoverse2Settings",),
    "centre.dds": ("DdsResult", "DdsSettings", "evaluate_dds"),
    "centre.nuscenes": ("NuScenesResult", "NuScenesSettings", "evaluate_nuscenes"),
    "kitti.evaluation": ("KittiResult", "KittiSettings", "evaluate_kitti"),
    "kradar.evaluation": ("KRadarResult", "evaluate_kradar"),
    "running": ("RunningMetric", "running_metric"),
    "kradar.settings": ("KRadarSettings", "kradar_settings"),
    "tracking.nuscenes": ("NuScenesTrackingResult", "NuScenesTrackingSettings"),
    "tracking.protocol": ("TrackingResult",),
    "tracking.scene": ("TrackingSettings",),
    "waymo.evaluation": ("WaymoResult", "evaluate_waymo"),
    "waymo.settings": ("WaymoLetSettings", "WaymoSettings"),
}
_METRICS = {
    "Argoverse2": "argoverse2",
    "DDS": "dds",
    "KITTI": "kitti",
    "KRadar": "kradar",
    "KRadarCompat": "kradar-compat",
    "NuScenes": "nuscenes",
    "NuScenesDetection": "nuscenes-detection",
    "NuScenesTracking": "nuscenes-tracking",
    "OpenSweeps": "open-sweeps",
    "TrackingMetric": "tracking",
    "Waymo": "waymo",
    "WaymoLET": "waymo-let",
}
"""Protocols that ship, by the names of their metrics in a loop; :func:`running_metric` takes any protocol."""
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Import what belongs to one protocol when it is used; ``DDS`` and its like are the metrics in a loop."""
    if name in _METRICS:
        kind: Any = import_module(f"{__name__}.running").metric_class(_METRICS[name])
        return kind
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)


def scored_labels(annotations: BoxesByFrame, protocol: str = "dds", **options: Any) -> tuple[str, ...]:
    """Classes that can be scored, the most annotated first: relabelled ones as one, ignored ones left out.

    K-Radar's protocols score the classes of their settings; those that occur are given.
    """
    return PROTOCOLS[protocol].labels(annotations, **options)


def score(
    predictions: BoxesByFrame,
    annotations: Mapping[Key, Boxes | Annotation],
    *,
    protocol: str | Protocol = "dds",
    conditions: Mapping[Key, Mapping[str, str]] | None = None,
    **settings: Any,
) -> Result:
    """Score predictions by any protocol; :class:`Detections` hold more of what is known.

    Args:
        predictions: Scored boxes by (sequence, frame). A frame without an entry has no detections.
        annotations: Annotated boxes by (sequence, frame), or annotations with all that is known of the boxes: every
            frame that counts, those without boxes too.
        protocol: ``"dds"``, ``"nuscenes"``, ``"argoverse2"``, ``"waymo"``, ``"waymo-let"``, ``"kitti"``, ``"kradar"``,
            ``"kradar-compat:VARIANT"``, a registered one, or the object.
        conditions: For K-Radar's protocols: weather, road and time of the frames.
        **settings: The protocol's settings: ``label`` (the class with most annotated boxes unless given, for K-Radar's
            protocols all that their settings name), ``range_bins_m``, ``region``, ``bootstrap``...

    Raises:
        ConfigError: If the protocol, a setting or the label is unknown, or frames do not pair.
    """
    full = {key: a if isinstance(a, Annotation) else Annotation(boxes=a) for key, a in annotations.items()}
    detections = Detections(boxes=predictions, annotations=full, conditions=conditions or {})
    check_frames(predictions, detections.annotated)
    return detections.score(protocol, **settings)

"""Maps on frames: functions of a frame and the frames before it, each with a name and settings that JSON takes."""

from collections.abc import Callable, Mapping
from typing import Any, Protocol, runtime_checkable

from pydantic import ValidationError

from farfield.errors import ConfigError, plain
from farfield.frame import Frame
from farfield.registry import Registry

Earlier = Callable[[int], Frame | None]
"""``earlier(k)`` is the k-th frame before the present one in its drive, k >= 1; None where there is none."""


@runtime_checkable
class FrameMap(Protocol):
    """A way to see frames: moved, with several sweeps, with another radar cloud.

    It is built from its settings as keywords, has them as a pydantic model in ``Settings``, and pickles. Optional
    attributes say more of it; without them nothing is assumed:

    - ``frames_before``: how many frames before the present one it reads, 0 if left out.
    - ``annotated(annotation)``: what becomes of an annotation alone, so that it can be read without building the frame.
    - ``keeps_annotation``: whether the annotation stays as it is, so that it can be read without building the frame.
    - ``moved_poses(poses)``: what becomes of the drives' ``world_T_frame``, shape (n, 4, 4); None where not known.
    - ``poses_of(keys)``: the poses that it gives the frames of a drive, shape (n, 4, 4), or None.
    - ``fits(dataset)``: whether a data set's frames can be seen so; True if left out.
    - ``overrules``: whether it takes the place of an earlier one of its name, as the view of a detector's training does
      of the user's; False if left out.
    """

    @property
    def name(self) -> str:
        """The name by which :func:`make` knows it; a plain attribute of its class will do."""

    def settings(self) -> Mapping[str, Any]:
        """Its settings, as JSON takes them."""

    def __call__(self, frame: Frame, earlier: Earlier) -> Frame:
        """The frame seen so; what is costly is left to the moment at which it is read."""


def none_before(k: int) -> Frame | None:
    """The frames before a frame that stands alone: none."""
    del k
    return None


def described(function: FrameMap) -> dict[str, Any]:
    """A map as JSON: ``{"name": ..., "settings": {...}}``."""
    return {"name": function.name, "settings": dict(function.settings())}


MAPS: Registry[Any] = Registry(
    "farfield.maps",
    "map of frames",
    {
        "annotated_field": "farfield.datasets.maps.annotations:AnnotatedField",
        "classes": "farfield.datasets.class_mapping:Classes",
        "common_radar": "farfield.datasets.maps.common_radar:CommonRadar",
        "coordinates": "farfield.datasets.maps.coordinates:Coordinates",
        "edited": "farfield.datasets.edits.edited:Edited",
        "labels_at": "farfield.datasets.maps.annotations:LabelsAt",
        "move": "farfield.datasets.maps.coordinates:Move",
        "posed": "farfield.datasets.maps.sweeps:Posed",
        "radar_view": "farfield.datasets.kradar.radar_cloud:RadarView",
        "separate_labels": "farfield.datasets.separate_labels:SeparateLabels",
        "sweeps": "farfield.datasets.maps.sweeps:Sweeps",
        "where": "farfield.datasets.maps.where:Fulfilling",
        "whole_bodies": "farfield.datasets.maps.annotations:WholeBodies",
    },
)


def make(name: str, settings: Mapping[str, Any]) -> FrameMap:
    """Make a map from its name and settings, such as a recipe has them.

    Args:
        name: One of :data:`MAPS`.
        settings: Its settings; those left out have their defaults.

    Raises:
        ConfigError: If there is no such map, or a setting is unknown or impossible.

    >>> make("sweeps", {"count": 4})
    Sweeps(count=4)
    """
    kind = MAPS[name]
    try:
        checked = kind.Settings.model_validate(dict(settings))
    except ValidationError as error:
        names = ", ".join(kind.Settings.model_fields)
        raise ConfigError(f"map {name!r}: {plain(error)}. It has the settings {names}.") from error
    function: FrameMap = kind(**checked.model_dump())
    return function

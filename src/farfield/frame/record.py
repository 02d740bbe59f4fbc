"""Frame: the one record that flows from readers and the simulator to detectors, metrics, reports and the studio.

Coordinates: right-handed, x forward, y left, z up, metres, in the frame of the sensor that ``reference`` names.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, Shaped, UInt8

from farfield.geometry.boxes import Boxes
from farfield.geometry.cameras import Camera
from farfield.geometry.points import points_in_boxes
from farfield.geometry.poses import transform_points

__all__ = ["Boxes", "Camera", "Cloud", "Frame", "Lazy"]


@dataclass(frozen=True, eq=False)
class Cloud:
    """A point cloud with whatever columns its file had.

    Args:
        points_m: x, y, z in metres, shape (n, 3), float32.
        intensity: Return strength in [0, 1], shape (n,), float32.
        extra: Further columns by name, each of shape (n,): ``ring``, ``time_ns``, ``extra0``...
    """

    points_m: Float32[np.ndarray, "n 3"]
    intensity: Float32[np.ndarray, " n"]
    extra: Mapping[str, Shaped[np.ndarray, " n"]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if len(self.points_m) != len(self.intensity) or any(len(v) != len(self.points_m) for v in self.extra.values()):
            raise ValueError(f"Cloud: expected columns of equal length, got {len(self.points_m)} points")

    def __len__(self) -> int:
        return len(self.points_m)

    def __getitem__(self, index: slice | Bool[np.ndarray, " n"] | Int[np.ndarray, " k"]) -> "Cloud":
        return Cloud(self.points_m[index], self.intensity[index], {k: v[index] for k, v in self.extra.items()})

    @classmethod
    def concatenate(cls, parts: "list[Cloud]") -> "Cloud":
        """Join clouds; only the extra columns that all of them have are kept."""
        shared = set.intersection(*(set(part.extra) for part in parts)) if parts else set()
        return cls(
            np.concatenate([part.points_m for part in parts]),
            np.concatenate([part.intensity for part in parts]),
            {name: np.concatenate([part.extra[name] for part in parts]) for name in sorted(shared)},
        )

    def transform(self, target_T_source: Float[np.ndarray, "4 4"]) -> "Cloud":
        """Move all points rigidly into another frame."""
        moved = transform_points(target_T_source, self.points_m.astype(np.float64)).astype(np.float32)
        return Cloud(moved, self.intensity, self.extra)

    def in_boxes(self, boxes: Boxes, *, margin_m: float = 0.0) -> list[Int[np.ndarray, " _"]]:
        """Indices of the points inside each box, one array a box."""
        return points_in_boxes(self.points_m, boxes, margin_m=margin_m)


class Lazy(Mapping[str, Any]):
    """A read-only mapping whose values are loaded at the first access and then kept.

    >>> clouds = Lazy({"gaussian": lambda: 42})
    >>> list(clouds), clouds["gaussian"]
    (['gaussian'], 42)
    """

    def __init__(self, loaders: Mapping[str, Callable[[], Any]]) -> None:
        self._loaders = dict(loaders)
        self._loaded: dict[str, Any] = {}

    def loader(self, key: str) -> Callable[[], Any]:
        """The function that loads the value of a key, which a further mapping may wrap."""
        return self._loaders[key]

    def __getitem__(self, key: str) -> Any:
        if key not in self._loaders:
            raise KeyError(f"{key!r}; present: {', '.join(self._loaders) or 'nothing'}")
        if key not in self._loaded:
            self._loaded[key] = self._loaders[key]()
        return self._loaded[key]

    def __contains__(self, key: object) -> bool:
        return key in self._loaders  # Mapping's own would load the value

    def __iter__(self) -> Iterator[str]:
        return iter(self._loaders)

    def __len__(self) -> int:
        return len(self._loaders)

    def __repr__(self) -> str:
        return f"Lazy({', '.join(key + ('' if key in self._loaded else ' (not loaded)') for key in self._loaders)})"


@dataclass(frozen=True, eq=False, kw_only=True)
class Frame:
    """One moment of one drive: what the sensors gave, what was annotated, and how it was taken.

    Args:
        sequence: Name of the drive or segment.
        frame_id: Name of the frame within its sequence.
        time_ns: Reference time in nanoseconds, or None.
        clouds: Point clouds by sensor or pattern (``"gaussian"``, ``"uniform"``, ``"lidar"``), loaded when read.
        images: Images by camera, shape (height, width, 3), uint8, loaded when read.
        cameras: Calibrations by camera; their poses refer to this frame's coordinates.
        annotation: Loads the annotated boxes; None where the frame has no annotation.
        world_T_lidar: Pose of the reference sensor, or None.
        times_ns: Time of each sensor's measurement, by the keys of ``clouds`` and ``images``.
        conditions: Weather, road, time of day...
        radar: Radar products by name, loaded when read.
        reference: Name of the sensor whose frame the coordinates are in.
        metadata: What else is known: source files, box protocol ("visible" or "full").
    """

    sequence: str
    frame_id: str
    time_ns: int | None = None
    clouds: Lazy | Mapping[str, Cloud] = field(default_factory=dict)
    images: Lazy | Mapping[str, UInt8[np.ndarray, "height width 3"]] = field(default_factory=dict)
    cameras: Mapping[str, Camera] = field(default_factory=dict)
    annotation: Callable[[], Boxes] | None = None
    world_T_lidar: Float[np.ndarray, "4 4"] | None = None
    times_ns: Mapping[str, int] = field(default_factory=dict)
    conditions: Mapping[str, str] = field(default_factory=dict)
    radar: Mapping[str, Any] = field(default_factory=dict)
    reference: str = "lidar"
    metadata: Lazy | Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, cloud: Cloud, boxes: Boxes | None = None, *, name: str = "lidar", **rest: Any) -> "Frame":
        """Make a frame from one cloud (and its boxes) already in memory."""
        rest = {"sequence": "memory", "frame_id": "0", **rest}
        return cls(clouds={name: cloud}, annotation=None if boxes is None else lambda: boxes, **rest)

    @property
    def key(self) -> tuple[str, str]:
        """(sequence, frame): what pairs predictions with annotations."""
        return self.sequence, self.frame_id

    @cached_property
    def boxes(self) -> Boxes | None:
        """The annotated boxes, loaded at the first access; None where nothing was annotated."""
        return None if self.annotation is None else self.annotation()

    def cloud(self, name: str | None = None) -> Cloud:
        """One cloud by name; without a name the only or first one; ``"merged"`` joins all of them.

        Raises:
            KeyError: If there is no such cloud.
        """
        if name == "merged" and "merged" not in self.clouds:
            return Cloud.concatenate([self.clouds[key] for key in self.clouds])
        if name is None:
            name = next(iter(self.clouds), None)
        if name is None or name not in self.clouds:
            raise KeyError(f"frame {self.key} has no cloud {name!r}; present: {', '.join(self.clouds) or 'none'}")
        return self.clouds[name]

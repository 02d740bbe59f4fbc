"""Frame: the one record that flows from readers and the simulator to detectors, metrics, reports and the studio.

Coordinates: right-handed, x forward, y left, z up, metres. All data stand in the frame's one set of coordinates, unless
their sensor says ``in_frame=False``.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Shaped, UInt8

from farfield.errors import ConfigError, MissingCloudError
from farfield.frame.annotation import Annotation, ImpossibleBoxError
from farfield.frame.cloud import Cloud
from farfield.frame.drive import Key
from farfield.geometry.arrays import Locked, locked
from farfield.geometry.boxes import Boxes
from farfield.geometry.cameras import Camera
from farfield.geometry.poses import check_rigid, invert
from farfield.registry import display_html

Pose = Float[np.ndarray, "4 4"]
Kind = Literal["lidar", "radar", "camera"]
_AHEAD, _BESIDE_RAD = 0.5, np.deg2rad(5.0)  # share of a camera's axis along x at least; between cameras alike
_NO_LENGTH = 1e-9  # metres, and parts of a unit vector: what inverting and multiplying poses leaves


class Constant:
    """A loader of a value that is in memory already; unlike a lambda it can be pickled.

    >>> Constant(42)()
    42
    """

    def __init__(self, value: Any) -> None:
        self.value = value

    def __call__(self) -> Any:
        """The value."""
        return self.value


class Lazy(Mapping[str, Any]):
    """A read-only mapping whose values are loaded at the first access and then kept; arrays are read-only too.

    It pickles if its loaders do (functools.partial of functions of a module, or :class:`Constant`); values that were
    loaded stay behind, so that frames travel light.

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
            self._loaded[key] = locked(self._loaders[key]())
        return self._loaded[key]

    def __contains__(self, key: object) -> bool:
        return key in self._loaders  # Mapping's own would load the value

    def __iter__(self) -> Iterator[str]:
        return iter(self._loaders)

    def __len__(self) -> int:
        return len(self._loaders)

    def __repr__(self) -> str:
        return f"Lazy({', '.join(key + ('' if key in self._loaded else ' (not loaded)') for key in self._loaders)})"

    def __getstate__(self) -> dict[str, Any]:
        return {"_loaders": self._loaders, "_loaded": {}}


@dataclass(frozen=True, eq=False, kw_only=True)
class Sensor(Locked):
    """Where a cloud, an image or a radar product comes from.

    Args:
        kind: What it is.
        frame_T_sensor: Maps the sensor's own coordinates to the frame's; None where it is not known.
        in_frame: Whether its data stand in the frame's coordinates; if not they keep the sensor's own axes, as images
            and radar products do.
        time_ns: Time of its measurement, or None.
        holds: Names of the sensors whose points are among this one's, such as single sweeps of an accumulated cloud.
        shots: How many pulses a LiDAR sends a frame, where that is known: what does not return has no point.
    """

    kind: Kind
    frame_T_sensor: Pose | None = None
    in_frame: bool = True
    time_ns: int | None = None
    holds: tuple[str, ...] = ()
    shots: int | None = None

    def __post_init__(self) -> None:
        self.lock()

    def __repr__(self) -> str:
        position = "at an unknown place"
        if self.frame_T_sensor is not None:
            position = f"at {', '.join(f'{metres:.2f}' for metres in self.frame_T_sensor[:3, 3])} m"
        return f"Sensor({self.kind}, {position}{'' if self.in_frame else ', in its own axes'})"

    def moved(self, target_T_frame: Pose) -> "Sensor":
        """The sensor as seen from other coordinates; one that then stands at their origin stands there exactly."""
        if self.frame_T_sensor is None:
            return self
        target_T_sensor = target_T_frame @ self.frame_T_sensor
        return replace(self, frame_T_sensor=np.eye(4) if _is_origin(target_T_sensor) else target_T_sensor)


def camera_sensor(camera: Camera | None, time_ns: int | None = None) -> Sensor:
    """The sensor of a camera: images keep its own axes (x right, y down, z forward)."""
    pose = None if camera is None else invert(camera.camera_T_lidar)
    return Sensor(kind="camera", frame_T_sensor=pose, in_frame=False, time_ns=time_ns)


@dataclass(frozen=True, eq=False, kw_only=True)
class Frame(Locked):
    """One moment of one drive: what the sensors gave, what was annotated, and how it was taken.

    Its arrays are read-only: a detector or a notebook that changes one makes a copy. It pickles, and travels light:
    what loads when it is read is loaded again by the receiver.

    Args:
        sequence: Name of the drive or segment.
        frame_id: Name of the frame within its sequence.
        time_ns: Reference time in nanoseconds, or None.
        reference: Name of the sensor whose frame the coordinates are in; with a ``'`` where they were moved away from
            it.
        sensors: What is known of the sensors, by the names of clouds, images and radar products.
        clouds: Point clouds by sensor or pattern (``"gaussian"``, ``"uniform"``, ``"lidar"``), loaded when read.
        images: Images by camera, shape (height, width, 3), uint8, loaded when read.
        radar: Radar products by name, loaded when read; each in its sensor's own axes.
        cameras: Calibrations by camera; their poses refer to this frame's coordinates.
        load_annotation: Loads what was annotated; None where the frame has no annotation.
        world_T_frame: Pose of the frame's coordinates, or None.
        conditions: Weather, road, time of day...
        indices: Number of each sensor's measurement in its recording, where sensors count apart (K-Radar).
        simulated: Whether it was simulated; None where nothing says so.
        metadata: What else is known, files and words for people; nothing that other code reads.
    """

    sequence: str
    frame_id: str
    time_ns: int | None = None
    reference: str = "lidar"
    sensors: Mapping[str, Sensor] = field(default_factory=dict)
    clouds: Lazy | Mapping[str, Cloud] = field(default_factory=dict)
    images: Lazy | Mapping[str, UInt8[np.ndarray, "height width 3"]] = field(default_factory=dict)
    radar: Lazy | Mapping[str, Any] = field(default_factory=dict)
    cameras: Mapping[str, Camera] = field(default_factory=dict)
    load_annotation: Callable[[], Annotation] | None = None
    world_T_frame: Pose | None = None
    conditions: Mapping[str, str] = field(default_factory=dict)
    indices: Mapping[str, int] = field(default_factory=dict)
    simulated: bool | None = None
    metadata: Lazy | Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.lock()

    @classmethod
    def of(
        cls,
        cloud: Cloud | Shaped[np.ndarray, "n columns"] | None = None,
        boxes: Boxes | Annotation | None = None,
        *,
        clouds: Mapping[str, Cloud] | None = None,
        name: str = "lidar",
        **rest: Any,
    ) -> "Frame":
        """Make a frame from one cloud, or several by name, and what was annotated, already in memory.

        The sensor of a cloud without intensities is a radar if the cloud has a radar's columns or its name begins with
        ``radar``; others are LiDARs, unless ``sensors`` says otherwise. The first one's kind also names the
        coordinates, unless ``reference`` does.

        Args:
            cloud: The only cloud, or its rows; see :meth:`Cloud.of`.
            boxes: What was annotated.
            clouds: Several clouds by name, in its place.
            name: What to call the only cloud.
            **rest: Further fields of the frame.

        Raises:
            ConfigError: If there is no cloud, or one and several are given.
        """
        cloud = cloud if cloud is None or isinstance(cloud, Cloud) else Cloud.of(np.asarray(cloud))
        named_clouds = dict(clouds or {}) if cloud is None else {name: cloud}
        if not named_clouds or (cloud is not None and clouds):
            raise ConfigError("Frame.of: expected one cloud, or clouds= with one or more by name; got none or both.")
        annotation = Annotation(boxes=boxes) if isinstance(boxes, Boxes) else boxes
        sensors = {
            key: Sensor(kind="radar" if entry.intensity is None and key.startswith("radar") else entry.kind)
            for key, entry in named_clouds.items()
        }
        usual = {"sequence": "memory", "frame_id": "0", "reference": next(iter(sensors.values())).kind}
        load = None if annotation is None else Constant(annotation)
        return cls(clouds=named_clouds, load_annotation=load, **{**usual, "sensors": sensors, **rest})

    @property
    def front_camera(self) -> str | None:
        """Name of the calibrated camera that looks ahead, along x: what layouts of one camera hold.

        Of those with a picture, where there is one, the first whose axis lies within 5 degrees of the one that lies
        nearest to x; the first of all where none looks ahead. None without a calibrated camera.
        """
        names = [name for name in self.cameras if name in self.images] or list(self.cameras)
        ahead = {name: float(self.cameras[name].camera_T_lidar[2, 0]) for name in names}
        best = max(ahead.values(), default=0.0)
        if best < _AHEAD:
            return next(iter(names), None)
        limit_rad = np.arccos(min(best, 1.0)) + _BESIDE_RAD
        return next(name for name in names if np.arccos(np.clip(ahead[name], -1, 1)) <= limit_rad)

    def __repr__(self) -> str:
        """Its name and what it holds, in one line; nothing is loaded for it."""
        held = {"cloud": self.clouds, "image": self.images, "radar": self.radar}
        parts = [
            f"{kind}{'s' if len(names) > 1 and kind != 'radar' else ''} {', '.join(names)}"
            for kind, names in held.items()
        ]
        parts = [part for part, names in zip(parts, held.values(), strict=True) if names]
        parts += ["annotated" if self.has_annotation else "not annotated"]
        parts += [f"{name} {value}" for name, value in self.conditions.items()]
        return f"Frame({self.sequence}/{self.frame_id}: {'; '.join(parts)})"

    def _repr_html_(self) -> str | None:
        """What a notebook shows: the frame from above, with its boxes."""
        return display_html("frame", self)

    @property
    def key(self) -> Key:
        """(sequence, frame): what pairs predictions with annotations."""
        return self.sequence, self.frame_id

    @property
    def has_annotation(self) -> bool:
        """Whether the frame was annotated; known without loading anything."""
        return self.load_annotation is not None

    @cached_property
    def annotation(self) -> Annotation | None:
        """What was annotated, loaded at the first access; None where nothing was: that is not "nothing there"."""
        try:
            return None if self.load_annotation is None else self.load_annotation()
        except ImpossibleBoxError as error:
            raise ImpossibleBoxError(f"frame {self.key}: {error}") from None

    @property
    def boxes(self) -> Boxes | None:
        """The annotated boxes; None where the frame was not annotated."""
        return None if self.annotation is None else self.annotation.boxes

    def annotated(self, annotation: Annotation | None) -> "Frame":
        """The same frame with another annotation, or with none."""
        return replace(self, load_annotation=None if annotation is None else Constant(annotation))

    def cloud(self, name: str | None = None) -> Cloud:
        """One cloud by name; without a name the only or first one.

        Raises:
            MissingCloudError: If there is no such cloud; it is a KeyError too.
        """
        if name is None:
            name = next(iter(self.clouds), None)
        if name is None or name not in self.clouds:
            raise MissingCloudError(
                f"frame {self.key} has no cloud {name!r}; present: {', '.join(self.clouds) or 'none'}"
            )
        cloud: Cloud = self.clouds[name]
        return cloud

    @property
    def reference_kind(self) -> Kind | None:
        """Kind of the sensor that ``reference`` names; where it names none, the kind of all clouds that stand in it."""
        named = self.sensors.get(self.reference.removesuffix("'"))
        if named is not None:
            return named.kind
        in_clouds = [self.sensors[name] for name in self.clouds if name in self.sensors]
        kinds = {sensor.kind for sensor in in_clouds if sensor.in_frame}
        return kinds.pop() if len(kinds) == 1 else None

    def time_ns_of(self, name: str) -> int | None:
        """Time of a sensor's measurement; the frame's where its own is not known."""
        sensor = self.sensors.get(name)
        return self.time_ns if sensor is None or sensor.time_ns is None else sensor.time_ns

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "annotation"}


def merge_clouds(frame: Frame, names: Sequence[str]) -> Cloud:
    """Join clouds of one frame; only the columns that all of them have are kept.

    Args:
        frame: The frame.
        names: Its clouds to join, in this order.

    Raises:
        KeyError: If the frame has no such cloud.
        ConfigError: If the clouds cannot be joined: of different kinds, one of them not in the frame's coordinates, or
            one that holds the points of another.
    """
    if not names or len(set(names)) < len(names):
        raise ConfigError(f"merge_clouds: expected the names of clouds, each once, got {', '.join(names) or 'none'}")
    absent = [name for name in names if name not in frame.clouds]
    if absent:
        frame.cloud(absent[0])  # raises
    unknown = [name for name in names if name not in frame.sensors]
    if unknown:
        raise ConfigError(
            f"merge_clouds: expected the sensor of each cloud in frame.sensors, got none of {unknown[0]!r}"
        )
    sensors = {name: frame.sensors[name] for name in names}
    if len({sensor.kind for sensor in sensors.values()}) > 1:
        what = ", ".join(f"{name} is of a {sensor.kind}" for name, sensor in sensors.items())
        raise ConfigError(f"merge_clouds: expected clouds of one kind of sensor; {what}. Leave one out.")
    for name, sensor in sensors.items():
        if not sensor.in_frame:
            raise ConfigError(
                f"merge_clouds: expected clouds in the frame's coordinates ({frame.reference}); {name} keeps its "
                "sensor's own. Leave it out, or move it by its frame_T_sensor if that is known."
            )
        held = [other for other in sensor.holds if other in sensors]
        if held:
            raise ConfigError(f"merge_clouds: {name} holds the points of {', '.join(held)} already; take one of them")
    return Cloud.concatenate([frame.cloud(name) for name in names])


def transform_frame(frame: Frame, target_T_frame: Pose, *, reference: str | None = None) -> Frame:
    """Express a frame in other coordinates.

    Clouds in the frame's coordinates, what was annotated, the sensors' and the cameras' poses and the pose in the world
    move. Data that keep their sensor's own axes (``in_frame=False``) stay as they are; their pose moves.

    Args:
        frame: The frame; its clouds stay unread until they are asked for.
        target_T_frame: Maps the frame's coordinates to the new ones.
        reference: Name of the sensor in whose coordinates the frame then stands. Left out, the old name stays if that
            sensor still stands at the origin, else it gets a ``'``: the coordinates are no longer its.

    Raises:
        ConfigError: If the motion is no rigid one, or ``reference`` names a sensor that would not stand at the origin.
    """
    check_rigid(target_T_frame, "transform_frame")
    frame_T_target = invert(target_T_frame)
    sensors = {name: sensor.moved(target_T_frame) for name, sensor in frame.sensors.items()}
    return replace(
        frame,
        reference=_reference(frame, sensors, target_T_frame) if reference is None else _checked(reference, sensors),
        sensors=sensors,
        clouds=Lazy({name: partial(_moved_cloud, frame, name, target_T_frame) for name in frame.clouds}),
        cameras={
            name: replace(camera, camera_T_lidar=camera.camera_T_lidar @ frame_T_target)
            for name, camera in frame.cameras.items()
        },
        load_annotation=None if frame.load_annotation is None else partial(_moved_annotation, frame, target_T_frame),
        world_T_frame=None if frame.world_T_frame is None else frame.world_T_frame @ frame_T_target,
    )


def _is_origin(pose: Pose) -> bool:
    return np.allclose(pose, np.eye(4), rtol=0.0, atol=_NO_LENGTH)


def _reference(frame: Frame, sensors: Mapping[str, Sensor], target_T_frame: Pose) -> str:
    """``lidar`` becomes ``lidar'``: coordinates that were moved are no longer that sensor's, unless it still fits."""
    own = frame.reference.removesuffix("'")
    pose = sensors[own].frame_T_sensor if own in sensors else None
    if pose is None:
        return frame.reference if _is_origin(target_T_frame) else own + "'"
    return own if _is_origin(pose) else own + "'"


def _checked(reference: str, sensors: Mapping[str, Sensor]) -> str:
    pose = sensors[reference].frame_T_sensor if reference in sensors else None
    if pose is not None and not _is_origin(pose):
        raise ConfigError(
            f"transform_frame: expected coordinates in which {reference} stands at the origin, but it would stand at "
            f"{np.round(pose[:3, 3], 3).tolist()}. Give the inverse of its frame_T_sensor, or leave reference out."
        )
    return reference


def _moved_cloud(frame: Frame, name: str, target_T_frame: Pose) -> Cloud:
    cloud: Cloud = frame.clouds[name]
    stays = name in frame.sensors and not frame.sensors[name].in_frame
    return cloud if stays else cloud.transform(target_T_frame)


def _moved_annotation(frame: Frame, target_T_frame: Pose) -> Annotation:
    annotation = frame.annotation
    assert annotation is not None  # the moved frame has a loader only where this one has
    return annotation.moved(target_T_frame)

"""What messages are made of: checked frozen dataclasses, bounded numbers, boxes, layers, frames, classes, predictions.

Lengths in metres, angles in radians.
"""

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, TypeVar, dataclass_transform

from pydantic import ConfigDict, Field

# Frozen dataclasses whose fields are checked, with nothing unknown among them

T = TypeVar("T")


@dataclass_transform(frozen_default=True, kw_only_default=True)
def message(cls: type[T]) -> type[T]:
    """Make a class a message: a frozen dataclass that pydantic checks strictly, without unknown fields, inf or NaN."""
    cls.__pydantic_config__ = ConfigDict(extra="forbid", allow_inf_nan=False)  # type: ignore[attr-defined]
    return dataclass(frozen=True, kw_only=True)(cls)


VERSION = 3
"""Of these messages; a page of another version is sent away with bye."""
MOST_FRAMES = 10_000_000

Name = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9._:+-]+$")]
"""An identity that a client makes up, or a name of ours: letters, digits and ``. _ - : +``."""
BoxName = Annotated[str, Field(min_length=1, max_length=96, pattern=r"^[A-Za-z0-9._:+-]+$")]
"""A box of a drive: the number of its frame, a colon, and its name within the frame."""
FileName = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9._-]+$")]
Word = Annotated[str, Field(max_length=128)]
Note = Annotated[str, Field(max_length=2000)]
Index = Annotated[int, Field(ge=0, lt=MOST_FRAMES)]
"""Number of a frame in the open data set."""
Track = Annotated[int, Field(ge=0, lt=2**31)]
Count = Annotated[int, Field(ge=0, lt=2**53)]
Nanoseconds = Annotated[str, Field(pattern=r"^-?[0-9]{1,20}$")]
"""int64 as text: 1.6e18 exceeds what a number of the browser holds exactly (2^53)."""
Place = Annotated[float, Field(ge=-1000.0, le=1000.0)]
Size = Annotated[float, Field(gt=0.0, le=60.0)]
Yaw = Annotated[float, Field(ge=-10.0, le=10.0)]
Part = Annotated[float, Field(ge=0.0, le=1.0)]

BoxNumbers = tuple[Place, Place, Place, Size, Size, Size, Yaw]
"""Centre x, y, z in metres, full length, width, height in metres, yaw in radians, as a client may set them."""
AnyBox = tuple[float, float, float, float, float, float, float]
"""The same as files hold them: within no bounds."""
Matrix = Annotated[tuple[float, ...], Field(min_length=16, max_length=16)]
"""A 4 x 4 matrix, row by row."""
Attributes = Annotated[dict[Word, Note | int | float | bool | None], Field(max_length=64)]


def plain(value: Any) -> Any:
    """A message as what JSON knows; much faster than ``dataclasses.asdict``, which copies."""
    if isinstance(value, str | int | float | bool) or value is None:
        return value
    if isinstance(value, dict):
        return {name: plain(item) for name, item in value.items()}
    if isinstance(value, tuple | list):
        return [plain(item) for item in value]
    return {name: plain(item) for name, item in vars(value).items()}


State = Literal["proposed", "edited", "accepted", "rejected"]
Source = Literal["lidar", "radar", "camera", "interpolated", "propagated", "predicted", "detector"]
Severity = Literal["info", "warning", "error"]
SensorKind = Literal["lidar", "radar", "camera"]
LayerKind = Literal["points", "bev", "bfs", "image"]
Match = Literal["matched", "false", "ignored", "unknown"]


@message
class BoxValue:
    """What a person decides about a box."""

    box: BoxNumbers
    class_name: Word
    track: Track | None = None
    state: State = "edited"
    source: Source = "lidar"
    attributes: Attributes = field(default_factory=dict)


@message
class BoxRow:
    """A box of a frame as it stands. No other of the data set has its ``id``; an edit gives ``version`` as ``base``."""

    id: str
    track: int | None
    class_name: str
    box: AnyBox
    version: int
    state: State
    source: Source
    attributes: Attributes = field(default_factory=dict)
    score: float | None = None
    points: int | None = None  # LiDAR points inside; None: not counted
    radar_points: int | None = None
    distance_m: float = 0.0  # of the centre from the origin, in the plane
    keyframe: bool = True  # False: the tool made it (interpolated, propagated, predicted)
    visibility: str | None = None
    moving: bool | None = None
    proposal: AnyBox | None = None  # the detector's box, kept beside what became of it


@message
class TrackRow:
    """An object over its frames. ``version`` is the ``base`` of track.set."""

    track: int
    class_name: str
    version: int
    size_locked: bool = False
    size: tuple[float, float, float] | None = None
    frames: tuple[int, ...] = ()
    keyframes: tuple[int, ...] = ()
    ends: int | None = None  # last frame, where a person said so


@message
class PlacedRow:
    """A box and the frame in which it stands."""

    frame: int
    row: BoxRow


@message
class RemovedRow:
    """A box that is no more."""

    frame: int
    id: str


@message
class UnwrittenRow:
    """A box that its label file cannot hold, and why; ``box`` None where it is the file as a whole."""

    frame: int
    box: str | None
    sentence: str


@message
class CameraModel:
    """A pinhole camera: ``matrix`` fx 0 cx / 0 fy cy / 0 0 1 (row by row), ``distortion`` k1 k2 p1 p2 k3."""

    width_px: int
    height_px: int
    matrix: tuple[float, ...]
    distortion: tuple[float, ...]
    camera_T_frame: Matrix


@message
class Polar:
    """Axes of a radar map: first value and step of range (m), azimuth and elevation (rad), and their counts.

    A BEV-2D has rows of range and columns of azimuth; a BFS-2D rows of elevation and columns of azimuth or range.
    """

    range_m: tuple[float, float, int]
    azimuth_rad: tuple[float, float, int]
    elevation_rad: tuple[float, float, int] | None = None


@message
class Grid:
    """Axes of a map in metres along the sensor's own axes: first value, step and count; a BFS-2D has rows of z."""

    x_m: tuple[float, float, int] | None = None
    y_m: tuple[float, float, int] | None = None
    z_m: tuple[float, float, int] | None = None


@message
class Layer:
    """Something to show of a frame: fetched from ``url`` (relative to the page)."""

    id: int
    name: str
    title: str
    kind: LayerKind
    sensor: SensorKind
    url: str
    fields: tuple[str, ...] = ()  # columns to colour points by: intensity, ring, lag_s, doppler_m_s, power, pattern
    frame_T_layer: Matrix | None = None  # None: not known, or not needed (its data stand in the frame)
    placed: bool = True  # False: the data keep their sensor's axes and no pose is known
    time_ns: Nanoseconds | None = None
    lag_ms: float | None = None  # its time less the frame's
    sweeps: int = 1
    camera: CameraModel | None = None
    polar: Polar | None = None
    grid: Grid | None = None  # of a map in metres; either this or ``polar``
    holds: tuple[str, ...] = ()  # layers whose points are among this one's
    file: str = ""  # its file, relative to the data set


@message
class FrameInfo:
    """One moment of one drive."""

    index: int
    sequence: str
    frame_id: str
    time_ns: Nanoseconds | None = None
    reference: str = "lidar"
    conditions: dict[str, str] = field(default_factory=dict)
    world_T_frame: Matrix | None = None
    annotated: bool = True
    simulated: bool | None = None
    metadata: dict[str, str] = field(default_factory=dict)


@message
class DriveRow:
    """A drive: which frames of the data set, in time order."""

    name: str
    frames: tuple[int, ...]
    times_ns: tuple[Nanoseconds, ...] | None = None


@message
class ClassSpec:
    """A class: its preset size, where that is from, its colour (``#rrggbb``); ``types`` are finer sizes, as of vans."""

    name: str
    title: str
    size: tuple[Size, Size, Size]
    colour: str
    key: str = ""  # the digit that sets it
    group: Literal["vehicle", "person", "two_wheeler", "other"] = "vehicle"
    types: tuple["TypeSpec", ...] = ()
    source: str = ""


@message
class TypeSpec:
    """A kind of vehicle within a class, with its own preset size."""

    name: str
    size: tuple[Size, Size, Size]


@message
class CheckRow:
    """Something that a check found. ``id`` stays the same as long as the finding does."""

    id: str
    frame: int
    box: str | None
    track: int | None
    check: str
    severity: Severity
    sentence: str
    ignored: str | None = None  # the reason that a person gave
    at: tuple[float, float] | None = None  # x and y in the frame


@message
class PredictionSet:
    """Boxes of a detector or a tracker, from a file or made here."""

    name: str
    title: str
    kind: Literal["detections", "tracks"]
    classes: tuple[str, ...] = ()
    frames: int = 0
    protocol: str = ""  # by which they are matched with the truth
    colour: str = "#e69f00"


@message
class PredictedRow:
    """A predicted box, and what the protocol makes of it."""

    class_name: str
    box: AnyBox
    score: float | None = None
    track: int | None = None
    velocity: tuple[float, float] | None = None
    match: Match = "unknown"
    truth: str | None = None  # the annotated box that it found
    distance_m: float = 0.0
    points: int | None = None


@message
class PredictedFrame:
    """What a set predicts in a frame. A truth found only below the page's threshold counts as missed there."""

    set: str
    rows: tuple[PredictedRow, ...]
    missed: tuple[str, ...] = ()  # annotated boxes that no prediction found
    ignored: tuple[str, ...] = ()  # annotated boxes that the protocol does not count


@message
class MatchRow:
    """How many annotated boxes of a frame a set misses, and how many of its boxes have no truth."""

    frame: int
    missed: int
    wrong: int


@message
class Trail:
    """Where a track was and will be: frame, x, y, z in the coordinates of the frame shown."""

    set: str  # "" for annotations
    track: int
    points: tuple[tuple[int, float, float, float], ...]


@message
class Bookmark:
    """A frame to come back to."""

    frame: int
    note: str = ""
    by: str = ""


@message
class DetectorRow:
    """A detector on offer."""

    name: str
    title: str
    classes: tuple[str, ...] = ()
    cloud: str = ""

"""The messages of the calibration pages, ``calib.*``: what the page sends, and what it gets."""

from typing import Annotated, Literal

from pydantic import Field

from farfield.studio.messages.rows import CameraModel, Count, Index, Name, Place, Word, Yaw, message

CalibrationKind = Literal["radar-lidar", "lidar-camera"]
Focal = Annotated[float, Field(ge=10.0, le=100_000.0)]
Pixel = Annotated[float, Field(ge=-100_000.0, le=100_000.0)]
Coefficient = Annotated[float, Field(ge=-10.0, le=10.0)]
Offset = Annotated[int, Field(ge=-20, le=20)]
"""Radar frames."""
Late = Annotated[float, Field(ge=-1.0, le=1.0)]
"""Seconds."""
MOST_PICKS = 500


@message
class RadarValues:
    """``p_radar = R(yaw) p_lidar + (x, y, z)``; the radar runs ``frames`` frames and ``time_offset_s`` ahead."""

    x_m: Place
    y_m: Place
    z_m: Place
    yaw_rad: Yaw
    frames: Offset
    time_offset_s: Late


@message
class CameraValues:
    """Intrinsics in pixels, k1 k2 p1 p2 k3, and turns in rad about, shifts in m along the axes (right, down, ahead)."""

    fx: Focal
    fy: Focal
    cx: Pixel
    cy: Pixel
    distortion: tuple[Coefficient, Coefficient, Coefficient, Coefficient, Coefficient]
    moved: tuple[Yaw, Yaw, Yaw, Place, Place, Place]


@message
class CalibOpen:
    """Ask for the calibration as it stands; the first one begins to read the frames."""

    op: Literal["calib.open"] = "calib.open"
    id: Name


@message
class CalibMatch:
    """Ask for the residuals of some values, while they move; nothing is kept."""

    op: Literal["calib.match"] = "calib.match"
    id: Name
    frame: Index
    radar: RadarValues | None = None
    camera: CameraValues | None = None
    full: bool = False  # with sigma: takes longer, for values at rest


@message
class CalibSet:
    """Take values: one step of undo. ``base`` is the state's ``seq`` from which they come."""

    op: Literal["calib.set"] = "calib.set"
    id: Name
    base: Count
    radar: RadarValues | None = None
    camera: CameraValues | None = None


@message
class CalibPick:
    """Add a pair: a point of a frame, in the LiDAR's coordinates, and its pixel."""

    op: Literal["calib.pick"] = "calib.pick"
    id: Name
    frame: Index
    point_m: tuple[Place, Place, Place]
    pixel: tuple[Pixel, Pixel]


@message
class CalibUnpick:
    """Take a pair away, or leave it out (``used``) or take it in again."""

    op: Literal["calib.unpick"] = "calib.unpick"
    id: Name
    pick: Count
    used: bool | None = None  # None: away with it


@message
class CalibSolve:
    """Solve from the present values: by matched objects, by picked pairs, or by edges."""

    op: Literal["calib.solve"] = "calib.solve"
    id: Name
    how: Literal["objects", "pairs", "edges"]
    focal: bool = False  # of pairs: the focal length too


@message
class CalibCancel:
    """Stop a job."""

    op: Literal["calib.cancel"] = "calib.cancel"
    id: Name
    job: Name


@message
class CalibUndo:
    """Take the last change back, or do it again."""

    op: Literal["calib.undo"] = "calib.undo"
    id: Name
    what: Literal["undo", "redo"]


@message
class CalibSave:
    """Write the calibration: where the data set's reader finds it, or into the folder of results."""

    op: Literal["calib.save"] = "calib.save"
    id: Name
    to: Literal["data", "folder"]


@message
class CalibRestore:
    """Put back what the last save replaced."""

    op: Literal["calib.restore"] = "calib.restore"
    id: Name


@message
class CalibFrame:
    """A frame that serves."""

    index: int
    name: str
    number: int  # of the sweep; the radar frame that belongs to it has this number plus the offset


@message
class PickRow:
    """A picked pair and how far its point falls from its pixel."""

    pick: int
    frame: int
    point_m: tuple[float, float, float]
    pixel: tuple[float, float]
    used: bool
    residual_px: float | None
    range_m: float


@message
class Known:
    """How well a parameter is known: ``observed`` is the data's share of what is known, 0 to 1."""

    name: str
    unit: str
    sigma: float | None  # None: not known at all
    prior: float
    observed: float


@message
class Figure:
    """A number to show."""

    name: str
    value: float | None
    unit: str


@message
class Bars:
    """A histogram: ``limits`` has one number more than ``counts``."""

    limits: tuple[float, ...]
    counts: tuple[int, ...]
    unit: str


@message
class ResidualPoint:
    """The residual of one matched object, with what it may depend on."""

    range_m: float
    azimuth_rad: float
    speed_m_s: float
    off_m: float
    off_rad: float


@message
class MatchedPair:
    """An object of both sensors in the frame that is shown, in the radar's coordinates."""

    lidar_m: tuple[float, float]
    radar_m: tuple[float, float]


@message
class Residuals:
    """What the data say of some values."""

    figures: tuple[Figure, ...] = ()
    histogram: Bars | None = None
    known: tuple[Known, ...] = ()
    notes: tuple[str, ...] = ()  # what the data cannot tell, a sentence each
    objects: tuple[ResidualPoint, ...] = ()
    pairs: tuple[MatchedPair, ...] = ()
    lacking: str = ""  # why there are no residuals


@message
class OffsetScore:
    """By how many standard errors a frame offset explains the objects worse than the chosen one."""

    frames: int
    worse: float


@message
class CalibState:
    """The calibration as it stands."""

    op: Literal["calib.state"] = "calib.state"
    kind: CalibrationKind
    answers: str  # the request that made it so
    seq: int
    ready: bool
    radar: RadarValues | None
    camera: CameraValues | None
    before: RadarValues | CameraValues  # at the start
    stored: RadarValues | None  # takes the radar's points, as they are sent, back into the radar's coordinates
    start: CameraModel | None  # from which the camera's moves are counted
    sensor: Word
    lidar: Word
    frames: tuple[CalibFrame, ...]
    numbers: dict[str, int]  # frames of the sequence by the number of their sweep
    picks: tuple[PickRow, ...]
    solved: str  # what was solved last, in words; empty where values were set by hand since
    offsets: tuple[OffsetScore, ...]
    notes: tuple[str, ...]
    undo: bool
    redo: bool
    unsaved: bool
    restorable: bool
    saves_to: tuple[str, ...]  # files of the data set that a save writes
    not_saved: str  # what the data set's files have no place for
    folder: str


@message
class CalibResidual:
    """Residuals of the values that were asked for."""

    op: Literal["calib.residual"] = "calib.residual"
    id: str
    frame: int
    residuals: Residuals
    milliseconds: float


@message
class CalibSaved:
    """Files were written or put back."""

    op: Literal["calib.saved"] = "calib.saved"
    id: str
    files: tuple[str, ...]
    copies: tuple[str, ...]
    restored: bool = False


CalibRequest = (
    CalibOpen
    | CalibMatch
    | CalibSet
    | CalibPick
    | CalibUnpick
    | CalibSolve
    | CalibCancel
    | CalibUndo
    | CalibSave
    | CalibRestore
)
"""What a calibration page sends."""
CalibReply = CalibState | CalibResidual | CalibSaved
"""What it gets."""

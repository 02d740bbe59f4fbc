"""What the server sends."""

import json
from typing import Any, Literal

from farfield.studio.messages.calibration import CalibReply
from farfield.studio.messages.rows import (
    AnyBox,
    Bookmark,
    BoxRow,
    CheckRow,
    ClassSpec,
    DetectorRow,
    DriveRow,
    FrameInfo,
    Layer,
    MatchRow,
    Nanoseconds,
    PlacedRow,
    PredictedFrame,
    PredictionSet,
    RemovedRow,
    TrackRow,
    Trail,
    message,
    plain,
)

VERSION = 1
"""Of these messages; a page of another version is sent away with bye."""


@message
class Welcome:
    """Answer to hello: what is open."""

    op: Literal["welcome"] = "welcome"
    version: int = VERSION
    farfield: str
    mode: Literal["view", "annotate", "calibrate"]
    data: str  # name of the data set
    title: str
    frames: int
    drives: tuple[DriveRow, ...]
    labels: tuple[str, ...]  # "sequence/frame" of every frame; empty above 20,000 frames
    classes: tuple[ClassSpec, ...]
    predictions: tuple[PredictionSet, ...]
    detectors: tuple[DetectorRow, ...]
    protocols: tuple[str, ...]
    bookmarks: tuple[Bookmark, ...]
    tracks: tuple[TrackRow, ...]
    annotator: str
    window: str
    windows: int
    journal_seq: int
    extent: Literal["full", "visible"] | None
    first: int = 0  # frame to show first
    formats: tuple[str, ...] = ()  # in which labels can be saved
    saves_to: str = ""
    undo: bool = False
    redo: bool = False


@message
class FrameState:
    """A frame as it stands: boxes, layers, predictions with their matching, trails."""

    op: Literal["frame.state"] = "frame.state"
    frame: FrameInfo
    layers: tuple[Layer, ...]
    boxes: tuple[BoxRow, ...]
    predicted: tuple[PredictedFrame, ...] = ()
    trails: tuple[Trail, ...] = ()
    notes: tuple[str, ...] = ()  # what is missing and why, a sentence each


@message
class Predicted:
    """What a set predicts in a frame, where it became known after the frame was opened."""

    op: Literal["predicted"] = "predicted"
    frame: int
    predicted: PredictedFrame
    set: PredictionSet


@message
class Ack:
    """An edit is on the disk. Its rows follow in ``changed`` where the tool made them."""

    op: Literal["ack"] = "ack"
    id: str
    seq: int
    version: int
    saved_ns: Nanoseconds
    row: BoxRow | None = None
    undo: bool = True
    redo: bool = False


@message
class Conflict:
    """An edit came too late: somebody changed the box since ``base``. Nothing was changed."""

    op: Literal["conflict"] = "conflict"
    id: str
    by: str
    sentence: str
    frame: int | None = None
    present: BoxRow | None = None  # None: the box is gone
    track: TrackRow | None = None


@message
class Refused:
    """A message was understood and refused."""

    op: Literal["refused"] = "refused"
    id: str | None
    code: str
    sentence: str
    mend: str = ""


@message
class Changed:
    """Boxes and tracks as they now stand, after an edit of another window, of a tool, or an undo (sent to all)."""

    op: Literal["changed"] = "changed"
    seq: int
    id: str
    by: str
    window: str
    rows: tuple[PlacedRow, ...] = ()
    removed: tuple[RemovedRow, ...] = ()
    tracks: tuple[TrackRow, ...] = ()
    show: int | None = None  # frame to go to, for the window that asked
    sentence: str = ""
    undo: bool = True
    redo: bool = False


@message
class Previewed:
    """A box that somebody else is dragging."""

    op: Literal["previewed"] = "previewed"
    window: str
    frame: int
    box: str
    value: AnyBox


@message
class Candidate:
    """A box that was found, the best first."""

    box: AnyBox
    score: float


@message
class Fitted:
    """Answer to fit; ``box`` None with a sentence where nothing was found."""

    op: Literal["fitted"] = "fitted"
    id: str
    frame: int
    box: AnyBox | None
    points: int = 0
    candidates: tuple[Candidate, ...] = ()
    ms: float = 0.0
    sentence: str = ""
    source: Literal["lidar", "radar"] = "lidar"


@message
class Checks:
    """Findings of a frame, or of all frames (``frame`` None)."""

    op: Literal["checks"] = "checks"
    frame: int | None
    rows: tuple[CheckRow, ...]


@message
class Matches:
    """Frames of one set, matched by the protocol. They come in parts; the first one replaces what was known."""

    op: Literal["matches"] = "matches"
    set: str
    first: bool
    rows: tuple[MatchRow, ...]


@message
class Job:
    """Progress of something that takes time. A finished detection is shown with the next frame.state."""

    op: Literal["job"] = "job"
    id: str
    job: str
    kind: Literal["infer", "export", "save", "calibrate"]
    state: Literal["queued", "running", "done", "cancelled", "failed"]
    done: int = 0
    total: int = 0
    eta_s: float | None = None
    message: str = ""
    url: str = ""  # of the file that an export made
    set: PredictionSet | None = None


@message
class Bookmarks:
    """All bookmarks."""

    op: Literal["bookmarks"] = "bookmarks"
    rows: tuple[Bookmark, ...]


@message
class Saved:
    """Label files were written."""

    op: Literal["saved"] = "saved"
    id: str
    seq: int
    files: int
    saved_ns: Nanoseconds
    folder: str
    sentence: str = ""


@message
class Windows:
    """How many windows are open, and who else is there."""

    op: Literal["windows"] = "windows"
    count: int
    annotators: tuple[str, ...] = ()


@message
class PolicyIs:
    """What the boxes hold: declared."""

    op: Literal["policy"] = "policy"
    extent: Literal["full", "visible"]


@message
class Failure:
    """Something went wrong: what, and how to fix it."""

    op: Literal["error"] = "error"
    sentence: str
    mend: str = ""


@message
class Bye:
    """The server stops, or the page is of another version."""

    op: Literal["bye"] = "bye"
    reason: str


Reply = (
    Welcome
    | FrameState
    | Predicted
    | Ack
    | Conflict
    | Refused
    | Changed
    | Previewed
    | Fitted
    | Checks
    | Matches
    | Job
    | Bookmarks
    | Saved
    | Windows
    | PolicyIs
    | Failure
    | Bye
    | CalibReply
)
"""Whatever the server sends."""


def write_reply(reply: Any) -> str:
    """A message to the page as JSON text.

    Raises:
        ValueError: If a number is not finite.
    """
    return json.dumps(plain(reply), separators=(",", ":"), allow_nan=False)

"""What the server sends."""

import json
from typing import Any, Literal

from farfield.studio.messages.calibration import CalibReply
from farfield.studio.messages.rows import (
    VERSION,
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
    UnwrittenRow,
    message,
    plain,
)


@message
class LabelState:
    """What the label files hold of the journal, and where, in which format and when the next save writes."""

    op: Literal["labels"] = "labels"
    answers: str = ""  # the request that made it so
    unwritten: int  # edits of boxes that are in the journal only
    written_ns: Nanoseconds | None = None  # of the last save; None: there was none
    folder: str = ""  # where that wrote to, in words
    format: str = ""
    left: int = 0  # boxes that it could not write
    next_folder: str  # where the next one writes to, in words
    next_format: str
    name: str | None = None  # of the folder that was chosen
    itself: bool = False  # whether labels are also written every half minute
    at_exit: bool = False


@message
class Welcome:
    """Answer to hello: what is open."""

    op: Literal["welcome"] = "welcome"
    version: int = VERSION
    farfield: str
    mode: Literal["view", "annotate", "calibrate"]
    data: str  # name of the data set
    store: str  # tells this annotation from others that the same address serves at other times; no path
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
    written: LabelState | None = None
    drive: str = ""  # whose tracks those are
    undo: bool = False
    redo: bool = False


@message
class FrameState:
    """A frame as it stands: boxes, layers, predictions with their matching, trails.

    ``seq`` is the number of the last edit that it holds for sure.
    """

    op: Literal["frame.state"] = "frame.state"
    frame: FrameInfo
    layers: tuple[Layer, ...]
    boxes: tuple[BoxRow, ...]
    predicted: tuple[PredictedFrame, ...] = ()
    trails: tuple[Trail, ...] = ()
    notes: tuple[str, ...] = ()  # what is missing and why, a sentence each
    unreadable: str = ""  # why nothing of the frame can be shown; empty: it can
    seq: int = 0


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
    unwritten: int = 0  # edits of boxes that are in the journal only


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
    """Boxes and tracks as they now stand, after an edit of another window, of a tool, or an undo (sent to all).

    Its own window gets it before the ack. ``drive`` is that of the tracks.
    """

    op: Literal["changed"] = "changed"
    seq: int
    id: str
    by: str
    window: str
    rows: tuple[PlacedRow, ...] = ()
    removed: tuple[RemovedRow, ...] = ()
    tracks: tuple[TrackRow, ...] = ()
    drive: str = ""
    show: int | None = None  # frame to go to, for the window that asked
    sentence: str = ""
    undo: bool = True
    redo: bool = False
    unwritten: int = 0  # edits of boxes that are in the journal only


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
class Proposals:
    """How many proposals of a score or more there are: ``seq`` is the ``base``, the counts are those of box.accept."""

    op: Literal["proposals"] = "proposals"
    id: str
    frame: int
    score: float
    seq: int
    here: int  # in the frame
    count: int  # in its drive
    frames: int  # of the drive that have any
    first: int  # frame of the drive
    last: int


@message
class Checks:
    """Findings of a frame that is shown."""

    op: Literal["checks"] = "checks"
    frame: int
    rows: tuple[CheckRow, ...]


@message
class DriveChecks:
    """Findings of some frames of a drive, in place of what was known of these; for windows that asked by check.list.

    They come in parts, while the drive is checked and after each edit. ``drive`` is empty for frames of none.
    """

    op: Literal["drive.checks"] = "drive.checks"
    drive: str
    frames: tuple[int, ...]
    rows: tuple[CheckRow, ...]
    done: int  # frames that are checked with their points
    total: int


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
    answers: str = ""  # the request that made them so


@message
class Saved:
    """Label files were written; ``unwritten`` boxes stay in the journal only, with what their files held before."""

    op: Literal["saved"] = "saved"
    id: str
    seq: int
    files: int
    saved_ns: Nanoseconds
    folder: str
    sentence: str = ""
    unwritten: tuple[UnwrittenRow, ...] = ()


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
    | LabelState
    | FrameState
    | Predicted
    | Ack
    | Conflict
    | Refused
    | Changed
    | Previewed
    | Fitted
    | Proposals
    | Checks
    | DriveChecks
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

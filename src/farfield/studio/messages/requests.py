"""What the page sends. ``id`` is the page's own: a message sent again after a lost reply is recognised by it."""

import json
import re
from functools import lru_cache
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter, ValidationError

from farfield.errors import ConfigError, fault_of
from farfield.studio.messages.calibration import CalibRequest
from farfield.studio.messages.rows import (
    VERSION,
    BoxName,
    BoxNumbers,
    BoxValue,
    Count,
    FileName,
    Index,
    Name,
    Note,
    Part,
    Place,
    Size,
    Track,
    Word,
    message,
)


@message
class Hello:
    """First message of a window."""

    op: Literal["hello"] = "hello"
    window: Name
    annotator: Word = ""
    version: int = VERSION


@message
class FrameOpen:
    """Show a frame: answered by frame.state, then by checks. ``threshold`` bounds the predicted boxes sent.

    ``purpose`` ahead: only the state, the window still shows another frame; here: the page has the state already.
    """

    op: Literal["frame.open"] = "frame.open"
    frame: Index
    threshold: Part = 0.0
    sweeps: Annotated[int, Field(ge=1, le=20)] = 1
    purpose: Literal["show", "ahead", "here"] = "show"


@message
class BoxSet:
    """Change a box; ``base`` is the version that the page saw. ``group`` joins edits that undo together."""

    op: Literal["box.set"] = "box.set"
    id: Name
    frame: Index
    box: BoxName
    base: Count
    value: BoxValue
    group: Name | None = None


@message
class BoxAdd:
    """Add a box under an identity that the page makes up.

    ``fresh``: its track is to be a new object's; where the drive has one of this number by now, the box gets another.
    """

    op: Literal["box.add"] = "box.add"
    id: Name
    frame: Index
    box: BoxName
    value: BoxValue
    group: Name | None = None
    fresh: bool = False


@message
class BoxDelete:
    """Remove a box."""

    op: Literal["box.delete"] = "box.delete"
    id: Name
    frame: Index
    box: BoxName
    base: Count
    group: Name | None = None


@message
class BoxAccept:
    """Accept all proposals of ``score`` or more from frame ``first`` to ``last``, in the drive of ``frame``.

    ``count`` and ``base`` are those of the answer to proposals.count: what was told of is accepted, nothing else.
    """

    op: Literal["box.accept"] = "box.accept"
    id: Name
    frame: Index
    first: Index
    last: Index
    score: Part
    count: Count
    base: Count


@message
class TrackSet:
    """Set what holds for a track of a frame's drive: class, locked size, last frame. ``ends`` -1: no end.

    None leaves as it is. ``box``, of version ``box_base``, is that of the track that was shown in the frame.
    """

    op: Literal["track.set"] = "track.set"
    id: Name
    frame: Index
    track: Track
    base: Count
    class_name: Word | None = None
    size_locked: bool | None = None
    size: tuple[Size, Size, Size] | None = None
    ends: Annotated[int, Field(ge=-1)] | None = None
    box: BoxName
    box_base: Count


@message
class TrackMerge:
    """Make one track of a frame's drive a part of another. ``box``, of version ``box_base``: shown in the frame."""

    op: Literal["track.merge"] = "track.merge"
    id: Name
    frame: Index
    track: Track
    into: Track
    base: Count
    into_base: Count
    box: BoxName
    box_base: Count


@message
class TrackSplit:
    """Give the boxes of a track from a frame on a new number. ``box``, of version ``box_base``: shown in the frame."""

    op: Literal["track.split"] = "track.split"
    id: Name
    track: Track
    frame: Index
    new_track: Track
    base: Count
    box: BoxName
    box_base: Count


@message
class TrackInterpolate:
    """Fill the frames between keyframes, from ``first`` to ``last``.

    ``box`` is that of the track in the ``frame`` that was shown, ``base`` its version there.
    """

    op: Literal["track.interpolate"] = "track.interpolate"
    id: Name
    frame: Index
    box: BoxName
    base: Count
    track: Track
    first: Index
    last: Index


@message
class TrackPropagate:
    """Carry a track on by its motion, from frame ``first`` to ``last`` (backwards if it is smaller).

    ``box`` is that of the track in ``first``, ``base`` its version that was shown. To the next frame it always comes:
    where its points do not decide, its motion does, and the box's source is ``predicted``.
    """

    op: Literal["track.propagate"] = "track.propagate"
    id: Name
    box: BoxName
    base: Count
    track: Track
    first: Index
    last: Index
    fit: bool = True


@message
class Preview:
    """A box while it is dragged: passed on to the other windows, stored nowhere."""

    op: Literal["preview"] = "preview"
    frame: Index
    box: BoxName
    value: BoxNumbers


@message
class Fit:
    """Find a box at a gesture. ``at``: click x y; drag x0 y0 x1 y1 along the heading; rectangle: four corners x y.

    ``kind`` refit takes ``around`` (the box as it stands); peak is a radar's peak at x y.
    """

    op: Literal["fit"] = "fit"
    id: Name
    frame: Index
    kind: Literal["click", "drag", "rectangle", "refit", "peak"]
    at: Annotated[tuple[Place, ...], Field(max_length=8)] = ()
    class_name: Word
    type_name: Word = ""
    track: Track | None = None
    around: BoxNumbers | None = None
    keep_size: bool = False


@message
class Undo:
    """Take back the last edit of mine (or of anybody)."""

    op: Literal["undo"] = "undo"
    id: Name
    scope: Literal["mine", "all"] = "mine"
    force: bool = False  # also where somebody else changed the object since


@message
class Redo:
    """Do again what was taken back last."""

    op: Literal["redo"] = "redo"
    id: Name
    scope: Literal["mine", "all"] = "mine"
    force: bool = False


@message
class ProposalsCount:
    """Ask how many proposals of a score or more a frame and its drive have; answered by proposals."""

    op: Literal["proposals.count"] = "proposals.count"
    id: Name
    frame: Index
    score: Part


@message
class CheckList:
    """Ask for the findings of the whole drive of a frame, and to be told from then on what changes of them."""

    op: Literal["check.list"] = "check.list"
    frame: Index


@message
class CheckIgnore:
    """Let a finding stand, with a reason; an empty reason brings it back."""

    op: Literal["check.ignore"] = "check.ignore"
    id: Name
    check: Annotated[str, Field(min_length=1, max_length=200)]
    reason: Note


@message
class InferStart:
    """Detect in frames; ``propose`` adds the boxes above the threshold as proposals to the annotation."""

    op: Literal["infer.start"] = "infer.start"
    id: Name
    detector: Word
    first: Index
    last: Index
    threshold: Part = 0.1
    propose: bool = False


@message
class InferCancel:
    """Stop a job."""

    op: Literal["infer.cancel"] = "infer.cancel"
    id: Name
    job: Name


@message
class BookmarkSet:
    """Bookmark a frame; ``note`` None takes the bookmark away."""

    op: Literal["bookmark.set"] = "bookmark.set"
    id: Name
    frame: Index
    note: Note | None = ""


@message
class SaveChoose:
    """Choose where labels are written to and in which format, for all windows, and whether also when the studio ends.

    ``format`` empty: their own; ``folder``: a name beside the data set's other saves; None: where saves go.
    """

    op: Literal["save.choose"] = "save.choose"
    id: Name
    format: Word = ""
    folder: FileName | None = None
    at_exit: bool = False


@message
class Save:
    """Write the label files now, as :class:`SaveChoose` has it where neither format nor folder is given."""

    op: Literal["save"] = "save"
    id: Name
    format: Word = ""
    folder: FileName | None = None


@message
class Export:
    """Make a file to take away: ``html`` of frames, a film of pictures sent to /shot, or labels in a format."""

    op: Literal["export"] = "export"
    id: Name
    kind: Literal["html", "gif", "webp", "labels"]
    frames: Annotated[tuple[Index, ...], Field(max_length=100_000)] = ()
    format: Word = ""
    name: FileName = "export"
    shots: Annotated[tuple[Name, ...], Field(max_length=2000)] = ()
    rate_hz: Annotated[float, Field(gt=0.0, le=60.0)] = 10.0


@message
class PolicySet:
    """Declare once what the boxes of the data set hold: whole bodies or visible parts."""

    op: Literal["policy.set"] = "policy.set"
    id: Name
    extent: Literal["full", "visible"]


@message
class Timing:
    """Time that a person spent on a box: from its selection to the next, pauses left out."""

    op: Literal["timing"] = "timing"
    frame: Index
    box: BoxName
    seconds: Annotated[float, Field(ge=0.0, le=3600.0)]
    edits: Count = 0


@message
class MatchList:
    """Ask in which frames boxes are missed or detected without a truth: of predictions from a score on."""

    op: Literal["match.list"] = "match.list"
    threshold: Part = 0.0


Edit = BoxSet | BoxAdd | BoxDelete | BoxAccept | TrackSet | TrackMerge | TrackSplit | TrackInterpolate | TrackPropagate
"""What changes the annotation, and is answered by ack, conflict or refused."""


def frame_of(edit: Edit | ProposalsCount) -> int:
    """The frame that was shown when an edit was made: it changes nothing of other drives."""
    return edit.first if isinstance(edit, TrackPropagate) else edit.frame


def group_of(edit: Edit) -> str | None:
    """What joins an edit with others that undo together; only edits of boxes have it."""
    return edit.group if isinstance(edit, BoxSet | BoxAdd | BoxDelete) else None


Request = Annotated[
    Hello
    | FrameOpen
    | BoxSet
    | BoxAdd
    | BoxDelete
    | BoxAccept
    | TrackSet
    | TrackMerge
    | TrackSplit
    | TrackInterpolate
    | TrackPropagate
    | Preview
    | Fit
    | Undo
    | Redo
    | ProposalsCount
    | CheckList
    | CheckIgnore
    | InferStart
    | InferCancel
    | BookmarkSet
    | SaveChoose
    | Save
    | Export
    | PolicySet
    | Timing
    | MatchList
    | CalibRequest,
    Field(discriminator="op"),
]
"""Whatever the page sends."""


@lru_cache(maxsize=1)
def _adapter() -> Any:
    return TypeAdapter(Request)


_MOST_TEXT = 1 << 20


def id_of(text: str | bytes) -> str | None:
    """The ``id`` by which its sender knows a message that :func:`read_request` refuses; None where it has none."""
    try:  # NaN, halves of characters, digits without end: what may have been refused
        fields = json.loads(text, parse_int=str) if len(text) <= _MOST_TEXT else None
    except (ValueError, RecursionError):
        return None
    id = fields.get("id") if isinstance(fields, dict) else None
    return id if isinstance(id, str) and re.fullmatch(r"[A-Za-z0-9._:+-]{1,64}", id) else None


def read_request(text: str | bytes) -> Any:
    """A message of the page.

    Args:
        text: JSON, one object with the field ``op``.

    Raises:
        ConfigError: If it is no such message: unknown field or op, wrong kind, out of bounds, inf or NaN.
    """
    try:
        return _adapter().validate_json(text, strict=True)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        where = ".".join(map(str, first["loc"])) or "message"
        raise ConfigError(f"message refused: {where}: {fault_of(first)}") from None

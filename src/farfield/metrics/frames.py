"""Predicted and annotated boxes by frame: what the protocols share before they part."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import chain
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.errors import ConfigError
from farfield.frame.drive import Drive, Key
from farfield.geometry.boxes import Boxes

BoxesByFrame = Mapping[Key, Boxes]


def in_range(boxes: Boxes, low_m: float, high_m: float) -> Bool[np.ndarray, " n"]:
    """Which boxes' 2D range lies in [low, high)."""
    range_m = boxes.range_m
    return (range_m >= low_m) & (range_m < high_m)


def check_frames(predictions: BoxesByFrame, annotations: BoxesByFrame) -> None:
    """Raise ConfigError if there are predictions in frames that are not annotated."""
    strangers = [key for key in predictions if key not in annotations]
    if strangers:
        raise ConfigError(
            f"predictions: expected frames that are annotated, got {len(strangers)} others, the first "
            f"{strangers[0]}. For a frame annotated as empty give an entry with no boxes."
        )


def flatten(parts: Iterable[Boxes], *, scored: bool) -> Boxes:
    """Join the boxes of many frames, one part at a time; it drops what a score does not need.

    Raises:
        ConfigError: If scores are asked for and some box has none.
    """
    names = ("centre_m", "size_m", "yaw_rad", "label", "score" if scored else "point_count")
    columns: dict[str, list[Any]] = {name: [] for name in names}
    counted = False
    for part in parts:
        if not len(part.yaw_rad):
            continue
        if scored:
            check_scores(part)
        counted |= part.point_count is not None
        for name, column in columns.items():
            values = getattr(part, name)
            column.append(np.full(len(part), -1) if values is None else values)
    if not columns["yaw_rad"]:
        return Boxes.empty(scored=scored)
    if not scored and not counted:
        del columns["point_count"]
    return Boxes(**{name: np.concatenate(columns.pop(name)) for name in names if name in columns})


def check_scores(boxes: Boxes) -> None:
    """Raise ConfigError if predicted boxes have no scores."""
    if boxes.score is None and len(boxes.yaw_rad):
        raise ConfigError("predictions: expected a score for every box, got boxes without scores")


def has_label(boxes: Boxes, label: str, relabel: Mapping[str, str]) -> Bool[np.ndarray, " n"]:
    """Which boxes bear a label after relabelling."""
    names = [name for name in {label, *relabel} if relabel.get(name, name) == label]
    mask = np.zeros(len(boxes), dtype=bool)
    for name in names:
        mask |= boxes.label == name
    return mask


def group_frames(keys: Sequence[Key], drives: Sequence[Drive] = ()) -> tuple[Int[np.ndarray, " frames"], str]:
    """Group frames for resampling: by drive where drives are known, else by the name of the sequence.

    Each frame stands for itself where there is only one group.

    Args:
        keys: (sequence, frame) of the frames.
        drives: Drives of the data; frames of none of them are grouped by sequence.
    """
    drive_of = {key: number_of_drive for number_of_drive, drive in enumerate(drives) for key in drive.keys}
    number: dict[int | str, int] = {}
    group = np.array([number.setdefault(drive_of.get(key, key[0]), len(number)) for key in keys], dtype=np.int64)
    return (group, "sequences") if len(number) > 1 else (np.arange(len(keys)), "frames")


@runtime_checkable
class ScoredRegion(Protocol):
    """What the settings of every protocol say of the region, see :class:`CentreSettings`."""

    @property
    def region(self) -> Literal["window", "range", "none"]:
        """Which region counts."""

    @property
    def range_bins_m(self) -> tuple[float, ...]:
        """Edges of the range bins."""

    @property
    def window_m(self) -> tuple[float, float, float, float]:
        """Bounds of the window: x from, x to, y from, y to."""


def in_region(boxes: Boxes, settings: ScoredRegion) -> Bool[np.ndarray, " n"]:
    """Which boxes lie in the region that counts."""
    if settings.region == "none":
        return np.ones(len(boxes), dtype=bool)
    inside = in_range(boxes, settings.range_bins_m[0], settings.range_bins_m[-1])
    if settings.region == "window":
        x_from, x_to, y_from, y_to = settings.window_m
        x, y = boxes.centre_m[:, 0], boxes.centre_m[:, 1]
        inside &= (x >= x_from) & (x <= x_to) & (y >= y_from) & (y <= y_to)
    return inside


def labels_of(parts: Mapping[Key, Boxes], relabel: Mapping[str, str]) -> Iterator[tuple[str, int]]:
    """Class names after relabelling with their numbers of boxes, most frequent first."""
    yield from sorted(count_labels(parts, relabel).items(), key=lambda item: (-item[1], item[0]))


def count_labels(parts: Mapping[Key, Boxes], relabel: Mapping[str, str]) -> dict[str, int]:
    """Class names after relabelling with their numbers of boxes, in the order in which they come first."""
    labels = chain.from_iterable(np.asarray(boxes.label).tolist() for boxes in parts.values())
    counts: dict[str, int] = {}
    for name, count in Counter(labels).items():
        name = relabel.get(name, name)
        counts[name] = counts.get(name, 0) + count
    return counts


def nearest_first(boxes: Boxes, frame: Int[np.ndarray, " n"] | None = None) -> Int[np.ndarray, " n"]:
    """An order of boxes that does not depend on that of a file's lines, shape (n,): the nearer to the origin first.

    At one range x, then y, z, sizes, heading and class decide: boxes that still tie are the same.

    Args:
        boxes: The boxes.
        frame: What comes before the range, such as the frame of each.
    """
    label = np.unique(boxes.label, return_inverse=True)[1].reshape(-1)
    columns = (label, boxes.yaw_rad, *boxes.size_m.T[::-1], *boxes.centre_m.T[::-1], boxes.range_m)
    return np.lexsort(columns if frame is None else (*columns, frame))


def frame_order(key: Key) -> tuple[str, int, int, str]:
    """Sort key of a frame, under which frame "9" stands before frame "10"."""
    sequence, frame = key
    number = frame.isascii() and frame.isdigit() and len(frame) <= 20
    return (sequence, 0, int(frame), frame) if number else (sequence, 1, 0, frame)


def frames_in_order(predictions: BoxesByFrame, annotations: Mapping[Key, object], ties: str) -> list[Key]:
    """The annotated frames in the order that decides between equal scores of several frames.

    Args:
        predictions: Boxes by frame, in the order of their file.
        annotations: The frames that count.
        ties: ``"later_first"`` takes the predictions' own order first, as the nuScenes devkit does; any other value
            that of the frames' names.
    """
    keys = sorted(annotations, key=frame_order)
    if ties != "later_first":
        return keys
    return [*dict.fromkeys([*(key for key in predictions if key in annotations), *keys])]


MAX_BOXES = 5_000
"""Boxes of a frame on either side: no detector leaves so many."""
MAX_PAIRS = 250_000
"""Pairs of an annotated and a predicted box of a frame that may touch: 500 boxes that all lie upon one another."""
_PAIRS_AT_ONCE = 2_000_000


def check_crowd(where: str, count: int) -> None:
    """Refuse a frame of more boxes than can be paired.

    Args:
        where: The frame, for messages.
        count: Its boxes, predicted or annotated.

    Raises:
        ConfigError: If there are more than :data:`MAX_BOXES`.
    """
    if count > MAX_BOXES:
        raise ConfigError(f"{where}: expected at most {MAX_BOXES:,} boxes in a frame, got {count:,}. {_CROWD_FIX}")


_CROWD_FIX = "Suppress doubled boxes, leave out those of low scores, or write the frames apart."


def near_pairs(
    a_owner: Int[np.ndarray, " n"],
    b_owner: Int[np.ndarray, " m"],
    owners: int,
    measure: Callable[[Int[np.ndarray, "p 2"]], Float[np.ndarray, " p"]],
    frame_of_owner: Callable[[int], Key],
) -> tuple[Int[np.ndarray, "q 2"], Float[np.ndarray, " q"]]:
    """The pairs of boxes of one owner that are near by some measure, in the order of :func:`same_owner`.

    Args:
        a_owner: Frame, or frame and class, of each annotated box.
        b_owner: Likewise of each predicted box, sorted.
        owners: How many owners there are.
        measure: How near the boxes of some pairs are, above 0 where they are.
        frame_of_owner: The frame of an owner, for messages.

    Returns:
        Pairs (annotated, predicted) and their measures.

    Raises:
        ConfigError: If a frame has more than :data:`MAX_PAIRS` of them.
    """
    pairs, values = [], []
    count = np.zeros(owners, dtype=np.int64)
    for block in pairs_of_owners(a_owner, b_owner, owners):
        pair = np.column_stack(block)
        value = measure(pair)
        pairs.append(pair[value > 0])
        values.append(value[value > 0])
        count += np.bincount(a_owner[pairs[-1][:, 0]], minlength=owners)
        if count.max(initial=0) > MAX_PAIRS:
            raise ConfigError(
                f"frame {frame_of_owner(int(count.argmax()))}: expected at most {MAX_PAIRS:,} pairs of an annotated "
                f"and a predicted box that may touch, got more. {_CROWD_FIX}"
            )
    return np.concatenate(pairs), np.concatenate(values)


def pairs_of_owners(
    a_owner: Int[np.ndarray, " n"], b_owner: Int[np.ndarray, " m"], owners: int
) -> Iterator[tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]]:
    """The pairs of :func:`same_owner`, in the same order, in blocks that do not fill the memory; at least one block."""
    partners = np.cumsum(np.bincount(b_owner, minlength=owners)[a_owner])
    start = 0
    while True:
        before = int(partners[start - 1]) if start else 0
        stop = max(int(np.searchsorted(partners, before + _PAIRS_AT_ONCE, side="right")), min(start + 1, len(a_owner)))
        a, b = same_owner(a_owner[start:stop], b_owner, owners)
        yield a + start, b
        start = stop
        if start >= len(a_owner):
            return


def same_owner(
    a_owner: Int[np.ndarray, " n"], b_owner: Int[np.ndarray, " m"], owners: int
) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
    """All pairs of a row of ``a`` with a row of ``b`` of the same owner; the rows of ``b`` are sorted by owner."""
    count = np.bincount(b_owner, minlength=owners)
    start = np.cumsum(count) - count
    partners = count[a_owner]
    a = np.repeat(np.arange(len(a_owner)), partners)
    return a, np.arange(len(a)) - np.repeat(np.cumsum(partners) - partners, partners) + np.repeat(
        start[a_owner], partners
    )

"""What people hold boxes in, as :class:`Boxes`: one door for arrays, dictionaries, tables and boxes."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Shaped

from farfield.errors import ConfigError
from farfield.files.tables import columns_in
from farfield.geometry.boxes import Boxes

_ROWS = ("boxes", "labels", "scores")
"""The keys of one frame as torchmetrics has them."""
_TAKES = (
    "Boxes, rows (n, 7) of x, y, z, length, width, height, yaw in metres and radians (n, 8 with the score last), a "
    "dictionary with boxes, scores and labels, or a table with the columns label, x, y, z, l, w, h, yaw_rad"
)


def boxes_of(value: Any, what: str, *, scored: bool, label: str = "vehicle", classes: Sequence[str] = ()) -> Boxes:
    """Boxes of one frame.

    Args:
        value: Boxes; rows of shape (n, 7), or (n, 8) with scores; ``{"boxes": rows, "scores": ..., "labels": ...}``;
            or a table, such as a DataFrame, with the columns of our CSV files. Tensors on the CPU count as arrays.
        what: What they are, for messages, such as ``"predicted"``.
        scored: Whether each must have a score.
        label: Class of boxes that name none.
        classes: Names by number, where labels are numbers.

    Raises:
        ConfigError: If it is nothing of these, a score is missing, or places, sizes or angles cannot be what they are
            taken for.
    """
    if isinstance(value, Boxes):
        boxes = value
    elif isinstance(value, Mapping) and "boxes" in value:
        unknown = sorted(set(map(str, value)) - set(_ROWS))
        if unknown:
            raise ConfigError(f"{what}: expected the keys {', '.join(_ROWS)}, got {', '.join(unknown)} too")
        names = value.get("labels")
        boxes = _of_rows(
            value["boxes"], what, label if names is None else _names(names, classes, what), value.get("scores")
        )
    elif (columns := columns_in(value)) is not None:
        boxes = Boxes.from_pandas(columns)
    elif isinstance(value, str | bytes) or value is None:
        raise ConfigError(f"{what}: expected {_TAKES}; got {type(value).__name__}")
    else:
        boxes = _of_rows(value, what, label, None)
    if scored and boxes.score is None and len(boxes):
        raise ConfigError(f"{what}: expected a score for every box, got boxes without: rows (n, 8) end with it")
    return Boxes.empty(scored=True) if scored and not len(boxes) else boxes


def _of_rows(value: Any, what: str, label: Any, scores: Any) -> Boxes:
    try:
        rows = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, RuntimeError) as error:
        reason = f" ({error})" if "cuda" in str(error).lower() else ""
        raise ConfigError(f"{what}: expected {_TAKES}; got {type(value).__name__}{reason}") from None
    if rows.size == 0:
        return Boxes.empty(scored=True)
    if rows.ndim != 2 or rows.shape[1] not in (7, 8) or (rows.shape[1] == 8 and scores is not None):
        raise ConfigError(f"{what}: expected {_TAKES}; got an array of shape {rows.shape}")
    score = rows[:, 7] if rows.shape[1] == 8 else None if scores is None else np.asarray(scores, dtype=np.float64)
    if score is not None and not ((score >= 0) & (score <= 1)).all():
        raise ConfigError(
            f"{what}: expected scores in [0, 1], got {np.nanmin(score):g} to {np.nanmax(score):g}"
            + (": is the last of the eight columns the score?" if rows.shape[1] == 8 else "")
        )
    try:
        return Boxes.from_numpy(rows[:, :7], label=label, score=score)
    except ValueError as error:
        raise ConfigError(f"{what}: {error}. Columns are x, y, z, length, width, height, yaw") from None


def _names(labels: Any, classes: Sequence[str], what: str) -> Shaped[np.ndarray, " n"]:
    values = np.asarray(labels)
    if values.dtype.kind in "US" or not values.size:
        return values.astype(np.str_)
    if values.dtype.kind not in "iu":
        raise ConfigError(f"{what}: expected labels that are names or whole numbers, got {values.dtype}")
    if not classes or values.min() < 0 or values.max() >= len(classes):
        raise ConfigError(
            f"{what}: expected names as labels, or numbers and classes=(...) that names them; got numbers "
            f"{values.min()} to {values.max()} and {len(classes)} classes"
        )
    return np.asarray(classes, dtype=np.str_)[values]

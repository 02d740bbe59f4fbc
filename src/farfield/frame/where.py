"""Conditions on frames and objects, as ``--where 'range_m > 100 and weather == "sleet"'`` states them.

A condition is read with Python's own grammar and then walked over a short list of allowed parts: names of columns,
numbers, texts, comparisons, ``in``, ``and``, ``or``, ``not`` and brackets. Nothing is evaluated by the interpreter, and
a name that is no column is refused before any frame is read.
"""

import ast
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import Any

import numpy as np
from jaxtyping import Bool, Shaped

from farfield.errors import ConfigError, did_you_mean
from farfield.frame.annotation import Annotation
from farfield.geometry.boxes import Boxes

FRAME_COLUMNS = {
    "sequence": "name of the sequence",
    "frame": "name of the frame",
    "weather": "as the data set has it: normal, fog, rain, sleet, light_snow, heavy_snow...",
    "road": "as the data set has it: highway, urban...",
    "time": "day or night",
}
OBJECT_COLUMNS = {
    "label": "class",
    "range_m": "distance from the origin, seen from above, m",
    "bearing_deg": "direction, counter-clockwise from straight ahead, degrees",
    "x_m": "ahead, m",
    "y_m": "to the left, m",
    "z_m": "upwards, m",
    "length_m": "m",
    "width_m": "m",
    "height_m": "m",
    "yaw_deg": "heading, counter-clockwise from straight ahead, degrees",
    "speed_m_s": "over ground, m/s; no comparison holds where it is not known",
}
ANNOTATED_COLUMNS = {
    "points": "points of the cloud inside; no comparison holds where they were not counted",
    "track_id": "identity over time; none where not known",
    "visibility": "which sensor sees it, as K-Radar has it",
    "occlusion": "as the labels have it",
    "truncation": "as the labels have it",
}
"""Columns of annotated boxes that predicted ones do not have."""
COLUMNS = (*FRAME_COLUMNS, *OBJECT_COLUMNS, *ANNOTATED_COLUMNS)
"""All names that a condition may use."""

_MOST_CHARACTERS, _MOST_PARTS = 1000, 200
_COMPARISONS: Mapping[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}
_ORDERED = (ast.Lt, ast.LtE, ast.Gt, ast.GtE)
_TEXTS = {*FRAME_COLUMNS, "label", "visibility"}

Columns = Mapping[str, Shaped[np.ndarray, " n"]]


@dataclass(frozen=True)
class Where:
    """A condition that was read and checked.

    Args:
        text: As it was written.

    Raises:
        ConfigError: If it is no condition, uses what is not allowed, a name that is no column, or compares a text with
            a number.

    >>> Where('range_m > 100 and weather == "sleet"').columns == {"range_m", "weather"}
    True
    """

    text: str

    def __post_init__(self) -> None:
        if len(self.text) > _MOST_CHARACTERS:
            raise ConfigError(f"--where: expected at most {_MOST_CHARACTERS} characters, got {len(self.text)}")
        try:
            tree = ast.parse(self.text.strip(), mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            raise ConfigError(f"--where: expected a condition such as {_EXAMPLE}, got {self.text!r}") from None
        if sum(1 for _ in ast.walk(tree)) > _MOST_PARTS:
            raise ConfigError(f"--where: expected at most {_MOST_PARTS} parts, got more")
        _check(tree)

    @cached_property
    def _tree(self) -> ast.expr:
        return ast.parse(self.text.strip(), mode="eval").body

    @property
    def columns(self) -> set[str]:
        """The columns that it compares."""
        return {node.id for node in ast.walk(self._tree) if isinstance(node, ast.Name)}

    @property
    def of_frames(self) -> bool:
        """Whether it says something of frames alone."""
        return self.columns <= set(FRAME_COLUMNS)

    def holds(self, columns: Columns, count: int) -> Bool[np.ndarray, " n"]:
        """Where it holds, shape (n,).

        Args:
            columns: The columns by name; one that is absent is not known, and no comparison with it holds.
            count: Number of rows n.
        """
        return _holds(self._tree, columns, count)

    def of_boxes(
        self, boxes: Boxes, key: tuple[str, str], conditions: Mapping[str, str], annotation: Annotation | None = None
    ) -> Bool[np.ndarray, " n"]:
        """For which boxes of a frame it holds, shape (n,).

        Args:
            boxes: The boxes.
            key: Sequence and name of their frame.
            conditions: The frame's weather, road and time, where known.
            annotation: What else is known of the boxes, where they are annotated ones.
        """
        return self.holds(columns_of_boxes(boxes, key, conditions, annotation), len(boxes))

    def of_frame(self, key: tuple[str, str], conditions: Mapping[str, str]) -> bool:
        """Whether it can hold for any object of a frame: with what is known of the frame alone."""
        rows = {name: np.array([value]) for name, value in _frame_values(key, conditions).items()}
        return bool(_possible(self._tree, rows)[0])


_EXAMPLE = "'range_m > 100 and weather == \"sleet\"'"


def columns_of_boxes(
    boxes: Boxes, key: tuple[str, str], conditions: Mapping[str, str], annotation: Annotation | None = None
) -> dict[str, Shaped[np.ndarray, " n"]]:
    """The columns that a condition may use, of the boxes of one frame; what is not known is left out.

    Arguments are those of :meth:`Where.of_boxes`.
    """
    count = len(boxes)
    columns: dict[str, Any] = {name: np.full(count, value) for name, value in _frame_values(key, conditions).items()}
    columns |= dict(zip(("x_m", "y_m", "z_m"), boxes.centre_m.T, strict=True))
    columns |= dict(zip(("length_m", "width_m", "height_m"), boxes.size_m.T, strict=True))
    columns |= {"label": boxes.label, "range_m": boxes.range_m, "yaw_deg": np.degrees(boxes.yaw_rad)}
    columns["bearing_deg"] = np.degrees(np.arctan2(boxes.centre_m[:, 1], boxes.centre_m[:, 0]))
    if boxes.velocity_m_s is not None:
        columns["speed_m_s"] = np.hypot(boxes.velocity_m_s[:, 0], boxes.velocity_m_s[:, 1])
    if boxes.point_count is not None:
        columns["points"] = np.where(boxes.point_count < 0, np.nan, boxes.point_count)
    if boxes.track_id is not None:
        columns["track_id"] = np.where(boxes.track_id < 0, np.nan, boxes.track_id)
    if annotation is not None:
        if annotation.visibility is not None:
            columns["visibility"] = np.asarray(annotation.visibility, dtype=np.str_)
        for name in ("occlusion", "truncation"):
            values = annotation.details.get(name)
            if values is not None and np.ndim(values) == 1 and np.asarray(values).dtype.kind in "iufb":
                columns[name] = np.asarray(values, dtype=np.float64)
    return columns


def _frame_values(key: tuple[str, str], conditions: Mapping[str, str]) -> dict[str, str]:
    return {"sequence": key[0], "frame": key[1]} | {
        name: str(value) for name, value in conditions.items() if name in FRAME_COLUMNS
    }


def _check(node: ast.expr) -> None:
    """Refuse all but the allowed parts."""
    if isinstance(node, ast.BoolOp):
        for value in node.values:
            _check(value)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        _check(node.operand)
    elif isinstance(node, ast.Compare):
        sides = [node.left, *node.comparators]
        for left, operation, right in zip(sides, node.ops, sides[1:], strict=False):
            _check_comparison(left, operation, right)
    elif isinstance(node, ast.Name):
        _check_column(node.id)
        raise ConfigError(f"--where: expected a comparison of {node.id}, such as {node.id} == ..., got it alone")
    else:
        raise ConfigError(f"--where: expected a condition such as {_EXAMPLE}, got {ast.unparse(node)[:80]!r}")


def _check_comparison(left: ast.expr, operation: ast.cmpop, right: ast.expr) -> None:
    if isinstance(operation, ast.In | ast.NotIn):
        if not isinstance(right, ast.Tuple | ast.List | ast.Set):
            raise ConfigError(f"--where: expected a list behind in, such as (1, 2), got {ast.unparse(right)[:80]!r}")
        others = list(right.elts)
    elif type(operation) in _COMPARISONS:
        others = [right]
    else:
        raise ConfigError("--where: expected <, <=, >, >=, ==, != or in between a column and a value, got another sign")
    kinds = [_kind(side) for side in (left, *others)]
    names = [side.id for side in (left, *others) if isinstance(side, ast.Name)]
    if not names:
        raise ConfigError(f"--where: expected a column on one side of each comparison, got {ast.unparse(left)[:40]!r}")
    if len(set(kinds)) > 1 or (kinds[0] == "text" and isinstance(operation, _ORDERED)):
        expected = "== or != and a text in quotes" if names[0] in _TEXTS else "a number"
        raise ConfigError(
            f"--where: expected {expected} beside {names[0]}, got {' and '.join(ast.unparse(o)[:40] for o in others)}"
        )


def _kind(node: ast.expr) -> str:
    """Whether a side of a comparison is a text or a number."""
    if isinstance(node, ast.Name):
        _check_column(node.id)
        return "text" if node.id in _TEXTS else "number"
    value = _constant(node)
    return "text" if isinstance(value, str) else "number"


def _constant(node: ast.expr) -> str | float:
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        value = _constant(node.operand)
        if isinstance(value, str):
            raise ConfigError(f"--where: expected a number behind the minus, got {value!r}")
        return -value
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    number = node.value if isinstance(node, ast.Constant) else None
    if isinstance(number, int | float) and not isinstance(number, bool) and abs(number) <= 1e18:
        return float(number)
    raise ConfigError(f"--where: expected a column, a number or a text in quotes, got {ast.unparse(node)[:80]!r}")


def _check_column(name: str) -> None:
    if name not in COLUMNS:
        meant = did_you_mean(name, COLUMNS) or (" A text stands in quotes." if name.islower() else "")
        raise ConfigError(f"--where: expected columns among {', '.join(COLUMNS)}; got {name}.{meant}")


def _holds(node: ast.expr, columns: Columns, count: int) -> Bool[np.ndarray, " n"]:
    if isinstance(node, ast.BoolOp):
        join = np.logical_and if isinstance(node.op, ast.And) else np.logical_or
        return reduce(join, (_holds(value, columns, count) for value in node.values))
    if isinstance(node, ast.UnaryOp):
        return ~_holds(node.operand, columns, count)
    assert isinstance(node, ast.Compare)
    sides = [node.left, *node.comparators]
    pairs = zip(sides, node.ops, sides[1:], strict=False)
    return reduce(np.logical_and, (_compared(left, op, right, columns, count) for left, op, right in pairs))


def _compared(
    left: ast.expr, operation: ast.cmpop, right: ast.expr, columns: Columns, count: int
) -> Bool[np.ndarray, " n"]:
    if isinstance(operation, ast.In | ast.NotIn):
        assert isinstance(right, ast.Tuple | ast.List | ast.Set)
        equal = [_compared(left, ast.Eq(), item, columns, count) for item in right.elts]
        inside = reduce(np.logical_or, equal, np.zeros(count, dtype=bool))
        return ~inside & _is_known(left, columns, count) if isinstance(operation, ast.NotIn) else inside
    if not (_is_known(left, columns, count).all() and _is_known(right, columns, count).all()):
        certain = _is_known(left, columns, count) & _is_known(right, columns, count)
        if not certain.any():
            return np.zeros(count, dtype=bool)
    else:
        certain = np.ones(count, dtype=bool)
    compared = _COMPARISONS[type(operation)](_values(left, columns), _values(right, columns))
    return np.broadcast_to(np.asarray(compared, dtype=bool), (count,)) & certain


def _is_known(side: ast.expr, columns: Columns, count: int) -> Bool[np.ndarray, " n"]:
    """In which rows a side of a comparison has a value."""
    if not isinstance(side, ast.Name):
        return np.ones(count, dtype=bool)
    if side.id not in columns:
        return np.zeros(count, dtype=bool)
    values = np.asarray(columns[side.id])
    return ~np.isnan(values) if values.dtype.kind == "f" else np.ones(count, dtype=bool)


def _values(side: ast.expr, columns: Columns) -> Any:
    return columns[side.id] if isinstance(side, ast.Name) else _constant(side)


def _possible(node: ast.expr, columns: Columns) -> Bool[np.ndarray, " n"]:
    """Whether a condition may hold where only some columns are given: comparisons of others may."""
    if isinstance(node, ast.BoolOp):
        join = np.logical_and if isinstance(node.op, ast.And) else np.logical_or
        return reduce(join, (_possible(value, columns) for value in node.values))
    names = {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}
    return np.ones(1, dtype=bool) if not names <= set(FRAME_COLUMNS) else _holds(node, columns, 1)

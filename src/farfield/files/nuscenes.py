"""nuScenes' result files: JSON of detections or of tracks by sample (format: the development kit's documentation)."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from farfield.errors import FileFormatError, plain
from farfield.files.cuboids import FARTHEST_M, check_turns, is_name
from farfield.files.json_text import read_json
from farfield.files.limits import MAX_NAME

_MAX_BYTES = 1 << 31
_LARGEST = FARTHEST_M
_SAME_EGO_M = 0.5
_KINDS = ("tracking", "detection")
WORLD = "world"
"""Name of the coordinates in which the format's own boxes stand."""
_Row = tuple[list[float], str, str | None, str]


@dataclass(frozen=True, eq=False, kw_only=True)
class NuScenesBoxes:
    """The boxes of one sample, upright, in the world.

    Args:
        centre_m: Middle of each box, shape (n, 3).
        size_m: Length, width, height, shape (n, 3).
        yaw_rad: Headings, shape (n,).
        velocity_m_s: Over ground, x and y, NaN where it is not known, shape (n, 2).
        score: Shape (n,).
        label: Classes, n names.
        track: Identities, n names; empty for detections.
        attribute: Attributes, n names, empty where a box has none.
        ego_m: Where the car stood, x, y, z; None where no box says how far it is from there (``ego_translation``).
    """

    centre_m: Float[np.ndarray, "n 3"]
    size_m: Float[np.ndarray, "n 3"]
    yaw_rad: Float[np.ndarray, " n"]
    velocity_m_s: Float[np.ndarray, "n 2"]
    score: Float[np.ndarray, " n"]
    label: tuple[str, ...]
    track: tuple[str, ...]
    attribute: tuple[str, ...] = ()
    ego_m: Float[np.ndarray, "3"] | None = None


def read_results(path: Path | str) -> dict[str, NuScenesBoxes]:
    """Read a result file, samples in its order.

    Raises:
        FileFormatError: If it is no such JSON, or a box lacks a field or has an impossible value.
    """
    return read_results_in(path)[0]


def read_results_in(path: Path | str) -> tuple[dict[str, NuScenesBoxes], str]:
    """Read a result file, and the name of the coordinates in which its boxes stand: ``reference`` of its ``meta``.

    The name is empty where the file does not say it; errors are those of :func:`read_results`.
    """
    tree = read_json(path, max_bytes=_MAX_BYTES, nan=True)  # two NaN are a velocity that is not known
    results = tree.get("results") if isinstance(tree, dict) else None
    if not isinstance(results, dict) or not all(isinstance(boxes, list) for boxes in results.values()):
        actual = "no object 'results'" if not isinstance(results, dict) else "a sample that is no list"
        raise FileFormatError(path, where="the file", expected="results: a list of boxes a sample", got=actual)
    meta = tree.get("meta")
    named = meta.get("reference") if isinstance(meta, dict) else None
    if not isinstance(named, str | None):
        raise FileFormatError(path, where="meta", expected="a text as reference", got=repr(named)[:80])
    samples = {token: _sample(path, token, boxes) for token, boxes in results.items()}
    tracked = {token: bool(sample.track) for token, sample in samples.items() if sample.label}
    if len(set(tracked.values())) > 1:
        where = f"sample {next(token for token, is_track in tracked.items() if not is_track)}"
        raise FileFormatError(path, where=where, expected="detections or tracks, not both", got="both")
    return samples, named or ""


def _sample(path: Path | str, token: str, boxes: list[Any]) -> NuScenesBoxes:
    rows: list[_Row] = []
    for number, box in enumerate(boxes):
        try:
            rows.append(_row(box, token))
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            actual = plain(error)
            expected = "translation (3), size (3), rotation (4), a name and a score, as finite numbers"
            raise FileFormatError(path, where=f"sample {token}, box {number}", expected=expected, got=actual) from error
    kinds = {track is None for _, _, track, _ in rows}
    if len(kinds) > 1:
        expected = "detections or tracks, not both"
        raise FileFormatError(path, where=f"sample {token}", expected=expected, got="both")
    table = np.array([values for values, _, _, _ in rows], dtype=np.float64).reshape(-1, 13)
    check_turns(table[:, [7, 8, 9, 6]], path, f"sample {token.replace('{', '{{').replace('}', '}}')}, box {{}}")
    w, x, y, z = table[:, 6:10].T
    return NuScenesBoxes(
        centre_m=table[:, :3],
        size_m=table[:, [4, 3, 5]],
        yaw_rad=np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z),
        velocity_m_s=table[:, 10:12],
        score=table[:, 12],
        label=tuple(label for _, label, _, _ in rows),
        track=tuple(track for _, _, track, _ in rows if track is not None),
        attribute=tuple(attribute for _, _, _, attribute in rows),
        ego_m=_ego(path, token, boxes),
    )


def _ego(path: Path | str, token: str, boxes: list[Any]) -> Float[np.ndarray, "3"] | None:
    """Where the car stood: what is left of a box's place once its place seen from there is taken off.

    The devkit writes zeros where it does not know.
    """
    places = []
    for number, box in enumerate(boxes):
        relative = box.get("ego_translation")
        if relative is None:
            continue
        try:
            offset = np.array(_numbers(relative, 3))
        except (TypeError, ValueError) as error:
            raise FileFormatError(
                path,
                where=f"sample {token}, box {number}",
                expected="ego_translation: three finite numbers",
                got=plain(error),
            ) from error
        if offset.any():
            places.append(np.array(box["translation"], dtype=np.float64) - offset)
    if not places:
        return None
    ego_m = np.median(places, axis=0)
    apart_m = float(np.abs(np.array(places) - ego_m).max())
    if apart_m > _SAME_EGO_M:
        expected = "translation less ego_translation to be where the car stood, the same for all boxes"
        raise FileFormatError(path, where=f"sample {token}", expected=expected, got=f"places {apart_m:.2g} m apart")
    return ego_m


def _row(box: Any, token: str) -> _Row:
    """Thirteen numbers, class, identity and attribute of a box."""
    if not isinstance(box, dict):
        raise TypeError(f"{type(box).__name__}, no object")
    if box.get("sample_token", token) != token:
        raise ValueError(f"the sample_token {str(box['sample_token'])[:60]!r} of another sample")
    kind = next((kind for kind in _KINDS if f"{kind}_name" in box), _KINDS[0])
    values = [
        *_numbers(box["translation"], 3),
        *_numbers(box["size"], 3),
        *_numbers(box["rotation"], 4),
        *_speed(box.get("velocity", [math.nan, math.nan])),
        *_numbers([box[f"{kind}_score"]], 1),
    ]
    if min(values[3:6]) <= 0:
        raise ValueError("a size that is not positive")
    label, track = box[f"{kind}_name"], box["tracking_id"] if kind == "tracking" else None
    if not is_name(label) or not (track is None or isinstance(track, str)):
        raise TypeError("a name that is no text")
    attribute = box.get("attribute_name", "")
    if not (attribute == "" or is_name(attribute)):
        raise TypeError("an attribute_name that is no text")
    if max(len(label), len(track or ""), len(attribute)) > MAX_NAME:
        raise ValueError(f"a name of more than {MAX_NAME} characters")
    return values, label, track, attribute


def _numbers(values: Any, count: int) -> list[float]:
    if not isinstance(values, list) or len(values) != count or not all(type(v) in (int, float) for v in values):
        raise TypeError(f"expected {count} numbers, got {str(values)[:60]}")
    if not all(abs(value) < _LARGEST for value in values):
        raise ValueError(f"numbers that are not finite or above {_LARGEST:g}: {str(values)[:60]}")
    return [float(value) for value in values]


def _speed(values: Any) -> list[float]:
    """A velocity along x and y, of which two NaN say that it is not known."""
    if isinstance(values, list) and len(values) == 2 and all(type(v) is float and math.isnan(v) for v in values):
        return [math.nan, math.nan]
    return _numbers(values, 2)

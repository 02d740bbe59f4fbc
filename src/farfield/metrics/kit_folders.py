"""K-Radar's kit folders, and the folders in which OpenPCDet and mmdetection3d leave their results.

The kit (kaist-avelab/K-Radar, pipelines/pipeline_detection_v1_0.py) writes for each cut of the score a folder with
``all`` and one folder for each condition; in each stand ``preds``, ``gts`` and ``desc`` (time, road, weather, a line
each) with a text a frame, and ``val.txt``. Its unconditional form has ``pred``, ``gt`` and ``desc``. Frames are
numbered in the order of its test set: which those are stands nowhere, but in the file ``FRAMES`` of this package.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from farfield.errors import ConfigError, FileFormatError
from farfield.files.atomic import read_bytes, write_text
from farfield.files.kitti import read_labels
from farfield.files.limits import MAX_NAME
from farfield.frame.drive import Key
from farfield.metrics.box_side import BoxSide
from farfield.metrics.kit_axes import boxes_in_axes, decide_axes
from farfield.vocabulary.classes import CIRRUS_FROM_ANY_KRADAR
from farfield.vocabulary.conditions import UNKNOWN, condition_name, fits_kind
from farfield.vocabulary.kradar import DESC_ORDER

ALL = "all"
PREDICTED, ANNOTATED, DESCRIBED = ("preds", "pred"), ("gts", "gt"), "desc"
FRAMES = "FRAMES"
"""Which frame of which sequence a text is of: a line ``NUMBER<tab>SEQUENCE<tab>FRAME`` each."""
_MAX_BYTES, _DESC_BYTES = 1 << 26, 4096


def kit_folder(path: Path, sides: Sequence[str] = PREDICTED) -> Path:
    """The folder of texts of one side of a kit's folder, or the path itself where it is one.

    Args:
        path: A folder of one score cut, its ``all`` or a condition of it, or one of its folders of texts.
        sides: Names of the side's folder, :data:`PREDICTED` or :data:`ANNOTATED`.

    Raises:
        ConfigError: If there are several score cuts below.
    """
    for folder in (path, path / ALL):
        for name in sides:
            if (folder / name).is_dir():
                return folder / name
    cuts = sorted(child.name for child in path.iterdir() if (child / ALL).is_dir()) if path.is_dir() else []
    if cuts:
        raise ConfigError(
            f"{path}: expected one score cut of K-Radar's kit, found {', '.join(cuts)}; name {path / cuts[0]}"
        )
    return path


def results_folder(path: Path) -> Path:
    """Where OpenPCDet (``final_result/data``) and mmdetection3d's inferencer (``preds``) leave a file a frame."""
    below = (path / "final_result" / "data", path / "data", path / "preds")
    return next((folder for folder in below if folder.is_dir()), path)


def read_kit_text(side: BoxSide, path: Path, stem: str) -> None:
    """Take the rows of a text; their axes are decided once all are read, see :func:`settle_axes`."""
    objects = read_labels(path)
    if side.scored and objects.score is None and len(objects):
        raise FileFormatError(path, where="line 1", expected="16 columns, the score last", got="15")
    side.texts.append((path, ("", stem), objects[objects.has_box]))  # "dummy" stands for no prediction


def settle_axes(annotated: BoxSide, predicted: BoxSide, axes: str = "") -> str:
    """Turn the rows of both sides into boxes, in the axes that they have.

    Args:
        annotated: What was read of the annotated side; it decides where it has boxes.
        predicted: Likewise of the predicted side.
        axes: One of :data:`~farfield.metrics.kit_axes.AXES`; unless given they are decided from the numbers.

    Returns:
        In which axes they were read and why, in a sentence.

    Raises:
        ConfigError: If the numbers do not decide it.
    """
    why = "as --axes says"
    if not axes:
        parts = [objects for _, _, objects in annotated.texts or predicted.texts if len(objects)]
        axes, why = decide_axes(parts)
    for side in (annotated, predicted):
        for path, key, objects in side.texts:
            side.turned(objects.rotation_y_rad)
            boxes = boxes_in_axes(objects, axes, score=side.scores(objects.score, len(objects)))
            side.add(path, key, boxes.relabel(CIRRUS_FROM_ANY_KRADAR))
    return f"the texts of K-Radar's kit are read with the axes {axes}: {why}"


def described(folder: Path, keys: Sequence[Key]) -> dict[Key, dict[str, str]]:
    """Time, road and weather of the frames of a folder of texts, where ``desc`` beside it has them.

    Args:
        folder: The folder of texts.
        keys: ("", number) of the frames.

    Raises:
        FileFormatError: If a description is not three lines.
    """
    beside = folder.parent / DESCRIBED
    conditions: dict[Key, dict[str, str]] = {}
    for key in keys if beside.is_dir() else ():
        path = beside / f"{key[1]}.txt"
        if not path.is_file():
            continue
        words = read_bytes(path, max_bytes=_DESC_BYTES).decode("utf-8", errors="replace").split("\n")
        words = [condition_name(word) for word in words if word.strip()]
        pairs = dict(zip(DESC_ORDER, words, strict=False))
        if len(words) != len(DESC_ORDER) or not all(fits_kind(word, kind) for kind, word in pairs.items()):
            raise FileFormatError(
                path, where="the file", expected="three lines: time, road, weather", got=repr(words)[:80]
            )
        conditions[key] = {kind: word for kind, word in pairs.items() if word != UNKNOWN}
    return conditions


def write_frames(folder: Path, keys: Mapping[str, Key]) -> None:
    """Write which frames the texts of the folder are of, by stem."""
    write_text(folder / FRAMES, "".join(f"{stem}\t{sequence}\t{frame}\n" for stem, (sequence, frame) in keys.items()))


def read_frames(folder: Path) -> dict[str, Key]:
    """Which frames the texts of a folder are of, by stem; empty where nothing says it.

    Raises:
        FileFormatError: If a line is not three words with tabs between, or comes twice.
    """
    path = folder / FRAMES
    if not path.is_file():
        return {}
    keys: dict[str, Key] = {}
    text = read_bytes(path, max_bytes=_MAX_BYTES).decode("utf-8", errors="replace")
    for number, line in enumerate(text.split("\n")[:-1], start=1):
        words = line.split("\t")
        sound = len(words) == 3 and all(word.isprintable() and len(word) <= MAX_NAME for word in words)
        if not sound or words[0] in keys or not words[2]:
            expected = "NUMBER, SEQUENCE and FRAME with tabs between, each number once"
            raise FileFormatError(path, where=f"line {number}", expected=expected, got=repr(line[:60]))
        keys[words[0]] = (words[1], words[2])
    return keys


def renamed(side: BoxSide, folder: Path) -> None:
    """Call the frames of a side as ``FRAMES`` beside its texts does."""
    names = read_frames(folder)
    if not names:
        return
    side.boxes = {names.get(frame, (sequence, frame)): boxes for (sequence, frame), boxes in side.boxes.items()}


def text_row(name: str, size_hwl_m: np.ndarray, place_m: np.ndarray, yaw_rad: float, score: float | None) -> str:
    """A line of the kit, numbers as precise as they are."""
    head = "0.00 0 0 50 50 150 150" if score is None else "-1 -1 0 50 50 150 150"
    numbers = [*size_hwl_m.tolist(), *place_m.tolist(), float(yaw_rad), *([] if score is None else [float(score)])]
    return " ".join([name, head, *map(repr, numbers)])


NOTHING = "dummy -1 -1 0 0 0 0 0 0 0 0 0 0 0 0 0"
"""The line that the kit writes where nothing was predicted."""

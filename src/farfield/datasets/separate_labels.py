"""Labels that stand in files of their own, apart from the clouds: laid over the frames of a data set by their names."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict

from farfield.datasets.base import Dataset
from farfield.datasets.class_mapping import class_mapping_of, renamed, usual
from farfield.datasets.folder import boxes_of_table, read_boxes
from farfield.datasets.frame_maps import Earlier
from farfield.errors import ConfigError, DatasetError
from farfield.files.boxes_csv import read_boxes_csv, zeros_note
from farfield.frame import Annotation, Boxes, Constant, Frame, Key
from farfield.vocabulary.counts import count_of

_NAMED = 5  # frames in a message


class SeparateLabelsSettings(BaseModel):
    """Settings of :class:`SeparateLabels`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    labels: Path
    classes: dict[str, str] = {}


@dataclass(frozen=True)
class SeparateLabels:
    """Each frame with the boxes that files of labels have for it; frames that they do not name are not annotated.

    Args:
        labels: A table of boxes (``.csv``, the columns of :mod:`farfield.files.boxes_csv`), or a folder of
            ``FRAME.json`` as :func:`farfield.datasets.folder.read_boxes` reads them. Boxes stand in the coordinates of
            the data set's own frames.
        classes: Our class by the name in the files; usual names such as ``Car`` need none.

    Raises:
        ConfigError: If there is no such file, or a folder without labels.
        FileFormatError: If a file is damaged, when an annotation is read.
    """

    name: ClassVar[str] = "separate_labels"
    Settings: ClassVar[type[BaseModel]] = SeparateLabelsSettings
    labels: Path
    classes: Mapping[str, str] = field(default_factory=dict)

    def settings(self) -> Mapping[str, Any]:
        """Where the labels stand, and the classes."""
        return {"labels": str(self.labels), "classes": dict(self.classes)}

    def moved_poses(self, world_T_frame: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 4 4"]:
        """The poses as they are."""
        return world_T_frame

    def __call__(self, frame: Frame, earlier: Earlier) -> Frame:
        """The frame with its labels, or without any."""
        del earlier
        boxes = self.boxes.get(frame.key, self.boxes.get(("", frame.frame_id)))
        if boxes is None:
            return replace(frame, load_annotation=None)
        return replace(frame, load_annotation=Constant(renamed(usual(Annotation(boxes=boxes)), self.classes)))

    @cached_property
    def boxes(self) -> Mapping[Key, Boxes]:
        """The boxes by (sequence, frame); where the files name no sequence, it is empty."""
        if self.labels.is_dir():
            paths = sorted(path for path in self.labels.glob("*.json") if not path.name.startswith("."))
            boxes: dict[Key, Boxes] = {("", path.stem): read_boxes(path) for path in paths}
        elif self.labels.is_file():
            boxes = _table(self.labels)
        else:
            raise ConfigError(f"{self.labels}: expected a table of boxes, or a folder of labels; nothing is there.")
        if not boxes:
            raise ConfigError(
                f"{self.labels}: expected labels, found none: a data set's folder with annotated frames, a table of "
                "boxes (.csv with a header, see docs/own-data.md), or a folder of FRAME.json."
            )
        return boxes

    @property
    def reference(self) -> str:
        """The sensor in whose coordinates the boxes stand; empty where the files do not say."""
        return read_boxes_csv(self.labels).stands_in if self.labels.is_file() else ""

    def __getstate__(self) -> dict[str, Any]:
        return {"labels": self.labels, "classes": self.classes}


def _table(path: Path) -> dict[Key, Boxes]:
    """The boxes of a table by sequence and frame."""
    rows = read_boxes_csv(path)
    boxes = boxes_of_table(rows, path).replace(score=None, point_count=None)
    sequences = np.full(len(rows), "") if rows.sequence is None else rows.sequence
    members: dict[Key, list[int]] = {}
    for row, key in enumerate(zip(sequences.tolist(), rows.frame.tolist(), strict=True)):
        members.setdefault((str(key[0]), str(key[1])), []).append(row)
    return {key: boxes[np.array(indices)] for key, indices in members.items()}


def labelled_by_files(data: Dataset, labels: Path) -> Dataset:
    """The frames of a data set that files of labels name, with these labels.

    Args:
        data: The frames, as they were opened: selections and maps stay.
        labels: As of :class:`SeparateLabels`.

    Raises:
        ConfigError: If there are no labels, or they stand in coordinates that are not the frames' own.
        DatasetError: If they name frames that are not there, or a name that several sequences have.
        FileFormatError: If a file is damaged.
    """
    reader = data.unwrapped
    function = SeparateLabels(labels, class_mapping_of(data))
    own = reader[0].reference
    if function.reference not in ("", own):
        raise ConfigError(
            f"{labels}: expected boxes in the coordinates of {own}, those of the frames of {data.root}, got "
            f"those of {function.reference}. Write them anew in those of {own}."
        )
    frames_by_name: dict[str, list[Key]] = {}
    for key in data.keys:
        frames_by_name.setdefault(key[1], []).append(key)
    named: set[Key] = set()
    strange: list[Key] = []
    for sequence, frame in function.boxes:
        candidates = [key for key in frames_by_name.get(frame, ()) if sequence in ("", key[0])]
        if len(candidates) > 1:
            there = ", ".join(sorted(key[0] for key in candidates)[:_NAMED])
            raise DatasetError(
                f"{labels}: expected the sequence of frame {frame!r}, which several have ({there}). Give a table with "
                "the column sequence."
            )
        named.update(candidates)
        strange += [] if candidates else [(sequence, frame)]
    if strange:
        shown = ", ".join("/".join(filter(None, key)) for key in strange[:_NAMED])
        raise DatasetError(
            f"{labels}: expected labels of the frames of {data.root}, such as {data.frame_ids[0]!r}; "
            f"{count_of(len(strange), 'frame')} of {len(function.boxes)} are not there: {shown}. Name them as the "
            f"clouds' files, or remove them. {zeros_note((key[1] for key in strange), data.frame_ids)}".rstrip()
        )
    labelled = reader.mapped(function)
    for moved in data.maps[len(reader.maps) :]:
        labelled = labelled.mapped(moved)
    return labelled.select([data.origins[index] for index, key in enumerate(data.keys) if key in named])

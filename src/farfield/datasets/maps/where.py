"""Data of which only the objects count that fulfil a condition, and the frames that hold some."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

from pydantic import BaseModel, ConfigDict

from farfield.datasets.base import Dataset
from farfield.datasets.frame_maps import Earlier
from farfield.errors import DatasetError
from farfield.frame import Annotation, Frame
from farfield.frame.where import Where, columns_of_boxes


class FulfillingSettings(BaseModel):
    """Settings of :class:`Fulfilling`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    where: str


@dataclass(frozen=True)
class Fulfilling:
    """Frames of whose annotated objects those stay that fulfil a condition.

    Args:
        where: The condition, see :class:`farfield.frame.where.Where`.

    Raises:
        ConfigError: If it is none.
    """

    name: ClassVar[str] = "where"
    Settings: ClassVar[type[BaseModel]] = FulfillingSettings
    where: str

    def __post_init__(self) -> None:
        Where(self.where)

    def settings(self) -> Mapping[str, Any]:
        """The condition."""
        return {"where": self.where}

    def __call__(self, frame: Frame, earlier: Earlier) -> Frame:
        """The frame with fewer objects, if it is annotated."""
        del earlier
        if not frame.has_annotation:
            return frame
        return replace(frame, load_annotation=partial(_cut, self.where, frame))


def fulfilling(data: Dataset, where: str) -> Dataset:
    """The frames that hold an object that fulfils a condition, with these objects alone.

    A condition on frames alone, such as ``weather == "sleet"``, chooses frames and reads no annotation.

    Args:
        data: The data set.
        where: The condition; the data set as it is where it is empty.

    Raises:
        ConfigError: If it is none.
        DatasetError: If no frame is left.
    """
    if not where:
        return data
    condition = Where(where)
    frames = ((index, data[index]) for index in range(len(data)))
    possible = [index for index, frame in frames if condition.of_frame(frame.key, frame.conditions)]
    stated: set[str] = set()
    rows = possible if condition.of_frames else []
    for index in () if condition.of_frames else possible:
        annotation = data.annotation(index)
        if annotation is None:
            continue
        frame = data[index]
        columns = columns_of_boxes(annotation.boxes, frame.key, frame.conditions, annotation)
        stated |= set(columns)
        if condition.holds(columns, len(annotation.boxes)).any():
            rows.append(index)
    if not rows:
        unknown = sorted(condition.columns - stated) if stated else []
        why = f": these data do not say {', '.join(unknown)}" if unknown else ""
        raise DatasetError(f"--where {where}: expected frames or objects that fulfil it, found none{why}")
    return data.select(rows).mapped(Fulfilling(where))


def _cut(where: str, frame: Frame) -> Annotation:
    annotation = frame.annotation
    if annotation is None:  # it was annotated as the frame was seen
        raise DatasetError(f"frame {frame.key}: expected its annotation, found none")
    return annotation[Where(where).of_boxes(annotation.boxes, frame.key, frame.conditions, annotation)]

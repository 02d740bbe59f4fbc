"""Boxes of whole bodies where a data set's own boxes show the visible parts."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict

from farfield.datasets.maps.contract import Earlier
from farfield.errors import DatasetError
from farfield.frame import Annotation, Boxes, Frame


class WholeBodiesSettings(BaseModel):
    """Settings of :class:`WholeBodies`: none."""

    model_config = ConfigDict(extra="forbid", frozen=True)


@dataclass(frozen=True)
class WholeBodies:
    """Every box holds the whole body of its object, not the part that the sensor sees.

    Cirrus' annotators drew boxes round what the cloud shows; other data sets' boxes are whole bodies. Simulated frames
    know both. Annotations that are whole bodies already stay as they are.

    Raises:
        DatasetError: If boxes show visible parts and nothing tells the bodies, when the annotation is read.
    """

    name: ClassVar[str] = "whole_bodies"
    Settings: ClassVar[type[BaseModel]] = WholeBodiesSettings

    def settings(self) -> Mapping[str, Any]:
        """None."""
        return {}

    def fits(self, dataset: Any) -> bool:
        """Whether the data set's first annotated objects tell their bodies."""
        if "whole_bodies" not in dataset.view_options:
            return False
        annotated = (dataset.annotation(index) for index in range(len(dataset)) if dataset.has_annotation(index))
        first = next((each for each in annotated if each is not None and len(each)), None)
        return first is not None and first.full_boxes is not None

    def moved_poses(self, world_T_frame: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 4 4"]:
        """The poses as they are."""
        return world_T_frame

    def __call__(self, frame: Frame, earlier: Earlier) -> Frame:
        """The frame with its annotation's bodies in the place of the visible parts."""
        del earlier
        return replace(frame, load_annotation=WholeAnnotation(frame)) if frame.has_annotation else frame


@dataclass(frozen=True, eq=False)
class WholeAnnotation:
    """Loads the annotation of a frame as whole bodies.

    Args:
        frame: The frame as it was annotated.
    """

    frame: Frame

    def __call__(self) -> Annotation:
        """The annotation; counts of points stay."""
        annotation = self.frame.annotation or Annotation(boxes=Boxes.empty())
        if annotation.extent == "full":
            return annotation
        bodies = annotation.full_boxes if len(annotation) else annotation.boxes
        if bodies is None:
            raise DatasetError(
                f"whole_bodies: expected frame {self.frame.key} to tell the whole bodies of its objects, as simulated "
                "frames do; its boxes show the part that the sensor sees, and nothing more is known. Leave "
                "whole_bodies out."
            )
        return replace(annotation, boxes=bodies, extent="full", full_boxes=None)

"""The few sweeps of the user that are labelled and teach: opened, checked, kept apart from those that score."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool

from farfield.datasets import Dataset, open_dataset, recognise
from farfield.datasets.contents import common_frames, frame_digests
from farfield.datasets.maps import AnnotatedField, WholeBodies
from farfield.datasets.separate_labels import labelled_by_files
from farfield.errors import ConfigError, DatasetError
from farfield.evaluation import as_trained, suitable_clouds
from farfield.evaluation.detecting import points_in_boxes
from farfield.experiments.adapting.source import TrainingHistory
from farfield.experiments.frames import annotated_frames
from farfield.experiments.schema import DataConfig
from farfield.files.remote_paths import as_path
from farfield.frame import Annotation, Boxes
from farfield.metrics.result import digest_of
from farfield.training.samples import no_boxes
from farfield.vocabulary.counts import count_of

if TYPE_CHECKING:
    from farfield.detectors.runtime import Detector

_NAMED = 5  # frames in a message
_BOXES_HOLD = {"full": "whole bodies", "visible": "the parts that the sensor sees"}
_LOOKED_AT = 10  # frames in which points are looked for in the boxes


@dataclass(frozen=True, kw_only=True)
class LabelledSweeps:
    """Labelled frames from which a detector learns.

    Args:
        frames: The frames as the detector sees them, all annotated.
        clouds: Which of their clouds it reads.
        aliases: Classes that the detector learnt under another name.
        options: Options of the stream: the reader's, and the coordinates.
    """

    frames: Dataset
    clouds: tuple[str, ...]
    aliases: Mapping[str, str]
    options: Mapping[str, Any]

    @property
    def config(self) -> DataConfig:
        """The experiment's settings of the stream."""
        return DataConfig(
            path=self.frames.root, clouds=self.clouds, aliases=dict(self.aliases), options=dict(self.options)
        )

    @cached_property
    def digest(self) -> str:
        """SHA-256 over the labels: those that were edited are others."""
        annotations = ((key, self.frames.annotation(index)) for index, key in enumerate(self.frames.keys))
        return digest_of((key, annotation) for key, annotation in annotations if annotation is not None)

    def boxes(self, index: int) -> Boxes:
        """The boxes of a frame, under the detector's names."""
        annotation = self.frames.annotation(index)
        return Boxes.empty() if annotation is None else annotation.boxes.relabel(dict(self.aliases))

    @property
    def extent(self) -> str:
        """What their boxes show: ``"full"`` or ``"visible"``."""
        annotation = self.frames.annotation(0)
        return "full" if annotation is None else annotation.extent

    def contradiction(self, source: Dataset) -> str:
        """What to tell where of these boxes and the source's one are whole bodies: both teach; else nothing."""
        annotation = source.annotation(0)
        if annotation is None or self.extent == annotation.extent:
            return ""
        advice = (
            "--whole-bodies lets the source's hold whole bodies too"
            if self.extent == "full"
            else "label whole bodies, or take a source whose boxes show visible parts, without --whole-bodies"
        )
        return (
            f"warning: labelled boxes hold {_BOXES_HOLD[self.extent]} and those of the source "
            f"{_BOXES_HOLD[annotation.extent]}; they teach against each other. {advice}"
        )

    def check(self, detector: "Detector") -> list[str]:
        """Refuse labels that cannot teach a detector; what of them teaches nothing, in sentences.

        Raises:
            DatasetError: If no box is of a class that the detector tells, lies where it looks, or holds a point.
        """
        classes = tuple(detector.config.class_names)
        taught, others, outside = Counter[str](), Counter[str](), 0
        for index in range(len(self.frames)):
            boxes = self.boxes(index)
            of_class = np.isin(boxes.label, classes)
            inside = looked_at(detector.config, boxes)
            taught.update(map(str, np.asarray(boxes.label)[of_class & inside]))
            others.update(map(str, np.asarray(boxes.label)[~of_class]))
            outside += int((of_class & ~inside).sum())
        root, count = self.frames.root, count_of(len(self.frames), "sweep")
        if not taught and not outside:
            raise no_boxes(self.frames, "labels", classes, others)
        if not taught:
            raise DatasetError(
                f"{root}: expected labelled boxes where the detector looks ({reach_text(detector.config)}), found none "
                f"of {outside} there. Turn the sweeps (--rotate-deg), move them into the coordinates that the detector "
                "learnt in, or take a detector that looks there."
            )
        self._check_points(detector)
        lines = [f"learns from {count} with labels: {', '.join(f'{n} {name}' for name, n in taught.items())}"]
        if others:
            shown = ", ".join(f"{name} ({n})" for name, n in others.most_common(_NAMED))
            lines.append(
                f"warning: the detector does not tell labelled boxes of {shown}: they teach as background; a mapping "
                "(--mapping) says what they are"
            )
        if outside:
            lines.append(
                f"warning: {count_of(outside, 'labelled box lies', 'labelled boxes lie')} where the detector does not "
                f"look ({reach_text(detector.config)}): nothing is learnt from these"
            )
        return lines

    def _check_points(self, detector: "Detector") -> None:
        classes, looked_into = tuple(detector.config.class_names), 0
        for index in range(len(self.frames)):
            boxes = self.boxes(index)
            boxes = boxes[np.isin(boxes.label, classes) & looked_at(detector.config, boxes)]
            if not len(boxes):
                continue
            cloud = self.frames[index].cloud(self.clouds[0])
            if points_in_boxes(Annotation(boxes=boxes), cloud).any():
                return
            looked_into += 1
            if looked_into == _LOOKED_AT:
                break
        raise DatasetError(
            f"{self.frames.root}: expected points in the labelled boxes, found none in those of "
            f"{count_of(looked_into, 'sweep')}: boxes and points do not lie in one place; see farfield doctor."
        )

    def check_apart(self, scored: Dataset) -> None:
        """Refuse labels that teach and score: such a score says how well a detector remembers.

        Frames are compared by the contents of their files, and by their names within one folder.

        Args:
            scored: The data set whose annotated frames score.

        Raises:
            ConfigError: If a frame is in both; the message names them.
        """
        annotated = scored.select([index for index in range(len(scored)) if scored.has_annotation(index)])
        names = set(annotated.keys) if annotated.root.resolve() == self.frames.root.resolve() else set()
        copies, _ = common_frames(self.frames, " ".join(frame_digests(annotated)))
        both = [key for key, copy in zip(self.frames.keys, copies, strict=True) if copy or key in names]
        if both:
            shown = ", ".join("/".join(key) for key in both[:_NAMED]) + (", ..." if len(both) > _NAMED else "")
            raise ConfigError(
                f"adapt: expected labels that score (--labels {scored.root}) apart from those that teach (--learn-from "
                f"{self.frames.root}); {count_of(len(both), 'frame is', 'frames are')} in both: {shown}. Take them out "
                "of one of the two, whole drives rather than single frames."
            )


def labelled_sweeps(
    labels: Path | str | Dataset,
    data: Dataset,
    detector: "Detector",
    learnt: TrainingHistory,
    clouds: Sequence[str],
    *,
    whole_bodies: bool = False,
) -> LabelledSweeps:
    """Open the labels that teach.

    Args:
        labels: A data set with annotated frames, or its folder; or a table or folder of labels of frames of ``data``,
            see :class:`~farfield.datasets.separate_labels.SeparateLabels`.
        data: The user's sweeps as they were opened.
        detector: The detector.
        learnt: What it learnt from.
        clouds: Clouds of the sweeps that it is to read; where the labelled frames have others, the first that suits.
        whole_bodies: Boxes hold whole bodies, where the labels tell them.

    Raises:
        ConfigError: If there are no labels, or no cloud suits the detector.
        DatasetError: If no frame is labelled, or labels are of no frame.
        FileFormatError: If a file of labels is damaged.
    """
    opened = labels if isinstance(labels, Dataset) else _opened(as_path(labels), data)
    opened = opened.mapped(WholeBodies()) if whole_bodies and WholeBodies().fits(opened) else opened
    frames = annotated_frames(as_trained(opened, detector.info), "skip").mapped(AnnotatedField())
    first = frames[0]
    present = tuple(clouds) if clouds and set(clouds) <= set(first.clouds) else ()
    options = dict(opened.options)
    if detector.reference in (*frames.references, first.reference):
        options["reference"] = detector.reference
    return LabelledSweeps(
        frames=frames,
        clouds=present or suitable_clouds(detector.info, first)[:1],
        aliases=learnt.aliases,
        options=options,
    )


def _opened(path: Path, data: Dataset) -> Dataset:
    if path.is_dir() and recognise(path) is not None:
        return open_dataset(path)
    return labelled_by_files(data, path)


def looked_at(config: Any, boxes: Boxes) -> Bool[np.ndarray, " n"]:
    """Whether the centre of each box lies where a detector looks, seen from above, shape (n,).

    Args:
        config: The detector's settings.
        boxes: Boxes in its coordinates.
    """
    half_width_m = getattr(getattr(config, "grid", None), "half_width_m", np.inf)
    x, y = boxes.centre_m[:, 0], boxes.centre_m[:, 1]
    return (x >= 0) & (x <= config.reach_m) & (np.abs(y) <= half_width_m)


def reach_text(config: Any) -> str:
    """Where a detector looks, in words."""
    half_width_m = getattr(getattr(config, "grid", None), "half_width_m", None)
    across = "" if half_width_m is None else f", {half_width_m:g} m to either side"
    return f"0 to {float(config.reach_m):g} m ahead{across}"

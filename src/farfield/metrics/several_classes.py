"""Protocols of which one result holds several classes: which classes are scored, and how they are chosen."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.errors import ConfigError
from farfield.frame.drive import Drive, Key
from farfield.geometry.boxes import Boxes
from farfield.metrics.detections import Detections, Protocol
from farfield.metrics.frames import BoxesByFrame, check_frames, flatten, frame_order, group_frames, labels_of
from farfield.metrics.frames import nearest_first as order_of_boxes
from farfield.metrics.options import option_text

OTHER = -1
"""Number of a class that is not scored."""


class SeveralClassProtocol(Protocol):
    """A protocol whose settings have ``classes`` and ``relabel``; ``label`` stands for one class."""

    several_classes = True

    def classes_of(self, detections: Detections, relabel: Mapping[str, str]) -> tuple[str, ...]:
        """The classes that are scored where none are named: those of the settings.

        Args:
            detections: The detections.
            relabel: Names that stand for another.
        """
        del detections, relabel
        return tuple(self.Settings().classes)

    def settings(self, detections: Detections, **options: Any) -> Any:
        """The settings; ``label`` is one class, and unless any is named the protocol chooses them.

        Raises:
            ConfigError: If a setting is unknown or impossible.
        """
        options = self.with_own_relabel(options)
        label, relabel = options.pop("label", None), options.get("relabel", self.Settings().relabel)
        if label is not None:
            options["classes"] = (relabel.get(label, label),)
        elif options.get("classes") is None:
            options["classes"] = self.classes_of(detections, relabel)
        return super().settings(detections, **options)

    def labels(self, boxes: BoxesByFrame, **options: Any) -> tuple[str, ...]:
        """The classes of the settings that occur, the most frequent first."""
        options = self.with_own_relabel(options)
        chosen = {name: options[name] for name in ("relabel", "classes") if name in options}
        settings = self.Settings(**chosen)
        return tuple(name for name, _ in labels_of(boxes, settings.relabel) if name in settings.classes)

    def each(self, detections: Detections, *, label: str | None = None, **options: Any) -> list[Any]:
        """One result for all classes; refused if none of them is annotated but others are."""
        settings = self.settings(detections, label=label, **options)
        present = [name for name, _ in labels_of(detections.annotated, settings.relabel)]
        if present and not set(present) & set(settings.classes):
            raise ConfigError(
                f"{self}: expected annotated boxes of {' or '.join(settings.classes)}, got {', '.join(present[:8])}. "
                "Choose with --label, --options classes=a,b or rename with --options relabel=old:new"
            )
        return [settings]

    def inert(self, settings: Mapping[str, Any]) -> Collection[str]:
        """Besides those of every protocol: classes have figures of their own, and range bins too."""
        return [*super().inert(settings), "classes", "range_bins_m"]

    def convention_text(self, settings: Mapping[str, Any], *, by_range: bool = False) -> str:
        """The settings on which figures depend in one line; how names are called is left out."""
        shown = self.depends_on(settings, by_range=by_range)
        return option_text({name: value for name, value in shown.items() if name != "relabel"})


def check_classes(classes: Sequence[str], relabel: Mapping[str, str]) -> None:
    """Refuse classes that are named twice, relabelled as others, or named with a slash.

    Raises:
        ConfigError: If so, or there are none.
    """
    if not classes or len(set(classes)) < len(classes):
        raise ConfigError(f"classes: expected one or more different names, got {tuple(classes)}")
    for name in classes:
        if relabel.get(name, name) != name:
            raise ConfigError(f"classes: {name!r} is relabelled as {relabel[name]!r}; name that one")
        if "/" in name:
            raise ConfigError(f"classes: expected names without a slash, got {name!r}")


@dataclass(frozen=True, eq=False, kw_only=True)
class ClassRows:
    """Boxes of all frames and classes as rows: those of a frame and class stand together, the nearest first.

    Args:
        boxes: n boxes.
        frame: Number of the frame of each, shape (n,).
        kind: Number of its class in the settings, :data:`OTHER` for any other, shape (n,).
        origin: Place of each among the boxes of all frames as they were given, shape (n,).
        range_m: Distance of its centre from the origin in space, shape (n,), metres.
    """

    boxes: Boxes
    frame: Int[np.ndarray, " n"]
    kind: Int[np.ndarray, " n"]
    origin: Int[np.ndarray, " n"]
    range_m: Float[np.ndarray, " n"]

    def __len__(self) -> int:
        return len(self.frame)

    def __getitem__(self, rows: Bool[np.ndarray, " n"] | Int[np.ndarray, " k"]) -> "ClassRows":
        return ClassRows(
            boxes=self.boxes[rows],
            frame=self.frame[rows],
            kind=self.kind[rows],
            origin=self.origin[rows],
            range_m=self.range_m[rows],
        )

    def owner(self, classes: int) -> Int[np.ndarray, " n"]:
        """A number for each frame and class, rising with the rows, shape (n,)."""
        return self.frame * classes + self.kind

    @property
    def score(self) -> Float[np.ndarray, " n"]:
        """Scores, shape (n,); zeros where there are none."""
        return np.zeros(len(self)) if self.boxes.score is None else self.boxes.score


@dataclass(frozen=True, eq=False, kw_only=True)
class ClassFrames:
    """Predicted and annotated boxes of all frames with their classes.

    Args:
        keys: (sequence, frame) of the frames.
        predicted: Predicted boxes.
        annotated: Annotated boxes.
        group: Resampling group of each frame, shape (f,).
        grouped_by: ``"sequences"``, or ``"frames"`` where there is only one sequence.
        other_predicted: Predictions of classes that are not scored.
        other_annotated: Annotated boxes of such classes.
    """

    keys: list[Key]
    predicted: ClassRows
    annotated: ClassRows
    group: Int[np.ndarray, " f"]
    grouped_by: str
    other_predicted: int
    other_annotated: int

    @property
    def groups(self) -> int:
        """Number of resampling groups."""
        return int(self.group.max()) + 1 if len(self.group) else 0


def gather_classes(
    predictions: BoxesByFrame,
    annotations: BoxesByFrame,
    classes: Sequence[str],
    relabel: Mapping[str, str],
    drives: Sequence[Drive] = (),
) -> ClassFrames:
    """Collect several classes from all frames.

    Args:
        predictions: Scored boxes by (sequence, frame).
        annotations: Annotated boxes by (sequence, frame): every frame that counts.
        classes: The classes.
        relabel: Names that stand for another.
        drives: Drives of the data, for resampling.

    Raises:
        ConfigError: If predictions lie in frames that are not annotated, or lack scores.
    """
    check_frames(predictions, annotations)
    keys = sorted(annotations, key=frame_order)
    empty = Boxes.empty(scored=True)
    sides = [([predictions.get(key, empty) for key in keys], True), ([annotations[key] for key in keys], False)]
    rows, others = [], []
    for parts, scored in sides:
        boxes = flatten(parts, scored=scored)
        frame = np.repeat(np.arange(len(keys)), [len(part) for part in parts])
        kind = class_numbers(boxes, classes, relabel)
        order = order_of_boxes(boxes, frame * len(classes) + kind)
        order = order[kind[order] != OTHER]
        range_m = np.sqrt((boxes.centre_m**2).sum(axis=1))
        others.append(len(boxes) - len(order))
        rows.append(
            ClassRows(boxes=boxes, frame=frame, kind=kind, origin=np.arange(len(boxes)), range_m=range_m)[order]
        )
    group, grouped_by = group_frames(keys, drives)
    return ClassFrames(
        keys=keys,
        predicted=rows[0],
        annotated=rows[1],
        group=group,
        grouped_by=grouped_by,
        other_predicted=others[0],
        other_annotated=others[1],
    )


def class_numbers(boxes: Boxes, classes: Sequence[str], relabel: Mapping[str, str]) -> Int[np.ndarray, " n"]:
    """Number of each box's class after relabelling, :data:`OTHER` for a class that is not scored, shape (n,)."""
    number = {name: index for index, name in enumerate(classes)}
    names, index = np.unique(np.asarray(boxes.label, dtype=np.str_), return_inverse=True)
    numbers = [number.get(relabel.get(name, name), OTHER) for name in names.tolist()]
    return np.array(numbers, dtype=np.int64)[index.reshape(-1)] if len(boxes) else np.zeros(0, dtype=np.int64)

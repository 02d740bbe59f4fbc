"""Boxes of a file, with a data set as the truth."""

from collections.abc import Mapping
from dataclasses import replace

from farfield.datasets.base import Dataset
from farfield.datasets.maps.coordinates import Coordinates
from farfield.errors import ConfigError
from farfield.evaluation.detecting import detections_from_boxes
from farfield.frame import Boxes, Key
from farfield.metrics.detections import Detections
from farfield.metrics.oddities import oddities


def attach_ground_truth(predictions: Detections, data: Dataset) -> Detections:
    """Predictions with what a data set's frames have annotated, seen in the predictions' coordinates.

    Args:
        predictions: Boxes as :func:`farfield.metrics.reading.read_predictions` gives them. Where they name no sequence
            and the data set has one alone, it is theirs.
        data: The data set.

    Raises:
        ConfigError: If the data set does not know the coordinates in which the predictions stand, or no frame of theirs
            is one of its annotated ones.
        DatasetError: If nothing is annotated.
    """
    notes = list(predictions.notes)
    stands_in, own = predictions.reference, data[0].reference
    data = in_coordinates(data, stands_in)
    if not stands_in:
        notes.append(f"predictions do not name their coordinates: they are taken for {own} (--reference says it)")
    elif stands_in != own:
        notes.append(f"the annotated boxes are seen in the coordinates of {stands_in}, as the predictions are")
    found = detections_from_boxes(_in_sequence(predictions.boxes, data, notes), data)
    return replace(found, notes=(*notes, *found.notes, *oddities(found.boxes, found.annotated)))


def in_coordinates(data: Dataset, reference: str) -> Dataset:
    """The data set in the coordinates in which boxes of a file stand.

    Args:
        data: The data set.
        reference: What the file names; empty: nothing, and the data stay as they are.

    Raises:
        ConfigError: If the data set does not know these coordinates.
    """
    own = data[0].reference
    if not reference or reference == own:
        return data
    if reference not in data.references:
        known = " or ".join(data.references or (own,))
        raise ConfigError(
            f"the boxes stand in the coordinates of {reference}; the frames of {data.root} can be seen in those of "
            f"{known}. Write the boxes anew in one of these (farfield predict ... --reference {own})"
        )
    return data.mapped(Coordinates(reference))


def _in_sequence(boxes: Mapping[Key, Boxes], data: Dataset, notes: list[str]) -> Mapping[Key, Boxes]:
    """The boxes under the data set's only sequence, where they name none."""
    sequences = set(data.sequences)
    if len(sequences) != 1 or {sequence for sequence, _ in boxes} != {""}:
        return boxes
    (name,) = sequences
    notes.append(f"predictions name no sequence: their frames are taken for those of {name!r}, the data's only one")
    return {(name, frame): part for (_, frame), part in boxes.items()}

"""The frames of an experiment's streams: opened, cut to a part, held out."""

import hashlib
import math
from collections.abc import Sequence

from farfield.datasets import Dataset, open_dataset
from farfield.datasets.contents import common_frames, frame_digests
from farfield.datasets.maps import Sweeps
from farfield.errors import DatasetError
from farfield.experiments.schema import DataConfig, Experiment
from farfield.simulation.donor_frames import DonorFrames
from farfield.training.method import Stream
from farfield.vocabulary.counts import count_of

OPEN_SWEEPS = "open-sweeps"
"""In the place of a folder: the real sweeps that ship with the package."""


def open_frames(config: DataConfig, stream: Stream, experiment: Experiment) -> Dataset:
    """The frames of a stream as they are trained on.

    Raises:
        DatasetError: If there is no folder, a cloud is absent, or frames of a labelled stream have no annotation.
    """
    if not config.path.is_dir() and str(config.path) != OPEN_SWEEPS:
        raise DatasetError(
            f"{experiment.name}: expected its data in {config.path}, found no folder there. Name where they are: "
            f"farfield train {experiment.name} -o data.path=FOLDER"
        )
    data = open_dataset(config.path, **config.options)
    data = data.mapped(Sweeps(config.sweeps)) if config.sweeps > 1 else data
    data = data.split(config.split) if config.split else data
    data = part_of(data, config.part, config.part_draw) if config.part != (0.0, 1.0) else data
    clouds = config.clouds if isinstance(config.clouds, tuple) else sum(config.clouds.values(), ())
    missing = [name for name in clouds if name not in data[0].clouds]
    if missing:
        raise DatasetError(f"{data.root}: expected the clouds {missing}; its frames hold {list(data[0].clouds)}.")
    if config.donors is not None:
        return DonorFrames(data, config.donors, clouds[0])
    return annotated_frames(data, experiment.training.unannotated) if stream.labelled else data


def part_of(data: Dataset, part: tuple[float, float], draw: int = 0) -> Dataset:
    """The frames of a part of the sequences, whole ones; smaller parts that begin alike lie in larger ones.

    Args:
        data: The frames.
        part: From where to where in the drawn order of the sequences, shares of their number.
        draw: Draws the order, by the sequences' names alone.

    Raises:
        DatasetError: If no sequence falls into the part.
    """
    names = sorted({sequence for sequence, _ in data.keys})
    names.sort(key=lambda name: hashlib.sha256(f"{draw}:{name}".encode()).digest())
    first, last = (math.floor(share * len(names) + 0.5) for share in part)
    chosen = set(names[first:last])
    if not chosen:
        raise DatasetError(
            f"{data.root}: expected at least one of its {count_of(len(names), 'sequence')} "
            f"in the part {part[0]:g} to {part[1]:g}; "
            "got none. Take a larger part."
        )
    return data.select([index for index, (sequence, _) in enumerate(data.keys) if sequence in chosen])


def annotated_frames(data: Dataset, unannotated: str) -> Dataset:
    """The frames that were annotated; those without any box were, those without an annotation were not.

    Args:
        data: The frames.
        unannotated: ``"refuse"`` or ``"skip"``.

    Raises:
        DatasetError: If there are frames without annotation and they are refused, or if no frame has one.
    """
    annotated = [index for index in range(len(data)) if data.has_annotation(index)]
    lacking = len(data) - len(annotated)
    if lacking and unannotated == "refuse":
        raise DatasetError(
            f"{data.root}: {lacking} of {count_of(len(data), 'frame')} have "
            "no annotation and would train as empty ones. "
            "Set training.unannotated=skip to leave them out, or name a split or folder of annotated ones."
        )
    if not annotated:
        raise DatasetError(f"{data.root}: expected annotated frames to train on, found none.")
    return data.select(annotated) if lacking else data


def held_out(data: Dataset, count: int) -> tuple[Dataset, Dataset | None]:
    """Part frames into those that are trained on and some that are not.

    Whole sequences are held out where there are others: neighbouring frames look alike. Of a single sequence it is its
    end.

    Args:
        data: The frames.
        count: How many to hold out; 0 holds out none.

    Raises:
        DatasetError: If that leaves no frame to train on.
    """
    if not count:
        return data, None
    names = sorted(set(data.sequences), key=lambda name: hashlib.sha256(f"held:{name}".encode()).digest())
    chosen: set[str] = set()
    for name in names[:-1]:
        if sum(sequence in chosen for sequence in data.sequences) < count:
            chosen.add(name)
    held = [index for index, sequence in enumerate(data.sequences) if sequence in chosen]
    if len(held) < count:
        held = list(range(len(data)))[-count:]
    trained = [index for index in range(len(data)) if index not in set(held)]
    if not trained:
        raise DatasetError(
            f"{data.root}: expected more than {count_of(count, 'frame')}, to hold so many out; got {len(data)}."
        )
    return data.select(trained), data.select([held[row] for row in spread(len(held), count)])


def without(data: Dataset, held: Dataset) -> Dataset:
    """The frames that are not among others: neither by name in the same folder nor by the contents of their files.

    Args:
        data: The frames.
        held: Those to leave out; what is not among ``data`` does not matter.
    """
    names = set(held.keys) if data.root.resolve() == held.root.resolve() else set()
    copies, _ = common_frames(data, " ".join(frame_digests(held)))
    left = [index for index, key in enumerate(data.keys) if key not in names and not copies[index]]
    return data if len(left) == len(data) else data.select(left)


def spread(count: int, most: int) -> Sequence[int]:
    """Indices of at most so many of ``count`` frames, spread evenly; all of them if ``most`` is 0.

    >>> list(spread(10, 3)), list(spread(3, 0))
    ([0, 3, 6], [0, 1, 2])
    """
    return range(count) if not most or count <= most else [number * count // most for number in range(most)]

"""Training samples, and batches of them: a frame's clouds, changed at random, with the targets of its boxes.

A sample is a function of (seed, stream, position) alone. A run that is resumed at any step, or that has more or fewer
workers, sees exactly the same samples.
"""

import hashlib
import os
import signal
import threading
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from lightning_fabric import Fabric
from torch import Tensor
from torch.utils.data import DataLoader
from torch.utils.data import Dataset as TorchDataset

from farfield.datasets.base import Dataset
from farfield.detectors.inputs import CloudInput, Inputs, cloud_tensor
from farfield.detectors.network import Assigner
from farfield.errors import ConfigError, DatasetError
from farfield.files.remote_stores import may_be_copied
from farfield.frame import Annotation, Key
from farfield.geometry.boxes import BOX_MARGIN_M, Boxes, count_points_in_boxes
from farfield.training.augmentation import SWEEP, Points, Progress, RollingBank, augment, cut_out
from farfield.training.config import UNCHANGED, AugmentationConfig
from farfield.training.method import LABELLED, Batch, Stream
from farfield.training.weather import WeatherOverlay, check_weather, draw_weather, read_with
from farfield.vocabulary.classes import CIRRUS_CLASSES, UNSURE, closest_class
from farfield.vocabulary.counts import count_of

_ORDER, _BANK, _CHANGES, _WEATHER = 1, 2, 3, 6  # keys of the generators; 4 and 5 are the loop's and the methods'
_LOOKED_AT, _LEAST_BOXES = 10, 20  # frames, and their boxes, of which none has points: no more are looked at
_LOOK_S = 0.5  # between a worker's looks whether its training still runs
_FIRST = ("x_m", "y_m", "z_m", "lag_s", "sweep")

Binding = Mapping[str, str]
"""Which of a frame's clouds each of the network's inputs reads."""


_NAMES_LOOKED_AT = 200


class TrainingSample(NamedTuple):
    """One frame as the network takes it."""

    inputs: dict[str, Tensor]
    targets: Any
    boxes: Boxes | None = None


def bindings(
    inputs: Mapping[str, CloudInput], clouds: Sequence[str] | Mapping[str, Sequence[str]]
) -> tuple[Binding, ...]:
    """Bind clouds to the inputs of a network; each binding gives one sample a frame.

    Args:
        inputs: The network's inputs.
        clouds: Names of clouds that its only input reads in turn, or the same for each input by its name: as many for
            each, or one that goes with all.

    Raises:
        ConfigError: If the inputs and the clouds do not fit.

    >>> bindings({"points": CloudInput()}, ("gaussian", "uniform"))
    ({'points': 'gaussian'}, {'points': 'uniform'})
    """
    if not isinstance(clouds, Mapping):
        if len(inputs) != 1:
            raise ConfigError(f"Expected clouds for each of the inputs {', '.join(inputs)}; got {', '.join(clouds)}.")
        clouds = {next(iter(inputs)): clouds}
    if set(clouds) != set(inputs):
        raise ConfigError(f"Expected clouds for the inputs {', '.join(inputs)}; got them for {', '.join(clouds)}.")
    count = max(map(len, clouds.values()))
    wrong = [name for name, names in clouds.items() if len(names) not in (1, count)]
    if wrong or count == 0:
        raise ConfigError(f"Expected one cloud or {count} for each input; {', '.join(wrong) or 'there is none'}.")
    return tuple({name: names[i % len(names)] for name, names in clouds.items()} for i in range(count))


class TrainingSamples(TorchDataset[TrainingSample]):
    """Samples of one stream by their position in the endless stream of epochs.

    Args:
        data: The frames; annotated ones, if the stream is labelled.
        inputs: The network's inputs.
        clouds: Which of a frame's clouds they read, see :func:`bindings`; each binding gives one sample a frame.
        classes: Class names of the detector; boxes of other classes are left out.
        assigner: Gives a frame its targets, from its boxes and inputs.
        augmentation: Random changes.
        min_points: Boxes with fewer points in the present sweep of the sample's clouds are left out.
        seed: Seed of order and changes.
        aliases: Renames classes before they are looked up: trains ``large_vehicle`` as ``vehicle``.
        far_sampling: Weight that a frame with an average number of far boxes gains over one without any; an epoch draws
            frames by their weight. With 0 it holds every sample once.
        far_from_m: Boxes from this range on are far.
        name: The stream's name.
        stream: What the stream is.
        negatives: Mined boxes of the class ``clutter`` by frame, whose points can be pasted without a box.

    Raises:
        ConfigError: If the clouds do not fit the inputs, or weather cannot be laid over them.
    """

    def __init__(
        self,
        data: Dataset,
        *,
        inputs: Mapping[str, CloudInput],
        clouds: Sequence[str] | Mapping[str, Sequence[str]],
        classes: Sequence[str],
        assigner: Assigner,
        augmentation: AugmentationConfig,
        min_points: int = 1,
        seed: int = 0,
        aliases: dict[str, str] | None = None,
        far_sampling: float | int = 0.0,
        far_from_m: float | int = 150.0,
        name: str = LABELLED,
        stream: Stream | None = None,
        negatives: Mapping[Key, Boxes] | None = None,
    ) -> None:
        self.data, self.inputs, self.bindings = data, dict(inputs), bindings(inputs, clouds)
        self.classes, self.assigner, self.augmentation = tuple(classes), assigner, augmentation
        self.min_points, self.seed, self.aliases = min_points, seed, aliases or {}
        self.far_sampling, self.far_from_m = float(far_sampling), float(far_from_m)
        self.name, self.stream = name, stream or Stream()
        self.labelled, self.negatives = self.stream.labelled, negatives or {}
        if not self.labelled:
            self.augmentation, self.far_sampling = augmentation.model_copy(update={"pasted": {}}), 0.0
        if not self.stream.changed:
            self.augmentation = UNCHANGED
        self.together = 1 if self.stream.members == "mixed" else len(self.bindings)
        if self.stream.members != "mixed" and self.together < 2:
            raise ConfigError(
                f"{name}: expected at least two clouds a frame, such as clouds: [gaussian, uniform], for samples that "
                f"come {self.stream.members}; got {', '.join(self.bindings[0].values())}."
            )
        self.read = {name: read_with(cloud, self.augmentation.weather) for name, cloud in self.inputs.items()}
        self.columns = tuple(dict.fromkeys([*_FIRST, *(c for columns in self.read.values() for c in columns)]))
        check_weather(self.augmentation.weather, self.inputs)
        self._weights: np.ndarray | None = None
        self._set_up()

    def _set_up(self) -> None:
        """Make what cannot travel to another process."""
        self._order = lru_cache(maxsize=2)(self._epoch)
        self._last = lru_cache(maxsize=1)(self._augmented)
        self._bank_order = lru_cache(maxsize=4)(self._bank_epoch)
        self._bank = None
        if self.augmentation.pasted:
            frames = min(self.augmentation.bank_frames, self._loads)
            self._bank = RollingBank(self._cut_out, self._bank_number, frames)

    @property
    def epoch_length(self) -> int:
        """Samples an epoch: frames times bindings."""
        return len(self.data) * len(self.bindings)

    @property
    def _joint(self) -> bool:
        """Whether all bindings of a frame are read, and changed, at once."""
        return self.stream.members == "paired"

    @property
    def _loads(self) -> int:
        """Numbers that :meth:`load` takes."""
        return len(self.data) if self._joint else self.epoch_length

    def _generator(self, purpose: int, number: int) -> np.random.Generator:
        """The generator of a purpose and a number; each stream has generators of its own."""
        digest = hashlib.sha256(self.name.encode()).digest()
        stream = () if self.name == LABELLED else (int.from_bytes(digest[:8], "little"),)
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(purpose, *stream, number)))

    def load(self, number: int) -> tuple[Points, Boxes]:
        """The unchanged points and boxes of sample ``number`` of an epoch in order; of a paired stream, of a frame.

        The points of all inputs, and of all samples of a pair, stand in one table: x, y, z, lag, the number of the
        sweep (0 for the present one), the other columns that the inputs read, zero where a point's input does not read
        them, and the number of the input, of the sample, that a point belongs to.
        """
        count = len(self.bindings)
        index, bound = (number, self.bindings) if self._joint else (number // count, [self.bindings[number % count]])
        frame = self.data[index]
        tables = []
        for part, (name, cloud) in enumerate((name, binding[name]) for binding in bound for name in self.inputs):
            columns = tuple(dict.fromkeys([*_FIRST, *self.read[name]]))
            rows = cloud_tensor(frame.cloud(cloud), columns).numpy()
            table = np.zeros((len(rows), len(self.columns) + 1), dtype=np.float32)
            table[:, [self.columns.index(column) for column in columns]] = rows
            table[:, -1] = part
            tables.append(table)
        points = np.concatenate(tables, dtype=np.float32)
        if not self.labelled:
            return points, Boxes.empty()
        return points, self._filled(points, self._trained_boxes(frame.annotation, frame.key))

    def _filled(self, points: Points, boxes: Boxes) -> Boxes:
        """The boxes that hold enough points of the present sweep."""
        if self.min_points and len(boxes):
            boxes = boxes[_count(points, boxes) >= self.min_points]
        return boxes

    def _trained_boxes(self, annotation: Annotation | None, key: Key) -> Boxes:
        """A frame's boxes of the classes that are trained.

        Raises:
            DatasetError: If the frame was not annotated: it would train as background.
        """
        if annotation is None:
            raise DatasetError(
                f"{self.data.root}: expected annotated frames to train on; frame {key} is not annotated and would "
                "count as empty. Leave such frames out (training.unannotated: skip)."
            )
        boxes = annotation.boxes.relabel(self.aliases)
        return boxes[np.isin(boxes.label, (*self.classes, UNSURE))]

    def _cut_out(self, number: int) -> "list[tuple[Points, Boxes]]":
        points, boxes = self.load(number)
        clutter = self.negatives.get(self.data.keys[number if self._joint else number // len(self.bindings)])
        sets = [boxes] if clutter is None else [boxes, clutter]
        return [cut for one in sets for cut in cut_out(points, one, min_points=self.augmentation.pasted_min_points)]

    def _bank_epoch(self, epoch: int) -> np.ndarray:
        return self._generator(_BANK, epoch).permutation(self._loads)

    def _bank_number(self, position: int) -> int:
        return int(self._bank_order(position // self._loads)[position % self._loads])

    def prepare(self, position: int = 0, progress: Progress = iter) -> None:
        """Read what the sample at ``position`` needs besides its frame; without this the first sample does it.

        That is the annotation of all frames, where far boxes decide how often a frame is drawn, and the frames whose
        objects are pasted.
        """
        if self.labelled:
            self._check_boxes()
        self._weigh(progress)
        if self._bank is not None:
            self._bank.at(position, progress)

    def names_left_out(self) -> dict[str, int]:
        """Names that are neither trained nor of our vocabulary, with the number of their boxes in the first frames."""
        names: Counter[str] = Counter()
        for index in range(min(len(self.data), _NAMES_LOOKED_AT)) if self.labelled else ():
            annotation = self.data.annotation(index)
            if annotation is not None:
                names.update(map(str, annotation.boxes.relabel(self.aliases).label))
        return {name: count for name, count in names.items() if name not in (*self.classes, *CIRRUS_CLASSES, UNSURE)}

    def _check_boxes(self) -> None:
        """Refuse frames of which none has a box of a trained class: the loss of boxes would be 0 to the end.

        Raises:
            DatasetError: If there is none, or none holds a point, of all or of the first twenty and more.
        """
        others: dict[str, int] = {}
        box_count = frame_count = filled_count = 0
        for index, key in enumerate(self.data.keys):
            annotation = self.data.annotation(index)
            boxes = _sure(self._trained_boxes(annotation, key))
            if annotation is not None and not len(boxes):
                for name in np.asarray(annotation.boxes.label).tolist():
                    others[str(name)] = others.get(str(name), 0) + 1
                continue
            _, filled = self.load(index if self._joint else index * len(self.bindings))
            filled_count += len(_sure(filled))
            box_count += len(boxes)
            frame_count += 1
            if filled_count or (frame_count >= _LOOKED_AT and box_count >= _LEAST_BOXES):
                break
        if not box_count:
            raise no_boxes(self.data, self.name, self.classes, others)
        if not filled_count:
            raise DatasetError(
                f"{self.data.root}: expected boxes with at least {self.min_points} points, found none among "
                f"{count_of(box_count, 'box', 'boxes')} of {count_of(frame_count, 'frame')}: "
                "boxes and points do not lie in one place. "
                "farfield doctor DATA says how"
            )

    def _weigh(self, progress: Progress = iter) -> np.ndarray | None:
        """Weight of each sample of an epoch, shape (epoch_length,), by the far boxes of its frame."""
        if self._weights is None and self.far_sampling > 0:
            far = np.zeros(len(self.data), dtype=np.float64)
            for index in progress(range(len(self.data))):
                boxes = _sure(self._trained_boxes(self.data.annotation(index), self.data.keys[index]))
                far[index] = np.count_nonzero(np.hypot(*boxes.centre_m[:, :2].T) >= self.far_from_m)
            weight = 1 + self.far_sampling * far / max(float(far.mean()), 1e-9)
            self._weights = np.repeat(weight, len(self.bindings))
        return self._weights

    def _epoch(self, epoch: int) -> np.ndarray:
        """The samples of an epoch in their order, shape (epoch_length,)."""
        rng, weight, count = self._generator(_ORDER, epoch), self._weigh(), len(self.bindings)
        if self.stream.members == "mixed":
            return _drawn(self.epoch_length, weight, rng)
        frame_weight = None if weight is None else weight[::count]
        if self._joint:
            return _drawn(len(self.data), frame_weight, rng)
        members = [_drawn(len(self.data), frame_weight, rng) * count + member for member in range(count)]
        return np.stack(members, axis=1).reshape(-1)

    def __len__(self) -> int:
        return self.epoch_length

    def __getitem__(self, position: int) -> TrainingSample:
        """The sample at a position of the stream; position // epoch_length is its epoch."""
        if self._joint:
            unit, member = divmod(position, self.together)
            points, boxes = self._last(unit)
            points = points[points[:, -1] // len(self.inputs) == member]
            points[:, -1] -= member * len(self.inputs)
            boxes = self._filled(points, boxes)
        else:
            points, boxes = self._augmented(position)
        inputs = {}
        for part, (name, cloud) in enumerate(self.inputs.items()):
            rows = points if len(self.inputs) == 1 else points[points[:, -1] == part]
            chosen = rows[:, [self.columns.index(column) for column in cloud.columns]]
            inputs[name] = np.ascontiguousarray(chosen, dtype=np.float32)
        targets = self.assigner(boxes, inputs) if self.labelled else None
        counted = None
        if self.stream.boxes:
            boxes = boxes[np.asarray(boxes.label) != UNSURE]
            counted = boxes.replace(point_count=_count(points, boxes))
        return TrainingSample({name: torch.from_numpy(rows) for name, rows in inputs.items()}, targets, counted)

    def _augmented(self, unit: int) -> tuple[Points, Boxes]:
        """Points and boxes at a position, or of a pair, after the random changes."""
        epoch, index = divmod(unit, self._loads)
        points, boxes = self.load(int(self._order(epoch)[index]))
        bank = None if self._bank is None else self._bank.at(unit * self.together if self._joint else unit)
        weather = self._weather(unit)
        intensity = self.columns.index("intensity") if "intensity" in self.columns else None
        return augment(points, boxes, self.augmentation, self._generator(_CHANGES, unit), bank, weather, intensity)

    def _weather(self, unit: int) -> WeatherOverlay | None:
        """What lays weather over the frame at a position, or over a pair; None where it stays as it is."""
        config = self.augmentation.weather
        if config is None:
            return None
        rng = self._generator(_WEATHER, unit)
        drawn = draw_weather(config, rng)
        return None if drawn is None else WeatherOverlay(config, self.columns, tuple(self.read.values()), drawn, rng)

    def __getstate__(self) -> dict[str, Any]:
        rebuilt = ("_order", "_last", "_bank_order", "_bank")
        return {key: value for key, value in self.__dict__.items() if key not in rebuilt}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._set_up()


def no_boxes(data: Dataset, stream: str, classes: Sequence[str], others: Mapping[str, int]) -> DatasetError:
    """The error of frames without one box of the trained classes.

    Args:
        data: The frames.
        stream: Name of the stream.
        classes: The trained classes.
        others: The classes that there are, with the number of their boxes.
    """
    shown = ", ".join(f"{name} ({count})" for name, count in others.items()) or "no box at all"
    pairs = {name: meant for name in others if (meant := closest_class(name, classes))}
    pairs = pairs or dict.fromkeys(list(others)[:1], classes[0] if classes else "")
    aliases = ", ".join(f"{name}: {meant}" for name, meant in pairs.items())
    key = "data" if stream == LABELLED else f"data.{stream}"
    fix = (
        f" Say which is meant: -o '{key}.aliases={{{aliases}}}', or train them: detector.class_names" if others else ""
    )
    return DatasetError(
        f"{data.root}: expected boxes of the trained classes {', '.join(classes)}, "
        f"found none in {count_of(len(data), 'frame')}; "
        f"there are: {shown}.{fix if others else ''}"
    )


def _sure(boxes: Boxes) -> Boxes:
    """The boxes of objects, without those of what may be one."""
    return boxes[np.asarray(boxes.label) != UNSURE]


def _count(points: Points, boxes: Boxes) -> Int[np.ndarray, " n"]:
    """Points of the present sweep in each box, shape (n,)."""
    return count_points_in_boxes(points[points[:, SWEEP] == 0, :3], boxes, margin_m=BOX_MARGIN_M)


def _drawn(count: int, weight: Float[np.ndarray, " n"] | None, rng: np.random.Generator) -> Int[np.ndarray, " n"]:
    """Numbers below ``count`` in random order, by their weight if there is one."""
    return rng.permutation(count) if weight is None else rng.permutation(systematic(weight, rng))


def systematic(weight: Float[np.ndarray, " n"], rng: np.random.Generator) -> Int[np.ndarray, " n"]:
    """Draw as many samples as there are, each as often as its share of the weight, rounded up or down at random.

    One random offset decides all (systematic sampling), so equal weights give every sample once.
    """
    edges = np.cumsum(weight) / weight.sum() * len(weight)
    edges[-1] = len(weight)
    upto = np.floor(edges + rng.random()).astype(np.int64)
    return np.repeat(np.arange(len(weight)), np.diff(upto, prepend=0))


# Batches of several streams of samples, from one loader

Position = tuple[str, int]
"""Name of a stream and a position in it."""


class StreamSamples(TorchDataset[TrainingSample]):
    """The samples of several streams, a batch at a time: one loader's workers serve them all."""

    def __init__(self, streams: Mapping[str, TrainingSamples]) -> None:
        self.streams = dict(streams)

    def __len__(self) -> int:
        return sum(map(len, self.streams.values()))

    def __getitems__(self, positions: Sequence[Position]) -> dict[str, list[TrainingSample]]:
        """The samples of a batch, by stream."""
        batch: dict[str, list[TrainingSample]] = {}
        for name, position in positions:
            batch.setdefault(name, []).append(self.streams[name][position])
        return batch


def batch_shares(
    batch_size: int, streams: Mapping[str, Stream], world: int = 1, units: Mapping[str, int] | None = None
) -> dict[str, int]:
    """Samples of each stream in a batch, by their shares.

    Args:
        batch_size: Samples of all streams, over all processes.
        streams: The streams.
        world: Number of processes.
        units: Samples of each stream that stay together, such as pairs; 1 where left out.

    Raises:
        ConfigError: If a stream gets none, the numbers do not add up, or the processes do not divide them.

    >>> batch_shares(4, {"source": Stream(), "target": Stream(labelled=False)})
    {'source': 2, 'target': 2}
    """
    total = sum(stream.share for stream in streams.values())
    counts = {name: round(batch_size * stream.share / total) for name, stream in streams.items()}
    if sum(counts.values()) != batch_size or min(counts.values()) < 1:
        raise ConfigError(
            f"Expected a batch_size that the shares of the streams {', '.join(streams)} divide; got {batch_size}, "
            f"which gives {', '.join(f'{name} {count}' for name, count in counts.items())}."
        )
    units = units or {}
    uneven = [name for name, count in counts.items() if count % (world * units.get(name, 1))]
    if uneven:
        groups = (
            f" with {count_of(units[uneven[0]], 'sample')} that stay together" if units.get(uneven[0], 1) > 1 else ""
        )
        raise ConfigError(
            f"Expected a batch_size that {world} processes{groups} divide, for each stream; got {batch_size}, of which "
            f"{counts[uneven[0]]} for {uneven[0]}."
        )
    return counts


def batches(
    streams: Mapping[str, TrainingSamples],
    counts: Mapping[str, int],
    *,
    first_step: int,
    steps: int,
    workers: int,
    rank: int = 0,
    world: int = 1,
    pinned: bool = False,
) -> Iterator[dict[str, list[TrainingSample]]]:
    """Batches from ``first_step`` on, by stream; with several processes each takes every ``world``-th sample.

    Samples that stay together, such as pairs, go to one process.

    Args:
        streams: The samples of each stream.
        counts: How many of each are in a batch, over all processes.
        first_step: Steps done.
        steps: Steps in all.
        workers: Processes that prepare samples.
        rank: Number of this process.
        world: Number of processes.
        pinned: Put tensors into pinned memory, from which copies to a GPU need not be waited for.
    """
    positions: list[list[Position]] = []
    for step in range(first_step, steps):
        positions.append([])
        for name, count in counts.items():
            together = streams[name].together
            units = range(step * count // together + rank, (step + 1) * count // together, world)
            positions[-1] += [(name, unit * together + member) for unit in units for member in range(together)]
    loader: DataLoader[Any] = DataLoader(
        StreamSamples(streams),
        batch_sampler=positions,
        num_workers=workers,
        multiprocessing_context=None if may_be_copied() or not workers else "spawn",
        collate_fn=dict,  # a batch comes by stream as it is
        worker_init_fn=_one_thread,
        prefetch_factor=4 if workers else None,
        pin_memory=pinned,
    )
    return iter(loader)


def _one_thread(_: int) -> None:
    torch.set_num_threads(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the training's, which ends its workers
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()


def _end_with(parent: int) -> None:
    """End this worker when its training was killed: it holds the run's folder as long as it lives."""
    while os.getppid() == parent:
        time.sleep(_LOOK_S)
    os._exit(1)


def to_batch(samples: list[TrainingSample], fabric: Fabric) -> Batch:
    """Samples as a batch on the process' device."""
    names = samples[0].inputs
    inputs = Inputs({name: [fabric.to_device(sample.inputs[name]) for sample in samples] for name in names})
    targets = [sample.targets for sample in samples if sample.targets is not None]
    return Batch(inputs, targets, [sample.boxes for sample in samples if sample.boxes is not None])

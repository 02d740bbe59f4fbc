"""Training samples: a frame's cloud, changed at random, with the targets of its boxes.

A sample is a function of (seed, position) alone. A run that is resumed at any step, or that has more or fewer workers,
sees exactly the same samples.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.utils.data import DataLoader
from torch.utils.data import Dataset as TorchDataset

from farfield.datasets.base import Dataset
from farfield.detectors.inputs import POSITION, cloud_tensor
from farfield.frame import Frame
from farfield.geometry.boxes import Boxes
from farfield.geometry.points import count_points_in_boxes
from farfield.training.augmentation import augment
from farfield.training.bank import Points, Progress, RollingBank, cut_out
from farfield.training.config import AugmentationConfig


class Sample(NamedTuple):
    """One frame as the network takes it."""

    points: Tensor
    targets: Any


class TrainingSamples(TorchDataset[Sample]):
    """Samples by their position in the endless stream of epochs.

    Args:
        data: Annotated frames.
        clouds: Names of the clouds to train on; each frame gives one sample a cloud.
        classes: Class names of the detector; boxes of other classes are left out.
        assigner: The network's, of a frame's boxes and inputs.
        augmentation: Random changes.
        columns: Columns of the clouds that the detector reads.
        min_points: Boxes with fewer points in the present sweep of the sample's cloud are left out.
        seed: Seed of order and changes.
        aliases: Renames classes before they are looked up: trains ``large_vehicle`` as ``vehicle``.
        far_sampling: Weight that a frame with an average number of far boxes gains over one without any; an epoch draws
            frames by their weight. With 0 it holds every sample once.
        far_from_m: Boxes from this range on are far.
    """

    def __init__(
        self,
        data: Dataset,
        *,
        clouds: Sequence[str],
        classes: Sequence[str],
        assigner: Callable[[Boxes, Mapping[str, np.ndarray]], Any],
        augmentation: AugmentationConfig,
        columns: Sequence[str] = (*POSITION, "intensity", "lag_s"),
        min_points: int = 1,
        seed: int = 0,
        aliases: dict[str, str] | None = None,
        far_sampling: float | int = 0.0,
        far_from_m: float | int = 150.0,
    ) -> None:
        self.data, self.clouds, self.classes, self.assigner = data, tuple(clouds), tuple(classes), assigner
        self.augmentation, self.columns, self.min_points = augmentation, tuple(columns), min_points
        self.seed, self.aliases = seed, aliases or {}
        self.far_sampling, self.far_from_m = float(far_sampling), float(far_from_m)
        self.loaded = self.columns if "lag_s" in self.columns else (*self.columns, "lag_s")
        self._weights: np.ndarray | None = None
        self._set_up()

    def _set_up(self) -> None:
        """Make what cannot travel to another process."""
        self._order = lru_cache(maxsize=2)(self._epoch)
        bank_order = lru_cache(maxsize=4)(lambda epoch: self._generator(2, epoch).permutation(self.epoch_length))
        frames = min(self.augmentation.bank_frames, self.epoch_length)
        self._bank = None
        if self.augmentation.pasted:
            self._bank = RollingBank(
                self._cut_out,
                lambda place: int(bank_order(place // self.epoch_length)[place % self.epoch_length]),
                frames,
            )

    @property
    def epoch_length(self) -> int:
        """Samples an epoch: frames times clouds."""
        return len(self.data) * len(self.clouds)

    def _generator(self, *words: int) -> np.random.Generator:
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=words))

    def load(self, number: int) -> tuple[np.ndarray, Boxes]:
        """The unchanged points and boxes of sample ``number`` of an epoch in order."""
        frame = self.data[number // len(self.clouds)]
        points = cloud_tensor(frame.cloud(self.clouds[number % len(self.clouds)]), self.loaded).numpy()
        boxes = self._wanted(frame)
        if self.min_points and len(boxes):
            present = points[points[:, self.loaded.index("lag_s")] == 0, :3]
            boxes = boxes[count_points_in_boxes(present, boxes, margin_m=0.05) >= self.min_points]
        return points, boxes

    def _wanted(self, frame: Frame) -> Boxes:
        """The frame's boxes of the classes that are trained."""
        boxes = (frame.boxes if frame.boxes is not None else Boxes.empty()).relabel(self.aliases)
        return boxes[np.isin(boxes.label, self.classes)]

    def _cut_out(self, number: int) -> "list[tuple[Points, Boxes]]":
        lag = self.loaded.index("lag_s")
        return cut_out(*self.load(number), min_points=self.augmentation.pasted_min_points, lag=lag)

    def prepare(self, position: int = 0, progress: Progress = iter) -> None:
        """Read what the sample at ``position`` needs besides its frame; without this the first sample does it.

        That is the annotation of all frames, where far boxes decide how often a frame is drawn, and the frames whose
        objects are pasted.
        """
        self._weigh(progress)
        if self._bank is not None:
            self._bank.at(position, progress)

    def _weigh(self, progress: Progress = iter) -> np.ndarray | None:
        """Weight of each sample of an epoch, shape (epoch_length,), by the far boxes of its frame."""
        if self._weights is None and self.far_sampling > 0:
            far = np.zeros(len(self.data), dtype=np.float64)
            for index in progress(range(len(self.data))):
                boxes = self._wanted(self.data[index])
                far[index] = np.count_nonzero(np.hypot(*boxes.centre_m[:, :2].T) >= self.far_from_m)
            weight = 1 + self.far_sampling * far / max(float(far.mean()), 1e-9)
            self._weights = np.repeat(weight, len(self.clouds))
        return self._weights

    def _epoch(self, epoch: int) -> np.ndarray:
        """The samples of an epoch in their order, shape (epoch_length,)."""
        rng, weight = self._generator(1, epoch), self._weigh()
        if weight is None:
            return rng.permutation(self.epoch_length)
        return rng.permutation(systematic(weight, rng))

    def __len__(self) -> int:
        return self.epoch_length

    def __getitem__(self, position: int) -> Sample:
        """The sample at a position of the stream; position // epoch_length is its epoch."""
        epoch, place = divmod(position, self.epoch_length)
        points, boxes = self.load(int(self._order(epoch)[place]))
        bank = None if self._bank is None else self._bank.at(position)
        points, boxes = augment(points, boxes, self.augmentation, self._generator(3, position), bank)
        points = np.ascontiguousarray(points[:, : len(self.columns)], dtype=np.float32)
        return Sample(torch.from_numpy(points), self.assigner(boxes, {"points": points}))

    def __getstate__(self) -> dict[str, Any]:
        return {key: value for key, value in self.__dict__.items() if key not in ("_order", "_bank")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._set_up()


def systematic(weight: Float[np.ndarray, " n"], rng: np.random.Generator) -> Int[np.ndarray, " n"]:
    """Draw as many samples as there are, each as often as its share of the weight, rounded up or down at random.

    One random offset decides all (systematic sampling), so equal weights give every sample once.
    """
    edges = np.cumsum(weight) / weight.sum() * len(weight)
    edges[-1] = len(weight)
    upto = np.floor(edges + rng.random()).astype(np.int64)
    return np.repeat(np.arange(len(weight)), np.diff(upto, prepend=0))


def batches(
    samples: TrainingSamples,
    *,
    first_step: int,
    steps: int,
    batch_size: int,
    workers: int,
    rank: int = 0,
    world: int = 1,
) -> Iterator[list[Sample]]:
    """Batches from ``first_step`` on; with several processes each takes every ``world``-th sample of a batch."""
    positions = [
        list(range(step * batch_size + rank, (step + 1) * batch_size, world)) for step in range(first_step, steps)
    ]
    loader: DataLoader[Sample] = DataLoader(
        samples,
        batch_sampler=positions,
        num_workers=workers,
        collate_fn=list,
        worker_init_fn=_one_thread,
        prefetch_factor=4 if workers else None,
    )
    return iter(loader)


def _one_thread(_: int) -> None:
    torch.set_num_threads(1)

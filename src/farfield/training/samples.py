"""Training samples: a frame's cloud, changed at random, with the targets of its boxes.

A sample is a function of (seed, position) alone. A run that is resumed at any step, or that has more or fewer workers,
sees exactly the same samples.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader
from torch.utils.data import Dataset as TorchDataset

from farfield.datasets.base import Dataset
from farfield.detectors.runtime import cloud_tensor
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
        targets: The network's target function, of a frame's boxes and points.
        augmentation: Random changes.
        min_points: Boxes with fewer points in the present sweep of the sample's cloud are left out.
        seed: Seed of order and changes.
        aliases: Renames classes before they are looked up: trains ``large_vehicle`` as ``vehicle``.
    """

    def __init__(
        self,
        data: Dataset,
        *,
        clouds: Sequence[str],
        classes: Sequence[str],
        targets: Callable[[Boxes, np.ndarray], Any],
        augmentation: AugmentationConfig,
        min_points: int = 1,
        seed: int = 0,
        aliases: dict[str, str] | None = None,
    ) -> None:
        self.data, self.clouds, self.classes, self.targets = data, tuple(clouds), tuple(classes), targets
        self.augmentation, self.min_points, self.seed, self.aliases = augmentation, min_points, seed, aliases or {}
        self._prepare()

    def _prepare(self) -> None:
        """Make what cannot travel to another process."""
        self._order = lru_cache(maxsize=2)(lambda epoch: self._generator(1, epoch).permutation(self.epoch_length))
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
        points = cloud_tensor(frame.cloud(self.clouds[number % len(self.clouds)])).numpy()
        boxes = (frame.boxes if frame.boxes is not None else Boxes.empty()).relabel(self.aliases)
        boxes = boxes[np.isin(boxes.label, self.classes)]
        if self.min_points and len(boxes):
            present = points[points[:, 4] == 0, :3]
            boxes = boxes[count_points_in_boxes(present, boxes, margin_m=0.05) >= self.min_points]
        return points, boxes

    def _cut_out(self, number: int) -> "list[tuple[Points, Boxes]]":
        return cut_out(*self.load(number), min_points=self.augmentation.pasted_min_points)

    def fill_bank(self, position: int = 0, progress: Progress = iter) -> None:
        """Read the frames whose objects are pasted at ``position``; without this the first sample does it."""
        if self._bank is not None:
            self._bank.at(position, progress)

    def __len__(self) -> int:
        return self.epoch_length

    def __getitem__(self, position: int) -> Sample:
        """The sample at a position of the stream; position // epoch_length is its epoch."""
        epoch, place = divmod(position, self.epoch_length)
        points, boxes = self.load(int(self._order(epoch)[place]))
        bank = None if self._bank is None else self._bank.at(position)
        points, boxes = augment(points, boxes, self.augmentation, self._generator(3, position), bank)
        points = np.ascontiguousarray(points, dtype=np.float32)
        return Sample(torch.from_numpy(points), self.targets(boxes, points))

    def __getstate__(self) -> dict[str, Any]:
        return {key: value for key, value in self.__dict__.items() if key not in ("_order", "_bank")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._prepare()


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

"""A ring of object features by class, which the local loss of range adaptation compares with.

One batch seldom holds a near object that looks like a given far one. The memory is a module, so that the checkpoint
holds it; its features carry no gradient.
"""

from typing import NamedTuple

import torch
from torch import Tensor, distributed, nn

from farfield.detectors.losses import process_count, sum_over_processes

_NEVER = -(10**9)
_SENT = 64  # objects of a process that enter in a step, where there are several


class MemoryEntries(NamedTuple):
    """What the memory holds of a class.

    Attributes:
        feature: Shape (m, c), float32.
        descriptor: Shape (m, d), float32.
    """

    feature: Tensor
    descriptor: Tensor


class Memory(nn.Module):
    """The last near objects of each class.

    Args:
        classes: Number of classes.
        channels: Numbers of a feature.
        descriptor: Numbers of a descriptor.
        size: Objects of a class that are kept.
        max_age: Steps after which an entry no longer counts: the features of a trunk that learns drift.
    """

    def __init__(self, classes: int, channels: int, descriptor: int, *, size: int, max_age: int) -> None:
        super().__init__()
        self.size, self.max_age = size, max_age
        self.feature: Tensor
        self.descriptor: Tensor
        self.entered: Tensor
        self.following: Tensor
        self.register_buffer("feature", torch.zeros(classes, size, channels))
        self.register_buffer("descriptor", torch.zeros(classes, size, descriptor))
        self.register_buffer("entered", torch.full((classes, size), _NEVER))
        self.register_buffer("following", torch.zeros(classes, dtype=torch.int64))

    @torch.no_grad()
    def add(self, kind: Tensor, feature: Tensor, descriptor: Tensor, step: int) -> None:
        """Take objects in, the oldest of their class making way; with several processes those of all of them.

        Args:
            kind: Number of the class of each, shape (n,), int64.
            feature: Shape (n, c).
            descriptor: Shape (n, d).
            step: Number of the step.
        """
        rows = torch.cat([kind[:, None].float(), feature.detach().float(), descriptor.float()], 1)
        rows = _of_all_processes(rows)
        kind = rows[:, 0].long()
        channels = self.feature.shape[2]
        for number in range(len(self.feature)):
            new = rows[kind == number][-self.size :]
            place = (int(self.following[number]) + torch.arange(len(new), device=new.device)) % self.size
            self.feature[number, place] = new[:, 1 : 1 + channels]
            self.descriptor[number, place] = new[:, 1 + channels :]
            self.entered[number, place] = step
            self.following[number] = (self.following[number] + len(new)) % self.size

    def entries(self, kind: int, step: int) -> MemoryEntries:
        """What counts of a class at a step; a copy, so that later steps leave it as it is."""
        kept = self.entered[kind] >= step - self.max_age
        return MemoryEntries(self.feature[kind][kept], self.descriptor[kind][kept])


def _of_all_processes(rows: Tensor) -> Tensor:
    """The rows of all processes, those of the first first; up to 64 of each."""
    if process_count() == 1:
        return rows
    slots = rows.new_zeros(process_count(), _SENT, 1 + rows.shape[1])
    rows = rows[:_SENT]
    slots[distributed.get_rank(), : len(rows)] = torch.cat([torch.ones_like(rows[:, :1]), rows], 1)
    slots = sum_over_processes(slots).view(-1, slots.shape[2])
    return slots[slots[:, 0] > 0, 1:]


def similarity(descriptor: Tensor, entries: Tensor, tau: float) -> Tensor:
    """Weights of the entries for each object, softmax of -|o_i - o_t| / tau, shape (n, m).

    Descriptors are measured in the spread of the entries' own, so that no unit counts. (A transcription of the paper
    has a plus for the minus: it would favour what is least alike.)

    Args:
        descriptor: Those of the objects, shape (n, d).
        entries: Those of the memory, shape (m, d).
        tau: Temperature.
    """
    spread = entries.std(0, correction=0).clamp(min=0.05)
    gap = (descriptor[:, None] / spread - entries[None] / spread).norm(dim=2)
    return torch.softmax(-gap / tau, dim=1)


def effective_number(weights: Tensor) -> Tensor:
    """1 / sum of w^2 of each row, shape (n,): 1 copies one entry, m is the mean of all."""
    return 1 / weights.square().sum(1)

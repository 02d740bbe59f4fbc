"""Features and descriptors of objects: what the local loss of range adaptation compares (Wang et al., ICCVW 2019).

One batch seldom holds a near object that looks like a given far one, so a ring of near objects by class is remembered.
The memory is a module, so that the checkpoint holds it; its features carry no gradient.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, distributed, nn

from farfield.adaptation.cells import device_of, in_boxes
from farfield.detectors.features import FeatureMap, Features
from farfield.detectors.losses import process_count, sum_over_processes
from farfield.detectors.sparse.cells import SparseTensor
from farfield.geometry.boxes import Boxes

_STEPS = (-1 / 3, 0.0, 1 / 3)


class ObjectFeatures(NamedTuple):
    """Labelled objects of a batch.

    Attributes:
        feature: Shape (n, c), float32, with gradient.
        descriptor: Shape (n, d), float32.
        kind: Number of the class of each, shape (n,), int64.
        range_m: On the ground, shape (n,).
        points: Points in each, shape (n,), int64.
    """

    feature: Tensor
    descriptor: Tensor
    kind: Tensor
    range_m: Tensor
    points: Tensor

    def chosen(self, rows: Tensor) -> "ObjectFeatures":
        """Those of a mask, or at indices."""
        return ObjectFeatures(*(part[rows] for part in self))


def objects_of(
    features: Features, boxes: Sequence[Boxes], classes: Sequence[str], extent: Literal["full", "visible"]
) -> ObjectFeatures:
    """The objects of a batch that are of the classes and, on a map, stand on it.

    Args:
        features: Of the batch.
        boxes: Of each frame, with point counts.
        classes: Names by number.
        extent: What the boxes show; see :func:`descriptors`.
    """
    chosen = [_of_classes(features, frame_boxes, classes) for frame_boxes in boxes]
    count = sum(map(len, chosen))
    frame = np.repeat(np.arange(len(chosen)), [len(frame_boxes) for frame_boxes in chosen])
    device = device_of(features)
    objects = Boxes.concatenate(chosen) if chosen else Boxes.empty()
    number = {name: index for index, name in enumerate(classes)}
    kind = np.array([number[str(name)] for name in objects.label], dtype=np.int64)
    points = np.zeros(count, dtype=np.int64) if objects.point_count is None else objects.point_count
    return ObjectFeatures(
        _features(features, objects, torch.from_numpy(frame).to(device)),
        torch.from_numpy(descriptors(objects, extent)).float().to(device),
        torch.from_numpy(kind).to(device),
        torch.from_numpy(np.hypot(*objects.centre_m[:, :2].T)).float().to(device),
        torch.tensor(points, device=device),
    )


def _of_classes(features: Features, boxes: Boxes, classes: Sequence[str]) -> Boxes:
    keep = np.isin(boxes.label, list(classes))
    if isinstance(features, FeatureMap):
        upper = np.array(features.values.shape[-2:]) * features.cell_m
        offset_m = boxes.centre_m[:, :2] - np.array(features.origin_m)
        keep &= ((offset_m >= 0) & (offset_m < upper)).all(axis=1)
    return boxes[keep]


def descriptors(boxes: Boxes, extent: Literal["full", "visible"]) -> Float[np.ndarray, "n d"]:
    """What makes objects alike: log length, log width, log height, sine and cosine of the angle that they are seen at.

    The angle is the heading from the direction of sight: it decides which faces are seen. Length and width of visible
    parts depend on the range (a far car is its rear), so with ``"visible"`` they are left out.

    Args:
        boxes: The objects.
        extent: Whether the boxes hold whole objects or their visible parts.
    """
    seen_rad = boxes.yaw_rad - np.arctan2(boxes.centre_m[:, 1], boxes.centre_m[:, 0])
    sizes = np.log(boxes.size_m if extent == "full" else boxes.size_m[:, 2:])
    return np.column_stack([sizes, np.sin(seen_rad), np.cos(seen_rad)])


def _features(features: Features, boxes: Boxes, frame: Tensor) -> Tensor:
    """The mean feature of each object, shape (n, c), float32."""
    if isinstance(features, FeatureMap) and not isinstance(features.values, SparseTensor):
        return sampled(features, boxes, frame)
    return _mean_of_rows(features, boxes, frame)


def sampled(features: FeatureMap, boxes: Boxes, frame: Tensor) -> Tensor:
    """The mean of 3 x 3 bilinear samples in each turned box, at its centre and a third of its size off, (n, c).

    Args:
        features: A dense map.
        boxes: The objects.
        frame: Frame of each, shape (n,), int64.
    """
    grid = np.stack(np.meshgrid(_STEPS, _STEPS, indexing="ij"), axis=-1).reshape(1, 9, 2) * boxes.size_m[:, None, :2]
    cos, sin = np.cos(boxes.yaw_rad)[:, None], np.sin(boxes.yaw_rad)[:, None]
    x = boxes.centre_m[:, :1] + grid[..., 0] * cos - grid[..., 1] * sin
    y = boxes.centre_m[:, 1:2] + grid[..., 0] * sin + grid[..., 1] * cos
    samples_m = np.stack([x, y], axis=-1)
    cell = (samples_m - np.array(features.origin_m)) / features.cell_m - 0.5
    at = torch.from_numpy(cell).float().to(frame.device).reshape(-1, 2)
    return bilinear(features.dense, frame.repeat_interleave(9), at).view(len(boxes), 9, -1).mean(1)


def bilinear(image: Tensor, frame: Tensor, at: Tensor) -> Tensor:
    """Values between the centres of cells, those beyond the edge by the nearest cell, shape (n, c), float32.

    Args:
        image: Shape (b, c, nx, ny).
        frame: Shape (n,), int64.
        at: Place in cells, 0 at the first one's centre, shape (n, 2).
    """
    limit = at.new_tensor([image.shape[2] - 1, image.shape[3] - 1])
    at = torch.minimum(at.clamp(min=0), limit)
    low = at.floor()
    high, part = torch.minimum(low + 1, limit), at - low
    total = image.new_zeros(len(at), image.shape[1], dtype=torch.float32)
    for ix, wx in ((low[:, 0], 1 - part[:, 0]), (high[:, 0], part[:, 0])):
        for iy, wy in ((low[:, 1], 1 - part[:, 1]), (high[:, 1], part[:, 1])):
            total = total + image[frame, :, ix.long(), iy.long()].float() * (wx * wy)[:, None]
    return total


def _mean_of_rows(features: Features, boxes: Boxes, frame: Tensor) -> Tensor:
    """The mean of the rows in each box, grown by a cell; without any the nearest row; zero in an empty frame."""
    rows = features.rows()
    margin_m = features.cell_m if isinstance(features, FeatureMap) else 0.0
    means = rows.values.new_zeros(len(boxes), rows.values.shape[1], dtype=torch.float32)
    for index in range(len(boxes)):
        of_frame = (rows.frame == frame[index]).nonzero().squeeze(1)
        if not len(of_frame):
            continue
        rows_m = rows.place_m[of_frame].float()
        chosen = of_frame[in_boxes(rows_m, boxes[index : index + 1], margin_m).squeeze(1)]
        if not len(chosen):
            centre = rows_m.new_tensor(boxes.centre_m[index, :2])
            chosen = of_frame[(rows_m - centre).norm(dim=1).argmin()][None]
        means[index] = rows.values[chosen].float().mean(0)
    return means


# Memory of the objects of earlier batches, by class

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
            slots = (int(self.following[number]) + torch.arange(len(new), device=new.device)) % self.size
            self.feature[number, slots] = new[:, 1 : 1 + channels]
            self.descriptor[number, slots] = new[:, 1 + channels :]
            self.entered[number, slots] = step
            self.following[number] = (self.following[number] + len(new)) % self.size

    def entries(self, kind: int, step: int) -> MemoryEntries:
        """What counts of a class at a step; a copy, so that later steps leave it as it is."""
        valid = self.entered[kind] >= step - self.max_age
        return MemoryEntries(self.feature[kind][valid], self.descriptor[kind][valid])


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

"""Train the two networks of number plates on a pool of drawn crops.

Processes draw the crops into memory that they share. At two points of the training the crops on which the finder errs
most are taken more often. Then the judge learns from what the finder proposes on these crops.
"""

import mmap
import multiprocessing
import time
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass

import numpy as np
import torch
from _plates_training import SIDE, Sampler, loss_of, targets
from torch import Tensor, nn
from torch.nn import functional

from farfield.privacy.plate_network import STRIDE, PlateJudge, PlateNetwork, cut_patches, halved

MOST_BOXES, PROPOSED, PROPOSALS_A_CROP = 8, 0.03, 8
_BATCH, _RATE, _JUDGE_BATCH, _JUDGE_RATE = 32, 1e-3, 96, 2e-3
_HARD, _HARD_AT = 0.12, (0.4, 0.7)
_SAME_IOU = 0.35
_CELLS = SIDE // STRIDE


@dataclass
class Pool:
    """Crops and what there is to learn from them, in memory that processes share.

    Args:
        image: Shape (n, 128, 128, 3), uint8.
        maps: Targets and what counts (:func:`targets`), shape (n, 7, 32, 32), float16.
        boxes: Plates, then boxes in which nothing counts, NaN where there are less, shape (n, 2, 8, 4), float32.
    """

    image: np.ndarray
    maps: np.ndarray
    boxes: np.ndarray

    @classmethod
    def of_size(cls, crops: int) -> "Pool":
        """An empty pool."""
        arrays = [
            _shared((crops, SIDE, SIDE, 3), np.uint8),
            _shared((crops, 7, _CELLS, _CELLS), np.float16),
            _shared((crops, 2, MOST_BOXES, 4), np.float32),
        ]
        return cls(*arrays)

    def draw(self, sampler: Sampler, worker: int, workers: int) -> None:
        """Draw one worker's crops."""
        for number in range(worker, len(self.image), workers):
            crop = sampler(number)
            self.image[number] = crop.image
            maps, counts = targets(crop)
            self.maps[number, :5], self.maps[number, 5:] = maps, counts
            for part, boxes in enumerate((crop.boxes, crop.ignored)):
                self.boxes[number, part] = np.nan
                self.boxes[number, part, : min(len(boxes), MOST_BOXES)] = boxes[:MOST_BOXES]


def _shared(shape: tuple[int, ...], kind: type) -> np.ndarray:
    size = int(np.prod(shape)) * np.dtype(kind).itemsize
    return np.frombuffer(mmap.mmap(-1, size), dtype=kind).reshape(shape)


def filled_pool(sampler: Sampler, crops: int, workers: int) -> Pool:
    """A pool whose crops so many processes have drawn."""
    pool, context = Pool.of_size(crops), multiprocessing.get_context("fork")
    hands = [context.Process(target=pool.draw, args=(sampler, worker, workers)) for worker in range(workers)]
    for hand in hands:
        hand.start()
    for hand in hands:
        hand.join()
    if any(hand.exitcode for hand in hands):
        raise RuntimeError("crops: a process that draws them has ended early")
    return pool


def train_networks(
    pool: Pool, seed: int, *, seconds: float, device: str, start: PlateNetwork | None = None
) -> tuple[PlateNetwork, PlateJudge]:
    """Both networks, trained for so long: six tenths for the finder, the rest for the judge.

    Args:
        pool: Crops.
        seed: Of weights and order.
        seconds: By the clock on the wall.
        device: ``cpu``, ``cuda``.
        start: A finder to go on from.
    """
    torch.manual_seed(seed)
    copies = _Copies(pool, device)
    finder = _train_finder(copies, 0.6 * seconds, start)
    return finder.cpu().float(), _train_judge(copies, finder.to(device), 0.4 * seconds).cpu().float()


class _Copies:
    """A pool on the device."""

    def __init__(self, pool: Pool, device: str) -> None:
        self.device, self.count = device, len(pool.image)
        self.arrays = [torch.from_numpy(array).to(device) for array in (pool.image, pool.maps, pool.boxes)]

    def pixels(self, rows: Tensor) -> Tensor:
        """Crops from 0 to 1, shape (b, 3, 128, 128)."""
        return self.arrays[0][rows].permute(0, 3, 1, 2).float() / 255


def _varied(pixels: Tensor) -> Tensor:
    """Other light, colours, blur and noise than when the crop was drawn."""
    shape, device = (len(pixels), 1, 1, 1), pixels.device
    gain = 0.65 + 0.7 * torch.rand(shape, device=device) + 0.08 * torch.randn((len(pixels), 3, 1, 1), device=device)
    varied = pixels * gain + 0.15 * (torch.rand(shape, device=device) - 0.5)
    varied = torch.where(torch.rand(shape, device=device) < 0.15, varied.mean(dim=1, keepdim=True), varied)
    soft = functional.avg_pool2d(functional.pad(varied, (1, 1, 1, 1), mode="replicate"), 3, 1)
    varied = torch.where(torch.rand(shape, device=device) < 0.15, soft, varied)
    noise = torch.randn_like(varied) * 0.03 * torch.rand(shape, device=device)
    return (varied + noise).clamp(0, 1)


class _Training:
    """Optimiser, rate by the share of the time that is over, and a running mean of the weights."""

    def __init__(self, network: nn.Module, rate: float, seconds: float) -> None:
        self.network, self.rate, self.seconds = network, rate, seconds
        self.mean = deepcopy(network).eval()
        self.optimiser = torch.optim.AdamW(network.parameters(), lr=rate, weight_decay=1e-2)
        self.began, self.steps = time.monotonic(), 0

    def share(self) -> float:
        """Share of the time that is over."""
        return (time.monotonic() - self.began) / self.seconds

    def step(self, loss: Tensor) -> None:
        """One step, and the mean."""
        done = min(self.share(), 1.0)
        for group in self.optimiser.param_groups:
            group["lr"] = self.rate * min(1.0, (self.steps + 1) / 50) * (0.01 + 0.99 * (1 + np.cos(np.pi * done)) / 2)
        self.optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self.network.parameters(), 5.0)
        self.optimiser.step()
        self.steps += 1
        keep = min(0.995, self.steps / (self.steps + 10))
        with torch.no_grad():
            for mean, value in zip(self.mean.state_dict().values(), self.network.state_dict().values(), strict=True):
                if mean.is_floating_point():
                    mean.lerp_(value, 1 - keep)
                else:
                    mean.copy_(value)


def _autocast(device: str) -> torch.autocast:
    return torch.autocast("cuda" if device.startswith("cuda") else "cpu", torch.bfloat16)


def _train_finder(copies: _Copies, seconds: float, start: PlateNetwork | None) -> PlateNetwork:
    device = copies.device
    network = deepcopy(start or PlateNetwork()).to(device, memory_format=torch.channels_last).train()
    training, hard, turns = _Training(network, _RATE, seconds), torch.zeros(0, dtype=torch.long, device=device), 0
    total = torch.zeros((), device=device)
    while training.share() < 1:
        if turns < len(_HARD_AT) and training.share() > _HARD_AT[turns]:
            hard, turns = _hardest(copies, training.mean), turns + 1
        rows = torch.randint(copies.count, (_BATCH,), device=device)
        if len(hard):
            rows[: _BATCH // 2] = hard[torch.randint(len(hard), (_BATCH // 2,), device=device)]
        maps = copies.arrays[1][rows].float()
        with _autocast(device):
            output = network(_varied(copies.pixels(rows)).contiguous(memory_format=torch.channels_last))
        loss = loss_of(output.float(), maps[:, :5], maps[:, 5:])
        training.step(loss)
        total += loss.detach()
        if training.steps % 100 == 0:
            print(f"step {training.steps}: loss {float(total) / 100:.3f}", flush=True)
            total.zero_()
    return training.mean


def _in_batches(copies: _Copies, network: PlateNetwork) -> Iterator[tuple[Tensor, Tensor]]:
    """Numbers of crops, and the network's maps of them, scores first."""
    for first in range(0, copies.count, 1024):
        rows = torch.arange(first, min(first + 1024, copies.count), device=copies.device)
        with torch.no_grad(), _autocast(copies.device):
            maps = network(copies.pixels(rows).contiguous(memory_format=torch.channels_last)).float()
        maps[:, 0] = maps[:, 0].sigmoid()
        yield rows, maps


def _hardest(copies: _Copies, network: PlateNetwork) -> Tensor:
    """Numbers of the crops with the highest scores away from plates, or the lowest on them."""
    errors = []
    for rows, maps in _in_batches(copies, network):
        truth = copies.arrays[1][rows].float()
        away = (maps[:, 0] * (truth[:, 0] < 0.02) * truth[:, 5]).amax(dim=(1, 2))
        missed = ((1 - maps[:, 0]) * (truth[:, 0] == 1)).amax(dim=(1, 2))
        errors.append(torch.maximum(away, 0.7 * missed))
    error = torch.cat(errors)
    count = max(1, int(_HARD * len(error)))
    print(f"hardest {count} crops: errors from {float(error.topk(count).values[-1]):.3f} on", flush=True)
    return error.topk(count).indices


def _iou(one: Tensor, other: Tensor) -> Tensor:
    """Overlap of boxes of shapes (..., 4) that go together; 0 where one is NaN."""
    low, high = torch.maximum(one[..., :2], other[..., :2]), torch.minimum(one[..., 2:], other[..., 2:])
    shared = (high - low).clamp(min=0).prod(dim=-1)
    areas = (one[..., 2:] - one[..., :2]).prod(dim=-1) + (other[..., 2:] - other[..., :2]).prod(dim=-1)
    return (shared / (areas - shared).clamp(min=1e-6)).nan_to_num(0.0)


def _proposals(copies: _Copies, network: PlateNetwork) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Number of the crop, proposed box, the plate nearest to it, and 1 for a plate or 0 for none."""
    parts: list[tuple[Tensor, ...]] = []
    for rows, maps in _in_batches(copies, network):
        score = maps[:, 0] * (maps[:, 0] == functional.max_pool2d(maps[:, 0], 3, 1, 1))
        best, cell = score.flatten(1).topk(PROPOSALS_A_CROP, dim=1)
        values = torch.gather(maps[:, 1:].flatten(2), 2, cell[:, None].expand(-1, 4, -1))
        half = values[:, :2].clamp(-3, 3.5).exp() * STRIDE / 2
        place = torch.stack([cell % _CELLS, cell // _CELLS], dim=1)
        centre = (place + values[:, 2:].clamp(-1, 2)) * STRIDE
        box = torch.cat([centre - half, centre + half], dim=1).permute(0, 2, 1)  # (b, k, 4)
        truth, ignored = copies.arrays[2][rows].unbind(dim=1)
        overlap, which = _iou(box[:, :, None], truth[:, None]).max(dim=2)
        nearest = torch.gather(truth, 1, which[..., None].expand(-1, -1, 4))
        middle = (box[..., :2] + box[..., 2:])[:, :, None] / 2
        both = torch.cat([truth, ignored], dim=1)[:, None]
        upon = ((middle > both[..., :2]) & (middle < both[..., 2:])).all(dim=-1).any(dim=2)
        plate = overlap >= _SAME_IOU
        counts = (best > PROPOSED) & (plate | ~upon)
        parts.append((rows[:, None].expand_as(cell)[counts], box[counts], nearest[counts], plate[counts].float()))
        # The plates themselves, which the finder may have missed.
        valid = ~truth[..., 0].isnan()
        own = rows[:, None].expand_as(valid)[valid]
        parts.append((own, truth[valid], truth[valid], torch.ones(len(own), device=own.device)))
    row, box, nearest, plate = (torch.cat(columns) for columns in zip(*parts, strict=True))
    return row, box, nearest, plate


def _train_judge(copies: _Copies, finder: PlateNetwork, seconds: float) -> PlateJudge:
    device = copies.device
    row, box, nearest, plate = _proposals(copies, finder)
    good, bad = torch.nonzero(plate == 1)[:, 0], torch.nonzero(plate == 0)[:, 0]
    print(f"judge: {len(good)} plates, {len(bad)} false proposals", flush=True)
    network = PlateJudge().to(device, memory_format=torch.channels_last).train()
    training, total = _Training(network, _JUDGE_RATE, seconds), torch.zeros((), device=device)
    while training.share() < 1:
        chosen = torch.cat([_drawn(good, _JUDGE_BATCH // 3), _drawn(bad, _JUDGE_BATCH - _JUDGE_BATCH // 3)])
        side = (box[chosen, 2:] - box[chosen, :2]).repeat(1, 2)
        jitter = torch.randn((len(chosen), 4), device=device) * 0.08
        shaken = box[chosen] + jitter * side
        shaken = torch.cat([shaken[:, :2], torch.maximum(shaken[:, 2:], shaken[:, :2] + 2)], dim=1)
        numbers = torch.arange(len(chosen), device=device)
        patches = _varied(cut_patches(halved(copies.pixels(row[chosen]), 2), numbers, shaken))
        with _autocast(device):
            output = network(patches.contiguous(memory_format=torch.channels_last))
        output, is_plate = output.float(), plate[chosen]
        loss = functional.binary_cross_entropy_with_logits(output[:, 0], is_plate)
        away = _wanted_change(shaken, nearest[chosen])
        error = functional.smooth_l1_loss(output[:, 1:], away.nan_to_num(0.0), reduction="none", beta=0.1).sum(dim=1)
        loss = loss + (error * is_plate).sum() / is_plate.sum().clamp(min=1)
        training.step(loss)
        total += loss.detach()
        if training.steps % 100 == 0:
            print(f"judge, step {training.steps}: loss {float(total) / 100:.3f}", flush=True)
            total.zero_()
    return training.mean


def _drawn(numbers: Tensor, count: int) -> Tensor:
    """So many of some numbers, with repeats; none of none."""
    count = count if len(numbers) else 0
    return numbers[torch.randint(max(len(numbers), 1), (count,), device=numbers.device)]


def _wanted_change(box: Tensor, truth: Tensor) -> Tensor:
    """What :func:`judged_boxes` needs to make one box of another."""
    side, true_side = box[:, 2:] - box[:, :2], truth[:, 2:] - truth[:, :2]
    shift = (truth[:, :2] + truth[:, 2:] - box[:, :2] - box[:, 2:]) / 2 / side
    return torch.cat([shift, (true_side / side).clamp(min=1e-3).log()], dim=1)

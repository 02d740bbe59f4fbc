"""The training of the network that finds number plates: loss, hard negatives, and a state to go on from."""

import time
from pathlib import Path

import numpy as np
import torch
from _plates_crops import SIDE, Crop, Sampler, cut, draw_board, tilted
from _plates_rendering import cover, paste
from _plates_scenes import Scene, upright

from farfield.privacy.detectors import decode_plates, predict_plate_maps
from farfield.privacy.plate_network import STRIDE, PlateNetwork

BATCH, RATE = 16, 2e-3
_MINED_SCORE, _MINED_MOST = 0.15, 1500


def targets(crop: Crop) -> tuple[np.ndarray, np.ndarray]:
    """Heat, logarithms of size, offset, shape (5, 32, 32); and what counts: heat everywhere else, size at centres."""
    cells = SIDE // STRIDE
    maps, counts = np.zeros((5, cells, cells), np.float32), np.ones((2, cells, cells), np.float32)
    counts[1] = 0
    axis = np.arange(cells) + 0.5
    for left, top, right, bottom in crop.ignored / STRIDE:
        counts[0, max(0, int(top - 1)) : int(max(0, bottom + 2)), max(0, int(left - 1)) : int(max(0, right + 2))] = 0
    for left, top, right, bottom in crop.boxes / STRIDE:
        x, y, wide, high = (left + right) / 2, (top + bottom) / 2, right - left, bottom - top
        column, row = int(x), int(y)
        spread = np.maximum(np.array([wide, high]) / 6, 0.5)
        heat = np.exp(
            -(((axis - column - 0.5) / spread[0]) ** 2)[None] / 2 - (((axis - row - 0.5) / spread[1]) ** 2)[:, None] / 2
        )
        maps[0] = np.maximum(maps[0], heat)
        for there_y in range(max(row - 1, 0), min(row + 2, cells)):
            for there_x in range(max(column - 1, 0), min(column + 2, cells)):
                if (there_y, there_x) == (row, column) or not counts[1, there_y, there_x]:
                    maps[1:, there_y, there_x] = [np.log(wide), np.log(high), x - there_x, y - there_y]
                    counts[1, there_y, there_x] = 1.0 if (there_y, there_x) == (row, column) else 0.3
        maps[0, row, column], counts[0, row, column] = 1.0, 1.0
    return maps, counts


def loss_of(told: torch.Tensor, maps: torch.Tensor, counts: torch.Tensor) -> torch.Tensor:
    """Focal loss of the heat (alpha 2, beta 4) and L1 of size and offset."""
    heat, logit = maps[:, 0], told[:, 0]
    score = logit.sigmoid()
    hit, plates = (heat == 1).float(), (heat == 1).sum().clamp(min=4)
    good = hit * (1 - score) ** 2 * torch.nn.functional.softplus(-logit)
    bad = (1 - hit) * (1 - heat) ** 4 * score**2 * torch.nn.functional.softplus(logit)
    size = ((told[:, 1:] - maps[:, 1:]).abs() * counts[:, 1:]).sum() / counts[:, 1].sum().clamp(min=1)
    return ((good + bad) * counts[:, 0]).sum() / plates + 0.5 * size


def mined(network: PlateNetwork, sampler: Sampler, number: int) -> list[Crop]:
    """False hits in pictures without plates, at the three sizes that the detector looks at."""
    rng, found = np.random.default_rng([sampler.seed, 7, number]), []
    network.eval()
    for scene in [*sampler.scenes, *(Scene(picture, (), (), "day") for picture in sampler.pictures * 4)]:
        image = scene.image.copy()
        for place in scene.places:
            cover(image, place, rng)
        for _ in range(6):
            board, wide, high = draw_board(rng)
            place = tilted(rng, wide, high, float(rng.uniform(10, 120)))
            flat = place.quad(wide, high) + rng.uniform(0, 1, 2) * (np.array(image.shape[1::-1]) - SIDE)
            if np.isfinite(flat).all():
                paste(image, board, flat, 1.0, rng)
        hidden = np.array([upright(place.quad(0.6, 0.25)) for place in scene.hidden]).reshape(-1, 4)
        for halving, maps in enumerate(predict_plate_maps(network, image)):
            scale = 0.5**halving
            for box in decode_plates(maps, _MINED_SCORE).box_px[:8] / scale:
                centre = (box[:2] + box[2:]) / 2 + rng.uniform(-24, 24, 2) / scale
                crop, low = cut(image, centre, scale)
                found.append(Crop(crop, ignored=(hidden - np.tile(low, 2)) * scale))
    network.train()
    order = rng.permutation(len(found))[:_MINED_MOST]
    return [found[place] for place in order]


def train(sampler: Sampler, steps: int, state_file: Path | None, *, every: int = 100) -> PlateNetwork:
    """Train, or go on where an interrupted training was; hard negatives are mined at half and three quarters."""
    torch.manual_seed(sampler.seed)
    network = PlateNetwork().to(memory_format=torch.channels_last).train()
    optimiser = torch.optim.AdamW(network.parameters(), lr=RATE, weight_decay=1e-2)
    first = _resumed(state_file, network, optimiser, sampler)
    clock = time.process_time()
    total = 0.0
    for step in range(first, steps):
        if step in (steps // 2, steps * 3 // 4):
            sampler.mined = sampler.mined[-_MINED_MOST // 2 :] + mined(network, sampler, step)
            print(f"step {step}: {len(sampler.mined)} hard negatives", flush=True)
        done = step / steps
        for group in optimiser.param_groups:
            group["lr"] = RATE * min(1.0, (step + 1) / 100) * (0.02 + 0.98 * (1 + np.cos(np.pi * done)) / 2)
        crops = [sampler(step * BATCH + number) for number in range(BATCH)]
        made = [targets(crop) for crop in crops]
        images = torch.from_numpy(np.stack([crop.image for crop in crops])).permute(0, 3, 1, 2).float() / 255
        maps, counts = (torch.from_numpy(np.stack([each[part] for each in made])) for part in (0, 1))
        with torch.autocast("cpu", torch.bfloat16):
            told = network(images.contiguous(memory_format=torch.channels_last))
        loss = loss_of(told.float(), maps, counts)
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 5.0)
        optimiser.step()
        total += float(loss.detach())
        if (step + 1) % every == 0:
            print(f"step {step + 1}: loss {total / every:.3f}, {time.process_time() - clock:.0f} s of CPU", flush=True)
            total = 0.0
            if state_file is not None:
                _keep(state_file, step + 1, network, optimiser, sampler)
    return network.eval()


def _keep(path: Path, step: int, network: PlateNetwork, optimiser: torch.optim.Optimizer, sampler: Sampler) -> None:
    crops = torch.from_numpy(np.stack([crop.image for crop in sampler.mined])) if sampler.mined else torch.zeros(0)
    ignored = [torch.from_numpy(np.asarray(crop.ignored)) for crop in sampler.mined]
    partial = path.with_suffix(".part")
    torch.save(
        {
            "step": step,
            "network": network.state_dict(),
            "optimiser": optimiser.state_dict(),
            "crops": crops,
            "ignored": ignored,
        },
        partial,
    )
    partial.replace(path)


def _resumed(path: Path | None, network: PlateNetwork, optimiser: torch.optim.Optimizer, sampler: Sampler) -> int:
    if path is None or not path.is_file():
        return 0
    told = torch.load(path, weights_only=True)
    network.load_state_dict(told["network"])
    optimiser.load_state_dict(told["optimiser"])
    sampler.mined = [
        Crop(image.numpy(), ignored=ignored.numpy())
        for image, ignored in zip(told["crops"], told["ignored"], strict=True)
    ]
    return int(told["step"])

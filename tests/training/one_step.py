"""One step of training of small detectors, as the only process or as one of several.

    python one_step.py FOLDER RANK WORLD NAME...

The process of rank 0 writes FOLDER/NAME.pt for each: the losses, the averaged gradients and the network's statistics.
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import torch

sys.path.append(str(Path(__file__).parents[1] / "detectors"))

from small import batch_of, small_detector, targets_of

from farfield.frame import Boxes
from farfield.training.distributed import average_gradients, average_values, synchronise_norms

DOUBLE = {"voxelnet": {"middle": "dense"}}
"""Settings with which a detector computes in double precision throughout."""
SINGLE = {"voxelnet-sparse": ("voxelnet", {"middle": "sparse"})}
"""What computes in single precision only: detector and settings."""


def frames() -> list[tuple[np.ndarray, Boxes]]:
    """Four frames of ground and cars; in the last one the sensor saw nothing."""
    rng = np.random.default_rng(7)
    made = []
    for cars in (4, 1, 2):
        place = np.column_stack([8 + 14 * np.arange(cars), rng.uniform(-10, 10, cars), np.full(cars, -1.2)])
        boxes = Boxes(
            centre_m=place,
            size_m=np.tile([4.4, 1.8, 1.4], (cars, 1)),
            yaw_rad=rng.uniform(-3, 3, cars),
            label="vehicle",
        )
        ground = np.column_stack([rng.uniform(2, 63, 1500), rng.uniform(-19, 19, 1500), rng.normal(-2, 0.02, 1500)])
        shells = [centre + rng.uniform(-1, 1, (90, 3)) * [2.0, 0.8, 0.7] for centre in place]
        xyz = np.concatenate([ground, *shells])
        made.append((np.column_stack([xyz, np.full(len(xyz), 0.3), np.zeros(len(xyz))]).astype(np.float32), boxes))
    return [*made, (np.zeros((0, 5), np.float32), Boxes.empty())]


def one_step(name: str, rank: int = 0, world: int = 1) -> dict[str, Any]:
    """Gradients, statistics and losses of a small detector after one step on this process' share of the frames.

    In double precision: small untrained networks turn the last digit of single precision into the third.
    """
    detector, settings = SINGLE.get(name, (name, DOUBLE.get(name, {})))
    dtype = torch.float32 if name in SINGLE else torch.float64
    network = small_detector(detector, **settings).to(dtype)
    network.train()
    synchronise_norms(network)
    torch.manual_seed(1)
    batch = frames()[rank::world]
    columns = len(network.inputs["points"].columns)
    clouds = [torch.from_numpy(points[:, :columns]) for points, _ in batch]
    targets = [targets_of(network, boxes, cloud) for cloud, (_, boxes) in zip(clouds, batch, strict=True)]
    losses = network.losses(network(batch_of(*(cloud.to(dtype) for cloud in clouds)), targets), targets)
    sum(losses.values()).backward()
    average_gradients(network.parameters())
    values = {key: float(value.detach()) for key, value in losses.items()}
    return {
        "losses": average_values(values, torch.device("cpu")),
        "gradients": {key: p.grad for key, p in network.named_parameters() if p.grad is not None},
        "statistics": dict(network.named_buffers()),
    }


def main(folder: str, rank: str, world: str, *names: str) -> None:
    """Join the other processes and take the step of each detector."""
    torch.set_num_threads(1)
    meeting = (Path(folder) / "meeting").as_uri()
    torch.distributed.init_process_group("gloo", init_method=meeting, rank=int(rank), world_size=int(world))
    for name in names:
        result = one_step(name, int(rank), int(world))
        if rank == "0":
            torch.save(result, Path(folder) / f"{name}.pt")
    torch.distributed.destroy_process_group()


if __name__ == "__main__":
    main(*sys.argv[1:])

"""Batches of several streams of samples, from one loader."""

import signal
from collections.abc import Iterable, Iterator, Mapping
from functools import partial

import torch
from lightning_fabric import Fabric
from torch.utils.data import DataLoader
from torch.utils.data import Dataset as TorchDataset

from farfield.detectors.inputs import Inputs
from farfield.errors import ConfigError
from farfield.training.method import Batch, Stream
from farfield.training.samples import TrainingSample, TrainingSamples

Place = tuple[str, int]
"""Name of a stream and a position in it."""


class StreamSamples(TorchDataset[TrainingSample]):
    """The samples of several streams, by stream and position: one loader's workers serve them all."""

    def __init__(self, streams: Mapping[str, TrainingSamples]) -> None:
        self.streams = dict(streams)

    def __len__(self) -> int:
        return sum(map(len, self.streams.values()))

    def __getitem__(self, place: Place) -> TrainingSample:
        """The sample at a position of a stream."""
        name, position = place
        return self.streams[name][position]


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
        groups = f" with {units[uneven[0]]} samples that stay together" if units.get(uneven[0], 1) > 1 else ""
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
    places = [
        [
            (name, position)
            for name, count in counts.items()
            for position in _positions(step, count, streams[name].together, rank, world)
        ]
        for step in range(first_step, steps)
    ]
    loader: DataLoader[TrainingSample] = DataLoader(
        StreamSamples(streams),
        batch_sampler=places,
        num_workers=workers,
        collate_fn=partial(_by_stream, {name: count // world for name, count in counts.items()}),
        worker_init_fn=_one_thread,
        prefetch_factor=4 if workers else None,
        pin_memory=pinned,
    )
    return iter(loader)


def _positions(step: int, count: int, together: int, rank: int, world: int) -> list[int]:
    """Positions of a step's samples of a stream that belong to a process."""
    units = range(step * count // together + rank, (step + 1) * count // together, world)
    return [unit * together + member for unit in units for member in range(together)]


def _by_stream(counts: Mapping[str, int], samples: Iterable[TrainingSample]) -> dict[str, list[TrainingSample]]:
    left = iter(samples)
    return {name: [next(left) for _ in range(count)] for name, count in counts.items()}


def _one_thread(_: int) -> None:
    torch.set_num_threads(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the training's, which ends its workers


def batch_of(samples: list[TrainingSample], fabric: Fabric) -> Batch:
    """Samples as a batch on the process' device."""
    names = samples[0].inputs
    inputs = Inputs({name: [fabric.to_device(sample.inputs[name]) for sample in samples] for name in names})
    targets = [sample.targets for sample in samples if sample.targets is not None]
    return Batch(inputs, targets, [sample.boxes for sample in samples if sample.boxes is not None])

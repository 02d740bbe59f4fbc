"""Training on a GPU beside the CPU's, with the same samples, and a checkpoint of one that the other goes on from."""

import json
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from _gpu_common import FAILED, OK, Row, Site, each, exact_float32

from farfield.datasets import Dataset
from farfield.errors import FarfieldError
from farfield.frame import Cloud, Frame
from farfield.testing.detectors import built, made_frame
from farfield.training.config import AugmentationConfig, TrainingConfig
from farfield.training.loop import Training
from farfield.training.method import Supervised
from farfield.training.report import TrainingReport
from farfield.training.samples import TrainingSamples

# Training on a GPU beside the CPU's, with the same samples, and a checkpoint of one that the other goes on from.


RATE = 1.5e-3
STEPS, STEPS_ON_CPU, LAST = 50, 8, 10
FIRST_STEP = 1e-3  # relative difference of the first step's loss: nothing has been learnt, so only rounding differs
LEAST_NOISE = 0.05  # share of the loss that counts as noise whatever two seeds say
# Two seeds say how far apart two runs lie; a third one lies farther from the first than the second every other time,
# so the GPU's must not lie farther beyond both of them than they lie apart.
RESUMED = 0.02  # relative difference of the losses after a change of device
_FRAMES = 4


class Made(Dataset):
    """Frames of ground and boxes full of points, in memory.

    Args:
        network: What reads them.
    """

    name, root = "made", Path("made")

    def __init__(self, network: Any) -> None:
        self.sequences, self.frame_ids = ("made",) * _FRAMES, tuple(map(str, range(_FRAMES)))
        self.frames = [_frame(network, number) for number in range(_FRAMES)]

    def frame(self, index: int) -> Frame:
        """A frame."""
        return self.frames[index]

    def files(self, index: int) -> list[Path]:
        """None: they are made."""
        del index
        return []


def _frame(network: Any, number: int) -> Frame:
    inputs, boxes = made_frame(network, seed=number)
    ((name, (rows,)),) = inputs.items()
    columns = dict(zip(network.inputs[name].columns, rows.numpy().T, strict=True))
    xyz = np.ascontiguousarray(rows.numpy()[:, :3])
    extra = {key: value.copy() for key, value in columns.items() if key not in ("x_m", "y_m", "z_m", "intensity")}
    strength = columns["intensity"].copy() if "intensity" in columns else None
    return Frame.of(Cloud(xyz, strength, extra), boxes, name="made", sequence="made", frame_id=str(number))


class Stopped(FarfieldError):  # noqa: N818 - nothing went wrong
    """The training was stopped on purpose."""


class StopAt(TrainingReport):
    """Stops a training at a step.

    Args:
        at: The step that is not kept.
    """

    def __init__(self, at: int) -> None:
        self.at = at

    def step(self, step: int, losses: dict[str, float]) -> None:
        """Stop at the step."""
        del losses
        if step == self.at:
            raise Stopped("stopped")


def trained(name: str, folder: Path, *, device: str, steps: int, seed: int = 0, stop: int | None = None) -> list[float]:
    """Train a small detector and give the loss of each step; a folder with a checkpoint goes on.

    Args:
        name: The detector's.
        folder: The run's.
        device: "cpu" or "gpu".
        steps: Steps in all.
        seed: Of weights and samples.
        stop: Stop before this step is kept.
    """
    network = small_network(name, seed)
    samples = TrainingSamples(
        Made(network),
        inputs=network.inputs,
        clouds=("made",),
        classes=network.config.class_names,
        assigner=network.assigner,
        augmentation=AugmentationConfig(),
        seed=seed,
    )
    config = TrainingConfig(
        steps=steps,
        batch_size=2,
        learning_rate=RATE,
        precision="fp32",
        accelerator=device,
        workers=0,
        log_every_steps=1,
        checkpoint_every_s=1e-9,
        seed=seed,
    )
    with suppress(Stopped):
        Training(Supervised(network), {"labelled": samples}, config, folder).run(None if stop is None else StopAt(stop))
    lines = map(json.loads, (folder / "log.jsonl").read_text("utf-8").splitlines())
    losses = {line["step"]: line["loss"] for line in lines}
    return [losses[step] for step in sorted(losses)]


def train(site: Site) -> Iterator[Row]:
    """The course of the loss of every detector."""
    exact_float32()
    if not site.gpu:
        yield site.needs_gpu(f"{STEPS} steps on the GPU beside the CPU's", f"below: {STEPS_ON_CPU} steps on the CPU")
    yield from each(list(SETTINGS), partial(_train, site))


def _train(site: Site, name: str) -> Iterator[Row]:
    with tempfile.TemporaryDirectory() as place:
        if not site.gpu:
            losses = np.array(trained(name, Path(place), device="cpu", steps=STEPS_ON_CPU))
            good = bool(np.isfinite(losses).all() and losses[-2:].mean() < losses[:2].mean())
            words = f"CPU: loss {losses[:2].mean():.3f} to {losses[-2:].mean():.3f}, expected to fall"
            yield Row(f"{name}, {STEPS_ON_CPU} steps", words, OK if good else FAILED, {"cpu": losses.tolist()})
            return
        runs = {"gpu": ("gpu", 0), "cpu": ("cpu", 0), "other": ("cpu", 1)}
        course = {
            key: np.array(trained(name, Path(place) / key, device=device, steps=STEPS, seed=seed))
            for key, (device, seed) in runs.items()
        }
    numbers = {key: losses.tolist() for key, losses in course.items()}
    first = abs(course["gpu"][0] / course["cpu"][0] - 1)
    yield site.bounded(f"{name}, loss of the first step", first, FIRST_STEP, "relative difference")
    gpu, cpu, other = (float(course[key][-LAST:].mean()) for key in runs)
    noise = max(abs(other - cpu), LEAST_NOISE * cpu)
    beyond = max(min(cpu, other) - gpu, gpu - max(cpu, other), 0.0)
    words = f"last {LAST}: GPU {gpu:.3f}, CPU {cpu:.3f} and {other:.3f}, {beyond:.3f} beyond; noise {noise:.3f}"
    yield Row(f"{name}, {STEPS} steps", words, OK if beyond <= noise else FAILED, numbers)


def resume(site: Site) -> Iterator[Row]:
    """A checkpoint of each device, gone on from on the other."""
    exact_float32()
    ways = [("cpu", "gpu"), ("gpu", "cpu")] if site.gpu else [("cpu", "cpu")]
    if not site.gpu:
        yield site.needs_gpu("a checkpoint of the CPU on the GPU, and back", "below: CPU to CPU")
    for way in ways:
        yield from each(["pointpillars", "sparsecentre"], partial(_resume, site, way))


def _resume(site: Site, way: tuple[str, str], name: str) -> Iterator[Row]:
    steps, stop = 6, 4
    with tempfile.TemporaryDirectory() as place:
        whole = np.array(trained(name, Path(place) / "whole", device=way[0], steps=steps))
        trained(name, Path(place) / "parted", device=way[0], steps=steps, stop=stop)
        parted = np.array(trained(name, Path(place) / "parted", device=way[1], steps=steps))
    if len(parted) != steps:
        yield Row(f"{name}, {way[0]} to {way[1]}", f"{len(parted)} steps logged, expected {steps}", FAILED)
        return
    error = float(np.abs(parted / whole - 1)[stop - 1 :].max())
    bound = RESUMED if site.gpu else 0.0
    yield site.bounded(f"{name}, {way[0]} to {way[1]}", error, bound, f"losses from step {stop} on differ by")


# Detectors small enough for a CPU to train beside the GPU: a window of 64 m x 40 m, few channels.


_WINDOW = {"range_m": 64.0, "half_width_m": 20.0}
_LOW = {**_WINDOW, "z_min_m": -3.0, "z_max_m": 1.0}
_BANDS = {"edges_m": [0.0, 30.0, 64.0], "shares": [0.5, 0.5]}
_RADAR = {
    "grid": {**_LOW, "voxel_m": [1.0, 1.0, 1.0]},
    "anchors": {"vehicle": {"size_m": [4.2, 2.1, 2.0], "z_m": -1.0, "positive_iou": 0.5, "negative_iou": 0.2}},
    "proposals": "anchors",
    "neck_width": 32,
}
_LEVELS = [
    {"centres": 512, "radii_m": [0.5, 1.5], "limits": [16, 32], "widths": [[16, 32], [16, 32]]},
    {"centres": 128, "radii_m": [1.5, 4.0], "limits": [16, 32], "widths": [[32, 48], [32, 48]]},
]
SETTINGS: dict[str, dict[str, Any]] = {
    "pointpillars": {
        "grid": {**_WINDOW, "cell_m": 0.5},
        "widths": [16, 32, 32],
        "neck_width": 32,
        "out_stride": 2,
    },
    "second": {
        "grid": {**_WINDOW, "voxel_m": [0.25, 0.25, 0.45]},
        "middle_widths": [8, 8, 16, 16],
        "middle_out": 32,
        "widths": [64, 64],
        "depths": [0, 0],
        "neck_width": 64,
    },
    "voxelnet": {
        "grid": {**_LOW, "voxel_m": [0.5, 0.5, 0.8]},
        "vfe_widths": [8, 16],
        "voxel_channels": 16,
        "middle_widths": [16, 16, 16],
        "widths": [16, 32, 32],
        "depths": [1, 2, 2],
        "neck_width": 32,
    },
    "pointrcnn": {
        "window": _WINDOW,
        "sizes_m": {"vehicle": [4.6, 1.95, 1.7], "pedestrian": [0.75, 0.7, 1.75]},
        "points": 2048,
        "bands": _BANDS,
        "backbone": {"levels": _LEVELS, "propagation": [[64], [64]]},
        "head_width": 64,
        "proposals": {"threshold": 0.0, "candidates": 256, "training_count": 64, "count": 48, "bands": _BANDS},
        "refinement": {"points": 64, "match": {"drawn": 48}},
    },
    "sparsecentre": {
        "grid": {**_WINDOW, "z_min_m": -4.0, "z_max_m": 4.0, "voxel_m": [0.4, 0.4, 0.5]},
        "classes": ["vehicle", "pedestrian"],
        "widths": [16, 32],
        "depths": [0, 1],
        "pyramid_widths": [32, 32, 32],
    },
    "rtn": {**_RADAR, "planes": 16, "depths": [1, 1, 1], "strides": [1, 2, 2]},
    "rtnh": {**_RADAR, "cell_channels": 16, "widths": [16, 16, 32]},
}


def small_network(name: str, seed: int) -> Any:
    """The small network of a detector, its weights drawn with a seed."""
    return built(name, SETTINGS[name], seed=seed)

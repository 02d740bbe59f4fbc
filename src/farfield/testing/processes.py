"""A step of training in two processes is that of one with the whole batch: losses, gradients, statistics.

    python -m farfield.testing.processes FOLDER RANK

does one process' part; :func:`steps_of_two` starts both.
"""

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import torch

from farfield.detectors.inputs import Inputs
from farfield.files.json_text import read_json
from farfield.frame import Boxes
from farfield.testing.detectors import arrays_of, built, made_frame
from farfield.training.processes import average_gradients, average_values, synchronise_norms

PROCESSES = 2
PATIENCE_S = 300.0


class StepTask(NamedTuple):
    """A small network that takes a step.

    Attributes:
        name: The detector's name.
        settings: Its settings.
        double: Whether it computes in double precision: small untrained networks turn the last digit of single
            precision into the third.
    """

    name: str
    settings: Mapping[str, Any]
    double: bool = True


def check_two_processes(name: str, settings: Mapping[str, Any]) -> None:
    """Take a step in two processes, one of which gets a frame without points, and compare it with that of one.

    Args:
        name: The detector.
        settings: Settings of a small network that computes in double precision.

    Raises:
        AssertionError: If a process fails or the steps differ; the message says in what.
    """
    task = StepTask(name, settings)
    with TemporaryDirectory() as folder:
        (shared,) = steps_of_two(Path(folder), [task])
    check_same_step(name, one_step(task), shared)


def check_same_step(name: str, alone: Mapping[str, Any], shared: Mapping[str, Any], tolerance: float = 1e-5) -> None:
    """Compare the step of one process with that of two.

    Args:
        name: The detector, for messages.
        alone: What :func:`one_step` gave.
        shared: What :func:`steps_of_two` gave.
        tolerance: Largest difference, as a share of what is compared; of statistics a tenth of it.
    """
    check_same_losses(name, alone["losses"], shared["losses"], tolerance)
    assert shared["gradients"].keys() == alone["gradients"].keys(), f"{name}: other parameters have a gradient in two"
    one, two = (torch.cat([step["gradients"][key].flatten() for key in alone["gradients"]]) for step in (alone, shared))
    gap, largest = two - one, float(one.abs().max())
    for key, value in alone["gradients"].items():
        error = float((shared["gradients"][key] - value).abs().max())
        assert error <= tolerance * largest, f"{name}: the gradient of {key} differs in two processes, by {error:.2g}"
    assert float(gap.norm()) <= tolerance * float(one.norm()), (
        f"{name}: the gradients of two processes differ from those of one by {float(gap.norm()):.2g} of "
        f"{float(one.norm()):.2g}; losses must be sums over normaliser(...), without random numbers of their own"
    )
    check_same_statistics(name, alone["statistics"], shared["statistics"], tolerance / 10)


def check_same_losses(name: str, alone: Mapping[str, float], shared: Mapping[str, float], tolerance: float) -> None:
    """Compare losses by name, as shares of themselves."""
    for part, value in alone.items():
        assert abs(shared[part] - value) <= max(tolerance * abs(value), 1e-7), (
            f"{name}: the loss {part} is {value} in one process and {shared[part]} in two; divide sums by "
            "farfield.detectors.losses.normaliser(number of what counts), and take no mean over a process' own"
        )


def check_same_statistics(name: str, alone: Mapping[str, Any], shared: Mapping[str, Any], tolerance: float) -> None:
    """Compare the networks' buffers by name, each to a share of its largest value."""
    for key, value in alone.items():
        error = float((shared[key].double() - value.double()).abs().max())
        assert error <= tolerance * max(float(value.abs().max()), 1e-6), (
            f"{name}: {key} differs in two processes; normalise with nn.BatchNorm, which is synchronised by itself"
        )


def one_step(task: StepTask, rank: int = 0, world: int = 1) -> dict[str, Any]:
    """Losses, gradients and statistics of a network after one step on this process' share of four frames.

    In the last frame the sensor saw nothing.
    """
    dtype = torch.float64 if task.double else torch.float32
    network = built(task.name, task.settings).to(dtype).train()
    synchronise_norms(network)
    torch.manual_seed(1)
    frames = [made_frame(network, seed=seed, objects=objects) for seed, objects in ((5, 4), (6, 1), (7, 2))]
    nothing = Inputs({key: [cloud[:0] for cloud in clouds] for key, clouds in frames[0][0].items()})
    share: list[tuple[Inputs, Boxes]] = [*frames, (nothing, Boxes.empty())][rank::world]
    batch = sum((inputs for inputs, _ in share[1:]), share[0][0])
    targets = [network.assigner(boxes, arrays_of(batch, index)) for index, (_, boxes) in enumerate(share)]
    losses = network.losses(network(batch.to(dtype), targets), targets)
    torch.stack([*losses.values()]).sum().backward()
    average_gradients(network.parameters())
    values = {key: float(value.detach()) for key, value in losses.items()}
    return {
        "losses": average_values(values, torch.device("cpu")),
        "gradients": {key: p.grad for key, p in network.named_parameters() if p.grad is not None},
        "statistics": dict(network.named_buffers()),
    }


def steps_of_two(folder: Path, tasks: Sequence[StepTask]) -> list[dict[str, Any]]:
    """The step of each task by two processes that share its batch; both are started here.

    Raises:
        AssertionError: If a process fails, or they wait for each other.
    """
    names = ", ".join(task.name for task in tasks)
    (folder / "tasks.json").write_text(json.dumps([task._asdict() for task in tasks]), encoding="utf-8")
    command = [sys.executable, "-m", "farfield.testing.processes", str(folder)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    running = [subprocess.Popen([*command, str(rank)], env=environment) for rank in range(PROCESSES)]
    try:
        ended = [process.wait(PATIENCE_S) for process in running]
    except subprocess.TimeoutExpired as error:
        fix = "each process must call normaliser as often as the other, whatever its frames hold"
        raise AssertionError(f"{names}: two processes wait for each other; {fix}") from error
    finally:
        for process in running:
            process.kill()
    assert not any(ended), (
        f"{names}: a process failed, see its message; a detector must be found by entry point, and compute in float64"
    )
    return [torch.load(folder / f"{number}.pt", weights_only=True) for number in range(len(tasks))]


def main(folder: str, rank: str) -> None:
    """Join the other process and take the step of each task; the first one writes them beside the tasks."""
    torch.set_num_threads(1)
    shared = Path(folder)
    tasks = [StepTask(**task) for task in read_json(shared / "tasks.json")]
    meeting = (shared / "meeting").as_uri()
    torch.distributed.init_process_group("gloo", init_method=meeting, rank=int(rank), world_size=PROCESSES)
    for number, task in enumerate(tasks):
        step = one_step(task, int(rank), PROCESSES)
        if int(rank) == 0:
            torch.save(step, shared / f"{number}.pt")
    torch.distributed.destroy_process_group()


if __name__ == "__main__":
    main(*sys.argv[1:])

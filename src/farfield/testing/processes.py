"""A step of training in two processes is that of one with the whole batch: losses, gradients, statistics.

    python -m farfield.testing.processes TASK RANK

does one process' part; :func:`check_two_processes` starts both.
"""

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch
from torch import Tensor

from farfield.detectors.inputs import Inputs
from farfield.frame import Boxes
from farfield.testing.detectors import arrays_of, built, made_frame
from farfield.training.distributed import average_gradients, average_values, synchronise_norms

PROCESSES = 2
PATIENCE_S = 300.0


def check_two_processes(name: str, settings: Mapping[str, Any], *, tolerance: float = 1e-4) -> None:
    """Take a step in two processes, one of which gets a frame without points, and compare it with that of one.

    Args:
        name: The detector.
        settings: Settings of a small network, which computes in double precision if it can.
        tolerance: Largest difference, as a share of the gradients' length.

    Raises:
        AssertionError: If a process fails or the steps differ; the message says in what.
    """
    with TemporaryDirectory() as folder:
        shared = _step_of_two(Path(folder), name, settings)
    alone = one_step(name, settings)
    for part, value in alone["losses"].items():
        error = abs(shared["losses"][part] - value)
        assert error <= tolerance * max(abs(value), 1e-3), (
            f"{name}: the loss {part} is {value} in one process and {shared['losses'][part]} in two; divide sums by "
            "farfield.detectors.processes.normaliser(number of what counts), and take no mean over a process' own"
        )
    assert shared["gradients"].keys() == alone["gradients"].keys(), f"{name}: other parameters have a gradient in two"
    one, two = (torch.cat([step["gradients"][key].flatten() for key in alone["gradients"]]) for step in (alone, shared))
    assert float((two - one).norm()) <= tolerance * float(one.norm()), (
        f"{name}: the gradients of two processes differ from those of one by {float((two - one).norm()):.2g} of "
        f"{float(one.norm()):.2g}; losses must be sums over normaliser(...), without random numbers of their own"
    )
    for key, value in alone["statistics"].items():
        error = float((shared["statistics"][key].double() - value.double()).abs().max())
        assert error <= tolerance * max(float(value.abs().max()), 1e-6), (
            f"{name}: the statistics {key} differ; normalise with nn.BatchNorm, which is synchronised by itself"
        )


def one_step(name: str, settings: Mapping[str, Any], rank: int = 0, world: int = 1) -> dict[str, Any]:
    """Losses, gradients and statistics of a network after one step on this process' share of the frames."""
    network = built(name, settings).to(torch.float64).train()
    synchronise_norms(network)
    torch.manual_seed(1)
    frames = [made_frame(network, seed=seed, objects=objects) for seed, objects in ((5, 4), (6, 1), (7, 2))]
    nothing = Inputs({key: [cloud[:0] for cloud in clouds] for key, clouds in frames[0][0].items()})
    mine: list[tuple[Inputs, Boxes]] = [*frames, (nothing, Boxes.empty())][rank::world]
    batch = sum((inputs for inputs, _ in mine[1:]), mine[0][0])
    targets = [network.assigner(boxes, arrays_of(batch, index)) for index, (_, boxes) in enumerate(mine)]
    losses = network.losses(network(batch.to(torch.float64), targets), targets)
    torch.stack([*losses.values()]).sum().backward()
    average_gradients(network.parameters())
    values = {key: float(value.detach()) for key, value in losses.items()}
    gradients: dict[str, Tensor] = {key: p.grad for key, p in network.named_parameters() if p.grad is not None}
    return {
        "losses": average_values(values, torch.device("cpu")),
        "gradients": gradients,
        "statistics": dict(network.named_buffers()),
    }


def _step_of_two(folder: Path, name: str, settings: Mapping[str, Any]) -> dict[str, Any]:
    (folder / "task.json").write_text(json.dumps({"name": name, "settings": dict(settings)}), encoding="utf-8")
    command = [sys.executable, "-m", "farfield.testing.processes", str(folder / "task.json")]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    running = [subprocess.Popen([*command, str(rank)], env=environment) for rank in range(PROCESSES)]
    try:
        ended = [process.wait(PATIENCE_S) for process in running]
    except subprocess.TimeoutExpired as error:
        raise AssertionError(f"{name}: two processes wait for each other; each must sum as often as the other") from (
            error
        )
    finally:
        for process in running:
            process.kill()
    assert not any(ended), (
        f"{name}: a process failed, see its message; the detector must be importable from an installed package"
    )
    step: dict[str, Any] = torch.load(folder / "step.pt", weights_only=True)
    return step


def main(task: str, rank: str) -> None:
    """Join the other process and take the step; the first one writes ``step.pt`` beside the task."""
    torch.set_num_threads(1)
    path = Path(task)
    chosen = json.loads(path.read_text(encoding="utf-8"))
    meeting = (path.parent / "meeting").as_uri()
    torch.distributed.init_process_group("gloo", init_method=meeting, rank=int(rank), world_size=PROCESSES)
    step = one_step(chosen["name"], chosen["settings"], int(rank), PROCESSES)
    if int(rank) == 0:
        torch.save(step, path.parent / "step.pt")
    torch.distributed.destroy_process_group()


if __name__ == "__main__":
    main(*sys.argv[1:])

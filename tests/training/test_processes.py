import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

torch = pytest.importorskip("torch")

from small import SMALL

from farfield.detectors.weights import load_weights
from farfield.testing.processes import (
    StepTask,
    check_same_losses,
    check_same_statistics,
    check_same_step,
    one_step,
    steps_of_two,
)

ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": "1"}


TASKS = {name: StepTask(name, small.settings) for name, small in SMALL.items()}
COARSE = {"grid": SMALL["voxelnet"].settings["grid"] | {"cell_m": [1.0, 1.0, 0.8]}}
TASKS["voxelnet"] = StepTask("voxelnet", SMALL["voxelnet"].settings | COARSE | {"middle": "dense"})  # double throughout
TASKS["voxelnet-sparse"] = StepTask("voxelnet", SMALL["voxelnet"].settings | {"middle": "sparse"}, double=False)


def take_steps(folder: Path) -> None:
    folder.mkdir()
    for name, step in zip(TASKS, steps_of_two(folder, [*TASKS.values()]), strict=True):
        torch.save(step, folder / f"{name}.pt")


@pytest.fixture(scope="module")
def shared_steps(made_once) -> dict[str, dict]:
    """One step of every small detector, shared by one pair of processes."""
    folder = made_once("steps-of-two", take_steps)
    return {name: torch.load(folder / f"{name}.pt", weights_only=True) for name in TASKS}


def close(one, other, tolerance: float) -> bool:
    """Whether two tensors agree to a share of the largest value."""
    return bool((one.double() - other.double()).abs().max() <= tolerance * max(float(one.abs().max()), 1e-6))


@pytest.mark.parametrize("name", list(SMALL))
def test_two_processes_take_the_step_of_one(name, shared_steps):
    """Losses, gradients and statistics over two processes, one of which got an empty cloud, are those of the batch."""
    check_same_step(name, one_step(TASKS[name]), shared_steps[name])


def test_sparse_middle_layers_share_their_statistics(shared_steps):
    """In single precision, which is all that they have: what is left are its roundings."""
    name = "voxelnet-sparse"
    shared, alone = shared_steps[name], one_step(TASKS[name])
    check_same_losses(name, alone["losses"], shared["losses"], 1e-3)
    middle = {key: value for key, value in alone["statistics"].items() if "middle" in key}
    assert middle
    check_same_statistics(name, middle, shared["statistics"], 1e-5)


def test_a_loss_that_is_a_mean_over_a_process_is_refused(shared_steps):
    alone = one_step(TASKS["pointpillars"])
    wrong = {**alone, "losses": {name: 1.1 * value for name, value in alone["losses"].items()}}
    with pytest.raises(AssertionError, match="divide sums by"):
        check_same_step("pointpillars", wrong, shared_steps["pointpillars"])


def test_torchrun_follows_the_course_of_one_process(experiment, tmp_path):
    from farfield.experiments.plan import Plan
    from farfield.experiments.schema import load_experiment

    settings = ["training.steps=10", "training.batch_size=4"]
    Plan(load_experiment(experiment, settings), tmp_path / "one").run()
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    command += ["-m", "farfield.cli", "train", str(experiment), "--out", str(tmp_path)]
    command += [word for setting in settings for word in ("-o", setting)]
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    one, two = (
        [json.loads(line) for line in (tmp_path / run / "log.jsonl").read_text().splitlines()]
        for run in ("one", "tiny")
    )
    assert [line["step"] for line in one] == [line["step"] for line in two] == list(range(1, 11))
    for alone, shared in zip(one, two, strict=True):
        assert shared["loss"] == pytest.approx(alone["loss"], rel=1e-3)
    alone, shared = (load_weights(tmp_path / run / "weights.safetensors")[0].state_dict() for run in ("one", "tiny"))
    assert all(close(alone[name], shared[name], 1e-2) for name in alone)
    assert done.stderr.count("step 10/10") == 1  # only the first process reports

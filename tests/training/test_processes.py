import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

torch = pytest.importorskip("torch")

from one_step import one_step
from small import SMALL

from farfield.detectors.weights import load_weights

ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": "1"}


@pytest.fixture(scope="module")
def shared_steps(tmp_path_factory) -> Path:
    """One step of every small detector, shared by one pair of processes: a folder with a file each."""
    folder = tmp_path_factory.mktemp("shared")
    command = [sys.executable, str(Path(__file__).with_name("one_step.py")), str(folder)]
    names = [*SMALL, "voxelnet-sparse"]
    running = [subprocess.Popen([*command, str(rank), "2", *names], env=ENVIRONMENT) for rank in range(2)]
    try:
        assert [process.wait(300) for process in running] == [0, 0]
    finally:
        for process in running:
            process.kill()
    return folder


def close(one, other, tolerance: float) -> bool:
    """Whether two tensors agree to a share of the largest value."""
    return bool((one.double() - other.double()).abs().max() <= tolerance * max(float(one.abs().max()), 1e-6))


@pytest.mark.parametrize("name", list(SMALL))
def test_two_processes_take_the_step_of_one(name, shared_steps):
    """Losses, gradients and statistics over two processes, one of which got an empty cloud, are those of the batch."""
    shared, alone = torch.load(shared_steps / f"{name}.pt", weights_only=True), one_step(name)
    assert shared["losses"] == pytest.approx(alone["losses"], rel=1e-5, abs=1e-7)
    assert shared["gradients"].keys() == alone["gradients"].keys()
    one, two = (torch.cat([step["gradients"][key].flatten() for key in step["gradients"]]) for step in (alone, shared))
    assert float((two - one).norm()) < 1e-5 * float(one.norm())
    largest = float(one.abs().max())
    for key, value in alone["gradients"].items():
        assert float((shared["gradients"][key] - value).abs().max()) <= 1e-5 * largest, key
    for key, value in alone["statistics"].items():
        assert close(value, shared["statistics"][key], 1e-6), key


def test_sparse_middle_layers_share_their_statistics(shared_steps):
    """In single precision, which is all that they have: what is left are its roundings."""
    shared = torch.load(shared_steps / "voxelnet-sparse.pt", weights_only=True)
    alone = one_step("voxelnet-sparse")
    assert shared["losses"] == pytest.approx(alone["losses"], rel=1e-3, abs=1e-6)
    for key, value in alone["statistics"].items():
        if "middle" in key:
            assert close(value, shared["statistics"][key], 1e-5), key


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

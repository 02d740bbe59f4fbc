"""Several nodes, as far as one machine can tell: two of torchrun's agents, of which one loses its process."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

torch = pytest.importorskip("torch")

pytestmark = [pytest.mark.slow, pytest.mark.whole]
STEPS = 24
ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": "1"}


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def agents(experiment: Path, out: Path) -> list[subprocess.Popen]:
    """Two agents of one process each, which meet at a port as those of two nodes do."""
    out.mkdir()
    words = ["--nnodes=2", "--nproc-per-node=1", "--rdzv-backend=c10d", f"--rdzv-endpoint=127.0.0.1:{free_port()}"]
    words += ["--rdzv-id=test", "--max-restarts=3", "-m", "farfield.cli", "train", str(experiment), "--out", str(out)]
    words += ["-o", f"training.steps={STEPS}", "-o", "training.batch_size=4"]
    nodes = []
    for node in range(2):
        with (out / f"node{node}.txt").open("w") as log:
            command = [sys.executable, "-m", "torch.distributed.run", *words]
            nodes.append(subprocess.Popen(command, env=ENVIRONMENT, stdout=log, stderr=log))
    return nodes


def wait(nodes: list[subprocess.Popen], out: Path) -> None:
    try:
        for node in nodes:
            assert node.wait(timeout=400) == 0, "\n".join(log.read_text()[-1500:] for log in out.glob("node*.txt"))
    finally:
        end(nodes)


def end(nodes: list[subprocess.Popen]) -> None:
    for node in nodes:
        if node.poll() is None:
            node.kill()
        node.wait()


def losses(out: Path) -> dict[int, float]:
    lines = (out / "tiny/log.jsonl").read_text().splitlines()
    return {line["step"]: line["loss"] for line in map(json.loads, lines)}


def test_a_lost_process_of_one_node_changes_neither_the_curve_nor_the_weights(experiment: Path, tmp_path: Path) -> None:
    quiet, broken = tmp_path / "quiet", tmp_path / "broken"
    wait(agents(experiment, quiet), quiet)
    nodes = agents(experiment, broken)
    until = time.monotonic() + 300
    try:
        while not (broken / "tiny/log.jsonl").is_file() or len(losses(broken)) < 6:
            assert time.monotonic() < until, "no step was taken"
            time.sleep(0.05)
        worker = next(
            process
            for process in psutil.Process(nodes[1].pid).children(recursive=True)
            if "farfield.cli" in process.cmdline() and "torch.distributed.run" not in process.cmdline()
        )
        steps_before = len(losses(broken))
        worker.send_signal(signal.SIGKILL)
    except BaseException:
        end(nodes)
        raise
    wait(nodes, broken)
    assert steps_before < STEPS
    assert "exitcode: -9" in (broken / "node1.txt").read_text()
    assert losses(broken) == losses(quiet)
    assert sorted(losses(quiet)) == list(range(1, STEPS + 1))
    weights = [(out / "tiny/weights.safetensors").read_bytes() for out in (quiet, broken)]
    assert weights[0] == weights[1]

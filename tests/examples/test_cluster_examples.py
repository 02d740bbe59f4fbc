"""The examples for clusters are read as far as one machine can: bash, YAML, torchrun's and Farfield's flags."""

import shutil
import subprocess
from importlib import import_module
from inspect import signature
from pathlib import Path

import pytest
import yaml

CLUSTER = Path(__file__).parents[2] / "examples" / "cluster"


def _flags(words: list[str]) -> set[str]:
    return {word.partition("=")[0].removeprefix("--").replace("-", "_") for word in words if word.startswith("--")}


def _torchrun_flags() -> set[str]:
    run = pytest.importorskip("torch.distributed.run")
    return {
        option.removeprefix("--").replace("-", "_")
        for one in run.get_args_parser()._actions
        for option in one.option_strings
    }


def _check(words: list[str]) -> None:
    """Of a call of torchrun: its flags are torchrun's, those behind the verb are the verb's."""
    at = words.index("-m")
    assert _flags(words[:at]) <= _torchrun_flags()
    assert words[at + 1] == "farfield.cli"
    run = import_module(f"farfield.cli.{words[at + 2]}").run
    assert _flags(words[at + 3 :]) <= set(signature(run).parameters)


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
def test_the_script_for_slurm_is_bash_and_calls_what_there_is() -> None:
    script = CLUSTER / "train.slurm"
    subprocess.run(["bash", "-n", str(script)], check=True)
    text = script.read_text().replace("\\\n", " ")
    line = next(line for line in text.splitlines() if line.startswith("srun torchrun"))
    _check(line.replace('"$@"', "EXPERIMENT").split()[2:])
    directives = [line for line in text.splitlines() if line.startswith("#SBATCH")]
    assert any("--ntasks-per-node=1" in line for line in directives)  # torchrun starts the others
    assert any("--signal=TERM" in line for line in directives)
    assert text.index("#SBATCH") < text.index("set -u")  # behind a command none is read


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
@pytest.mark.parametrize(
    ("status", "left", "queued"),
    [(143, "1:20", True), (1, "0:07", True), (143, "2:00:00", False), (1, "7:59:00", False), (0, "0:30", False)],
)
def test_a_job_is_queued_again_where_its_time_was_over(tmp_path: Path, status: int, left: str, queued: bool) -> None:
    for name, body in {
        "scontrol": 'if [ "$1" = requeue ]; then echo "$2" > requeued; else echo node1; echo node2; fi',
        "srun": f'echo "$@" > called; exit {status}',
        "squeue": f"echo {left}",
    }.items():
        (tmp_path / name).write_text(f"#!/bin/bash\n{body}\n")
        (tmp_path / name).chmod(0o755)
    environment = {"PATH": f"{tmp_path}:/usr/bin:/bin", "SLURM_JOB_ID": "7", "SLURM_JOB_NODELIST": "node[1-2]"}
    environment |= {"SLURM_NNODES": "2", "SLURM_GPUS_ON_NODE": "4", "SLURM_CPUS_PER_TASK": "32"}
    done = subprocess.run(
        ["bash", str(CLUSTER / "train.slurm"), "tiny", "-o", "training.steps=3"],
        cwd=tmp_path,
        env=environment,
        check=False,
    )
    assert done.returncode == status
    assert (tmp_path / "requeued").exists() == queued
    called = (tmp_path / "called").read_text()
    assert "--rdzv-endpoint=node1:29500" in called
    assert called.rstrip().endswith("-m farfield.cli train tiny -o training.steps=3 --out runs")


def test_the_objects_for_kubernetes_belong_together() -> None:
    service, job = yaml.safe_load_all((CLUSTER / "train.kubernetes.yaml").read_text())
    assert (service["apiVersion"], service["kind"], job["apiVersion"], job["kind"]) == (
        "v1",
        "Service",
        "batch/v1",
        "Job",
    )
    assert service["spec"]["clusterIP"] == "None"
    spec, pod = job["spec"], job["spec"]["template"]["spec"]
    assert spec["completionMode"] == "Indexed"
    assert spec["completions"] == spec["parallelism"]
    assert pod["subdomain"] == service["metadata"]["name"]
    assert service["spec"]["selector"] == {"job-name": job["metadata"]["name"]}
    (container,) = pod["containers"]
    assert container["command"] == ["torchrun"]
    _check(container["args"])
    nodes = next(word for word in container["args"] if word.startswith("--nnodes="))
    assert nodes == f"--nnodes={spec['completions']}"
    first = f"{job['metadata']['name']}-0.{service['metadata']['name']}"  # the first pod's name in the service
    assert any(f"--rdzv-endpoint={first}:" in word for word in container["args"])
    assert {mount["name"] for mount in container["volumeMounts"]} == {volume["name"] for volume in pod["volumes"]}
    assert pod["securityContext"]["runAsNonRoot"]

"""Triton's kernels compute what their plain versions do: compiled on a GPU, and interpreted where there is Triton."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("torch")
pytest.importorskip("triton", reason="Triton is not installed")

CHECKS = ("books", "convolution", "bias_and_relu", "suppression", "decoding", "voxel_means", "pillars")


@pytest.mark.gpu
@pytest.mark.parametrize("name", CHECKS)
def test_compiled(name):
    import _gpu_kernel_checks

    assert tuple(_gpu_kernel_checks.CHECKS) == CHECKS
    _gpu_kernel_checks.CHECKS[name]("cuda")


@pytest.mark.slow
def test_interpreted():
    script = Path(__file__).parents[2] / "benchmarks" / "_gpu_kernel_checks.py"
    environment = {**os.environ, "TRITON_INTERPRET": "1"}
    done = subprocess.run(
        [sys.executable, str(script), "cpu"], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr

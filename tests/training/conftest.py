"""Three simulated frames, and a tiny experiment on them."""

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[1] / "detectors"))  # the small detectors of its small.py

SETTINGS = """
name: tiny
data: {path: DATA, clouds: [gaussian, uniform]}
detector:
  {grid: {range_m: 64.0, half_width_m: 16.0, cell_m: 0.5}, widths: [8, 16, 16], depths: [0, 0, 0], neck_width: 16}
augmentation: {pasted: {vehicle: 2}}
training:
  {steps: 12, batch_size: 2, precision: fp32, threads: 1, workers: 0, checkpoint_every_s: 0.001, log_every_steps: 1}
"""


@pytest.fixture(scope="session")
def data(simulated_cirrus: Path) -> Path:
    """Three mini frames in the Cirrus layout."""
    pytest.importorskip("torch")
    return simulated_cirrus


@pytest.fixture
def experiment(data: Path, tmp_path: Path) -> Path:
    """The YAML file of a tiny experiment."""
    path = tmp_path / "tiny.yaml"
    path.write_text(SETTINGS.replace("DATA", str(data)))
    return path

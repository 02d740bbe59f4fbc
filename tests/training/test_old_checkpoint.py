"""A run that was begun under old names of settings goes on."""

import json

import pytest

torch = pytest.importorskip("torch")

from farfield.experiments.plan import Plan
from farfield.experiments.schema import load_experiment
from farfield.training.checkpoints import load_checkpoint, save_checkpoint

SECOND = {
    "name": "second",
    "grid": {"range_m": 64.0, "half_width_m": 16.0, "cell_m": [0.5, 0.5, 0.45]},
    "middle_widths": [4, 4, 8, 8],
    "middle_out": 8,
    "widths": [8, 8],
    "depths": [0, 0],
    "neck_width": 8,
}


def test_a_checkpoint_with_the_old_name_of_the_cells_resumes(experiment, tmp_path):
    words = [f"detector={json.dumps(SECOND)}", "training.steps=2", "augmentation.pasted={}"]
    settings = load_experiment(experiment, words)
    Plan(settings, tmp_path / "run").run()
    path = tmp_path / "run" / "checkpoint.pt"
    state = load_checkpoint(path)
    provenance = json.loads(state["provenance"])
    grid = provenance["experiment"]["detector"]["grid"]
    grid["voxel_m"] = grid.pop("cell_m")
    save_checkpoint(path, {**state, "provenance": json.dumps(provenance)})
    (tmp_path / "run" / "weights.safetensors").unlink()
    Plan(settings, tmp_path / "run").run()
    assert (tmp_path / "run" / "weights.safetensors").is_file()

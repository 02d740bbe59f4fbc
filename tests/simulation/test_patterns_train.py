"""Small detectors of three seeds, trained on one scan pattern and tested on both: Cirrus' claims about its patterns."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("embreex")

from farfield.api import load_detector, open_dataset
from farfield.cli import main
from farfield.detection import detect

EXPERIMENT = """
name: NAME
data: {path: train, clouds: [CLOUD]}
detector:
  grid: {range_m: 128.0, half_width_m: 32.0, cell_m: 0.4}
  widths: [16, 32, 32]
  depths: [1, 1, 1]
  neck_width: 32
  anchors: {vehicle: {size_m: [4.6, 1.95, 1.7], z_m: -1.15}}
training: {steps: 200, batch_size: 2, learning_rate: 0.004, average_decay: 0.98, seed: SEED}
"""


@pytest.mark.slow
def test_gaussian_beats_uniform_and_a_change_of_pattern_costs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Signs of Cirrus' Table I: G > U, and a detector of the other pattern falls below the pattern's own, both ways."""
    monkeypatch.chdir(tmp_path)
    few = ["--sensors", "gaussian,uniform", "--cache"]
    assert (
        main(["simulate", "cirrus-sim-ideal", "train", "--sequences", "16", "--frames", "96", "--seed", "1", *few]) == 0
    )
    assert main(["simulate", "cirrus-sim-ideal", "val", "--sequences", "8", "--frames", "32", "--seed", "2", *few]) == 0
    data = open_dataset("val")
    found: dict[tuple[str, str], list[float]] = {}
    for seed in range(3):
        for trained in ("gaussian", "uniform"):
            name = f"{trained}-{seed}"
            text = EXPERIMENT.replace("NAME", name).replace("CLOUD", trained).replace("SEED", str(seed))
            Path(f"{name}.yaml").write_text(text)
            assert main(["train", f"{name}.yaml"]) == 0
            detector = load_detector(f"runs/{name}")
            for tested in ("gaussian", "uniform"):
                seen = detect(detector, data, cloud=tested)
                window = {"window_m": (0.0, 128.0, -32.0, 32.0), "range_bins_m": (0.0, 70.0, 128.0)}
                result = seen.score("dds", **window)
                found.setdefault((trained, tested), []).append(float(result.figures["dds/0/dds"]))
    print({" on ".join(key): np.round(values, 3).tolist() for key, values in found.items()})
    own = {name: np.array(found[name, name]) for name in ("gaussian", "uniform")}
    assert (own["gaussian"] > own["uniform"]).all()
    assert (np.array(found["gaussian", "uniform"]) < own["uniform"]).all()
    assert (np.array(found["uniform", "gaussian"]) < own["gaussian"]).all()

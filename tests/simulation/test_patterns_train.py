"""Small detectors trained on one scan pattern and tested on both: Cirrus' claims about its patterns, of one seed here.

``farfield reproduce cirrus`` decides them on three.
"""

from pathlib import Path

import pytest

pytest.importorskip("torch")
pytest.importorskip("embreex")

from farfield.api import load_detector, open_dataset
from farfield.cli import main
from farfield.evaluation import detect

EXPERIMENT = """
name: NAME
data: {path: TRAIN, clouds: [CLOUD]}
detector:
  grid: {range_m: 128.0, half_width_m: 32.0, cell_m: 0.4}
  widths: [16, 32, 32]
  depths: [1, 1, 1]
  neck_width: 32
  anchors: {vehicle: {size_m: [4.6, 1.95, 1.7], z_m: -1.15}}
training: {steps: 200, batch_size: 2, learning_rate: 0.004, average_decay: 0.98, seed: 0}
"""


def _simulated(folder: Path) -> None:
    few = ["--sensors", "gaussian,uniform", "--cache"]
    for name, sequences, frames, seed in (("train", "16", "96", "1"), ("val", "8", "32", "2")):
        words = ["--sequences", sequences, "--frames", frames, "--seed", seed, *few]
        assert main(["simulate", "cirrus-sim-ideal", str(folder / name), *words]) == 0


@pytest.mark.slow
@pytest.mark.whole
def test_gaussian_beats_uniform_and_a_change_of_pattern_costs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Signs of Cirrus' Table I: G > U, and a detector of the other pattern falls below the pattern's own, both ways."""
    _simulated(tmp_path)
    monkeypatch.chdir(tmp_path)
    data = open_dataset(tmp_path / "val")
    found: dict[tuple[str, str], float] = {}
    for trained in ("gaussian", "uniform"):
        text = EXPERIMENT.replace("TRAIN", str(tmp_path / "train")).replace("CLOUD", trained)
        Path("one.yaml").write_text(text.replace("NAME", trained))
        assert main(["train", "one.yaml"]) == 0
        detector = load_detector(f"runs/{trained}")
        for tested in ("gaussian", "uniform"):
            seen = detect(detector, data, cloud=tested)
            window = {"window_m": (0.0, 128.0, -32.0, 32.0), "range_bins_m": (0.0, 70.0, 128.0)}
            result = seen.score("dds", **window)
            found[trained, tested] = float(result.figures["dds/0/dds"])
    print({" on ".join(key): round(value, 3) for key, value in found.items()})
    own = {name: found[name, name] for name in ("gaussian", "uniform")}
    assert own["gaussian"] > own["uniform"]
    assert found["gaussian", "uniform"] < own["uniform"]
    assert found["uniform", "gaussian"] < own["gaussian"]

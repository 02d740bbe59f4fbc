"""Weights say from which places of Open Sweeps they learnt, themselves or those that they started from."""

from pathlib import Path

from farfield.datasets.open_sweeps import OpenSweeps
from farfield.detectors.info import family_with_start
from farfield.detectors.runtime import Detector
from farfield.evaluation.leakage import seen_in_training
from farfield.experiments.plan import Plan
from farfield.experiments.schema import load_experiment

TINY = """
name: tiny
data: {path: open-sweeps, clouds: [lidar], PART}
detector:
  grid: {range_m: 64.0, half_width_m: 16.0, cell_m: 0.5}
  widths: [8, 16, 16]
  depths: [0, 0, 0]
  neck_width: 16
augmentation: {pasted: {}}
training: {START steps: 1, batch_size: 1, precision: fp32, threads: 1, workers: 0}
"""


def trained(folder: Path, part: str, start: str = "") -> Path:
    """Weights of a tiny training on open sweeps."""
    path = folder.with_suffix(".yaml")
    path.write_text(TINY.replace("PART", part).replace("START", start))
    return Plan(load_experiment(path), folder).run()


def test_places_of_streams_donors_and_the_start_are_named(tmp_path: Path) -> None:
    first = trained(tmp_path / "first", "split: avenue")
    start = f"start: {{weights: {first}}},"
    weights = trained(tmp_path / "second", "split: junction, donors: {copies: 1, vehicles: 2}", start)
    info = Detector.load(weights, device="cpu").info
    assert info.open_places == ("avenue", "junction")
    assert info.provenance["start"]["family"] == "real sweeps"
    assert (info.family, family_with_start(info.provenance)) == ("simulation with a user's sweeps", "")
    data = OpenSweeps()
    words, common = seen_in_training(data, info.provenance, set(data.keys))
    assert (words, common) == ("4 of 12 frames, of the places avenue and junction", 4)
    others = data.split("corner")
    words, common = seen_in_training(others, info.provenance, set(others.keys))
    assert (words.partition(",")[0], common) == ("none of the 8 frames", 0)

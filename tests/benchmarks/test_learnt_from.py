"""What the table of real frames says of a detector's training."""

from pathlib import Path

import numpy as np
from detectors import learnt_from

from farfield.datasets import open_dataset
from farfield.files.clouds import write_bin


def test_simulated_frames_alone_are_those_of_weights_from_scratch(tmp_path: Path) -> None:
    write_bin(tmp_path / "0.bin", np.ones((50, 4), np.float32))
    data = open_dataset(tmp_path)
    simulated = {"experiment": {"data": {"simulate": {"preset": "cirrus-sim"}}}}
    assert learnt_from(data, simulated) == "nothing: simulated frames only (cirrus-sim)"
    for earlier in ("start", "adapted"):
        assert not learnt_from(data, simulated | {earlier: {"weights": "other"}}).startswith("nothing")


def test_open_donors_and_the_start_are_named(tmp_path: Path) -> None:
    write_bin(tmp_path / "0.bin", np.ones((50, 4), np.float32))
    data = open_dataset(tmp_path)
    start = {"weights": "first", "family": "simulation", "open_sweeps": []}
    provenance = {"family": "simulation with open donors", "open_sweeps": ["corner"], "start": start}
    assert learnt_from(data, provenance) == "nothing: simulated frames, Open Sweeps (corner)"
    for family in ("", "real sweeps", "simulation with a user's sweeps"):
        assert not learnt_from(data, provenance | {"start": start | {"family": family}}).startswith("nothing")
        assert not learnt_from(data, provenance | {"family": family}).startswith("nothing")
    places = open_dataset("open-sweeps")
    assert not learnt_from(places, provenance).startswith("nothing")

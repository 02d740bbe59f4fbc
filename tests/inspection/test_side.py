"""One side of a comparison: frames spread evenly, and the simulator's shots where it left its settings."""

import json
from pathlib import Path

import numpy as np
from street import write_street

from farfield.datasets import open_dataset
from farfield.inspection.comparison import count_dataset, has_sensors, shots_of
from farfield.inspection.statistics.census import dataset_notes
from farfield.jobs import JobOptions


def test_frames_are_spread_and_progress_sees_each(tmp_path: Path, rng: np.random.Generator) -> None:
    data = open_dataset(write_street(tmp_path / "street", rng, frames=4))
    seen: list[int] = []
    watched = JobOptions(progress=lambda places: (seen.append(place) or place for place in places))
    side = count_dataset(data, "street", 2, watched)
    assert seen == [0, 1]
    assert side.summary["frames"] == 2
    assert (side.simulated, side.title) == (False, "street")
    assert count_dataset(data, "street").summary["frames"] == 4
    assert has_sensors(data)
    assert dataset_notes(data) == ()


def test_the_simulators_settings_say_how_many_shots_there_are(tmp_path: Path) -> None:
    root = tmp_path / "Cirrus_dataset1"
    root.mkdir()
    assert shots_of(root) == {}
    (tmp_path / "simulation.json").write_text(json.dumps({"preset": {"lines": 32, "columns": 100}}))
    assert shots_of(root) == {"gaussian": 3200, "uniform": 3200, "os2-64": 6400, "os1-128": 12800}
    (tmp_path / "simulation.json").write_text("[]")
    assert shots_of(root) == {}

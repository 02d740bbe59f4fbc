"""Real detections and what the devkit makes of them, read once."""

import json
from pathlib import Path
from typing import Any

import pytest

from farfield.metrics.reading import ScoreInputs, read_inputs


@pytest.fixture(scope="session")
def real_detections(shared_real: Path) -> tuple[ScoreInputs, dict[str, Any]]:
    folder = shared_real / "kitti_tracking"
    expected = json.loads((folder / "expected_nuscenes.json").read_text())
    inputs = read_inputs(folder / "detections_pointrcnn_car", folder / "label", format="kitti-tracking")
    return inputs, expected

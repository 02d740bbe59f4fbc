"""Real detections and what the devkit makes of them, read once."""

import json
from pathlib import Path
from typing import Any

import pytest

from farfield.metrics import Detections
from farfield.metrics.box_files import read


@pytest.fixture(scope="session")
def real_detections(shared_real: Path) -> tuple[Detections, dict[str, Any]]:
    folder = shared_real / "kitti_tracking"
    expected = json.loads((folder / "expected_nuscenes.json").read_text())
    found = read(folder / "detections_pointrcnn_car", folder / "label", format="kitti-tracking")
    return found, expected

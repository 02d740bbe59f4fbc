"""What the fifty wrong inputs start from: a sound folder and sound predictions."""

from pathlib import Path

import pytest
from wrong_inputs import detections, own_folder


@pytest.fixture
def base(tmp_path: Path) -> Path:
    return own_folder(tmp_path / "drive")


@pytest.fixture
def predictions(tmp_path: Path) -> Path:
    return detections(tmp_path / "predictions.csv")

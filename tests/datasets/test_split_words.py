"""Parts cut in time by one word, so that a YAML file and a flag can ask for what the message advises."""

from pathlib import Path

import numpy as np
import pytest

import farfield as ff
from farfield.datasets import Dataset
from farfield.errors import DatasetError


@pytest.fixture
def drive(tmp_path: Path) -> Dataset:
    for number in range(20):
        np.save(tmp_path / f"{number:02d}.npy", np.ones((4, 4), np.float32))
    return ff.open_dataset(tmp_path)


def test_the_advice_for_one_drive_can_be_followed(drive: Dataset) -> None:
    with pytest.raises(DatasetError, match="split: time-train"):
        drive.split("train")
    for part in ("train", "val", "test"):
        assert drive.split(f"time-{part}").keys == drive.split(part, by="time").keys

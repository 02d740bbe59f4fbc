"""The example goes through the checks that Farfield's own data sets, detectors and protocols go through."""

from pathlib import Path

import numpy as np
import pytest

import farfield as ff
from farfield.files.boxes_csv import BoxRows, write_boxes_csv
from farfield.testing import check_dataset, check_detector, check_protocol

SMALL = {
    "grid": {"range_m": 48.0, "half_width_m": 16.0, "cell_m": 0.5},
    "anchors": {"vehicle": {"size_m": [4.4, 1.8, 1.4], "z_m": -1.2}},
    "width": 16,
}


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    """A small data set."""
    return write_survey(tmp_path / "survey")


def write_survey(root: Path) -> Path:
    """Write three frames, two with two cars each, the last one annotated as empty."""
    rng = np.random.default_rng(1)
    (root / "clouds").mkdir(parents=True)
    (root / "survey.txt").write_text("a survey\n")
    centre = np.array([[12.0, 3.0, -1.2], [30.0, -5.0, -1.2]] * 2)
    for name in "abc":
        cars = [place + rng.uniform(-1, 1, (120, 3)) * [2.2, 0.9, 0.7] for place in centre[:2] if name != "c"]
        ground = np.column_stack([rng.uniform(1, 48, 800), rng.uniform(-16, 16, 800), np.full(800, -2.0)])
        points = np.concatenate([ground, *cars])
        rows = np.column_stack([points, np.full(len(points), 0.3)])
        np.savetxt(root / "clouds" / f"{name}.csv", rows, fmt="%.3f", delimiter=",", header="x,y,z,intensity")
    boxes = {"centre_m": centre, "size_m": np.tile([4.4, 1.8, 1.4], (4, 1)), "yaw_rad": np.zeros(4)}
    frames = np.array(["a", "a", "b", "b"])
    write_boxes_csv(root / "boxes.csv", BoxRows(**boxes, frame=frames, label=np.full(4, "vehicle")))
    return root


def test_data_set(survey: Path) -> None:
    data = ff.open_dataset(survey)
    assert data.name == "survey"
    assert [len(frame.boxes) for frame in data] == [2, 2, 0]
    check_dataset(data)


def test_detector() -> None:
    check_detector("mean-pillars", SMALL, processes=True)


def test_protocol(survey: Path) -> None:
    check_protocol("recall")
    data = ff.open_dataset(survey)
    some = {frame.key: frame.boxes[:1] for frame in data}
    assert ff.evaluate(some, data, protocol="recall").figures == {"recall": 0.5}

"""Which points count as the present sweep's: not by their age, which sensors that fire between frames have too."""

from pathlib import Path

import numpy as np
import pytest

from farfield.datasets import open_dataset
from farfield.errors import DatasetError
from farfield.frame import Cloud
from tests.datasets.generators.nuscenes_trees import write_nuscenes

pytest.importorskip("torch")

from farfield.detectors.inputs import CloudInput
from farfield.training.config import UNCHANGED
from farfield.training.samples import TrainingSamples


def nothing(boxes: object, inputs: object) -> None:
    """Targets that nobody looks at."""
    del boxes, inputs


def samples(root: Path, cloud: str, **changes: object) -> TrainingSamples:
    """Unchanged samples of one cloud."""
    options = {name: changes.pop(name) for name in ("sweeps",) if name in changes}
    settings = {"classes": ("vehicle", "pedestrian", "bicycle", "large_vehicle"), "augmentation": UNCHANGED}
    inputs = {"points": CloudInput()}
    data = open_dataset(root, **options)
    return TrainingSamples(data, inputs=inputs, clouds=(cloud,), assigner=nothing, **{**settings, **changes})


@pytest.mark.parametrize("sweeps", [1, 2])
def test_boxes_of_truckscenes_keep_their_points(tmp_path, sweeps):
    """Its LiDARs' points have times of their own and its frames the time of the sample: no age is 0."""
    write_nuscenes(tmp_path, dialect="truckscenes", samples=2)
    one = samples(tmp_path, "LIDAR_LEFT", sweeps=sweeps)
    points, boxes = one.load(1)
    assert not (points[:, 3] == 0).all()
    assert len(boxes)
    one.prepare()


def test_a_second_sweep_counts_no_points(tmp_path):
    write_nuscenes(tmp_path, samples=2)
    clouds = [open_dataset(tmp_path, sweeps=count)[1].cloud("LIDAR_TOP") for count in (1, 2)]
    assert len(clouds[1]) > len(clouds[0])
    assert (clouds[1].column("sweep") == 0).sum() == len(clouds[0])
    assert not clouds[0].column("sweep").any()


def test_an_age_alone_tells_sweeps_apart_where_some_points_have_none():
    points = np.ones((3, 3), dtype=np.float32)
    aged = Cloud(points, None, {"lag_s": np.array([0.0, 0.1, 0.2], dtype=np.float32)})
    assert aged.column("sweep").tolist() == [0.0, 1.0, 1.0]
    late = Cloud(points, None, {"lag_s": np.array([0.01, 0.01, 0.02], dtype=np.float32)})
    assert not late.column("sweep").any()


def test_few_boxes_without_one_point_stop_a_training(tmp_path):
    write_nuscenes(tmp_path, samples=1)
    empty = samples(tmp_path, "LIDAR_TOP", min_points=1_000_000)
    with pytest.raises(DatasetError, match="boxes with at least 1000000 points, found none among"):
        empty.prepare()

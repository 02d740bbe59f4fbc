"""farfield adapt --donors: simulated road users in the user's own sweeps teach; their labels are not looked at."""

from pathlib import Path

import numpy as np
import pytest
import yaml

torch = pytest.importorskip("torch")

from experiments.test_learning_from_labels import CHOICES, Streets, streets  # noqa: F401

import farfield as ff
from farfield.datasets.memory import InMemory
from farfield.detectors.weights import load_weights
from farfield.errors import ConfigError, DatasetError
from farfield.experiments.adapting import dry_run
from farfield.experiments.adapting.donors import check_donors, donor_frames
from farfield.experiments.schema import DataConfig
from farfield.frame import Annotation, Boxes, Cloud, Frame, Sensor
from farfield.frame.record import Constant


def road(seed: int) -> np.ndarray:
    """What a sensor of 32 rows sees of a flat road 1.9 m beneath it, and of two walls beside it, shape (n, 3)."""
    rng = np.random.default_rng(seed)
    azimuth, elevation = np.meshgrid(
        np.linspace(-np.pi, np.pi, 600, endpoint=False), np.deg2rad(-24 + 0.75 * np.arange(32))
    )
    along = np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], -1)
    along = along.reshape(-1, 3)
    with np.errstate(divide="ignore"):
        to_road, to_wall = -1.9 / np.minimum(along[:, 2], -1e-9), 14 / np.maximum(np.abs(along[:, 1]), 1e-9)
    points = along * (np.minimum(to_road, to_wall) + rng.normal(0, 0.01, len(along)))[:, None]
    return points[np.minimum(to_road, to_wall) < 100].astype(np.float32)


def sweeps(count: int, *, boxes: Boxes | None = None, stands: np.ndarray | None = None) -> InMemory:
    """Sweeps in memory, annotated or not."""
    annotation = None if boxes is None else Constant(Annotation(boxes=boxes))
    sensor = Sensor(kind="lidar", frame_T_sensor=np.eye(4) if stands is None else stands)
    return InMemory(
        [
            Frame(
                sequence="street",
                frame_id=f"{number:04d}",
                clouds={"lidar": Cloud(road(number))},
                sensors={"lidar": sensor},
                load_annotation=annotation,
            )
            for number in range(count)
        ]
    )


def test_road_users_in_the_sweeps_teach_in_every_batch_and_the_weights_say_so(
    streets: Streets,  # noqa: F811
    tmp_path: Path,
) -> None:
    folder = tmp_path / "mine"
    folder.mkdir()
    for number in range(3):
        np.save(folder / f"{number:04d}.npy", road(number))
    choices = {**CHOICES, "source": streets.source, "donors": 5}
    assert "donors: 15 frames made of the sweeps" in dry_run(streets.start, folder, out=tmp_path / "out", **choices)
    done = ff.adapt(streets.start, folder, out=tmp_path / "out", **choices)
    provenance = load_weights(done.weights)[1]
    assert {name: stream["frames"] for name, stream in provenance["streams"].items()} == {
        "source": 4,
        "target": 3,
        "donors": 15,
    }
    experiment = yaml.safe_load((tmp_path / "out" / "round-1" / "experiment.yaml").read_text())
    assert experiment["method"]["donors"] is True
    assert experiment["data"]["donors"]["donors"] == {
        **experiment["data"]["donors"]["donors"],
        "copies": 5,
        "annotations": False,
        "family": "own",
    }
    logged = (tmp_path / "out" / "round-1" / "log.jsonl").read_text()
    assert '"donors_classification"' in logged
    again = ff.adapt(streets.start, folder, out=tmp_path / "out", **choices)  # all is done: the same weights
    assert again.weights.read_bytes() == done.weights.read_bytes()
    with pytest.raises(ConfigError, match="it differs in donors"):
        ff.adapt(streets.start, folder, out=tmp_path / "out", **{**choices, "donors": 6})


def test_labels_of_the_sweeps_change_no_donor_frame() -> None:
    far = Boxes(
        centre_m=np.array([[20.0, 3, -1]]), size_m=np.array([[4.5, 1.9, 1.6]]), yaw_rad=np.zeros(1), label=["vehicle"]
    )
    config = DataConfig(path=Path("street"), clouds=("lidar",))
    plain, labelled = (donor_frames(config, sweeps(1, boxes=boxes), copies=3, seed=0)[1] for boxes in (None, far))
    for number in range(3):
        np.testing.assert_array_equal(plain[number].cloud("lidar").points_m, labelled[number].cloud("lidar").points_m)
        one, other = plain.annotation(number).boxes, labelled.annotation(number).boxes
        np.testing.assert_array_equal(one.centre_m, other.centre_m)
        assert list(one.label) == list(other.label)
        assert "unsure" in one.label
        assert {"vehicle", "large_vehicle", "pedestrian", "bicycle"} & set(one.label)


def test_sweeps_in_other_axes_or_without_ground_are_refused(streets: Streets) -> None:  # noqa: F811
    config, detector = DataConfig(path=Path("street"), clouds=("lidar",)), ff.load_detector(streets.start)
    on_a_roof = np.eye(4)
    on_a_roof[2, 3] = 1.9
    with pytest.raises(ConfigError, match="--reference lidar"):
        check_donors(donor_frames(config, sweeps(1, stands=on_a_roof), copies=3, seed=0)[1], detector)
    wall = np.column_stack([np.full(500, 20.0), np.linspace(-9, 9, 500), np.linspace(0, 9, 500)]).astype(np.float32)
    cloud = InMemory([Frame(sequence="street", frame_id="0", clouds={"lidar": Cloud(wall)})])
    with pytest.raises(DatasetError, match="found no room"):
        check_donors(donor_frames(config, cloud, copies=3, seed=0)[1], detector)


def test_a_thousand_sweeps_make_no_more_than_forty_thousand_frames() -> None:
    config = DataConfig(path=Path("street"), clouds=("lidar",))
    few = sweeps(1)
    many = few.select([0] * 1000)
    assert len(donor_frames(config, many, copies=1000, seed=0)[1]) == 40_000
    assert len(donor_frames(config, few, copies=1000, seed=0)[1]) == 1000

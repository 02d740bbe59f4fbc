"""One way from a detector to a number: Python and command line give one JSON, and what does not fit is refused."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("embreex")

from drive import frame as kradar_frame
from small import small_detector

import farfield as ff
from farfield.cli import main
from farfield.datasets.kradar import KRadarWriter
from farfield.detectors.runtime import Detector
from farfield.detectors.weights import save_weights
from farfield.errors import ConfigError
from farfield.evaluation import detect, suitable_clouds
from farfield.frame import Annotation, Boxes
from farfield.metrics import Bootstrap
from farfield.radar.axes import KRADAR_AXES
from farfield.radar.cells import cells_of_cube
from farfield.radar.products import zyx_cube
from farfield.vocabulary.kradar import KRADAR_ORIGIN_M

FEW = Bootstrap(replicates=3)


def saved(folder: Path, name: str, data: dict[str, Any], **settings: Any) -> Path:
    """The weights of an untrained small detector that learnt from these data, as far as its provenance knows."""
    network = small_detector(name, score_threshold=0.0, **settings)
    experiment = {"data": data, "training": {"steps": 0, "batch_size": 1, "seed": 0}}
    path = folder / f"{name}.safetensors"
    save_weights(path, network.state_dict(), config=network.config, provenance={"experiment": experiment, "frames": 0})
    return path


@pytest.fixture(scope="module")
def cirrus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cirrus")
    assert main(["simulate", "cirrus-sim-mini", str(folder / "data"), "--frames", "2", "--workers", "1"]) == 0
    return folder


@pytest.fixture(scope="module")
def kradar(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two drives in different weather with a car that one sensor sees, and an RTNH that learnt in the radar's frame."""
    folder = tmp_path_factory.mktemp("kradar")
    power = np.random.default_rng(1).exponential(10**10.9, KRADAR_AXES.shape[1:]).astype(np.float32)
    cells = cells_of_cube(zyx_cube(power), "narrow")
    car = Boxes(
        centre_m=np.array([[20.0, 1.0, 0.0]]) + np.array(KRADAR_ORIGIN_M),
        size_m=np.array([[4.2, 2.0, 1.6]]),
        yaw_rad=np.zeros(1),
        label=["vehicle"],
    )
    writer = KRadarWriter(folder / "data")
    for sequence, weather in (("1", "fog"), ("2", "light_snow")):
        given = kradar_frame(1, sequence=sequence, weather=weather, radar={"cells": cells})
        writer.write(given.annotated(Annotation(boxes=car, visibility=["R"])))
    writer.finish()
    options = {"reference": "radar", "radar_rate": 0.01, "radar_region": "narrow"}
    saved(folder, "rtnh", {"path": "data", "clouds": ["radar"], "options": options})
    return folder


def by_command(detector: Path, data: Path, *flags: str) -> dict[str, Any]:
    out = detector.parent / "evaluation"
    words = ["--precision", "fp32", "--replicates", "3", "--shown-frames", "0", "--out", str(out)]
    assert main(["evaluate", str(detector), str(data), *words, *flags]) == 0
    return json.loads((out / "evaluation.json").read_text())["results"]


def by_python(detector: Path, data: Path, cloud: str, **settings: Any) -> dict[str, Any]:
    loaded = ff.load_detector(detector, precision="fp32")
    result = ff.evaluate(loaded, ff.open_dataset(data), cloud=cloud, bootstrap=FEW, **settings)
    return json.loads(json.dumps(result.to_json()))


@pytest.mark.parametrize(
    ("settings", "flags"),
    [
        ({}, []),
        ({"min_points": 5}, ["--options", "min_points=5"]),
        ({"protocol": "nuscenes"}, ["--protocol", "nuscenes"]),
        (
            {"protocol": "kitti", "range_bins_m": (0.0, 30.0, 60.0)},
            ["--protocol", "kitti", "--range-bins-m", "0,30,60"],
        ),
    ],
    ids=["dds", "dds, boxes of five points", "nuscenes", "kitti"],
)
def test_both_patterns_score_alike(cirrus: Path, settings: dict[str, Any], flags: list[str]) -> None:
    detector = saved(cirrus, "pointpillars", {"path": "data", "clouds": ["gaussian"]})
    results = by_command(detector, cirrus / "data", *flags)
    assert set(results) == {"gaussian", "uniform"}
    for cloud, result in results.items():
        assert result == by_python(detector, cirrus / "data", cloud, **settings)
    if settings.get("min_points"):  # each pattern's own points decide
        counted = [result["counts"]["annotated"] for result in results.values()]
        assert counted[0] != counted[1]


def test_kitti_scores_its_difficulties_alike(shared_real: Path, tmp_path: Path) -> None:
    detector = saved(tmp_path, "pointpillars", {"path": "data", "clouds": ["gaussian"]})
    results = by_command(detector, shared_real / "kitti", "--protocol", "kitti")
    assert set(results) == {"lidar"}
    assert results["lidar"] == by_python(detector, shared_real / "kitti", "lidar", protocol="kitti")
    assert {"easy", "moderate", "hard"} <= set(json.dumps(results["lidar"]["ap"]).replace('"', " ").split())


@pytest.mark.parametrize("region", ["wide", "narrow"])
@pytest.mark.parametrize("protocol", ["kradar", "kradar-compat:rtnh_wide"])
def test_kradar_scores_by_condition_and_visibility_alike(kradar: Path, protocol: str, region: str) -> None:
    flags = ["--protocol", protocol] + (["--region", region] if protocol == "kradar" else [])
    results = by_command(kradar / "rtnh.safetensors", kradar / "data", *flags)
    given = {"region": region} if protocol == "kradar" else {}
    assert results == {
        "radar": by_python(kradar / "rtnh.safetensors", kradar / "data", "radar", protocol=protocol, **given)
    }
    assert results["radar"]["settings"]["boxes_in"] == "radar"
    if protocol == "kradar":
        assert {name for name, part in results["radar"]["conditions"]["weather"].items() if part} == {
            "fog",
            "light_snow",
        }
        assert {name for name, part in results["radar"]["visibility"].items() if part} == {"R"}
        assert results["radar"]["settings"]["classes"] == ["vehicle"]  # those that the detector knows


def test_raw_frames_are_refused_by_a_detector_that_learnt_in_other_coordinates(kradar: Path) -> None:
    detector, data = ff.load_detector(kradar / "rtnh.safetensors"), ff.open_dataset(kradar / "data")
    with pytest.raises(ConfigError, match=r"farfield\.detect"):
        detector(data[0])
    found = detect(detector, data)
    seen = ff.open_dataset(kradar / "data", reference="radar", radar_rate=0.01, radar_region="narrow")
    expected = detector(seen[0])
    assert found.reference == "radar"
    np.testing.assert_array_equal(found.boxes[seen[0].key].centre_m, expected.centre_m)


def test_a_radar_detector_takes_no_lidar_and_a_lidar_detector_no_radar(kradar: Path, shared_real: Path) -> None:
    """It once scored LiDAR intensity as radar power: 0.1452, exit status 0."""
    radar = ff.load_detector(kradar / "rtnh.safetensors")
    with pytest.raises(ConfigError, match="Expected a cloud of a radar"):
        detect(radar, ff.open_dataset(shared_real / "kitti"))
    assert main(["evaluate", str(kradar / "rtnh.safetensors"), str(shared_real / "kitti")]) == 1
    lidar = Detector(small_detector("pointpillars"), provenance={"experiment": {"data": {"clouds": ["gaussian"]}}})
    delft = ff.open_dataset(shared_real / "view_of_delft")[0]
    assert set(delft.clouds) > {"lidar"}
    assert suitable_clouds(lidar.info, delft) == ("lidar",)
    with pytest.raises(ConfigError, match="radar"):
        lidar.with_cloud("radar")(delft)


def test_nothing_counts_where_nobody_annotated(shared_real: Path) -> None:
    """KITTI's boxes stand in the camera's field: what a whole sweep shows beside it is neither right nor wrong."""
    data = ff.open_dataset(shared_real / "kitti")
    ahead = {frame.key: frame.boxes.replace(score=np.ones(len(frame.boxes))) for frame in data}
    behind = {
        key: Boxes.concatenate([boxes, boxes.replace(centre_m=boxes.centre_m * [-1, 1, 1], score=np.ones(len(boxes)))])
        for key, boxes in ahead.items()
    }
    one, other = (ff.evaluate(boxes, data, region="none", bootstrap=FEW) for boxes in (ahead, behind))
    assert one.figures == other.figures
    assert any("outside the field of" in note for note in other.notes)


def test_bins_beyond_the_reach_have_no_figure(cirrus: Path) -> None:
    detector = saved(cirrus, "pointpillars", {"path": "data", "clouds": ["gaussian"]})  # looks 64 m ahead
    result = by_python(detector, cirrus / "data", "gaussian", range_bins_m=(0.0, 50.0, 70.0, 150.0))
    assert result["ranges"]["70-150"] is None
    assert result["ranges"]["0-50"] is not None
    assert any("70-150 m begins beyond the detector's reach of 64 m" in note for note in result["notes"])

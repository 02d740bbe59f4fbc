"""train, evaluate and predict on K-Radar's layout: the radar's frame, cloud and conditions go all the way."""

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")

from drive import frame

from farfield.api import evaluate, load_detector
from farfield.cli import main
from farfield.datasets import open_dataset
from farfield.datasets.kradar import KRadarWriter
from farfield.datasets.maps import Coordinates
from farfield.evaluation import as_trained
from farfield.files.boxes_csv import read_boxes_csv
from farfield.frame import Annotation, Boxes
from farfield.metrics import Bootstrap
from farfield.radar.axes import KRADAR_AXES
from farfield.radar.cells import cells_of_cube
from farfield.radar.products import zyx_cube
from farfield.vocabulary.kradar import KRADAR_ORIGIN_M

FEW = Bootstrap(replicates=3)
EXPERIMENT = """
name: tiny
data:
  path: data
  clouds: [radar]
  options: {reference: radar, radar_rate: 0.01, radar_region: narrow}
detector:
  {name: rtnh, form: wide, widths: [4, 4], cell_channels: 4, neck_width: 4, score_threshold: 0.0, candidates: 100}
augmentation: {rotation_rad: 0.0, scale: 0.0}
training: {steps: 2, batch_size: 1, precision: fp32, threads: 1, workers: 0, min_points: 0}
"""


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two drives of two frames in different weather, a car 20 m ahead of the radar, and a detector that saw them."""
    folder = tmp_path_factory.mktemp("home")
    rng = np.random.default_rng(1)
    power = rng.exponential(10**10.9, KRADAR_AXES.shape[1:]).astype(np.float32)
    cells = cells_of_cube(zyx_cube(power), "narrow")
    car = Boxes(
        centre_m=np.array([[20.0, 1.0, 0.0]]) + np.array(KRADAR_ORIGIN_M),
        size_m=np.array([[4.2, 2.0, 1.6]]),
        yaw_rad=np.zeros(1),
        label=["vehicle"],
    )
    writer = KRadarWriter(folder / "data")
    for sequence, weather in (("1", "fog"), ("2", "light_snow")):
        for number in (1, 2):
            given = frame(number, sequence=sequence, weather=weather, radar={"cells": cells})
            writer.write(given.annotated(Annotation(boxes=car, visibility=["R"])))
    writer.finish()
    (folder / "tiny.yaml").write_text(EXPERIMENT)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert main(["train", "tiny.yaml"]) == 0
    return folder


def test_evaluate_scores_by_weather(home: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    monkeypatch.chdir(home)
    words = ["--region", "narrow", "--replicates", "3", "--out", "eval", "--shown-frames", "1"]
    assert main(["evaluate", "runs/tiny", "data", *words]) == 0
    evaluation = json.loads((home / "eval" / "evaluation.json").read_text())
    assert set(evaluation["results"]) == {"radar"}  # the LiDARs' clouds are none of its kind
    result = evaluation["results"]["radar"]
    assert result["protocol"] == "kradar"
    assert {name for name, part in result["conditions"]["weather"].items() if part} == {"fog", "light_snow"}
    assert {name for name, part in result["visibility"].items() if part} == {"R"}
    assert result["counts"]["classes"]["vehicle"]["annotated"] == 4
    assert result["settings"]["region"] == "narrow"
    assert "radar:" in capsys.readouterr().out
    assert (home / "eval" / "report.html").stat().st_size > 20_000


def test_predict_reads_the_cloud_that_it_learnt_from(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(home)
    assert main(["predict", "runs/tiny", "data", "--out", "boxes.csv", "--score-threshold", "0"]) == 0
    rows = read_boxes_csv(home / "boxes.csv")
    assert len(rows) > 0
    assert np.abs(rows.centre_m[:, 1]).max() < 20  # in the radar's corridor: the drive's LiDAR points are all over


def test_the_one_line_evaluation_knows_where_the_boxes_are(home: Path) -> None:
    """The car stands in the corridor whichever frame the data are opened in."""
    data = open_dataset(home / "data")
    for given in (data, data.mapped(Coordinates("radar"))):
        found = {frame.key: frame.boxes.replace(score=np.ones(1)) for frame in (given[i] for i in range(4))}
        narrow = (19.0, 21.0, 0.5, 1.5, -1.0, 1.0)
        result = evaluate(found, given, protocol="kradar", region=narrow, bootstrap=FEW).to_json()
        assert result["ap"]["vehicle"]["3d"]["0.7"] == 1
        assert result["counts"]["classes"]["vehicle"]["annotated"] == 4
        assert result["conditions"]["weather"]["fog"]["ap"]["vehicle"]["3d"]["0.7"] == 1
    detected = evaluate(load_detector(home / "runs" / "tiny"), data, protocol="kradar", bootstrap=FEW).to_json()
    assert detected["settings"]["boxes_in"] == "radar"  # as the detector learnt


def test_data_are_seen_as_in_training(home: Path) -> None:
    data = open_dataset(home / "data")
    detector = load_detector(home / "runs" / "tiny")
    seen = as_trained(data.select([3, 1]), detector.info)
    assert (data[0].reference, seen[0].reference) == ("os2-64", "radar")
    np.testing.assert_allclose(seen[0].boxes.centre_m, [[20.0, 1.0, 0.0]], atol=1e-9)
    assert len(seen[0].clouds["radar"]) < len(data[0].clouds["radar"])
    assert seen.keys == (data.keys[3], data.keys[1])

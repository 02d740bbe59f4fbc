"""train, evaluate, predict, report and demo, one after the other on a few small simulated frames."""

import json
import shutil

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("embreex")

from farfield.cli import main
from farfield.datasets import open_dataset
from farfield.files.boxes_csv import read_boxes_csv

EXPERIMENT = """
name: tiny
data: {path: data, clouds: [gaussian], simulate: {preset: cirrus-sim-mini, sequences: 1, frames: 2, seed: 3}}
detector:
  {grid: {range_m: 64.0, half_width_m: 16.0, cell_m: 0.5}, widths: [8, 16, 16], depths: [0, 0, 0], neck_width: 16,
   score_threshold: 0.0}
training: {steps: 2, batch_size: 1, precision: fp32, threads: 1, workers: 0}
"""


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """A folder in which a tiny detector was trained on data that the experiment made itself."""
    folder = tmp_path_factory.mktemp("home")
    (folder / "tiny.yaml").write_text(EXPERIMENT)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert main(["train", "tiny.yaml"]) == 0
    return folder


@pytest.fixture(autouse=True)
def at_home(home, monkeypatch):
    monkeypatch.chdir(home)


def test_train_leaves_a_run_that_explains_itself(home):
    run = home / "runs" / "tiny"
    assert {path.name for path in run.iterdir()} >= {
        "experiment.yaml",
        "provenance.json",
        "log.jsonl",
        "weights.safetensors",
    }
    assert json.loads((run / "provenance.json").read_text())["data_fingerprint"] == open_dataset("data").fingerprint()
    assert main(["train", "tiny.yaml"]) == 0  # nothing left to do, and nothing is simulated anew


def test_evaluate_scores_each_pattern_and_writes_a_page(home, capsys):
    words = ["--range-bins-m", "0,30,60", "--replicates", "3", "--out", "eval", "--shown-frames", "1"]
    assert main(["evaluate", "runs/tiny", "data", *words]) == 0
    shown = capsys.readouterr().out
    assert "gaussian" in shown
    assert "report:" in shown
    evaluation = json.loads((home / "eval" / "evaluation.json").read_text())
    assert set(evaluation["results"]) == {"gaussian", "uniform"}
    assert set(evaluation["results"]["gaussian"]["ranges"]) == {"0-30", "30-60"}
    assert evaluation["provenance"]["simulated"] is True
    assert (home / "eval" / "report.html").stat().st_size > 20_000
    assert main(["report", "eval", "--out", "again.html"]) == 0
    assert (home / "again.html").is_file()


def test_evaluate_shows_what_is_taken_for_a_vehicle(home, capsys):
    words = ["--clouds", "gaussian", "--replicates", "0", "--out", "eval-false", "--no-report"]
    assert main(["evaluate", "runs/tiny", "data", *words, "--paste-cars", "luminar-h2"]) == 0
    assert "2 sweeps without annotated objects, cars pasted as luminar-h2 sees them: " in capsys.readouterr().out
    tree = json.loads((home / "eval-false" / "false_vehicles.json").read_text())
    assert tree["sweeps"] == len(tree["scenes"]) == 2
    assert len(tree["cars"]) > 5
    page = (home / "eval-false" / "false_vehicles.html").read_text()
    assert "False vehicles over found cars" in page
    kinds = {one["kind"] for one in tree["false"]}
    assert kinds
    assert all(f"Taken for vehicles: {kind}" in page for kind in kinds)


def test_cars_are_pasted_into_the_cloud_that_is_evaluated(home, capsys):
    """Of the sweeps those with labels; without any, it fails before something is detected."""
    shutil.copytree("data", "partly")
    labels = sorted(path for path in (home / "partly").rglob("dataset1_annotation/*.json"))
    labels[0].unlink()
    words = ["--clouds", "uniform", "--replicates", "0", "--no-report", "--paste-cars", "luminar-h2"]
    assert main(["evaluate", "runs/tiny", "partly", *words, "--out", "eval-partly"]) == 0
    assert "uniform: 1 sweep without annotated objects" in capsys.readouterr().out
    labels[1].unlink()
    assert main(["evaluate", "runs/tiny", "partly", *words, "--out", "eval-bare", "--dry-run"]) == 1
    assert "--paste-cars: expected annotated sweeps" in capsys.readouterr().err
    assert not (home / "eval-bare").exists()


def test_predict_writes_boxes_that_score_reads(home, capsys):
    assert (
        main(["predict", "runs/tiny", "data", "--out", "boxes.csv", "--score-threshold", "0", "--picture", "a.png"])
        == 0
    )
    rows = read_boxes_csv(home / "boxes.csv")
    assert set(rows.frame) <= {key[1] for key in open_dataset("data").keys}
    assert len(rows) > 0
    assert (home / "a.png").stat().st_size > 5_000
    assert main(["convert", "data", "labels.csv", "--to", "boxes-csv"]) == 0
    words = ["--format", "boxes-csv", "--json", "scores.json", "--replicates", "3"]
    assert main(["score", "boxes.csv", "labels.csv", *words]) == 0
    assert json.loads((home / "scores.json").read_text())["protocol"] == "dds"
    capsys.readouterr()
    cloud = next((home / "data").rglob("*.xyz"))
    assert main(["predict", "runs/tiny", str(cloud), "--score-threshold", "0"]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("sequence,frame,label,x,y,z")
    assert cloud.stem in printed


def test_half_turn_and_back_predicts_the_same_place(home):
    """Turned data keep boxes and points together: the doctor still finds points in every box."""
    plain, turned = open_dataset("data")[0], open_dataset("data", rotate_deg=180)[0]
    np.testing.assert_allclose(turned.boxes.centre_m[:, :2], -plain.boxes.centre_m[:, :2], atol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["evaluate", "no-such", "data"], "bundled detector"),
        (["evaluate", "runs/tiny", "nowhere"], "found nothing"),
        (["predict", "runs/tiny", "nowhere.pcd"], "not there"),
        (["train", "nowhere.yaml"], "found nothing"),
        (["train", "tiny.yaml", "-o", "training.step=1"], "training.step"),
        (["evaluate", "runs/tiny", "data", "--range-bins-m", "0,a"], "comma-separated numbers"),
    ],
)
def test_mistakes_are_named_and_exit_with_1(arguments, words, capsys):
    assert main(arguments) == 1
    assert words in capsys.readouterr().err


def test_demo_ends_with_the_path_of_a_report(home, capsys):
    assert main(["demo", "--frames", "1", "--sequences", "1", "--out", "demo"]) == 0
    last = capsys.readouterr().out.strip().splitlines()[-1]
    assert last.startswith("report: ")
    assert (home / "demo" / "evaluation" / "report.html").is_file()

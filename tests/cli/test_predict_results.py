"""What predict writes: which boxes, in which file, by which name; each is read back by score."""

import json

import numpy as np
import pytest

pytest.importorskip("torch")

from farfield.cli import main
from farfield.datasets.folder import write_boxes
from farfield.files.boxes_csv import read_boxes_csv
from farfield.files.kitti import read_labels
from farfield.frame import Boxes
from farfield.metrics.box_files import read_predictions

DETECTOR = "pointpillars-cirrus-sim"
CARS = ((12.0, 0.0), (25.0, 4.0), (40.0, -5.0))


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    """A folder of two clouds of one's own."""
    folder, rng = tmp_path_factory.mktemp("home") / "own", np.random.default_rng(4)
    folder.mkdir()
    for frame in ("000000", "000001"):
        ground = np.column_stack([rng.uniform(3, 60, 4000), rng.uniform(-12, 12, 4000), rng.normal(-2, 0.03, 4000)])
        cars = [rng.uniform(-1, 1, (400, 3)) * [2.2, 0.9, 0.75] + [x, y, -1.2] for x, y in CARS]
        points = np.concatenate([ground, *cars])
        np.save(folder / f"{frame}.npy", np.column_stack([points, np.full(len(points), 0.3)]).astype(np.float32))
    return folder


def predict(*words) -> int:
    return main(["predict", DETECTOR, *map(str, words), "--device", "cpu", "--precision", "fp32"])


def test_flags_choose_the_boxes(own, tmp_path):
    out = tmp_path / "all.csv"
    assert predict(own, "--out", out, "--score-threshold", "0.01") == 0
    every = read_boxes_csv(out)
    assert every.score.min() < 0.05, "below the weights' own threshold"
    flags = ["--score-threshold", "0.01", "--classes", "vehicle:Car,bicycle", "--max-boxes", "2", "--nms-iou", "0.3"]
    assert predict(own, "--out", out, *flags) == 0
    some = read_boxes_csv(out)
    assert set(some.label) <= {"Car", "bicycle"}
    assert {int((some.frame == frame).sum()) for frame in ("000000", "000001")} == {2}


def test_unknown_classes_are_named(own, capsys):
    assert predict(own, "--classes", "Car") == 1
    assert "vehicle, large_vehicle" in capsys.readouterr().err


def test_own_folders_score_against_labels_without_a_sequence(own, tmp_path, capsys):
    out, labels = tmp_path / "boxes.csv", tmp_path / "truth.csv"
    assert predict(own, "--out", out, "--classes", "vehicle") == 0
    assert set(read_boxes_csv(out).sequence) == {"own"}
    rows = [f"{frame},vehicle,{x},{y},-1.2,4.4,1.8,1.5,0" for frame in ("000000", "000001") for x, y in CARS]
    labels.write_text("\n".join(["frame,label,x,y,z,l,w,h,yaw_rad", *rows]) + "\n")
    capsys.readouterr()
    words = ["--json", str(tmp_path / "s.json"), "--replicates", "0", "--range-bins-m", "0,60"]
    assert main(["score", str(out), str(labels), *words]) == 0
    assert "labels name no sequence" in capsys.readouterr().out
    scored = json.loads((tmp_path / "s.json").read_text())
    assert (scored["counts"]["annotated"], scored["counts"]["frames"]) == (6, 2)


def test_kitti_results_are_a_folder_that_score_reads(own, tmp_path):
    out = tmp_path / "kitti"
    assert predict(own, "--out", tmp_path / "boxes.csv") == 0
    assert predict(own, "--out", out, "--format", "kitti") == 0
    assert sorted(path.name for path in out.iterdir()) == ["000000.txt", "000001.txt", "CARD.md", "COORDINATES"]
    rows, first = read_boxes_csv(tmp_path / "boxes.csv"), read_labels(out / "000000.txt")
    assert set(first.type) <= {"Car", "Truck", "Pedestrian", "Cyclist"}
    read = read_predictions(out, format="kitti").boxes["", "000000"]
    here = rows.frame == "000000"
    np.testing.assert_allclose(read.centre_m, rows.centre_m[here], atol=1e-9)
    np.testing.assert_allclose(read.size_m, rows.size_m[here])
    np.testing.assert_array_equal(read.score, rows.score[here])


def test_a_frame_without_boxes_has_a_file_of_its_own(own, tmp_path):
    assert predict(own, "--out", tmp_path / "kitti", "--format", "kitti", "--score-threshold", "1") == 0
    assert [path.read_text() for path in sorted((tmp_path / "kitti").glob("*.txt"))] == ["", ""]
    assert predict(own, "--out", tmp_path / "n.json", "--score-threshold", "1") == 0
    assert json.loads((tmp_path / "n.json").read_text())["results"] == {"000000": [], "000001": []}


def test_nuscenes_results_are_the_json_that_the_suffix_says(own, tmp_path, capsys):
    assert predict(own, "--out", tmp_path / "boxes.csv") == 0
    assert predict(own, "--out", tmp_path / "boxes.json") == 0
    assert "nuScenes" in capsys.readouterr().out
    tree = json.loads((tmp_path / "boxes.json").read_text())
    assert tree["meta"]["use_lidar"] is True
    rows, found = read_boxes_csv(tmp_path / "boxes.csv"), read_predictions(tmp_path / "boxes.json", format="nuscenes")
    here, boxes = rows.frame == "000001", found.boxes["", "000001"]
    np.testing.assert_allclose(boxes.centre_m, rows.centre_m[here], atol=1e-9)
    np.testing.assert_allclose(boxes.size_m, rows.size_m[here], atol=1e-9)
    np.testing.assert_allclose(np.cos(boxes.yaw_rad - rows.yaw_rad[here]), 1, atol=1e-9)
    assert set(boxes.label) <= {"car", "truck", "pedestrian", "bicycle"}
    for box in tree["results"]["000001"]:
        assert set(box) == {
            "sample_token", "translation", "size", "rotation", "velocity",
            "detection_name", "detection_score", "attribute_name",
        }  # fmt: skip


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--out", "results/"], "--to kitti"),
        (["--out", "boxes.txt"], ".csv"),
        (["--out", "boxes.json", "--format", "boxes-csv"], ".csv"),
        (["--out", "boxes.csv", "--format", "nuscenes"], ".json"),
        (["--format", "kitti"], "--out"),
    ],
)
def test_names_that_say_something_else_are_refused(own, tmp_path, monkeypatch, capsys, words, expected):
    monkeypatch.chdir(tmp_path)
    assert predict(own, *words) == 1
    assert expected in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_folder_is_never_overwritten_by_a_file(own, tmp_path, capsys):
    (tmp_path / "there.csv").mkdir()
    assert predict(own, "--out", tmp_path / "there.csv") == 1
    assert "folder" in capsys.readouterr().err


def test_boxes_written_beside_the_clouds_are_the_labels(own, tmp_path):
    """What a folder's own JSON says and what the table says are the same annotation."""
    from farfield.datasets import open_dataset

    boxes = Boxes(
        centre_m=np.array([[12.0, 0, -1.2]]), size_m=np.array([[4.4, 1.8, 1.5]]), yaw_rad=np.zeros(1), label=["vehicle"]
    )
    for path in own.glob("*.npy"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    write_boxes(tmp_path / "000000.json", boxes)
    by_json = open_dataset(tmp_path)[0].boxes
    (tmp_path / "000000.json").unlink()
    (tmp_path / "labels.csv").write_text("frame,label,x,y,z,l,w,h,yaw_rad\n000000,vehicle,12,0,-1.2,4.4,1.8,1.5,0\n")
    by_table = open_dataset(tmp_path)[0].boxes
    np.testing.assert_array_equal(by_table.centre_m, by_json.centre_m)
    assert list(by_table.label) == ["vehicle"]


def test_evaluate_has_the_same_flags_and_keeps_them(own, tmp_path, monkeypatch, capsys):
    from farfield.errors import ConfigError

    seen = {}

    def stop(detector, data, options):
        seen.update(detector=detector, data=data, options=options)
        raise ConfigError("far enough")

    monkeypatch.setattr("farfield.evaluation.evaluating.evaluate_clouds", stop)
    flags = ["--score-threshold", "0.2", "--max-boxes", "7", "--nms-iou", "0.4", "--classes", "vehicle:car"]
    assert main(["evaluate", DETECTOR, str(own), *flags, "--device", "cpu", "--out", str(tmp_path)]) == 1
    assert "far enough" in capsys.readouterr().err
    config = seen["detector"].config
    assert (config.score_threshold, config.nms_iou, seen["detector"].chosen.max_boxes) == (0.2, 0.4, 7)
    assert seen["detector"].class_names == ("car",)
    assert seen["options"].provenance["kept"] == {
        "score_threshold": 0.2, "nms_iou": 0.4, "max_boxes": 7, "classes": "vehicle:car",
    }  # fmt: skip

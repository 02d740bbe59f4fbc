"""convert --to kitti, results in KITTI's text and score --format kitti as a chain: one space, whoever names it."""

import json
from pathlib import Path

import numpy as np
import pytest

from farfield.cli import main
from farfield.datasets import open_dataset
from farfield.datasets.result_files import ResultWriter

TABLE = "frame,label,x,y,z,l,w,h,yaw_rad\n" + "".join(
    f"{frame},{name},{x},2,-1,4.4,1.8,1.5,0.3\n"
    for frame in ("000000", "000001")
    for name, x in (("Car", 20), ("Cone", 9))
)


@pytest.fixture
def own(tmp_path: Path, rng: np.random.Generator) -> Path:
    folder = tmp_path / "own"
    folder.mkdir()
    for stem in ("000000", "000001"):
        rows = np.column_stack([rng.uniform(1, 60, (50, 3)), np.full(50, 0.5)])
        np.save(folder / f"{stem}.npy", rows.astype(np.float32))
    (folder / "labels.csv").write_text(TABLE)
    return folder


def results(data: Path, out: Path) -> Path:
    """The annotated boxes of a data set as a detector's results, as predict --format kitti writes them."""
    frames = open_dataset(data)
    boxes = [frame.boxes.replace(score=np.full(len(frame.boxes), 0.9)) for frame in frames]
    ResultWriter("kitti", frames, frames.keys).write(out, zip(frames.keys, boxes, strict=True))
    return out


@pytest.mark.parametrize("source", ["own", "as_kitti"])
@pytest.mark.parametrize("truth", ["own", "as_kitti", "as_kitti/training/label_2"])
def test_the_chain_scores_1(tmp_path: Path, own: Path, source: str, truth: str) -> None:
    assert main(["convert", str(own), str(tmp_path / "as_kitti"), "--to", "kitti"]) == 0
    predictions = results(tmp_path / source, tmp_path / "predictions")
    words = ["--format", "kitti", "--label", "Car", "--replicates", "0", "--json", str(tmp_path / "s.json")]
    assert main(["score", str(predictions), str(tmp_path / truth), *words]) == 0
    tree = json.loads((tmp_path / "s.json").read_text())
    assert tree["dds"]["0"]["dds"] == pytest.approx(1.0)
    assert tree["counts"]["annotated"] == 2


def test_other_coordinates_are_refused_with_a_cure_that_exists(
    tmp_path: Path, own: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["convert", str(own), str(tmp_path / "as_kitti"), "--to", "kitti"]) == 0
    predictions = results(own, tmp_path / "predictions")
    (predictions / "COORDINATES").write_text("camera cam-front\n")
    labels = tmp_path / "as_kitti" / "training" / "label_2"
    assert main(["score", str(predictions), str(labels), "--format", "kitti"]) == 1
    assert "farfield score PREDICTIONS DATASET --format kitti" in capsys.readouterr().err
    assert main(["score", str(predictions), str(own), "--format", "kitti"]) == 1
    assert "camera cam-front" in capsys.readouterr().err


def test_a_part_that_the_data_have_not_is_not_written(tmp_path: Path) -> None:
    assert main(["simulate", "kitti-sim-mini", str(tmp_path / "sim")]) == 0
    assert main(["convert", str(tmp_path / "sim"), str(tmp_path / "again"), "--to", "kitti"]) == 0
    sets = sorted(path.name for path in (tmp_path / "again" / "ImageSets").iterdir())
    assert sets == ["train.txt", "val.txt"]
    before, after = open_dataset(tmp_path / "sim"), open_dataset(tmp_path / "again")
    for name in ("train", "val"):
        assert len(after.split(name)) == len(before.split(name)) > 0
    for old, new in zip(before, after, strict=True):
        assert new.annotation.details["occlusion"].tolist() == old.annotation.details["occlusion"].tolist()


@pytest.mark.parametrize("truth", ["own", "as_kitti"])
def test_kittis_protocol_scores_what_convert_wrote_and_says_what_is_not_known(
    tmp_path: Path, own: Path, truth: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["convert", str(own), str(tmp_path / "as_kitti"), "--to", "kitti"]) == 0
    predictions = results(own, tmp_path / "predictions")
    words = ["--format", "kitti", "--label", "Car", "--replicates", "5", "--json", str(tmp_path / "s.json")]
    assert main(["score", str(predictions), str(tmp_path / truth), *words, "--protocol", "kitti"]) == 0
    tree = json.loads((tmp_path / "s.json").read_text())
    assert tree["ap"]["3d_r40"] == {"easy": 1.0, "moderate": 1.0, "hard": 1.0}
    assert "occlusion of all 4 annotated boxes is not known" in capsys.readouterr().out

"""Names of files that are not UTF-8: no verb loses its work to them."""

import os
from pathlib import Path

import numpy as np
import pytest
from wrong_inputs import run, sweep

from farfield.api import open_dataset
from farfield.datasets.convert import convert
from farfield.datasets.folder import write_boxes
from farfield.datasets.memory import CloudFiles
from farfield.errors import DatasetError
from farfield.files.atomic import readable, write_text
from farfield.files.boxes_csv import read_boxes_csv
from farfield.frame import Boxes

DETECTOR = "pointpillars-cirrus-sim"


def odd(folder: Path, name: bytes) -> Path:
    return folder / os.fsdecode(name)


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """Three sweeps with boxes, in a folder and of names of which some are Latin-1."""
    root = odd(tmp_path, b"stra\xdfe")
    root.mkdir()
    box = Boxes(
        centre_m=np.array([[11.0, 2, -0.75]]),
        size_m=np.array([[4.4, 1.9, 1.6]]),
        yaw_rad=np.zeros(1),
        label=["vehicle"],
    )
    for number, stem in enumerate((b"0000", b"\xff0001", b"caf\xe9")):
        np.save(odd(root, stem + b".npy"), sweep(number))
        write_boxes(odd(root, stem + b".json"), box)
    return root


def test_names_are_shown_with_their_bytes_and_boxes_stay_beside_their_clouds(data: Path) -> None:
    opened = open_dataset(data)
    assert opened.keys == tuple(("stra\\xdfe", name) for name in ("0000", "caf\\xe9", "\\xff0001"))
    assert all(frame.boxes is not None and len(frame.boxes) == 1 for frame in opened)
    assert len(opened.fingerprint()) == 64
    assert CloudFiles(sorted(data.glob("*.npy"))).frame_ids == ("0000", "caf\\xe9", "\\xff0001")


@pytest.mark.parametrize(
    "words",
    [
        "doctor DATA --workers 1",
        "doctor DATA --workers 1 --json OUT/report.json",
        "stats DATA --workers 1 --out OUT",
        "show DATA --frame 1 --out OUT/a.png",
        "view DATA --html OUT/a.html --frame 1",
        "convert DATA OUT --to kitti --workers 1",
        "convert DATA OUT --to cirrus --workers 2",
        "convert DATA OUT/labels.csv --to boxes-csv",
        "convert DATA OUT --to openlabel --workers 1",
        "convert DATA OUT --to sustechpoints --workers 1",
        "convert DATA OUT --to cvat --workers 1",
        "odometry DATA --out OUT --workers 1 --no-backward",
        "score OUTSIDE DATA --replicates 0 --json OUT/scores.json",
    ],
)
def test_a_verb_does_its_work(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: str) -> None:
    outside, out = tmp_path / "boxes.csv", odd(tmp_path, b"\xf6ut")
    status, _ = run(capsys, "convert", data, outside, "--to", "boxes-csv")
    assert status == 0
    outside.write_text(outside.read_text().replace(",\n", ",0.9\n"))
    command = words.replace("OUTSIDE", str(outside)).replace("DATA", str(data)).replace("OUT", str(out)).split()
    status, text = run(capsys, *command)
    assert status == 0, text
    assert "Error" not in text, text


@pytest.mark.slow
def test_a_detector_s_boxes_and_scores_are_written(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "boxes.csv"
    status, text = run(capsys, "predict", DETECTOR, data, "--out", out, "--score-threshold", "0.01")
    assert status == 0, text
    assert {*read_boxes_csv(out).frame.tolist()} <= {"0000", "caf\\xe9", "\\xff0001"}
    status, text = run(capsys, "predict", DETECTOR, *sorted(data.glob("*.npy")), "--out", tmp_path / "files.csv")
    assert status == 0, text
    status, text = run(capsys, "predict", DETECTOR, data, "--out", tmp_path / "kitti", "--format", "kitti")
    assert status == 0, text
    assert (tmp_path / "kitti" / "caf\\xe9.txt").is_file()
    status, text = run(capsys, "evaluate", DETECTOR, data, "--out", odd(tmp_path, b"\xf6ut"), "--replicates", "0")
    assert "Traceback" not in text, text
    assert (odd(tmp_path, b"\xf6ut") / "report.html").is_file(), text


def test_a_reader_that_cannot_take_them_says_so_before_the_work(data: Path, tmp_path: Path) -> None:
    convert(open_dataset(data), tmp_path / "scenes", to="sustechpoints")
    (scene,) = (tmp_path / "scenes").glob("stra*")
    scene.rename(odd(tmp_path / "scenes", b"caf\xe9"))
    with pytest.raises(DatasetError, match=r"expected names in UTF-8, got caf\\xe9. Rename the file or folder"):
        open_dataset(tmp_path / "scenes")


def test_a_text_holds_the_bytes_of_a_name(tmp_path: Path) -> None:
    write_text(tmp_path / "a.html", os.fsdecode(b"caf\xe9 gr\xc3\xbcn"))
    assert (tmp_path / "a.html").read_text("utf-8") == "caf\\xe9 grün"
    assert readable("grün") == "grün"

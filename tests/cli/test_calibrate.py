"""``farfield calibrate``: the examples of its help parse; wrong use is said in words."""

import inspect
import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from drive import frame
from street import write_street

from farfield import cli
from farfield.calibration.camera_pairs import read_pairs
from farfield.cli import calibrate
from farfield.datasets.kradar.writer import KRadarWriter
from farfield.errors import FileFormatError


def examples() -> list[str]:
    lines = (inspect.getdoc(calibrate.run) or "").splitlines()
    return [
        line.strip().removeprefix("farfield calibrate ") for line in lines if line.startswith("  farfield calibrate")
    ]


@pytest.mark.parametrize("example", examples())
def test_examples_of_the_help_run(
    example: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    places = ("K-Radar", "kitti", "Cirrus_dataset1", "PICTURES")
    words = [str(tmp_path) if word in places else word for word in shlex.split(example)]
    if "--draw" in words:
        pytest.importorskip("cv2")
        assert cli.main(["calibrate", *words]) == 0
        assert (tmp_path / "board.png").stat().st_size > 1000
        return
    assert cli.main(["calibrate", *words]) == 1  # an empty folder: arguments are understood, no data set is found
    assert "farfield calibrate" in capsys.readouterr().err


def test_there_are_examples_of_each_kind() -> None:
    assert {line.split()[0] for line in examples()} == {"radar-lidar", "lidar-camera", "lidar-lidar", "board"}


def test_what_is_missing_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    writer = KRadarWriter(tmp_path / "set", columns=512)
    writer.write(frame(1))
    writer.finish()
    where = str(tmp_path / "set")
    out = ["--out", str(tmp_path / "out")]
    assert cli.main(["calibrate", "lidar-camera", where, "--camera", "nose", *out]) == 1
    assert "expected one of cam-front" in capsys.readouterr().err
    assert cli.main(["calibrate", "radar-lidar", where, "--sequence", "9", *out]) == 1
    assert "expected one of 1" in capsys.readouterr().err
    assert cli.main(["calibrate", "radar-lidar", where, "--frames", "0", *out]) == 1
    assert "expected one or more" in capsys.readouterr().err


def test_a_camera_is_calibrated_and_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    writer = KRadarWriter(tmp_path / "set", columns=512)
    for number in (1, 2):
        writer.write(frame(number))
    writer.finish()
    save = tmp_path / "mine.json"
    words = ["lidar-camera", str(tmp_path / "set"), "--out", str(tmp_path / "out"), "--save", str(save)]
    assert cli.main(["calibrate", *words, "--json", "-"]) == 0
    captured = capsys.readouterr()
    assert json.loads(captured.out)["kind"] == "lidar-camera"  # and nothing else
    assert "wrote" in captured.err
    assert cli.main(["calibrate", *words]) == 0
    result = json.loads((tmp_path / "out" / "calibration.json").read_text())
    assert len(result["frames"]) == 2
    assert result["notes"]  # noise has no edges: something is not observed
    assert sum(result["residual_after"]["histogram"]["counts"]) <= result["residual_after"]["edges"]
    assert (tmp_path / "out" / "before-after.png").stat().st_size > 100
    assert "cam-front" in json.loads(save.read_text())["cameras"]
    text = capsys.readouterr().out
    assert "wrote" in text
    assert re.search(r"parameter +value +change +sigma +verdict", text)
    assert "residual: median" in text
    assert re.search(r"^(keep|replace): ", text, re.MULTILINE)
    assert "{" not in text


def test_pairs_are_read_and_other_tables_refused(tmp_path: Path) -> None:
    path = tmp_path / "picks.csv"
    path.write_text("x_m,y_m,z_m,u_px,v_px\n10,1,0.5,300,200\n12,-1,0,500,210\n")
    points, pixels = read_pairs(path)
    np.testing.assert_allclose(points[1], [12, -1, 0])
    np.testing.assert_allclose(pixels[0], [300, 200])
    path.write_text("x,y\n1,2\n")
    with pytest.raises(FileFormatError, match="line 1"):
        read_pairs(path)


@pytest.mark.parametrize(
    "words", [["lidar-lidar"], ["board"], ["radar-lidar", "--save", "x.txt"], ["lidar-camera", "--save", "x.json"]]
)
def test_the_page_takes_two_kinds_and_saves_by_itself(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["calibrate", words[0], str(tmp_path), "--page", *words[1:]]) == 1
    assert "expected radar-lidar or lidar-camera, without --save" in capsys.readouterr().err


def test_the_page_of_a_data_set_without_a_radar_ends_with_words(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("starlette")
    write_street(tmp_path, np.random.default_rng(0), frames=1)
    words = ["radar-lidar", str(tmp_path / "Cirrus_dataset1"), "--page", "--no-browser", "--port", "0"]
    assert cli.main(["calibrate", *words]) == 1
    assert "expected a K-Radar" in capsys.readouterr().err

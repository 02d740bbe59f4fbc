"""A flag that an error advises exists in every verb that opens data, and does there what the error says."""

from pathlib import Path

import numpy as np
import pytest
from trees import write_kitti

from farfield.cli import main
from farfield.datasets import open_dataset

UNIT = "R0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: 1 0 0 0 0 1 0 0 0 0 1 0\nP2: 700 0 600 0 0 700 180 0 0 0 1 0\n"
ROW = "20,2,-1,4.4,1.8,1.5,0.3"


@pytest.fixture
def lidar_axes(tmp_path: Path) -> Path:
    """KITTI's folders with a unit calibration and a label in the LiDAR's axes."""
    root = tmp_path / "unit"
    write_kitti(root)
    (root / "training" / "calib" / "000007.txt").write_text(UNIT)
    (root / "training" / "label_2" / "000007.txt").write_text("Car 0 0 0 10 10 50 50 1.5 1.8 4.4 20 2 -1 0.3\n")
    return root


@pytest.fixture
def predictions(tmp_path: Path, lidar_axes: Path) -> Path:
    sequence, frame = open_dataset(lidar_axes, label_axes="lidar").keys[0]
    path = tmp_path / "p.csv"
    path.write_text(f"sequence,frame,label,x,y,z,l,w,h,yaw_rad,score\n{sequence},{frame},vehicle,{ROW},0.9\n")
    return path


def test_score_reads_a_data_set_as_the_flag_says(
    lidar_axes: Path, predictions: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["score", str(predictions), str(lidar_axes), "--replicates", "0"]
    assert main(words) == 1
    assert "--label-axes lidar" in capsys.readouterr().err
    assert main([*words, "--label-axes", "lidar"]) == 0
    assert "1.0000" in capsys.readouterr().out


@pytest.mark.parametrize("format", ["boxes-csv", "kitti"])
def test_kittis_text_is_scored_on_labels_in_other_axes_and_under_other_names(
    tmp_path: Path, lidar_axes: Path, format: str
) -> None:
    from farfield.datasets.result_files import ResultWriter

    label = lidar_axes / "training" / "label_2" / "000007.txt"
    label.write_text(label.read_text().replace("Car", "Auto"))
    (tmp_path / "classes.yaml").write_text("classes: {Auto: vehicle}\n")
    data = open_dataset(lidar_axes, label_axes="lidar", mapping=tmp_path / "classes.yaml")
    boxes = data[0].boxes.replace(score=np.ones(1))
    out = tmp_path / ("r.csv" if format == "boxes-csv" else "r")
    ResultWriter(format, data, data.keys).write(out, [(data.keys[0], boxes)])
    words = ["score", str(out), str(lidar_axes), "--format", format, "--replicates", "0", "--label-axes", "lidar"]
    name = "Car" if format == "kitti" else "vehicle"
    assert main([*words, "--mapping", str(tmp_path / "classes.yaml"), "--label", name]) == 0


def test_a_flag_without_data_to_read_is_refused(
    tmp_path: Path, predictions: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["track", str(predictions), "--out", str(tmp_path / "t.csv"), "--label-axes", "lidar"]) == 1
    assert "--label-axes: expected --data" in capsys.readouterr().err
    assert main(["report", str(tmp_path), "--columns", "5"]) == 1
    assert "--columns: expected --film" in capsys.readouterr().err
    assert main(["score", str(predictions), str(predictions), "--label-axes", "lidar"]) == 1
    assert "label_axes: expected a data set's folder" in capsys.readouterr().err


def test_compare_reads_each_data_set_with_the_flags_that_it_knows(
    tmp_path: Path, lidar_axes: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = tmp_path / "own"
    own.mkdir()
    np.save(own / "a.npy", np.ones((5, 4), np.float32))
    (own / "labels.csv").write_text(f"frame,label,x,y,z,l,w,h,yaw_rad\na,Car,{ROW}\n")
    words = ["compare", str(lidar_axes), str(own), "--out", str(tmp_path / "c")]
    assert main([*words, "--label-axes", "lidar"]) == 0
    capsys.readouterr()
    assert main([*words, "--tracklets", "cvat"]) == 1
    assert "'tracklets'" in capsys.readouterr().err


def test_compare_takes_the_flag_of_one_side_before_that_of_both(tmp_path: Path) -> None:
    rows = np.column_stack([np.tile([[5.0, 1, 0]], (64, 1)), np.linspace(0, 200, 64), np.arange(64)]).astype("<f4")
    folders = [tmp_path / name for name in "ab"]
    for folder in folders:
        folder.mkdir()
        rows.tofile(folder / "0.bin")
    words = ["compare", *map(str, folders), "--out", str(tmp_path / "c")]
    assert main([*words, "--columns", "3", "--columns-a", "5", "--columns-b", "5"]) == 0
    assert main([*words, "--columns", "3", "--columns-a", "5"]) == 1  # 320 numbers are no rows of three
    assert main([*words, "--columns", "5", "--intensity-scale", "200", "--intensity-scale-b", "100"]) == 1


def test_what_a_reader_assumed_is_a_note_and_what_it_left_out_a_warning(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from farfield.cli._flags import ReadingFlags

    np.save(tmp_path / "a.npy", np.ones((5, 4), np.float32))
    (tmp_path / "calibration.yaml").write_text("something: else\n")
    ReadingFlags().open(tmp_path)
    assert "warning: " in capsys.readouterr().err
    drive = tmp_path / "drive"
    (drive / "velodyne_points" / "data").mkdir(parents=True)
    np.ones((5, 4), "<f4").tofile(drive / "velodyne_points" / "data" / "0000000000.bin")
    sizes = "<h>1.5</h><w>1.8</w><l>4.4</l><first_frame>0</first_frame>"
    pose = "<item><tx>9</tx><ty>0</ty><tz>-1</tz><rx>0</rx><ry>0</ry><rz>0</rz></item>"
    (drive / "tracklet_labels.xml").write_text(
        f"<b><tracklets><item><objectType>Car</objectType>{sizes}<poses>{pose}</poses></item></tracklets></b>"
    )
    ReadingFlags().open(drive)
    error = capsys.readouterr().err
    assert "note: " in error
    assert "--tracklets" in error


@pytest.fixture
def half_calibrated(tmp_path: Path) -> Path:
    """A folder whose calibration cannot be used."""
    np.save(tmp_path / "a.npy", np.ones((5, 4), np.float32))
    (tmp_path / "calibration.yaml").write_text("something: else\n")
    return tmp_path


@pytest.mark.parametrize("verb", [("view",), ("annotate",), ("calibrate", "lidar-camera")], ids=lambda verb: verb[0])
def test_the_studios_verbs_tell_what_a_reader_left_out(
    half_calibrated: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, verb: tuple[str, ...]
) -> None:
    run = pytest.importorskip("farfield.studio.serving.run")
    monkeypatch.setattr(run, "serve", lambda opening, *_, **__: len(opening()) - 1)
    page = ["--page"] if verb[0] == "calibrate" else []
    assert main([*verb, str(half_calibrated), *page, "--no-browser"]) == 0
    assert "warning: " in capsys.readouterr().err


def test_the_page_shows_what_a_reader_left_out(half_calibrated: Path, tmp_path: Path) -> None:
    pytest.importorskip("starlette")
    out = tmp_path / "page.html"
    assert main(["view", str(half_calibrated), "--html", str(out)]) == 0
    assert "no camera is calibrated" in out.read_text("utf-8")


@pytest.mark.parametrize("verb", ["view", "annotate"])
def test_a_flag_for_the_frames_that_ship_is_refused(capsys: pytest.CaptureFixture[str], verb: str) -> None:
    assert main([verb, "--columns", "5", "--no-browser"]) == 1
    assert "--columns: expected a data set" in capsys.readouterr().err


def test_a_mapping_beside_the_data_that_is_none_is_not_ignored(lidar_axes: Path) -> None:
    from farfield.errors import ConfigError

    (lidar_axes / "mapping.yaml").write_text("class: {Auto: vehicle}\n")
    with pytest.raises(ConfigError, match=r"mapping\.yaml.*classes: \{Auto: vehicle\}"):
        open_dataset(lidar_axes)

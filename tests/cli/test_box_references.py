"""Files of boxes name the coordinates in which they stand, and nothing is scored across two of them in silence."""

import json
from pathlib import Path

import numpy as np
import pytest
from drive import frame as kradar_frame

from farfield.cli import main
from farfield.datasets import open_dataset
from farfield.datasets.convert import box_rows
from farfield.datasets.kradar import KRadarWriter
from farfield.datasets.labels import BoxLabel, CsvLabels
from farfield.datasets.result_files import ResultWriter
from farfield.errors import ConfigError, FileFormatError
from farfield.evaluation import in_coordinates
from farfield.files.boxes_csv import parse_boxes_csv, read_boxes_csv, write_boxes_csv
from farfield.frame import Annotation, Boxes
from farfield.metrics.box_files import read, read_predictions
from farfield.studio.showing.predictions import read_set
from farfield.tracking.writing import write_kitti_tracks, write_nuscenes_tracks, write_tracks_csv

CAR = Boxes(
    centre_m=np.array([[24.0, 1.0, 0.4]]), size_m=np.array([[4.2, 2.0, 1.6]]), yaw_rad=np.zeros(1), label=["vehicle"]
)


@pytest.fixture
def kradar(tmp_path: Path) -> Path:
    writer = KRadarWriter(tmp_path / "data")
    for number in (1, 2, 3):
        writer.write(kradar_frame(number, sequence="1").annotated(Annotation(boxes=CAR)))
    writer.finish()
    return tmp_path / "data"


def converted(kradar: Path, reference: str) -> Path:
    out = kradar.parent / f"{reference}.csv"
    assert main(["convert", str(kradar), str(out), "--to", "boxes-csv", "--reference", reference]) == 0
    return out


def as_found(labels: Path) -> Path:
    """The same boxes with scores, as a perfect detector writes them."""
    rows = read_boxes_csv(labels)
    out = labels.with_name(f"found_{labels.name}")
    lines = labels.read_text().splitlines()
    place = lines[0].split(",").index("score")
    cells = [line.split(",") for line in lines]
    out.write_text(
        "\n".join(",".join([*c[:place], "0.9" if n else "score", *c[place + 1 :]]) for n, c in enumerate(cells))
    )
    assert len(rows) == 3
    return out


def test_convert_names_and_chooses_the_coordinates(kradar: Path) -> None:
    lidar, radar = (read_boxes_csv(converted(kradar, name)) for name in ("os2-64", "radar"))
    assert lidar.reference is not None
    assert radar.reference is not None
    assert (set(lidar.reference), set(radar.reference)) == ({"os2-64"}, {"radar"})
    apart = lidar.centre_m - radar.centre_m
    assert np.linalg.norm(apart[0]) > 1
    np.testing.assert_allclose(apart, np.tile(apart[0], (3, 1)), atol=1e-9)


def test_convert_refuses_coordinates_that_the_data_do_not_know(
    kradar: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["convert", str(kradar), str(kradar.parent / "a.csv"), "--to", "boxes-csv", "--reference", "gaussian"]
    assert main(words) == 1
    assert "os2-64 or radar" in capsys.readouterr().err


def test_boxes_of_other_coordinates_are_not_scored(kradar: Path, capsys: pytest.CaptureFixture[str]) -> None:
    predictions, labels = as_found(converted(kradar, "radar")), converted(kradar, "os2-64")
    assert main(["score", str(predictions), str(labels), "--protocol", "kradar"]) == 1
    said = capsys.readouterr().err
    assert "radar" in said
    assert "os2-64" in said
    assert "--reference" in said


def test_equal_coordinates_are_used_by_the_protocol(kradar: Path) -> None:
    for reference in ("radar", "os2-64"):
        labels = converted(kradar, reference)
        found = read(as_found(labels), labels)
        assert found.reference == reference
        assert not any("coordinates" in note for note in found.notes)
        assert found.score("kradar").settings["boxes_in"] == reference


def test_the_setting_cannot_contradict_the_files(kradar: Path) -> None:
    labels = converted(kradar, "radar")
    with pytest.raises(ConfigError, match="boxes_in"):
        read(as_found(labels), labels).score("kradar", boxes_in="os2-64")


def test_a_side_that_names_none_is_said_and_can_be_told(kradar: Path) -> None:
    labels = converted(kradar, "radar")
    predictions = as_found(labels)
    predictions.write_text(
        predictions.read_text().replace(",reference", "").replace(",radar\n", "\n").removesuffix(",radar")
    )
    found = read(predictions, labels)
    assert any("predictions do not name their coordinates" in note for note in found.notes)
    assert not any("coordinates" in note for note in read(predictions, labels, reference="radar").notes)
    with pytest.raises(ConfigError, match="os2-64"):
        read(predictions, labels, reference="os2-64")


@pytest.mark.parametrize("reference", ["radar", "os2-64"])
def test_a_data_set_is_the_truth_in_the_predictions_coordinates(kradar: Path, reference: str, tmp_path: Path) -> None:
    predictions, out = as_found(converted(kradar, reference)), tmp_path / "scores.json"
    assert main(["score", str(predictions), str(kradar), "--json", str(out), "--replicates", "0"]) == 0
    tree = json.loads(out.read_text())
    assert tree["subject"]["data"] == "data"
    assert tree["dds"]["0"]["dds"] == pytest.approx(1, abs=1e-3)
    words = ["score", str(predictions), str(kradar), "--protocol", "kradar", "--replicates", "0", "--json", str(out)]
    assert main(words) == 0
    assert json.loads(out.read_text())["settings"]["boxes_in"] == reference


def test_one_file_has_one_frame() -> None:
    header = "frame,label,x,y,z,l,w,h,yaw_rad,reference"
    with pytest.raises(FileFormatError, match="reference"):
        parse_boxes_csv(f"{header}\n1,car,1,1,1,1,1,1,0,radar\n1,car,1,1,1,1,1,1,0,lidar\n".encode(), "a.csv")


def test_an_edited_file_keeps_its_coordinates(tmp_path: Path) -> None:
    path, key = tmp_path / "a.csv", ("1", "7")
    write_boxes_csv(path, box_rows([(key, CAR)], reference="radar"))
    labels = CsvLabels(path)
    new = BoxLabel(id="new", label="vehicle", box=(9.0, 0.0, 0.0, 4.0, 2.0, 1.5, 0.0))
    before = labels.parse(path.read_bytes(), path, [key])[key]
    text = labels.render(path.read_bytes(), path, {key: (*before, new)})
    again = parse_boxes_csv(text, path)
    assert again.reference is not None
    assert again.reference.tolist() == ["radar", "radar"]


def test_results_of_every_format_name_their_coordinates(kradar: Path, tmp_path: Path) -> None:
    data = open_dataset(kradar, reference="radar")
    boxes = [(key, CAR.replace(score=np.ones(1), track_id=np.ones(1, dtype=np.int64))) for key in data.keys]
    for format, out in (("boxes-csv", "a.csv"), ("nuscenes", "a.json"), ("kitti", "a")):
        ResultWriter(format, data, data.keys).write(tmp_path / out, boxes)
    assert read_predictions(tmp_path / "a.csv").reference == "radar"
    world = open_dataset(kradar)[0].world_T_frame is not None
    assert read_predictions(tmp_path / "a.json", format="nuscenes").reference == ("world" if world else "radar")
    assert read_predictions(tmp_path / "a", format="kitti").reference == "camera cam-front"
    tracks = read_predictions(tmp_path / "a.csv")
    write_tracks_csv(tmp_path / "t.csv", tracks)
    write_nuscenes_tracks(tmp_path / "t.json", tracks)
    assert read_predictions(tmp_path / "t.csv").reference == "radar"
    assert read_predictions(tmp_path / "t.json", format="nuscenes").reference == "radar"
    named = {("a", str(number)): part for number, (_, part) in enumerate(boxes)}
    write_kitti_tracks(tmp_path / "k", tracks.replaced(named))
    assert "radar" in read_predictions(tmp_path / "k", format="kitti-tracking").reference


def test_a_conversion_to_other_coordinates_is_not_taken_for_the_one_that_is_there(kradar: Path) -> None:
    target = kradar.parent / "labels"
    for reference in ("os2-64", "radar"):
        words = ["convert", str(kradar), str(target), "--to", "boxes-csv", "--reference", reference]
        assert main(words) == 0
        (path,) = target.glob("*.csv")
        assert read_boxes_csv(path).stands_in == reference


def test_openlabel_names_its_coordinates(kradar: Path) -> None:
    target = kradar.parent / "labels"
    assert main(["convert", str(kradar), str(target), "--to", "openlabel", "--reference", "radar"]) == 0
    (path,) = target.rglob("*.json")
    assert list(json.loads(path.read_text())["openlabel"]["coordinate_systems"]) == ["radar"]


def test_shown_and_tracked_boxes_stand_where_the_data_do(kradar: Path, tmp_path: Path) -> None:
    data = open_dataset(kradar)
    assert in_coordinates(data, "radar")[0].reference == "radar"
    assert in_coordinates(data, "") is data
    with pytest.raises(ConfigError, match="os2-64 or radar"):
        in_coordinates(data, "gaussian")
    predictions = as_found(converted(kradar, "radar"))
    with pytest.raises(ConfigError, match="--reference radar"):
        read_set(predictions, data, format="boxes-csv", protocol="dds", number=0)
    assert main(["track", str(predictions), "--data", str(kradar), "--out", str(tmp_path / "tracks.csv")]) == 0
    assert read_boxes_csv(tmp_path / "tracks.csv").stands_in == "radar"

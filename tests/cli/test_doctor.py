import json

import pytest
from street import write_street

from farfield.cli import main


@pytest.fixture
def street_root(tmp_path, rng):
    return write_street(tmp_path, rng)


def swap_sizes(root):
    for path in root.glob("dataset1_annotation/*.json"):
        content = json.loads(path.read_text())
        for label in content["labels"]:
            length, width, height = label["size"]
            label["size"] = [width, length, height]
        path.write_text(json.dumps(content))


def test_a_sound_data_set_exits_0_and_prints_a_table(street_root, capsys):
    assert main(["doctor", str(street_root)]) == 0
    printed = capsys.readouterr().out
    for words in ("3 Gaussian frames", "no uniform folder", "x y z w, decided", "l w h, decided", "Ready for training"):
        assert words in printed


def test_a_fault_exits_1_and_json_names_it(street_root, capsys):
    swap_sizes(street_root)
    assert main(["doctor", str(street_root), "--json", "-"]) == 1
    report = json.loads(capsys.readouterr().out)
    assert report["failed"]
    assert report["facts"]["size_order"] == "wlh"
    assert [f["topic"] for f in report["findings"] if f["severity"] == "fail"] == ["size order"]


def test_a_mapping_mends_it(street_root, tmp_path):
    swap_sizes(street_root)
    (tmp_path / "mapping.yaml").write_text("labels: {size_order: wlh}\n")
    assert main(["doctor", str(street_root), "--mapping", str(tmp_path / "mapping.yaml")]) == 0


def test_no_data_set_exits_1_with_a_message(tmp_path, capsys):
    assert main(["doctor", str(tmp_path)]) == 1
    assert "recognised no data set" in capsys.readouterr().err


def test_what_is_not_there_is_folded_into_one_line(tmp_path, capsys):
    from drive import frame

    from farfield.datasets.kradar import KRadarWriter

    writer = KRadarWriter(tmp_path / "kradar")
    writer.write(frame(1))
    writer.finish()
    assert main(["doctor", str(tmp_path / "kradar")]) in (0, 1)
    printed = capsys.readouterr().out
    table, _, below = printed.partition("not there: ")
    assert "os2-64" in table
    rows = [line for line in table.splitlines() if line.startswith("│")]
    assert not [line for line in rows if "│ none " in line]
    for absent in ("radar tesseract", "cam-rear", "dash video", "IMU"):
        assert absent in " ".join(below.split())
    assert main(["doctor", str(tmp_path / "kradar"), "--json", "-"]) in (0, 1)
    report = json.loads(capsys.readouterr().out)
    assert {f["topic"] for f in report["findings"] if f["absent"]} >= {"radar tesseract", "cam-rear", "IMU"}

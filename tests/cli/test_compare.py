import json

import numpy as np
import pytest
from street import write_street

from farfield.cli import main
from farfield.files.clouds import write_bin


@pytest.fixture
def street_root(tmp_path, rng):
    return write_street(tmp_path / "street", rng, frames=4)


@pytest.fixture
def bare_folder(tmp_path, rng):
    folder = tmp_path / "bare"
    folder.mkdir()
    for number in range(2):
        points = rng.uniform([5, -20, -2], [90, 20, 2], (500, 3)).astype(np.float32)
        write_bin(folder / f"{number}.bin", np.column_stack([points, np.zeros(500)]).astype(np.float32))
    return folder


def test_two_data_sets_end_with_the_reports_path(street_root, bare_folder, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["compare", str(street_root), str(bare_folder), "--out", str(out), "--names", "street,bare"]) == 0
    printed = capsys.readouterr().out
    assert printed.splitlines()[-1] == f"report: {(out / 'comparison.html').resolve()}"
    assert "note: bare: no annotated frame" in printed
    assert "points in vehicles: slope in log-log" in printed
    first, second = json.loads((out / "comparison.json").read_text())["sides"]
    assert (first["frames"], second["frames"]) == (4, 2)
    assert first["boxes"]["count"] == 4 * 30
    assert first["simulated"] is None


def test_frames_are_limited_and_simulated_data_is_marked(street_root, tmp_path, capsys):
    settings = {"preset": {"lidar": {"lines": 64, "columns": 938}}}
    (street_root.parent / "simulation.json").write_text(json.dumps(settings))
    out = tmp_path / "out"
    assert main(["compare", str(street_root), str(street_root), "--frames", "2", "--out", str(out)]) == 0
    first, second = json.loads((out / "comparison.json").read_text())["sides"]
    assert first["frames"] == 2
    assert first["simulated"] is True
    assert first["name"] != second["name"]
    gaussian = first["clouds"]["gaussian"]
    assert gaussian["return_rate"] == pytest.approx(gaussian["points_per_frame"] / (64 * 938))
    assert "(simulated)" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("extra", "words"),
    [
        (["--frames", "-1"], "0 (all) or more"),
        (["--names", "one"], "two names"),
        (["--vehicle-labels", ","], "at least one class"),
    ],
)
def test_wrong_settings_say_what_was_expected(street_root, extra, words, capsys):
    assert main(["compare", str(street_root), str(street_root), *extra]) == 1
    assert words in capsys.readouterr().err


def test_a_folder_without_data_is_named(street_root, tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    assert main(["compare", str(street_root), str(tmp_path / "empty")]) == 1
    assert "recognised no data set" in capsys.readouterr().err

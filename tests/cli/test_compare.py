import json

import numpy as np
import pytest
from street import write_street

from farfield.cli import main
from farfield.errors import DatasetError
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
        (["--names", "one,two", "--floor", "."], "three names"),
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


def write_hedge(folder, rng, depth_m):
    """Two sweeps of a road along a hedge."""
    folder.mkdir()
    for number in range(2):
        road = rng.uniform([5, -15, -1.8], [35, 15, -1.78], (6000, 3))
        hedge = rng.uniform([8, 5, -1.5], [30, 5, 0.5], (4000, 3)) + rng.exponential(depth_m, (4000, 1)) * [0, 1, 0]
        points = np.concatenate([road, hedge])
        write_bin(folder / f"{number}.bin", np.column_stack([points, np.zeros(len(points))]).astype(np.float32))
    return folder


def test_a_third_set_says_how_far_real_ones_are_told_apart(tmp_path, rng, capsys):
    flat, deep, third = (
        write_hedge(tmp_path / name, rng, depth) for name, depth in (("flat", 0.01), ("deep", 0.2), ("third", 0.2))
    )
    out = tmp_path / "out"
    flags = ["--floor", str(third), "--out", str(out), "--workers", "1"]
    assert main(["compare", str(flat), str(deep), *flags]) == 0
    printed = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "floor, deep and third: told apart" in printed
    apart = json.loads((out / "comparison.json").read_text())["told_apart"]
    assert apart["floor"]["name"] == "third"
    first, floor = (next(iter(results.values())) for results in (apart["clouds"], apart["floor"]["clouds"]))
    assert first["by_thickness"] > 0.95 > 0.6 > floor["by_thickness"]
    assert first["by_classifier"] > 0.95 > 0.6 > floor["by_classifier"]
    assert len(first["features"]) == len(first["lost_without"]) == 7
    page = (out / "comparison.html").read_text()
    assert "What tells the roadsides apart" in page
    assert "by a classifier of seven features, on sweeps of one sequence" in page
    assert "tried on sweeps of one sequence that it did not learn from" in page


def test_the_floor_is_opened_before_anything_is_counted(street_root, bare_folder, tmp_path, capsys, monkeypatch):
    """A flag that only the floor's reader knows counts for it, and a mistyped folder fails at once."""
    counted = []

    def count(data, name, *others, **options):
        counted.append(name)
        raise DatasetError(f"{name}: enough")

    monkeypatch.setattr("farfield.inspection.comparison.count_dataset", count)
    street = str(street_root)
    assert main(["compare", street, street, "--floor", str(tmp_path / "absent"), "--out", str(tmp_path / "out")]) == 1
    assert "absent" in capsys.readouterr().err
    assert counted == []
    flags = ["--floor", str(bare_folder), "--columns", "4", "--names", "one,two,bare", "--out", str(tmp_path / "out")]
    assert main(["compare", street, street, *flags]) == 1
    assert "one: enough" in capsys.readouterr().err

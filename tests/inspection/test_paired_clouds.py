"""Clouds of two data sets stand in one row though their sensors are called otherwise."""

import numpy as np
import pytest
from street import write_street

from farfield.cli import main
from farfield.errors import ConfigError
from farfield.files.clouds import write_bin
from farfield.inspection.comparison import ComparedDataset, pair_clouds
from farfield.pages.dataset_pages import table_lines


@pytest.fixture
def roots(tmp_path, rng):
    street, bare = write_street(tmp_path / "street", rng, frames=2), tmp_path / "bare"
    bare.mkdir()
    points = rng.uniform([5, -20, -2], [90, 20, 2], (500, 3)).astype(np.float32)
    write_bin(bare / "0.bin", np.column_stack([points, np.zeros(500)]).astype(np.float32))
    return [str(street), str(bare)]


def side(*clouds):
    summary = {"clouds": {name: {"points_per_frame": len(name)} for name in clouds}}
    return ComparedDataset("x", summary, {f"points/{name}": {"range_m": np.ones(1)} for name in clouds})


def test_the_first_stands_beside_the_first_where_no_name_is_shared():
    (one, two), pairs = pair_clouds([side("gaussian", "uniform"), side("lidar")])
    assert pairs == [("gaussian", "lidar")]
    assert list(one.summary["clouds"]) == ["gaussian : lidar", "uniform"]
    assert list(two.summary["clouds"]) == ["gaussian : lidar"]
    assert set(one.arrays) == {"points/gaussian : lidar", "points/uniform"}


def test_shared_names_stay_as_they_are():
    sides = [side("os2-64", "radar"), side("gaussian", "os2-64")]
    found, pairs = pair_clouds(sides)
    assert pairs == [("os2-64", "os2-64")]
    assert [list(each.summary["clouds"]) for each in found] == [["os2-64", "radar"], ["gaussian", "os2-64"]]


def test_chosen_pairs_come_first_and_alone():
    (one, two), pairs = pair_clouds([side("gaussian", "uniform"), side("lidar", "uniform")], {"uniform": "lidar"})
    assert pairs == [("uniform", "lidar")]
    assert list(one.summary["clouds"]) == ["uniform : lidar"]
    assert list(two.summary["clouds"]) == ["uniform : lidar"]
    assert two.summary["clouds"]["uniform : lidar"]["points_per_frame"] == 5
    with pytest.raises(ConfigError, match=r"x has no cloud 'nothing'.*lidar, uniform"):
        pair_clouds([side("gaussian"), side("lidar", "uniform")], {"gaussian": "nothing"})


def test_sides_without_clouds_stay():
    found, pairs = pair_clouds([side(), side("lidar")])
    assert pairs == []
    assert list(found[1].summary["clouds"]) == ["lidar"]


@pytest.mark.parametrize("flags", [[], ["--clouds", "gaussian:lidar"]])
def test_compare_sets_two_lidars_side_by_side(roots, tmp_path, capsys, flags):
    assert main(["compare", *roots, "--out", str(tmp_path / "out"), "--workers", "1", *flags]) == 0
    printed = capsys.readouterr().out
    pair = "gaussian : lidar"
    assert f"clouds side by side: {pair}" in printed
    assert ("--clouds A:B" in printed) == (not flags), "a guess is said, and how to overrule it"
    row = next(line for line in printed.splitlines() if "points a frame" in line)
    assert "–" not in row, "both sides have a figure"
    page = (tmp_path / "out" / "comparison.html").read_text()
    assert pair in page


def test_a_wrong_pair_is_named(roots, tmp_path, capsys):
    assert main(["compare", *roots, "--out", str(tmp_path / "out"), "--clouds", "gaussian"]) == 1
    assert "A:B" in capsys.readouterr().err


def test_the_published_figure_stays_beside_a_renamed_gaussian_cloud(roots, tmp_path):
    limits = {str(limit): 0.5 for limit in (0.1, 0.25, 0.5, 1.0)}
    cloud = {"far_m": 8.0, "focus_deg": -2.0, "far_share_of_horizon": limits}
    from farfield.vocabulary.published_tables import SHARES_NEAR_HORIZON

    cloud["far_share_of_horizon"] = dict.fromkeys(SHARES_NEAR_HORIZON, 0.5)
    sides, _ = pair_clouds(
        [ComparedDataset("a", {"clouds": {"gaussian": cloud}}), ComparedDataset("b", {"clouds": {"lidar": cloud}})]
    )
    lines = [line for line in table_lines(sides) if "elevation" in line.what and line.published]
    assert [line.published for line in lines] == list(SHARES_NEAR_HORIZON.values())

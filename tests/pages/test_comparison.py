"""The comparison page: what it shows, what it leaves out, and that it is one sound file."""

import json
import re

import numpy as np
import pytest

from farfield.figures import comparison_plots as plots
from farfield.inspection.comparison import ComparedDataset
from farfield.pages.dataset_pages import render_comparison, sensor_pictures, table_lines, write_comparison

EDGES_M = [0.0, 20.0, 40.0, 70.0]


def class_of(count):
    sizes = {axis: {"mean": 2.0, "std": 0.1} for axis in ("length_m", "width_m", "height_m")}
    return {"count": count, "share": count / 10, **sizes}


def cloud_summary(far_share):
    return {
        "frames": 3,
        "points_per_frame": 12345.0,
        "return_rate": 0.8,
        "longest_m": 231.0,
        "focus_deg": -2.0,
        "far_m": 8.0,
        "share_of_horizon": {"2": 0.1, "5": 0.2, "10": 0.3},
        "share_of_focus": {"2": 0.1, "5": 0.2, "10": 0.3},
        "far_share_of_horizon": {"2": far_share, "5": 0.6, "10": 0.9},
        "far_share_of_focus": {"2": 0.3, "5": 0.6, "10": 0.9},
        "elevation": {"edges_deg": np.linspace(-30, 30, 241).tolist(), "count": [1] * 240},
        "range": {"edges_m": [0.0, 5.0, 10.0], "count": [3, 4]},
        "points_in_vehicles": {
            "edges_m": [10.0, 20.0, 40.0, 80.0],
            "boxes": [9, 9, 0],
            "median": [400.0, 100.0, None],
            "share_empty": [0.0, 0.0, None],
            "slope": -2.0,
            "level": 36.0,
            "fitted_m": [10.0, 40.0],
        },
        "survival": {
            "edges_m": EDGES_M,
            "weather": {
                "normal": {
                    "boxes": [1, 1, 1],
                    "mean_points": [9.0, 4.0, 1.0],
                    "ratio": [1.0, 1.0, 1.0],
                    "overall": 1.0,
                },
                "heavy_snow": {
                    "boxes": [1, 1, 0],
                    "mean_points": [3.0, 1.0, None],
                    "ratio": [0.33, 0.25, None],
                    "overall": 0.29,
                },
            },
        },
    }


def full_side(rng, name="<sim>", simulated=True):
    quantiles = {"5": 0.4, "25": 0.8, "50": 1.1, "75": 2.1, "95": 4.4}
    radar = {"frames": 2, "floor_db": 109.2, "floor_std_db": 0.28, "leakage_db": 44.0, "row_quantiles_db": quantiles}
    summary = {
        "frames": 3,
        "sequences": 1,
        "simulated": simulated,
        "box_protocol": "visible",
        "conditions": {"weather": {"normal": 0.5, "heavy_snow": 0.5}, "road": {"urban": 1.0}, "time": {"day": 1.0}},
        "clouds": {"gaussian": cloud_summary(0.26), "uniform": cloud_summary(0.15)},
        "pattern_ratio_beyond_50_m": 2.3,
        "boxes": {
            "annotated_frames": 3,
            "count": 10,
            "per_frame": 3.3,
            "most_in_a_frame": 5,
            "classes": {"vehicle": class_of(9), "pedestrian": class_of(1)},
            "vehicle_distance": {"edges_m": [0.0, 10.0, 20.0], "count": [5, 4]},
        },
        "radar": radar,
        "missing": [],
    }
    points = {"range_m": rng.uniform(8, 100, 30), "count": rng.integers(0, 300, 30)}
    maps = {
        "map_db": (109 + 0.3 * rng.standard_normal((256, 107))).astype(np.float32),
        "profile_db": np.zeros(256),
        "range_m": np.arange(256) * 0.46289,
        "azimuth_deg": np.arange(-53.0, 54.0),
    }
    return ComparedDataset(
        name, summary, {"points/gaussian": points, "points/uniform": points, "radar": maps}, "data/sim"
    )


def bare_side():
    """What a folder of clouds without labels gives."""
    cloud = cloud_summary(0.31)
    nothing = {"edges_m": [10.0, 20.0], "boxes": [0], "median": [None], "share_empty": [None]}
    cloud["points_in_vehicles"] = {**nothing, "slope": None, "level": None, "fitted_m": None}
    cloud["survival"] = {"edges_m": EDGES_M, "weather": {}}
    cloud["return_rate"] = None
    summary = {
        "frames": 2,
        "sequences": 1,
        "simulated": None,
        "box_protocol": None,
        "conditions": {"weather": {}, "road": {}, "time": {}},
        "clouds": {"gaussian": cloud},
        "pattern_ratio_beyond_50_m": None,
        "boxes": {
            "annotated_frames": 0,
            "count": 0,
            "per_frame": 0.0,
            "most_in_a_frame": 0,
            "classes": {},
            "vehicle_distance": {"edges_m": [0.0, 10.0], "count": [0]},
        },
        "radar": None,
        "missing": ["no annotated frame: no points in boxes"],
    }
    return ComparedDataset("real & bare", summary, {}, "data/real")


@pytest.fixture(scope="module")
def sides():
    return full_side(np.random.default_rng(1)), bare_side()


@pytest.fixture(scope="module")
def page(sides):
    return render_comparison(sides, title="A & B")


def test_table_holds_both_figures_and_a_dash_where_one_is_missing(sides):
    found = {(line.topic, line.what): line for line in table_lines(sides)}
    share = found["LiDAR, gaussian", "|elevation| < 2°, beyond 8 m"]
    assert share.values == ("0.260", "0.310")
    assert share.published == "0.31"
    assert found["LiDAR, uniform", "|elevation| < 2°, beyond 8 m"].published == ""
    assert found["LiDAR, gaussian", "share of shots that return"].values == ("0.800", "–")
    assert found["LiDAR, gaussian", "points in vehicles: slope in log-log"].values == ("-2.00", "–")
    assert found["LiDAR, gaussian", "points in vehicles, heavy_snow over normal"].values == ("0.29", "–")
    assert found["radar", "noise floor (dB)"].values == ("109.20", "–")
    assert found["radar", "strongest object's row, 95 % quantile (dB)"].published == "4.2"
    assert found["data", "simulated"].values == ("yes", "not said")


def test_lines_that_nobody_has_are_left_out():
    assert not [line for line in table_lines((bare_side(), bare_side())) if line.topic == "radar"]


def test_every_figure_is_drawn_where_there_is_data_and_none_where_not(page):
    assert page.count("data:image/svg+xml;base64,") == 9  # of both sides
    assert [item.heading for item in sensor_pictures((bare_side(), bare_side()))] == [
        "Where the returns lie in elevation",
        "Range of the returns",
    ]


def test_page_is_one_file_that_loads_nothing(page):
    sources = re.findall(r'(?:src|href)="([^#"][^"]*)"', page)
    assert len(sources) == 9
    assert all(source.startswith("data:image/svg+xml;base64,") for source in sources)
    assert "<script" not in page
    assert not re.search(r"url\(|@import", page)


def test_page_names_what_is_simulated_and_what_is_missing(page):
    assert "&lt;sim&gt; (simulated)" in page
    assert "Simulated data" in page
    assert "real &amp; bare: no annotated frame: no points in boxes" in page
    assert "real &amp; bare (simulated)" not in page


def test_real_sides_carry_no_word_of_simulation(rng):
    real = full_side(rng, "one", False), full_side(rng, "two", False)
    assert "Simulated data" not in render_comparison(real, title="t")


def test_overlay_has_a_line_for_every_cloud_of_every_side(sides):
    figure = plots.points_in_vehicles(sides)
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert titles[0].startswith("<sim> (simulated), gaussian\n30 boxes; slope -2.00, 36 at 50 m")
    assert titles[2].startswith("Medians and lines together")
    assert len({line.get_linestyle() for line in figure.axes[2].lines if line.get_label()[0] == "<"}) == 2


def test_no_panel_of_lines_where_no_cloud_has_one(rng):
    few = full_side(rng, "few", False)
    for name, cloud in few.summary["clouds"].items():
        found = cloud.get("points_in_vehicles")
        if found:
            found |= {"slope": None, "boxes": [0] * len(found["boxes"])}
            assert len(few.arrays[f"points/{name}"]["range_m"])
    figure = plots.points_in_vehicles((few, few))
    shown = [axes.get_title(loc="left") for axes in figure.axes if axes.get_visible()]
    assert shown
    assert not [title for title in shown if title.startswith("Medians")]
    assert not figure.legends


def test_written_files_read_back(sides, tmp_path):
    path = write_comparison(tmp_path / "new" / "folder", sides, title="A & B")
    assert path.name == "comparison.html"
    tree = json.loads((path.parent / "comparison.json").read_text("utf-8"))
    assert tree["sides"][0]["clouds"]["gaussian"]["far_share_of_horizon"]["2"] == 0.26
    assert [side["name"] for side in tree["sides"]] == ["<sim>", "real & bare"]


def test_the_effective_range_and_the_time_it_leaves():
    """Cirrus, introduction: at 75 mph 250, 120 and 70 m leave 7.5, 3.5 and 2 s."""
    from farfield.figures.comparison_plots import effective_range_m, reaction_s

    assert [round(reaction_s(each) * 2) / 2 for each in (250.0, 120.0, 70.0)] == [7.5, 3.5, 2.0]
    cloud = {"range": {"count": [990, 9, 0, 1], "edges_m": [0.0, 50.0, 100.0, 200.0, 400.0]}}
    assert effective_range_m(cloud) == pytest.approx(100.0, abs=0.01)
    assert effective_range_m({"range": {"count": [0, 0], "edges_m": [0.0, 5.0, 10.0]}}) is None


def test_sweeps_stand_side_by_side(rng, tmp_path):
    import farfield as ff
    from farfield.figures.comparison_plots import from_above
    from farfield.inspection.comparison import count_dataset

    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        np.save(tmp_path / name / "0.npy", rng.uniform([1, -20, -2, 0], [60, 20, 1, 1], (500, 4)).astype(np.float32))
    sides = [count_dataset(ff.open_dataset(tmp_path / name), name) for name in ("a", "b")]
    figure = from_above(sides)
    first = figure.axes[0]
    assert first.get_xlabel() == "y (m)"
    assert first.get_xlim()[0] > first.get_xlim()[1], "y points left, as from above"
    shown = [axes for axes in figure.axes if axes.collections]
    assert [len(axes.collections[0].get_offsets()) for axes in shown] == [500, 500]
    assert all("at 75 mph" in axes.get_title(loc="left") for axes in shown)
    assert [line.what for line in table_lines(sides) if "mph" in line.what] == ["time that leaves at 75 mph (s)"]


def test_short_logarithmic_axes_have_plain_numbers():
    from farfield.figures.style import figure_bytes, new_figure

    figure = new_figure(4.0, 2.0)
    axes = figure.subplots()
    axes.plot([1, 2], [2.0, 7.0])
    axes.set_yscale("log")
    figure_bytes(figure, "png")
    labels = [text.get_text() for text in axes.get_yticklabels(minor=True)]
    assert any(label == "6" for label in labels)
    assert not any("times" in label for label in labels)


def test_empty_bins_of_range_keep_their_place():
    from farfield.inspection.statistics.census import Census, range_names

    census = Census(
        sequence=np.array(["a"]),
        conditions={},
        objects=np.array([2]),
        frame=np.array([0, 0]),
        name=np.array(["car", "car"]),
        range_m=np.array([10.0, 70.0]),
        size_m=np.ones((2, 3)),
        visibility=np.array(["unknown", "unknown"]),
    )
    assert census.names("range") == range_names()[:4]

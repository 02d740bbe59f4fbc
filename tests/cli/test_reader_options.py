"""Options of readers on the command line, and words that users have for formats."""

from pathlib import Path

import pytest

from farfield.cli import main
from farfield.datasets import open_dataset
from farfield.datasets.kitti.object import Kitti
from farfield.datasets.nuscenes.reader import NuScenesData
from farfield.datasets.reader_options import OptionText, typed_options
from farfield.errors import ConfigError
from farfield.inspection.formats import format_catalogue
from tests.datasets.generators.nuscenes_trees import write_nuscenes


@pytest.mark.parametrize(
    ("reader", "name", "text", "value"),
    [
        (NuScenesData, "whole_scenes", "true", True),
        (NuScenesData, "sweeps", "5", 5),
        (NuScenesData, "classes", "original", "original"),
        (NuScenesData, "intensity_scale", "none", None),
        (NuScenesData, "intensity_scale", "255", 255.0),
        (Kitti, "bin_columns", "4", 4),
        (NuScenesData, "rotate_deg", "180", 180.0),
        (NuScenesData, "reference", "radar", "radar"),
    ],
)
def test_a_text_becomes_what_the_signature_says(reader, name, text, value):
    typed = typed_options(reader, {name: OptionText(text)})[name]
    assert typed == value
    assert type(typed) is type(value)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("whole_scenes", "yes", "true or false"),
        ("sweeps", "2.5", "a whole number"),
        ("classes", "mine", "cirrus or original or detection"),
        ("intensity_scale", "much", "a number"),
    ],
)
def test_a_text_of_another_type_is_refused_by_name(name, text, words):
    with pytest.raises(ConfigError, match=f"--reader {name}: expected {words}"):
        typed_options(NuScenesData, {name: OptionText(text)})


def test_a_verb_passes_options_on_and_refuses_strange_ones(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_nuscenes(tmp_path / "set", samples=2)
    words = ["show", str(tmp_path / "set"), "--out", str(tmp_path / "a.png"), "--frame", "1"]
    assert main([*words, "--reader", "sweeps=2", "--reader", "whole-scenes=true"]) == 0
    assert (tmp_path / "a.png").exists()
    for option, sentence in (
        ("swoops=2", "does not know the option 'swoops'"),
        ("sweeps=two", "--reader sweeps: expected a whole number"),
        ("sweeps", "expected each NAME=VALUE once"),
    ):
        assert main([*words, "--reader", option]) == 1
        assert sentence in capsys.readouterr().err
    assert main([*words, "--size-order", "wlh", "--reader", "size_order=lwh"]) == 1
    assert "size_order is given by its own flag too" in capsys.readouterr().err


def test_options_stay_in_what_a_data_set_is_made_of(tmp_path: Path) -> None:
    write_nuscenes(tmp_path, samples=1)
    options = open_dataset(tmp_path, sweeps=OptionText("2")).options
    assert options == {"sweeps": 2}


@pytest.mark.parametrize(
    ("word", "name"),
    [
        ("velodyne", "captures"),
        ("hesai", "captures"),
        ("Ouster", "osf"),
        ("las", ".las"),
        (".LAZ", ".laz"),
        ("pcap", "ouster"),
        ("rosbag", "bags"),
        ("ROS 2", "bags"),
        ("SemanticKITTI", "kitti_odometry"),
        ("TruckScenes", "truckscenes"),
        ("mmdetection3d", "openpcdet"),
        ("K-Radar", "kradar"),
        ("nuScenes", "nuscenes"),
    ],
)
def test_any_word_of_a_user_gives_what_is_read(word, name):
    assert name in [entry.name for entry in format_catalogue().find(word)]


def test_a_word_of_files_that_are_not_read_says_so():
    with pytest.raises(ConfigError, match="e57 is not read"):
        format_catalogue().find("e57")
    with pytest.raises(ConfigError, match="got 'zebra'"):
        format_catalogue().find("zebra")


def test_every_word_stands_for_formats_that_there_are():
    from farfield.inspection.formats import _WORDS

    catalogue = format_catalogue()
    names = {entry.name for entry in (*catalogue.datasets, *catalogue.forms)}
    assert {name for group in _WORDS.values() for name in group} <= names

"""What is odd about boxes is said beside the score: units, headings, scores, classes, places, frames."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from farfield.cli import main
from farfield.errors import ConfigError
from farfield.files.boxes_csv import BoxRows, write_boxes_csv
from farfield.metrics.box_files import read
from farfield.vocabulary.classes import closest_class

Changed = Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]]


def cars(seed: int = 0) -> dict[str, np.ndarray]:
    """Ten cars in each of twelve frames, each at another place, none at the mirror image of another."""
    random = np.random.default_rng(seed)
    count = 120
    left = random.choice([-1.0, 1.0], count) * random.uniform(5, 20, count)
    place = np.column_stack(
        [np.tile(np.arange(10) * 8.0, 12) + random.uniform(8, 11, count), left, np.full(count, -0.9)]
    )
    return {
        "frame": np.repeat([f"{number:03d}" for number in range(12)], 10),
        "label": np.full(count, "vehicle"),
        "centre_m": place,
        "size_m": np.tile([4.5, 1.9, 1.6], (count, 1)),
        "yaw_rad": random.uniform(-3, 3, count),
    }


def found(tmp_path: Path, change: Changed = dict, of_labels: Changed = dict, shift: float = 0.1):
    """Good predictions and their labels as files, after a change."""
    seen, random = cars(), np.random.default_rng(5)
    seen["centre_m"] = seen["centre_m"] + random.normal(0, shift, (120, 3))
    seen["score"] = random.uniform(0.3, 1, 120)
    write_boxes_csv(tmp_path / "p.csv", BoxRows(**change(seen)))
    write_boxes_csv(tmp_path / "l.csv", BoxRows(**of_labels(cars())))
    return read(tmp_path / "p.csv", tmp_path / "l.csv")


def part(name: str, make: Callable[[np.ndarray], np.ndarray]) -> Changed:
    def changed(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return columns | {name: make(columns[name])}

    return changed


def test_good_boxes_are_not_odd(tmp_path: Path) -> None:
    assert found(tmp_path).notes == ()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (part("yaw_rad", np.rad2deg), "look like degrees"),
        (part("yaw_rad", lambda yaw: np.negative(yaw)), "counted clockwise"),
        (part("yaw_rad", lambda yaw: yaw + np.pi / 2), "off by 90 degrees"),
        (part("size_m", lambda size: 100 * size), "centimetres"),
        (part("size_m", lambda size: size / 2), "half the annotated"),
        (part("size_m", lambda size: size[:, [1, 0, 2]]), "length and width"),
        (part("centre_m", lambda place: 100 * place), "divided by 100"),
        (part("centre_m", lambda place: place * [1, -1, 1]), "mirrored"),
        (part("centre_m", lambda place: place[:, [1, 2, 0]] * [-1, -1, 1]), "camera's axes"),
        (part("centre_m", lambda place: place - [0, 0, 0.8]), "not its bottom"),
        (part("frame", lambda names: np.array([f"{int(name) + 1:03d}" for name in names])), "off by one"),
        (part("score", lambda score: 100 * score), "scores go from"),
        (part("score", np.ones_like), "have one score"),
        (lambda columns: {name: np.concatenate([rows, rows]) for name, rows in columns.items()}, "twice"),
        (lambda columns: columns | {"velocity_m_s": np.full((120, 2), 90.0)}, "km/h"),
        (lambda columns: {name: rows[:0] for name, rows in columns.items()}, "no predicted box"),
    ],
    ids=[
        *("degrees", "clockwise", "quarter", "centimetres", "half", "swapped", "far", "mirrored", "camera", "bottom"),
        *("off by one", "per cent", "one score", "twice", "km/h", "empty"),
    ],
)
def test_what_is_odd_is_said(tmp_path: Path, change: Changed, words: str) -> None:
    assert any(words in note for note in found(tmp_path, change).notes), words


def test_labels_are_looked_at_too(tmp_path: Path) -> None:
    notes = found(tmp_path, of_labels=part("yaw_rad", np.rad2deg)).notes
    assert any("annotated headings" in note for note in notes)


def test_exchanged_files_and_one_for_both_are_said(tmp_path: Path) -> None:
    found(tmp_path)
    assert any("exchanged" in note for note in read(tmp_path / "l.csv", tmp_path / "p.csv").notes)
    assert any("the same boxes" in note for note in read(tmp_path / "p.csv", tmp_path / "p.csv").notes)


def test_classes_that_no_label_has_are_named(tmp_path: Path) -> None:
    result = found(tmp_path, part("label", lambda names: np.where(np.arange(120) % 2, "Car", names))).score("dds")
    (note,) = [note for note in result.notes if "classes that no label has" in note]
    assert "60 of 120" in note
    assert "relabel=Car:vehicle" in note


def test_a_class_that_is_not_annotated_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    boxes = found(tmp_path)
    with pytest.raises(ConfigError, match="Did you mean vehicle"):
        boxes.check_label("dds", "Vehicle")
    assert main(["score", str(tmp_path / "p.csv"), str(tmp_path / "l.csv"), "--label", "Car"]) == 1
    assert "vehicle (120)" in capsys.readouterr().err


def test_an_empty_region_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    behind = part("centre_m", lambda place: place * [-1, 1, 1])
    result = found(tmp_path, behind, behind).score("dds")
    assert any("0 of 120 annotated boxes of vehicle" in note for note in result.notes)
    assert main(["score", str(tmp_path / "p.csv"), str(tmp_path / "l.csv"), "--replicates", "0"]) == 1
    assert "0 of 120" in capsys.readouterr().out


def test_nothing_found_is_exit_status_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found(tmp_path, lambda columns: {name: rows[:0] for name, rows in columns.items()})
    assert main(["score", str(tmp_path / "p.csv"), str(tmp_path / "l.csv"), "--replicates", "0"]) == 1
    assert "no frame has both" in capsys.readouterr().out


def test_names_are_guessed() -> None:
    assert closest_class("Auto", ["vehicle"]) == ""
    assert closest_class("pedestrain", ["vehicle", "pedestrian"]) == "pedestrian"
    assert closest_class("bus", ["vehicle", "large_vehicle"]) == "large_vehicle"


@pytest.mark.parametrize(("across", "is_named"), [(0.7, False), (1.0, True)])
def test_a_detector_that_is_unsure_of_headings_has_no_other_convention(
    tmp_path: Path, across: float, is_named: bool
) -> None:
    """Fifteen pairs on real sweeps, eleven of them across, were called yaws that are off by 90 degrees."""
    keep = slice(0, 15)
    turned = np.arange(15) < across * 15

    def fewer(boxes: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {name: values[keep] for name, values in boxes.items()}

    def unsure(boxes: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        boxes = fewer(boxes)
        return boxes | {"yaw_rad": boxes["yaw_rad"] + np.where(turned, np.pi / 2, 0.05)}

    notes = found(tmp_path, unsure, fewer).score("dds").notes
    assert any("off by 90 degrees" in note for note in notes) == is_named, notes

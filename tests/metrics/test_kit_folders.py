"""K-Radar's kit folders: axes decided from the numbers or refused, conditions read; OpenPCDet's and mmdetection3d's."""

import json
from pathlib import Path

import numpy as np
import pytest

from farfield.errors import ConfigError, FileFormatError
from farfield.metrics.box_files import read, read_predictions
from farfield.metrics.kit_axes import AXES

PLACES = [(20.0 + 3 * number, -12.0 + 4 * (number % 7), -0.3 + 0.1 * (number % 5)) for number in range(24)]
"""x ahead, y left, z up of the middle; the radar's."""
SIZE = (4.4, 1.9, 1.6)


def kit(folder: Path, axes: str, *, yaw_rad: float = 0.1, stand_in: bool = True, above: float = 0.0) -> Path:
    """A score cut as the kit writes it, its columns in some axes; four boxes a frame."""
    sides = {name: folder / "all" / name for name in ("preds", "gts", "desc")}
    for side in sides.values():
        side.mkdir(parents=True)
    px = "50 50 150 150" if stand_in else "0 0 10 10"
    for frame in range(0, len(PLACES), 4):
        rows: dict[str, list[str]] = {"preds": [], "gts": []}
        for x, y, z in PLACES[frame : frame + 4]:
            z += above
            place, turn = (y, z, x), yaw_rad
            if axes == "camera":
                place, turn = (-y, -(z - SIZE[2] / 2), x), -yaw_rad - np.pi / 2
            elif axes == "lidar":
                place = (x, y, z)
            elif axes == "exchanged-turned":
                turn = yaw_rad - np.pi / 2
            numbers = " ".join(map(repr, [*SIZE[::-1], *place, turn]))
            rows["preds"].append(f"sed -1 -1 0 {px} {numbers} 0.75")
            rows["gts"].append(f"sed 0.00 0 0 {px} {numbers}")
        name = f"{frame // 4:06d}.txt"
        for side, lines in rows.items():
            (sides[side] / name).write_text("\n".join(lines) + "\n")
        (sides["desc"] / name).write_text("night\nparkinglots\nheavysnow")
    (folder / "all" / "val.txt").write_text("000000\n")
    return folder


@pytest.mark.parametrize(
    ("axes", "stand_in", "above", "evidence"),
    [
        ("exchanged", True, 0.0, "the kit alone writes"),
        ("exchanged", False, 0.0, "y is upright"),
        ("camera", False, -1.5, "points down"),
        ("lidar", False, 0.0, "z alone is upright"),
    ],
)
def test_axes_are_decided_by_the_numbers_and_said(
    tmp_path: Path, axes: str, stand_in: bool, above: float, evidence: str
) -> None:
    folder = kit(tmp_path, axes, stand_in=stand_in, above=above)
    detections = read(folder, folder, format="kradar")
    (note,) = [note for note in detections.notes if "axes" in note]
    assert f"axes {axes}:" in note
    assert evidence in note
    boxes = detections.boxes["", "000001"]
    np.testing.assert_allclose(boxes.centre_m, np.add(PLACES[4:8], [0, 0, above]), atol=1e-12)
    np.testing.assert_allclose(boxes.size_m, [SIZE] * 4)
    np.testing.assert_allclose(boxes.yaw_rad, 0.1, atol=1e-12)
    assert set(boxes.label) == {"vehicle"}


@pytest.mark.parametrize(
    ("axes", "yaw_rad", "why"),
    [("exchanged-turned", 0.1, "exchanged-turned"), ("exchanged", 1.5, "across"), ("exchanged", 0.8, "across")],
)
def test_what_the_numbers_do_not_decide_is_refused_with_the_flag(
    tmp_path: Path, axes: str, yaw_rad: float, why: str
) -> None:
    folder = kit(tmp_path, axes, yaw_rad=yaw_rad)
    with pytest.raises(ConfigError, match=why) as refused:
        read(folder, folder, format="kradar")
    assert "--axes" in str(refused.value)
    detections = read(folder, folder, format="kradar", axes=axes)
    np.testing.assert_allclose(detections.boxes["", "000000"].yaw_rad, yaw_rad, atol=1e-12)
    assert any("as --axes says" in note for note in detections.notes)


def test_boxes_whose_upright_column_may_be_either_are_refused(tmp_path: Path) -> None:
    folder = kit(tmp_path, "exchanged", stand_in=False, above=0.85)
    with pytest.raises(ConfigError, match="up or down"):
        read(folder, folder, format="kradar")


def test_contradicting_evidence_is_refused(tmp_path: Path) -> None:
    folder = kit(tmp_path, "lidar", stand_in=True)
    with pytest.raises(ConfigError, match="y is not upright"):
        read(folder, folder, format="kradar")


def test_conditions_come_from_the_descriptions(tmp_path: Path) -> None:
    folder = kit(tmp_path, "exchanged")
    detections = read(folder, folder, format="kradar")
    assert detections.conditions["", "000000"] == {"time": "night", "road": "parking_lot", "weather": "heavy_snow"}
    table = str(detections.score("kradar"))
    assert "weather: heavy_snow" in table
    (folder / "all/desc/000001.txt").write_text("night\nfog")
    with pytest.raises(FileFormatError, match="three lines"):
        read(folder, folder, format="kradar")


def test_dummies_are_no_boxes_and_several_cuts_are_named(tmp_path: Path) -> None:
    folder = kit(tmp_path / "0.3", "exchanged")
    (folder / "all/preds/000000.txt").write_text("dummy -1 -1 0 0 0 0 0 0 0 0 0 0 0 0 0\n")
    detections = read(folder, folder, format="kradar")
    assert not len(detections.boxes["", "000000"])
    assert len(detections.annotated["", "000000"]) == 4
    kit(tmp_path / "0.5", "exchanged")
    with pytest.raises(ConfigError, match=r"0\.3, 0\.5"):
        read(tmp_path, tmp_path, format="kradar")
    with pytest.raises(ConfigError, match="format kradar"):
        read(folder, folder, format="kitti", axes=AXES[0])


def instances(path: Path, **changes: object) -> Path:
    """A frame of mmdetection3d's inferencer."""
    tree = {
        "labels_3d": [2, 0],
        "scores_3d": [0.9, 0.4],
        "bboxes_3d": [[10.0, 2.0, -1.7, 4.2, 1.8, 1.5, 0.3], [8.0, -1.0, -1.6, 0.8, 0.6, 1.7, -1.0]],
        "box_type_3d": "LiDAR",
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({key: value for key, value in (tree | changes).items() if value is not None}))
    return path


def test_numbered_classes_need_their_names(tmp_path: Path) -> None:
    instances(tmp_path / "preds" / "000007.json")
    with pytest.raises(FileFormatError, match="--class-names"):
        read_predictions(tmp_path, format="mmdetection3d")
    names = ("Pedestrian", "Cyclist", "Car")
    boxes = read_predictions(tmp_path, format="mmdetection3d", class_names=names).boxes["", "000007"]
    assert boxes.label.tolist() == ["Car", "Pedestrian"]
    np.testing.assert_allclose(boxes.centre_m, [[10.0, 2.0, -0.95], [8.0, -1.0, -0.75]])  # the bottom is theirs
    np.testing.assert_allclose(boxes.size_m, [[4.2, 1.8, 1.5], [0.8, 0.6, 1.7]])
    np.testing.assert_allclose(boxes.yaw_rad, [0.3, -1.0])
    instances(tmp_path / "preds" / "000007.json", classes=["Car", "Pedestrian", "Cyclist"])
    with pytest.raises(ConfigError, match="class-names says"):
        read_predictions(tmp_path, format="mmdetection3d", class_names=names)


def test_boxes_of_the_camera_are_kittis(tmp_path: Path) -> None:
    box = [[1.0, 1.6, 20.0, 4.0, 1.5, 1.8, -np.pi / 2]]
    path = instances(
        tmp_path / "a.json", bboxes_3d=box, labels_3d=[0], scores_3d=[0.5], box_type_3d="Camera", classes=["Car"]
    )
    detections = read_predictions(path, format="mmdetection3d")
    (boxes,) = detections.boxes.values()
    np.testing.assert_allclose(boxes.centre_m, [[20.0, -1.0, -0.85]])
    np.testing.assert_allclose(boxes.size_m, [[4.0, 1.8, 1.5]])
    np.testing.assert_allclose(boxes.yaw_rad, [0.0], atol=1e-12)
    assert detections.reference == "camera"


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"box_type_3d": "Depth"}, "LiDAR or Camera"),
        ({"scores_3d": [0.5]}, "of one length"),
        ({"scores_3d": [0.5, "x"]}, "a number"),
        ({"labels_3d": [0, -1]}, "a number from 0"),
        ({"labels_3d": [0, True]}, "a number from 0"),
        ({"bboxes_3d": [[1.0] * 7, [1.0] * 8]}, "7 numbers"),
        ({"bboxes_3d": [[1.0] * 7, [1.0, 1, 1, 1, 0, 1, 1]]}, "sizes"),
        ({"bboxes_3d": [[1.0] * 7, [1.0, 1, 1, 1, 1, 1, 90]]}, "radians"),
        ({"bboxes_3d": None}, "a list"),
        ({"classes": ["a", ""]}, "names"),
    ],
)
def test_damaged_instances_are_told(tmp_path: Path, changes: dict[str, object], expected: str) -> None:
    path = instances(tmp_path / "a.json", **changes)
    with pytest.raises(FileFormatError, match=expected):
        read_predictions(path, format="mmdetection3d", class_names=("a", "b", "c"))


def test_openpcdet_s_texts_are_where_it_leaves_them(tmp_path: Path) -> None:
    row = "Car -1 -1 -0.2 600.0 170.0 660.0 210.0 1.5 1.8 4.0 1.0 1.6 20.0 -1.5708 0.9731\n"
    folder = tmp_path / "final_result" / "data"
    folder.mkdir(parents=True)
    (folder / "000001.txt").write_text(row)
    boxes = read_predictions(tmp_path, format="openpcdet").boxes["", "000001"]
    np.testing.assert_allclose(boxes.centre_m, [[20.0, -1.0, -0.85]])
    assert boxes.score.tolist() == [0.9731]

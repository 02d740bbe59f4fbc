import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from street import GROUND_M, street
from trees import write_kitti

from farfield.datasets import open_dataset
from farfield.geometry.poses import quaternion_from_yaw, yaw_from_quaternion
from farfield.inspection.doctor import DoctorReport, examine
from farfield.inspection.doctor.conventions import (
    READINGS,
    above_ground,
    convention_votes,
    count_points,
    ground_height_m,
)

Label = dict[str, Any]


def yaw_of(label: Label) -> float:
    return float(yaw_from_quaternion(np.array(label["quaternion"])))


def quaternion(yaw_rad: float) -> list[float]:
    return quaternion_from_yaw(np.array(yaw_rad)).tolist()


def swap_size(label: Label) -> None:
    label["size"] = [label["size"][1], label["size"][0], label["size"][2]]


def shrink_yaw(label: Label) -> None:
    label["quaternion"] = quaternion(yaw_of(label) * np.pi / 180)


def lower(label: Label) -> None:
    label["position"][2] -= label["size"][2] / 2


def rotate_list(label: Label) -> None:
    label["quaternion"] = [label["quaternion"][index] for index in (3, 0, 1, 2)]


def mirror_yaw(label: Label) -> None:
    label["quaternion"] = quaternion(-yaw_of(label))


def in_degrees(label: Label) -> None:
    label["quaternion"] = quaternion(np.rad2deg(yaw_of(label)))


def quarter_turn(label: Label) -> None:
    label["quaternion"] = quaternion(yaw_of(label) + np.pi / 2)


def centimetres(label: Label) -> None:
    label["size"] = [100 * value for value in label["size"]]
    label["position"] = [100 * value for value in label["position"]]


def mirror(label: Label) -> None:
    label["position"][1] *= -1
    label["quaternion"] = quaternion(-yaw_of(label))


FAULTS: list[tuple[Callable[[Label], None], str, str]] = [
    (swap_size, "size order", "w l h, but read as l w h"),
    (shrink_yaw, "yaw", "multiplied by pi/180"),
    (lower, "box centre", "position is the bottom"),
    (rotate_list, "quaternion order", "w x y z, but read as x y z w"),
    (mirror_yaw, "yaw", "clockwise"),
    (in_degrees, "yaw", ""),
    (quarter_turn, "yaw", "off by 90 degrees"),
    (centimetres, "units", "centimetres"),
    (mirror, "axes", "mirrored"),
]
MENDS = {
    swap_size: "size_order: wlh",
    lower: "position_is: bottom",
    rotate_list: "quat_order: wxyz",
    mirror_yaw: "yaw_scale: -1",
    shrink_yaw: "yaw_scale: 57.29577951308232",
    quarter_turn: "yaw_offset_deg: -90",
}


def spoil(root: Path, change: Callable[[Label], None]) -> None:
    for path in root.glob("dataset1_annotation/*.json"):
        content = json.loads(path.read_text())
        for label in content["labels"]:
            change(label)
        path.write_text(json.dumps(content))


def failures(report: DoctorReport) -> dict[str, str]:
    return {finding.topic: finding.what for finding in report.findings if finding.severity == "fail"}


def test_a_sound_data_set_passes_and_conventions_are_decided(street_root):
    report = examine(open_dataset(street_root))
    assert not report.failed, str(report)
    assert report.facts["quaternion_order"] == "xyzw"
    assert report.facts["size_order"] == "lwh"
    for topic in ("quaternion order", "size order", "yaw", "box centre"):
        assert "decided from the data" in next(f.what for f in report.findings if f.topic == topic)
    assert sum(report.facts["classes_by_range"]["vehicle"].values()) > 30
    assert report.facts["frame_rate_hz"] == pytest.approx(10.0)
    json.dumps(report.to_json())


@pytest.mark.parametrize(("change", "topic", "words"), FAULTS, ids=lambda value: getattr(value, "__name__", None))
def test_each_fault_is_named(street_root, change, topic, words):
    spoil(street_root, change)
    found = failures(examine(open_dataset(street_root)))
    assert words in found[topic]


@pytest.mark.parametrize("change", MENDS)
def test_the_advised_mapping_mends_it(street_root, tmp_path, change):
    spoil(street_root, change)
    mapping = tmp_path / "mapping.yaml"
    mapping.write_text(f"labels: {{{MENDS[change]}}}\n")
    report = examine(open_dataset(street_root, mapping=mapping))
    assert not report.failed, str(report)


def test_two_faults_at_once_are_both_named(street_root):
    spoil(street_root, lambda label: (swap_size(label), lower(label), rotate_list(label)))
    assert set(failures(examine(open_dataset(street_root)))) == {"size order", "box centre", "quaternion order"}


def test_missing_labels_and_damaged_files_fail(street_root):
    next(street_root.glob("dataset1_gaussian/*.xyz")).write_text("1,2,3,0.5,0\n1,2\n")
    assert "line 2" in failures(examine(open_dataset(street_root)))["damaged"]
    shutil.rmtree(street_root / "dataset1_annotation")
    assert "0 of 3 frames annotated" in failures(examine(open_dataset(street_root)))["labels"]


def test_unknown_classes_fail_and_aliases_mend_them(street_root, tmp_path):
    spoil(street_root, lambda label: label.update(label_class="pkw"))
    assert "'pkw'" in failures(examine(open_dataset(street_root)))["class names"]
    (tmp_path / "mapping.yaml").write_text("labels: {aliases: {pkw: vehicle}}\n")
    assert not examine(open_dataset(street_root, mapping=tmp_path / "mapping.yaml")).failed


def test_boxes_off_the_points_fail(street_root):
    spoil(street_root, lambda label: label["position"].__setitem__(1, label["position"][1] + 9.0))
    assert set(failures(examine(open_dataset(street_root)))) == {"points in boxes"}


def test_changes_keep_the_volume_and_ground_points_do_not_vote(rng):
    cloud, boxes = street(rng)
    for reading in READINGS:
        np.testing.assert_allclose(reading.change(boxes).volume_m3, boxes.volume_m3)
    points = cloud.points_m.astype(np.float64)
    assert ground_height_m(points, boxes.centre_m[:, :2]) == pytest.approx(GROUND_M, abs=0.03)
    on_ground = points[:, 2] < GROUND_M + 0.03
    assert above_ground(points)[on_ground].mean() < 0.1  # only where cells at the rim hold too few points
    assert above_ground(points)[points[:, 2] > GROUND_M + 0.35].all()
    assert not any(ballot.wins for ballot in convention_votes(count_points(points, boxes, READINGS), READINGS))


class TestRealLuminar:
    @pytest.fixture
    def root(self, shared_real, tmp_path) -> Path:
        copy = tmp_path / "Cirrus_dataset1"
        ignore = shutil.ignore_patterns("*.jpg")
        return Path(shutil.copytree(shared_real / "cirrus_layout" / "Cirrus_dataset1", copy, ignore=ignore))

    def test_as_it_is(self, root):
        report = examine(open_dataset(root))
        assert not report.failed, str(report)
        text = str(report)
        for words in ("3 Gaussian frames", "no uniform folder", "no calibration", "x y z w, decided from the data"):
            assert words in text
        assert report.facts["size_order"] == "lwh"
        assert report.facts["classes_by_range"]["vehicle"] == {
            "0-70 m": 209,
            "70-150 m": 64,
            "150-250 m": 5,
            "250+ m": 0,
        }

    @pytest.mark.parametrize(
        ("change", "topic", "words"), FAULTS[:8], ids=lambda value: getattr(value, "__name__", None)
    )
    def test_faults(self, root, change, topic, words):
        spoil(root, change)
        found = failures(examine(open_dataset(root)))
        assert words in found[topic]

    @pytest.mark.parametrize("keep", [0, 1, 2])
    def test_one_frame_is_enough(self, root, keep):
        for folder in ("dataset1_gaussian", "dataset1_annotation"):
            for path in sorted((root / folder).iterdir())[:keep] + sorted((root / folder).iterdir())[keep + 1 :]:
                path.unlink()
        assert not examine(open_dataset(root)).failed
        spoil(root, shrink_yaw)
        assert "pi/180" in failures(examine(open_dataset(root)))["yaw"]


def verdict(report: DoctorReport) -> list[tuple[str, str]]:
    return [(finding.topic, finding.severity) for finding in report.findings]


@pytest.mark.parametrize("wrong", [False, True])
def test_a_selection_and_a_moved_set_are_examined_as_the_whole_is(street_root: Path, wrong: bool) -> None:
    """Wrong quaternions are read anew in the order that the data show, in the coordinates that were asked for."""
    if wrong:
        spoil(street_root, rotate_list)
    data = open_dataset(street_root)
    whole = examine(data)
    assert whole.failed == wrong
    for seen in (data.select(range(len(data))), data.turned(90), data.select(range(len(data))).turned(180)):
        report = examine(seen)
        assert verdict(report) == verdict(whole)
        assert report.facts["quaternion_order"] == whole.facts["quaternion_order"]
    part = examine(data.select([0]))
    assert {topic for topic, _ in verdict(part)} >= {"Gaussian sweeps", "quaternion order", "size order"}
    assert "1 Gaussian frame" in next(one.what for one in part.findings if one.topic == "Gaussian sweeps")
    assert "of full scale" in next(one.what for one in part.findings if one.topic == "cloud gaussian")


def test_each_image_is_held_against_its_own_frames_calibration(tmp_path: Path) -> None:
    """KITTI's pictures have four sizes, each with a calibration of its own: the first frame's counted for all."""
    from PIL import Image

    root = tmp_path / "kitti"
    write_kitti(root)
    training = root / "training"
    (training / "image_2").mkdir(exist_ok=True)
    for kind, suffix in (("velodyne", "bin"), ("calib", "txt"), ("label_2", "txt")):
        shutil.copy(training / kind / f"000007.{suffix}", training / kind / f"000008.{suffix}")
    for name, size in (("000007", (1242, 375)), ("000008", (1224, 370))):
        Image.new("RGB", size).save(training / "image_2" / f"{name}.png")
    report = examine(open_dataset(root))
    assert not [finding for finding in report.findings if "calibrated for" in finding.what]

"""What an evaluation lost: each object's loss by hand, slices by a condition, and the file read back."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import farfield as ff
from farfield.cli import main
from farfield.datasets.door import dataset_of
from farfield.datasets.maps.where import fulfilling
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.evaluation.lost import LOST, lost_json, lost_of, read_lost
from farfield.frame import Annotation
from farfield.frame.where import Where
from farfield.metrics import Detections
from farfield.metrics.breakdown import of_slice
from farfield.metrics.presenting import HitRule
from farfield.pages.worst_page import headline


def boxes(*places: tuple[float, float, float | None], label: str = "vehicle") -> ff.Boxes:
    rows = np.array([[x, y, 0.0, 4.0, 2.0, 1.5, 0.0] for x, y, _ in places]).reshape(-1, 7)
    scores = [score for *_, score in places]
    return ff.Boxes.from_numpy(rows, label=label, score=None if None in scores else np.array(scores, dtype=float))


def detections() -> Detections:
    """Frame 1, sleet: one found by 0.9, one missed at 120 m, a false box of 0.6. Frame 2, fog: found by 0.2."""
    one = boxes((20, 0, None), (120, 0, None)).replace(point_count=np.array([80, 3]))
    two = boxes((40, 0, None)).replace(point_count=np.array([20]))
    return Detections(
        boxes={("a", "1"): boxes((20.3, 0, 0.9), (60, 10, 0.6)), ("a", "2"): boxes((40, 0.5, 0.2))},
        annotations={("a", "1"): Annotation(boxes=one), ("a", "2"): Annotation(boxes=two)},
        conditions={("a", "1"): {"weather": "sleet"}, ("a", "2"): {"weather": "fog"}},
    )


def test_losses_are_those_of_the_hand(tmp_path: Path) -> None:
    tree = lost_of(detections(), finding=HitRule(), labels=None)
    (tmp_path / LOST).write_text(json.dumps(lost_json({"lidar": tree})))
    (lost,) = read_lost(tmp_path)
    assert [(row["frame"], row["loss"], row["missed"], row["false"]) for row in lost.frames] == [
        ("1", pytest.approx(1.7), 1, 1),
        ("2", pytest.approx(0.8), 0, 0),
    ]
    assert [(row["kind"], row["loss"]) for row in lost.objects] == [("missed", 1.0), ("unsure", 0.8), ("false", 0.6)]
    far = lost.where(Where('range_m > 100 and weather == "sleet"'))
    assert [row["kind"] for row in far.objects] == ["missed"]
    assert far.frames[0]["loss"] == 1.0
    assert [row["value"] for row in lost.by("points")] == ["1-5 points", "20-50 points", "not counted"]
    assert lost.by("weather")[0] == {"value": "sleet", "loss": 1.6, "missed": 1, "false": 1, "unsure": 0}
    with pytest.raises(ConfigError, match="--by"):
        lost.by("colour")


def test_classes_that_do_not_count_are_named(tmp_path: Path) -> None:
    """All bicycles were missed, and nothing said that the evaluation was of vehicles alone."""
    own = detections()
    key = ("a", "1")
    both = ff.Boxes.concatenate(
        [own.annotations[key].boxes.plain(), boxes((10, 3, None), (12, 5, None), label="bicycle")]
    )
    own = replace(own, annotations={**own.annotations, key: Annotation(boxes=both)})
    (tmp_path / LOST).write_text(json.dumps(lost_json({"lidar": lost_of(own, finding=HitRule(), labels={"vehicle"})})))
    (lost,) = read_lost(tmp_path)
    assert "of vehicle alone; also annotated: bicycle (2) (farfield evaluate --label CLASS)" in headline(lost)
    assert headline(lost.where(None, ("missed",))).endswith("(farfield evaluate --label CLASS)")
    assert main(["worst", str(tmp_path), "--where", 'label == "bicycle"']) == 1
    every = lost_of(own, finding=HitRule(), labels=None)
    (tmp_path / LOST).write_text(json.dumps(lost_json({"lidar": every})))
    assert "alone" not in headline(read_lost(tmp_path)[0])


def test_boxes_outside_the_score_s_region_lose_nothing() -> None:
    settings = {"region": "range", "range_bins_m": [0, 70]}
    tree = lost_of(detections(), finding=HitRule(), labels=None, settings=settings)
    assert [row["kind"] for row in tree["objects"]] == ["unsure", "false"]


@pytest.mark.parametrize(
    "text", ["{}", '{"clouds": {"a": {"finding": "x", "frames": [3], "objects": []}}}', '{"clouds": 3}']
)
def test_a_damaged_file_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / LOST).write_text(text)
    with pytest.raises(FileFormatError):
        read_lost(tmp_path)
    with pytest.raises(ConfigError, match=r"lost\.json"):
        read_lost(tmp_path / "nowhere")


def test_a_slice_cuts_both_sides_and_says_so() -> None:
    part = of_slice(detections(), Where('range_m > 50 and weather == "sleet"'))
    assert list(part.annotations) == [("a", "1")]
    assert len(part.annotations["a", "1"].boxes) == 1
    assert part.boxes["a", "1"].range_m.round().tolist() == [61.0]
    assert "1 of 3 annotated and 1 of 3 predicted boxes count, in 1 of 2 frames" in part.notes[-1]
    with pytest.raises(ConfigError, match="found none of 3"):
        of_slice(detections(), Where("range_m > 500"))


def test_a_predicted_box_goes_with_the_annotated_one_that_it_finds() -> None:
    part = of_slice(detections(), Where("points < 50"))
    assert part.boxes["a", "1"].score is not None
    assert part.boxes["a", "1"].score.tolist() == [0.6], "the box of 0.9 finds the object of 80 points"


def test_data_of_which_only_some_objects_count() -> None:
    points = np.random.default_rng(0).uniform(2, 60, (30, 3))
    frames = [
        ff.Frame.of(points, boxes((x, 0, None)), frame_id=str(x), conditions={"weather": weather})
        for x, weather in ((20, "sleet"), (120, "sleet"), (150, "fog"))
    ]
    data = dataset_of(frames)
    assert fulfilling(data, "") is data
    assert fulfilling(data, 'weather == "sleet"').frame_ids == ("20", "120")
    assert fulfilling(data, 'range_m > 100 and weather == "sleet"').frame_ids == ("120",)
    assert len(fulfilling(data, "range_m < 100")[0].boxes or ()) == 1
    with pytest.raises(DatasetError, match="these data do not say points"):
        fulfilling(data, "points > 3")

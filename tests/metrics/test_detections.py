"""Detections: what counts, what is left out and said, and what each protocol takes of them."""

import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from farfield.errors import ConfigError
from farfield.frame import Annotation, Camera, CameraField, Drive
from farfield.geometry.boxes import Boxes
from farfield.metrics import Bootstrap, Detections, evaluate_dds, score
from farfield.metrics.centre.dds import DdsSettings
from farfield.metrics.kitti.protocol import FACTS

from .scenes import NO_BOOTSTRAP, as_predictions, boxes, car, random_scene


def camera_field() -> CameraField:
    """A camera at the origin that looks ahead, 45 degrees to either side."""
    matrix = np.array([[50.0, 0.0, 50.0], [0.0, 50.0, 50.0], [0.0, 0.0, 1.0]])
    return CameraField(camera=Camera(matrix=matrix, width_px=101, height_px=101), name="camera")


def detections(rng: np.random.Generator, **rest: Any) -> Detections:
    predictions, annotations = random_scene(rng)
    return Detections(
        boxes=predictions, annotations={k: Annotation(boxes=part) for k, part in annotations.items()}, **rest
    )


SAME = "predictions and labels are the same boxes: is one file given for both?"


def test_a_score_is_the_evaluators(rng: np.random.Generator) -> None:
    found = detections(rng)
    tree = found.score("dds", epsilons=(0.0, 0.01)).to_json()
    plain = {name: value for name, value in tree.items() if name != "subject"}
    assert plain == evaluate_dds(found.boxes, found.annotated, DdsSettings(epsilons=(0.0, 0.01))).to_json()
    assert "notes" not in tree
    assert tree == pickle.loads(pickle.dumps(found)).score("dds", epsilons=(0.0, 0.01)).to_json()
    assert "12 annotated" in repr(found)


@pytest.mark.parametrize("protocol", ["dds", "nuscenes", "kitti", "kradar"])
def test_boxes_outside_the_annotated_region_do_not_count_and_it_is_said(protocol: str) -> None:
    ahead = {("s", str(i)): boxes([car(20), car(40, 3)], scored=False) for i in range(4)}
    behind = boxes([car(-20, score=0.95), car(5, 30, score=0.9)])
    predictions = {key: Boxes.concatenate([part.replace(score=np.full(2, 0.5)), behind]) for key, part in ahead.items()}
    annotations = {
        key: Annotation(boxes=Boxes.concatenate([part, boxes([car(-40)], scored=False)]), region=camera_field())
        for key, part in ahead.items()
    }
    given: dict[str, Any] = {"region": "none", "bootstrap": NO_BOOTSTRAP}
    masked = Detections(boxes=predictions, annotations=annotations).score(protocol, **given)
    alone = score(as_predictions(ahead), ahead, protocol=protocol, **given)
    assert masked.counts["annotated"] == 8
    assert masked.counts["predictions"] == 8
    assert [v for v in masked.figures.values() if v is not None] == pytest.approx(
        [v for v in alone.figures.values() if v is not None]
    )
    note = "8 of 16 predicted and 4 of 12 annotated boxes have their centre outside the field of camera"
    assert any(note in said for said in masked.to_json()["notes"])
    assert "note: 8 of 16" in str(masked)
    plain = {key: replace(annotation, region=None) for key, annotation in annotations.items()}
    assert score(predictions, plain, protocol=protocol, **given).counts["annotated"] == 12


def test_rows_beside_the_boxes_are_cut_with_them() -> None:
    px = np.array([[0, 0, 50, 50], [0, 0, 9, 9.0]])
    facts = {"truncation": np.zeros(2), "occlusion": np.zeros(2), "box_px": px[:, :]}
    annotation = Annotation(
        boxes=boxes([car(20), car(-20)], scored=False, label="Car"), details=facts, region=camera_field()
    )
    found = Detections(
        boxes={("s", "0"): boxes([car(-20, score=0.9), car(20, score=0.5)], label="Car")},
        annotations={("s", "0"): annotation},
        prediction_details={("s", "0"): {"box_px": px[::-1]}},
    )
    counted = found.counted()
    assert counted.prediction_details["s", "0"]["box_px"].tolist() == [[0, 0, 50, 50]]
    assert counted.annotations["s", "0"].details["box_px"].tolist() == [[0, 0, 50, 50]]
    assert found.score("kitti").figures["ap/3d_r40/easy"] == 1.0


def test_frames_without_annotation_do_not_count(rng: np.random.Generator) -> None:
    found = detections(rng)
    keys = list(found.annotations)
    part = replace(found, annotations={key: found.annotations[key] for key in keys[:7]})
    result = part.score(bootstrap=NO_BOOTSTRAP)
    cut = {key: found.boxes[key] for key in keys[:7]}
    assert result.figures == part.replaced(cut).score(bootstrap=NO_BOOTSTRAP).figures
    assert result.notes[0] == "5 of 12 frames are not annotated and do not count"
    missing = part.replaced({key: found.boxes[key] for key in keys[:3]})
    assert missing.score(bootstrap=NO_BOOTSTRAP).counts["frames_given"] == 7
    with pytest.raises(ConfigError, match="none in common"):
        part.replaced({("elsewhere", "0"): boxes([car(5, score=1)])}).score()
    with pytest.raises(ConfigError, match="frames that are annotated"):
        score(found.boxes, {key: found.annotations[key] for key in keys[:7]})


def test_bins_beyond_the_reach_are_null_with_the_reason() -> None:
    annotated = {("s", str(i)): boxes([car(20), car(60), car(90), car(180)], scored=False) for i in range(6)}
    near = {key: as_predictions(annotated)[key][:2] for key in annotated}
    found = Detections(boxes=near, annotations={k: Annotation(boxes=b) for k, b in annotated.items()}, reach_m=80.0)
    result = found.score("dds", range_bins_m=(0.0, 50.0, 100.0, 150.0, 250.0), bootstrap=Bootstrap(replicates=5))
    tree = result.to_json()
    assert tree["ranges"]["150-250"] is None
    assert tree["ranges"]["50-100"] is not None
    assert [note.partition(" m ")[0] for note in tree["notes"][:2]] == ["range 150-250", "range 50-100"]
    note = "all 12 predictions have one score, 1: they cannot be ranked, and the curve has a single point"
    assert tree["notes"][2:] == [note]
    assert "beyond the detector's reach of 80 m" in tree["notes"][0]
    assert tree["mean_of_bins"]["dds"]["0"]["map"] == np.mean(
        [tree["ranges"][name]["dds"]["0"]["map"] for name in ("0-50", "50-100")]
    )
    assert tree["intervals"]["150-250"]["dds"]["0"]["dds"] is None
    assert tree["intervals"]["mean_of_bins"]["dds"]["0"]["dds"] is not None
    assert tree["counts"]["ranges"]["150-250"]["annotated"] == 6
    far = replace(found, reach_m=None)
    far = far.score("dds", range_bins_m=(0.0, 50.0, 100.0, 150.0, 250.0), bootstrap=NO_BOOTSTRAP).to_json()
    assert far["ranges"]["150-250"]["dds"]["0"]["map"] == 0.0
    assert "notes" not in far or not any("reach" in note for note in far["notes"])
    for protocol in ("nuscenes", "kitti", "kradar"):
        result = found.score(protocol, range_bins_m=(0.0, 70.0, 85.0, 250.0), bootstrap=NO_BOOTSTRAP, region="none")
        assert result.to_json()["ranges"]["85-250"] is None
        assert result.to_json()["ranges"]["0-70"] is not None


def test_visibility_is_used_where_it_is_known() -> None:
    marked = boxes([car(20), car(40)], scored=False)
    annotations = {("1", str(i)): Annotation(boxes=marked, visibility=("R", "L")) for i in range(41)}
    found = Detections(
        boxes={key: marked.replace(score=np.array([0.9, 0.1])) for key in annotations}, annotations=annotations
    )
    whole = found.score("kradar", bootstrap=NO_BOOTSTRAP)
    assert whole.to_json()["visibility"]["R"]["ap"]["vehicle"]["3d"]["0.3"] == 1.0
    assert whole.notes[-1] == SAME
    odd = {**annotations, ("1", "0"): Annotation(boxes=marked), ("1", "99"): Annotation(boxes=Boxes.empty())}
    result = replace(found, annotations=odd).score("kradar", bootstrap=NO_BOOTSTRAP)
    assert result.counts["visibility"]["R"]["annotated"] == 40
    assert result.notes[0].startswith("1 of 42 annotated frames do not say which sensor sees their boxes")
    assert (
        not replace(found, annotations={k: Annotation(boxes=marked) for k in annotations})
        .score("kradar")
        .to_json()["visibility"]
    )


def test_k_radars_protocols_take_classes_coordinates_and_version_from_the_detections() -> None:
    marked = boxes([car(20)], scored=False, label="Sedan")
    found = Detections(
        boxes={("1", "0"): marked.replace(score=np.ones(1), label="vehicle")},
        annotations={("1", "0"): Annotation(boxes=marked)},
        reference="os2-64",
        classes=("Sedan", "pedestrian"),
        facts={"label_version": "v2.1"},
        conditions={("1", "0"): {"weather": "fog"}, ("1", "1"): {"weather": "hail"}},
    )
    result = found.score("kradar")
    assert result.settings["boxes_in"] == "os2-64"
    assert result.settings["label_version"] == "v2.1"
    assert result.settings["classes"] == ["vehicle", "pedestrian"]
    assert result.to_json()["conditions"]["weather"]["fog"]["ap"]["vehicle"]["3d"]["0.3"] == 1.0
    assert "hail" not in result.to_json()["conditions"]["weather"]
    assert result.settings["range_bins_m"] == [0.0, 20.0, 40.0, 60.0, 80.0]
    assert replace(found, reference="radar").score("kradar").settings["boxes_in"] == "radar"
    assert found.score("kradar", boxes_in="os2-64", label="Sedan").settings["classes"] == ["vehicle"]
    with pytest.raises(ConfigError, match="Leave boxes_in out"):
        found.score("kradar", boxes_in="radar")
    narrow = found.score("kradar-compat:rtnh_narrow")
    assert narrow.settings["classes"] == ["vehicle"]
    assert narrow.settings["label_version"] == "v2.1"
    assert "stands for results on labels v1.0; these are v2.1" in narrow.notes[0]
    with pytest.raises(ConfigError, match=r"fixes label_version=v1\.0"):
        found.score("kradar-compat:rtnh_narrow", label_version="v2.1")


def test_kitti_takes_the_facts_of_the_image_and_says_where_there_are_none() -> None:
    marked = boxes([car(20), car(40)], scored=False, label="Car")
    facts = dict(zip(FACTS, (np.zeros(2), np.zeros(2), np.array([[0, 0, 9, 30.0], [0, 0, 9, 50]])), strict=True))
    known = Annotation(boxes=marked, details=facts, unboxed={"dontcare_px": np.zeros((0, 4))})
    predictions = {("s", "0"): marked.replace(score=np.ones(2))}
    result = score(predictions, {("s", "0"): known}, protocol="kitti")
    assert set(result.to_json()["ap"]["3d_r40"]) == {"easy", "moderate", "hard"}
    assert result.notes == (SAME,)
    plain = score(predictions, {("s", "0"): marked}, protocol="kitti")
    assert set(plain.to_json()["ap"]["3d_r40"]) == {"all"}
    assert "one difficulty" in plain.to_json()["notes"][0]


@pytest.mark.parametrize("protocol", ["dds", "nuscenes", "kitti", "kradar"])
def test_intervals_are_drawn_over_drives_where_they_are_known(protocol: str, rng: np.random.Generator) -> None:
    found = detections(rng)
    keys = tuple(found.annotations)
    given: dict[str, Any] = {"bootstrap": Bootstrap(replicates=5), "region": "none"}
    plain = found.score(protocol, **given)
    halves = [
        Drive(name=name, indices=np.arange(len(part)), keys=part) for name, part in (("a", keys[:6]), ("b", keys[6:]))
    ]
    by_drive = replace(found, drives=tuple(halves)).score(protocol, **given)
    assert by_drive.figures == plain.figures
    assert by_drive.grouped_by == plain.grouped_by == "sequences"
    assert by_drive.intervals != plain.intervals
    same = [
        Drive(name=name, indices=np.arange(4), keys=tuple(key for key in keys if key[0] == name))
        for name in ("drive0", "drive1", "drive2")
    ]
    assert replace(found, drives=tuple(same)).score(protocol, **given).intervals == plain.intervals

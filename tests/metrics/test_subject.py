"""Every figure says what it is of: detector, data, class, cloud, region, objects, protocol, learnt from or not."""

from dataclasses import replace

import numpy as np
import pytest

from farfield.metrics import PROTOCOLS, Detections
from farfield.metrics.result import Subject, labels_fingerprint, region_words, subject_of
from farfield.testing.protocols import example

NAMES = (
    "dds",
    "nuscenes",
    "argoverse2",
    "waymo",
    "waymo-let",
    "kitti",
    "kradar",
    "kradar-compat:old_as_shipped@0.3",
    "tracking",
    "nuscenes-tracking",
)


def found() -> Detections:
    return replace(
        example(),
        detector="pillars",
        detector_digest="ab" * 32,
        data="drives",
        fingerprint="cd" * 32,
        cloud="gaussian",
        seen_in_training="2 of 6 frames",
    )


@pytest.mark.parametrize("name", NAMES)
def test_a_result_carries_its_subject(name: str) -> None:
    result = found().score(name)
    subject = subject_of(result.to_json())
    assert subject is not None
    assert subject == result.subject
    assert subject == Subject.from_json(subject.to_json())
    assert (subject.detector, subject.data, subject.cloud) == ("pillars", "drives", "gaussian")
    assert subject.protocol == name
    assert subject.label == result.label
    assert subject.frames == 6
    assert subject.annotated == result.counts.get("annotated", subject.annotated)
    assert subject.annotated is not None
    assert subject.labels_fingerprint == labels_fingerprint(example().annotations)
    for text in (str(result).replace("\n  ", " "), repr(result)):
        assert str(subject) in text
    for word in ("pillars [abababab] on drives [cdcdcdcd]", "cloud gaussian", "2 of 6 frames", f"{subject.annotated}"):
        assert word in str(subject)


def test_labels_that_are_moved_are_other_labels() -> None:
    annotations = example().annotations
    moved = {key: a.replaced(a.boxes.replace(centre_m=a.boxes.centre_m + 0.4)) for key, a in annotations.items()}
    assert labels_fingerprint(moved) != labels_fingerprint(annotations)
    assert labels_fingerprint(dict(reversed([*moved.items()]))) == labels_fingerprint(moved)
    here, there = (Detections(boxes={}, annotations=a).score().subject for a in (annotations, moved))
    assert here is not None
    assert there is not None
    assert not here.same_data(there)
    assert here.same_data(replace(there, labels_fingerprint=""))


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"region": "none"}, "everywhere"),
        ({}, "everywhere"),
        ({"region": "range", "range_bins_m": [0.0, 70.0, "inf"]}, "0 to inf m around"),
        (
            {"region": "window", "window_m": [0.0, 250.0, -50.0, 50.0], "range_bins_m": [0.0, 80.0]},
            "x 0 to 250 m, y -50 to 50 m, range 0 to 80 m",
        ),
        ({"region": "wide", "azimuth_deg": 53.0}, "wide, azimuth to 53 degrees"),
        (
            {"region": [0.0, 72.0, -6.4, 6.4, -2.0, 6.0], "azimuth_deg": None},
            "x 0 to 72 m, y -6.4 to 6.4 m, z -2 to 6 m",
        ),
    ],
)
def test_regions_in_words(settings: dict[str, object], words: str) -> None:
    assert region_words(settings) == words


@pytest.mark.parametrize("tree", [None, {}, {"subject": 3}, {"subject": {"protocol": "dds"}}])
def test_results_from_before_have_no_subject(tree: object) -> None:
    assert subject_of(tree if isinstance(tree, dict) else {}) is None


def test_the_class_that_is_scored_is_one_that_the_detector_knows() -> None:
    every = example()
    assert every.score().label == "vehicle"
    assert replace(every, classes=("pedestrian",)).score().label == "pedestrian"
    assert replace(every, classes=("boat",)).score().label == "vehicle"
    assert PROTOCOLS["dds"].settings(replace(every, classes=("pedestrian",)), label="vehicle").label == "vehicle"


def test_a_count_that_a_protocol_does_not_give_is_that_of_the_class() -> None:
    subject = np.array([len(boxes) for boxes in example().annotated.values()])
    assert subject.sum() == 50


@pytest.mark.parametrize(("name", "word"), [("dds", "aIoU counts as 0"), ("nuscenes", "errors count as 1")])
def test_a_score_of_nothing_says_why(name: str, word: str) -> None:
    every = example()
    few = {key: boxes[:0] if key != ("drive0", "0") else boxes[1:5] for key, boxes in every.boxes.items()}
    result = replace(every, boxes=few).score(name, label="vehicle", region="none")
    assert 0 < 4 / 40 < 0.11
    assert result.figures["map" if name == "nuscenes" else "dds/0/dds"] == 0
    (note,) = [note for note in result.notes if "over all ranges" in note]
    assert "only 0.10 of the 40 objects are found within 2 m" in note
    assert word in note
    assert not [note for note in every.score(name).notes if "are found" in note]
    assert not [note for note in replace(every, boxes={}).score(name).notes if "are found" in note]


def test_classes_that_count_as_another_are_named() -> None:
    """Cirrus' vehicle includes large vehicles: a row of vehicles alone has another number."""
    every = example()
    key = next(iter(every.annotations))
    boxes = every.annotations[key].boxes
    some = every.annotations[key].replaced(boxes.replace(label=["large_vehicle", *boxes.label.tolist()[1:]]))
    mixed = replace(every, annotations={**every.annotations, key: some})
    subject = mixed.score(label="vehicle").subject
    assert subject is not None
    assert subject.label == "vehicle with large_vehicle"
    assert "; vehicle with large vehicle; 41 objects" in str(subject)

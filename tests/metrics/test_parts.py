"""Scores of parts: by condition, by sector, by class."""

from pathlib import Path

import numpy as np
import pytest

from farfield.files.disk_dict import DiskDict
from farfield.frame import Annotation, Boxes
from farfield.metrics import PROTOCOLS, Bootstrap, Detections
from farfield.metrics.breakdown import by_class, by_part, parts, parts_json

STILL = {"bootstrap": Bootstrap(replicates=0)}


def at(*places_m: tuple[float, float], label: str = "vehicle", score: float | None = None) -> Boxes:
    """Boxes of one class on the ground at x, y."""
    n = len(places_m)
    return Boxes(
        centre_m=np.array([(*place, 0.0) for place in places_m]).reshape(n, 3),
        size_m=np.tile([4.0, 2.0, 1.5], (n, 1)),
        yaw_rad=np.zeros(n),
        label=np.array([label] * n),
        score=None if score is None else np.full(n, score),
    )


AHEAD, LEFT, RIGHT = (50.0, 0.0), (40.0, 16.0), (30.0, -30.0)  # 0, 21.8 and 45 degrees


@pytest.fixture
def found() -> Detections:
    """Two drives: on the highway the object ahead is found, in town the one to the left; the right one never."""
    keys = [("a", "0"), ("b", "0")]
    return Detections(
        boxes={keys[0]: at(AHEAD, score=0.9), keys[1]: at(LEFT, score=0.8)},
        annotations={key: Annotation(boxes=at(AHEAD, LEFT, RIGHT)) for key in keys},
        conditions={keys[0]: {"road": "highway"}, keys[1]: {"road": "urban"}},
        classes=("vehicle",),
    )


def test_a_road_is_scored_as_if_there_were_no_other(found: Detections) -> None:
    scored = by_part(found, kinds=["road"], region="none", **STILL)["road"]
    assert [*scored] == ["urban", "highway"]  # in the vocabulary's order
    alone = Detections(
        boxes={("a", "0"): at(AHEAD, score=0.9)}, annotations={("a", "0"): Annotation(boxes=at(AHEAD, LEFT, RIGHT))}
    ).score(region="none", **STILL)
    assert scored["highway"].figures == alone.figures
    assert scored["highway"].counts["annotated"] == 3


def test_sectors_hold_the_boxes_of_both_sides_by_their_own_azimuth(found: Detections) -> None:
    held = parts(found, ["azimuth"])["azimuth"]
    counts = {name: sum(len(boxes) for boxes in part.annotated.values()) for name, part in held.items()}
    assert counts == {"0-15": 2, "15-30": 2, "30-60": 2}
    scored = by_part(found, kinds=["azimuth"], region="none", **STILL)["azimuth"]
    recalled = {name: result.figures["dds/0/map"] for name, result in scored.items()}
    assert recalled["30-60"] == 0.0
    assert recalled["0-15"] > 0.4
    assert recalled["0-15"] == pytest.approx(recalled["15-30"])


def test_an_edge_belongs_to_the_outer_sector() -> None:
    edge = Detections(boxes={}, annotations={("a", "0"): Annotation(boxes=at((10.0, 10.0)))})
    held = parts(edge, ["azimuth"], azimuths_deg=(0.0, 45.0, 90.0))["azimuth"]
    assert [len(part.annotated["a", "0"]) for part in held.values()] == [0, 1]


def test_what_is_not_stated_gives_no_part_and_what_is_not_annotated_no_figure(found: Detections) -> None:
    assert [*parts(found)] == ["road", "azimuth"]
    far = by_part(found, kinds=["azimuth"], azimuths_deg=(0.0, 60.0, 90.0), region="none", **STILL)
    tree = parts_json(far)
    assert tree["conditions"]["azimuth"]["60-90"] is None
    assert tree["conditions"]["azimuth"]["0-60"]["dds"]["0"]["dds"] > 0
    assert tree["counts"]["azimuth"]["0-60"]["annotated"] == 6


def test_parts_of_boxes_in_a_file_are_the_same(found: Detections, tmp_path: Path) -> None:
    boxes, annotations = DiskDict(tmp_path), DiskDict(tmp_path)
    boxes.update(found.boxes)
    annotations.update(found.annotations)
    kept = Detections(boxes=boxes, annotations=annotations, conditions=found.conditions, classes=found.classes)
    for kind, values in by_part(found, region="none", **STILL).items():
        again = by_part(kept, kinds=[kind], region="none", **STILL)[kind]
        assert {name: part.to_json() for name, part in values.items()} == {n: p.to_json() for n, p in again.items()}


def test_every_class_has_a_row_and_says_why_it_has_no_figure() -> None:
    mixed = Boxes.concatenate([at(AHEAD), at(LEFT, label="large_vehicle"), at(RIGHT, label="bicycle")])
    seen = Detections(
        boxes={("a", "0"): at(AHEAD, LEFT, score=0.9)},
        annotations={("a", "0"): Annotation(boxes=mixed)},
        classes=("vehicle", "pedestrian"),
    )
    rows = {row.label: row for row in by_class(seen, region="none", **STILL)}
    assert [*rows] == [
        "vehicle",
        "large_vehicle",
        "pedestrian",
        "bicycle",
        "animal",
        "wheeled_pedestrian",
        "motorcycle",
        "trailer",
    ]
    assert rows["vehicle"].figures is not None
    assert rows["vehicle"].figures["dds/0/map"] == pytest.approx(1.0)  # both, for the large one is counted here
    assert rows["vehicle"].annotated == 2
    whys = {label: row.why for label, row in rows.items() if row.why}
    assert whys["large_vehicle"] == "counted as vehicle"
    assert whys["bicycle"] == "not learnt"
    assert whys["pedestrian"] == whys["animal"] == "not annotated"
    assert rows["large_vehicle"].to_json() == {"annotated": 1, "figures": None, "why": "counted as vehicle"}


def test_a_class_that_was_learnt_stands_for_itself() -> None:
    mixed = Boxes.concatenate([at(AHEAD), at(LEFT, label="large_vehicle")])
    seen = Detections(
        boxes={("a", "0"): at(LEFT, label="large_vehicle", score=0.9)},
        annotations={("a", "0"): Annotation(boxes=mixed)},
        classes=("vehicle", "large_vehicle"),
    )
    rows = {row.label: row for row in by_class(seen, region="none", **STILL)}
    assert (rows["vehicle"].annotated, rows["large_vehicle"].annotated) == (1, 1)
    assert rows["vehicle"].figures is not None
    assert rows["large_vehicle"].figures is not None
    assert rows["vehicle"].figures["dds/0/map"] == 0.0
    assert rows["large_vehicle"].figures["dds/0/map"] == pytest.approx(1.0)


def test_kradar_has_seven_rows() -> None:
    seen = Detections(
        boxes={("1", "0"): at(AHEAD, score=0.9)},
        annotations={("1", "0"): Annotation(boxes=Boxes.concatenate([at(AHEAD), at(LEFT, label="bicycle")]))},
        classes=("vehicle",),
        reference="os2-64",
    )
    rows = {row.label: row for row in by_class(seen, PROTOCOLS["kradar"], region="none", **STILL)}
    assert len(rows) == 7
    assert rows["Sedan"].figures is not None
    assert max(v for v in rows["Sedan"].figures.values() if v is not None) == pytest.approx(1.0)
    assert rows["Bicycle"].why == "not learnt"
    assert rows["Bicycle Group"].why == "counted as bicycle"
    assert rows["Bus or Truck"].why == "not annotated"


def test_a_row_of_kradar_counts_the_boxes_in_the_region() -> None:
    """The region ends at 72 m: of two annotated boxes one counts."""
    seen = Detections(
        boxes={("1", "0"): at(AHEAD, score=0.9)},
        annotations={("1", "0"): Annotation(boxes=at(AHEAD, (150.0, 0.0)))},
        classes=("vehicle",),
        reference="radar",
    )
    rows = {row.label: row for row in by_class(seen, PROTOCOLS["kradar"], region="wide", **STILL)}
    result = seen.score("kradar", region="wide", **STILL)
    assert result.subject is not None
    assert rows["Sedan"].annotated == result.subject.annotated == 1

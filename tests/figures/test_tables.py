from dataclasses import replace

import numpy as np

from farfield.evaluation.record import Evaluation
from farfield.evaluation.report_data import annotated_objects, confident
from farfield.figures import report_text
from farfield.figures.tables import heading, range_name, rows
from farfield.geometry.boxes import Boxes
from farfield.metrics import PROTOCOLS
from farfield.metrics.detections import presentation_of

DDS = PROTOCOLS["dds"]
RESULT = {
    "protocol": "dds",
    "label": "vehicle",
    "dds": {"0": {"dds": 0.5, "map": 0.4, "aiou": 0.6}, "0.006": {"dds": 0.625, "map": 0.5, "aiou": 0.75}},
    "ranges": {"70-150": {"dds": {"0": {"dds": 0.25}}}, "0-70": None},
    "counts": {"frames": 3, "annotated": 1200, "predictions": 7, "ranges": {"70-150": {"annotated": 4}}},
    "intervals": {"resampled": "frames", "overall": {"dds": {"0": {"dds": [0.25, 0.75]}}}},
}


def _boxes(x_m: list[float], **extra: np.ndarray) -> Boxes:
    n = len(x_m)
    centre = np.column_stack([x_m, np.zeros(n), np.zeros(n)])
    return Boxes(centre_m=centre, size_m=np.ones((n, 3)), yaw_rad=np.zeros(n), label="vehicle", **extra)


def test_table_by_hand() -> None:
    names = ["dds/0/dds", "dds/0.006/dds"]
    assert [heading(DDS, name) for name in names] == ["DDS", "wDDS 0.006"]
    table = rows({"mine": RESULT}, names, DDS)
    assert [(range_name(row.part), row.annotated, *(row.cells[name].text for name in names)) for row in table] == [
        ("0 to 70 m", None, "–", "–"),
        ("70 to 150 m", 4, "0.250", "–"),
        ("all ranges", 1200, "0.500", "0.625"),
    ]


def test_rows_carry_intervals_and_order() -> None:
    table = rows({"a": RESULT, "b": RESULT}, ["dds/0/dds"], DDS)
    assert [(row.part, row.result) for row in table[:3]] == [("0-70", "a"), ("0-70", "b"), ("70-150", "a")]
    assert table[-1].cells["dds/0/dds"].interval_text == "0.25 to 0.75"
    assert table[-1].cells["dds/0/dds"].percent == 50.0
    assert table[0].cells["dds/0/dds"].text == "–"
    assert range_name("overall") == "all ranges"


def test_headline_and_scope_by_hand() -> None:
    results = {"gaussian": RESULT, "uniform": RESULT}
    shown = presentation_of(RESULT)
    assert report_text.headline(results, DDS, shown) == (
        "DDS of vehicle, all ranges together (1 is perfect): 0.50 (mAP 0.40) on the Gaussian pattern and "
        "0.50 (mAP 0.40) on the uniform pattern."
    )
    assert report_text.scope(results) == (
        "Scored: 3 frames with 1,200 annotated objects, the same in the Gaussian pattern and the uniform pattern."
    )
    assert report_text.headline({}, DDS, shown).startswith("Pictures only")
    assert report_text.scope({}) == ""
    assert "real recordings" in report_text.origin({"simulated": False})[1]


def test_only_sure_predictions_find_objects() -> None:
    predicted = _boxes([10.5, 10.1, 21.9, 40.0], score=np.array([0.9, 0.5, 0.4, 0.3]))
    assert len(confident(predicted, 0.4)) == 3


def test_annotated_objects_keep_known_counts_only(evaluation: Evaluation) -> None:
    annotated = _boxes([10.0, 20.0, 30.0], point_count=np.array([7, -1, 0]))
    key = ("s", "0")
    found = annotated_objects({key: _boxes([10.0], score=np.array([0.9]))}, {key: annotated})
    assert found["range_m"] == [10.0, 30.0]
    assert found["point_count"] == [7, 0]
    assert found["found"] == [True, False]
    assert annotated_objects({}, {key: annotated.replace(point_count=None)})["found"] == []


def test_a_headline_of_several_classes_is_named_by_its_figure() -> None:
    protocol = PROTOCOLS["kradar"]
    result = {"label": "vehicle, pedestrian", "figures": {}, "ap": {"vehicle": {"3d": {"0.3": 0.5}}}}
    presentation = replace(presentation_of(result), figures=("ap/vehicle/3d/0.3",))
    text = report_text.headline({"os2-64": result}, protocol, presentation)
    assert text.startswith("Vehicle AP3D 0.3, all ranges together (100 is perfect): 50.0 on os2-64.")

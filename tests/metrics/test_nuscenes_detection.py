"""The protocol nuscenes-detection against figures of nuscenes-devkit 1.2.0, and against cases known by hand."""

import json

import numpy as np
import pytest
from _nuscenes_tree import write_results, write_tree

from farfield.cli import main
from farfield.datasets import open_dataset
from farfield.errors import ConfigError
from farfield.evaluation import read_detections
from farfield.frame import Annotation, Boxes
from farfield.metrics import Bootstrap, Detections, score
from farfield.metrics.comparing import compare, read_results
from tests.datasets.generators.nuscenes_trees import write_nuscenes

KIT = {  # of the tree below: benchmarks/nuscenes_devkit.py task compares every figure
    "nds": 0.3339847036802832,
    "map": 0.2188098485781918,
    "errors/trans_err": 0.5312379741104841,
    "errors/scale_err": 0.19797585251161715,
    "errors/orient_err": 0.08990918760574927,
    "errors/vel_err": 2.845634165198529,
    "errors/attr_err": 0.9350791918602766,
}
NONE = Bootstrap(replicates=0)


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    folder = tmp_path_factory.mktemp("task")
    write_tree(folder / "tree")
    write_results(folder / "tree", folder / "results.json")
    return folder


def test_figures_are_those_of_the_devkit_on_the_same_files(tree):
    detections = read_detections(tree / "results.json", tree / "tree", format="nuscenes")
    figures = detections.score("nuscenes-detection", bootstrap=NONE).figures
    for name, value in KIT.items():
        assert figures[name] == pytest.approx(value, abs=1e-9), name


def boxes(x_m, label, *, score=None, velocity=(0.0, 0.0), yaw_rad=0.0, points=5):
    count = len(x_m)
    return Boxes(
        centre_m=np.column_stack([x_m, np.zeros(count), np.zeros(count)]),
        size_m=np.tile([4.0, 2.0, 1.5], (count, 1)),
        yaw_rad=np.full(count, yaw_rad),
        label=label,
        score=None if score is None else np.asarray(score, dtype=float),
        point_count=np.full(count, points) if score is None else None,
        velocity_m_s=np.tile(velocity, (count, 1)),
    )


def case(predicted, annotated, *, attributes=None, found=None, original=None, **options):
    details = {} if attributes is None else {"attribute": np.array(attributes)}
    annotation = Annotation(boxes=annotated, details=details, original_label=original)
    key = ("a", "0")
    rows = {} if found is None else {key: {"attribute": np.array(found)}}
    detections = Detections(boxes={key: predicted}, annotations={key: annotation}, prediction_details=rows)
    return detections.score("nuscenes-detection", bootstrap=NONE, **options)


CARS = np.arange(5.0, 45.0, 4.0)


def test_a_perfect_detector_of_all_that_is_there_scores_one():
    truth = boxes(CARS, "car")
    kinds = ["vehicle.moving"] * len(CARS)
    result = case(
        boxes(CARS, "car", score=np.linspace(0.5, 0.9, 10)), truth, attributes=kinds, found=kinds, label="car"
    )
    assert result.figures["nds"] == pytest.approx(1)
    assert result.figures["map"] == pytest.approx(1)


def test_classes_of_which_nothing_is_annotated_count_as_nothing_unless_left_out():
    truth, found = boxes(CARS, "car"), boxes(CARS, "car", score=np.linspace(0.5, 0.9, 10))
    assert case(found, truth).figures["map"] == pytest.approx(0.1)
    assert case(found, truth, absent="left_out").figures["map"] == pytest.approx(1)


def test_velocity_and_attribute_errors_are_means_over_those_that_are_known():
    truth = boxes(CARS, "car", velocity=(3.0, 4.0))
    unknown = np.where(np.arange(10)[:, None] < 4, np.nan, truth.velocity_m_s)
    truth = truth.replace(velocity_m_s=unknown)
    found = boxes(CARS, "car", score=np.linspace(0.9, 0.5, 10))
    kinds = ["vehicle.parked"] * 5 + [""] * 5
    result = case(found, truth, attributes=kinds, found=["vehicle.moving"] * 10, label="car")
    assert result.figures["errors/attr_err"] == pytest.approx(1)
    running = [0.0] * 4 + [5.0] * 6  # of the matches, best first; 0 as in the devkit where none is known
    recalls = np.interp(np.linspace(0.9, 0.5, 10), np.linspace(0.5, 0.9, 10), running[::-1])
    assert result.figures["errors/vel_err"] == pytest.approx(
        np.interp(np.arange(11, 101), np.arange(10, 101, 10), recalls).mean()
    )


def test_a_barrier_the_other_way_round_is_right_and_a_car_is_not():
    for label, expected in (("barrier", 0.0), ("car", np.pi)):
        truth, found = boxes(CARS[:5], label), boxes(CARS[:5], label, score=np.full(5, 0.5), yaw_rad=np.pi)
        figures = case(found, truth, label=label).figures
        assert figures[f"class_errors/{label}/orient_err"] == pytest.approx(expected, abs=1e-9)


def test_boxes_beyond_their_class_or_without_points_do_not_count():
    truth = boxes([10.0, 45.0], ["pedestrian", "pedestrian"])
    assert case(boxes([10.0], "pedestrian", score=[0.5]), truth).counts["by_class"]["pedestrian"] == [1, 1]
    near = case(boxes([10.0], "pedestrian", score=[0.5]), truth)
    assert any(note.startswith("1 annotated boxes lie beyond the range") for note in near.notes)
    everywhere = case(boxes([10.0], "pedestrian", score=[0.5]), truth, ranges="none")
    assert not any("beyond the range" in note for note in everywhere.notes)
    assert everywhere.counts["by_class"]["pedestrian"] == [2, 1]
    truth = boxes([10.0, 20.0, 30.0, 9.0], ["pedestrian", "vehicle.ego_trailer", "vehicle.ego_trailer", "animal"])
    other = case(boxes([10.0], "pedestrian", score=[0.5]), truth, original=tuple(truth.label))
    (note,) = (note for note in other.notes if "none of the task's" in note)
    assert note.startswith("2 annotated boxes of classes that are none of the task's (vehicle.ego_trailer)")
    empty = case(boxes([10.0], "pedestrian", score=[0.5]), boxes([10.0], "pedestrian", points=0))
    assert empty.counts["by_class"]["pedestrian"] == [0, 1]


def test_bicycles_in_a_rack_are_left_out_on_both_sides():
    truth = boxes([10.0, 10.0, 20.0], ["unknown", "bicycle", "bicycle"])
    original = ("static_object.bicycle_rack", "vehicle.bicycle", "vehicle.bicycle")
    found = boxes([10.5, 20.0], "bicycle", score=[0.9, 0.5])
    assert case(found, truth, original=original).counts["by_class"]["bicycle"] == [1, 1]
    assert case(found, truth, original=original, racks=False).counts["by_class"]["bicycle"] == [2, 2]


def test_categories_that_the_task_does_not_know_are_no_class_of_it():
    truth = boxes([10.0, 20.0], ["vehicle", "vehicle"])
    original = ("vehicle.car", "vehicle.emergency.police")
    result = case(boxes([10.0], "vehicle", score=[0.9]), truth, original=original)
    assert result.counts["by_class"]["car"] == [1, 1]


def test_of_many_predictions_the_best_count_and_it_is_said():
    truth = boxes(CARS, "car")
    found = boxes(np.full(600, 10.0), "car", score=np.linspace(0.1, 0.9, 600))
    result = case(found, truth)
    assert result.counts["by_class"]["car"] == [10, 500]
    assert any("100 predictions" in note for note in result.notes)


def test_results_in_the_world_need_to_say_where_the_car_was(tree, tmp_path):
    far = json.loads((tree / "results.json").read_text())
    path = tmp_path / "far.json"
    path.write_text(json.dumps(far))
    with pytest.raises(ConfigError, match="nothing says where it was"):
        read_detections(path, path, format="nuscenes").score("nuscenes-detection")


def test_samples_of_other_data_are_refused_and_scenes_without_results_left_out(tree, tmp_path):
    whole = json.loads((tree / "results.json").read_text())
    strange = whole["results"] | {"f" * 32: []}
    (tmp_path / "strange.json").write_text(json.dumps({**whole, "results": strange}))
    with pytest.raises(ConfigError, match="expected sample tokens"):
        read_detections(tmp_path / "strange.json", tree / "tree", format="nuscenes")
    first = dict(list(whole["results"].items())[:20])
    (tmp_path / "first.json").write_text(json.dumps({**whole, "results": first}))
    part = read_detections(tmp_path / "first.json", tree / "tree", format="nuscenes")
    assert len(part.annotations) == 20
    assert any("scenes without results" in note for note in part.notes)


def test_samples_of_another_dialect_say_that_the_task_is_not_theirs(tmp_path):
    write_nuscenes(tmp_path / "tree", dialect="truckscenes", samples=1)
    tokens = open_dataset(tmp_path / "tree").frame_ids
    path = tmp_path / "results.json"
    path.write_text(json.dumps({"meta": {"use_lidar": True}, "results": {token: [] for token in tokens}}))
    notes = read_detections(path, tmp_path / "tree", format="nuscenes").notes
    assert any("MAN TruckScenes" in note and "not those of its own task" in note for note in notes)


def test_the_command_scores_and_results_compare(tree, tmp_path, capsys):
    files = [str(tree / "results.json"), str(tree / "tree"), "--format", "nuscenes"]
    out = tmp_path / "score.json"
    words = ["--protocol", "nuscenes-detection", "--replicates", "20", "--range-bins-m", "0,25,50"]
    assert main(["score", *files, *words, "--json", str(out)]) == 0
    assert "NDS" in capsys.readouterr().out
    result = json.loads(out.read_text())
    assert result["nds"] == pytest.approx(KIT["nds"], abs=1e-9)
    assert set(result["ranges"]) == {"0-25", "25-50"}
    assert "NDS" in str(compare(read_results([out, out])))


def test_scores_of_boxes_in_memory_take_the_protocol_by_name():
    truth = {("a", "0"): boxes(CARS, "vehicle")}
    found = {("a", "0"): boxes(CARS, "vehicle", score=np.full(10, 0.5))}
    assert score(found, truth, protocol="nuscenes-detection").figures["ap/car/mean"] == pytest.approx(1)

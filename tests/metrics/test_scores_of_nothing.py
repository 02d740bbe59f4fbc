"""A score of nothing says so; settings are numbers; a mapping adds to the protocol's own; labels have a fingerprint."""

import json
from pathlib import Path

import numpy as np
import pytest

import farfield as ff
from farfield.cli import main
from farfield.errors import ConfigError
from farfield.files.boxes_csv import BoxRows, write_boxes_csv
from farfield.frame import Annotation, Boxes
from farfield.metrics import Bootstrap, Detections
from farfield.metrics.box_files import read
from farfield.metrics.detections import PROTOCOLS

NO_BOOTSTRAP = Bootstrap(replicates=0)


def _cars(count: int = 12, label: str = "vehicle", offset_m: float = 0.0, left_m: float = 0.0) -> Boxes:
    x_m = np.linspace(10, 60, count)
    return Boxes(
        centre_m=np.column_stack([x_m + offset_m, np.full(count, left_m), np.zeros(count)]),
        size_m=np.tile([4.5, 1.9, 1.6], (count, 1)),
        yaw_rad=np.zeros(count),
        label=label,
    )


def _frames(boxes: Boxes, frames: int = 4) -> dict[tuple[str, str], Annotation]:
    return {(str(number % 2), str(number)): Annotation(boxes=boxes) for number in range(frames)}


def _scored(boxes: Boxes, seed: int = 0) -> Boxes:
    return boxes.replace(score=np.random.default_rng(seed).uniform(0.3, 1, len(boxes)))


# Settings


NAN = float("nan")


@pytest.mark.parametrize(
    ("protocol", "settings"),
    [
        ("dds", {"epsilons": (NAN,)}),
        ("dds", {"epsilons": (0.0, float("inf"))}),
        ("dds", {"thresholds_m": (0.5, NAN)}),
        ("dds", {"thresholds_m": (float("inf"),)}),
        ("dds", {"aiou_threshold_m": NAN}),
        ("dds", {"window_m": (0.0, NAN, -50.0, 50.0)}),
        ("nuscenes", {"epsilons": (NAN,)}),
        ("kradar", {"origin_m": (NAN, 0.0, 0.0)}),
        ("kradar", {"z_center": NAN}),
        ("tracking", {"iou": NAN}),
        ("tracking", {"least_track_score": NAN}),
        ("nuscenes-tracking", {"distance_m": NAN}),
    ],
)
def test_a_setting_that_is_no_number_is_refused(protocol: str, settings: dict[str, object]) -> None:
    if next(iter(settings)) not in PROTOCOLS[protocol].options():
        pytest.skip("no such setting")
    detections = Detections(boxes={("0", "0"): _scored(_cars())}, annotations=_frames(_cars(), 1))
    with pytest.raises(ConfigError, match=f"{next(iter(settings))}.*(finite|positive|expected)"):
        detections.score(protocol, **settings)


# The classes that count as another


def test_a_mapping_of_classes_is_added_to_the_protocols_own() -> None:
    labels = Boxes.concatenate([_cars(), _cars(4, "large_vehicle", left_m=9.0), _cars(3, "Lorry", left_m=-9.0)])
    detections = Detections(
        boxes={
            key: _scored(labels.relabel({"large_vehicle": "vehicle", "Lorry": "vehicle"})) for key in _frames(labels)
        },
        annotations=_frames(labels),
    )
    result = detections.score("dds", bootstrap=NO_BOOTSTRAP, relabel={"Lorry": "vehicle"})
    assert result.settings["relabel"] == {"large_vehicle": "vehicle", "Lorry": "vehicle"}
    assert result.counts["annotated"] == 4 * 19
    assert any(
        "large_vehicle counts as vehicle" in note and "large_vehicle:large_vehicle" in note for note in result.notes
    )
    apart = detections.score("dds", bootstrap=NO_BOOTSTRAP, label="vehicle", relabel={"large_vehicle": "large_vehicle"})
    assert apart.counts["annotated"] == 4 * 12
    none = detections.score("dds", bootstrap=NO_BOOTSTRAP, label="vehicle", relabel={})
    assert none.counts["annotated"] == 4 * 12
    renamed = detections.score("dds", bootstrap=NO_BOOTSTRAP, label="Car", relabel={"vehicle": "Car"})
    assert renamed.counts["annotated"] == 4 * 16


def test_a_mapping_is_added_to_that_of_kradar() -> None:
    labels = Boxes.concatenate([_cars(6, "Sedan"), _cars(3, "Taxi", left_m=5.0)])
    detections = Detections(
        boxes={key: _scored(labels) for key in _frames(labels)}, annotations=_frames(labels), reference="radar"
    )
    result = detections.score("kradar", bootstrap=NO_BOOTSTRAP, relabel={"Taxi": "vehicle"})
    assert result.counts["classes"]["vehicle"]["annotated"] == 4 * 9


# Few matches, one object


def test_a_fit_of_a_few_chance_matches_is_said() -> None:
    predicted = _scored(Boxes.concatenate([_cars(40)[:4], _cars(20, offset_m=500.0)]), 2)
    detections = Detections(boxes={("0", "0"): predicted}, annotations={("0", "0"): Annotation(boxes=_cars(40)[:30])})
    result = detections.score("dds", bootstrap=NO_BOOTSTRAP, region="none")
    assert result.counts["matches"] == 4
    assert any("4 matches" in note and "chance" in note for note in result.notes)
    many = Detections(boxes={k: _scored(_cars()) for k in _frames(_cars())}, annotations=_frames(_cars()))
    many_result = many.score("dds", bootstrap=NO_BOOTSTRAP)
    assert many_result.counts["matches"] == 48
    assert not any("chance" in note for note in many_result.notes)


@pytest.mark.parametrize("protocol", ["dds", "nuscenes", "kradar", "kitti"])
def test_one_object_has_no_interval(protocol: str) -> None:
    one = {("0", "0"): Annotation(boxes=_cars(1)), ("1", "1"): Annotation(boxes=Boxes.empty())}
    one |= {("1", str(number)): Annotation(boxes=Boxes.empty()) for number in range(2, 9)}
    boxes = {key: _scored(_cars(1, offset_m=0.0 if key == ("0", "0") else 9.0)) for key in one}
    detections = Detections(boxes=boxes, annotations=one, reference="radar")
    result = detections.score(protocol, bootstrap=Bootstrap(replicates=50))
    spans = [span for part in result.intervals.values() for span in part.values()]
    assert not any(spans)
    assert any("one annotated object" in note for note in result.notes)


# Files


def _csv(path: Path, boxes: Boxes, frames: int = 3) -> Path:
    count = len(boxes)
    columns = {
        "frame": np.repeat([str(number) for number in range(frames)], count),
        "label": np.tile(boxes.label, frames),
        "centre_m": np.tile(boxes.centre_m, (frames, 1)),
        "size_m": np.tile(boxes.size_m, (frames, 1)),
        "yaw_rad": np.tile(boxes.yaw_rad, frames),
    }
    score = None if boxes.score is None else np.tile(boxes.score, frames)
    write_boxes_csv(path, BoxRows(**columns, score=score))
    return path


def test_classes_that_no_label_has_end_with_exit_status_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    predictions = _csv(tmp_path / "p.csv", _scored(_cars()))
    labels = _csv(tmp_path / "l.csv", _cars(label="Auto"))
    assert main(["score", str(predictions), str(labels), "--replicates", "0"]) == 1
    assert "no predicted box is of a class that is annotated" in capsys.readouterr().out
    assert main(["score", str(predictions), str(labels), "--replicates", "0", "--options", "relabel=Auto:vehicle"]) == 0


def test_a_mapping_beside_the_labels_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    predictions = _csv(tmp_path / "p.csv", _scored(_cars()))
    (tmp_path / "l").mkdir()
    labels = _csv(tmp_path / "l" / "l.csv", _cars(label="Auto"))
    (tmp_path / "l" / "mapping.yaml").write_text("classes: {Auto: vehicle}\n")
    assert main(["score", str(predictions), str(labels), "--replicates", "0"]) == 1
    printed = capsys.readouterr().out
    assert "mapping.yaml" in printed
    assert "--options relabel=" in printed


def _nuscenes(path: Path, boxes: Boxes, ego_m: np.ndarray, *, with_ego: bool) -> Path:
    rows = [
        {
            "sample_token": "t",
            "translation": (boxes.centre_m[i] + ego_m).tolist(),
            "size": boxes.size_m[i][[1, 0, 2]].tolist(),
            "rotation": [1.0, 0.0, 0.0, 0.0],
            "velocity": [0.0, 0.0],
            "detection_name": "car",
            "detection_score": -1.0 if boxes.score is None else float(boxes.score[i]),
            **({"ego_translation": boxes.centre_m[i].tolist()} if with_ego else {}),
        }
        for i in range(len(boxes))
    ]
    path.write_text(json.dumps({"meta": {}, "results": {"t": rows}}))
    return path


def test_ranges_of_boxes_in_the_world_are_from_the_ego_or_not_at_all(tmp_path: Path) -> None:
    ego_m = np.array([600.0, 1600.0, 0.0])
    predictions = _nuscenes(tmp_path / "p.json", _scored(_cars()), ego_m, with_ego=False)
    labels = _nuscenes(tmp_path / "l.json", _cars(), ego_m, with_ego=True)
    settings = {"bootstrap": NO_BOOTSTRAP, "label": "car", "region": "none", "range_bins_m": (0.0, 30.0, 100.0)}
    near = read(predictions, labels, format="nuscenes").score("nuscenes", **settings)
    assert near.counts["ranges"]["0-30"]["annotated"] == int((_cars().range_m < 30).sum())
    assert near.ranges["0-30"]["map"] == pytest.approx(1.0)
    without = _nuscenes(tmp_path / "w.json", _cars(), ego_m, with_ego=False)
    world = read(predictions, without, format="nuscenes").score("nuscenes", **settings)
    assert world.figures["map"] == pytest.approx(1.0)
    assert all(value is None for part in world.ranges.values() for value in part.values())
    assert any("ego_translation" in note for note in world.notes)


# The labels' fingerprint


def test_two_trackers_on_one_folder_of_labels_are_of_the_same_data(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    labels = _csv(tmp_path / "l.csv", _cars())
    names = []
    for name, frames in (("a", 3), ("b", 5)):  # the second one has boxes in frames without a label
        predictions = _csv(tmp_path / f"{name}.csv", _scored(_cars(), frames), frames)
        names.append(str(tmp_path / f"{name}.json"))
        assert main(["score", str(predictions), str(labels), "--replicates", "0", "--json", names[-1]]) == 0
    capsys.readouterr()
    assert main(["compare-results", *names]) == 0
    printed = capsys.readouterr().out
    assert "not the same data" not in printed
    assert "None" not in printed
    moved = _csv(tmp_path / "m.csv", _cars(offset_m=0.01))
    third = str(tmp_path / "c.json")
    assert main(["score", str(tmp_path / "a.csv"), str(moved), "--replicates", "0", "--json", third]) == 0
    capsys.readouterr()
    assert main(["compare-results", names[0], third]) == 0
    assert "not the same data" in capsys.readouterr().out


def test_the_epsilons_flag_takes_numbers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    predictions, labels = _csv(tmp_path / "p.csv", _scored(_cars())), _csv(tmp_path / "l.csv", _cars())
    assert main(["score", str(predictions), str(labels), "--epsilons", "nan"]) != 0
    assert "epsilons" in capsys.readouterr().err


def test_evaluate_takes_the_same_mapping() -> None:
    frames = [ff.Frame.of(np.zeros((1, 4)), _cars(label="Auto"), sequence="s", frame_id=str(n)) for n in range(3)]
    predictions = {frame.key: _scored(_cars()) for frame in frames}
    result = ff.evaluate(predictions, frames, relabel={"Auto": "vehicle"}, bootstrap=NO_BOOTSTRAP)
    assert result.counts["annotated"] == 36

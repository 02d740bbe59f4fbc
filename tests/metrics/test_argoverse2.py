"""Argoverse 2's metrics: the kit's own fixtures, a slow second implementation, and what each rule leaves out."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from farfield.errors import ConfigError
from farfield.frame.annotation import Annotation
from farfield.geometry.boxes import Boxes
from farfield.metrics import PROTOCOLS, Detections
from farfield.metrics.argoverse2.evaluation import evaluate_argoverse2
from farfield.metrics.argoverse2.settings import CATEGORIES, Argoverse2Settings
from farfield.metrics.bootstrap import Bootstrap
from farfield.metrics.comparing import compare, read_results
from farfield.testing import check_protocol

from .scenes import NO_BOOTSTRAP, boxes, random_scene

PLAIN = Argoverse2Settings(classes=("vehicle",), bootstrap=NO_BOOTSTRAP)

# argoverse/av2-api b7321d1 (MIT), tests/unit/evaluation/detection/data: sweep, x, y, z, length, yaw, score; boxes are
# 2 m wide and high. The labels' boxes stand at 0 0 0 and 2 2 0 of three sweeps; yaw is that of the turned x axis.
HALF = np.pi
LABELS = (
    (0, 0, 0, 0, 2, 0),
    (0, 2, 2, 0, 2, HALF),
    (1, 0, 0, 0, 2, HALF),
    (1, 2, 2, 0, 2, HALF),
    (2, 0, 0, 0, 2, 0),
    (2, 2, 2, 0, 2, HALF),
)
IDENTITY = tuple((*row, 1.0) for row in LABELS)
DETECTIONS = (
    (0, 0, 0, 0.1, 2, 0, 1.0),
    (0, 2, 2, 0, 2, HALF, 1.0),
    (1, 0, 0, 0, 2.5, HALF, 1.0),
    (1, 2, 2, 0, 2, HALF, 1.0),
    (2, 0, 0, 0, 2, 0, 1.0),
    (2, 2, 2, 0, 2, 0, 1.0),
)
ASSIGNMENT = (
    (0, 0, 0, 0, 2, 0, 0.9),
    (0, 2, 2, 0, 2, HALF, 0.9),
    (0, 2, 2, 0, 2, HALF, 1.0),
    *IDENTITY[2:],
)


def kit_boxes(rows: Any) -> dict[tuple[str, str], Boxes]:
    table = np.array(rows, dtype=np.float64)
    frames = {}
    for frame in range(3):
        part = table[table[:, 0] == frame]
        frames["log", str(frame)] = Boxes(
            centre_m=part[:, 1:4],
            size_m=np.column_stack([part[:, 4], np.full((len(part), 2), 2.0)]),
            yaw_rad=part[:, 5],
            label="REGULAR_VEHICLE",
            score=part[:, 6] if table.shape[1] > 6 else None,
            point_count=None if table.shape[1] > 6 else np.ones(len(part), dtype=np.int64),
        )
    return frames


def kit_labels() -> dict[tuple[str, str], Boxes]:
    return kit_boxes(LABELS)


def scored(frames: dict[tuple[str, str], Boxes]) -> dict[tuple[str, str], Boxes]:
    return {key: part.replace(score=np.ones(len(part)), point_count=None) for key, part in frames.items()}


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (IDENTITY, {"ap": 1.0, "ate": 0.0, "ase": 0.0, "aoe": 0.0, "cds": 1.0}),
        (
            DETECTIONS,
            {"ap": 1.0, "ate": 0.1 / 6, "ase": 0.2 / 6, "aoe": np.pi / 6, "cds": (3 - 1 / 120 - 1 / 30 - 1 / 6) / 3},
        ),
        (ASSIGNMENT, {"ap": (100 + 6 / 7) / 101, "ate": 0.0, "ase": 0.0, "aoe": 0.0}),
    ],
)
def test_the_figures_of_the_kits_fixtures(found: Any, expected: dict[str, float]) -> None:
    settings = Argoverse2Settings(classes=("REGULAR_VEHICLE",), bootstrap=NO_BOOTSTRAP)
    figures = evaluate_argoverse2(kit_boxes(found), kit_labels(), settings).figures
    for name, value in expected.items():
        assert figures[f"ap/REGULAR_VEHICLE/{name}"] == pytest.approx(value, abs=1e-12)
        assert figures[f"ap/mean_of_all/{name}"] == pytest.approx(value, abs=1e-12)


def slow(predictions: Any, annotations: Any, settings: Argoverse2Settings) -> dict[str, float]:
    """One category, a frame after the other, as the kit goes about it."""
    label = settings.classes[0]
    rows: list[tuple[float, ...]] = []
    total = 0
    for key in annotations:
        truth, found = annotations[key], predictions.get(key, Boxes.empty(scored=True))
        counts = np.ones(len(truth)) if truth.point_count is None else truth.point_count
        near = np.linalg.norm(truth.centre_m, axis=1) < settings.max_range_m
        truth = truth[(truth.label == label) & near & (counts > 0)]
        found = found[(found.label == label) & (np.linalg.norm(found.centre_m, axis=1) < settings.max_range_m)]
        found = found[np.argsort(-found.score, kind="stable")][: settings.max_boxes]
        total += len(truth)
        taken = set()
        distance = cdist(found.centre_m, truth.centre_m) if len(truth) and len(found) else None
        for row in range(len(found)):
            best = -1 if distance is None else int(distance[row].argmin())
            first = best >= 0 and best not in taken
            taken.add(best)
            if not first or distance is None:
                rows.append((found.score[row], np.inf, 0, 0))
                continue
            small = np.minimum(found.size_m[row], truth.size_m[best]).prod()
            large = np.maximum(found.size_m[row], truth.size_m[best]).prod()
            turn = abs((found.yaw_rad[row] - truth.yaw_rad[best] + np.pi) % (2 * np.pi) - np.pi)
            rows.append((found.score[row], distance[row, best], 1 - small / large, turn))
    table = np.array(sorted(rows, key=lambda row: -row[0])).reshape(-1, 4)
    values = []
    for threshold in settings.thresholds_m:
        is_true = table[:, 1] < threshold
        precision = np.cumsum(is_true) / np.arange(1, len(table) + 1)
        precision = np.maximum.accumulate(precision[::-1])[::-1]
        sampled = np.interp(np.linspace(0, 1, 101), np.cumsum(is_true) / total, precision, right=0)
        values.append(float(sampled.mean()) if is_true.any() else 0.0)
    near = table[:, 1] < settings.error_threshold_m
    errors = table[near, 1:].mean(axis=0) if near.any() else np.array([settings.error_threshold_m, 1, np.pi])
    ap = float(np.mean(values))
    cds = ap * float(np.mean(1 - errors / [settings.error_threshold_m, 1, np.pi]))
    return dict(zip(("ap", "ate", "ase", "aoe", "cds"), (ap, *errors, cds), strict=True))


def test_it_equals_a_slow_second_implementation(rng: np.random.Generator) -> None:
    for number in range(12):
        predictions, annotations = random_scene(rng)
        unique = {
            key: part.replace(score=rng.permutation(len(part)) / 100 + int(key[1]) / 1e4 + 1e-6)
            for key, part in predictions.items()
        }
        settings = replace(PLAIN, max_boxes=3 if number % 2 else 100)
        expected = slow(unique, annotations, settings)
        figures = evaluate_argoverse2(unique, annotations, settings).figures
        for name, value in expected.items():
            assert figures[f"ap/vehicle/{name}"] == pytest.approx(value, abs=1e-12), name


def test_a_sure_detection_farther_away_blocks_a_less_sure_one() -> None:
    truth = {("a", "0"): boxes([(10, 0, 0, 4, 2, 1.5, 0, 0)], scored=False)}
    found = {("a", "0"): boxes([(13, 0, 0, 4, 2, 1.5, 0, 0.9), (10.1, 0, 0, 4, 2, 1.5, 0, 0.5)])}
    figures = evaluate_argoverse2(found, truth, PLAIN).figures
    last = 100.5 / 101  # at recall 1 itself the kit takes the precision of all detections
    assert [figures[f"ap/vehicle/ap_{t}"] for t in ("0.5", "1", "2", "4")] == [0, 0, 0, pytest.approx(last)]
    assert (figures["ap/vehicle/ate"], figures["ap/vehicle/ase"], figures["ap/vehicle/aoe"]) == (2.0, 1.0, np.pi)
    near = {key: part.replace(score=part.score[::-1]) for key, part in found.items() if part.score is not None}
    assert evaluate_argoverse2(near, truth, PLAIN).figures["ap/vehicle/ap"] == pytest.approx(last)
    edge = {("a", "0"): boxes([(12, 0, 0, 4, 2, 1.5, 0, 0.9)])}
    assert evaluate_argoverse2(edge, truth, PLAIN).figures["ap/vehicle/ap_2"] == 0.0  # 2 m is not nearer than 2 m


def test_every_rule_says_how_many_boxes_it_left_out() -> None:
    rows = [(5.0, 0, 0, 4, 2, 1.5, 0, 0.0), (160.0, 0, 0, 4, 2, 1.5, 0, 0), (9.0, 9, 0, 4, 2, 1.5, 0, 0)]
    truth = boxes(rows, scored=False).replace(point_count=np.array([3, 3, 0]))
    other = boxes([(20, 0, 0, 1, 1, 1, 0, 0)], scored=False, label="cone").replace(point_count=np.array([1]))
    found = boxes([(*row[:7], 0.5 + number / 10) for number, row in enumerate(rows)])
    result = evaluate_argoverse2(
        {("a", "0"): found}, {("a", "0"): Boxes.concatenate([truth, other])}, replace(PLAIN, max_boxes=1)
    )
    counts = result.counts
    assert (counts["annotated"], counts["predictions"]) == (1, 1)
    assert counts["annotated_without_points"] == counts["annotated_out_of_range"] == 1
    assert counts["predictions_out_of_range"] == counts["predictions_over_limit"] == 1
    assert counts["annotated_of_other_classes"] == 1
    assert "1 predicted boxes are beyond the 1 best of a sweep and category" in " ".join(result.notes)
    text = str(result)
    assert "region of interest" in text
    assert "mean of all" in text


def test_bins_reach_beyond_150_m_and_are_cut_by_the_distance_in_space() -> None:
    rows = [(x, 0.0, 0.0, 4, 2, 1.5, 0, 0.9) for x in (10.0, 120.0, 200.0)] + [(140.0, 60.0, 0, 4, 2, 1.5, 0, 0.8)]
    truth, found = {("a", "0"): boxes(rows, scored=False)}, {("a", "0"): boxes(rows[:3])}
    result = evaluate_argoverse2(found, truth, replace(PLAIN, range_bins_m=(0.0, 50.0, 150.0, 250.0)))
    ap = {part: figures["ap/vehicle/ap"] for part, figures in result.ranges.items()}
    assert ap == {"0-50": 1.0, "50-150": 1.0, "150-250": pytest.approx(51 / 101)}
    assert result.figures["ap/vehicle/ap"] == 1.0
    assert result.counts["annotated"] == 2
    assert result.counts["ranges"]["150-250"]["annotated"] == 2


def test_categories_without_annotation_count_as_zero_in_the_mean_of_all() -> None:
    labels = kit_labels()
    detections = Detections(boxes=scored(labels), annotations={k: Annotation(boxes=b) for k, b in labels.items()})
    result = detections.score("argoverse2")
    assert tuple(result.settings["classes"]) == CATEGORIES
    assert len(CATEGORIES) == 26
    assert result.figures["ap/mean_of_all/ap"] == pytest.approx(1 / 26)
    assert result.figures["ap/mean_of_all/ate"] == pytest.approx(25 * 2 / 26)
    assert result.figures["ap/mean_of_all/aoe"] == pytest.approx(25 * np.pi / 26)
    assert result.figures["ap/mean_of_present/cds"] == 1.0
    assert result.figures["ap/PEDESTRIAN/ap"] is None
    assert "1 of 26 categories are annotated" in " ".join(result.notes)
    assert detections.score("argoverse2", label="REGULAR_VEHICLE").figures["ap/mean_of_all/ap"] == 1.0


def test_the_protocol_keeps_what_all_promise_and_its_results_stand_side_by_side(tmp_path: Any) -> None:
    check_protocol("argoverse2")
    labels = kit_labels()
    detections = Detections(boxes=scored(labels), annotations={k: Annotation(boxes=b) for k, b in labels.items()})
    paths = [tmp_path / "a.json", tmp_path / "b.json"]
    for path in paths:
        path.write_text(json.dumps(detections.score("argoverse2").to_json()))
    text = compare(read_results(paths))
    assert "argoverse2, mean_of_all" in text
    assert "argoverse2, REGULAR_VEHICLE" in text
    assert "argoverse2, PEDESTRIAN" not in text
    far = detections.score("argoverse2", max_range_m=200.0)
    paths[1].write_text(json.dumps(far.to_json()))
    with pytest.raises(ConfigError, match="max_range_m"):
        compare(read_results(paths))


def test_intervals_are_those_of_the_figures_under_weights(rng: np.random.Generator) -> None:
    predictions, annotations = random_scene(rng)
    detections = Detections(boxes=predictions, annotations={k: Annotation(boxes=b) for k, b in annotations.items()})
    protocol = PROTOCOLS["argoverse2"]
    settings = protocol.settings(detections, bootstrap=Bootstrap(replicates=20))
    result, weighted = protocol.evaluate(detections, settings), protocol.weighted(detections, settings)
    groups = max(weighted.groups) + 1
    for part, figures in {"overall": result.figures, **result.ranges}.items():
        ones = weighted.parts[part](np.ones((1, groups)))
        for name, value in figures.items():
            assert value is None or ones[name][0] == pytest.approx(value, abs=1e-12)
    # Drawing a drive twice is what the same drive recorded twice would give.
    twice = np.where(np.arange(groups) == 0, 2.0, 1.0)[None]
    again = {("again", key[1]): key for key in annotations if key[0] == "drive0"}
    doubled = evaluate_argoverse2(
        predictions | {new: predictions[old] for new, old in again.items()},
        annotations | {new: annotations[old] for new, old in again.items()},
        replace(settings, bootstrap=NO_BOOTSTRAP),
    )
    drawn = weighted.parts["overall"](twice)
    for name in ("ate", "ase", "aoe"):
        assert drawn[f"ap/vehicle/{name}"][0] == pytest.approx(doubled.figures[f"ap/vehicle/{name}"], abs=1e-12)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"thresholds_m": (2.0, 1.0)}, "thresholds_m"),
        ({"error_threshold_m": 3.0}, "error_threshold_m"),
        ({"max_boxes": 0}, "max_boxes"),
        ({"classes": ()}, "classes"),
        ({"classes": ("a/b",)}, "slash"),
        ({"range_bins_m": (10.0, 5.0)}, "range_bins_m"),
    ],
)
def test_impossible_settings_are_refused(options: dict[str, Any], word: str) -> None:
    with pytest.raises(ConfigError, match=word):
        Argoverse2Settings(**options)

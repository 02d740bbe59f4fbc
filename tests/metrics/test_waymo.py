"""Waymo's metrics: their own fixtures, a slow second implementation, and LET by its paper."""

import csv
import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from farfield.errors import ConfigError
from farfield.frame.annotation import Annotation
from farfield.geometry.boxes import Boxes, wrap_angle_rad
from farfield.geometry.iou import paired_iou, pairwise_iou
from farfield.metrics import PROTOCOLS, Detections
from farfield.metrics.waymo.evaluation import (
    WaymoFrames,
    WaymoResult,
    aligned_boxes,
    area_below,
    evaluate_waymo,
    gather_waymo,
    waymo_result,
)
from farfield.metrics.waymo.settings import WAYMO_CLASSES, WaymoLetSettings, WaymoSettings
from farfield.testing import check_protocol

from .scenes import NO_BOOTSTRAP, boxes, random_scene

PLAIN = WaymoSettings(bootstrap=NO_BOOTSTRAP)
LOST_PAIR = (0.145, 34.42)  # score and range of the pair that Waymo's polygon code gives no overlap


def read_table(path: Path) -> tuple[dict[Any, Boxes], dict[Any, dict[str, np.ndarray]]]:
    rows: dict[Any, list[dict[str, str]]] = {}
    for row in csv.DictReader(path.read_text().splitlines()):
        rows.setdefault((row["context_name"], row["frame_timestamp_micros"]), []).append(row)
    sides, details = {}, {}
    for key, frame in rows.items():
        column = {name: np.array([row[name] for row in frame]) for name in frame[0]}
        number = {name: values.astype(float) for name, values in column.items() if name not in ("context_name", "id")}
        sides[key] = Boxes(
            centre_m=np.column_stack([number[axis] for axis in "xyz"]),
            size_m=np.column_stack([number[name] for name in ("length", "width", "height")]),
            yaw_rad=number["heading"],
            label=[("unknown", *WAYMO_CLASSES)[int(kind)] for kind in number["type"]],
            score=number["score"],
            point_count=number["num_lidar_points"].astype(int),
        )
        details[key] = {"detection_level": number["detection_difficulty"], "no_label_zone": number["overlap_with_nlz"]}
    return sides, details


@pytest.fixture(scope="module")
def published(shared_real: Path) -> tuple[WaymoFrames, dict[str, Any]]:
    folder = shared_real / "waymo_metrics"
    annotated, levels = read_table(folder / "ground_truths.csv")
    predicted, zones = read_table(folder / "predictions.csv")
    truth = {key: annotated[key].replace(score=None) if key in annotated else Boxes.empty() for key in predicted}
    frames = gather_waymo(predicted, truth, PLAIN, prediction_details=zones, annotation_details=levels)
    return frames, json.loads((folder / "expected.json").read_text())["detection"]


def differences(result: WaymoResult, expected: dict[str, Any]) -> dict[str, float]:
    """By how much each figure differs from that of Waymo's tool."""
    ranges = {"[0, 30)": "0-30", "[30, 50)": "30-50", "[50, +inf)": "50-inf"}
    apart = {}
    for name, values in expected.items():
        words = name.removeprefix("OBJECT_TYPE_").removeprefix("RANGE_").removeprefix("TYPE_").split("_")
        figures = result.ranges[ranges[words[1]]] if name.startswith("RANGE") else result.figures
        for kind, value in values.items():
            figure = f"ap/{words[0].lower()}/level_{words[-1]}/{kind[1:].lower()}"
            apart[f"{name} {kind}"] = abs((figures[figure] or 0.0) - value)
    return apart


def test_the_figures_of_waymos_tool(published: tuple[WaymoFrames, dict[str, Any]]) -> None:
    frames, expected = published
    assert frames.without_points == 105
    apart = differences(waymo_result(frames, PLAIN, 20), expected)
    assert len(apart) == 64
    exceptions = {name for name, value in apart.items() if value > 1e-6}
    assert len(exceptions) == 8
    assert all("VEHICLE" in name and ("OBJECT" in name or "[30, 50)" in name) for name in exceptions)
    # A known fault of Waymo's polygon code: of some 200 pairs of equal boxes turned by pi it finds one not to meet.
    predicted, annotated = frames.frames.predicted, frames.frames.annotated
    box, detection = frames.pair.T
    turned = np.abs(wrap_angle_rad(predicted.boxes.yaw_rad[detection] - annotated.boxes.yaw_rad[box])) > 3.1
    lost = turned & (np.abs(predicted.score[detection] - LOST_PAIR[0]) < 1e-3)
    lost &= (np.abs(predicted.range_m[detection] - LOST_PAIR[1]) < 0.01) & (frames.iou > 0.99)
    assert lost.sum() == 1
    without = replace(frames, iou=np.where(lost, 0.0, frames.iou))
    assert max(differences(waymo_result(without, PLAIN, 20), expected).values()) < 1e-6


def slow_counts(
    predictions: Any, annotations: Any, settings: WaymoSettings, label: str, levels: Any
) -> dict[str, list[float]]:
    """AP and APH of one class: each frame and cut-off matched by itself."""
    least = np.float32(settings.vehicle_iou if label == "vehicle" else settings.other_iou)
    sums = np.zeros((settings.cutoffs, 5))  # true, false, missed at level 1 and 2, heading
    for key, everything in annotations.items():
        truth = everything[everything.label == label]
        level = levels[key][everything.label == label]
        found = predictions.get(key, Boxes.empty(scored=True))
        found = found[found.label == label]
        iou = pairwise_iou(found, truth).astype(np.float32) if len(found) and len(truth) else np.zeros((0, len(truth)))
        for number, cutoff in enumerate(np.linspace(0, 1, settings.cutoffs).astype(np.float32)):
            rows = np.flatnonzero(found.score.astype(np.float32) >= cutoff)
            weight = np.where(iou[rows] >= least, np.rint(iou[rows] * 1e6), 0) if len(truth) else np.zeros((0, 0))
            rows_of, columns_of = linear_sum_assignment(weight, maximize=True)
            pairs = [(i, j) for i, j in zip(rows_of, columns_of, strict=True) if weight[i, j] > 0]
            sums[number, 0] += len(pairs)
            sums[number, 1] += len(rows) - len(pairs)
            left = np.setdiff1d(np.arange(len(truth)), [j for _, j in pairs])
            sums[number, 2:4] += (level[left] <= 1).sum(), len(left)
            turn = np.array([found.yaw_rad[rows[i]] - truth.yaw_rad[j] for i, j in pairs])
            sums[number, 4] += float(np.sum(1 - np.abs(wrap_angle_rad(turn)) / np.pi))
    figures = {}
    for level in (1, 2):
        recall = sums[:, 0] / np.maximum(sums[:, 0] + sums[:, 1 + level], 1)
        positive = np.maximum(sums[:, 0] + sums[:, 1], 1)
        figures[f"level_{level}"] = [slow_area(recall, sums[:, column] / positive) for column in (0, 4)]
    return figures


def slow_area(recalls: Any, precisions: Any) -> float:
    """The area as it is described: points from high recall to low, filled every 0.05, joined by lines."""
    best_of: dict[float, float] = {0.0: 1.0}
    for recall, precision in zip(recalls, precisions, strict=True):
        best_of[recall] = max(best_of.get(recall, 0.0), precision)
    points: list[tuple[float, float]] = []
    last, best = 0.0, 0.0
    for recall in sorted(best_of, reverse=True):
        while last - recall > 0.05 + 1e-6:
            last -= 0.05
            points.append((last, best))
        best = max(best, best_of[recall])
        points.append((recall, best))
        last = recall
    if len(points) > 1:
        points[-1] = (points[-1][0], points[-2][1])
    return sum((a[0] - b[0]) * (a[1] + b[1]) / 2 for a, b in pairwise(points))


def test_it_equals_a_slow_second_implementation(rng: np.random.Generator) -> None:
    settings = replace(PLAIN, vehicle_iou=0.2, other_iou=0.1, cutoffs=11, relabel={})
    tangled = 0
    for _ in range(6):
        predictions, annotations = random_scene(rng)
        level = {key: rng.integers(1, 3, len(part)) for key, part in annotations.items()}
        annotations = {key: part.replace(point_count=None) for key, part in annotations.items()}
        details = {key: {"detection_level": values} for key, values in level.items()}
        found = evaluate_waymo(predictions, annotations, settings, annotation_details=details).figures
        for label in ("vehicle", "pedestrian"):
            expected = slow_counts(predictions, annotations, settings, label, level)
            for name, values in expected.items():
                for kind, value in zip(("ap", "aph"), values, strict=True):
                    figure = found[f"ap/{label}/{name}/{kind}"]
                    tangled += bool(value)
                    assert figure is None or figure == pytest.approx(value, abs=1e-9)
    assert tangled > 10


def test_the_largest_sum_of_overlaps_decides_and_not_the_score() -> None:
    truth = boxes([(10, 0, 0, 4, 2, 1.5, 0, 0), (11.2, 0, 0, 4, 2, 1.5, 0, 0)], scored=False)
    found = boxes([(10.6, 0, 0, 4, 2, 1.5, 0, 0.9), (11.3, 0, 0, 4, 2, 1.5, 0, 0.2)])
    key = ("a", "0")
    result = evaluate_waymo({key: found}, {key: truth}, replace(PLAIN, vehicle_iou=0.5))
    assert result.figures["ap/vehicle/level_1/ap"] == pytest.approx(1.0)
    # The first alone would overlap both alike; where it is the sure one it leaves the second box to the other.
    worse = {key: found[:1]}
    assert evaluate_waymo(worse, {key: truth}, replace(PLAIN, vehicle_iou=0.5)).figures[
        "ap/vehicle/level_1/ap"
    ] == pytest.approx(0.5)


def test_levels_points_zones_and_classes_count_as_waymos_tool_counts_them() -> None:
    rows = [(10.0 + 10 * n, 0, 0, 4, 2, 1.5, 0, 0.5) for n in range(4)]
    truth = boxes(rows, scored=False).replace(point_count=np.array([50, 5, 0, 50]))
    key = ("a", "0")
    found = boxes([rows[0], (99, 0, 0, 4, 2, 1.5, 0, 0.5)])
    result = evaluate_waymo({key: found}, {key: truth}, PLAIN)
    assert result.counts["annotated_without_points"] == 1
    assert result.counts["classes"]["vehicle"]["annotated_level_1"] == 2
    assert result.counts["classes"]["vehicle"]["annotated"] == 3
    figures = result.figures
    assert figures["ap/vehicle/level_1/ap"] == pytest.approx(0.5 * 0.5)
    assert figures["ap/vehicle/level_2/ap"] == pytest.approx(0.5 / 3)
    zone = {key: {"no_label_zone": np.array([0, 1])}}
    excused = evaluate_waymo({key: found}, {key: truth}, PLAIN, prediction_details=zone)
    assert excused.figures["ap/vehicle/level_1/ap"] == pytest.approx(0.5)
    assert excused.counts["predictions_in_no_label_zones"] == 1
    hard = {key: {"detection_level": np.array([2, 2, 2, 2])}}
    said = evaluate_waymo({key: found}, {key: truth}, PLAIN, annotation_details=hard)
    assert said.figures["ap/vehicle/level_1/ap"] is None
    # A match of a hard box counts at level 1 too, where the others need not be found.
    mixed = {key: {"detection_level": np.array([2, 1, 2, 2])}}
    said = evaluate_waymo({key: found[:1]}, {key: truth}, PLAIN, annotation_details=mixed)
    assert said.figures["ap/vehicle/level_1/ap"] == pytest.approx(0.5)


def test_heading_weighs_and_scores_beyond_0_to_1_are_refused() -> None:
    key = ("a", "0")
    truth = {key: boxes([(10, 0, 0, 4, 2, 1.5, 0, 0)], scored=False)}
    for turn, accuracy in ((0.0, 1.0), (np.pi, 0.0), (np.pi / 2, 0.5)):
        found = {key: boxes([(10, 0, 0, 4, 2, 1.5, turn, 0.5)])}
        figures = evaluate_waymo(found, truth, replace(PLAIN, vehicle_iou=0.3)).figures
        assert figures["ap/vehicle/level_1/ap"] == pytest.approx(1.0)
        assert figures["ap/vehicle/level_1/aph"] == pytest.approx(accuracy)
    with pytest.raises(ConfigError, match="scores from 0 to 1"):
        evaluate_waymo({key: boxes([(10, 0, 0, 4, 2, 1.5, 0, 7.0)])}, truth, PLAIN)


def test_a_box_along_the_line_of_sight_is_forgiven_by_let() -> None:
    settings = WaymoLetSettings(bootstrap=NO_BOOTSTRAP, sensor_m=(0.0, 0.0, 0.0))
    key = ("a", "0")
    truth = {key: boxes([(30, 40, 0, 4, 2, 1.5, 0.3, 0)], scored=False)}
    found = {key: boxes([(31.5, 42, 0, 4, 2, 1.5, 0.3, 0.5)])}  # 2.5 m of the 5 m that are allowed
    figures = evaluate_waymo(found, truth, settings).figures
    assert figures["ap/vehicle/level_2/ap"] == pytest.approx(1.0)
    assert figures["ap/vehicle/level_2/apl"] == pytest.approx(0.5)
    assert figures["ap/vehicle/level_2/aph"] == pytest.approx(1.0)
    far = {key: boxes([(33.1, 44.1, 0, 4, 2, 1.5, 0.3, 0.5)])}
    assert evaluate_waymo(far, truth, settings).figures["ap/vehicle/level_2/ap"] == 0.0
    assert evaluate_waymo(found, truth, PLAIN).figures["ap/vehicle/level_2/ap"] == 0.0
    near = {key: boxes([(0.4, 0, 0, 1, 1, 1, 0, 0)], scored=False)}
    seen = {key: boxes([(0.6, 0, 0, 1, 1, 1, 0, 0.5)])}  # 0.2 of the half metre that is always allowed
    assert evaluate_waymo(seen, near, settings).figures["ap/vehicle/level_2/apl"] == pytest.approx(0.6)


def test_let_moves_a_prediction_to_where_it_is_nearest(rng: np.random.Generator) -> None:
    settings = WaymoLetSettings()
    truth = boxes([(*rng.uniform(-60, 60, 3), 4, 2, 1.5, 0, 0) for _ in range(50)], scored=False)
    found = truth.replace(centre_m=truth.centre_m * 1.02 + rng.normal(0, 0.3, (50, 3)), score=np.ones(50))
    moved, affinity = aligned_boxes(truth, found, settings)
    sensor = np.array(settings.sensor_m)
    gap = np.linalg.norm(moved.centre_m - truth.centre_m, axis=1)
    for share in np.linspace(0.9, 1.1, 41):
        other = sensor + (found.centre_m - sensor) * share
        assert (np.linalg.norm(other - truth.centre_m, axis=1) >= gap - 1e-9).all()
    assert ((affinity >= 0) & (affinity <= 1)).all()
    assert paired_iou(truth, moved).mean() > paired_iou(truth, found).mean()


def test_let_takes_boxes_as_the_cameras_see_them() -> None:
    key = ("a", "0")
    stands = boxes([(30, 0, 0, 4, 2, 1.5, 0, 0), (40, 0, 0, 4, 2, 1.5, 0, 0)], scored=False)
    seen = np.array([[20, 0, 0, 4, 2, 1.5, 0], [np.nan] * 7])
    annotation = Annotation(boxes=stands, details={"camera_box": seen, "top_points": np.array([9, 9])})
    found = {key: boxes([(20, 0, 0, 4, 2, 1.5, 0, 0.5)])}
    result = Detections(boxes=found, annotations={key: annotation}).score("waymo-let")
    assert result.figures["ap/vehicle/level_2/apl"] == pytest.approx(1.0)
    assert "1 annotated boxes are in no camera's view" in " ".join(result.notes)
    bare = Detections(boxes=found, annotations={key: Annotation(boxes=stands)}).score("waymo-let")
    assert bare.figures["ap/vehicle/level_2/ap"] == 0.0
    assert "scored as they stand for the LiDAR" in " ".join(bare.notes)


def test_the_area_repeats_the_better_precision_where_recall_leaps() -> None:
    recall, precision = np.array([[0.9, 0.5, 0.5, 0.0]]), np.array([[0.2, 0.8, 0.4, 1.0]])
    assert area_below(recall, precision, 0.05)[0] == pytest.approx(slow_area(recall[0], precision[0]))
    assert area_below(np.zeros((1, 3)), np.ones((1, 3)), 0.05)[0] == 0.0


@pytest.mark.parametrize("name", ["waymo", "waymo-let"])
def test_the_protocols_keep_what_all_promise(name: str, rng: np.random.Generator) -> None:
    check_protocol(name)
    predictions, annotations = random_scene(rng)
    detections = Detections(boxes=predictions, annotations={k: Annotation(boxes=b) for k, b in annotations.items()})
    protocol = PROTOCOLS[name]
    settings = protocol.settings(detections, vehicle_iou=0.2)
    result, weighted = protocol.evaluate(detections, settings), protocol.weighted(detections, settings)
    for part, figures in {"overall": result.figures, **result.ranges}.items():
        ones = weighted.parts[part](np.ones((1, max(weighted.groups) + 1)))
        assert {name: values[0] for name, values in ones.items() if not np.isnan(values[0])} == pytest.approx(
            {name: value for name, value in figures.items() if value is not None}, abs=1e-12
        )
    assert any(result.intervals["overall"].values())


@pytest.mark.parametrize("options", [{"vehicle_iou": 1.0}, {"cutoffs": 1}, {"recall_step": 0.0}, {"hard_points": -1}])
def test_impossible_settings_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=next(iter(options))):
        WaymoSettings(**options)

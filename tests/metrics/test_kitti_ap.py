"""KITTI's average precision against a plain evaluation written from its rules, and worked cases."""

from typing import Any

import numpy as np
import pytest

from farfield.errors import ConfigError
from farfield.geometry.boxes import Boxes
from farfield.geometry.iou import pairwise_iou
from farfield.metrics import Bootstrap, KittiSettings, evaluate_kitti
from farfield.metrics.kitti.evaluation import DIFFICULTIES
from farfield.metrics.recall_sampling import sample_thresholds

from .scenes import NO_BOOTSTRAP, ByFrame, as_predictions, boxes, car

Details = dict[tuple[str, str], dict[str, np.ndarray]]


def scene(rng: np.random.Generator, *, frames: int = 40) -> tuple[ByFrame, ByFrame, Details, Details]:
    """Cars and vans that overlap by chance, detections of some, of various 2D heights."""
    predictions, annotations, found_details, details = {}, {}, {}, {}
    for number in range(frames):
        key, many = ("a" if number % 2 else "b", str(number)), int(rng.integers(0, 7))
        centre = np.column_stack([rng.uniform(5, 40, many), rng.uniform(-8, 8, many), np.zeros(many)])
        size = np.tile([4.0, 2.0, 1.5], (many, 1))
        yaw = rng.uniform(-0.3, 0.3, many)
        names = rng.choice(["Car", "Van", "Pedestrian"], many, p=[0.7, 0.2, 0.1])
        annotations[key] = Boxes(centre_m=centre, size_m=size, yaw_rad=yaw, label=names)
        details[key] = {
            "truncation": rng.choice([0.0, 0.2, 0.4, 0.9], many),
            "occlusion": rng.integers(0, 4, many),
            "box_px": np.column_stack([np.zeros((many, 3)), rng.uniform(15, 80, many)]),
            "dontcare_px": np.zeros((0, 4)),
        }
        source = rng.integers(0, many, int(rng.integers(0, 2 * many + 1))) if many else np.zeros(0, dtype=int)
        jitter = rng.normal(0, 0.15, (len(source), 3)) * rng.choice([0.3, 1, 4], (len(source), 1))
        predictions[key] = Boxes(
            centre_m=centre[source] + jitter,
            size_m=size[source],
            yaw_rad=yaw[source] + rng.normal(0, 0.05, len(source)),
            label="Car",
            score=rng.uniform(0, 1, len(source)),
        )
        found_details[key] = {"box_px": np.column_stack([np.zeros((len(source), 3)), rng.uniform(15, 80, len(source))])}
    return predictions, annotations, found_details, details


def plain(data: tuple[Any, ...], difficulty: str, kind: str, least: float = 0.7) -> tuple[float, float] | None:
    """R11 and R40 by KITTI's rules, box by box."""
    predictions, annotations, found_details, details = data
    least_px, occluded, truncated = DIFFICULTIES[difficulty]
    frames, total = [], 0
    for key in annotations:
        marks, facts = annotations[key], details[key]
        state = []
        for i, name in enumerate(marks.label):
            hard = (
                facts["box_px"][i, 3] - facts["box_px"][i, 1] <= least_px
                or facts["occlusion"][i] > occluded
                or facts["truncation"][i] > truncated
            )
            state.append({"Car": 1 if hard else 0, "Van": 1}.get(str(name), -1))
        total += state.count(0)
        found = predictions[key]
        small = [box[3] - box[1] < least_px for box in found_details[key]["box_px"]]
        frames.append((pairwise_iou(marks, found, kind=kind), state, list(found.score), small))
    if total == 0:
        return None
    scores = []
    for overlap, state, score, small in frames:
        used: set[int] = set()
        for i, kept in enumerate(state):
            if kept == -1:
                continue
            able = [j for j in range(len(score)) if j not in used and overlap[i, j] > least]
            if able:
                best = max(able, key=lambda j: score[j])
                used.add(best)
                if kept == 0 and not small[best]:
                    scores.append(score[best])
    thresholds, _ = sample_thresholds(np.sort(np.array(scores))[::-1], total)
    precision = np.zeros(41)
    for number, threshold in enumerate(thresholds):
        true = false = 0
        for overlap, state, score, small in frames:
            used = set()
            for i, kept in enumerate(state):
                able = [
                    j
                    for j in range(len(score))
                    if kept != -1 and j not in used and score[j] >= threshold and overlap[i, j] > least
                ]
                if not able:
                    continue
                large = [j for j in able if not small[j]]
                best = max(large, key=lambda j: overlap[i, j]) if large else able[0]
                used.add(best)
                true += kept == 0 and not small[best]
            false += sum(1 for j in range(len(score)) if j not in used and not small[j] and score[j] >= threshold)
        precision[number] = true / max(true + false, 1)
    precision = np.maximum.accumulate(precision[::-1])[::-1]
    assert total >= 41, "with fewer boxes the official sampling has gaps"
    return float(precision[::4].mean()), float(precision[1:].mean())


def test_equals_the_plain_rules(rng: np.random.Generator) -> None:
    data = scene(rng, frames=150)
    result = evaluate_kitti(
        data[0],
        data[1],
        KittiSettings(bootstrap=NO_BOOTSTRAP),
        prediction_details=data[2],
        annotation_details=data[3],
    )
    for difficulty in ("moderate", "hard"):
        for kind in ("bev", "3d"):
            expected = plain(data, difficulty, kind)
            found = [result.figures[f"ap/{kind}_{name}/{difficulty}"] for name in ("r11", "r40")]
            assert found == pytest.approx(expected, abs=1e-12), (kind, difficulty)


def test_thresholds_are_those_nearest_to_even_recalls() -> None:
    thresholds, recalls = sample_thresholds(np.linspace(1, 0, 400), 400)
    assert len(thresholds) == 41
    assert recalls[1:] == pytest.approx(np.arange(1, 41) / 40, abs=0.5 / 400 + 1e-12)


def test_annotated_against_annotated_is_one_however_few(rng: np.random.Generator) -> None:
    for frames in (1, 3, 60):
        _, annotations, _, details = scene(rng, frames=frames)
        annotations["a", "last"] = boxes([car(10)], scored=False, label="Car")
        details["a", "last"] = {
            "truncation": np.zeros(1),
            "occlusion": np.zeros(1),
            "box_px": np.array([[0, 0, 50, 50.0]]),
            "dontcare_px": np.zeros((0, 4)),
        }
        result = evaluate_kitti(
            as_predictions(annotations),
            annotations,
            KittiSettings(bootstrap=Bootstrap(replicates=5)),
            prediction_details=details,
            annotation_details=details,
        )
        in_space = {name: value for name, value in result.figures.items() if "bev" in name or "3d" in name}
        assert len(in_space) == 12
        assert set(in_space.values()) == {1.0}


def test_half_found_gives_half() -> None:
    annotations = {("s", str(i)): boxes([car(20)], scored=False, label="Car") for i in range(80)}
    predictions = {("s", str(i)): boxes([car(20, score=0.5 + i / 1000)], label="Car") for i in range(40)}
    result = evaluate_kitti(predictions, annotations, KittiSettings(bootstrap=NO_BOOTSTRAP))
    assert result.figures["ap/3d_r40/all"] == pytest.approx(0.5)
    assert result.figures["ap/3d_r11/all"] == pytest.approx(6 / 11)  # recalls 0, 0.1 ... 0.5


def test_a_van_is_neither_right_nor_wrong() -> None:
    van = boxes([car(20)], scored=False, label="Van")
    annotations = {("s", "0"): Boxes.concatenate([van, boxes([car(40)], scored=False, label="Car")])}
    predictions = {("s", "0"): boxes([car(20, score=0.9), car(40, score=0.5)], label="Car")}
    found = evaluate_kitti(predictions, annotations, KittiSettings(bootstrap=NO_BOOTSTRAP))
    assert found.figures["ap/3d_r40/all"] == 1.0
    strict = evaluate_kitti(predictions, annotations, KittiSettings(bootstrap=NO_BOOTSTRAP, ignore=()))
    assert strict.figures["ap/3d_r40/all"] == pytest.approx(0.5)


def test_dontcare_regions_excuse_detections_only_if_asked() -> None:
    key = ("s", "0")
    annotations = {key: boxes([car(20)], scored=False, label="Car")}
    predictions = {key: boxes([car(20, score=0.5), car(60, 5, score=0.9)], label="Car")}
    found = {key: {"box_px": np.array([[0, 0, 50, 50], [100, 100, 150, 150]], dtype=float)}}
    facts = {
        key: {
            "truncation": np.zeros(1),
            "occlusion": np.zeros(1),
            "box_px": np.array([[0, 0, 50, 50]], dtype=float),
            "dontcare_px": np.array([[90, 90, 160, 160]], dtype=float),
        }
    }
    for dontcare, expected in (("none", 0.5), ("image", 1.0)):
        settings = KittiSettings(dontcare=dontcare, bootstrap=NO_BOOTSTRAP)
        result = evaluate_kitti(predictions, annotations, settings, prediction_details=found, annotation_details=facts)
        assert result.figures["ap/bev_r40/easy"] == pytest.approx(expected)


def test_intervals_hold_the_score_and_the_table_its_convention(rng: np.random.Generator) -> None:
    data = scene(rng)
    settings = KittiSettings(bootstrap=Bootstrap(replicates=30), range_bins_m=(0.0, 20.0, 50.0))
    result = evaluate_kitti(data[0], data[1], settings)
    for name, value in result.figures.items():
        low, high = result.intervals["overall"][name]
        assert low - 1e-12 <= value <= high + 1e-12, name
    for shown in ("per cent", "min_overlap=0.7", "ignore=Van", "0-20", "bev_r11 all"):
        assert shown in str(result)
    tree = result.to_json()
    assert set(tree["ap"]) == {"bev_r11", "bev_r40", "3d_r11", "3d_r40"}
    assert len(tree["curves"]["overall"]["bev"]["all"]["recall"]) <= 41


def test_details_must_fit_and_settings_be_possible() -> None:
    annotations = {("s", "0"): boxes([car(20)], scored=False, label="Car")}
    with pytest.raises(ConfigError, match="a row for each of 1 box"):
        evaluate_kitti({}, annotations, annotation_details={("s", "0"): {"truncation": np.zeros(2)}})
    with pytest.raises(ConfigError, match="box_px"):
        evaluate_kitti({}, annotations, KittiSettings(dontcare="image"))
    for wrong in ({"min_overlap": 1.5}, {"range_bins_m": (5.0,)}, {"ignore": ("Car",)}):
        with pytest.raises(ConfigError):
            KittiSettings(**wrong)
    assert KittiSettings(label="Pedestrian").min_overlap == 0.5

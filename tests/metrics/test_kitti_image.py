"""KITTI's AP2D and AOS against a plain evaluation written from its rules, and worked cases."""

from typing import Any

import numpy as np
import pytest

from farfield.frame.annotation import Annotation
from farfield.geometry.boxes import Boxes
from farfield.metrics import Detections, KittiSettings, evaluate_kitti
from farfield.metrics.kitti.evaluation import DIFFICULTIES
from farfield.metrics.recall_sampling import sample_thresholds

from .scenes import NO_BOOTSTRAP, boxes, car

KEY = ("s", "0")


def scene(rng: np.random.Generator, frames: int) -> tuple[Any, Any, Any, Any]:
    """Cars and vans in images, some found askew or facing the other way, with DontCare regions."""
    sides: tuple[dict[Any, Any], ...] = ({}, {}, {}, {})
    for number in range(frames):
        key, many = (f"drive{number % 3}", str(number)), int(rng.integers(0, 7))
        left_top = rng.uniform(0, [400, 60], (many, 2))
        box_px = np.column_stack([left_top, left_top + rng.uniform([30, 15], [120, 90], (many, 2))])
        centre = np.column_stack([rng.uniform(5, 40, many), rng.uniform(-8, 8, many), np.zeros(many)])
        yaw = rng.uniform(-np.pi, np.pi, many)
        names = rng.choice(["Car", "Van"], many, p=[0.8, 0.2])
        size = np.tile([4.0, 2.0, 1.5], (many, 1))
        alpha = rng.uniform(-np.pi, np.pi, many)
        sides[1][key] = Boxes(centre_m=centre, size_m=size, yaw_rad=yaw, label=names)
        sides[3][key] = {
            "truncation": rng.choice([0.0, 0.2, 0.4], many, p=[0.7, 0.2, 0.1]),
            "occlusion": rng.choice(3, many, p=[0.7, 0.2, 0.1]),
            "box_px": box_px,
            "alpha_rad": alpha,
            "dontcare_px": np.array([[300, 0, 520, 150.0]])[: number % 2],
        }
        source = rng.integers(0, many, 2 * many) if many else np.zeros(0, dtype=int)
        turned = yaw[source] + rng.choice([0, 0.3, np.pi], len(source))
        sides[0][key] = Boxes(
            centre_m=centre[source] + rng.normal(0, 5, (len(source), 3)),  # in space nothing is found
            size_m=size[source],
            yaw_rad=turned,
            label="Car",
            score=rng.uniform(0, 1, len(source)),
        )
        sides[2][key] = {
            "box_px": box_px[source] + rng.normal(0, 3, (len(source), 4)),
            "alpha_rad": alpha[source] + rng.choice([0, 0.3, np.pi], len(source)),
        }
    return sides


def iou_px(a: Any, b: Any) -> float:
    wide = max(min(a[2], b[2]) - max(a[0], b[0]), 0)
    high = max(min(a[3], b[3]) - max(a[1], b[1]), 0)
    both = (a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1])
    return float(wide * high / (both - wide * high))


def plain(data: Any, difficulty: str, least: float = 0.7) -> dict[str, float]:
    """AP2D and AOS over 40 recalls by KITTI's rules, box by box."""
    predictions, annotations, found_details, details = data
    least_px, occluded, truncated = DIFFICULTIES[difficulty]
    frames, total = [], 0
    for key, marks in annotations.items():
        facts, found = details[key], found_details[key]
        hard = (
            (facts["box_px"][:, 3] - facts["box_px"][:, 1] <= least_px)
            | (facts["occlusion"] > occluded)
            | (facts["truncation"] > truncated)
        )
        state = [1 if name == "Van" or is_hard else 0 for name, is_hard in zip(marks.label, hard, strict=True)]
        total += state.count(0)
        overlap = np.array([[iou_px(a, b) for b in found["box_px"]] for a in facts["box_px"]])
        similar = (1 + np.cos(facts["alpha_rad"][:, None] - found["alpha_rad"][None])) / 2
        small = [box[3] - box[1] < least_px for box in found["box_px"]]
        excused = []
        for box in found["box_px"]:
            area = (box[2] - box[0]) * (box[3] - box[1])
            shares = [
                max(min(box[2], r[2]) - max(box[0], r[0]), 0) * max(min(box[3], r[3]) - max(box[1], r[1]), 0) / area
                for r in facts["dontcare_px"]
            ]
            excused.append(any(share > least for share in shares))
        frames.append((overlap, similar, state, list(predictions[key].score), small, excused))
    scores = []
    for overlap, _, state, score, small, _ in frames:
        used: set[int] = set()
        for i, may in enumerate(state):
            able = [j for j in range(len(score)) if j not in used and overlap[i, j] > least]
            if able:
                best = max(able, key=lambda j: score[j])
                used.add(best)
                if may == 0 and not small[best]:
                    scores.append(score[best])
    thresholds, _ = sample_thresholds(np.sort(np.array(scores))[::-1], total)
    sampled = np.zeros((2, 41))
    for number, threshold in enumerate(thresholds):
        true, false, alike = 0, 0, 0.0
        for overlap, similar, state, score, small, excused in frames:
            used = set()
            for i, may in enumerate(state):
                able = [
                    j for j in range(len(score)) if j not in used and score[j] >= threshold and overlap[i, j] > least
                ]
                if not able:
                    continue
                large = [j for j in able if not small[j]]
                best = max(large, key=lambda j: overlap[i, j]) if large else able[0]
                used.add(best)
                if may == 0 and not small[best]:
                    true, alike = true + 1, alike + similar[i, best]
            left = [j for j in range(len(score)) if j not in used and score[j] >= threshold]
            false += sum(1 for j in left if not small[j] and not excused[j])
        sampled[:, number] = true / max(true + false, 1), alike / max(true + false, 1)
    sampled = np.maximum.accumulate(sampled[:, ::-1], axis=1)[:, ::-1]
    assert total >= 41, "with fewer boxes the official sampling has gaps"
    return {"2d": float(sampled[0, 1:].mean()), "aos": float(sampled[1, 1:].mean())}


def test_equals_the_plain_rules(rng: np.random.Generator) -> None:
    data = scene(rng, 90)
    settings = KittiSettings(bootstrap=NO_BOOTSTRAP)
    result = evaluate_kitti(data[0], data[1], settings, prediction_details=data[2], annotation_details=data[3])
    for difficulty in DIFFICULTIES:
        expected = plain(data, difficulty)
        assert 0.05 < expected["aos"] < expected["2d"] < 1
        for measure, value in expected.items():
            assert result.figures[f"ap/{measure}_r40/{difficulty}"] == pytest.approx(value, abs=1e-12)


def facts(count: int, **columns: Any) -> dict[str, np.ndarray]:
    box_px = np.array([[100.0 * n, 0, 100 * n + 80, 60] for n in range(count)]).reshape(-1, 4)
    plain = {"truncation": np.zeros(count), "occlusion": np.zeros(count, dtype=int), "box_px": box_px}
    return plain | {"dontcare_px": np.zeros((0, 4))} | columns


def test_headings_weigh_in_aos_and_come_from_the_boxes_where_no_alpha_is_given() -> None:
    marked = {KEY: boxes([car(20, 5), car(30, -5)], scored=False, label="Car")}
    for turn, similarity in ((0.0, 1.0), (np.pi / 2, 0.5), (np.pi, 0.0)):
        found = {KEY: boxes([car(20, 5, score=0.9, yaw=turn), car(30, -5, score=0.8, yaw=turn)], label="Car")}
        here = {KEY: facts(2)}
        ours = evaluate_kitti(found, marked, prediction_details=here, annotation_details=here).figures
        assert ours["ap/2d_r40/moderate"] == pytest.approx(1.0)
        assert ours["ap/aos_r40/moderate"] == pytest.approx(similarity)
    stated = [{KEY: facts(2, alpha_rad=np.array([0.0, 0.0]))}, {KEY: facts(2, alpha_rad=np.array([0.0, np.pi]))}]
    ours = evaluate_kitti(found, marked, prediction_details=stated[1], annotation_details=stated[0]).figures
    assert ours["ap/aos_r40/easy"] == pytest.approx(0.75 + 0.25 / 2)  # 1 up to a recall of 0.75, then a half
    unknown = {KEY: facts(2, alpha_rad=np.array([0.0, -10.0]))}
    ours = evaluate_kitti(found, marked, prediction_details=unknown, annotation_details=stated[0]).figures
    assert ours["ap/aos_r40/easy"] == pytest.approx(0.0)  # of the boxes, which face the other way


def test_regions_without_labels_always_excuse_in_the_image() -> None:
    marked, region = {KEY: boxes([car(20)], scored=False, label="Car")}, np.array([[90.0, 0, 190, 70]])
    found = {KEY: boxes([car(20, score=0.5), car(60, 5, score=0.9)], label="Car")}
    details = {KEY: facts(1, dontcare_px=region)}
    ours = evaluate_kitti(found, marked, prediction_details={KEY: facts(2)}, annotation_details=details).figures
    assert ours["ap/2d_r40/easy"] == pytest.approx(1.0)
    assert ours["ap/bev_r40/easy"] == pytest.approx(0.5)


def test_without_boxes_in_the_image_of_both_sides_there_are_no_figures_of_it() -> None:
    marked = {KEY: boxes([car(20)], scored=False, label="Car")}
    found = {KEY: boxes([car(20, score=0.5)], label="Car")}
    names = evaluate_kitti(found, marked, annotation_details={KEY: facts(1)}).figures
    assert not any("2d" in name or "aos" in name for name in names)
    detections = Detections(
        boxes=found,
        annotations={
            KEY: Annotation(boxes=marked[KEY], details={k: v for k, v in facts(1).items() if k != "dontcare_px"})
        },
        prediction_details={KEY: {"box_px": facts(1)["box_px"]}},
    )
    result = detections.score("kitti", label="Car")
    assert result.figures["ap/2d_r40/moderate"] == pytest.approx(1.0)
    text = str(result)
    assert "2d_r40 moderate" in text
    assert "aos_r11 hard" in text

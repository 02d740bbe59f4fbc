"""DDS and wDDS: hand-worked cases, published figures, a slow oracle for every option, invariances."""

import json
import math

import numpy as np
import pytest

from farfield.errors import ConfigError
from farfield.geometry.boxes import Boxes
from farfield.metrics import Bootstrap, DdsSettings, evaluate_dds, score, scored_labels

from . import reference
from .scenes import NO_BOOTSTRAP, as_predictions, boxes, car, random_scene

OPTIONS = [
    {},
    {"distance": "bev"},
    {"omega_range": "pred"},
    {"match": "nearest_normalised"},
    {"match": "nearest_normalised", "omega_range": "pred"},
    {"ap": "interp101"},
    {"ap": "area"},
    {"ap": "voc"},
    {"aiou": "scale"},
    {"aiou": "bev"},
    {"aiou_threshold_m": "all"},
    {"aiou_threshold_m": 4.0},
    {"aiou_mean": "tp_mean"},
    {"range_assign": "match_then_bin"},
    {"range_assign": "match_then_bin", "region": "none", "ignore": ()},
    {"region": "range"},
    {"region": "none"},
    {"relabel": {}},
    {"ignore": ()},
    {"ignore": ("unknown", "pedestrian")},
    {"min_points": 2},
    {"max_boxes": 3},
    {"ties": "later_first"},
    {"ties": "stable"},
    {"thresholds_m": (0.25, 2.0, 8.0)},
]


def assert_near(found: dict, expected: dict | None, epsilon: str, tolerance: float = 1e-12) -> None:
    assert (found[f"dds/{epsilon}/dds"] is None) == (expected is None)
    if expected is not None:
        assert found[f"dds/{epsilon}/map"] == pytest.approx(expected["map"], abs=tolerance)
        assert found[f"dds/{epsilon}/aiou"] == pytest.approx(expected["aiou"], abs=tolerance)
        assert found[f"dds/{epsilon}/dds"] == pytest.approx((expected["map"] + expected["aiou"]) / 2, abs=tolerance)


@pytest.mark.parametrize("options", OPTIONS, ids=lambda o: ",".join(f"{k}={v}" for k, v in o.items()) or "default")
def test_equals_the_plain_evaluation_for_every_option(options: dict, rng: np.random.Generator) -> None:
    predictions, annotations = random_scene(rng, frames=14)
    settings = DdsSettings(scores="raw", epsilons=(0.0, 0.009), bootstrap=NO_BOOTSTRAP, **options)
    result = evaluate_dds(predictions, annotations, settings)
    parts = {"overall": (0.0, math.inf)} | {f"{low:g}-{high:g}": (low, high) for low, high in settings.bins_m}
    for name, (low, high) in parts.items():
        expected = reference.evaluate(predictions, annotations, settings, low, high)
        found = result.figures if name == "overall" else result.ranges[name]
        for epsilon in ("0", "0.009"):
            assert_near(found, expected[epsilon], epsilon)


def test_hand_worked_case() -> None:
    annotated = {("s", "0"): boxes([car(10), car(30)], scored=False)}
    predicted = {("s", "0"): boxes([car(10.75, score=0.9), car(30, score=0.8), car(60, score=0.7)])}
    result = evaluate_dds(predicted, annotated, DdsSettings(bootstrap=NO_BOOTSTRAP))
    # At 0.5 m: miss, match, miss: recall 0, 1/2, 1/2; precision 0, 1/2, 1/3. Interpolated precision at recall r is r up
    # to 0.5 (the last of equal recalls, 1/3, stands at 0.5 itself), then 0. Less 0.1 and over 0.9, from recall 0.11 on:
    half = (sum(r / 100 - 0.1 for r in range(11, 50)) + (1 / 3 - 0.1)) / 90 / 0.9
    assert result.figures["ap/0.5"] == pytest.approx(half, abs=1e-12)
    assert result.figures["ap/1.0"] == pytest.approx(_two_then_false(), abs=1e-12)
    assert result.figures["dds/0/aiou"] == pytest.approx(1.0, abs=1e-12)  # sizes and headings are exact
    assert result.figures["errors/trans_err"] == pytest.approx(_mean_distance(), abs=1e-12)
    assert result.counts["annotated"] == 2
    assert result.counts["predictions"] == 3


def _two_then_false() -> float:
    # Recall 1/2, 1, 1; precision 1, 1, 2/3: one up to recall 0.99, and 2/3, the last, at recall 1.
    return (89 * 0.9 + (2 / 3 - 0.1)) / 90 / 0.9


def _mean_distance() -> float:
    # Running mean of 0.75, 0 is 0.75, 0.375. Confidence by rank is 1, 2/3, 1/3. At recalls r of 0.11 to 0.5 it is 1,
    # then falls to 2/3 along r; at recall 1 it is 1/3, below all matches.
    total = 0.0
    for r in range(11, 101):
        confidence = 1.0 if r <= 50 else 1.0 - (r / 100 - 0.5) * 2 / 3
        total += 0.375 if r == 100 else 0.375 + (confidence - 2 / 3) / (1 / 3) * 0.375
    return total / 90


def test_omega_widens_the_threshold_as_the_equation_says() -> None:
    annotated = {("s", "0"): boxes([car(200)], scored=False)}
    reach = 0.5 * math.exp(0.003 * 200)
    for shift, hit in ((reach - 1e-9, 1.0), (reach + 1e-9, 0.0)):
        predicted = {("s", "0"): boxes([car(200, shift, score=0.5)])}
        result = evaluate_dds(predicted, annotated, DdsSettings(bootstrap=NO_BOOTSTRAP, thresholds_m=(0.5, 2.0)))
        curve = result.curves["overall"]["0.003"]["0.5"]
        assert curve.recall.tolist() == [hit]
        assert result.curves["overall"]["0"]["0.5"].recall.tolist() == [0.0]


def test_the_threshold_itself_is_no_match() -> None:
    annotated = {("s", "0"): boxes([car(8)], scored=False)}
    result = evaluate_dds({("s", "0"): boxes([car(10, score=1)])}, annotated, DdsSettings(bootstrap=NO_BOOTSTRAP))
    assert result.figures["ap/2.0"] == 0.0
    assert result.figures["ap/4.0"] == pytest.approx(1.0)


def test_annotated_against_annotated_is_one(rng: np.random.Generator) -> None:
    _, annotations = random_scene(rng, frames=30)
    for region in ("window", "range", "none"):
        settings = DdsSettings(region=region, bootstrap=NO_BOOTSTRAP)
        result = evaluate_dds(as_predictions(annotations), annotations, settings)
        for name, value in {
            **result.figures,
            **{f"{r}{n}": v for r, p in result.ranges.items() for n, v in p.items()},
        }.items():
            assert value == pytest.approx(0.0 if "err" in name else 1.0, abs=1e-12), name


def test_a_bin_without_annotated_boxes_is_null() -> None:
    annotated = {("s", "0"): boxes([car(10)], scored=False)}
    predicted = {("s", "0"): boxes([car(10, score=0.9), car(100, score=0.5)])}
    settings = DdsSettings(bootstrap=Bootstrap(replicates=5))
    tree = evaluate_dds(predicted, annotated, settings).to_json()
    assert tree["ranges"]["70-150"] is None
    assert tree["ranges"]["0-70"]["dds"]["0"]["dds"] == pytest.approx(1.0)
    assert tree["counts"]["ranges"]["70-150"] == {"annotated": 0, "predictions": 1, "ignored": 0}
    assert tree["mean_of_bins"]["dds"]["0"]["dds"] == pytest.approx(1.0)
    nothing = evaluate_dds(predicted, {("s", "0"): Boxes.empty()}, settings).to_json()
    assert nothing["ap"] == {"0.5": None, "1.0": None, "2.0": None, "4.0": None}
    assert nothing["dds"]["0"] == {"dds": None, "map": None, "aiou": None}
    assert "NaN" not in json.dumps(nothing)


def test_an_open_last_bin_and_no_frames_at_all() -> None:
    settings = DdsSettings(range_bins_m=(0.0, 50.0, math.inf), region="none", bootstrap=NO_BOOTSTRAP)
    annotated = {("s", "0"): boxes([car(900)], scored=False)}
    tree = evaluate_dds(as_predictions(annotated), annotated, settings).to_json()
    assert tree["ranges"]["50-inf"]["dds"]["0"]["dds"] == pytest.approx(1.0)
    assert json.loads(json.dumps(tree, allow_nan=False))["settings"]["range_bins_m"] == [0.0, 50.0, "inf"]
    for protocol in ("dds", "nuscenes", "kitti"):
        assert all(value is None for value in score({}, {}, protocol=protocol).figures.values())


def test_no_predictions_score_zero() -> None:
    result = evaluate_dds({}, {("s", "0"): boxes([car(10)], scored=False)})
    assert result.figures["dds/0/dds"] == 0.0


def test_order_of_frames_and_boxes_does_not_matter(rng: np.random.Generator) -> None:
    predictions, annotations = random_scene(rng)
    predictions = {k: p.replace(score=rng.uniform(0, 1, len(p))) for k, p in predictions.items()}  # no ties
    settings = DdsSettings(bootstrap=NO_BOOTSTRAP)
    turned = []
    for side in (predictions, annotations):
        keys = list(side)
        rng.shuffle(keys)
        turned.append({tuple(key): side[tuple(key)][rng.permutation(len(side[tuple(key)]))] for key in keys})
    first, second = evaluate_dds(predictions, annotations, settings), evaluate_dds(*turned, settings)
    assert first.figures == pytest.approx(second.figures, abs=1e-12)


def test_scores_are_only_ranked(rng: np.random.Generator) -> None:
    predictions, annotations = random_scene(rng)
    logits = {key: part.replace(score=np.log(part.score + 0.1) * 7 - 3) for key, part in predictions.items()}
    settings = DdsSettings(bootstrap=NO_BOOTSTRAP)
    assert (
        evaluate_dds(logits, annotations, settings).figures == evaluate_dds(predictions, annotations, settings).figures
    )


def test_an_ignored_box_drops_every_prediction_on_it() -> None:
    annotated = Boxes.concatenate([boxes([car(10)], scored=False), boxes([car(30)], scored=False, label="unknown")])
    predicted = boxes([car(10, score=0.5), car(30, score=0.9), car(30.1, score=0.8)])
    key = ("s", "0")
    kept = evaluate_dds({key: predicted}, {key: annotated}, DdsSettings(bootstrap=NO_BOOTSTRAP))
    assert kept.figures["dds/0/map"] == pytest.approx(1.0, abs=1e-12)
    assert (kept.counts["annotated"], kept.counts["ignored"]) == (1, 1)
    strict = evaluate_dds({key: predicted}, {key: annotated}, DdsSettings(bootstrap=NO_BOOTSTRAP, ignore=()))
    assert strict.figures["dds/0/map"] < 0.5


def test_interval_covers_the_score_and_follows_the_seed(rng: np.random.Generator) -> None:
    predictions, annotations = random_scene(rng, frames=60, sequences=12)
    options = {"epsilons": (0.0,), "range_bins_m": (0.0, 70.0, 250.0)}
    result = evaluate_dds(predictions, annotations, DdsSettings(**options, bootstrap=Bootstrap(50)))
    for part, names in (("overall", result.figures), ("mean_of_bins", result.mean_of_bins)):
        for name, value in names.items():
            low, high = result.intervals[part][name]
            assert low <= value <= high, name
            assert low < high
    again = evaluate_dds(predictions, annotations, DdsSettings(**options, bootstrap=Bootstrap(50)))
    other = evaluate_dds(predictions, annotations, DdsSettings(**options, bootstrap=Bootstrap(50, seed=1)))
    assert again.intervals == result.intervals
    assert other.intervals != result.intervals
    assert result.grouped_by == "sequences"
    assert "bootstrap interval over sequences" in str(result)


def test_one_sequence_is_resampled_by_frames(rng: np.random.Generator) -> None:
    predictions, annotations = random_scene(rng, sequences=1)
    result = evaluate_dds(predictions, annotations, DdsSettings(bootstrap=Bootstrap(replicates=20)))
    assert result.grouped_by == "frames"
    assert "there is only one sequence" in str(result)


def test_result_prints_and_serialises_its_convention(rng: np.random.Generator) -> None:
    result = evaluate_dds(*random_scene(rng), DdsSettings(ap="area", bootstrap=Bootstrap(replicates=10)))
    text = str(result)
    for shown in ("ap=area", "distance=3d", "aiou_mean=nuscenes", "large_vehicle->vehicle", "150-250", "mean of bins"):
        assert shown in text
    tree = json.loads(json.dumps(result.to_json(), allow_nan=False))
    assert set(tree) >= {"protocol", "settings", "ap", "errors", "dds", "ranges", "counts", "intervals", "curves"}
    assert set(tree["dds"]) == {"0", "0.003", "0.006", "0.009"}
    assert tree["settings"]["ap"] == "area"
    assert len(tree["curves"]["overall"]["0.006"]["0.5"]["precision"]) == 101
    low, high = tree["intervals"]["overall"]["dds"]["0"]["dds"]
    assert low <= high


def test_equals_the_published_figures_on_real_detections(real_detections) -> None:
    detections, expected = real_detections
    settings = DdsSettings(label="Car", region="none", range_bins_m=(0.0, 25.0, 50.0, 1e9), bootstrap=NO_BOOTSTRAP)
    tree = evaluate_dds(detections.boxes, detections.annotated, settings).to_json()
    pairs = [(tree["dds"]["0"], expected["dds_base"])]
    pairs += [(tree["dds"][e], expected[f"wdds_{e}"]) for e in ("0.003", "0.006", "0.009")]
    pairs += [(tree["ranges"]["0-25"]["dds"]["0"], expected["dds_range_0_25"])]
    pairs += [(tree["ranges"]["25-50"]["dds"]["0"], expected["dds_range_25_50"])]
    pairs += [(tree["ranges"]["50-1e+09"]["dds"]["0"], expected["dds_range_50_1e+09"])]
    for found, wanted in pairs:
        assert found == pytest.approx({name: wanted[name] for name in ("dds", "map", "aiou")}, abs=1e-5)
    assert (tree["counts"]["frames"], tree["counts"]["annotated"], tree["counts"]["predictions"]) == (
        4002,
        17750,
        28022,
    )


@pytest.mark.parametrize(
    "options",
    [
        {"ap": "coco"},
        {"range_bins_m": (70.0, 0.0)},
        {"range_bins_m": (0.0,)},
        {"thresholds_m": ()},
        {"thresholds_m": (1.0, 1.0)},
        {"epsilons": (-0.1,)},
        {"aiou_threshold_m": "some"},
        {"max_boxes": 0},
        {"ignore": ("vehicle",)},
    ],
)
def test_impossible_settings_are_refused(options: dict) -> None:
    with pytest.raises((ConfigError, TypeError)):  # TypeError where types are checked at run time
        DdsSettings(**options)


def test_wrong_inputs_are_refused() -> None:
    annotated = {("s", "0"): boxes([car(10)], scored=False)}
    with pytest.raises(ConfigError, match="frames that are annotated"):
        evaluate_dds({("s", "1"): boxes([car(10, score=1)])}, annotated)
    with pytest.raises(ConfigError, match="score"):
        evaluate_dds({("s", "0"): boxes([car(10)], scored=False)}, annotated)
    with pytest.raises(ConfigError, match="point counts"):
        evaluate_dds({}, annotated, DdsSettings(min_points=1))
    with pytest.raises(ConfigError, match="protocol"):
        score({}, annotated, protocol="coco")
    with pytest.raises(ConfigError, match="options among"):
        score({}, annotated, protocol="dds", overlap=0.5)


def test_score_takes_the_most_annotated_class(rng: np.random.Generator) -> None:
    _, annotations = random_scene(rng)
    assert scored_labels(annotations)[0] == "vehicle"
    assert "unknown" not in scored_labels(annotations)
    assert score({}, annotations, bootstrap=NO_BOOTSTRAP).label == "vehicle"
    assert score({}, annotations, label="pedestrian", bootstrap=NO_BOOTSTRAP).label == "pedestrian"

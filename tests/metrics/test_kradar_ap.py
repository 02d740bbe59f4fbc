"""K-Radar's average precision against the development kit's figures, plain rules box by box, and worked cases."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from farfield.errors import ConfigError
from farfield.geometry.boxes import Boxes
from farfield.geometry.iou import pairwise_iou
from farfield.metrics import Bootstrap, KRadarSettings, evaluate_kradar, kradar_settings, score, scored_labels
from farfield.metrics.kradar import matching
from farfield.metrics.kradar.settings import VARIANTS
from farfield.metrics.recall_sampling import sample_thresholds, sampled_precision
from farfield.vocabulary.kradar import KRADAR_ORIGIN_M

from .scenes import NO_BOOTSTRAP, ByFrame, as_predictions, boxes, car

SHORT = {"sed": "vehicle", "bus": "large_vehicle"}
PLAIN: dict[str, Any] = {"region": "none", "bootstrap": NO_BOOTSTRAP}


@pytest.fixture(scope="module", params=["iso", "long"])
def kit(shared_real: Path, request: pytest.FixtureRequest) -> tuple[ByFrame, ByFrame, dict[str, Any]]:
    """500 real test frames, predictions of noise (of two kinds), and what the development kit prints for them."""
    folder = shared_real / "kradar" / "evaluation"
    rows: dict[tuple[str, str], dict[str, list[dict[str, str]]]] = {}
    with (folder / f"boxes_{request.param}.csv").open(newline="") as handle:
        for row in csv.DictReader(handle):
            rows.setdefault((row["seq"], row["stem"]), {"gt": [], "pred": []})[row["kind"]].append(row)
    sides: dict[str, ByFrame] = {"gt": {}, "pred": {}}
    for key, kinds in rows.items():
        for kind, found in kinds.items():
            names = ("x", "y", "z", "l", "w", "h", "yaw_rad", "score")
            table = np.array([[float(row[name]) for name in names] for row in found]).reshape(-1, 8)
            sides[kind][key] = Boxes(
                centre_m=table[:, :3],
                size_m=table[:, 3:6],
                yaw_rad=table[:, 6],
                label=[row["cls"] for row in found],
                score=table[:, 7] if kind == "pred" else None,
            )
    return sides["pred"], sides["gt"], json.loads((folder / f"expected_{request.param}.json").read_text())["variants"]


def crowd(rng: np.random.Generator, *, frames: int = 60) -> tuple[ByFrame, ByFrame]:
    """Boxes that overlap each other, contested and doubled predictions with tied scores, and empty frames."""
    predictions, annotations = {}, {}
    for number in range(frames):
        key, many = (f"{number % 5}", f"{number:03d}"), int(rng.integers(0, 6)) * int(number % 4 > 0)
        centre = np.column_stack([rng.uniform(5, 20, many), rng.uniform(-3, 3, many), rng.normal(0, 0.2, many)])
        size = rng.uniform([3.5, 1.6, 1.4], [5, 2.2, 2.0], (many, 3))
        names = rng.choice(["vehicle", "large_vehicle"], many, p=[0.8, 0.2])
        yaw = rng.uniform(-0.4, 0.4, many)
        annotations[key] = Boxes(centre_m=centre, size_m=size, yaw_rad=yaw, label=names)
        source = rng.integers(0, many, int(rng.integers(0, 3 * many + 1))) if many else np.zeros(0, dtype=int)
        extra = int(rng.integers(0, 2))
        spread_m = rng.choice([0.1, 0.5, 1.5], (len(source), 1))
        found = centre[source] + rng.normal(0, 1, (len(source), 3)) * spread_m * [1, 0.6, 0.3]
        predictions[key] = Boxes(
            centre_m=np.concatenate([found, rng.uniform([5, -3, 0], [20, 3, 0.1], (extra, 3))]),
            size_m=np.concatenate([size[source], np.full((extra, 3), 2.0)]),
            yaw_rad=np.concatenate([yaw[source] + rng.normal(0, 0.1, len(source)), np.zeros(extra)]),
            label=np.concatenate([names[source], np.full(extra, "vehicle")]),
            score=np.round(rng.uniform(0.05, 1, len(source) + extra), 1),
        )
    return predictions, annotations


def plain(
    predictions: ByFrame, annotations: ByFrame, label: str, kind: str, iou: float, options: dict[str, Any]
) -> float | None:
    """Average precision by KITTI's rules, frame by frame and box by box, with the options' quirks."""
    frames, total = [], 0
    for key, given in annotations.items():
        if options.get("empty_frames") == "dropped" and len(given) == 0:
            continue
        marks, found = given[given.label == label], predictions[key][predictions[key].label == label]
        lift = options.get("z_center", 0.5) - 0.5
        turn = np.pi / 2 if options.get("yaw") == "as_shipped" else 0.0
        sides = [
            side.replace(centre_m=side.centre_m - side.size_m * [0, 0, lift], yaw_rad=side.yaw_rad + turn)
            for side in (marks, found)
        ]
        total += len(marks)
        frames.append((pairwise_iou(sides[0], sides[1], kind=kind), found.score.tolist()))  # type: ignore[union-attr]
    if total == 0:
        return None

    def taken(overlap: np.ndarray, able: list[float], prefer: Any) -> list[int]:
        used: list[int] = []
        for i in range(len(overlap)):
            free = [j for j in range(len(able)) if j not in used and able[j] >= 0 and overlap[i, j] > iou]
            if free:
                used.append(max(free, key=lambda j: (prefer(i, j), -j)))
        return used

    scores = [s[j] for o, s in frames for j in taken(o, s, lambda i, j, s=s: s[j])]
    thresholds, recalls = sample_thresholds(np.sort(np.array(scores, dtype=np.float64))[::-1], total)
    precision = np.zeros(len(thresholds))
    for number, threshold in enumerate(thresholds):
        true = allowed = 0
        for overlap, score_of in frames:
            able = [value if value >= threshold else -1.0 for value in score_of]
            true += len(taken(overlap, able, lambda i, j, o=overlap: o[i, j]))
            allowed += sum(value >= 0 for value in able)
        precision[number] = true / allowed
    sampled = sampled_precision(precision, np.array(recalls), total, gaps=options.get("sampling") == "gaps")
    return float({11: sampled[::4], 40: sampled[1:], 41: sampled}[options.get("recall_points", 40)].mean())


@pytest.mark.parametrize("variant", ["old_as_shipped", "old_yaw_fixed", "revised_as_shipped", "revised_yaw_fixed"])
def test_equals_the_development_kit(kit: tuple[ByFrame, ByFrame, dict[str, Any]], variant: str) -> None:
    settings = kradar_settings(f"kradar-compat:{variant}", **PLAIN)
    figures = evaluate_kradar(kit[0], kit[1], settings).figures
    for short, label in SHORT.items():
        expected = kit[2][variant]["ap"][short]
        for measure in ("bev", "3d"):
            ours = [100 * (figures[f"ap/{label}/{measure}/{iou:g}"] or 0) for iou in expected["iou"]]
            assert ours == pytest.approx(expected[measure], abs=0.001), (label, measure)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"recall_points": 41, "yaw": "as_shipped", "empty_frames": "dropped", "sampling": "gaps"},
        {"recall_points": 11, "z_center": 1.0},
    ],
)
def test_equals_the_plain_rules(rng: np.random.Generator, options: dict[str, Any]) -> None:
    predictions, annotations = crowd(rng, frames=45)
    figures = evaluate_kradar(predictions, annotations, KRadarSettings(**PLAIN, **options, ious=(0.3, 0.6))).figures
    for name, value in figures.items():
        _, label, kind, iou = name.split("/")
        assert value == pytest.approx(plain(predictions, annotations, label, kind, float(iou), options), abs=1e-12), (
            name
        )


def test_parts_of_the_table_of_prefixes_do_not_matter(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    predictions, annotations = crowd(rng)
    whole = evaluate_kradar(predictions, annotations, KRadarSettings(**PLAIN)).figures
    monkeypatch.setattr(matching, "_ROWS_AT_ONCE", 7)
    assert evaluate_kradar(predictions, annotations, KRadarSettings(**PLAIN)).figures == whole


def test_subsets_are_the_evaluations_of_their_frames(rng: np.random.Generator) -> None:
    predictions, annotations = crowd(rng)
    weather = {key: ("sleet", "fog", "light snow")[int(key[1]) % 3] for key in annotations}
    conditions = {key: {"weather": name, "road": "urban", "time": "day"} for key, name in weather.items()}
    result = evaluate_kradar(predictions, annotations, KRadarSettings(**PLAIN), conditions=conditions)
    assert [len(parts) for parts in result.conditions.values()] == [7, 8, 2]
    assert result.conditions["time"]["day"] == result.figures
    for name in ("sleet", "fog", "light snow"):
        keys = [key for key in annotations if weather[key] == name]
        alone = evaluate_kradar(
            {key: predictions[key] for key in keys}, {key: annotations[key] for key in keys}, KRadarSettings(**PLAIN)
        )
        assert result.conditions["weather"][name.replace(" ", "_")] == alone.figures
    assert set(result.conditions["weather"]["rain"].values()) == {None}
    assert result.counts["conditions"]["weather"]["fog"]["frames"] == 20
    unknown = evaluate_kradar(
        predictions, annotations, KRadarSettings(**PLAIN), conditions={key: {} for key in annotations}
    )
    assert unknown.conditions == {}


def test_range_bins_cut_both_kinds_of_boxes(rng: np.random.Generator) -> None:
    predictions, annotations = crowd(rng)
    settings = KRadarSettings(**PLAIN, range_bins_m=(0.0, 12.0, 30.0))
    result = evaluate_kradar(predictions, annotations, settings)
    near = [{key: part[part.range_m < 12.0] for key, part in side.items()} for side in (predictions, annotations)]
    assert result.ranges["0-12"] == evaluate_kradar(near[0], near[1], KRadarSettings(**PLAIN)).figures
    total = sum(result.counts["ranges"][name]["annotated"] for name in ("0-12", "12-30"))
    assert total == result.counts["annotated"] == sum(map(len, annotations.values()))


def test_annotated_against_annotated_is_100_in_every_part_however_few(rng: np.random.Generator) -> None:
    for frames in (3, 40):
        _, annotations = crowd(rng, frames=frames)
        conditions = {key: {"weather": ("fog", "rain")[int(key[1]) % 2], "time": "day"} for key in annotations}
        seen = {key: ["R", "L", "L1", "R", "L"][: len(part)] for key, part in annotations.items()}
        found, settings = as_predictions(annotations), KRadarSettings(bootstrap=NO_BOOTSTRAP)
        result = evaluate_kradar(found, annotations, settings, conditions=conditions, visibility=seen)
        values = [value for _, _, figures, _ in result.parts() for value in figures.values()]
        assert {value for value in values if value is not None} == {1.0}
        assert sum(value is not None for value in values) > 40


def test_real_annotations_score_100_against_themselves(kit: tuple[ByFrame, ByFrame, dict[str, Any]]) -> None:
    result = evaluate_kradar(as_predictions(kit[1]), kit[1], KRadarSettings(bootstrap=NO_BOOTSTRAP))
    parts = [value for _, _, figures, _ in result.parts() for value in figures.values()]
    assert len(parts) == 5 * 12
    assert set(parts) == {1.0}


def test_the_kit_turns_boxes_so_that_errors_along_and_across_change_places() -> None:
    annotations = {("1", str(i)): boxes([car(20)], scored=False) for i in range(50)}
    for offset, turned, correct in (((1.0, 0.0), 1 / 3, 0.6), ((0.0, 1.0), 0.6, 1 / 3)):
        row = (20 + offset[0], offset[1], *car(20)[2:7], 0.9)
        predictions = {key: boxes([row]) for key in annotations}
        for yaw, iou in (("as_shipped", turned), ("correct", correct)):
            ious = (iou - 1e-6, iou + 1e-6)
            settings = KRadarSettings(**PLAIN, yaw=yaw, ious=ious)  # type: ignore[arg-type]
            figures = evaluate_kradar(predictions, annotations, settings).figures
            assert [figures[f"ap/vehicle/bev/{value:g}"] for value in ious] == [1.0, 0.0]


def test_z_center_takes_z_as_the_middle_or_the_top() -> None:
    annotations = {("1", str(i)): boxes([(20, 0, 0, 4, 2, 1, 0, 0)], scored=False) for i in range(50)}
    predictions = {key: boxes([(20, 0, 0, 4, 2, 2, 0, 0.9)]) for key in annotations}
    lower = {key: boxes([(20, 0, -0.5, 4, 2, 2, 0, 0.9)]) for key in annotations}
    for found, z_center, iou in ((predictions, 0.5, 1 / 2), (predictions, 1.0, 1 / 2), (lower, 1.0, 1 / 5)):
        settings = KRadarSettings(**PLAIN, z_center=z_center, ious=(iou - 1e-6, iou + 1e-6))
        figures = evaluate_kradar(found, annotations, settings).figures
        assert [value for name, value in figures.items() if name.startswith("ap/vehicle/3d")] == [1.0, 0.0]


def test_empty_frames_count_or_are_dropped_with_their_predictions() -> None:
    annotations = {("1", str(i)): boxes([car(20)] if i < 50 else [], scored=False) for i in range(100)}
    predictions = {key: boxes([car(20, score=0.5)]) for key in annotations}
    for rule, expected in (("counted", 0.5), ("dropped", 1.0)):
        settings = KRadarSettings(**PLAIN, empty_frames=rule)  # type: ignore[arg-type]
        result = evaluate_kradar(predictions, annotations, settings)
        assert result.figures["ap/vehicle/3d/0.7"] == pytest.approx(expected)
        assert result.counts["frames"] == round(50 / expected)
    bus = {
        key: Boxes.concatenate([part, boxes([car(40)], scored=False, label="bus")]) for key, part in annotations.items()
    }
    settings = KRadarSettings(**PLAIN, empty_frames="dropped")
    assert evaluate_kradar(predictions, bus, settings).figures["ap/vehicle/3d/0.7"] == pytest.approx(0.5)


def test_the_score_cut_is_strict_and_is_told() -> None:
    annotations = {("1", str(i)): boxes([car(20)], scored=False) for i in range(40)}
    predictions = {("1", str(i)): boxes([car(20, score=0.3 if i < 20 else 0.4)]) for i in range(40)}
    result = evaluate_kradar(predictions, annotations, KRadarSettings(**PLAIN, score_cut=0.3))
    assert result.figures["ap/vehicle/3d/0.5"] == pytest.approx(0.5)
    assert result.counts["predictions_cut"] == 20
    assert "20 predictions at or below the score cut" in str(result)


def test_gaps_leave_a_perfect_detector_below_100_as_in_the_kit() -> None:
    annotations = {("1", str(i)): boxes([car(20)], scored=False) for i in range(10)}
    settings = kradar_settings("kradar-compat:revised_yaw_fixed", **PLAIN)
    assert evaluate_kradar(as_predictions(annotations), annotations, settings).figures[
        "ap/vehicle/3d/0.3"
    ] == pytest.approx(10 / 41)


def test_the_region_is_that_of_the_radar() -> None:
    places = [(10, 0), (71.9, 15.9), (73, 0), (10, 16.1), (1, 2), (-3, 0)]  # the fifth stands at 63 degrees
    rows = [car(x, y) for x, y in places]
    annotations = {("1", "1"): boxes(rows, scored=False)}

    def counted(**options: Any) -> int:
        return int(
            evaluate_kradar({}, annotations, KRadarSettings(bootstrap=NO_BOOTSTRAP, **options)).counts["annotated"]
        )

    assert counted() == 2
    assert counted(region="narrow") == 1
    assert counted(azimuth_deg=None) == 3
    assert counted(region="none") == 6
    assert counted(region=(70.0, 80.0, -1.0, 16.0, -2.0, 7.6)) == counted(region="70,80,-1,16,-2,7.6") == 2
    moved = {("1", "1"): annotations["1", "1"].replace(centre_m=annotations["1", "1"].centre_m + KRADAR_ORIGIN_M)}
    settings = KRadarSettings(bootstrap=NO_BOOTSTRAP, boxes_in="os2-64")
    assert evaluate_kradar({}, moved, settings).counts["annotated"] == 2


def test_predictions_outside_the_region_are_dropped_or_false() -> None:
    annotations = {("1", str(i)): boxes([car(20)], scored=False) for i in range(50)}
    predictions = {key: boxes([car(20, score=0.5), car(100, score=0.9)]) for key in annotations}
    for outside, expected in (("dropped", 1.0), ("kept", 0.5)):
        settings = KRadarSettings(bootstrap=NO_BOOTSTRAP, outside=outside)  # type: ignore[arg-type]
        figures = evaluate_kradar(predictions, annotations, settings).figures
        assert figures["ap/vehicle/bev/0.3"] == pytest.approx(expected)


def test_boxes_that_another_sensor_sees_may_be_found_or_not() -> None:
    annotations = {("1", str(i)): boxes([car(20), car(40)], scored=False) for i in range(50)}
    predictions = {key: boxes([car(20, score=0.5), car(40, score=0.9), car(60, score=0.7)]) for key in annotations}
    seen = dict.fromkeys(annotations, ("R", "L"))
    result = evaluate_kradar(predictions, annotations, KRadarSettings(**PLAIN), visibility=seen)
    assert result.visibility["R"]["ap/vehicle/3d/0.5"] == pytest.approx(0.5)  # the box at 60 m is false, not that at 40
    assert result.visibility["L"]["ap/vehicle/3d/0.5"] == pytest.approx(1.0)
    assert result.visibility["L1"]["ap/vehicle/3d/0.5"] is None
    assert result.to_json()["visibility"]["L1"] is None
    with pytest.raises(ConfigError, match="one word for each of 2 boxes"):
        evaluate_kradar(predictions, annotations, visibility={("1", "0"): ("R",)})


def test_the_convention_stands_beside_the_figures(rng: np.random.Generator) -> None:
    predictions, annotations = crowd(rng, frames=12)
    result = score(
        predictions,
        annotations,
        protocol="kradar-compat:old_as_shipped@0.3",
        label_version="v2.0",
        bootstrap=NO_BOOTSTRAP,
    )
    for shown in (
        "kradar-compat:old_as_shipped@0.3",
        "label_version=v2.0",
        "region=wide",
        "azimuth_deg=53",
        "score_cut=0.3",
        "recall_points=11",
        "empty_frames=dropped",
        "yaw=as_shipped",
        "z_center=1",
        "decimals=2",
    ):
        assert shown in str(result)
    tree = json.loads(json.dumps(result.to_json()))
    assert set(tree["ap"]) == {"vehicle", "large_vehicle"}
    assert set(tree["ap"]["vehicle"]["bev"]) == {"0.3", "0.5", "0.7"}
    assert len(tree["curves"]["overall"]["vehicle"]["3d"]["0.5"]["recall"]) <= 41


def test_intervals_hold_the_figures_and_repeat(rng: np.random.Generator) -> None:
    predictions, annotations = crowd(rng)
    settings = KRadarSettings(region="none", bootstrap=Bootstrap(replicates=40))
    conditions = {key: {"weather": "fog"} for key in annotations}
    result = evaluate_kradar(predictions, annotations, settings, conditions=conditions)
    again = evaluate_kradar(predictions, annotations, settings, conditions=conditions)
    assert result.intervals == again.intervals
    assert result.grouped_by == "sequences"
    assert set(result.intervals) >= {"overall", "weather/fog", "0-20"}
    for name, value in result.figures.items():
        low, high = result.intervals["overall"][name]
        assert low - 1e-12 <= value <= high + 1e-12, name
    assert "[low, high]" in str(result)


def test_k_radars_own_class_names_are_known() -> None:
    annotations = {("1", str(i)): boxes([car(20)], scored=False, label="Sedan") for i in range(41)}
    found = {key: part.replace(score=np.ones(1), label="vehicle") for key, part in annotations.items()}
    assert evaluate_kradar(found, annotations).figures["ap/vehicle/3d/0.7"] == 1.0
    assert scored_labels(annotations, "kradar") == ("vehicle",)
    result = score(found, annotations, protocol="kradar", label="vehicle", bootstrap=NO_BOOTSTRAP)
    assert set(result.to_json()["ap"]) == {"vehicle"}


def test_nothing_at_all_gives_nothing() -> None:
    assert set(evaluate_kradar({}, {}).figures.values()) == {None}
    annotations = {("1", "1"): boxes([car(20)], scored=False)}
    assert evaluate_kradar({}, annotations).figures["ap/vehicle/3d/0.3"] == 0.0
    assert "-" in str(evaluate_kradar({}, annotations))
    with pytest.raises(ConfigError, match="frames that are annotated"):
        evaluate_kradar(annotations, {})


@pytest.mark.parametrize(
    "wrong",
    [
        {"classes": ()},
        {"classes": ("vehicle", "vehicle")},
        {"classes": ("Sedan",)},
        {"classes": ("a/b",)},
        {"ious": (1.5,)},
        {"ious": ()},
        {"region": "broad"},
        {"region": (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)},
        {"azimuth_deg": 0.0},
        {"recall_points": 12},
        {"z_center": 0.7},
        {"yaw": "turned"},
        {"decimals": -1},
        {"score_cut": float("nan")},
        {"range_bins_m": (5.0,)},
        {"unknown": 1},
    ],
)
def test_impossible_settings_are_refused(wrong: dict[str, Any], without_shape_checks: None) -> None:
    with pytest.raises(ConfigError):
        kradar_settings("kradar", **wrong)


def test_variants_fix_their_options() -> None:
    assert kradar_settings("kradar-compat:rtnh_narrow").azimuth_deg == 50.0
    assert kradar_settings("kradar-compat:asf_wide").recall_points == 41
    assert {name.partition("@")[2] for name in VARIANTS} == {"", "0.3", "0.5", "0.7"}
    assert kradar_settings("kradar-compat:old_as_shipped", recall_points=11).z_center == 1.0
    with pytest.raises(ConfigError, match="fixes recall_points=11"):
        kradar_settings("kradar-compat:old_as_shipped", recall_points=41)
    for wrong in ("kradar-compat:new", "kradar-compat"):
        with pytest.raises(ConfigError, match="old_yaw_fixed"):
            score({}, {}, protocol=wrong)

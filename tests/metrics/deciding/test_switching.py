"""Switching the pattern by scenario: learnt on some drives, used on others."""

import pytest

from farfield.errors import ConfigError
from farfield.metrics import Detections
from farfield.metrics.deciding.switching import best_by, switched, switching_gains
from metrics.scenes import better_on

STILL = {"region": "none", "epsilons": (0.0,)}


def test_the_best_pattern_of_each_road_is_chosen_and_used_on_other_drives() -> None:
    found = {"gaussian": better_on("highway"), "uniform": better_on("urban")}
    assert best_by(found, **STILL) == {"urban": "uniform", "highway": "gaussian"}
    rule = switched(found, **STILL)
    assert rule.choices == ({"urban": "uniform", "highway": "gaussian"},) * 2
    for key, known in rule.detections.conditions.items():
        source = found["uniform" if known["road"] == "urban" else "gaussian"]
        assert rule.detections.boxes[key] is source.boxes[key]


def test_the_rule_lies_above_both_fixed_choices_where_each_is_best_somewhere() -> None:
    runs = {
        "gaussian": [better_on("highway", s) for s in range(3)],
        "uniform": [better_on("urban", s) for s in range(3)],
    }
    gains = switching_gains(runs, replicates=100, **STILL)
    assert {cloud: gain.interval()[0] > 0 for cloud, gain in gains.items()} == {"gaussian": True, "uniform": True}


def test_the_rule_gains_nothing_over_a_pattern_that_is_best_everywhere() -> None:
    good, bad = [better_on("highway", s) for s in range(2)], [better_on("nowhere", s) for s in range(2)]
    urban = [better_on("urban", s) for s in range(2)]
    both = [
        Detections(
            boxes={
                k: (h if c["road"] == "highway" else u)
                for (k, c), h, u in zip(
                    a.conditions.items(),
                    [a.boxes[k] for k in a.conditions],
                    [b.boxes[k] for k in a.conditions],
                    strict=True,
                )
            },
            annotations=a.annotations,
            conditions=a.conditions,
        )
        for a, b in zip(good, urban, strict=True)
    ]
    gains = switching_gains({"gaussian": both, "uniform": bad}, replicates=50, **STILL)
    assert gains["gaussian"].by_seed == (0.0, 0.0)
    assert min(gains["uniform"].by_seed) > 0.2


def test_frames_of_unknown_scenario_and_too_few_drives_are_refused() -> None:
    found = {"gaussian": better_on("highway"), "uniform": better_on("urban")}
    with pytest.raises(ConfigError, match="expected it of every frame"):
        switched(found, "weather", **STILL)
    with pytest.raises(ConfigError, match="2 folds or more"):
        switched(found, folds=13, **STILL)

"""Gradients at the shared features by hand, a fresh probe on clouds of numbers, failure modes on made logs."""

import math
from typing import Any

import pytest

torch = pytest.importorskip("torch")

from farfield.adaptation.adversarial import reverse
from farfield.adaptation.failure_modes import diagnose_log
from farfield.adaptation.probes import gradient_norms, gradient_ratio, probe_accuracy
from farfield.detectors.features import FeatureMap, PointFeatures


def map_of(values: Any) -> FeatureMap:
    return FeatureMap(values=values, cell_m=1.0, origin_m=(0.0, 0.0))


def test_gradient_norms_are_those_worked_out_by_hand() -> None:
    leaf = torch.ones(1, 2, 1, 2, requires_grad=True)
    features = map_of(leaf * 2.0)
    losses = {
        "detection": (3 * features.values).sum(),  # 3 at each of four numbers
        "global": reverse(features.values, 0.5)[0, 0].sum(),  # -0.5 at two of them
        "local": torch.zeros(()),  # does not reach them
    }
    norms = gradient_norms(losses, [features])
    assert norms == pytest.approx({"gradient_detection": 6.0, "gradient_global": math.sqrt(0.5), "gradient_local": 0.0})
    assert gradient_ratio(norms) == pytest.approx(math.sqrt(0.5) / 6)
    assert math.isnan(gradient_ratio({"gradient_detection": 0.0, "gradient_global": 1.0}))
    assert leaf.grad is None
    (losses["detection"] + losses["global"]).backward()  # the graph is still there
    assert leaf.grad is not None


def test_gradients_of_several_features_count_together() -> None:
    one = torch.ones(1, 1, 1, 1, requires_grad=True) * 1.0
    points = PointFeatures(values=torch.ones(2, 2, requires_grad=True) * 1.0, xyz=torch.zeros(2, 3), lengths=[2])
    norms = gradient_norms({"both": 3 * one.sum() + 2 * points.values.sum()}, [map_of(one), points])
    assert norms == {"gradient_both": 5.0}  # 9 + 4 * 4


def frames(shift: float, seed: int, count: int = 4) -> list[Any]:
    generator = torch.Generator().manual_seed(seed)
    return [torch.randn(300, 6, generator=generator) + shift for _ in range(count)]


def test_a_probe_tells_shifted_clouds_and_not_equal_ones() -> None:
    assert probe_accuracy(frames(0.0, 1), frames(2.0, 2)) > 0.95
    assert probe_accuracy(frames(0.0, 1), frames(0.0, 2)) == pytest.approx(0.5, abs=0.06)
    assert math.isnan(probe_accuracy(frames(0.0, 1, 1), frames(0.0, 2)))
    constant = [torch.ones(10, 3)] * 2
    assert probe_accuracy(constant, constant) == 0.5  # no number is divided by a spread of 0


def test_a_probe_changes_neither_the_draws_nor_the_features() -> None:
    one, other = frames(0.0, 1), frames(1.0, 2)
    torch.manual_seed(5)
    wanted = torch.rand(3)
    torch.manual_seed(5)
    with torch.no_grad():
        probe_accuracy(one, other)
    assert torch.equal(torch.rand(3), wanted)


def rows(**columns: list[float]) -> list[dict[str, float]]:
    count = max(map(len, columns.values()))
    return [{"step": 20.0 * n, **{name: values[n] for name, values in columns.items()}} for n in range(count)]


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"discriminator_accuracy": [0.7, 0.9, 0.97, 0.98, 0.99, 0.99]}, "always right in the last half"),
        ({"held_accuracy": [0.7, 0.9, 0.97, 0.98, 0.99, 0.99]}, "always right in the last half"),
        ({"discriminator_accuracy": [0.6, 0.51, 0.51, 0.5], "probe_accuracy": [0.9] * 4}, "a fresh linear probe"),
        ({"discriminator_accuracy": [0.5] * 8 + [0.95, 0.5, 0.95, 0.5, 0.95, 0.5, 0.95, 0.5]}, "unstable game"),
        ({"rank_near": [20.0] * 4 + [12] * 8 + [6] * 4}, "the rank of the features of near fell to 30%"),
        ({"variance_target": [1.0] * 12 + [0.5, 0.4, 0.6, 0.5]}, "the variance of the features of target fell to 50%"),
        ({"gradient_ratio": [0.1, 0.5, 2.0, 4.0]}, "pulls 3.0 times as hard"),
        ({"pseudo_boxes": [4.0, 5, 4, 3] + [8] * 8 + [12, 11, 13, 12]}, "more and more confident pseudo-labels"),
        ({"pseudo_boxes": [4.0] * 12 + [1] * 4}, "fewer and fewer confident pseudo-labels"),
        ({"n_eff": [40.0, 300.0]}, "the class mean; lower tau"),
        ({"n_eff": [40.0, 1.0]}, "a copy of one object; raise tau"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_each_failure_is_named(columns: dict[str, list[float]], words: str) -> None:
    (found,) = diagnose_log(rows(**columns))
    assert words in found


def test_a_healthy_log_and_an_empty_one_are_passed_over() -> None:
    healthy = rows(
        discriminator_accuracy=[0.75, 0.7, 0.65, 0.6, 0.58, 0.56, 0.55, 0.55],
        probe_accuracy=[0.9, 0.85, 0.8, 0.75, 0.7, 0.7, 0.7, 0.7],
        rank_near=[20.0, 21, 22, 22, 22, 22, 22, 22],
        gradient_ratio=[0.05] * 8,
        pseudo_boxes=[4.0, 4, 5, 5, 5, 6, 6, 6],
        n_eff=[20.0] * 8,
    )
    assert not list(diagnose_log(healthy))
    assert not list(diagnose_log([]))
    assert not list(diagnose_log(rows(loss=[1.0, 0.5])))
    assert not list(diagnose_log(rows(pseudo_boxes=[3.0, 9.5, 10.5, 10])))  # too few rows to say
    noise = [1.0, 9, 0, 2] + [5.0] * 8 + [2.0, 14, 1, 12]
    assert not list(diagnose_log(rows(pseudo_boxes=noise)))

"""One number of a run: under its own sequences it is the result's, under draws its interval is the result's."""

import numpy as np
import pytest

from farfield.errors import ConfigError
from farfield.frame.annotation import Annotation
from farfield.metrics import Bootstrap, Detections, Protocol
from farfield.metrics.centre.dds import Dds
from farfield.metrics.deciding import figure, sample, samples
from metrics.scenes import random_scene


class Unweighted(Dds):
    """A protocol of another package, written before figures could be resampled."""

    weighted = Protocol.weighted  # type: ignore[assignment]


def found(seed: int = 0, **facts: object) -> Detections:
    predictions, annotations = random_scene(np.random.default_rng(seed), frames=24, sequences=6)
    weathers = ("normal", "sleet", "fog")
    conditions = {key: {"weather": weathers[int(key[0][5:]) % 3]} for key in annotations}
    return Detections(
        boxes=predictions,
        annotations={key: Annotation(boxes=boxes) for key, boxes in annotations.items()},
        conditions=conditions,
        **facts,
    )


CASES = [
    ("dds", "dds/0/dds", "overall"),
    ("dds", "dds/0.006/dds", "0-70"),
    ("dds", "dds/0/map", "mean_of_bins"),
    ("nuscenes", "map", "overall"),
    ("kitti", "ap/3d_r40/all", "overall"),
    ("kitti", "ap/bev_r11/all", "70-150"),
    ("kradar", "ap/vehicle/3d/0.3", "overall"),
    ("kradar", "ap/vehicle/bev/0.3", "weather/sleet"),
]


@pytest.mark.parametrize(("protocol", "name", "part"), CASES)
def test_it_is_the_figure_of_the_result_and_its_interval(protocol: str, name: str, part: str) -> None:
    settings = {"kitti": {"label": "vehicle"}, "kradar": {"classes": ("vehicle",), "region": "none"}}.get(protocol, {})
    result = found().score(protocol, bootstrap=Bootstrap(replicates=60, seed=3), **settings)
    taken = sample(found(), figure(name, part), protocol=protocol, replicates=60, seed=3, **settings)
    home = {"overall": result.figures, "mean_of_bins": result.mean_of_bins, **result.ranges}
    home |= {f"weather/{value}": v for value, v in getattr(result, "conditions", {}).get("weather", {}).items()}
    assert taken.value is not None
    assert taken.value == pytest.approx(home[part][name], abs=1e-12)
    interval = result.intervals[part][name]
    assert interval is not None
    known = taken.draws[np.isfinite(taken.draws)]
    np.testing.assert_allclose(np.quantile(known, [0.025, 0.975]), interval, rtol=1e-12)
    assert taken.groups == 6
    assert taken.grouped_by == "sequences"


def test_differences_and_sums_of_figures_are_taken_draw_by_draw() -> None:
    near, far = figure("dds/0/dds", "0-70"), figure("dds/0/dds", "70-150")
    one, other, both = (sample(found(), each, replicates=40) for each in (near, far, near - far))
    assert both.value == pytest.approx(one.value - other.value, abs=1e-15)
    np.testing.assert_allclose(both.draws, one.draws - other.draws, atol=1e-15)
    assert str(near + far - near) == "dds/0/dds (0-70) + dds/0/dds (70-150) - dds/0/dds (0-70)"


def test_equal_seeds_draw_equally_and_others_do_not() -> None:
    first, again = (sample(found(), figure("dds/0/dds"), replicates=30, seed=5) for _ in range(2))
    np.testing.assert_array_equal(first.draws, again.draws)
    assert first.drawn == again.drawn
    for changed in (
        sample(found(), figure("dds/0/dds"), replicates=30, seed=6),
        sample(found(), figure("dds/0/dds"), replicates=31, seed=5),
    ):
        assert changed.drawn != first.drawn


def test_a_bin_beyond_the_detectors_reach_has_no_figure() -> None:
    taken = sample(found(reach_m=100.0), figure("dds/0/dds", "150-250"), replicates=10)
    assert taken.value is None
    assert np.isnan(taken.draws).all()


def test_what_is_not_there_is_named() -> None:
    with pytest.raises(ConfigError, match="expected some of overall, 0-70"):
        sample(found(), figure("dds/0/dds", "0-99"), replicates=2)
    with pytest.raises(ConfigError, match=r"expected one of ap/0\.5"):
        sample(found(), figure("dds"), replicates=2)


def test_a_protocol_without_weights_says_so() -> None:
    with pytest.raises(ConfigError, match="whose figures can be resampled"):
        sample(found(), figure("dds/0/dds"), protocol=Unweighted(), replicates=2)


def test_several_numbers_at_once_are_those_taken_one_by_one() -> None:
    scalars = {"all": figure("dds/0/dds"), "lost": figure("dds/0/dds", "0-70") - figure("dds/0/dds", "70-150")}
    together = samples(found(), scalars, replicates=25, seed=2)
    for name, scalar in scalars.items():
        alone = sample(found(), scalar, replicates=25, seed=2)
        assert together[name].value == alone.value
        np.testing.assert_array_equal(together[name].draws, alone.draws)
        assert together[name].drawn == alone.drawn


def test_of_some_frames_sequences_are_drawn_as_of_all() -> None:
    whole, scalar = found(), figure("dds/0/dds")
    some = sorted(whole.annotations)[::3]  # of some sequences other frames than of others
    few = Detections(
        boxes={key: whole.boxes[key] for key in some if key in whole.boxes},
        annotations={key: whole.annotations[key] for key in some},
    )
    taken = samples(whole, {"": scalar}, replicates=20, frames=some)[""]
    assert taken.value == sample(few, scalar, replicates=2).value
    everything = samples(whole, {"": scalar}, replicates=20, frames=[*whole.annotations])[""]
    plain = sample(whole, scalar, replicates=20)
    np.testing.assert_array_equal(everything.draws, plain.draws)
    assert taken.drawn == plain.drawn  # so that both can be compared
    assert not np.array_equal(taken.draws, plain.draws)


def test_of_frames_of_one_sequence_each_draw_weighs_it_as_often_as_it_came() -> None:
    whole = found()
    one = [key for key in whole.annotations if key[0] == next(iter(whole.annotations))[0]]
    taken = samples(whole, {"": figure("dds/0/dds")}, replicates=40, frames=one)[""]
    known = taken.draws[np.isfinite(taken.draws)]
    np.testing.assert_allclose(known, taken.value)  # a single sequence, however often it is drawn
    assert 0 < len(known) < 40  # some draws have it not at all

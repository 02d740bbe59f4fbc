"""Intervals over objects beside what is known exactly: a share of independent objects, and objects seen many times."""

import numpy as np
import pytest

from farfield.frame import Boxes
from farfield.metrics.bootstrap import Bootstrap
from farfield.metrics.centre.dds import DdsSettings, evaluate_dds
from farfield.metrics.centre.objects import object_intervals

DRAWN = Bootstrap(replicates=1_000)
SETTINGS = DdsSettings(label="vehicle", region="none", epsilons=(0.0,), bootstrap=DRAWN)


def boxes(places: np.ndarray, **more: np.ndarray) -> Boxes:
    count = len(places)
    size = np.tile([4.4, 1.9, 1.6], (count, 1))
    return Boxes(centre_m=places, size_m=size, yaw_rad=np.zeros(count), label=["vehicle"] * count, **more)


def scene(count: int, found: int, frames: int = 1, *, named: bool = True, strays: int = 0) -> tuple[dict, dict]:
    """Objects 10 m apart of which the first are found exactly, the same in every frame, and false positives."""
    places = np.column_stack([10.0 * np.arange(count) + 5, np.zeros(count), np.zeros(count)])
    wrong = np.column_stack([10.0 * np.arange(strays) + 5, np.full(strays, 40.0), np.zeros(strays)])
    predicted = np.concatenate([places[:found], wrong])
    scores = np.linspace(0.9, 0.5, len(predicted))
    truth, guess = {}, {}
    for frame in range(frames):
        truth["a", str(frame)] = boxes(places, **({"track_id": np.arange(count)} if named else {}))
        guess["a", str(frame)] = boxes(predicted, score=scores)
    return guess, truth


def test_a_share_has_the_interval_of_independent_objects() -> None:
    guess, truth = scene(100, 60)
    found = object_intervals(guess, truth, SETTINGS)
    assert found.objects == 100
    low, high = found.intervals["dds/0/map"] or (0, 0)
    value = evaluate_dds(guess, truth, SETTINGS).figures["dds/0/map"]
    assert value is not None
    assert low < value < high
    expected = 1.96 * np.sqrt(0.6 * 0.4 / 100) / 0.9  # AP counts recall from 0.1 to 1
    assert (high - low) / 2 == pytest.approx(expected, rel=0.2)


def test_what_is_seen_three_times_is_no_more_certain() -> None:
    once, three = (object_intervals(*scene(60, 30, frames), SETTINGS) for frames in (1, 3))
    assert three.objects == once.objects == 60
    assert three.intervals["dds/0/dds"] == pytest.approx(once.intervals["dds/0/dds"], abs=0.01)
    nameless = object_intervals(*scene(60, 30, 3, named=False), SETTINGS)
    assert nameless.objects == 180
    widths = [high - low for low, high in (each.intervals["dds/0/dds"] for each in (once, nameless))]
    assert widths[1] == pytest.approx(widths[0] / np.sqrt(3), rel=0.2)


def test_false_positives_stay_and_nothing_varies_where_all_is_found() -> None:
    guess, truth = scene(40, 40, strays=10)
    low, high = object_intervals(guess, truth, SETTINGS).intervals["dds/0/map"] or (0, 0)
    value = evaluate_dds(guess, truth, SETTINGS).figures["dds/0/map"]
    assert low == pytest.approx(high, abs=0.01) == pytest.approx(value, abs=0.01)


def test_one_object_has_no_interval() -> None:
    found = object_intervals(*scene(1, 1), SETTINGS)
    assert (found.objects, set(found.intervals.values())) == (1, {None})

"""Intervals over objects beside what is known exactly: a share of independent objects, and objects seen many times."""

import numpy as np
import pytest

from farfield.frame import Boxes
from farfield.metrics.bootstrap import Bootstrap
from farfield.metrics.centre.dds import DdsSettings, evaluate_dds
from farfield.metrics.centre.objects import object_differences, object_intervals

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


def test_a_difference_is_that_of_the_objects_that_changed() -> None:
    """Of 100 objects 60 were found, then 20 more: the variance is that of 20 changes, not of two independent shares."""
    (before, truth), (after, _) = scene(100, 60), scene(100, 80)
    found = object_differences(before, after, truth, SETTINGS)
    low, high = found.intervals["dds/0/map"] or (0, 0)
    assert found.after["dds/0/map"] - found.before["dds/0/map"] == pytest.approx(0.2 / 0.9, abs=0.01)
    expected = 1.96 * np.sqrt(0.2 * 0.8 / 100) / 0.9
    assert (high - low) / 2 == pytest.approx(expected, rel=0.2)  # 1.6 times as wide if they were drawn apart
    assert (found.objects, found.scenes) == (100, 1)
    same = object_differences(after, after, truth, SETTINGS)
    assert set(same.intervals.values()) == {(0.0, 0.0)}


def test_whole_scenes_are_drawn_where_there_are_several() -> None:
    """Twenty scenes of ten objects; in half of them nothing changed, in the others all were found."""
    scenes: list[list[dict]] = [[], [], []]
    for number in range(20):
        better = 10 if number % 2 else 5
        (before, truth), (after, _) = scene(10, 5), scene(10, better)
        for part, boxes_of in zip(scenes, (before, after, truth), strict=True):
            part.append({(f"scene {number}", "0"): boxes_of["a", "0"]})
    before, after, truth = ({key: one for part in parts for key, one in part.items()} for parts in scenes)
    found = object_differences(before, after, truth, SETTINGS)
    low, high = found.intervals["dds/0/map"] or (0, 0)
    within = 10 * 0.25 / 100 / 10  # of ten objects five changed, in half of the scenes
    expected = 1.96 * np.sqrt((0.25 * 0.25 + within / 2) / 20) / 0.9
    assert (high - low) / 2 == pytest.approx(expected, rel=0.2)
    assert (found.objects, found.scenes) == (200, 20)
    alone, of_scenes = (object_intervals(after, truth, SETTINGS, scenes=scenes) for scenes in (None, {}))
    spans = [np.diff(own.intervals["dds/0/map"] or (0, 0))[0] for own in (alone, of_scenes)]
    assert spans[1] > 1.5 * spans[0]  # ten objects of a scene are found or missed together
    one = object_differences(before, after, truth, SETTINGS, scenes=dict.fromkeys(truth, "all"))
    width = np.diff(one.intervals["dds/0/map"] or (0, 0))[0]
    assert one.scenes == 1
    assert width / 2 == pytest.approx(1.96 * np.sqrt(0.25 * 0.75 / 200) / 0.9, rel=0.2)


def test_a_scenes_false_positives_come_as_often_as_the_scene() -> None:
    truth, guess = {}, {}
    for number in range(10):
        own_guess, own_truth = scene(8, 8, strays=4 if number % 2 else 0)
        guess[f"{number}", "0"], truth[f"{number}", "0"] = own_guess["a", "0"], own_truth["a", "0"]
    clean = {key: one[one.centre_m[:, 1] < 1] for key, one in guess.items()}
    found = object_differences(guess, clean, truth, SETTINGS)
    low, high = found.intervals["dds/0/map"] or (0, 0)
    assert high - low > 0.02
    assert low > 0

"""Objects annotated by a hand with errors, as studio_fitting.py does with forty: what the label files hold."""

import numpy as np
import pytest

pytest.importorskip("starlette")
pytest.importorskip("embreex")
pytest.importorskip("numba")
from _studio_screen import Hand, annotated, emptied, errors_of
from studio_fitting import HEIGHT_M, HEIGHT_PX, draw_new, draw_next, near_objects, polar_errors, simulated, unseen

from farfield.datasets import open_dataset
from farfield.radar.axes import KRADAR_AXES

pytestmark = pytest.mark.slow  # simulates, and draws as a person does
FEW = 6


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    arguments = ("--frames", "4", "--sequences", "2", "--sensors", "os2-64", "--stride-s", "0.1")
    return simulated(tmp_path_factory.mktemp("forty") / "drives", *arguments)


def test_new_objects_by_one_drag_each(chromium, drives, tmp_path):
    chosen = near_objects(drives, FEW)
    copy = emptied(drives, tmp_path / "new")
    assert not any(copy.boxes())
    with annotated(copy, chromium) as page:
        made = draw_new(Hand(page), chosen)
    found, there = errors_of(copy, chosen, made)
    assert there.sum() >= FEW - 1
    assert np.median(found.centre_m) < 0.2  # of six, some of which hide an end
    assert np.median(found.yaw_deg) < 2
    assert len([label for frame in copy.boxes() for label in frame]) == there.sum()
    assert {label.track for frame in copy.boxes() for label in frame} == {str(row["track"]) for row in made if row}


def test_the_next_box_of_a_track_takes_its_size(chromium, drives, tmp_path):
    chosen = near_objects(drives, FEW)
    copy = emptied(drives, tmp_path / "next", sorted({frame for frame, _ in chosen}))
    with annotated(copy, chromium) as page:
        made = draw_next(Hand(page), drives, chosen)
    found, there = errors_of(copy, chosen, made)
    assert there.all()
    assert np.median(found.centre_m) <= 0.10
    assert np.median(found.yaw_deg) <= 2
    for (_, one), row in zip(chosen, made, strict=True):
        assert row["box"][3:6] == pytest.approx(one.box.size_m[0], abs=2e-3)


def test_an_object_of_the_radar_alone(chromium, tmp_path):
    arguments = ("--frames", "1", "--sequences", "1", "--sensors", "os2-64,polar3d", "--weather", "fog")
    source = simulated(tmp_path / "fog", *arguments)
    data = open_dataset(source)
    found = list(unseen(data[0]))
    one, place = min(found, key=lambda each: abs(each[0].range_m - 60))
    copy = emptied(source, tmp_path / "copy")
    with annotated(copy, chromium) as page:
        hand = Hand(page)
        hand.choose("Sedan")
        made = hand.peak(place + np.random.default_rng(1).normal(0, hand.error_m, 2))
        assert made["source"] == "radar"
        assert not made["points"]
        raised = hand.raised(one, np.random.default_rng(2), HEIGHT_PX)
        assert raised["box"][:2] == made["box"][:2]
        assert abs(raised["box"][2] - one.box.centre_m[0, 2]) <= HEIGHT_M
        assert abs(raised["box"][5] - one.box.size_m[0, 2]) <= HEIGHT_M
    pose = data[0].sensors["radar"].frame_T_sensor
    ((range_m, turn),) = polar_errors(copy, [(0, one)], [raised], pose[:2, 3])
    assert abs(range_m) <= KRADAR_AXES.range_step_m
    assert abs(turn) <= 1.0

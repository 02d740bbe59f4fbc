"""Radar clouds in one form: power over the floor of its range, flags, the strongest point of a cell."""

import pickle
from types import SimpleNamespace

import numpy as np
import pytest

from farfield.datasets import maps
from farfield.datasets.maps.common_radar import CommonRadar, strongest
from farfield.errors import ConfigError
from farfield.frame import Cloud, Frame

RNG = np.random.default_rng(0)


def cloud(count: int = 4000, *, fall_db: float = 40.0, shift_db: float = 0.0, extra: bool = True) -> Cloud:
    """Noise whose level falls with range, in a unit of its own."""
    points = RNG.uniform([1, -20, -2], [90, 20, 2], (count, 3)).astype(np.float32)
    range_m = np.linalg.norm(points, axis=1)
    power = 10 ** ((shift_db - fall_db * np.log10(range_m) + RNG.normal(0, 2, count)) / 10)
    columns = {"power": power.astype(np.float32)}
    return Cloud(points, None, columns | ({"doppler_m_s": RNG.normal(0, 1, count).astype(np.float32)} if extra else {}))


def frame_of(one: Cloud):
    return Frame(sequence="1", frame_id="000001", clouds={"radar": one})


def test_two_units_and_floors_become_one() -> None:
    """The same scene in another unit, 100 dB up: the same values, whose median is 0 at every range."""
    first = cloud()
    second = Cloud(first.points_m, None, {"strength": (10 * np.log10(first.extra["power"]) + 100) / 127.5})
    one = CommonRadar(floor_db=(0.0,)).fitted([frame_of(first)])
    other = CommonRadar(floor_db=(0.0,), column="strength", unit="db", db_per_one=127.5, doppler=False).fitted(
        [frame_of(second)]
    )
    values = [each.of_cloud(which).extra["power"] for each, which in ((one, first), (other, second))]
    np.testing.assert_allclose(values[0], values[1], atol=2e-4)
    range_m = np.linalg.norm(first.points_m, axis=1)
    for low in range(10, 80, 10):
        assert abs(np.median(values[0][(range_m >= low) & (range_m < low + 10)])) < 0.02
    assert len(one.floor_db) == len(one.spread_db) == 24
    assert one.spread_db[8] == pytest.approx(0.6745 * 2, abs=0.4)


def test_twenty_decibels_over_the_floor_are_one_and_the_rest_is_cut() -> None:
    form = CommonRadar(floor_db=(10.0, 20.0), unit="db", doppler=False)
    points = np.array([[2, 0, 0], [7, 0, 0], [7, 0, 0], [7, 0, 0]], dtype=np.float32)
    made = form.of_cloud(Cloud(points, None, {"power": np.array([30.0, 40.0, 500.0, -100.0], dtype=np.float32)}))
    assert made.extra["power"].tolist() == [1.0, 1.0, 4.0, -1.0]
    assert made.extra["has_doppler"].tolist() == [0.0] * 4
    assert made.extra["doppler_m_s"].tolist() == [0.0] * 4
    assert made.extra["has_height"].tolist() == [1.0] * 4


def test_height_may_be_unknown_and_doppler_left_out_of_some_frames() -> None:
    flat = CommonRadar(floor_db=(0.0,), height=False).of_cloud(cloud(50))
    assert (flat.points_m[:, 2] == 0).all()
    assert (flat.extra["has_height"] == 0).all()
    assert (flat.extra["has_doppler"] == 1).all()
    some = CommonRadar(floor_db=(0.0,), drop_doppler=0.3)
    dropped = [
        some.of_cloud(cloud(5), ("drive", f"{number:06d}")).extra["has_doppler"][0] == 0 for number in range(400)
    ]
    assert 0.24 < np.mean(dropped) < 0.36


def test_the_strongest_of_a_cell_stays() -> None:
    points = np.array([[0.1, 0.1, 0], [0.3, 0.2, 0], [0.5, 0.1, 0], [-0.1, 0.1, 0]], dtype=np.float32)
    assert strongest(points, np.array([1, 3, 2, 0], dtype=np.float32), 0.4).tolist() == [1, 2, 3]


def test_it_has_a_name_pickles_and_says_its_settings() -> None:
    form = CommonRadar(floor_db=(1.0, 2.0), cell_m=0.4, format="radiate")
    assert pickle.loads(pickle.dumps(form)) == form
    assert maps.make("common_radar", form.settings()) == form
    assert form.fits(SimpleNamespace(name="radiate"))
    assert not form.fits(SimpleNamespace(name="kradar"))
    with pytest.raises(ConfigError, match="floor_db"):
        maps.make("common_radar", {"floor_db": []})
    with pytest.raises(ConfigError, match="20 points"):
        CommonRadar(floor_db=(0.0,)).fitted([frame_of(cloud(3))])

"""Clouds as tensors with named columns, and batches of them."""

import pickle

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from farfield.detectors.inputs import POSITION, CloudInput, Inputs, cloud_tensor, features_of
from farfield.errors import ConfigError
from farfield.frame import Cloud


def cloud(**extra) -> Cloud:
    points = np.arange(12, dtype=np.float32).reshape(4, 3)
    return Cloud(points, np.array([0.1, 0.2, 0.3, 0.4], np.float32), {k: np.asarray(v) for k, v in extra.items()})


def test_columns_come_by_name_in_the_order_asked_for():
    given = cloud(power=[1.0, 2, 3, 4], doppler_m_s=[5, 6, 7, 8])
    rows = cloud_tensor(given, (*POSITION, "doppler_m_s", "power"))
    assert rows.dtype == torch.float32
    assert rows[:, 3:].tolist() == [[5, 1], [6, 2], [7, 3], [8, 4]]
    assert torch.equal(cloud_tensor(given, POSITION), torch.tensor(given.points_m))
    assert features_of((*POSITION, "doppler_m_s", "power")) == [3, 4]


def test_lag_is_zero_where_there_is_none_and_what_is_missing_is_an_error():
    assert cloud_tensor(cloud(), (*POSITION, "lag_s"))[:, 3].tolist() == [0, 0, 0, 0]
    with pytest.raises(ConfigError, match="doppler_m_s"):
        cloud_tensor(cloud(), (*POSITION, "doppler_m_s"))


def test_points_that_are_not_finite_are_dropped_and_other_values_count_as_zero():
    given = cloud(power=[1.0, np.nan, 3, 4], lag_s=[0, 0, np.inf, 0], doppler_m_s=[1, 2, 3, np.nan])
    for columns in (POSITION, (*POSITION, "power")):
        assert cloud_tensor(given, columns)[:, 0].tolist() == [0, 9]  # whether or not the column is read
    assert cloud_tensor(given, (*POSITION, "doppler_m_s"))[:, 3].tolist() == [1, 0]


def test_positions_come_first_and_no_column_twice():
    with pytest.raises(ConfigError, match="z_m"):
        CloudInput(columns=("x_m", "y_m", "power"))
    with pytest.raises(ConfigError, match="once"):
        CloudInput(columns=(*POSITION, "power", "power"))
    assert CloudInput().columns == (*POSITION, "intensity", "lag_s")


def test_inputs_join_frame_by_frame():
    one = Inputs({"lidar": [torch.zeros(3, 4)], "radar": [torch.ones(2, 5)]})
    two = Inputs({"radar": [torch.ones(0, 5)] * 2, "lidar": [torch.zeros(1, 4)] * 2})
    both = one + two
    assert len(both) == 3
    assert [len(each) for each in both["radar"]] == [2, 0, 0]
    assert dict(both).keys() == {"lidar", "radar"}
    assert both.to(torch.float64)["lidar"][2].dtype == torch.float64
    assert len(pickle.loads(pickle.dumps(both))) == 3
    with pytest.raises(ConfigError, match="same inputs"):
        one + Inputs({"lidar": [torch.zeros(3, 4)]})
    with pytest.raises(ConfigError, match="as many frames"):
        Inputs({"lidar": [torch.zeros(3, 4)], "radar": []})


def test_infinities_of_both_signs_are_dropped_without_a_warning():
    given = cloud(power=[np.inf, 2, -np.inf, 4])
    rows = cloud_tensor(given, (*POSITION, "power"))
    assert rows[:, 3].tolist() == [2, 4]

"""Custom sets of OpenPCDet and mmdetection3d, and Dual-Radar, by generators that have not seen the readers."""

import pytest

from .generators.custom import write_custom
from .generators.dual_radar import write_dual_radar
from .generators.truth import check_dataset, open_recognised, published_part


@pytest.mark.parametrize("kind", ["openpcdet", "mmdetection3d"])
def test_a_custom_set_is_read_as_it_was_written(kind, tmp_path):
    truth = write_custom(tmp_path, kind=kind)
    data = open_recognised(tmp_path)
    check_dataset(data, truth)
    assert published_part(data, "val").keys == data.keys[-1:]


def test_dual_radar_is_read_as_it_was_written(tmp_path):
    truth = write_dual_radar(tmp_path, frames=21)
    check_dataset(open_recognised(tmp_path), truth)

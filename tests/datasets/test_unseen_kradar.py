"""K-Radar's percentage clouds and disk folders by a generator that has not seen the reader."""

from dataclasses import replace

import numpy as np
import pytest

from .generators.kradar import SHARES, write_kradar
from .generators.truth import check_dataset, near, open_recognised


@pytest.mark.parametrize("disk", [False, True])
def test_sweeps_and_labels_are_read_as_they_were_written(disk, tmp_path):
    truth = write_kradar(tmp_path, disk=disk)
    frames = [replace(frame, clouds={"os2-64": frame.clouds["os2-64"]}) for frame in truth.frames]
    check_dataset(open_recognised(tmp_path), replace(truth, frames=frames))


@pytest.mark.parametrize("share", SHARES)
def test_every_share_is_a_product_of_its_own(share, tmp_path):
    truth = write_kradar(tmp_path)
    frame = open_recognised(tmp_path)[1]
    expected = truth.frames[1].clouds[f"pc{share}p"]
    product = "polar_cloud" if share == 10 else f"polar_cloud_{share}p"
    cloud = frame.radar[product]
    near(np.asarray(getattr(cloud, "points_m", cloud))[:, :3], expected.world_m, 1e-4, product)

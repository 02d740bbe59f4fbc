"""What encoders say of a cell where positions are relative: the same wherever the cell lies."""

import numpy as np
import pytest
import torch
from small import small_detector
from torch import Tensor

from farfield.detectors.voxels import mean_voxels


@pytest.mark.parametrize("name", ["pointpillars", "second"])
def test_local_features_do_not_change_where_all_points_move_by_whole_cells(name, rng) -> None:
    """SECOND's means of voxels are those of VoxelNet's and the sparse detector's input too; absolute ones differ."""
    points = np.round(rng.uniform([6, -4, -1.8], [14, 4, 0.5], (300, 3)) * 1024) / 1024
    moved = points + np.array([16.0, 8.0, 0.0])  # whole cells of every small detector
    for positions, same in (("relative", True), ("absolute", False)):
        network = small_detector(name, positions=positions).eval()
        columns = network.inputs["points"].columns
        clouds = [np.column_stack([part, np.zeros((300, len(columns) - 3))]) for part in (points, moved)]
        with torch.no_grad():
            one, other = (features(network, torch.from_numpy(cloud).float(), positions) for cloud in clouds)
        assert one.shape == other.shape
        assert np.allclose(one, other, atol=1e-4) == same


def features(network: torch.nn.Module, cloud: Tensor, positions: str) -> np.ndarray:
    """What is said of the occupied cells, in their order."""
    if network.config.name == "pointpillars":
        image = network.encoder(cloud, torch.zeros(len(cloud), dtype=torch.long), 1)[0].flatten(1).T
        return image[image.abs().sum(1) > 0].numpy()
    columns = network.inputs["points"].columns
    return mean_voxels([cloud], network.config.grid, 8, columns=columns, positions=positions).features.numpy()

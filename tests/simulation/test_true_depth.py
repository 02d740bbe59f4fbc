"""The exact depth of simulated pixels, and how near depth maps come to it."""

import numpy as np
import pytest

pytest.importorskip("embreex")

from depth import true_depth

from farfield.depth import depth_map
from farfield.depth.maps import cloud_and_camera
from farfield.metrics.depth import depth_errors
from farfield.simulation.presets import find_preset
from farfield.simulation.rigs.drive import drive_of
from farfield.simulation.rigs.kitti import KittiFrame
from farfield.simulation.sequence import simulate_frame


def test_a_simulated_sweep_agrees_with_the_exact_depth() -> None:
    preset = find_preset("kitti-sim", weather="normal")
    frame = simulate_frame(preset, sequence=0, index=0, sensors=("lidar",))
    points, lens = cloud_and_camera(frame)
    moment = KittiFrame(drive_of(preset, preset.seed, 0), 0)
    truth = true_depth(moment.window, frame.cameras["camera"], moment.world_T_lidar)
    assert truth.shape == (lens.height_px, lens.width_px)
    assert np.isnan(truth).any()  # there is sky
    made = depth_map(points.points_m, lens, ring=points.extra["ring"].astype(np.int64))
    near = depth_errors(made.depth_m, np.where(truth < 20, truth, np.nan))
    assert near.mae_mm < 300
    measured = np.where(made.measured & (truth < 20), truth, np.nan)
    assert depth_errors(made.depth_m, measured).mae_mm < 200
    pixels = np.argwhere(truth < 20)[::997]
    rays = lens.rays(pixels[:, ::-1].astype(np.float64))
    assert np.isfinite(rays).all()

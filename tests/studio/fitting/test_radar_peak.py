"""Boxes for objects that the radar alone sees."""

from dataclasses import replace

import numpy as np
import pytest
from fitting_scenes import road

from farfield.studio.fitting import fit_radar_peak, prior_of


@pytest.mark.parametrize(("peak", "middle"), [((40.0, 0.0), (42.305, 0.0)), ((0.0, 40.0), (0.0, 41.09))])
def test_the_near_face_lies_at_the_peak(
    rng: np.random.Generator, peak: tuple[float, float], middle: tuple[float, float]
) -> None:
    prior = replace(prior_of("Sedan"), lane_rad=0.0)
    found = fit_radar_peak(road(rng), peak, prior)
    assert found.box[:2] == pytest.approx(middle)
    assert found.box[2] - found.box[5] / 2 == pytest.approx(-1.9, abs=0.05)
    assert (found.heading, found.criterion, found.note) == ("lane", "lane", "")


def test_yaw_of_the_track_else_the_line_of_sight() -> None:
    nothing = np.zeros((0, 3))
    sight = fit_radar_peak(nothing, (30.0, 30.0), prior_of("bus"))
    assert sight.box[6] == pytest.approx(np.pi / 4)
    assert sight.heading == "ask"
    assert sight.box[3:6] == (11.5, 2.5, 3.3)
    assert "z = 0" in sight.note
    known = fit_radar_peak(nothing, (30.0, 30.0), replace(prior_of("bus"), yaw_rad=3.0, lane_rad=0.0), ground_z_m=-2.0)
    assert known.box[6] == pytest.approx(3.0)
    assert known.box[2] == pytest.approx(-2.0 + 3.3 / 2)
    assert known.note == ""
    moved = fit_radar_peak(nothing, (30.0, 5.0), replace(prior_of("Sedan"), ego_m=(0.0, 5.0)))
    assert moved.box[:2] == pytest.approx((32.305, 5.0))
    with pytest.raises(ValueError, match="away from the radar"):
        fit_radar_peak(nothing, (0.0, 0.0), prior_of("Sedan"))

"""Boxes for objects that the radar alone sees."""

from dataclasses import replace

import numpy as np
import pytest
from fitting_scenes import road

from farfield.annotation.fitting import fit_radar_peak, peak_near, prior_of
from farfield.radar.axes import KRADAR_AXES


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


def bump(range_m: float, azimuth_deg: float, power: float = 1.0) -> np.ndarray:
    """The response of one point, half a cell wide, on the radar's own axes."""
    across = (KRADAR_AXES.azimuth_deg[None] - azimuth_deg) / 1.2
    along = (KRADAR_AXES.range_m[:, None] - range_m) / 0.5
    return power * np.exp(-(along**2) - across**2)


@pytest.mark.parametrize(("range_m", "azimuth_deg"), [(30.1, 4.3), (62.0, -20.6), (12.25, 0.5)])
def test_a_press_snaps_to_the_peak_between_the_cells(range_m: float, azimuth_deg: float) -> None:
    place = range_m * np.array([np.cos(np.deg2rad(azimuth_deg)), np.sin(np.deg2rad(azimuth_deg))])
    power = bump(range_m, azimuth_deg) + bump(range_m + 4, azimuth_deg, 100.0)  # a stronger one beyond reach
    found = peak_near(power, np.add(place, [0.3, -0.4]))
    assert found is not None
    assert np.hypot(*(np.array(found) - place)) < 0.1


def test_no_peak_within_reach_and_peaks_at_the_edge() -> None:
    power = bump(30.0, 0.0)
    assert peak_near(power, (35.0, 0.0)) is None
    assert peak_near(np.full_like(power, -1.0), (30.0, 0.0)) is None
    edge = peak_near(bump(40.0, 53.0), 40 * np.array([np.cos(np.deg2rad(53)), np.sin(np.deg2rad(53))]))
    assert edge is not None
    assert np.rad2deg(np.arctan2(edge[1], edge[0])) == pytest.approx(53.0)

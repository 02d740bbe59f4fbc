"""What a check of a radar would find: y and yaw that err against each other, and how many frames it would take."""

import numpy as np
import pytest

from farfield.calibration.checking import CLAIMED, _is_error, detectable_errors, frames_needed, mahalanobis
from farfield.calibration.radar_lidar import SYSTEMATIC

AHEAD_M = 30.0


def covariance(aside_m: float, turn_rad: float) -> np.ndarray:
    """x and the place aside of objects 30 m ahead known to ``aside_m``, the turn about them to ``turn_rad``."""
    turns = np.array([[1, 0, 0], [0, 1, -AHEAD_M], [0, 0, 1.0]])
    return np.asarray(turns @ np.diag([aside_m**2, aside_m**2, turn_rad**2]) @ turns.T)


def test_a_shift_shows_where_the_objects_stand() -> None:
    known = covariance(0.03, np.radians(0.4))
    assert np.sqrt(known[1, 1]) > 0.2  # y alone would tell nothing
    assert mahalanobis(np.array([0.0, 0.2, 0.0]), known) > CLAIMED
    assert mahalanobis(np.array([0.0, -0.2, 0.2 / AHEAD_M]), known) < 1.0  # at the objects nothing moved
    assert detectable_errors(known).shift_m < 0.2


def test_what_is_found_lies_is_error_what_is_claimed() -> None:
    known = covariance(0.05, np.radians(0.2))
    found = detectable_errors(known)
    for away in np.linspace(0, 2 * np.pi, 12):
        change = found.shift_m * np.array([np.cos(away), np.sin(away), 0.0])
        assert mahalanobis(change, known) > CLAIMED + 1.6
    assert mahalanobis(np.array([0, 0, found.turn_rad]), known) > CLAIMED + 1.6


def test_more_frames_tell_what_few_do_not() -> None:
    systematic = np.diag(SYSTEMATIC[:3] ** 2)
    few = covariance(0.12, np.radians(0.5))
    assert not detectable_errors(systematic + few).enough
    needed = frames_needed(systematic + few, 24, systematic)
    assert needed > 24
    assert detectable_errors(systematic + few * 24 / needed).enough
    assert not detectable_errors(systematic + few * 24 / (needed - 1)).enough


def test_no_number_of_frames_undoes_what_is_systematic(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("farfield.calibration.checking.ASKED_M", 0.1)
    systematic = np.diag(SYSTEMATIC[:3] ** 2)
    assert frames_needed(systematic + covariance(0.1, np.radians(0.4)), 24, systematic) == 0


def test_a_shift_between_the_axes_is_as_large_as_along_one() -> None:
    """10 cm at 45 degrees are 7 along each axis, where 8 are no error: no less an error than 10 along one."""
    assert _is_error(np.array([0.07, 0.07, 0.0]), 1.0)
    assert not _is_error(np.array([0.05, 0.05, 0.0]), 1.0)
    assert _is_error(np.array([0.0, 0.0, np.radians(-0.4)]), 1.0)
    assert not _is_error(np.array([0.0, 0.0, np.radians(-0.4)]), 1.5)

"""What no number of matched objects averages away of a radar's pose: what all of their echoes err by alike."""

from functools import partial

import numpy as np
from jaxtyping import Float

from farfield.calibration.problems import consider_covariance
from farfield.calibration.radar_matching import azimuth_sigma_rad, observation_shares, radar_range_m, whitened_residuals
from farfield.calibration.radar_pairs import PARAMETERS, MatchedObjects
from farfield.calibration.targets import THIN_M

SYSTEMATIC = np.array([0.03, 0.025, np.radians(0.05), 0.004])
"""Of x, y, yaw and time offset whatever the objects, one sigma: range bias, side lobes, tracking of velocities; this
and the following set from simulated drives with known truth."""
_TILT_RAD, _TILTED_M = np.radians(0.2), 40.0
"""Near cars are seen outward and far ones inward of where they are, or the other way: one sigma, and where none is."""
_BESIDE_M = 0.04  # how far all cars are seen to one side
_MOST = 3.0  # sigmas of a match: what errs by more does not count so much


def systematic_covariance(pairs: MatchedObjects, value: Float[np.ndarray, " 4"]) -> Float[np.ndarray, "4 4"]:
    """Covariance of x, y, yaw and time offset by what all echoes err by alike: glint and side lobes of vehicles.

    A car's echo is drawn to the nearer corner when it is near, and by side lobes when it is far, on one side of the
    road as on the other. It does to y and yaw what the matches let it do: where posts tell them, little.

    Args:
        pairs: The matches.
        value: x, y, yaw and time offset.
    """
    reach = radar_range_m(pairs)
    wide = (pairs.width_m >= THIN_M) / azimuth_sigma_rad(pairs)
    turned = np.stack([wide * _TILT_RAD * (1.0 - _TILTED_M / reach), wide * _BESIDE_M / reach])
    errors = np.stack([np.zeros_like(turned), np.clip(turned, -_MOST, _MOST)], axis=-1)
    rows = partial(whitened_residuals, pairs=pairs)
    return consider_covariance(rows, value, PARAMETERS, errors, share=observation_shares(pairs, value)) + np.diag(
        SYSTEMATIC**2
    )

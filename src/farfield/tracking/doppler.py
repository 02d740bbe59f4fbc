"""Radial velocities as measurements: a filter in which x and y are coupled.

A radial velocity measures the velocity along the ray, so that errors of x and y no longer fall apart: the covariance of
(x, velocity along x, y, velocity along y) is kept whole, in the blocks of :class:`farfield.tracking.kalman.Tracks`.
"""

import numpy as np
from jaxtyping import Float, Int

from farfield.tracking.kalman import Tracks

_Four = Float[np.ndarray, "k 4 4"]


def spread_cross(tracks: Tracks, dt: Float[np.ndarray, " n"]) -> None:
    """Move the coupling of x and y on, in place: F C F' with F = [[1, dt], [0, 1]]."""
    move = np.zeros((len(tracks), 2, 2))
    move[:, 0, 0] = move[:, 1, 1] = 1.0
    move[:, 0, 1] = dt
    tracks.cross = move @ tracks.cross @ move.transpose(0, 2, 1)


def polar_covariance(
    ray_m: Float[np.ndarray, "k 2"], range_sigma_m: float, azimuth_sigma_rad: float
) -> Float[np.ndarray, "k 2 2"]:
    """Covariances of x and y of places that are measured by range and direction, m^2.

    Args:
        ray_m: From the sensor to the place.
        range_sigma_m: Error along the ray.
        azimuth_sigma_rad: Error across it, as an angle.
    """
    range_m = np.hypot(*ray_m.T)
    unit = ray_m / np.maximum(range_m, 1e-9)[:, None]
    across = np.column_stack([-unit[:, 1], unit[:, 0]])
    along2, across2 = range_sigma_m**2, (range_m * azimuth_sigma_rad) ** 2
    return along2 * _outer(unit, unit) + across2[:, None, None] * _outer(across, across)


def update_coupled(
    tracks: Tracks, rows: Int[np.ndarray, " k"], place_m: Float[np.ndarray, "k 2"], noise: Float[np.ndarray, "k 2 2"]
) -> None:
    """Take measured x and y into coupled tracks, in place.

    Args:
        tracks: The tracks.
        rows: Which of them, each once.
        place_m: Measured x and y.
        noise: Their covariances.
    """
    h = np.zeros((len(rows), 2, 4))
    h[:, 0, 0] = h[:, 1, 2] = 1.0
    _joseph(tracks, rows, h, place_m - tracks.place_m[rows, :2], noise)


def update_doppler(
    tracks: Tracks,
    rows: Int[np.ndarray, " k"],
    radial: Float[np.ndarray, "k 7"],
    range_m: Float[np.ndarray, " k"],
    *,
    sigma_m_s: float,
    span_m_s: float | None = None,
) -> None:
    """Take measured radial velocities into tracks, in place, after their places: the extended filter, Joseph's form.

    With the ray's direction u, the velocity v relative to the sensor and the range r, the measured velocity u.v changes
    by (v - u (u.v)) / r with the place and by u with the velocity. Where velocities are known modulo a span only, the
    innovation is wrapped, and tracks whose own radial velocity is less sure than a quarter of the span take nothing.

    Args:
        tracks: The tracks.
        rows: Which of them, each once.
        radial: Direction of the ray (3), the sensor's velocity (3), measured radial velocity relative to the sensor
            (1), away from it positive, NaN for none.
        range_m: Distance from the sensor.
        sigma_m_s: Error of the measurement.
        span_m_s: The span; None where velocities are not ambiguous.
    """
    known = np.flatnonzero(np.isfinite(radial[:, 6]))
    rows, radial, range_m = rows[known], radial[known], range_m[known]
    unit, relative = radial[:, :3], tracks.speed[rows] - radial[:, 3:6]
    expected = (unit * relative).sum(axis=1)
    innovation = radial[:, 6] - expected
    h = np.zeros((len(rows), 1, 4))
    h[:, 0, [0, 2]] = (relative - unit * expected[:, None])[:, :2] / np.maximum(range_m, 1.0)[:, None]
    h[:, 0, [1, 3]] = unit[:, :2]
    if span_m_s is not None:
        innovation = -(np.mod(-innovation + span_m_s / 2, span_m_s) - span_m_s / 2)
        moving = h * [0.0, 1.0, 0.0, 1.0]
        sure = _turned(moving, covariance(tracks, rows))[:, 0, 0] <= (span_m_s / 4) ** 2
        rows, h, innovation = rows[sure], h[sure], innovation[sure]
    _joseph(tracks, rows, h, innovation[:, None], np.full((len(rows), 1, 1), sigma_m_s**2))


def radial_gaps(
    tracks: Tracks,
    radial: Float[np.ndarray, "m 7"],
    a: Int[np.ndarray, " p"],
    b: Int[np.ndarray, " p"],
    *,
    sigma_m_s: float,
    span_m_s: float | None = None,
) -> Float[np.ndarray, " p"]:
    """How far measured radial velocities lie from those that pairs' tracks have, in standard deviations.

    Args:
        tracks: The tracks.
        radial: As in :func:`update_doppler`, of each detection.
        a: Row of the track of each pair.
        b: Row of its detection.
        sigma_m_s: Error of the measurement.
        span_m_s: Span modulo which it is known; None where it is not ambiguous.

    Returns:
        0 where nothing was measured, or the span leaves it open.
    """
    unit, measured = radial[b, :3], radial[b, 6]
    gap = measured - (unit * (tracks.speed[a] - radial[b, 3:6])).sum(axis=1)
    variance = (unit[:, :2] ** 2 * tracks.vv[a, :2]).sum(axis=1)
    variance = variance + 2 * unit[:, 0] * unit[:, 1] * tracks.cross[a, 1, 1]
    known = np.isfinite(measured)
    if span_m_s is not None:
        gap = np.mod(gap + span_m_s / 2, span_m_s) - span_m_s / 2
        known &= variance <= (span_m_s / 4) ** 2
    return np.where(known, np.abs(gap) / np.sqrt(np.maximum(variance, 0.0) + sigma_m_s**2), 0.0)


def narrow_births(tracks: Tracks, radial: Float[np.ndarray, "n 7"], across_m_s: float) -> None:
    """Make the velocities of new tracks with a radial velocity surer across the ray, in place.

    Args:
        tracks: New tracks, whose velocities are as unsure in each direction.
        radial: As in :func:`update_doppler`.
        across_m_s: Standard deviation of the velocity across the ray.
    """
    known = np.isfinite(radial[:, 6])
    unit = radial[known, :2] / np.maximum(np.hypot(*radial[known, :2].T), 1e-9)[:, None]
    along2 = tracks.vv[known, 0][:, None, None]
    v = along2 * _outer(unit, unit) + across_m_s**2 * (np.eye(2) - _outer(unit, unit))
    tracks.vv[known, 0], tracks.vv[known, 1], tracks.cross[known, 1, 1] = v[:, 0, 0], v[:, 1, 1], v[:, 0, 1]


def covariance(tracks: Tracks, rows: Int[np.ndarray, " k"]) -> _Four:
    """Covariances of (x, velocity along x, y, velocity along y)."""
    p = np.zeros((len(rows), 4, 4))
    for axis in (0, 1):
        a = 2 * axis
        p[:, a, a], p[:, a + 1, a + 1] = tracks.pp[rows, axis], tracks.vv[rows, axis]
        p[:, a, a + 1] = p[:, a + 1, a] = tracks.pv[rows, axis]
    p[:, :2, 2:] = tracks.cross[rows]
    p[:, 2:, :2] = tracks.cross[rows].transpose(0, 2, 1)
    return p


def _joseph(
    tracks: Tracks,
    rows: Int[np.ndarray, " k"],
    h: Float[np.ndarray, "k m 4"],
    innovation: Float[np.ndarray, "k m"],
    noise: Float[np.ndarray, "k m m"],
) -> None:
    p = covariance(tracks, rows)
    gain = p @ h.transpose(0, 2, 1) @ np.linalg.inv(_turned(h, p) + noise)
    change = (gain @ innovation[..., None])[..., 0]
    tracks.place_m[rows, :2] += change[:, [0, 2]]
    tracks.speed[rows, :2] += change[:, [1, 3]]
    p = _turned(np.eye(4) - gain @ h, p) + _turned(gain, noise)
    for axis in (0, 1):
        a = 2 * axis
        tracks.pp[rows, axis], tracks.vv[rows, axis] = p[:, a, a], p[:, a + 1, a + 1]
        tracks.pv[rows, axis] = (p[:, a, a + 1] + p[:, a + 1, a]) / 2
    tracks.cross[rows] = (p[:, :2, 2:] + p[:, 2:, :2].transpose(0, 2, 1)) / 2


def _turned(h: Float[np.ndarray, "k m n"], p: Float[np.ndarray, "k n n"]) -> Float[np.ndarray, "k m m"]:
    return np.asarray(h @ p @ h.transpose(0, 2, 1))


def _outer(a: Float[np.ndarray, "k 2"], b: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "k 2 2"]:
    return a[:, :, None] * b[:, None, :]

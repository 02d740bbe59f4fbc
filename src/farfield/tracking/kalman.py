"""Tracks as arrays, and the Kalman filter over position, velocity, size and heading.

With independent errors along the axes the covariance falls into blocks of position and velocity of each axis, and
single numbers for size and heading, exactly: the filter has a closed form and no matrix is inverted.

A radial velocity measures the velocity along the ray, which couples x and y: where there are radial velocities the
whole covariance of (x, velocity along x, y, velocity along y) is updated, in Joseph's form, from the same blocks.
"""

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.geometry.boxes import wrap_angle_rad
from farfield.tracking.presets import TrackerSettings


@dataclass(eq=False, kw_only=True)
class Tracks:
    """n tracks of several drives.

    Args:
        drive: Number of the drive, shape (n,), rising.
        track_id: Identity within the drive.
        label: Number of the class.
        position_m: Filtered point of the box, shape (n, 3).
        velocity: Its velocity, metres a second or a frame, shape (n, 3).
        position_var: Variances of the positions, shape (n, 3).
        position_velocity_cov: Covariances of position and velocity, shape (n, 3).
        velocity_var: Variances of the velocities, shape (n, 3).
        size_m: Length, width, height, shape (n, 3).
        yaw_rad: Heading, shape (n,).
        shape_var: Variance of size and heading, shape (n,).
        hits: Frames with a match, that of birth counted.
        misses: Frames since the last match.
        unseen_s: Seconds since then.
        source: Row of the last detection, in the table of all.
        score: Its score.
        best_score: The best score so far.
        range_m: How far from the sensor that detection was.
        cross_cov: Covariances of (x, velocity along x) with (y, velocity along y), shape (n, 2, 2); 0 without Doppler.
    """

    drive: Int[np.ndarray, " n"]
    track_id: Int[np.ndarray, " n"]
    label: Int[np.ndarray, " n"]
    position_m: Float[np.ndarray, "n 3"]
    velocity: Float[np.ndarray, "n 3"]
    position_var: Float[np.ndarray, "n 3"]
    position_velocity_cov: Float[np.ndarray, "n 3"]
    velocity_var: Float[np.ndarray, "n 3"]
    size_m: Float[np.ndarray, "n 3"]
    yaw_rad: Float[np.ndarray, " n"]
    shape_var: Float[np.ndarray, " n"]
    hits: Int[np.ndarray, " n"]
    misses: Int[np.ndarray, " n"]
    unseen_s: Float[np.ndarray, " n"]
    source: Int[np.ndarray, " n"]
    score: Float[np.ndarray, " n"]
    best_score: Float[np.ndarray, " n"]
    range_m: Float[np.ndarray, " n"]
    cross_cov: Float[np.ndarray, "n 2 2"]

    @classmethod
    def empty(cls) -> "Tracks":
        """No tracks."""
        vectors = ("position_m", "velocity", "position_var", "position_velocity_cov", "velocity_var", "size_m")
        integers = ("drive", "track_id", "label", "hits", "misses", "source")
        dtypes = {field.name: np.int64 if field.name in integers else np.float64 for field in fields(cls)}
        shapes = {name: (0, 2, 2) if name == "cross_cov" else (0, 3) if name in vectors else (0,) for name in dtypes}
        return cls(**{name: np.zeros(shapes[name], dtype=dtype) for name, dtype in dtypes.items()})

    def __len__(self) -> int:
        return len(self.drive)

    def __getitem__(self, rows: Bool[np.ndarray, " n"] | Int[np.ndarray, " k"]) -> "Tracks":
        return Tracks(**{name: values[rows] for name, values in vars(self).items()})

    def with_new(self, born: "Tracks") -> "Tracks":
        """These and new ones, by drive."""
        if not len(born):
            return self
        both = {name: np.concatenate([values, getattr(born, name)]) for name, values in vars(self).items()}
        order = np.argsort(both["drive"], kind="stable")
        return Tracks(**{name: values[order] for name, values in both.items()})


def predict(tracks: Tracks, dt: Float[np.ndarray, " n"], settings: TrackerSettings) -> None:
    """Move tracks on in place by constant velocity.

    Args:
        tracks: The tracks.
        dt: Step of each, seconds or frames.
        settings: Process noise.
    """
    dt = dt[:, None]
    tracks.position_m = tracks.position_m + dt * tracks.velocity
    tracks.position_var = tracks.position_var + 2 * dt * tracks.position_velocity_cov + dt**2 * tracks.velocity_var
    tracks.position_velocity_cov = tracks.position_velocity_cov + dt * tracks.velocity_var
    tracks.shape_var = tracks.shape_var + settings.process_variance
    if settings.acceleration is None:
        tracks.position_var = tracks.position_var + settings.process_variance
        tracks.velocity_var = tracks.velocity_var + settings.process_speed_variance
        return
    white = settings.acceleration
    tracks.position_var = tracks.position_var + white * dt**4 / 4
    tracks.position_velocity_cov = tracks.position_velocity_cov + white * dt**3 / 2
    tracks.velocity_var = tracks.velocity_var + white * dt**2


def update(
    tracks: Tracks,
    rows: Int[np.ndarray, " k"],
    boxes: Float[np.ndarray, "k 7"],
    variance: Float[np.ndarray, "k 3"],
    settings: TrackerSettings,
    axes: slice = slice(0, 3),
) -> None:
    """Update tracks by detections, in place.

    A heading that differs by more than a right angle turns the track by half a turn first (AB3DMOT).

    Args:
        tracks: The tracks.
        rows: Which of them, each once.
        boxes: The detections as x, y, z, length, width, height, yaw.
        variance: Variances of their positions.
        settings: Variance of size and heading.
        axes: Axes of the position that are updated here.
    """
    # Position and velocity, axis by axis.
    position_var, covariance_pv = tracks.position_var[rows, axes], tracks.position_velocity_cov[rows, axes]
    innovation_var = position_var + variance[:, axes]
    position_gain = position_var / innovation_var
    velocity_gain = covariance_pv / innovation_var
    innovation = boxes[:, :3][:, axes] - tracks.position_m[rows, axes]
    tracks.position_m[rows, axes] += position_gain * innovation
    tracks.velocity[rows, axes] += velocity_gain * innovation
    tracks.position_var[rows, axes] = position_var * (1 - position_gain)
    tracks.position_velocity_cov[rows, axes] = covariance_pv * (1 - position_gain)
    tracks.velocity_var[rows, axes] -= velocity_gain * covariance_pv
    # Size and heading, which share one variance.
    shape_var = tracks.shape_var[rows]
    gain = shape_var / (shape_var + settings.measurement_variance)
    tracks.size_m[rows] += gain[:, None] * (boxes[:, 3:6] - tracks.size_m[rows])
    turn = wrap_angle_rad(boxes[:, 6] - tracks.yaw_rad[rows])
    yaw = tracks.yaw_rad[rows] + np.where(np.abs(turn) > np.pi / 2, np.pi, 0.0)
    tracks.yaw_rad[rows] = wrap_angle_rad(yaw + gain * wrap_angle_rad(boxes[:, 6] - yaw))
    tracks.shape_var[rows] = shape_var * (1 - gain)


def predict_cross(tracks: Tracks, dt: Float[np.ndarray, " n"]) -> None:
    """Move the coupling of x and y on, in place: F C F' with F = [[1, dt], [0, 1]]."""
    transition = np.zeros((len(tracks), 2, 2))
    transition[:, 0, 0] = transition[:, 1, 1] = 1.0
    transition[:, 0, 1] = dt
    tracks.cross_cov = transition @ tracks.cross_cov @ transition.transpose(0, 2, 1)


def polar_covariance(
    ray_m: Float[np.ndarray, "k 2"], range_sigma_m: float, azimuth_sigma_rad: float
) -> Float[np.ndarray, "k 2 2"]:
    """Covariances of x and y of positions that are measured by range and direction, m^2, shape (k, 2, 2).

    Args:
        ray_m: From the sensor to the position.
        range_sigma_m: Error along the ray.
        azimuth_sigma_rad: Error across it, as an angle.
    """
    range_m = np.hypot(*ray_m.T)
    unit = ray_m / np.maximum(range_m, 1e-9)[:, None]
    across = np.column_stack([-unit[:, 1], unit[:, 0]])
    along2, across2 = range_sigma_m**2, (range_m * azimuth_sigma_rad) ** 2
    return along2 * _outer(unit, unit) + across2[:, None, None] * _outer(across, across)


def update_coupled(
    tracks: Tracks,
    rows: Int[np.ndarray, " k"],
    position_m: Float[np.ndarray, "k 2"],
    noise: Float[np.ndarray, "k 2 2"],
) -> None:
    """Update coupled tracks by measured x and y, in place.

    Args:
        tracks: The tracks.
        rows: Which of them, each once.
        position_m: Measured x and y.
        noise: Their covariances.
    """
    h = np.zeros((len(rows), 2, 4))
    h[:, 0, 0] = h[:, 1, 2] = 1.0
    _joseph(tracks, rows, h, position_m - tracks.position_m[rows, :2], noise)


def update_doppler(
    tracks: Tracks,
    rows: Int[np.ndarray, " k"],
    radial: Float[np.ndarray, "k 7"],
    range_m: Float[np.ndarray, " k"],
    *,
    sigma_m_s: float,
    span_m_s: float | None = None,
) -> None:
    """Update tracks by measured radial velocities, in place, after their positions: the extended filter, Joseph's form.

    With the ray's direction u, the velocity v relative to the sensor and the range r, the measured velocity u.v changes
    by (v - u (u.v)) / r with the position and by u with the velocity. Where velocities are known modulo a span only,
    the innovation is wrapped, and tracks whose own radial velocity is less certain than a quarter of the span stay as
    they are.

    Args:
        tracks: The tracks.
        rows: Which of them, each once.
        radial: Direction of the ray (3), the sensor's velocity (3), measured radial velocity relative to the sensor
            (1), away from it positive, NaN for none.
        range_m: Distance from the sensor.
        sigma_m_s: Error of the measurement.
        span_m_s: The span; None where velocities are not ambiguous.
    """
    measured = np.flatnonzero(np.isfinite(radial[:, 6]))
    rows, radial, range_m = rows[measured], radial[measured], range_m[measured]
    unit, relative = radial[:, :3], tracks.velocity[rows] - radial[:, 3:6]
    expected = (unit * relative).sum(axis=1)
    innovation = radial[:, 6] - expected
    h = np.zeros((len(rows), 1, 4))
    h[:, 0, [0, 2]] = (relative - unit * expected[:, None])[:, :2] / np.maximum(range_m, 1.0)[:, None]
    h[:, 0, [1, 3]] = unit[:, :2]
    if span_m_s is not None:
        innovation = -(np.mod(-innovation + span_m_s / 2, span_m_s) - span_m_s / 2)
        velocity_h = h * [0.0, 1.0, 0.0, 1.0]
        certain = _propagate(velocity_h, covariance(tracks, rows))[:, 0, 0] <= (span_m_s / 4) ** 2
        rows, h, innovation = rows[certain], h[certain], innovation[certain]
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
    gap = measured - (unit * (tracks.velocity[a] - radial[b, 3:6])).sum(axis=1)
    variance = (unit[:, :2] ** 2 * tracks.velocity_var[a, :2]).sum(axis=1)
    variance = variance + 2 * unit[:, 0] * unit[:, 1] * tracks.cross_cov[a, 1, 1]
    comparable = np.isfinite(measured)
    if span_m_s is not None:
        gap = np.mod(gap + span_m_s / 2, span_m_s) - span_m_s / 2
        comparable &= variance <= (span_m_s / 4) ** 2
    return np.where(comparable, np.abs(gap) / np.sqrt(np.maximum(variance, 0.0) + sigma_m_s**2), 0.0)


def narrow_births(tracks: Tracks, radial: Float[np.ndarray, "n 7"], across_m_s: float) -> None:
    """Make the velocities of new tracks with a radial velocity more certain across the ray, in place.

    Args:
        tracks: New tracks, whose velocities are as uncertain in each direction.
        radial: As in :func:`update_doppler`.
        across_m_s: Standard deviation of the velocity across the ray.
    """
    measured = np.isfinite(radial[:, 6])
    unit = radial[measured, :2] / np.maximum(np.hypot(*radial[measured, :2].T), 1e-9)[:, None]
    along2 = tracks.velocity_var[measured, 0][:, None, None]
    variance = along2 * _outer(unit, unit) + across_m_s**2 * (np.eye(2) - _outer(unit, unit))
    tracks.velocity_var[measured, 0] = variance[:, 0, 0]
    tracks.velocity_var[measured, 1] = variance[:, 1, 1]
    tracks.cross_cov[measured, 1, 1] = variance[:, 0, 1]


def covariance(tracks: Tracks, rows: Int[np.ndarray, " k"]) -> Float[np.ndarray, "k 4 4"]:
    """Covariances of (x, velocity along x, y, velocity along y), shape (k, 4, 4)."""
    p = np.zeros((len(rows), 4, 4))
    for axis in (0, 1):
        a = 2 * axis
        p[:, a, a] = tracks.position_var[rows, axis]
        p[:, a + 1, a + 1] = tracks.velocity_var[rows, axis]
        p[:, a, a + 1] = p[:, a + 1, a] = tracks.position_velocity_cov[rows, axis]
    p[:, :2, 2:] = tracks.cross_cov[rows]
    p[:, 2:, :2] = tracks.cross_cov[rows].transpose(0, 2, 1)
    return p


def _joseph(
    tracks: Tracks,
    rows: Int[np.ndarray, " k"],
    h: Float[np.ndarray, "k m 4"],
    innovation: Float[np.ndarray, "k m"],
    noise: Float[np.ndarray, "k m m"],
) -> None:
    """The update by a linear measurement ``h``, in Joseph's form, which keeps the covariance positive definite."""
    p = covariance(tracks, rows)
    gain = p @ h.transpose(0, 2, 1) @ np.linalg.inv(_propagate(h, p) + noise)
    change = (gain @ innovation[..., None])[..., 0]
    tracks.position_m[rows, :2] += change[:, [0, 2]]
    tracks.velocity[rows, :2] += change[:, [1, 3]]
    p = _propagate(np.eye(4) - gain @ h, p) + _propagate(gain, noise)
    for axis in (0, 1):
        a = 2 * axis
        tracks.position_var[rows, axis] = p[:, a, a]
        tracks.velocity_var[rows, axis] = p[:, a + 1, a + 1]
        tracks.position_velocity_cov[rows, axis] = (p[:, a, a + 1] + p[:, a + 1, a]) / 2
    tracks.cross_cov[rows] = (p[:, :2, 2:] + p[:, 2:, :2].transpose(0, 2, 1)) / 2


def _propagate(h: Float[np.ndarray, "k m n"], p: Float[np.ndarray, "k n n"]) -> Float[np.ndarray, "k m m"]:
    """H P H' of each."""
    return np.asarray(h @ p @ h.transpose(0, 2, 1))


def _outer(a: Float[np.ndarray, "k 2"], b: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "k 2 2"]:
    return a[:, :, None] * b[:, None, :]

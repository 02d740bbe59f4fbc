"""What the radar's solver solves for, the objects that it matches, and what their data cannot tell."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.calibration.problems import Parameter, Solution

_CLEAR = 2.0
_BLOCK = 4  # neighbouring frames see the same objects

PARAMETERS = (
    Parameter(name="x", unit="m", scale=0.01, prior_sigma=1.2),
    Parameter(name="y", unit="m", scale=0.01, prior_sigma=1.2),
    Parameter(name="yaw", unit="rad", scale=np.radians(0.1), prior_sigma=np.radians(2.0)),
    Parameter(name="time offset", unit="s", scale=0.005, prior_sigma=0.03),
)


@dataclass(frozen=True, eq=False, kw_only=True)
class MatchedObjects:
    """Matched objects: LiDAR place, width, velocity in m/s and whether it is known, lag, radar place, object."""

    lidar_m: Float[np.ndarray, "n 3"]
    width_m: Float[np.ndarray, " n"]
    velocity_m_s: Float[np.ndarray, "n 2"]
    lag_s: Float[np.ndarray, " n"]
    radar_m: Float[np.ndarray, "n 3"]
    track: Int[np.ndarray, " n"]
    tracked: Bool[np.ndarray, " n"]


def radar_notes(
    frames: int, solution: Solution, rivals: dict[int, float], pairs: MatchedObjects, above_m: float
) -> tuple[str, ...]:
    """What the data cannot tell, as sentences."""
    notes = [*solution.unobserved, "x includes the mean range bias of the radar's echoes"]
    notes.append(
        f"z is not observed: kept as given (one cell of elevation is 0.7 m at 40 m; echoes lie {above_m:+.1f} m off)"
    )
    spread = float(np.percentile(pairs.velocity_m_s[:, 0], 90) - np.percentile(pairs.velocity_m_s[:, 0], 10))
    if solution.sigma[3] > 0.6 * PARAMETERS[3].prior_sigma:
        notes.append(f"x and time offset cannot be told apart here (speed spread {spread:.1f} m/s)")
    close = sorted(offset for offset, worse in rivals.items() if worse < _CLEAR)
    if close:
        named = ", ".join(f"{offset - frames:+d}" for offset in close)
        notes.append(f"frame offset is not certain: {named} frames explain the objects nearly as well")
    return tuple(dict.fromkeys(notes))


def standard_errors_worse(costs: Float[np.ndarray, " frames"], best: Float[np.ndarray, " frames"]) -> float:
    """By how many standard errors a rival is worse, over the frames that both have, in blocks."""
    gap = costs - best
    blocks = [part[np.isfinite(part)].sum() for part in np.array_split(gap, max(len(gap) // _BLOCK, 2))]
    spread = float(np.std(blocks, ddof=1) * np.sqrt(len(blocks)))
    return float(np.sum(blocks)) / max(spread, 1e-9)

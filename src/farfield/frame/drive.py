"""Frames of one drive in the order of time."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from farfield.vocabulary.counts import count_of

Key = tuple[str, str]
"""(sequence, frame): what pairs predictions with annotations."""
_JUMP_M, _JUMP_M_S = 100.0, 100.0
BREAK_PERIODS = 5.0
"""An interval longer than so many median ones begins a new drive."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Drive:
    """Frames of one drive in the order of time, known without building a frame.

    Args:
        name: Name of the drive.
        indices: The frames' indices in their data set, shape (n,).
        keys: (sequence, frame) of each.
        times_ns: Time of each, shape (n,), or None.
        world_T_frame: Pose of each frame's coordinates, shape (n, 4, 4), or None.
    """

    name: str
    indices: Int[np.ndarray, " n"]
    keys: tuple[Key, ...]
    times_ns: Int[np.ndarray, " n"] | None = None
    world_T_frame: Float[np.ndarray, "n 4 4"] | None = None

    def out_of_step(self) -> tuple[str, ...]:
        """What is wrong with its times, in words; nothing where they are not known or all is well.

        Times that stand there twice, that run backwards, and breaks: intervals of more than five median ones, across
        which frames do not belong to one drive.

        >>> times = np.array([0, 1, 2, 2, 3, 33]) * 100_000_000
        >>> Drive(name="a", indices=np.arange(6), keys=(), times_ns=times).out_of_step()
        ('1 time stands there twice', 'a break of 3.0 s after frame 4')
        """
        if self.times_ns is None or len(self.times_ns) < 2:
            return ()
        steps = np.diff(self.times_ns)
        twice, backwards = int((steps == 0).sum()), int((steps < 0).sum())
        rising = steps[steps > 0]
        limit = BREAK_PERIODS * float(np.median(rising)) if len(rising) else np.inf
        issues = [
            f"{twice} {'times stand' if twice > 1 else 'time stands'} there twice" if twice else "",
            f"{backwards} {'times run' if backwards > 1 else 'time runs'} backwards" if backwards else "",
            *(f"a break of {steps[row] / 1e9:.1f} s after frame {row}" for row in np.flatnonzero(steps > limit)),
        ]
        return tuple(issue for issue in issues if issue)

    def odd_poses(self) -> tuple[str, ...]:
        """What no car does by its poses, in words; nothing where they are not known or all is well.

        A drive upside down, as quaternions with w first that are read as x first put it, and jumps: ways of more than
        100 m in a step, or faster than 100 m/s.
        """
        if self.world_T_frame is None or not len(self.world_T_frame):
            return ()
        issues = []
        if np.median(self.world_T_frame[:, 2, 2]) < -0.5:
            issues.append("the poses are upside down (z points down in the world): do their quaternions begin with w?")
        ways_m = np.linalg.norm(np.diff(self.world_T_frame[:, :3, 3], axis=0), axis=1)
        if len(ways_m):
            limits_m = np.full(len(ways_m), max(_JUMP_M, 10 * float(np.quantile(ways_m, 0.25, method="lower"))))
            if self.times_ns is not None:
                seconds = np.diff(self.times_ns) / 1e9
                limits_m = np.where(seconds > 0, _JUMP_M_S * np.maximum(seconds, 0.05), limits_m)
            jumps = np.flatnonzero(ways_m > limits_m)
            if len(jumps):
                first = int(jumps[0])
                after = self.keys[first + 1][1] if self.keys else first + 1
                issues.append(
                    f"the poses jump {count_of(len(jumps), 'time')}, first by {ways_m[first]:.0f} m at frame {after}"
                )
        return tuple(issues)

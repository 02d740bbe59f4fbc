"""Frames of one drive in the order of time."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

Key = tuple[str, str]
"""(sequence, frame): what pairs predictions with annotations."""
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

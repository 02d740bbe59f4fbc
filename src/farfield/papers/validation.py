"""Whether runs were trained long enough: scores on held-out roads, and a rule that calls their curve flat.

The rule was fixed before the runs. A straight line is fitted to the scores of the last third of the steps; its rise
over that third is the gain, with a 95 % interval by the scatter about the line. A curve is flat where the interval ends
below 0.01, or holds 0 and reaches no further than 0.03 to either side of the gain; it still rises where the interval
lies above 0 otherwise; else it is too noisy to say.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy import stats

from farfield.experiments.plan import logged
from farfield.papers.grid import Tree
from farfield.papers.jobs import TrainingJob

SMALL, NOISE = 0.01, 0.03
"""Gain that is none, and half-width up to which a curve says anything; mean AP."""
LEAST = 4
"""Scores in the last third that the rule needs."""
FLAT, RISING, NOISY, FEW = "flat", "still rising", "too noisy to say", "too few scores to say"


def course_of(steps: Sequence[int], scores: Sequence[float]) -> Tree:
    """The rule applied to a curve.

    Args:
        steps: Steps done at each score, rising, (n,).
        scores: Scores, 0 to 1, (n,).

    Returns:
        ``gain`` over the last third of the steps and its ``interval``, both None where there are too few scores, and
        ``words``.
    """
    x, y = np.asarray(steps, dtype=np.float64), np.asarray(scores, dtype=np.float64)
    last = x >= x[-1] * 2 / 3 if len(x) else x > 0
    if last.sum() < LEAST:
        return {"gain": None, "interval": None, "words": FEW}
    third = float(x[-1]) / 3
    x, y = (x[last] - x[last].mean()) / third, y[last] - y[last].mean()
    gain = float(x @ y / (x @ x))
    freedom = len(x) - 2
    error = float(np.sqrt(np.sum((y - gain * x) ** 2) / freedom / (x @ x)))
    half = float(stats.t.ppf(0.975, freedom)) * error
    low, high = gain - half, gain + half
    flat = high < SMALL or (low <= 0 and half <= NOISE)
    words = FLAT if flat else RISING if low > 0 else NOISY
    return {"gain": round(gain, 6), "interval": [round(low, 6), round(high, 6)], "words": words}


def validation_of(jobs: Sequence[TrainingJob], folder: Path) -> list[Tree]:
    """The curves of runs that were scored while they trained.

    Args:
        jobs: Finished trainings.
        folder: Folder of their folders, whose logs hold the scores.

    Returns:
        Of each run: ``run``, ``frames`` scored on, ``seeds`` with ``seed``, ``steps``, ``scores`` and what the rule
        says, and ``mean``, the same of the mean over seeds.
    """
    runs: dict[str, Tree] = {}
    for job in jobs:
        settings = job.experiment.training.validation
        rows = [row for row in logged(folder / job.folder) if "validation" in row]
        if settings is None or not rows:
            continue
        steps, scores = [int(row["step"]) for row in rows], [round(float(row["validation"]), 6) for row in rows]
        curve = {"seed": job.seed, "steps": steps, "scores": scores, **course_of(steps, scores)}
        tree = runs.setdefault(job.runs[0], {"run": job.runs[0], "frames": settings.frames, "seeds": []})
        tree["seeds"].append(curve)
    for tree in runs.values():
        by_step = [dict(zip(curve["steps"], curve["scores"], strict=True)) for curve in tree["seeds"]]
        steps = sorted(set.intersection(*map(set, by_step)))  # a training that was stopped at one lacks it
        mean = [round(float(np.mean([scores[step] for scores in by_step])), 6) for step in steps]
        tree["mean"] = {"steps": steps, "scores": mean, **course_of(steps, mean)}
    return list(runs.values())

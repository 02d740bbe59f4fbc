"""Whether one row of a table lies above another: differences paired by seed, their intervals, and the decision.

The rule: d_s is the difference of one figure between two rows that were trained with the same seed and scored on the
same frames, D its mean over n seeds. Its variance is s_seed^2 / n + s_seq^2, where s_seed is the standard deviation of
d_s, pooled over the pairs of a grid, and s_seq that of D under a bootstrap of whole sequences, the same draw for both
rows and all seeds. The interval D +- t(0.975, df) sqrt(variance) decides: it lies above 0, below 0, or neither.

    gain = difference(adapted, plain, figure("dds/0/dds"), epsilons=(0.0,))   # two lists of Detections, seed by seed
    spread = pooled([gain, *others])
    print(decide(gain.with_pooled(spread)))                     # +0.051 [+0.020, +0.083], n 3: holds
"""

from farfield.metrics.deciding.decision import Decision, Hypothesis, decide, half_width, holm, power
from farfield.metrics.deciding.difference import (
    Difference,
    Scalar,
    ScoreSample,
    Spread,
    difference,
    difference_of,
    figure,
    measured,
    pooled,
    sample,
    samples,
)
from farfield.metrics.deciding.switching import SwitchingResult, best_by, switched, switching_gains

__all__ = [
    "Decision",
    "Difference",
    "Hypothesis",
    "Scalar",
    "ScoreSample",
    "Spread",
    "SwitchingResult",
    "best_by",
    "decide",
    "difference",
    "difference_of",
    "figure",
    "half_width",
    "holm",
    "measured",
    "pooled",
    "power",
    "sample",
    "samples",
    "switched",
    "switching_gains",
]

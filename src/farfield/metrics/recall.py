"""KITTI's sampling of precision over recall, which K-Radar's average precision shares."""

import numpy as np
from jaxtyping import Float

SAMPLES = 41


def sample_thresholds(scores: Float[np.ndarray, " h"], annotated: int) -> tuple[list[float], list[float]]:
    """Scores at which recall comes nearest to 0, 1/40, 2/40 ...; returns them and the recalls reached there."""
    places: list[int] = []
    wanted = 0.0
    while len(places) < SAMPLES and (places[-1] if places else 0) < len(scores):
        places.append(_nearest_place(wanted, (places[-1] if places else 0) + 1, len(scores), annotated))
        wanted += 1.0 / (SAMPLES - 1)
    return [float(scores[place - 1]) for place in places], [place / annotated for place in places]


def _nearest_place(wanted: float, first: int, last: int, annotated: int) -> int:
    """The first place from ``first`` on after which recall does not come nearer, by KITTI's own float comparison."""
    place = min(max(first, int(wanted * annotated - 0.5) - 1), last)
    while place < last and (place + 1) / annotated - wanted < wanted - place / annotated:
        place += 1
    return place


def sampled_precision(
    precision: Float[np.ndarray, " t"], recalls: Float[np.ndarray, " t"], annotated: int, *, gaps: bool = False
) -> Float[np.ndarray, "41"]:
    """Precision at recalls 0, 1/40 ... 1: the best one from that threshold on.

    With 41 annotated boxes or more these are the values of KITTI's own code. With fewer it leaves samples at zero
    that it never reaches for want of thresholds, so that a perfect detector falls short of 100; here they take the
    best precision at that recall, unless ``gaps`` is set for those of KITTI's code.
    """
    by_place = np.zeros(SAMPLES)
    by_place[: len(precision)] = precision
    by_place = np.maximum.accumulate(by_place[::-1])[::-1]
    if gaps:
        return by_place
    reached = recalls[None] >= np.linspace(0, 1, SAMPLES)[:, None] - 0.5 / annotated - 1e-12
    by_recall = np.where(reached, precision[None], 0.0).max(axis=1, initial=0.0)
    return np.maximum(by_place, by_recall)

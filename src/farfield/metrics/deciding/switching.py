"""Whether it pays to switch the scan pattern by scenario: a rule learnt on some drives and scored on others.

Cirrus, section I: the patterns are for different scenarios, a Gaussian one for fast roads and a uniform one for towns.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from farfield.errors import ConfigError
from farfield.frame.drive import Key
from farfield.metrics.bootstrap import Bootstrap
from farfield.metrics.breakdown import parts
from farfield.metrics.deciding.difference import REPLICATES, Difference, Scalar, difference, figure
from farfield.metrics.detections import Detections, Protocol
from farfield.metrics.frames import frame_order, group_frames

DDS = figure("dds/0/dds")


@dataclass(frozen=True, eq=False, kw_only=True)
class SwitchingResult:
    """What the rule gives.

    Args:
        detections: Every frame from the pattern that was chosen for it.
        choices: For each fold the pattern chosen by scenario, from the other folds.
    """

    detections: Detections
    choices: tuple[Mapping[str, str], ...]


def best_by(
    detections: Mapping[str, Detections],
    kind: str = "road",
    *,
    scalar: Scalar = DDS,
    protocol: str | Protocol = "dds",
    **settings: Any,
) -> dict[str, str]:
    """The cloud whose figure is highest in each scenario; the first one where figures are equal or none is known.

    Args:
        detections: Detections of the same frames by cloud.
        kind: What the scenario is: ``"road"``, ``"weather"`` or ``"time"``.
        scalar: The figure.
        protocol: The protocol or its name.
        **settings: Its settings.
    """
    parted = {cloud: parts(of_cloud, (kind,)).get(kind, {}) for cloud, of_cloud in detections.items()}
    chosen: dict[str, tuple[float, str]] = {}
    for cloud, values in parted.items():
        for value, part in values.items():
            result = part.score(protocol, **{"bootstrap": Bootstrap(replicates=0), **settings})
            figures = {"overall": result.figures, "mean_of_bins": result.mean_of_bins, **result.ranges}
            reached = scalar.of(figures)
            if value not in chosen or (reached is not None and reached > chosen[value][0]):
                chosen[value] = (-np.inf if reached is None else reached, cloud)
    return {value: cloud for value, (_, cloud) in chosen.items()}


def switch(detections: Mapping[str, Detections], choice: Mapping[Key, str]) -> Detections:
    """Each frame as one of the clouds saw it.

    Args:
        detections: Detections of the same frames by cloud.
        choice: The cloud of each frame.
    """
    first = next(iter(detections.values()))
    return replace(
        first,
        cloud=None,
        boxes={key: detections[cloud].boxes[key] for key, cloud in choice.items() if key in detections[cloud].boxes},
        annotations={key: detections[cloud].annotations[key] for key, cloud in choice.items()},
    )


def switched(
    detections: Mapping[str, Detections], kind: str = "road", *, folds: int = 2, seed: int = 0, **learning: Any
) -> SwitchingResult:
    """The rule "in each scenario the cloud that is best there", learnt on other drives than it is used on.

    Args:
        detections: Detections of the same frames by cloud.
        kind: What the scenario is.
        folds: How many parts the drives are split into; the choice for each is learnt on all others.
        seed: Of the split.
        **learning: Arguments of :func:`best_by`.

    Raises:
        ConfigError: If the clouds' frames differ, a scenario is not known, or there are fewer drives than folds.
    """
    counted = {cloud: of_cloud.counted() for cloud, of_cloud in detections.items()}
    first = next(iter(counted.values()))
    keys = sorted(first.annotations, key=frame_order)
    if any(set(of_cloud.annotations) != set(keys) for of_cloud in counted.values()):
        raise ConfigError("switching: expected the same annotated frames of every cloud, got others")
    lacking = [key for key in keys if kind not in first.conditions.get(key, {})]
    if lacking:
        raise ConfigError(f"switching by {kind}: expected it of every frame, {len(lacking)} have none: {lacking[0]}")
    group, grouped_by = group_frames(keys, first.drives)
    drives = int(group.max()) + 1 if len(group) else 0
    if folds < 2 or drives < folds:
        raise ConfigError(f"switching: expected 2 folds or more and as many {grouped_by}, got {folds} and {drives}")
    fold = np.random.default_rng(seed).permutation(drives)[group] % folds
    choices, choice = [], dict[Key, str]()
    for number in range(folds):
        rest = {key for key, its in zip(keys, fold, strict=True) if its != number}
        learnt = best_by({cloud: _only(of_cloud, rest) for cloud, of_cloud in counted.items()}, kind, **learning)
        choices.append(learnt)
        for key, its in zip(keys, fold, strict=True):
            if its == number:
                choice[key] = learnt.get(first.conditions[key][kind], next(iter(detections)))
    return SwitchingResult(detections=switch(counted, choice), choices=tuple(choices))


def _only(detections: Detections, keys: set[Key]) -> Detections:
    return replace(
        detections,
        boxes={key: boxes for key, boxes in detections.boxes.items() if key in keys},
        annotations={key: annotation for key, annotation in detections.annotations.items() if key in keys},
        conditions={key: conditions for key, conditions in detections.conditions.items() if key in keys},
    )


def switching_gains(
    runs: Mapping[str, Sequence[Detections]],
    kind: str = "road",
    *,
    scalar: Scalar = DDS,
    replicates: int = REPLICATES,
    **settings: Any,
) -> dict[str, Difference]:
    """How much the rule is above each fixed choice, with what an interval needs.

    Args:
        runs: Detections of the same frames by cloud, seed by seed.
        kind: What the scenario is.
        scalar: The figure that is compared and by which the rule chooses.
        replicates: Draws of the sequences.
        **settings: The protocol's settings.

    Returns:
        By cloud; see :func:`farfield.metrics.deciding.decide`.
    """
    seeds = [dict(zip(runs, of_seed, strict=True)) for of_seed in zip(*runs.values(), strict=True)]
    rule = [switched(run, kind, scalar=scalar, **settings).detections for run in seeds]
    return {cloud: difference(rule, fixed, scalar, replicates=replicates, **settings) for cloud, fixed in runs.items()}

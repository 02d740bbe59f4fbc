"""Pseudo-labels of a teacher: confident boxes, those between two scores that are ignored, and the strong view.

The thresholds are those of self-training in the literature (ST3D++, arXiv 2108.06682: positive 0.6, negative 0.25).
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float
from pydantic import Field
from torch import Tensor

from farfield.detectors.inputs import Inputs
from farfield.detectors.network import Assigner, Network
from farfield.errors import ConfigError
from farfield.geometry.boxes import Boxes
from farfield.training.augmentation import Augmentation, draw_change
from farfield.training.config import AugmentationConfig, WeatherConfig
from farfield.training.method import MethodSettings
from farfield.training.weather import draw_weather, holding, lay_over

Score = float | dict[str, float]
"""A threshold of the score: one for all classes, or one for each."""


def levels(score: Score, labels: Sequence[str] | np.ndarray) -> Float[np.ndarray, " n"]:
    """The threshold of each box by its class, shape (n,).

    Args:
        score: A threshold, or thresholds by class.
        labels: Class of each box, length n.

    >>> levels({"vehicle": 0.6, "pedestrian": 0.4}, ["pedestrian", "vehicle"]).tolist()
    [0.4, 0.6]
    """
    if isinstance(score, Mapping):
        return np.array([score[str(label)] for label in labels], dtype=np.float64)
    return np.full(len(labels), score, dtype=np.float64)


def scores_of(boxes: Boxes) -> Float[np.ndarray, " n"]:
    """The scores of boxes, shape (n,); those without are 0."""
    return np.zeros(len(boxes)) if boxes.score is None else boxes.score


def threshold_text(score: Score) -> str:
    """A threshold in words.

    >>> threshold_text({"vehicle": 0.6, "pedestrian": 0.4})
    'vehicle 0.6, pedestrian 0.4'
    """
    if isinstance(score, Mapping):
        return ", ".join(f"{name} {value:g}" for name, value in score.items())
    return f"{score:g}"


class StrongAugmentation(MethodSettings):
    """Random changes of the view that the student sees; the teacher sees the frame as it is."""

    flip_probability: float = Field(0.5, ge=0, le=1)
    rotation_rad: float = Field(0.1, ge=0)
    scale: float = Field(0.05, ge=0, lt=1)
    height_m: float = Field(0.0, ge=0)
    thinning: float = Field(0.3, ge=0, lt=1, description="drop up to this share of the points")
    weather: WeatherConfig | None = Field(None, description="weather laid over the frames before they are moved")

    def draw(self, rng: np.random.Generator) -> Augmentation:
        """Draw the motion of one frame."""
        return draw_change(AugmentationConfig(**self.model_dump()), rng)


class PseudoLabels(NamedTuple):
    """What a teacher detected in a frame.

    Attributes:
        confident: Boxes with at least the higher score, without scores.
        ignored: Boxes with a score between the thresholds.
    """

    confident: Boxes
    ignored: Boxes

    def moved(self, change: Augmentation) -> "PseudoLabels":
        """The same boxes after a motion."""
        return PseudoLabels(change.boxes(self.confident), change.boxes(self.ignored))

    def where(self, visible: Bool[np.ndarray, " n"]) -> "PseudoLabels":
        """The same, but that of the confident boxes those that are not ``visible`` are ignored."""
        return PseudoLabels(self.confident[visible], Boxes.concatenate([self.ignored, self.confident[~visible]]))


def split_by_score(boxes: Boxes, positive: Score, negative: Score) -> PseudoLabels:
    """Part a teacher's boxes by their scores; those below ``negative`` are dropped.

    Args:
        boxes: Scored boxes.
        positive: Score from which a box is an object, of all classes or of each.
        negative: Score below which it is background.
    """
    score = scores_of(boxes)
    confident, above_negative = (score >= levels(threshold, boxes.label) for threshold in (positive, negative))
    unscored = boxes.replace(score=None)
    return PseudoLabels(unscored[confident], unscored[above_negative & ~confident])


def in_weather(
    inputs: Mapping[str, list[Tensor]],
    pseudo_labels: list[PseudoLabels],
    columns: Mapping[str, Sequence[str]],
    config: WeatherConfig,
    rng: np.random.Generator,
) -> tuple[Inputs, list[PseudoLabels]]:
    """The frames with weather laid over them, each its own, before anything moves them.

    Confident boxes whose last point the weather takes are ignored: the student cannot see what is there.

    Args:
        inputs: Clouds of each frame by input.
        pseudo_labels: What the teacher detected in each frame.
        columns: Columns of each input.
        config: The weather.
        rng: The only source of randomness.
    """
    named = {name: list(clouds) for name, clouds in inputs.items()}
    visible = list(pseudo_labels)
    for frame in range(len(pseudo_labels)):
        laid = draw_weather(config, rng)
        if laid is None:
            continue
        before, after = [], []
        for name, clouds in named.items():
            rows = clouds[frame].detach().float().cpu().numpy()
            changed, survives = lay_over(rows, columns[name], config, laid, rng)
            before.append(rows[:, :3])
            after.append(rows[survives, :3])
            clouds[frame] = torch.from_numpy(changed).to(clouds[frame].device, clouds[frame].dtype)
        holds_points = holding(np.concatenate(before), np.concatenate(after), visible[frame].confident)
        visible[frame] = visible[frame].where(holds_points)
    return Inputs(named), visible


def strong_view(
    inputs: Mapping[str, list[Tensor]], changes: list[Augmentation], thinning: float, rng: np.random.Generator
) -> Inputs:
    """The frames moved, each by its change, and thinned.

    Args:
        inputs: Clouds of each frame by input, x, y, z first.
        changes: One a frame.
        thinning: Largest share of the points that is dropped.
        rng: The only source of randomness.
    """
    shares = rng.uniform(0, thinning, size=len(changes))
    named = {}
    for name, clouds in inputs.items():
        with torch.autocast(clouds[0].device.type, enabled=False):  # bfloat16 has steps of a metre at 250 m
            named[name] = [
                _changed(cloud, change, share, rng)
                for cloud, change, share in zip(clouds, changes, shares, strict=True)
            ]
    return Inputs(named)


def _changed(cloud: Tensor, change: Augmentation, share: float, rng: np.random.Generator) -> Tensor:
    survives = torch.from_numpy(rng.random(len(cloud)) >= share).to(cloud.device)
    linear = torch.from_numpy(change.linear).to(cloud.device, cloud.dtype)
    moved = cloud[survives]
    moved[:, :3] = moved[:, :3] @ linear.T
    moved[:, 2] += change.rise_m
    return moved


def targets_of(assigner: Assigner, pseudo: PseudoLabels, inputs: Mapping[str, Tensor]) -> Any:
    """Targets of a frame: confident pseudo-labels are objects, and what is near ignored boxes is ignored.

    Args:
        assigner: The network's.
        pseudo: Boxes in the coordinates of the inputs.
        inputs: The frame's clouds.

    Raises:
        ConfigError: If the detector's targets know of nothing that is ignored.
    """
    clouds = {name: cloud.cpu().numpy() for name, cloud in inputs.items()}
    targets, ignored = (assigner(boxes, clouds) for boxes in pseudo)
    if not hasattr(targets, "ignoring"):
        raise ConfigError(
            f"method teacher: expected targets that can ignore boxes; {type(targets).__name__} cannot. Take "
            "pointpillars, second, voxelnet, sparsecentre, rtn or rtnh."
        )
    return targets.ignoring(ignored)


def check_ignores(network: Network) -> None:
    """See that a detector's targets can ignore.

    Raises:
        ConfigError: If they cannot.
    """
    none = {name: torch.zeros(0, len(cloud.columns)) for name, cloud in network.inputs.items()}
    targets_of(network.assigner, PseudoLabels(Boxes.empty(), Boxes.empty()), none)

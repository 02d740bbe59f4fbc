"""Scores on held-out frames while a training runs, and the weights that did best."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from farfield.datasets import Dataset
from farfield.detectors.network import Network
from farfield.detectors.runtime import Detector
from farfield.errors import ConfigError
from farfield.evaluation import detect
from farfield.files.atomic import write_text
from farfield.frame import Annotation
from farfield.metrics import Bootstrap

BEST = "best"
"""Stem of the best weights' file, and of what is known of them."""
_NO_INTERVALS = Bootstrap(replicates=0)


@dataclass(frozen=True, kw_only=True)
class Validation:
    """Frames on which a training is scored every few steps.

    The score is the mean over the detector's classes of nuScenes' AP (centres within 0.5, 1, 2 and 4 m; Caesar et al.
    2020, 3.1): it asks for no settings, and suits each kind of sensor.

    Args:
        frames: Held-out, annotated frames.
        every_steps: Steps between scores; the last step is scored too.
        cloud: Which of their clouds the detector reads; the first that suits unless given.
        aliases: Classes of the annotation renamed, as in training.
        precision: Number type in which it detects.
    """

    frames: Dataset
    every_steps: int
    cloud: str | None = None
    aliases: Mapping[str, str] = field(default_factory=dict)
    precision: str = "auto"

    def due(self, step: int, steps: int) -> bool:
        """Whether the weights after a step are scored."""
        return step % self.every_steps == 0 or step == steps

    def check(self, classes: Sequence[str]) -> None:
        """Refuse frames on which nothing can be scored.

        Args:
            classes: Those of the detector.

        Raises:
            ConfigError: If none of the frames has a box of one of them.
        """
        annotations = (self.frames[index].annotation for index in range(len(self.frames)))
        present = {self.aliases.get(str(name), str(name)) for each in annotations if each for name in each.boxes.label}
        if not present & {*classes}:
            raise ConfigError(
                f"training.validation: none of the {len(self.frames)} frames has a box of {', '.join(classes)}; they "
                f"hold {', '.join(sorted(present)) or 'no boxes'}. Take more frames or another split, or name the "
                "classes in data.aliases."
            )

    def score(self, network: Network) -> float:
        """Mean AP of a network on the frames, from 0 to 1."""
        device = next(network.parameters()).device
        detector = Detector(network, device=device, precision=self.precision)
        found = detect(detector, self.frames, cloud=self.cloud, annotated_only=True)
        renamed = {key: _renamed(each, self.aliases) for key, each in found.annotations.items()}
        found = replace(found, annotations=renamed)
        present = {str(label) for each in renamed.values() for label in each.boxes.label}
        classes = [name for name in detector.class_names if name in present]
        scores = [found.score("nuscenes", label=name, bootstrap=_NO_INTERVALS).figures["map"] for name in classes]
        return float(np.mean([0.0 if score is None else score for score in scores]))


def _renamed(annotation: Annotation, aliases: Mapping[str, str]) -> Annotation:
    return replace(annotation, boxes=annotation.boxes.relabel(aliases)) if aliases else annotation


def best_of(stem: str) -> str:
    """Name of the best weights beside those of the last step: ``best`` beside ``weights``."""
    return BEST if stem == "weights" else f"{BEST}-{stem}"


def spread(frames: Dataset, count: int) -> Dataset:
    """So many frames, spread evenly over all."""
    count = min(count, len(frames))
    return frames.select([place * len(frames) // count for place in range(count)])


@dataclass(frozen=True)
class Best:
    """The best score so far in a run's folder."""

    step: int
    score: float

    @classmethod
    def read(cls, folder: Path) -> "Best | None":
        """What an earlier part of the run reached; None where nothing stands there."""
        path = folder / f"{BEST}.json"
        try:
            tree = json.loads(path.read_text(encoding="utf-8"))
            return cls(int(tree["step"]), float(tree["validation"]))
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def write(self, folder: Path) -> None:
        """Keep it."""
        write_text(folder / f"{BEST}.json", json.dumps({"step": self.step, "validation": self.score}) + "\n")


def forget(folder: Path, stems: Sequence[str]) -> None:
    """Remove what another run left, as a run begins anew."""
    for name in (f"{BEST}.json", *(f"{stem}.safetensors" for stem in stems)):
        (folder / name).unlink(missing_ok=True)

"""Scores on held-out frames while a training runs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from farfield.datasets import Dataset
from farfield.detectors.network import Network
from farfield.detectors.runtime import Detector
from farfield.errors import ConfigError
from farfield.evaluation import detect
from farfield.metrics import Bootstrap
from farfield.metrics.detections import Detections
from farfield.vocabulary.counts import count_of

_NO_INTERVALS = Bootstrap(replicates=0)


@dataclass(frozen=True, kw_only=True)
class Validation:
    """Frames on which a training is scored every few steps.

    The score is the mean over the detector's classes of nuScenes' AP (centres within 0.5, 1, 2 and 4 m; Caesar et al.
    2020, 3.1): it needs no settings, and suits each kind of sensor.

    Args:
        frames: Held-out, annotated frames.
        cloud: Which of their clouds the detector reads (default: the first that suits).
        aliases: Classes of the annotation renamed, as in training.
        precision: Number type in which it detects.
    """

    frames: Dataset
    cloud: str | None = None
    aliases: Mapping[str, str] = field(default_factory=dict)
    precision: str = "auto"

    def check(self, classes: Sequence[str]) -> None:
        """Refuse frames on which nothing can be scored.

        Args:
            classes: Those of the detector.

        Raises:
            ConfigError: If none of the frames has a box of one of them.
        """
        annotations = filter(None, (self.frames[index].annotation for index in range(len(self.frames))))
        labels = {str(name) for annotation in annotations for name in annotation.boxes.label}
        present = {self.aliases.get(name, name) for name in labels}
        if not present & {*classes}:
            raise ConfigError(
                f"training.validation: none of the {count_of(len(self.frames), 'frame')} "
                f"has a box of {', '.join(classes)}; they "
                f"hold {', '.join(sorted(present)) or 'no boxes'}. Take more frames or another split, or name the "
                "classes in data.aliases."
            )

    def score(self, network: Network) -> float:
        """Mean AP of a network on the frames, from 0 to 1."""
        device = next(network.parameters()).device
        detector = Detector(network, device=device, precision=self.precision)
        detections = detect(detector, self.frames, cloud=self.cloud, annotated_only=True)
        detections = relabel_annotations(detections, self.aliases)
        present = {str(name) for annotation in detections.annotations.values() for name in annotation.boxes.label}
        classes = [name for name in detector.class_names if name in present]
        results = [detections.score("nuscenes", label=name, bootstrap=_NO_INTERVALS) for name in classes]
        return float(np.mean([result.figures["map"] or 0.0 for result in results]))


def relabel_annotations(detections: Detections, aliases: Mapping[str, str]) -> Detections:
    """The same detections beside annotations whose classes are called by their aliases."""
    annotations = {
        key: replace(annotation, boxes=annotation.boxes.relabel(dict(aliases)))
        for key, annotation in detections.annotations.items()
    }
    return replace(detections, annotations=annotations)

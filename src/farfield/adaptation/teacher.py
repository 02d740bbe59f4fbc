"""Mean teacher (Tarvainen and Valpola, NeurIPS 2017) for another weather, or for recordings without labels.

The teacher is the slow average of the student. It looks at target frames as they are; the student sees the same frames
moved and thinned and learns the teacher's boxes, of which those with a middling score are ignored, neither object nor
background. Labelled source frames are in every batch. The number of steps is fixed: the best step on the target's
labels is not looked for, for whoever has these would train on them. Whoever has labels of a few target frames does so
here: with ``labels`` these frames are in every batch too, and their boxes teach the student beside the teacher's. So do
``donors``: the target's own sweeps with simulated road users in them (LiDARsim, CVPR 2020; Real3D-Aug, 2022).
"""

import copy
from collections.abc import Collection, Mapping, Sequence
from typing import ClassVar, Literal, cast

import numpy as np
import torch
from pydantic import Field, model_validator
from torch import Tensor, nn

from farfield.adaptation.base import HELD_OUT, Adaptation, weighted_losses
from farfield.adaptation.cells import Cells, shown
from farfield.adaptation.networks import start_from, with_own_statistics
from farfield.adaptation.probes import gradient_norms
from farfield.adaptation.pseudo_labels import (
    PseudoLabels,
    Score,
    StrongAugmentation,
    in_weather,
    split_by_score,
    strong_view,
    targets_of,
    threshold_text,
)
from farfield.detectors.features import Features
from farfield.detectors.inputs import Inputs
from farfield.detectors.losses import process_count, sum_over_processes
from farfield.detectors.network import Network
from farfield.errors import ConfigError, FarfieldError
from farfield.training.method import (
    DETECTOR,
    Batch,
    MethodSettings,
    Stream,
    detection_losses,
    network_of,
    settings_of,
    total_of,
)
from farfield.training.weather import check_weather
from farfield.vocabulary.counts import count_of

_SOURCE, _TARGET, _TEACHER, _COUNTS = "source", "target", "teacher", "counts"
_SHARES = {"labels": 2.0, "donors": 1.0}  # frames in a batch over those of the source: labelled ones of the target


class TeacherSettings(MethodSettings):
    """Thresholds and average; 0.999, 0.6 and 0.25 are the literature's, the rest is ours."""

    start: str = Field(description="weights of the source's detector; without them a teacher has nothing to teach")
    decay: float = Field(0.999, ge=0, le=1, description="of the teacher's average, a step")
    positive: Score = Field(0.6, description="score from which a box of the teacher is an object, of all or by class")
    negative: Score = Field(0.25, description="score below which it is background; between, ignored")
    weight: float = Field(1.0, ge=0, description="of the target's losses; 0 leaves the statistics alone: the control")
    source_weight: float = Field(1.0, ge=0, description="of the source's losses")
    labels: bool = Field(False, description="learn from a few labelled target frames too: data.labels")
    labels_weight: float = Field(1.0, ge=0, description="of the losses of labelled target frames")
    donors: bool = Field(False, description="learn from simulated road users in target frames too: data.donors")
    donors_weight: float = Field(1.0, ge=0, description="of the losses of these frames")
    norm: Literal["shared", "per_domain"] = Field(
        "shared", description="one forward of all frames with its statistics, or statistics by domain"
    )
    strong: StrongAugmentation = StrongAugmentation()
    held_out: int = HELD_OUT
    patience: int = Field(200, ge=1, description="steps without any pseudo box after which the training stops")

    @model_validator(mode="after")
    def _in_order(self) -> "TeacherSettings":
        named = {name for score in (self.positive, self.negative) if isinstance(score, dict) for name in score}
        both = [self.by_class(which, named or {""}) for which in ("positive", "negative")]
        for name in sorted(both[0].keys() & both[1].keys()):
            positive, negative = both[0][name], both[1][name]
            if not 0 < positive <= 1 or not 0 <= negative <= 1:
                raise ValueError(f"expected scores from 0 to 1, got positive {positive:g} and negative {negative:g}")
            if negative > positive:
                raise ValueError(f"expected negative up to positive ({positive:g}), got {negative:g}")
        return self

    def by_class(self, which: str, names: Collection[str]) -> dict[str, float]:
        """A threshold by class: as it is given, or the same for all of the names."""
        score = self.positive if which == "positive" else self.negative
        return dict(score) if isinstance(score, dict) else dict.fromkeys(names, score)


class Counts(nn.Module):
    """Steps in a row without a pseudo box: a module, so that the checkpoint holds it."""

    def __init__(self) -> None:
        super().__init__()
        self.empty: Tensor
        self.register_buffer("empty", torch.zeros((), dtype=torch.int64))


class MeanTeacher(Adaptation):
    """Learn from labelled source frames, and from what a slow copy of the network finds in unlabelled target frames.

    Args:
        network: The detector's network: the student.
        **settings: See :class:`TeacherSettings`.

    Raises:
        ConfigError: If a setting is missing, unknown or does not fit.
    """

    streams: ClassVar[Mapping[str, Stream]] = {_SOURCE: Stream(), _TARGET: Stream(labelled=False, changed=False)}

    def __init__(self, network: Network, **settings: object) -> None:
        super().__init__()
        self.settings = settings_of(TeacherSettings, "teacher", settings)
        self._taught = tuple(name for name in _SHARES if getattr(self.settings, name))
        taught = {name: Stream(share=_SHARES[name]) for name in self._taught}
        self.streams = {**self.streams, **taught}  # type: ignore[misc]
        self._check(network)
        check_weather(self.settings.strong.weather, network.inputs)
        self.held_out = self.settings.held_out
        start_from(network, self.settings.start, "teacher")
        self.modules = nn.ModuleDict({DETECTOR: network, _TEACHER: copy.deepcopy(network), _COUNTS: Counts()})
        if self.settings.norm == "per_domain":
            self.modules[_SOURCE] = with_own_statistics(network, own_head=False)

    def _check(self, network: Network) -> None:
        for which in ("positive", "negative"):
            lacking = sorted(set(network.config.class_names) - set(self._scores(network, which)))
            if lacking:
                raise ConfigError(f"method teacher: expected {which} for each class; it lacks {', '.join(lacking)}.")
        least = min(self._scores(network, "negative").values())
        if network.config.score_threshold > least:
            raise ConfigError(
                f"method teacher: expected detector.score_threshold up to negative ({least:g}), or boxes that are to "
                f"be ignored would be background; got {network.config.score_threshold:g}."
            )

    def _scores(self, network: Network, which: str) -> dict[str, float]:
        return self.settings.by_class(which, tuple(network.config.class_names))

    def frozen(self) -> Collection[str]:
        """The teacher follows; it is not trained."""
        return (_TEACHER,)

    def meant_for(self) -> Mapping[str, str]:
        """The weights are for the target's clouds."""
        return {"weights": _TARGET}

    def losses(self, batch: Mapping[str, Batch], step: int) -> dict[str, Tensor]:
        """The losses of the source's labels, those of the pseudo boxes, and those of the target's labels, if any."""
        rng = self.generator(step)
        # 1. Teacher: pseudo-labels of the target's frames as they are
        pseudo_labels = self.pseudo_labels(batch[_TARGET].inputs)
        # 2. Strong view: the same frames in weather, moved and thinned, and their pseudo-labels with them
        changes = [self.settings.strong.draw(rng) for _ in pseudo_labels]
        clouds, pseudo_labels = self._in_weather(batch[_TARGET].inputs, pseudo_labels, rng)
        view = strong_view(clouds, changes, self.settings.strong.thinning, rng)
        moved = [pseudo.moved(change) for pseudo, change in zip(pseudo_labels, changes, strict=True)]
        # 3. Student: source and view, together or with statistics by domain; labels and donors are of the target
        of_target = view
        for name in self._taught:
            of_target = of_target + batch[name].inputs
        source, target = self._features(batch[_SOURCE].inputs, of_target)
        of_labels: dict[str, Features] = {}
        for name in reversed(self._taught):
            target, of_labels[name] = target.split(len(target) - len(batch[name]))
        student, of_source = self.network, network_of(self.modules, self._of_source)
        # 4. Losses: of the source's labels, of the pseudo-labels, and of the target's labels
        losses = detection_losses(of_source, source, batch[_SOURCE].targets)
        losses = weighted_losses(losses, "source", self.settings.source_weight)
        if self.settings.weight:
            frames = [{name: view[name][frame] for name in view} for frame in range(len(view))]
            pairs = zip(moved, frames, strict=True)
            targets = [targets_of(student.assigner, pseudo, clouds) for pseudo, clouds in pairs]
            losses |= weighted_losses(detection_losses(student, target, targets), "target", self.settings.weight)
        for name in self._taught:
            taught = detection_losses(student, of_labels[name], batch[name].targets)
            losses |= weighted_losses(taught, name, getattr(self.settings, f"{name}_weight"))
        features = [source, target, *(of_labels[name] for name in self._taught)]
        self._measure(losses, features, batch[_SOURCE].inputs, view, step)
        return losses

    def _in_weather(
        self, inputs: Inputs, pseudo_labels: list[PseudoLabels], rng: np.random.Generator
    ) -> tuple[Inputs, list[PseudoLabels]]:
        """The target's frames in the weather that the student is to see them in; its draws are its own."""
        config = self.settings.strong.weather
        if config is None or not config.probability:
            return inputs, pseudo_labels
        columns = {name: cloud.columns for name, cloud in self.network.inputs.items()}
        return in_weather(inputs, pseudo_labels, columns, config, rng.spawn(1)[0])

    def _measure(
        self, losses: Mapping[str, Tensor], features: Sequence[Features], inputs: Inputs, view: Inputs, step: int
    ) -> None:
        """Keep the norms of each stream's gradients, and variance and rank of both domains' features."""
        if not self.measures(step):
            return
        by_stream = {
            name: {part: loss for part, loss in losses.items() if part.startswith(f"{name}_")} for name in self.streams
        }
        self.note(**gradient_norms({name: total_of(parts) for name, parts in by_stream.items() if parts}, features))
        for name, of_domain, clouds in zip((_SOURCE, _TARGET), features, (inputs, view), strict=False):
            self.note(**{name: shown(of_domain, self.occupied(of_domain, clouds))})

    def reader(self, stream: str) -> Network:
        """Each domain has its statistics, if they are apart."""
        return network_of(self.modules, self._of_source if stream == _SOURCE else DETECTOR)

    def domains(self, features: Features, inputs: Inputs, stream: str, number: int) -> list[tuple[int, Cells]]:
        """All occupied cells of a frame; its stream is its domain."""
        del number
        return [(int(stream != _SOURCE), self.occupied(features, inputs))]

    @property
    def _of_source(self) -> str:
        return _SOURCE if self.settings.norm == "per_domain" else DETECTOR

    @torch.no_grad()
    def pseudo_labels(self, inputs: Inputs) -> list[PseudoLabels]:
        """What the teacher detects in frames.

        Raises:
            FarfieldError: If it detected no object for too many steps in a row.
        """
        teacher = network_of(self.modules, _TEACHER).eval()
        settings, frames = self.settings, teacher.predict(inputs)
        pseudo_labels = [split_by_score(boxes, settings.positive, settings.negative) for boxes in frames]
        confident, ignored = (sum(map(len, part)) for part in zip(*pseudo_labels, strict=True))
        self.note(pseudo_boxes=confident / len(frames), ignored_boxes=ignored / len(frames))
        self._count(confident)
        return pseudo_labels

    def _count(self, confident: int) -> None:
        empty = cast(Counts, self.modules[_COUNTS]).empty
        total = torch.tensor(float(confident), device=empty.device)
        total = sum_over_processes(total) if process_count() > 1 else total
        empty.copy_((empty + 1) * (0 if total else 1))
        if int(empty) >= self.settings.patience and not self._taught:
            raise FarfieldError(
                f"method teacher: in {count_of(int(empty), 'step')} the teacher found no box with a score of "
                f"{threshold_text(self.settings.positive)} or more in the target's frames, so there is nothing to "
                "learn there. Look at what the start's weights detect in them; lower positive, or move the target into "
                "the coordinates that these learnt in."
            )

    def _features(self, source: Inputs, target: Inputs) -> tuple[Features, Features]:
        student = self.network
        if self.settings.norm == "per_domain":
            return network_of(self.modules, _SOURCE).encode(source), student.encode(target)
        one, other = student.encode(source + target).split(len(source))
        return one, other

    @torch.no_grad()
    def after_step(self, step: int) -> None:
        """Move the teacher towards the student: parameters and statistics."""
        del step
        student = self.modules[DETECTOR].state_dict()
        for name, value in self.modules[_TEACHER].state_dict().items():
            if value.is_floating_point():
                value.lerp_(student[name].to(value.dtype), 1 - self.settings.decay)
            else:
                value.copy_(student[name])

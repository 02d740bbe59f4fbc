"""Typed settings of a training; unknown keys are errors."""

import itertools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    Field,
    field_validator,
    model_serializer,
    model_validator,
)

from farfield.files.yaml_text import PlainSettings


def _in_order(span: tuple[float, float]) -> tuple[float, float]:
    if span[0] > span[1]:
        raise ValueError(f"expected two values, the lower one first; got {span[0]:g} and {span[1]:g}")
    return span


_Positive = Annotated[float, Field(gt=0)]
_Share = Annotated[float, Field(gt=0, le=1)]
Span = Annotated[tuple[_Positive, _Positive], AfterValidator(_in_order)]
"""From and to, both greater than 0."""
Shares = Annotated[tuple[_Share, _Share], AfterValidator(_in_order)]
"""The same of shares, up to 1."""
Gains = Annotated[tuple[float, float], AfterValidator(_in_order)]
"""From and to, in dB."""


class SparseNear(PlainSettings):
    """Near points thinned until near objects hold as many as far ones do: a control of range adaptation."""

    near_m: float = Field(100.0, gt=0, description="points nearer than this are thinned")
    far_m: tuple[float, float] = Field((100.0, 250.0), description="ranges whose objects say how sparse")
    probability: float = Field(0.5, gt=0, le=1, description="share of the frames with far objects that are thinned")

    @model_validator(mode="after")
    def _in_order(self) -> "SparseNear":
        if not self.near_m <= self.far_m[0] < self.far_m[1]:
            raise ValueError(f"expected near_m up to far_m, and far_m to rise; got {self.near_m:g}, {list(self.far_m)}")
        return self


class WeatherConfig(PlainSettings):
    """Weather laid over frames. Spans are drawn from; their defaults lie outside those of the simulator's weathers."""

    probability: float = Field(0.5, ge=0, le=1, description="share of the frames that get weather; 0 switches it off")
    kinds: tuple[Literal["fog", "rain", "snow", "ice"], ...] = Field(
        ("fog", "rain", "snow", "ice"),
        min_length=1,
        description="drawn evenly; snow brings ice, rain drops on the window",
    )
    sensor: Literal["luminar-h2", "os2-64", "os1-128", "hdl-64e"] | None = Field(
        None, description="which LiDAR the clouds are from; a radar needs none"
    )
    origin_m: tuple[float, float, float] = Field((0.0, 0.0, 0.0), description="where it stands in the frame")
    reflectance: float = Field(
        0.2, gt=0, le=1, description="taken of all points where intensity is not read: in a teacher's strong view"
    )
    fog_m: Span = Field((120.0, 350.0), description="visibility: meteorological optical range")
    rain_mm_h: Span = Field((12.0, 30.0), description="rain's rate")
    snow_mm_h: Span = Field((4.0, 6.0), description="as liquid water")
    coverage: Shares = Field((0.08, 0.35), description="share of the window's front that ice covers")
    patches_deg: tuple[Span, Span] = Field(
        ((12.0, 25.0), (6.0, 12.0)), description="widths of the ice's patches in azimuth and elevation"
    )
    drops: Shares = Field((0.08, 0.2), description="share of the window's front that drops cover")
    drops_deg: tuple[Span, Span] = Field(((2.0, 4.0), (1.2, 2.4)), description="widths of the drops")
    transmission: Shares = Field((0.08, 0.3), description="one way, through what is covered")
    film_mm: Span = Field((0.06, 0.15), description="film of water on a radome in rain")
    floor_rise_db: Gains = Field((0.0, 0.5), description="by how much a radar's noise rises")


_LATE = ("weather", "object_scale", "line_dropout", "missing_sectors", "range_noise_m", "intensity_off")


class AugmentationConfig(PlainSettings):
    """Random changes to a training frame. Zero switches each off."""

    flip_probability: float = Field(0.5, ge=0, le=1, description="mirror left and right")
    rotation_rad: float = Field(0.1, ge=0, description="turn about the sensor by up to this; more leaves a long window")
    scale: float = Field(0.05, ge=0, lt=1, description="scale the scene by up to this share")
    height_m: float = Field(
        0.0, ge=0, description="raise or lower the scene by up to this: sensors stand at other heights"
    )
    thinning: float = Field(0.0, ge=0, lt=1, description="drop up to this share of a frame's points: sparser sensors")
    sparse_near: SparseNear | None = Field(None, description="thin near points to the density of far objects")
    pasted: dict[str, int] = Field(default_factory=dict, description="objects of each class pasted from other frames")
    pasted_min_points: int = Field(5, ge=1, description="pasted objects have at least this many points")
    pasted_bands_m: tuple[float, ...] = Field(
        (), description="edges of range bands, such as 0, 70, 150, 250, that pasted objects are drawn evenly from"
    )
    bank_frames: int = Field(128, ge=1, description="frames whose objects can be pasted at a time; they change slowly")
    weather: WeatherConfig | None = Field(None, description="weather laid over frames before they are moved")
    object_scale: float = Field(
        0.0, ge=0, lt=1, description="scale each object, its points and its box, by up to this share; full boxes only"
    )
    line_dropout: float = Field(0.0, ge=0, lt=1, description="drop up to this share of the scan lines, whole ones")
    missing_sectors: float = Field(
        0.0,
        ge=0,
        le=1,
        description="share of the frames that lose a sector of 5 to 30 degrees, as ice on a window does",
    )
    range_noise_m: float = Field(0.0, ge=0, description="noise along the beam of up to this standard deviation")
    intensity_off: float = Field(
        0.0, ge=0, le=1, description="share of the frames whose intensity is 0, as that of sensors that give none"
    )

    @field_validator("pasted_bands_m")
    @classmethod
    def _rising(cls, edges_m: tuple[float, ...]) -> tuple[float, ...]:
        if edges_m and (len(edges_m) < 2 or any(a >= b for a, b in itertools.pairwise(edges_m)) or edges_m[0] < 0):
            raise ValueError(f"expected at least two rising edges from 0 up, got {list(edges_m)}")
        return edges_m

    @model_serializer(mode="wrap")
    def _serialised(self, others: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        """All settings; late ones only where they are set, so that trainings without are recognised as before."""
        return {name: value for name, value in others(self).items() if name not in _LATE or getattr(self, name)}


UNCHANGED = AugmentationConfig(flip_probability=0.0, rotation_rad=0.0, scale=0.0)
"""No random change."""


class InitConfig(PlainSettings):
    """What of other weights a network takes; :mod:`farfield.training.transfer` has the rules in their order."""

    rename: dict[str, str] = Field(
        default_factory=dict, description="beginnings of names in the weights and what they are called here"
    )
    inputs: Literal["match", "average", "fresh"] = Field(
        "match", description="where the columns read differ: match takes them by name, average the mean of theirs"
    )
    head: Literal["by-class", "fresh"] = Field("by-class", description="fresh: nothing of the head is taken")
    skip: tuple[str, ...] = Field((), description="parts or patterns that stay fresh, such as head or *.bias")
    least_taken: float = Field(0.1, ge=0, le=1, description="taking a smaller share of the parameters is an error")


class StatisticsConfig(PlainSettings):
    """Batch statistics taken anew on the target's frames, before the first step."""

    reestimate_batches: int = Field(
        200, ge=1, description="batches from which batch normalisation takes its statistics"
    )


class StartConfig(InitConfig):
    """Where a training starts instead of at random."""

    weights: str = Field(min_length=1, description="a bundled detector's name, a run's folder or a weights file")
    statistics: StatisticsConfig | None = Field(None, description="batch statistics taken anew on the target's frames")
    freeze: tuple[str, ...] | dict[str, _Share] = Field(
        (),
        description="parts of the network that stay as they are: names such as encoder, or patterns such as *.norm; "
        "with shares of the steps, such as {backbone: 0.5}, they stay until then",
    )
    rates: dict[str, _Positive] = Field(
        default_factory=dict, description="learning rates of parts over that of the training, such as {encoder: 0.1}"
    )
    layer_decay: _Share | None = Field(
        None, description="instead of rates: each part of the network learns so much slower than the one after it"
    )

    @model_validator(mode="after")
    def _rates_or_decay(self) -> "StartConfig":
        if self.rates and self.layer_decay is not None:
            raise ValueError("expected rates or layer_decay, got both")
        return self

    @property
    def frozen_until(self) -> dict[str, float]:
        """Share of the steps until which each of the frozen parts stays."""
        return dict(self.freeze) if isinstance(self.freeze, dict) else dict.fromkeys(self.freeze, 1.0)

    @model_serializer(mode="wrap")
    def _serialised(self, others: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        """All settings; defaults only where they always were written, so that runs are recognised as before."""
        values, fields = others(self), type(self).model_fields
        defaults = {name: fields[name].get_default(call_default_factory=True) for name in values}
        written = {name for name in values if getattr(self, name) != defaults[name]} | {"weights", "freeze"}
        return {name: value for name, value in values.items() if name in written}


class ValidationConfig(PlainSettings):
    """Scores on frames that are not trained on, while the training runs; the best weights are kept."""

    every_steps: int = Field(500, ge=1, description="steps between two scores; the last step is scored too")
    frames: int = Field(
        64, ge=1, description="frames to score on: held out of the training, whole sequences where there are several"
    )
    split: str = Field(
        "", description="take them from this split of the same data instead; none of its frames is trained on"
    )


class TrainingConfig(PlainSettings):
    """The loop. ``start_from: WEIGHTS`` is short for ``start: {weights: WEIGHTS}``."""

    steps: int = Field(
        2000,
        ge=0,
        description="updates; a run whose number is raised goes on to the new one; 0: only what start takes",
    )
    batch_size: int = Field(4, ge=1, description="frames a step, over all processes")
    learning_rate: float = Field(3e-3, gt=0, description="peak of the one-cycle schedule")
    weight_decay: float = Field(0.01, ge=0, description="AdamW's, of matrices and kernels")
    warmup: float = Field(0.3, gt=0, lt=1, description="share of the steps in which the rate rises")
    gradient_clip: float = Field(10.0, gt=0, description="limit of the gradient's norm")
    average_decay: float = Field(
        0.998, ge=0, lt=1, description="decay of the averaged weights that are kept at the end"
    )
    precision: Literal["auto", "fp32", "bf16"] = Field("auto", description="number type; auto: what suits the device")
    accelerator: str = Field("auto", description="as Lightning Fabric names them: auto, cpu, gpu")
    devices: int | Literal["auto"] = Field(1, description="processes that share each batch; auto: one a GPU")
    threads: int = Field(0, ge=0, description="torch threads; 0 leaves torch's choice")
    workers: int = Field(1, ge=0, description="processes that prepare frames")
    checkpoint_every_s: float = Field(60.0, gt=0, description="seconds between checkpoints; Ctrl-C writes one too")
    log_every_steps: int = Field(20, ge=1, description="steps between lines on the screen; log.jsonl has every step")
    min_points: int = Field(1, ge=0, description="boxes with fewer points in the trained cloud are left out")
    unannotated: Literal["refuse", "skip"] = Field(
        "refuse", description="what to do with frames without annotation in a labelled stream: they are not empty ones"
    )
    far_sampling: float = Field(
        0.0, ge=0, description="weight that a frame with an average number of far boxes gains; 0 draws all alike"
    )
    far_from_m: float = Field(150.0, gt=0, description="boxes from this range on are far")
    validation: ValidationConfig | None = Field(None, description="scores on held-out frames while it runs")
    start: StartConfig | None = Field(None, description="weights to start from: what fits is taken, and reported")
    negatives: Path | None = Field(
        None, description="file of mined false boxes; augmentation.pasted: {clutter: 4} pastes what stands in them"
    )
    tensorboard: bool = Field(False, description="also log for TensorBoard, into the run's folder")
    seed: int = Field(0, description="of weights, order of frames and all random changes")

    @model_validator(mode="before")
    @classmethod
    def _short(cls, settings: Any) -> Any:
        """Put ``start_from`` into ``start``."""
        if not isinstance(settings, Mapping) or settings.get("start_from") is None:
            return settings
        others = {name: value for name, value in settings.items() if name != "start_from"}
        start = others.get("start") or {}
        start = start.model_dump() if isinstance(start, StartConfig) else start
        weights = str(settings["start_from"])
        if not isinstance(start, Mapping) or start.get("weights", weights) != weights:
            raise ValueError(f"expected start_from or start.weights, which are one; got {weights} and {start}")
        return {**others, "start": {**start, "weights": weights}}

    @model_validator(mode="after")
    def _learns(self) -> "TrainingConfig":
        if self.steps == 0 and self.start is None:
            raise ValueError("steps: expected at least 1, got 0: without start the weights would be random ones")
        return self

    @model_serializer(mode="wrap")
    def _serialised(self, others: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        """All settings; start and validation only where there is one, so that runs without are recognised as before."""
        values = others(self)
        if self.validation is None:
            values.pop("validation", None)
        if self.start is None:
            values.pop("start", None)
        if self.negatives is None:
            values.pop("negatives", None)
        return values

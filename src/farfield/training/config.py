"""Typed settings of a training; unknown keys are errors."""

import itertools
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator


class _Settings(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class SparseNear(_Settings):
    """Near points thinned until near objects hold as many as far ones do: a control of range adaptation."""

    near_m: float = Field(100.0, gt=0, description="points nearer than this are thinned")
    far_m: tuple[float, float] = Field((100.0, 250.0), description="ranges whose objects say how sparse")
    probability: float = Field(0.5, gt=0, le=1, description="share of the frames with far objects that are thinned")

    @model_validator(mode="after")
    def _in_order(self) -> "SparseNear":
        if not self.near_m <= self.far_m[0] < self.far_m[1]:
            raise ValueError(f"expected near_m up to far_m, and far_m to rise; got {self.near_m:g}, {list(self.far_m)}")
        return self


class AugmentationConfig(_Settings):
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

    @field_validator("pasted_bands_m")
    @classmethod
    def _rising(cls, edges_m: tuple[float, ...]) -> tuple[float, ...]:
        if edges_m and (len(edges_m) < 2 or any(a >= b for a, b in itertools.pairwise(edges_m)) or edges_m[0] < 0):
            raise ValueError(f"expected at least two rising edges from 0 up, got {list(edges_m)}")
        return edges_m


UNCHANGED = AugmentationConfig(flip_probability=0.0, rotation_rad=0.0, scale=0.0)
"""No random change."""


class TrainingConfig(_Settings):
    """The loop."""

    steps: int = Field(2000, ge=1)
    batch_size: int = Field(4, ge=1, description="frames a step, over all processes")
    learning_rate: float = Field(3e-3, gt=0, description="peak of the one-cycle schedule")
    weight_decay: float = Field(0.01, ge=0)
    warmup: float = Field(0.3, gt=0, lt=1, description="share of the steps in which the rate rises")
    gradient_clip: float = Field(10.0, gt=0)
    average_decay: float = Field(
        0.998, ge=0, lt=1, description="decay of the averaged weights that are kept at the end"
    )
    precision: Literal["auto", "fp32", "bf16"] = "auto"
    accelerator: str = Field("auto", description="as Lightning Fabric names them: auto, cpu, gpu")
    devices: int | Literal["auto"] = 1
    threads: int = Field(0, ge=0, description="torch threads; 0 leaves torch's choice")
    workers: int = Field(1, ge=0, description="processes that prepare frames")
    checkpoint_every_s: float = Field(60.0, gt=0)
    log_every_steps: int = Field(20, ge=1)
    min_points: int = Field(1, ge=0, description="boxes with fewer points in the trained cloud are left out")
    unannotated: Literal["refuse", "skip"] = Field(
        "refuse", description="what to do with frames without annotation in a labelled stream: they are not empty ones"
    )
    far_sampling: float = Field(
        0.0, ge=0, description="weight that a frame with an average number of far boxes gains; 0 draws all alike"
    )
    far_from_m: float = Field(150.0, gt=0, description="boxes from this range on are far")
    tensorboard: bool = Field(False, description="also log for TensorBoard, into the run's folder")
    seed: int = 0

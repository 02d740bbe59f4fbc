"""Settings of detectors: what all of them have, their grids, bounds of lengths, and names that settings had before.

Bounds stand in one place, since a weights file's configuration is no more to be trusted than its bytes. What is a
length is known by its name, which ends in ``_m``. The bounds are far outside what any road holds; they keep out what
would overflow, or give boxes that no figure could hold. Needs no torch.
"""

import math
import operator
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Annotated, Any, ClassVar

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, Field, field_validator, model_serializer, model_validator

from farfield.detectors.score_bands import ScoreBands
from farfield.detectors.spec import DETECTORS
from farfield.errors import FarfieldError
from farfield.files.yaml_text import PlainSettings
from farfield.geometry.boxes import BOX_MARGIN_M, Boxes, count_points_in_boxes
from farfield.vocabulary.classes import unit_of_sizes

Channels = Annotated[int, Field(ge=1, le=4096)]
"""A number of features."""

OLD_NAMES = {"grid.voxel_m": "grid.cell_m"}
"""Old names of settings in a detector with a voxel grid."""

FARTHEST_M = 2000.0
"""No length, reach or height is larger, nor lower below the sensor."""
SMALLEST_M = 0.001
"""No size, cell or reach is smaller."""

_EXTENTS = ("size_m", "sizes_m", "cell_m", "range_m", "half_width_m")


_MAX_ENTRIES = 64  # of a list or a group of settings
_MAX_BLOCKS, _COARSEST_STRIDE = 8, 1024
_MAX_VOXELS = 4_000_000_000
_MAX_PILLARS = 50_000_000
MAX_IMAGE_NUMBERS = 500_000_000  # of the image that a frame becomes: 2 GB


class DetectorConfig(PlainSettings, ABC):
    """Everything that decides the shape of a network and its boxes; each detector adds its own fields.

    A subclass gives ``name`` its detector's name as the default.
    """

    old_names: ClassVar[Mapping[str, str]] = {}
    """Today's places of settings that had other ones, dotted."""

    name: str = Field(description="which detector")
    score_threshold: float = Field(0.05, ge=0, le=1, description="boxes of a lower score are not given")
    nms_iou: float = Field(0.1, ge=0, le=1, description="boxes that overlap a better one by more are dropped")
    max_boxes: int = Field(500, ge=1, le=100_000, description="boxes kept in a frame")
    far_weight: float = Field(0.0, ge=0, description="extra weight of a box's loss per 100 m of range")
    full_points: int = Field(
        0, ge=0, description="boxes with n points, fewer than these, weigh (n / these)^0.5 in the loss; 0: all alike"
    )
    score_bands: ScoreBands | None = Field(
        None, description="scores calibrated by range and points: fitted after the training, not set by hand"
    )

    @model_validator(mode="before")
    @classmethod
    def _today(cls, settings: Any) -> Any:
        return renamed(settings, cls.old_names)

    @model_validator(mode="after")
    def _possible_lengths(self) -> "DetectorConfig":
        check_lengths(self)
        longest = [max(size) for size in self.anchor_sizes_m.values()]
        unit = unit_of_sizes(float(np.median(longest))) if longest else ""
        if unit:
            raise ValueError(f"expected sizes in metres, got a median length of {np.median(longest):g}: {unit}")
        return self

    @field_validator("name")
    @classmethod
    def _is_its_own(cls, name: str) -> str:
        try:
            expected = DETECTORS[name].config_class
        except FarfieldError as error:
            raise ValueError(str(error)) from error
        if expected is not cls:
            raise ValueError(f"expected the settings of {name}, {expected.__name__}; got {cls.__name__}")
        return name

    @property
    @abstractmethod
    def class_names(self) -> tuple[str, ...]:
        """The classes that the detector tells apart."""

    @property
    def anchor_sizes_m(self) -> Mapping[str, tuple[float, float, float]]:
        """Length, width and height of each class' anchor, metres; none without anchors."""
        return {}

    @property
    @abstractmethod
    def reach_m(self) -> float:
        """How far ahead the detector looks, metres."""

    def box_weights(self, boxes: Boxes, inputs: Mapping[str, np.ndarray] | None = None) -> Float[np.ndarray, " n"]:
        """Weight of each box in the loss, shape (n,); see :class:`BoxWeights`."""
        return BoxWeights.of(self)(boxes, inputs or {})

    @model_serializer(mode="wrap")
    def _serialised(self, others: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        """All settings; late ones only where they are not the default, so that runs are recognised as before."""
        values = others(self)
        unset = {name for name in LATE_SETTINGS if name in values and getattr(self, name) == _default(self, name)}
        return {name: value for name, value in values.items() if name not in unset}


LATE_SETTINGS = ("full_points", "score_bands", "first_cell", "lifted_channels")
"""Settings that came after weights had been trained without them."""


def _default(settings: BaseModel, name: str) -> Any:
    return type(settings).model_fields[name].get_default(call_default_factory=True)


@dataclass(frozen=True)
class BoxWeights:
    """How much a box weighs in the loss.

    Args:
        far_weight: Extra weight per 100 m of range on the ground.
        full_points: A box with n points, fewer than these, weighs (n / these)^0.5 times as much; 0 counts no points.
    """

    far_weight: float = 0.0
    full_points: int = 0

    @classmethod
    def of(cls, config: DetectorConfig) -> "BoxWeights":
        """Those of a detector."""
        return cls(config.far_weight, config.full_points)

    def __call__(self, boxes: Boxes, inputs: Mapping[str, np.ndarray]) -> Float[np.ndarray, " n"]:
        """Weight of each box of a frame, shape (n,).

        Args:
            boxes: The boxes.
            inputs: What the network reads of the frame, x, y and z first; points of all inputs count.
        """
        weight = 1.0 + self.far_weight * np.hypot(boxes.centre_m[:, 0], boxes.centre_m[:, 1]) / 100.0
        if self.full_points and len(boxes):
            clouds = [np.zeros((0, 3), dtype=np.float32), *(cloud[:, :3] for cloud in inputs.values())]
            count = count_points_in_boxes(np.concatenate(clouds), boxes, margin_m=BOX_MARGIN_M)
            weight = weight * np.sqrt(np.clip(count, 1, self.full_points) / self.full_points)
        return weight


ALIKE = BoxWeights()
"""All boxes weigh the same."""


class GridConfig(PlainSettings):
    """Where a detector looks, and how finely.

    ``range_m`` is the one number to change for another reach: the cell counts, anchors and strides follow. Cell counts
    are rounded up to a multiple of the network's coarsest stride, so the grid may reach a little farther than range_m.
    """

    range_m: float = Field(250.0, gt=0, description="forward reach, x from 0")
    half_width_m: float = Field(50.0, gt=0, description="lateral reach, y from -half_width_m to +half_width_m")
    z_min_m: float = Field(-6.0, description="points below are dropped; generous, since roads climb over 250 m")
    z_max_m: float = Field(6.0, description="points above are dropped")
    cell_m: float = Field(0.25, gt=0, description="edge length of a square pillar")

    @model_validator(mode="after")
    def _fits_memory(self) -> "GridConfig":
        check_lengths(self)  # before they are divided by
        cells = self.range_m * 2 * self.half_width_m / self.cell_m**2
        if not cells <= _MAX_PILLARS:
            raise ValueError(f"expected at most {_MAX_PILLARS:,} cells, got {cells:,.0f}: take a larger cell_m")
        return self

    def shape(self, multiple: int) -> tuple[int, int]:
        """Cells along x and y, padded so that ``multiple`` divides both."""
        along = (self.range_m, 2 * self.half_width_m)
        nx, ny = (math.ceil(round(length / self.cell_m, 6) / multiple) * multiple for length in along)
        return nx, ny

    def y_min_m(self, multiple: int) -> float:
        """The grid's right edge in metres: padding is shared between both sides."""
        return -self.shape(multiple)[1] * self.cell_m / 2


class VoxelGridConfig(PlainSettings):
    """Where a voxel detector looks, and how finely.

    Cell counts along x and y are rounded up to a multiple of the network's coarsest stride, so the grid may reach a
    little farther than range_m.
    """

    range_m: float = Field(250.0, gt=0, description="forward reach, x from 0")
    half_width_m: float = Field(50.0, gt=0, description="lateral reach, y from -half_width_m to +half_width_m")
    z_min_m: float = Field(-6.0, description="points below are dropped; generous, since roads climb over 250 m")
    z_max_m: float = Field(6.0, description="points above are dropped")
    cell_m: tuple[float, float, float] = Field(
        (0.1, 0.1, 0.2), description="cell size along x, y and z; one number for a cube"
    )
    extra_layers: int = Field(0, ge=0, le=64, description="empty layers above, as SECOND's grid has one (41 for 40)")

    @model_validator(mode="before")
    @classmethod
    def _old_name(cls, settings: Any) -> Any:
        return renamed(settings, {"voxel_m": "cell_m"})

    @field_validator("cell_m", mode="before")
    @classmethod
    def _cube(cls, cell_m: Any) -> Any:
        return (cell_m,) * 3 if isinstance(cell_m, int | float) else cell_m

    @model_validator(mode="after")
    def _fits(self) -> "VoxelGridConfig":
        check_lengths(self)  # before they are divided by
        if not min(self.cell_m) > 0:
            raise ValueError(f"expected a voxel size above 0 along x, y and z, got {self.cell_m}")
        if not self.z_max_m > self.z_min_m:
            raise ValueError(f"expected z_max_m above z_min_m, got {self.z_max_m} and {self.z_min_m}")
        volume_m3 = self.range_m * 2 * self.half_width_m * (self.z_max_m - self.z_min_m)
        cells = volume_m3 / math.prod(self.cell_m)
        if not cells <= _MAX_VOXELS:
            raise ValueError(f"expected at most {_MAX_VOXELS:,} voxels, got {cells:,.0f}: take a larger cell_m")
        columns = self.range_m * 2 * self.half_width_m / (self.cell_m[0] * self.cell_m[1])
        if not columns <= _MAX_PILLARS:
            raise ValueError(f"expected at most {_MAX_PILLARS:,} cells on the ground, got {columns:,.0f}")
        return self

    def shape(self, multiple: int) -> tuple[int, int, int]:
        """Cells along z, x and y; ``multiple`` divides the last two."""
        dx, dy, dz = self.cell_m
        along = ((self.range_m, dx), (2 * self.half_width_m, dy))
        nx, ny = (math.ceil(round(length / step, 6) / multiple) * multiple for length, step in along)
        return math.ceil(round((self.z_max_m - self.z_min_m) / dz, 6)) + self.extra_layers, nx, ny

    def y_min_m(self, multiple: int) -> float:
        """The grid's right edge in metres: padding is shared between both sides."""
        return -self.shape(multiple)[2] * self.cell_m[1] / 2


def renamed(settings: Any, names: Mapping[str, str]) -> Any:
    """Settings under today's names.

    Args:
        settings: A tree of settings; anything else comes back as it is. It is not changed.
        names: Today's places by the old ones, dotted, such as ``{"grid.voxel_m": "grid.cell_m"}``; both places of a
            pair lie in one group.

    Raises:
        ValueError: If a setting stands under both names.
    """
    for old, new in names.items():
        settings = _rename_key(settings, old.split("."), new.split("."))
    return settings


def current_key(path: str, names: Mapping[str, str]) -> str:
    """Today's dotted place of a setting, or of one within a group, such as ``grid.range_m`` for ``window.range_m``."""
    for old, new in names.items():
        if path == old or path.startswith(f"{old}."):
            return new + path[len(old) :]
    return path


def _rename_key(settings: Any, old: list[str], new: list[str]) -> Any:
    if not isinstance(settings, Mapping) or old[0] not in settings:
        return settings
    if len(old) > 1:
        return {**settings, old[0]: _rename_key(settings[old[0]], old[1:], new[1:])}
    if new[0] in settings:
        raise ValueError(f"{old[0]} is the old name of {new[0]}: give one of them")
    return {(new[0] if name == old[0] else name): value for name, value in settings.items()}


def check_blocks(
    widths: Sequence[int], depths: Sequence[int], strides: Sequence[int], out_stride: int | None = None
) -> None:
    """Check the blocks of a backbone over the bird's-eye image.

    Args:
        widths: Channels of each block.
        depths: Further convolutions of each block.
        strides: Stride of each block.
        out_stride: Stride of its output; None: there is one a block.

    Raises:
        ValueError: If their numbers differ, they are too many or too coarse, or a block does not fit onto the output.
    """
    if not 1 <= len(widths) == len(depths) == len(strides) <= _MAX_BLOCKS:
        numbers = f"{len(widths)}, {len(depths)} and {len(strides)}"
        raise ValueError(f"expected 1 to {_MAX_BLOCKS} widths, as many depths and as many strides, got {numbers}")
    reached = list(accumulate(strides, operator.mul))
    if max(reached[-1], out_stride or 1) > _COARSEST_STRIDE:
        raise ValueError(
            f"expected strides that multiply to at most {_COARSEST_STRIDE}, got {reached[-1]}, {out_stride}"
        )
    if out_stride is not None and any(max(out_stride, stride) % min(out_stride, stride) for stride in reached):
        raise ValueError(f"expected an out_stride that divides, or is a multiple of, {reached}, got {out_stride}")


def check_lengths(settings: BaseModel) -> None:
    """Check every length of settings and of those within them, and how many entries lists and groups have.

    Raises:
        ValueError: If one is not finite or out of bounds, or a lowest height is not below the highest.
    """
    _check(settings, "")


def _check(value: Any, path: str) -> None:
    if isinstance(value, tuple | list | dict) and len(value) > _MAX_ENTRIES:
        raise ValueError(f"{path}: expected at most {_MAX_ENTRIES} entries, got {len(value)}")
    if isinstance(value, BaseModel):
        for name in type(value).model_fields:
            _check(getattr(value, name), f"{path}.{name}" if path else name)
        low, high = getattr(value, "z_min_m", None), getattr(value, "z_max_m", None)
        if low is not None and high is not None and not high > low:
            upper = f"{path}.z_max_m" if path else "z_max_m"
            raise ValueError(f"{upper}: expected more than z_min_m ({low:g}), got {high:g}")
    elif isinstance(value, dict):
        for name, item in value.items():
            _check(item, f"{path}.{name}")
    elif isinstance(value, tuple | list):
        for item in value:
            _check(item, path)
    elif isinstance(value, int | float) and any(part.endswith("_m") for part in path.split(".")):
        lowest = SMALLEST_M if set(path.split(".")) & set(_EXTENTS) else -FARTHEST_M
        if not (math.isfinite(value) and lowest <= value <= FARTHEST_M):
            raise ValueError(f"{path}: expected {lowest:g} to {FARTHEST_M:g} m, got {float(value):g}")

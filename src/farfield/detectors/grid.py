"""The bird's-eye grid of a detector: everything follows from the range in metres."""

import math

from pydantic import BaseModel, ConfigDict, Field, model_validator

_MAX_CELLS = 50_000_000


class GridConfig(BaseModel):
    """Where a detector looks, and how finely.

    ``range_m`` is the one number to change for another reach: the cell counts, anchors and strides follow. Cell counts
    are rounded up to a multiple of the network's coarsest stride, so the grid may reach a little farther than range_m.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    range_m: float = Field(250.0, gt=0, description="forward reach, x from 0")
    half_width_m: float = Field(50.0, gt=0, description="lateral reach, y from -half_width_m to +half_width_m")
    z_min_m: float = Field(-6.0, description="points below are dropped; generous, since roads climb over 250 m")
    z_max_m: float = Field(6.0, description="points above are dropped")
    cell_m: float = Field(0.25, gt=0, description="edge length of a square pillar")

    @model_validator(mode="after")
    def _fits_memory(self) -> "GridConfig":
        cells = self.range_m * 2 * self.half_width_m / self.cell_m**2
        if not cells <= _MAX_CELLS:
            raise ValueError(f"expected at most {_MAX_CELLS:,} cells, got {cells:,.0f}: take a larger cell_m")
        return self

    def shape(self, multiple: int) -> tuple[int, int]:
        """Cells along x and y, padded so that ``multiple`` divides both."""
        along = (self.range_m, 2 * self.half_width_m)
        nx, ny = (math.ceil(round(length / self.cell_m, 6) / multiple) * multiple for length in along)
        return nx, ny

    def y_min_m(self, multiple: int) -> float:
        """The grid's right edge in metres: padding is shared between both sides."""
        return -self.shape(multiple)[1] * self.cell_m / 2

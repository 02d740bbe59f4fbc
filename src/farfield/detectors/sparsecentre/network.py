"""A fully sparse centre-based detector: its cost follows the points, not the area.

In the line of VoxelNeXt (Chen et al., CVPR 2023, arXiv 2303.11301) and SAFDNet (Zhang et al., CVPR 2024, arXiv
2403.05817): points -> voxels -> sparse 3D encoder -> heights summed to a bird's-eye map of occupied cells -> sparse
pyramid with coarse stages -> diffusion to the empty centres -> heat and boxes at occupied cells -> local maxima ->
rotated NMS. Nothing is as large as the range. Differences from the papers, each for long range: strided layers add no
cells, so a single point is one path to the map; cells vote for the centre that should be occupied; heights of boxes are
relative to the points of their cell, since roads climb over 250 m; and any occupied cell can be assigned to a box.
"""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

import torch
from pydantic import Field, model_validator
from torch import Tensor, nn

from farfield.detectors.contract import Channels, InputColumns, MapDetector
from farfield.detectors.features import FeatureMap, in_type_of
from farfield.detectors.inputs import POSITION, CloudInput, Positions
from farfield.detectors.sparse import SparseTensor, SubmanifoldConv
from farfield.detectors.sparsecentre.backbone import (
    FLAT,
    ResidualBlock,
    SparsePyramid,
    VoxelEncoder,
    flat_keys,
    merge_heights,
    normalised,
)
from farfield.detectors.sparsecentre.diffusion import CentreDiffusion, means_at
from farfield.detectors.sparsecentre.head import CentreHead, CentreHeadConfig
from farfield.detectors.voxels import OLD_NAMES, VoxelGridConfig, mean_features, mean_voxels

Depth = Annotated[int, Field(ge=0, le=64)]


class SparseCentreConfig(CentreHeadConfig):
    """Everything that decides the shape of the network and its boxes."""

    old_names = OLD_NAMES

    name: str = "sparsecentre"
    grid: VoxelGridConfig = VoxelGridConfig(cell_m=(0.2, 0.2, 0.25))
    use_intensity: bool = Field(False, description="read intensities too")
    use_lag: bool = Field(False, description="read the age of each point's sweep: for several sweeps a frame")
    positions: Positions = Field(
        "absolute", description="relative: without the place on the ground, as adaptation needs"
    )
    widths: tuple[Channels, ...] = Field((16, 32, 64), description="of the 3D stages; each but the first halves")
    depths: tuple[Depth, ...] = Field((1, 1, 2), description="further convolutions of each block")
    pyramid_widths: tuple[Channels, ...] = Field((96, 96, 128, 128), description="of the map's levels; each halves")
    pyramid_depth: Depth = Field(1, description="further sparse convolutions at each step back up")
    vote_threshold: float = Field(0.3, ge=0, le=1, description="cells with a foreground score above this vote")
    vote_least: int = Field(16, ge=0, description="so many best cells of a frame vote in any case")
    vote_ring: int = Field(1, ge=0, le=8, description="cells around a voted one that become occupied")
    vote_reach_m: float = Field(10.0, gt=0, description="longest vote along x and along y")
    head_depth: Depth = Field(1, description="residual blocks after the diffusion")

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of the points that the network reads."""
        return (*POSITION, *["intensity"] * self.use_intensity, *["lag_s"] * self.use_lag)

    @property
    def reach_m(self) -> float:
        """How far ahead the detector looks, metres."""
        return self.grid.range_m

    @property
    def map_stride(self) -> int:
        """Voxels along the edge of a cell of the map."""
        return int(2 ** (len(self.widths) - 1))

    @property
    def multiple(self) -> int:
        """The coarsest stride, in voxels."""
        return int(self.map_stride * 2 ** (len(self.pyramid_widths) - 1))

    @model_validator(mode="after")
    def _strides_fit(self) -> "SparseCentreConfig":
        layers = self.grid.shape(self.multiple)[0]
        if not 1 <= len(self.widths) == len(self.depths) <= 5 or not 1 <= len(self.pyramid_widths) <= 6:
            raise ValueError("expected 1 to 5 widths, as many depths, and 1 to 6 pyramid_widths")
        if layers % self.map_stride:
            raise ValueError(f"expected voxel layers that {self.map_stride} divides, got {layers}: set extra_layers")
        if self.grid.cell_m[0] != self.grid.cell_m[1]:
            raise ValueError(f"expected voxels as long as wide, got {self.grid.cell_m}")
        return self


class SparseCentre(MapDetector):
    """The network: its outputs are the centre head's, for occupied cells."""

    work: ClassVar[Literal["dense", "rows"]] = "rows"
    low_precision: ClassVar[tuple[str, ...]] = ("encoder", "to_map", "pyramid", "diffusion", "refine", "head")

    def __init__(self, config: SparseCentreConfig | None = None) -> None:
        config = config or SparseCentreConfig()
        super().__init__(config)
        self.inputs = {"points": CloudInput(columns=config.columns)}
        self.features = (*mean_features(config.positions), *config.columns[len(POSITION) :])
        width = config.pyramid_widths[0]
        self.encoder = VoxelEncoder(len(self.features), config.widths, config.depths)
        self.to_map = normalised(SubmanifoldConv(config.widths[-1], width, (1, 1, 1)), width)
        self.pyramid = SparsePyramid(config.pyramid_widths, config.pyramid_depth)
        cell_m = config.grid.cell_m[0] * config.map_stride
        self.diffusion = CentreDiffusion(
            width,
            threshold=config.vote_threshold,
            least=config.vote_least,
            ring=config.vote_ring,
            reach_cells=config.vote_reach_m / cell_m,
        )
        self.refine = nn.Sequential(*[ResidualBlock(width, FLAT) for _ in range(config.head_depth)])
        _, nx, ny = config.grid.shape(config.multiple)
        shape, y_min_m = (nx // config.map_stride, ny // config.map_stride), config.grid.y_min_m(config.multiple)
        self.head = CentreHead(config, width, shape=shape, cell_m=cell_m, y_min_m=y_min_m)
        self.assigner, self.channels = self.head.assigner, width

    def input_columns(self) -> InputColumns:
        """What the first convolution reads of a voxel."""
        return {"encoder.0.conv.weight": (1, self.features)}

    def encode(self, batch: Mapping[str, list[Tensor]]) -> FeatureMap:
        """Voxels, sparse encoder, pyramid, diffusion and refinement; ``aux`` holds votes and heights for the head."""
        config = self.config
        read = {"columns": config.columns, "positions": config.positions}
        voxels = mean_voxels(batch["points"], config.grid, config.multiple, **read)
        flat = merge_heights(self.to_map(self.encoder(voxels.replace(in_type_of(self.encoder, voxels.features)))))
        flat = self.pyramid(flat)
        diffused = self.diffusion(flat, self._heights_m(voxels, flat.keys))
        refined = self.refine(diffused.sparse)
        return FeatureMap(
            values=refined,
            cell_m=self.head.cell_m,
            origin_m=(0.0, self.head.y_min_m),
            aux={"votes": flat.replace(diffused.votes), "height_m": refined.replace(diffused.height_m[:, None])},
        )

    def _heights_m(self, voxels: SparseTensor, keys: Tensor) -> Tensor:
        """Mean height of the points' voxels in each cell of the map, shape (n,)."""
        grid = self.config.grid
        height = voxels.features[:, mean_features(self.config.positions).index("z")]
        height_m = height * max(abs(grid.z_min_m), abs(grid.z_max_m))
        cell = torch.searchsorted(keys, flat_keys(voxels, self.config.map_stride))
        return means_at(height_m, cell, len(keys))[0]

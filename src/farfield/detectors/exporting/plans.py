"""Which reading and which graph a trained network is exported as."""

from typing import Any

from torch import nn

from farfield.detectors.exporting.graphs import (
    Graph,
    PillarGraph,
    RadarCellGraph,
    RadarMapGraph,
    SecondGraph,
    VoxelNetGraph,
)
from farfield.detectors.exporting.points import PointGraph
from farfield.detectors.exporting.sparse_centre import SparseCentreGraph
from farfield.detectors.kradar.rtn import RTN
from farfield.detectors.kradar.rtnh import RTNH
from farfield.detectors.network import Network
from farfield.detectors.onnx.cells import Triple, strided_shape
from farfield.detectors.onnx.points import Bands, PointLevel, PointReading
from farfield.detectors.onnx.readings import (
    PillarReading,
    RadarCellReading,
    RadarMapReading,
    Reading,
    SecondReading,
    SparseLevel,
    VoxelNetReading,
)
from farfield.detectors.onnx.sparse_centre import SparseCentreReading
from farfield.detectors.pointpillars.network import PointPillars
from farfield.detectors.pointrcnn.network import PointRCNN
from farfield.detectors.second.network import Second
from farfield.detectors.sparse import SparseBlock, SparseConv
from farfield.detectors.sparsecentre.network import SparseCentre
from farfield.detectors.voxelnet.network import VoxelNet
from farfield.errors import ConfigError

BOUNDARIES = {
    "pointpillars": "numpy: pillars and the description of each point. ONNX: point features, map, backbone, head, "
    "boxes.",
    "second": "numpy: mean voxels and tables of neighbours. ONNX: sparse layers as products by table, dense map, "
    "backbone, head, boxes.",
    "voxelnet": "numpy: points by voxel and tables of neighbours. ONNX: voxel features, middle layers as products by "
    "table, dense map, backbone, head, boxes.",
    "rtn": "numpy: mean values of the radar's cells. ONNX: map, trunk, neck, head, boxes.",
    "rtnh": "numpy: occupied cells and tables of neighbours. ONNX: cell features, sparse stages as products by table, "
    "dense maps, neck, head, boxes.",
    "sparsecentre": "numpy: mean voxels, tables of neighbours, the cells that votes add between the halves. ONNX: "
    "sparse layers as products by table, votes, heat and boxes at occupied cells.",
    "pointrcnn": "numpy: chosen points, neighbourhoods, proposals between the stages. ONNX: both stages' layers, "
    "boxes.",
}
"""What runs where, by detector; suppression is numpy's everywhere."""


def plan_of(network: Network) -> tuple[Reading, Graph]:
    """How a network in evaluation mode, its normalisation folded, is exported.

    Args:
        network: One of ours.

    Raises:
        ConfigError: If there is no plan for its kind.
    """
    for kind, plan in _PLANS.items():
        if isinstance(network, kind):
            reading, graph = plan(network)
            return reading, graph.eval()
    raise ConfigError(
        f"{network.config.name}: expected one of {', '.join(sorted(BOUNDARIES))} to export; other packages' detectors "
        "have no export yet."
    )


def _pillars(network: PointPillars) -> tuple[Reading, Graph]:
    config = network.config
    multiple = 1
    for stride in config.strides:
        multiple *= stride
    reading = PillarReading(
        columns=config.columns,
        grid=config.grid,
        multiple=multiple,
        features=config.features,
        max_points=config.max_points if config.features == "openpcdet" else 0,
        positions=config.positions,
    )
    return reading, PillarGraph(network)


def _levels(blocks: Any) -> tuple[SparseLevel, ...]:
    """The strided convolutions among blocks, and whether others follow them."""
    levels: list[SparseLevel] = []
    for layer in blocks:
        conv = layer.conv if isinstance(layer, SparseBlock) else None
        if isinstance(conv, SparseConv):
            levels.append(SparseLevel(kernel=conv.kernel, stride=conv.stride, padding=conv.padding, followed=False))
        elif levels:
            levels[-1] = levels[-1].model_copy(update={"followed": True})
    return tuple(levels)


def _shapes(shape: Triple, levels: tuple[SparseLevel, ...]) -> list[Triple]:
    """The grid, and that after each level."""
    shapes = [shape]
    for level in levels:
        shapes.append(strided_shape(shapes[-1], level.kernel, level.stride, level.padding))
    return shapes


def _second(network: Second) -> tuple[Reading, Graph]:
    config, levels = network.config, _levels(network.middle)
    reading = SecondReading(
        columns=config.columns,
        grid=config.grid,
        multiple=network.multiple,
        features=config.features,
        positions=config.positions,
        max_points=config.max_points,
        levels=levels,
    )
    return reading, SecondGraph(network, _shapes(reading.shape, levels)[-1])


def _voxelnet(network: VoxelNet) -> tuple[Reading, Graph]:
    config, layers = network.config, network.middle.layers
    levels = _levels([SparseBlock(layer.conv, nn.Identity()) for layer in layers])  # type: ignore[arg-type]
    margin = 2 * len(layers) + 1
    reading = VoxelNetReading(
        columns=config.columns,
        grid=config.grid,
        multiple=network.encoder.multiple,
        positions=config.positions,
        max_points=config.max_points,
        levels=levels,
        margin=margin,
    )
    return reading, VoxelNetGraph(network, _shapes(reading.shape, levels), margin)


def _rtn(network: RTN) -> tuple[Reading, Graph]:
    config = network.config
    reading = RadarMapReading(
        columns=config.columns,
        grid=_plain(config.grid),
        multiple=network.multiple,
        low_m=config.low_m,
        log_power=config.power == "log",
    )
    return reading, RadarMapGraph(network)


def _rtnh(network: RTNH) -> tuple[Reading, Graph]:
    config, encoder = network.config, network.encoder
    stages = [layer for stage, _ in network.backbone._branches() for layer in stage]
    levels = _levels(stages)
    reading = RadarCellReading(
        columns=config.columns,
        grid=_plain(config.grid),
        multiple=encoder.multiple,
        low_m=encoder.low_m,
        log_power=encoder.log_power,
        max_points=encoder.max_points,
        unit_positions=encoder.unit_positions,
        levels=levels,
    )
    return reading, RadarCellGraph(network, _shapes(reading.shape, levels)[1:])


def _plain(grid: Any) -> Any:
    """A grid's settings as those of any voxel grid."""
    return grid.model_dump()


def _sparsecentre(network: SparseCentre) -> tuple[Reading, Graph]:
    config, levels = network.config, _levels(network.encoder)
    cell_m = config.grid.cell_m[0] * config.map_stride
    reading = SparseCentreReading(
        columns=config.columns,
        grid=config.grid,
        multiple=config.multiple,
        positions=config.positions,
        levels=levels,
        pyramid=len(config.pyramid_widths),
        map_stride=config.map_stride,
        height_scale_m=max(abs(config.grid.z_min_m), abs(config.grid.z_max_m)),
        vote_threshold=config.vote_threshold,
        vote_least=config.vote_least,
        vote_ring=config.vote_ring,
        reach_cells=config.vote_reach_m / cell_m,
        peak_cells=config.peak_cells,
        candidates=config.candidates,
    )
    return reading, SparseCentreGraph(network)


def _pointrcnn(network: PointRCNN) -> tuple[Reading, Graph]:
    config, proposals, refinement = network.config, network.config.proposals, network.config.refinement
    reading = PointReading(
        columns=config.columns,
        range_m=config.grid.range_m,
        half_width_m=config.grid.half_width_m,
        z_min_m=config.grid.z_min_m,
        z_max_m=config.grid.z_max_m,
        read=config.inputs,
        points=config.points,
        bands=Bands(**config.bands.model_dump()),
        sampling=config.backbone.sampling,
        levels=tuple(map(_point_level, config.backbone.levels)),
        candidates=proposals.candidates,
        threshold=proposals.threshold,
        proposal_iou=proposals.nms_iou,
        proposals=proposals.count,
        proposal_bands=Bands(**proposals.bands.model_dump()),
        context_m=refinement.context_m,
        roi_points=refinement.points,
        roi_levels=tuple(map(_point_level, refinement.levels)),
    )
    return reading, PointGraph(network)


def _point_level(level: Any) -> PointLevel:
    return PointLevel(centres=level.centres, radii_m=level.radii_m, limits=level.limits)


_PLANS: dict[type, Any] = {
    PointPillars: _pillars,
    Second: _second,
    VoxelNet: _voxelnet,
    RTN: _rtn,
    RTNH: _rtnh,
    SparseCentre: _sparsecentre,
    PointRCNN: _pointrcnn,
}

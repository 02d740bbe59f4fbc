"""What the exported fully sparse detector asks between its two halves: where cells vote that a centre is."""

from itertools import product
from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Float32
from pydantic import Field

from farfield.detectors.onnx.cells import Triple, in_float32, means_by_group, neighbour_table, rows_among, split_keys
from farfield.detectors.onnx.cells import strided_table as strided
from farfield.detectors.onnx.readings import (
    DecodedBoxes,
    Positions,
    Run,
    SparseLevel,
    Tensors,
    VoxelReading,
    described,
    level_tables,
)

_FLAT: Triple = (1, 3, 3)
_PAIR: Triple = (1, 2, 2)
_CUBE: Triple = (3, 3, 3)


class SparseCentreReading(VoxelReading):
    """Points to mean voxels, the tables of the encoder and its pyramid, and the map that votes have grown."""

    kind: Literal["sparsecentre"] = "sparsecentre"
    positions: Positions
    levels: tuple[SparseLevel, ...] = Field(max_length=8)
    pyramid: int = Field(ge=1, le=8)
    map_stride: int = Field(ge=1, le=1024)
    height_scale_m: float = Field(gt=0)
    vote_threshold: float = Field(ge=0, le=1)
    vote_least: int = Field(ge=0, le=100_000)
    vote_ring: int = Field(ge=0, le=8)
    reach_cells: float = Field(gt=0)
    peak_cells: int = Field(ge=1, le=8)
    candidates: int = Field(ge=1, le=1_000_000)

    @property
    def map_shape(self) -> Triple:
        """The bird's-eye map, a grid of depth 1."""
        _, nx, ny = self.shape
        return 1, nx // self.map_stride, ny // self.map_stride

    def inputs(self, points: Float32[np.ndarray, "n c"]) -> dict[str, np.ndarray]:
        """``voxels``, tables of the encoder, ``heights`` of each column, tables of the pyramid's levels."""
        keys, features = self.mean_voxels(points, published=False, positions=self.positions, max_points=0)
        tables, cells = level_tables(keys, self.shape, self.levels)
        last, shape = cells[-1] if cells else (keys, self.shape)
        around = neighbour_table(keys, keys, self.shape, _CUBE)
        # The cells above one another, summed to a map.
        columns, member = np.unique(last % (shape[1] * shape[2]), return_inverse=True)
        heights = np.full((len(columns), shape[0]), len(last), dtype=np.int64)
        heights[member, last // (shape[1] * shape[2])] = np.arange(len(last))
        # The pyramid, each level of half the resolution.
        flat, at = columns, self.map_shape
        for level in range(self.pyramid):
            if level:
                finer, fine_shape = flat, at
                flat, at, tables[f"down_{level}"] = strided(finer, fine_shape, _PAIR, _PAIR, (0, 0, 0))
                _, ix, iy = split_keys(finer, fine_shape)
                parent = rows_among(flat, (ix // 2) * at[2] + iy // 2)
                tables[f"up_{level}"] = parent * 4 + (ix % 2) * 2 + iy % 2
            tables[f"flat_{level}"] = neighbour_table(flat, flat, at, _FLAT)
        return {"voxels": in_float32(features), "around_0": around, **tables, "heights": heights}

    results: ClassVar[tuple[str, ...]] = ("map_out", "votes", "boxes", "heat")

    def blank(self) -> dict[str, tuple[str, tuple[int | None, ...]]]:
        """Number type and sides of the inputs of both halves."""
        none = np.zeros((0, len(self.columns)), dtype=np.float32)
        votes = {"votes": np.zeros((0, 3), dtype=np.float32), "map_out": np.zeros((0, 1), dtype=np.float32)}
        return described({**self.inputs(none), **self.grown(none, votes)}, open_sides=("map",))

    def detect(self, points: Float32[np.ndarray, "n c"], run: Run, first: Tensors | None = None) -> DecodedBoxes:
        """Ask for votes, grow the map, ask for boxes."""
        votes = run(self.inputs(points) if first is None else first)
        return self.candidates_of(run(self.grown(points, votes)))

    def candidates_of(self, outputs: Tensors) -> DecodedBoxes:
        """The best peaks, best first."""
        heat = outputs["heat"].astype(np.float64)
        row, kind = np.nonzero(~(heat <= 0))  # NaN stays
        best = np.argsort(-heat[row, kind], kind="stable")[: self.candidates]
        row, kind = row[best], kind[best]
        return DecodedBoxes(outputs["boxes"][row].astype(np.float64), heat[row, kind], kind)

    def grown(self, points: Float32[np.ndarray, "n c"], outputs: Tensors) -> dict[str, np.ndarray]:
        """What the second half reads: the map with the cells that votes add, and the reference height of each."""
        located, key = self.located(points)
        keys, member = np.unique(key, return_inverse=True)
        centre = self.centres_m(keys)
        offset = means_by_group((located[:, :3] - centre[member])[:, 2:], member, len(keys))[:, 0].astype(np.float32)
        voxel_m = (centre[:, 2] + offset) / np.float32(self.height_scale_m) * np.float32(self.height_scale_m)
        shape, (_, nx, ny) = self.shape, self.map_shape
        _, ix, iy = split_keys(keys, shape)
        columns, cell = np.unique((ix // self.map_stride) * ny + iy // self.map_stride, return_inverse=True)
        height_m = means_by_group(voxel_m[:, None], cell, len(columns))[:, 0].astype(np.float32)
        # Cells that vote, and the cells they vote for.
        votes = outputs["votes"]
        score = 1 / (1 + np.exp(-votes[:, 0].astype(np.float64)))
        steps = np.clip(votes[:, 1:], -np.float32(self.reach_cells), np.float32(self.reach_cells))
        chosen = score > self.vote_threshold
        chosen[np.argsort(-score, kind="stable")[: self.vote_least]] = True
        at = np.stack(np.divmod(columns, ny), 1).astype(np.float32) + np.float32(0.5) + steps
        target = np.floor(at).astype(np.int64)
        rows = np.flatnonzero(((target >= 0) & (target < [nx, ny])).all(1) & chosen)
        voted, rest = target[rows, 0] * ny + target[rows, 1], at[rows] - target[rows] - np.float32(0.5)
        grown, ring = [columns, voted], range(-self.vote_ring, self.vote_ring + 1)
        for dx, dy in product(ring, ring):
            to = target[rows] + [dx, dy]
            to = to[((to >= 0) & (to < [nx, ny])).all(1)]
            grown.append(to[:, 0] * ny + to[:, 1])
        cells = np.unique(np.concatenate(grown))
        landed = np.searchsorted(cells, voted)
        share = score[rows] / np.maximum(np.bincount(landed, minlength=len(cells)), 1)[landed]
        side = 2 * self.peak_cells + 1
        return {
            "map": outputs["map_out"],
            "carrier": rows,
            "rest": in_float32(rest),
            "share": in_float32(share),
            "landed": landed,
            "stayed": rows_among(columns, cells),
            "around": neighbour_table(cells, cells, self.map_shape, _FLAT),
            "peak": neighbour_table(cells, cells, self.map_shape, (1, side, side)),
            "height_m": in_float32(self._heights_m(cells, columns, height_m, landed, height_m[rows])),
            "place_m": in_float32(self._places_m(cells)),
        }

    def _heights_m(
        self, cells: np.ndarray, columns: np.ndarray, height_m: np.ndarray, landed: np.ndarray, voted_m: np.ndarray
    ) -> np.ndarray:
        """Heights of cells: their own, those of their votes, or the mean of their neighbours'."""
        count = np.bincount(landed, minlength=len(cells))
        heights = np.bincount(landed, weights=voted_m.astype(np.float64), minlength=len(cells)) / np.maximum(count, 1)
        heights, there = heights.astype(np.float32), count > 0
        stayed = np.searchsorted(cells, columns)
        heights[stayed], there[stayed] = height_m, True
        side = 2 * self.vote_ring + 1
        table = neighbour_table(cells, cells[~there], self.map_shape, (1, side, side))
        weight = np.append(there, False).astype(np.float32)[table]
        around = np.append(heights, np.float32(0.0))[table]
        heights[~there] = (around * weight).sum(1) / np.maximum(weight.sum(1), 1)
        return heights

    def _places_m(self, cells: np.ndarray) -> np.ndarray:
        cell_m, y_min_m = self.grid.cell_m[0] * self.map_stride, self.grid.y_min_m(self.multiple)
        ix, iy = np.divmod(cells, self.map_shape[2])
        return np.stack([(ix + 0.5) * cell_m, (iy + 0.5) * cell_m + y_min_m], 1)

"""Which cells are occupied around a cell: binary search in sorted keys."""

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from farfield.detectors.blocks.sparse.tensor import Triple, decode_keys


def neighbour_table(keys: Tensor, query_keys: Tensor, shape: Triple, offsets: Sequence[Triple]) -> Tensor:
    """Find the neighbours of cells.

    Args:
        keys: Occupied cells, shape (n,), int64, ascending, each once.
        query_keys: Cells whose neighbours are wanted, shape (m,), int64, on the same grid.
        shape: Cells along z, x and y.
        offsets: Steps (dz, dx, dy) to the K neighbours.

    Returns:
        Row in ``keys`` of each neighbour, ``n`` where it is not occupied or outside the grid, shape (m, K), int32: so
        features with one row appended can be indexed as they are.
    """
    columns = list(neighbour_columns(keys, query_keys, shape, offsets))
    return torch.stack(columns, 1) if columns else keys.new_zeros(len(query_keys), 0, dtype=torch.int32)


def neighbour_columns(keys: Tensor, query_keys: Tensor, shape: Triple, offsets: Sequence[Triple]) -> Iterator[Tensor]:
    """The columns of :func:`neighbour_table`, one after the other.

    Offsets that step along y share one search, since their cells lie side by side in the sorted keys.
    """
    depth, nx, ny = shape
    none, same_cells = len(keys), keys is query_keys
    _, iz, ix, iy = decode_keys(query_keys, shape).unbind(1)
    keys, query_keys = _narrow(keys, query_keys)
    ended = torch.cat([keys, keys.new_full((1,), -1)])
    previous: Triple | None = None
    wanted = position = hit = in_plane = query_keys
    for dz, dx, dy in offsets:
        if previous == (dz, dx, dy - 1):
            wanted, position = wanted + 1, position + hit
        else:
            wanted = query_keys + ((dz * nx + dx) * ny + dy)
            if same_cells and (dz, dx, dy) == (0, 0, -1):
                position = _lower_neighbour(keys)
            else:
                position = torch.searchsorted(keys, wanted, out_int32=True)
            in_plane = _within(iz, dz, depth) & _within(ix, dx, nx)
        hit = ended.index_select(0, position) == wanted
        yield torch.where(hit & in_plane & _within(iy, dy, ny), position, none)
        previous = (dz, dx, dy)


def _lower_neighbour(keys: Tensor) -> Tensor:
    """First row whose key is not below one's own less one: the row before if its key is that, else one's own."""
    position = torch.arange(len(keys), dtype=torch.int32, device=keys.device)
    position[1:] -= (keys[1:] - keys[:-1] == 1).int()
    return position


def dilate(keys: Tensor, shape: Triple, offsets: Sequence[Triple]) -> Tensor:
    """Grow a set of cells.

    Args:
        keys: Cells, shape (n,), int64.
        shape: Cells along z, x and y.
        offsets: Steps (dz, dx, dy) from each cell to the cells to add; steps out of the grid add nothing.

    Returns:
        The cells and all added ones, ascending, each once, shape (m,), int64.
    """
    depth, nx, ny = shape
    _, iz, ix, iy = decode_keys(keys, shape).unbind(1)
    grown = [keys]
    for dz, dx, dy in offsets:
        inside = _within(iz, dz, depth) & _within(ix, dx, nx) & _within(iy, dy, ny)
        grown.append((keys + ((dz * nx + dx) * ny + dy))[inside])
    return torch.unique(torch.cat(grown))


def _within(index: Tensor, step: int, size: int) -> Tensor:
    return index < size - step if step >= 0 else index >= -step


def _narrow(*keys: Tensor) -> list[Tensor]:
    """The same ascending numbers as int32 where all are small enough to step anywhere on the grid and stay so."""
    fits = all(len(each) == 0 or int(each[-1]) < 2**30 for each in keys)
    return [each.int() if fits else each for each in keys]

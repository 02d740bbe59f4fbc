"""Neighbour tables cut into blocks of similar rows: a block skips the kernel elements that none of its rows has.

On a LiDAR scan a cell has 4 to 10 of its 27 neighbours. Sorted by which they have, the rows of one block share most of
them: half of the products with zero go, and the gathered rows stay in the cache.
"""

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

_KEY_BITS = 62


class Block(NamedTuple):
    """Some rows of a neighbour table.

    Attributes:
        rows: Which rows, shape (r,), int64; ``None`` for all, in order.
        columns: Kernel elements that occur, shape (k,), int64; ``None`` for all.
        sources: Input row under each of these elements, shape (r, k), int32.
    """

    rows: Tensor | None
    columns: Tensor | None
    sources: Tensor


class BlockTable:
    """A neighbour table in an order that puts similar rows together.

    Args:
        table: Row of the input cell under each kernel element, ``none`` for none, shape (n, K), int32.
        none: The number that marks an empty place.

    Attributes:
        order: Row of the given table that each row of this one was, shape (n,), int64.
        table: The rows in that order, shape (n, K), int32.
    """

    def __init__(self, table: Tensor, none: int) -> None:
        self._none = none
        self.order = _similar_first(table, none)
        self.table = table.index_select(0, self.order)
        self._blocks: dict[int, list[Block]] = {}

    def blocks(self, rows: int) -> list[Block]:
        """Blocks of ``rows`` rows; the last may be shorter. Found once for each length."""
        if rows not in self._blocks:
            self._blocks[rows] = [self._block(start, rows, used) for start, used in self._used_columns(rows)]
        return self._blocks[rows]

    def _block(self, start: int, rows: int, used: list[bool]) -> Block:
        part, order = self.table[start : start + rows], self.order[start : start + rows]
        if all(used):
            return Block(order, None, part)
        numbers = [number for number, any_row in enumerate(used) if any_row]
        columns = torch.tensor(numbers, dtype=torch.int64, device=part.device)
        return Block(order, columns, part.index_select(1, columns))

    def _used_columns(self, rows: int) -> Iterator[tuple[int, list[bool]]]:
        """First row of each block, and whether any of its rows has each neighbour."""
        count, size = self.table.shape
        whole = count // rows * rows
        least = self.table[:whole].view(-1, rows, size).amin(1)
        if whole < count:
            least = torch.cat([least, self.table[whole:].amin(0, keepdim=True)])
        return zip(range(0, count, rows), (least < self._none).tolist(), strict=True)


def _similar_first(table: Tensor, none: int) -> Tensor:
    """Order of rows by the set of their neighbours, the rarest neighbour counting most."""
    occupied = table.t().contiguous() < none
    rarest_first = occupied.sum(1).argsort(stable=True)[:_KEY_BITS].tolist()
    key = torch.zeros(len(table), dtype=torch.int32 if len(rarest_first) < 31 else torch.int64, device=table.device)
    for number in rarest_first:
        key = (key << 1) + occupied[number]
    return torch.sort(key, stable=True).indices

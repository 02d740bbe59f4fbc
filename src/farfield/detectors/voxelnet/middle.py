"""VoxelNet's convolutional middle layers (Zhou and Tuzel, CVPR 2018, section 2.1.2), dense and sparse.

After batch normalisation and ReLU an empty cell no longer holds zero, so a dense network's maps are full everywhere and
plain sparse convolution is another function. Far from every point, though, a cell's value depends on nothing but its
height and, within a few cells, on its distance from the borders. The sparse layers therefore keep each map as this
background, on a small grid that stands for the whole one, plus differences from it at the cells that a point reaches.
Convolution is linear, so it maps background to background and differences to differences, and the result is the dense
one up to rounding with the same weights: in evaluation, in training (the statistics count the empty cells), and in its
gradients.
"""

from typing import Any, Literal, NamedTuple, cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from farfield.detectors.layers import affine
from farfield.detectors.losses import process_count, sum_over_processes
from farfield.detectors.sparse import SparseConv, SparseTensor, sparse_conv
from farfield.detectors.sparse.cells import Triple, decode_keys

_KERNEL: Triple = (3, 3, 3)
_STEPS: tuple[tuple[Triple, Triple], ...] = (((2, 1, 1), (1, 1, 1)), ((1, 1, 1), (0, 1, 1)), ((2, 1, 1), (1, 1, 1)))
_BLOCK_ROWS = 8192


def middle_depths(depth: int) -> list[int]:
    """Layers of cells in z after each of the three convolutions: 10 gives 5, 3, 2; none left gives 0 or less."""
    depths = []
    for stride, padding in _STEPS:
        depth = (depth + 2 * padding[0] - 3) // stride[0] + 1
        depths.append(depth)
    return depths


class Field(NamedTuple):
    """A map of all cells as background plus differences.

    Attributes:
        difference: What the reached cells hold beyond the background, features (n, c).
        background: Value far from every point, shape (D, sx, sy, c), on the small grid of :func:`border_cells`.
    """

    difference: SparseTensor
    background: Tensor


def border_cells(size: int, small: int, device: torch.device | None = None) -> Tensor:
    """Cell of a small axis that stands for each cell of a long one, shape (size,), int64.

    Both ends are kept cell by cell; the middle cell stands for all between.
    """
    margin = small // 2
    cell = torch.arange(size, device=device)
    from_end = cell - size + small
    return torch.where(cell < margin, cell, torch.where(from_end >= small - margin, from_end, margin))


class MiddleLayer(nn.Module):
    """3 x 3 x 3 convolution, batch normalisation and ReLU, applied to a dense map or to a :class:`Field`.

    Args:
        c_in: Input channels.
        c_out: Output channels.
        stride: Step along z, x and y.
        padding: Cells of zeros added on both sides along z, x and y.
    """

    def __init__(self, c_in: int, c_out: int, stride: Triple, padding: Triple) -> None:
        super().__init__()
        self.conv = SparseConv(c_in, c_out, _KERNEL, stride, padding)
        self.norm: nn.Module = nn.BatchNorm3d(c_out, eps=1e-3, momentum=0.1)

    def dense(self, volume: Tensor) -> Tensor:
        """Map (b, c_in, D, nx, ny) to (b, c_out, D', nx, ny)."""
        volume = self._conv3d(volume)
        # In channels-last memory PyTorch sums batch statistics in float32 one by one: 3e-4 off at 30,000 cells.
        return torch.relu_(self.norm(volume.contiguous() if self.training else volume))

    def forward(self, field: Field) -> Field:
        """The same, cell by cell, where it differs from the background."""
        conv, sparse = self.conv, field.difference
        book = conv.rulebook(sparse)
        device = sparse.features.device.type
        dtype = torch.get_autocast_dtype(device) if torch.is_autocast_enabled(device) else conv.weight.dtype
        values = sparse_conv(sparse.features.to(dtype), conv.weight.to(dtype), book)
        with torch.autocast(device, enabled=False):
            ground = self._ground(field.background)
            ground_cell, share = _places(book.keys, book.shape, sparse.batch_size, ground.shape[:3])
            features, background = self._normalised(values, ground.flatten(0, 2), ground_cell, share)
        difference = SparseTensor(features, book.keys, book.shape, sparse.batch_size, sparse.rulebooks)
        return Field(difference, background.view(ground.shape))

    @torch.no_grad()
    def fold_norm(self) -> None:
        """Move the normalisation of evaluation mode into the convolution, in place."""
        if isinstance(self.norm, nn.BatchNorm3d):
            scale, shift = affine(self.norm)
            self.conv.weight.mul_(scale)
            self.conv.bias = nn.Parameter(shift.clone())
            self.norm = nn.Identity()

    def _conv3d(self, volume: Tensor) -> Tensor:
        conv = self.conv
        weight = conv.weight.view(*_KERNEL, conv.c_in, conv.c_out).permute(4, 3, 0, 1, 2)
        bias = None if conv.bias is None else conv.bias.to(volume.dtype)
        return functional.conv3d(volume, weight.to(volume.dtype), bias, conv.stride, conv.padding)

    def _ground(self, background: Tensor) -> Tensor:
        """Convolve the background, in float32, without the bias."""
        conv = self.conv
        weight = conv.weight.float().view(*_KERNEL, conv.c_in, conv.c_out).permute(4, 3, 0, 1, 2)
        volume = background.float().permute(3, 0, 1, 2)[None]
        return functional.conv3d(volume, weight, None, conv.stride, conv.padding)[0].permute(1, 2, 3, 0)

    def _normalised(self, values: Tensor, ground: Tensor, ground_cell: Tensor, share: Tensor) -> tuple[Tensor, Tensor]:
        norm, bias = self.norm, self.conv.bias
        if not isinstance(norm, nn.BatchNorm3d):
            one = torch.ones(ground.shape[1], device=ground.device)
            shift = torch.zeros_like(one) if bias is None else bias.float()
            return _shifted_relu(values, ground, ground_cell, one, shift)
        if not norm.training:
            return _shifted_relu(values, ground, ground_cell, *affine(norm))
        out: tuple[Tensor, ...] = _NormRelu.apply(values, ground, norm.weight, norm.bias, ground_cell, share, norm.eps)
        _update(norm, out[2], out[3], process_count() * (len(ground_cell) + float(share.sum())))
        return out[0], out[1]


class MiddleLayers(nn.Module):
    """Three layers that halve the height twice: voxels (b, 10 layers) to an image with two layers' channels.

    Args:
        c_in: Channels of a voxel.
        widths: Channels of each layer.
        depth: Cells along z.
        mode: ``"sparse"`` computes only what a point reaches; ``"dense"`` every cell, as published. The weights and the
            function are the same.

    Raises:
        ValueError: If ``depth`` leaves no cell.
    """

    def __init__(
        self, c_in: int, widths: tuple[int, int, int], depth: int, mode: Literal["dense", "sparse"] = "sparse"
    ) -> None:
        super().__init__()
        depths = middle_depths(depth)
        if min(depths) < 1:
            raise ValueError(f"Expected at least 5 layers of voxels in z; got {depth}.")
        self.mode = mode
        self.layers = nn.ModuleList()
        for c_out, (stride, padding) in zip(widths, _STEPS, strict=True):
            self.layers.append(MiddleLayer(c_in, c_out, stride, padding))
            c_in = c_out
        self.channels = c_in * depths[-1]

    def forward(self, voxels: SparseTensor) -> Tensor:
        """Run the layers.

        Args:
            voxels: Occupied voxels with their features.

        Returns:
            Image (b, channels, nx, ny) in channels_last memory, the lowest layer's channels first.
        """
        return self._dense(voxels) if self.mode == "dense" else self._sparse(voxels)

    def _dense(self, voxels: SparseTensor) -> Tensor:
        volume = voxels.dense().to(next(self.parameters()).dtype)
        for layer in self.layers:
            volume = cast(MiddleLayer, layer).dense(volume)
        image = volume.transpose(1, 2).flatten(1, 2)
        return image.contiguous(memory_format=torch.channels_last)

    def _sparse(self, voxels: SparseTensor) -> Tensor:
        margin = 2 * len(self.layers) + 1
        depth, nx, ny = voxels.shape
        small = (depth, min(nx, margin), min(ny, margin), voxels.features.shape[1])
        field = Field(voxels, voxels.features.new_zeros(small))
        for layer in self.layers:
            field = layer(field)
        return _image(field)


def _image(field: Field) -> Tensor:
    """Background everywhere, plus the differences: (b, D * c, nx, ny) in channels_last memory."""
    sparse, background = field
    depth, nx, ny = sparse.shape
    sx, sy, channels = background.shape[1:]
    features, device = sparse.features, sparse.features.device
    rows = background.to(features.dtype).permute(1, 2, 0, 3).reshape(sx, sy, depth * channels)
    column, row = border_cells(nx, sx, device), border_cells(ny, sy, device)
    b, iz, ix, iy = sparse.indices().unbind(1)
    cell = ((b * nx + ix) * ny + iy) * depth + iz
    image: Tensor = _Spread.apply(rows, column, row, sparse.batch_size, features, cell)
    return image.permute(0, 3, 1, 2)


class _Spread(torch.autograd.Function):
    """Copy a small map (sx, sy, k) to all cells that it stands for, (b, nx, ny, k), and add rows (n, c) at places."""

    @staticmethod
    def forward(
        ctx: Any, rows: Tensor, column: Tensor, row: Tensor, batch_size: int, features: Tensor, cell: Tensor
    ) -> Tensor:
        ctx.save_for_backward(column, row, cell)
        ctx.small, ctx.channels = rows.shape, features.shape[1]
        image = rows.index_select(0, column).index_select(1, row)[None]
        image = image if batch_size == 1 else image.repeat(batch_size, 1, 1, 1)
        image.view(-1, ctx.channels).index_add_(0, cell, features)
        return image

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        column, row, cell = ctx.saved_tensors
        sx, sy, width = ctx.small
        gradient = gradients[0].contiguous()
        # Sums of half a million bfloat16 numbers: a matrix product adds them up in float32.
        along_y = functional.one_hot(row, sy).t().to(gradient.dtype)
        sums = (along_y @ gradient.flatten(0, 1)).view(len(gradient), len(column), sy * width).float().sum(0)
        along_x = functional.one_hot(column, sx).t().float()
        to_rows = (along_x @ sums).view(sx, sy, width).to(gradient.dtype)
        return to_rows, None, None, None, gradient.view(-1, ctx.channels).index_select(0, cell), None


def _places(keys: Tensor, shape: Triple, batch_size: int, small: torch.Size) -> tuple[Tensor, Tensor]:
    """Background cell under each reached cell, shape (n,), and how many other cells each one stands for, float64."""
    depth, sx, sy = small
    column, row = border_cells(shape[1], sx, keys.device), border_cells(shape[2], sy, keys.device)
    _, iz, ix, iy = decode_keys(keys, shape).unbind(1)
    ground_cell = (iz * sx + column[ix]) * sy + row[iy]
    cells = torch.outer(column.bincount(minlength=sx), row.bincount(minlength=sy)).flatten()
    share = batch_size * cells.repeat(depth) - ground_cell.bincount(minlength=depth * sx * sy)
    return ground_cell, share.double()


def _shifted_relu(
    values: Tensor, ground: Tensor, ground_cell: Tensor, scale: Tensor, shift: Tensor
) -> tuple[Tensor, Tensor]:
    """Normalise with known statistics, apply ReLU, and split into differences and background again."""
    level = ground * scale + shift
    background = torch.relu(level)
    lifted = torch.addcmul(level.index_select(0, ground_cell), values.float(), scale)
    return (torch.relu(lifted) - background.index_select(0, ground_cell)).to(values.dtype), background


@torch.no_grad()
def _update(norm: nn.BatchNorm3d, mean: Tensor, variance: Tensor, count: float) -> None:
    """Move the running statistics as ``nn.BatchNorm3d`` does."""
    assert norm.running_mean is not None
    assert norm.running_var is not None
    assert norm.num_batches_tracked is not None
    norm.num_batches_tracked += 1
    share = 1 / float(norm.num_batches_tracked) if norm.momentum is None else norm.momentum
    norm.running_mean.lerp_(mean, share)
    norm.running_var.lerp_(variance * (count / max(count - 1, 1)), share)


class _NormRelu(torch.autograd.Function):
    """Batch normalisation over all cells and ReLU, of differences (n, c) on a background (m, c)."""

    @staticmethod
    def forward(
        ctx: Any,
        values: Tensor,
        ground: Tensor,
        weight: Tensor,
        bias: Tensor,
        ground_cell: Tensor,
        share: Tensor,
        eps: float,
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        count = len(ground_cell) + float(share.sum())
        mean, variance, count = _over_processes(*_statistics(values, ground, ground_cell, share, count), count)
        inverse = torch.rsqrt(variance + eps)
        scale = weight * inverse
        level = torch.addcmul(bias, ground - mean, scale)
        background = torch.relu(level)
        differences = torch.empty_like(values)
        for rows in _blocks(len(values)):
            lifted = torch.addcmul(level.index_select(0, ground_cell[rows]), values[rows].float(), scale).relu_()
            differences[rows] = lifted.sub_(background.index_select(0, ground_cell[rows]))
        ctx.save_for_backward(values, ground, weight, ground_cell, share, mean, inverse, level)
        ctx.count = count
        ctx.mark_non_differentiable(mean, variance)
        return differences, background, mean, variance

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        values, ground, weight, ground_cell, share, mean, inverse, level = ctx.saved_tensors
        scale, steady = weight * inverse, (ground - mean) * inverse
        passed, received = torch.empty_like(values, dtype=torch.float32), torch.zeros_like(ground)
        to_weight, to_bias = torch.zeros_like(weight), torch.zeros_like(weight)
        for rows in _blocks(len(values)):
            cell, value, gradient = ground_cell[rows], values[rows].float(), gradients[0][rows].float()
            received.index_add_(0, cell, gradient)
            part = torch.mul(gradient, torch.addcmul(level.index_select(0, cell), value, scale) > 0, out=passed[rows])
            to_bias += part.sum(0)
            to_weight += torch.addcmul(steady.index_select(0, cell), value, inverse).mul_(part).sum(0)
        to_level = (gradients[1] - received) * (level > 0)
        to_bias += to_level.sum(0)
        to_weight += (to_level * steady).sum(0)
        tilt, lift = sum_over_processes(torch.stack([to_weight, to_bias])) / ctx.count
        to_ground = scale * (to_level - share[:, None].float() * (lift + steady * tilt))
        to_values = torch.empty_like(values)
        for rows in _blocks(len(values)):
            cell = ground_cell[rows]
            part = passed[rows].sub_((lift + steady * tilt).index_select(0, cell))
            part.addcmul_(values[rows].float(), -inverse * tilt)
            part.mul_(scale)
            to_ground.index_add_(0, cell, part)
            to_values[rows] = part
        return to_values, to_ground, to_weight, to_bias, None, None, None


def _statistics(
    values: Tensor, ground: Tensor, ground_cell: Tensor, share: Tensor, count: float
) -> tuple[Tensor, Tensor]:
    """Mean and biased variance of ground + values at the reached cells and ground at all others, shape (c,) each."""
    cells = share + ground_cell.bincount(minlength=len(ground))
    pivot = (cells @ ground.double() / count).float()  # sums of small numbers: nearly every cell is near it
    above = ground - pivot
    first = share @ above.double()
    second = share @ above.double().square()
    for rows in _blocks(len(values)):
        part = above.index_select(0, ground_cell[rows]).add_(values[rows])
        first += part.sum(0)
        second += part.square_().sum(0)
    shift = first / count
    return (pivot + shift).float(), (second / count - shift.square()).clamp_(min=0).float()


def _over_processes(mean: Tensor, variance: Tensor, count: float) -> tuple[Tensor, Tensor, float]:
    """Mean, variance and number of the cells of all processes, from those of this one."""
    if process_count() == 1:
        return mean, variance, count
    total = sum_over_processes(mean.new_tensor(count, dtype=torch.float64))
    joined = sum_over_processes(mean.double() * count) / total
    spread = sum_over_processes((variance.double() + (mean.double() - joined).square()) * count) / total
    return joined.float(), spread.float(), float(total)


def _blocks(length: int) -> list[slice]:
    """Slices of rows that stay in the processor's cache."""
    return [slice(start, start + _BLOCK_ROWS) for start in range(0, length, _BLOCK_ROWS)]

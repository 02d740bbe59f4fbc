"""SECOND's sparse backbone by spconv on a GPU, with the weights of sparse_convolution.py."""

from functools import partial
from typing import Any

import spconv.pytorch as spconv
import torch
from sparse_convolution import BACKBONE, SHAPE, weights


def spconv_backbone(dtype: str, device: torch.device) -> Any:
    """A function from features (n, 4) and keys (n,) to the features and keys that the backbone gives.

    Args:
        dtype: "float32", "float16" or "bfloat16".
        device: The GPU.
    """
    layers = []
    for layer, (kernel, bias) in zip(BACKBONE, weights(), strict=True):
        submanifold = layer.stride is None
        kind = spconv.SubMConv3d if submanifold else spconv.SparseConv3d
        conv = kind(
            layer.c_in,
            layer.c_out,
            layer.kernel,
            stride=1 if submanifold else layer.stride,
            padding=layer.padding,
            bias=True,
            indice_key=layer.book,
        )
        ordered = torch.from_numpy(kernel).view(*layer.kernel, layer.c_in, layer.c_out).permute(4, 0, 1, 2, 3)
        with torch.no_grad():
            conv.weight.copy_(ordered)
            conv.bias.copy_(torch.from_numpy(bias))
        layers.append(conv.to(device=device, dtype=getattr(torch, dtype)).eval())
    return partial(_run, layers, getattr(torch, dtype))


def _run(layers: list[Any], dtype: torch.dtype, features: Any, keys: Any) -> tuple[Any, Any]:
    _, nx, ny = SHAPE
    place = torch.stack([keys * 0, keys // (nx * ny), keys // ny % nx, keys % ny], 1)
    sparse = spconv.SparseConvTensor(features.to(dtype), place.int().contiguous(), list(SHAPE), 1)
    for conv in layers:
        sparse = conv(sparse)
        sparse = sparse.replace_feature(sparse.features.relu_())
    place = sparse.indices.long()
    _, nx, ny = sparse.spatial_shape
    return sparse.features, (place[:, 1] * nx + place[:, 2]) * ny + place[:, 3]

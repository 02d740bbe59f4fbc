"""What float32 could still win on this processor: other ways to compute the detectors' layers beside what runs now.

usage: python benchmarks/cpu_ways.py [--rounds 9]

Sizes are those of PointPillars' blocks and head and of the sparse layers. All ways of a layer take turns in one process
of one thread; the figure is the median, over rounds, of the ratio of processor times to what runs now: below 1 wins.
Every way gives what runs now but for rounding, which is checked. Batch normalisation is folded in all of them.
"""

import argparse
import time
from collections.abc import Callable
from functools import partial

import numpy as np
import torch
from _report import header
from torch import Tensor
from torch.nn import functional

Ways = dict[str, Callable[[], Tensor]]


def plain(image: Tensor, weight: Tensor, bias: Tensor, padding: int) -> Tensor:
    return functional.conv2d(image, weight, bias, 1, padding).relu_()


def blocked(image: Tensor, weight: Tensor, bias: Tensor, padding: int) -> Tensor:
    made = torch.mkldnn_convolution(image, weight, bias, [padding] * 2, [1, 1], [1, 1], 1)
    return made.to_dense().relu_()


def fused(image: Tensor, weight: Tensor, bias: Tensor, padding: int) -> Tensor:
    once = [1, 1]
    return torch.ops.mkldnn._convolution_pointwise(image, weight, bias, [padding] * 2, once, once, 1, "relu", [], "")


def convolution(channels: int, height: int, width: int, out: int, reach: int) -> Ways:
    """A convolution with ReLU on a map in channels_last."""
    image = torch.randn(1, channels, height, width).to(memory_format=torch.channels_last)
    weight = (torch.randn(out, channels, reach, reach) * 0.05).to(memory_format=torch.channels_last)
    bias, pad = torch.randn(out), reach // 2
    packed = torch.ops.mkldnn._reorder_convolution_weight(weight, [pad] * 2, [1, 1], [1, 1], 1, list(image.shape))
    return {
        "now: channels_last": partial(plain, image, weight, bias, pad),
        "channels first": partial(plain, image.contiguous(), weight.contiguous(), bias, pad),
        "oneDNN's own layout": partial(blocked, image.to_mkldnn(), weight.contiguous(), bias, pad),
        "ReLU inside": partial(fused, image, weight, bias, pad),
        "ReLU inside, weights packed": partial(fused, image, packed, bias, pad),
    }


def gathered(features: Tensor, rows: Tensor, matrix: Tensor) -> Tensor:
    return features.index_select(0, rows) @ matrix


def gathered_by_onednn(features: Tensor, rows: Tensor, matrix: Tensor) -> Tensor:
    return torch.ops.mkldnn._linear_pointwise(features.index_select(0, rows), matrix.t(), None, "none", [], "")


def gathered_in_blocks(features: Tensor, rows: Tensor, matrix: Tensor, block: int) -> Tensor:
    made, held = features.new_empty(len(rows), matrix.shape[1]), features.new_empty(block, features.shape[1])
    for some, out in zip(rows.split(block), made.split(block), strict=True):
        torch.mm(torch.index_select(features, 0, some, out=held[: len(some)]), matrix, out=out)
    return made


def product(count: int, channels: int, out: int) -> Ways:
    """The product of one element of a sparse kernel."""
    features, matrix = torch.randn(2 * count, channels), torch.randn(channels, out)
    rows = torch.randperm(2 * count)[:count].sort().values
    return {
        "now: gather, multiply": partial(gathered, features, rows, matrix),
        "by oneDNN": partial(gathered_by_onednn, features, rows, matrix),
        "in blocks of 128 kB": partial(gathered_in_blocks, features, rows, matrix, 2**15 // channels),
        "in blocks of 512 kB": partial(gathered_in_blocks, features, rows, matrix, 2**17 // channels),
    }


def compared(ways: Ways, rounds: int) -> dict[str, tuple[float, float]]:
    """Milliseconds and ratio to the first way, medians."""
    taken: dict[str, list[float]] = {name: [] for name in ways}
    first, *others = (way() for way in ways.values())
    assert all(torch.allclose(first, other, atol=1e-3, rtol=1e-4) for other in others)
    for _ in range(rounds):
        for name, way in ways.items():
            began = time.process_time()
            way()
            taken[name].append(1e3 * (time.process_time() - began))
    now = np.array(next(iter(taken.values())))
    return {name: (float(np.median(t)), float(np.median(np.array(t) / now))) for name, t in taken.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=9)
    options = parser.parse_args()
    torch.set_num_threads(1)
    torch.set_grad_enabled(False)
    torch.manual_seed(0)
    layers = {
        "PointPillars, block 1, 3 x 3, 32 to 32": convolution(32, 500, 200, 32, 3),
        "PointPillars, block 2, 3 x 3, 64 to 64": convolution(64, 250, 100, 64, 3),
        "PointPillars, block 3, 3 x 3, 128 to 128": convolution(128, 125, 50, 128, 3),
        "PointPillars, head, 1 x 1, 288 to 60": convolution(288, 250, 100, 60, 1),
        "sparse, 20,000 pairs, 32 to 32": product(20_000, 32, 32),
        "sparse, 20,000 pairs, 64 to 64": product(20_000, 64, 64),
        "sparse, 3,000 pairs, 64 to 64": product(3_000, 64, 64),
    }
    print(header(), "\n\nfloat32, one thread; ms of processor time and ratio to what runs now", sep="")
    for title, ways in layers.items():
        print(title)
        for name, (ms, ratio) in compared(ways, options.rounds).items():
            print(f"  {name:<30} {ms:8.2f} {ratio:8.2f}", flush=True)


if __name__ == "__main__":
    main()

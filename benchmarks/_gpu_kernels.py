"""Every operator with a Triton kernel against its plain version: forward and gradients, from empty to 2 million pairs.

On a CPU the kernels run in Triton's interpreter, at small sizes. The truth is the plain version in float64 on the CPU,
given the numbers as the kernel sees them, already rounded to its number type.
"""

import importlib.util
import os
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import torch
from _gpu_common import ABSENT, NEEDS_GPU, OK, PRECISIONS, Row, Site, each

from farfield.detectors.devices import DTYPES
from farfield.detectors.sparse import Rulebook, layers, strided_rulebook, submanifold_rulebook
from farfield.detectors.sparse.tables import DeviceBook, strided_book, submanifold_book

FORWARD = {"fp32": 1e-5, "bf16": 8e-3, "fp16": 2e-3}  # of the largest output; results are rounded to 8, 11 bits
WEIGHT_GRADIENT = {**FORWARD, "fp32": 1e-4}  # summed in float32 over up to a hundred thousand pairs, then rounded
PAIRS = (0, 1, 1_000, 50_000, 2_000_000)
INTERPRETED = (0, 1, 300)  # a program of the interpreter takes seconds
WIDTHS = ((5, 20), (16, 32), (64, 64), (128, 128))
CLOUDS = ((0,), (1,), (9000, 0, 300), (65_536,))
CHOSEN = 4096


def run(site: Site) -> Iterator[Row]:
    """Rows of every operator."""
    if importlib.util.find_spec("triton") is None:
        yield Row("sparse convolution, farthest points", "Triton is not installed: pip install triton", ABSENT)
        return
    if not site.gpu and os.environ.get("TRITON_INTERPRET") != "1":
        yield site.needs_gpu("sparse convolution, farthest points", "or TRITON_INTERPRET=1 for the interpreter")
        return
    for precision in PRECISIONS:
        if precision == "bf16" and not site.gpu:
            yield Row("sparse convolution, bf16", "Triton's interpreter multiplies bfloat16 wrongly", NEEDS_GPU)
        else:
            sizes = [f"{pairs:,} pairs" for pairs in (PAIRS if site.gpu else INTERPRETED)]
            yield from each(sizes, partial(_convolutions, site, precision))
    yield from each(["farthest points"], partial(_farthest, site))
    from _gpu_kernel_checks import CHECKS

    yield from each(list(CHECKS), partial(_checked, site))
    if not site.gpu:
        yield site.needs_gpu("sizes to 2 million pairs, 65,536 points", "the kernels ran in Triton's interpreter")


def _checked(site: Site, name: str) -> Iterator[Row]:
    """A kernel on small and odd cases; where it differs the row says how."""
    from _gpu_kernel_checks import CHECKS

    CHECKS[name](site.device.type)
    yield Row(f"{name}, small and odd cases", "as the plain version", OK)


def _convolutions(site: Site, precision: str, size: str) -> Iterator[Row]:
    """A submanifold and a strided kernel on cells with about so many pairs, over several widths."""
    pairs = int(size.split()[0].replace(",", ""))
    widths = WIDTHS[:2] if not site.gpu else WIDTHS
    worst, met = dict.fromkeys(("output", "to features", "to weight"), 0.0), 0
    for number, (book, there) in enumerate(_books(pairs)):
        met = max(met, sum(book.counts))
        for c_in, c_out in widths[number % 2 :: 2] if not site.gpu else widths:
            for name, error in _errors(site, book, there, c_in, c_out, precision).items():
                worst[name] = max(worst[name], error)
    what = f"sparse convolution, {precision}, {met:,} pairs"
    bounds = {"output": FORWARD[precision], "to features": FORWARD[precision], "to weight": WEIGHT_GRADIENT[precision]}
    for name, error in worst.items():
        yield site.bounded(f"{what}, {name}", error, bounds[name])


def _books(pairs: int) -> list[tuple[Rulebook, Callable[[torch.device], DeviceBook]]]:
    """Rulebooks of clumps of cells, the first of about so many pairs; each with what makes its table on a device."""
    generator = torch.Generator().manual_seed(pairs)
    cells = {0: 0, 1: 1}.get(pairs, pairs // 9)  # a cell of a clump meets nine on average
    side = max(4, round((cells / 0.3) ** (1 / 3)))
    shape = (side, side, side)
    keys = torch.randperm(side**3, generator=generator)[:cells].sort().values
    same, strided = (3, 3, 3), ((3, 3, 3), (2, 2, 2), (1, 1, 1))
    return [
        (submanifold_rulebook(keys, shape, same), lambda device: submanifold_book(keys.to(device), shape, same)),
        (strided_rulebook(keys, shape, *strided), lambda device: strided_book(keys.to(device), shape, *strided)),
    ]


def _errors(
    site: Site, book: Rulebook, there: Callable[..., DeviceBook], c_in: int, c_out: int, precision: str
) -> dict[str, float]:
    """Largest error of the kernels' output and gradients, relative to the largest number of the truth."""
    from farfield.detectors.sparse import triton_kernels

    generator = torch.Generator().manual_seed(c_in)
    shapes = ((len(book.keys_in), c_in), (len(book.counts), c_in, c_out), (len(book.keys), c_out))
    given = [torch.randn(shape, generator=generator).to(DTYPES[precision]) for shape in shapes]
    truth = _results(layers, *(part.double() for part in given), book)
    got = _results(triton_kernels, *(part.to(site.device) for part in given), there(site.device))
    names = ("output", "to features", "to weight")
    return {name: _error(a, b) for name, a, b in zip(names, got, truth, strict=True)}


def _results(by: Any, features: Any, weight: Any, gradient: Any, book: Any) -> tuple[Any, ...]:
    """Output and both gradients, by the kernels from tables or by the plain version from pairs."""
    back = weight.transpose(1, 2)
    inverse = (back.flip(0), book) if book.symmetric else (back, book.inverse)
    out = by.gather_product(features, weight, *_read(by, book))
    to_features = by.gather_product(gradient, inverse[0], *_read(by, inverse[1]))
    to_weight = by.weight_gradient(features, gradient, *_read(by, book))
    return out, to_features, to_weight.to(weight.dtype)


def _read(by: Any, book: Any) -> tuple[Any, ...]:
    return (book,) if by is layers else book.similar


def _error(got: Any, truth: Any) -> float:
    if got.shape != truth.shape:
        raise ValueError(f"expected shape {tuple(truth.shape)}, got {tuple(got.shape)}")
    if not truth.numel():
        return 0.0
    return float((got.cpu().double() - truth).abs().max() / truth.abs().max().clamp(min=1e-12))


def _farthest(site: Site, what: str) -> Iterator[Row]:
    """Chosen points by the kernel, and by the plain version on the CPU: the same ones."""
    from farfield.detectors.pointrcnn import triton_sampling
    from farfield.detectors.pointrcnn.points import farthest_points

    clouds = CLOUDS if site.gpu else ((1,), (400, 0, 60))
    for lengths in clouds:
        points = torch.randn(sum(lengths), 3, generator=torch.Generator().manual_seed(7)) * 20
        count = CHOSEN if site.gpu else 16
        expected = farthest_points(points, lengths, count)[0]
        got = triton_sampling.farthest_points(points.to(site.device), lengths, count).cpu()
        differ = int((got != expected).sum()) if len(got) == len(expected) else max(len(got), len(expected))
        words = f"{what}, {'+'.join(map(str, lengths))} points"
        yield site.bounded(words, differ, 0, f"of {len(expected)} chosen differ")

"""SECOND's sparse backbone beside spconv's CPU build."""

import argparse
import importlib.util
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from _report import Part, child_command, part_parser, run_parts

SHAPE = (41, 1408, 1600)  # z, x, y: SECOND's car grid at 0.05 x 0.05 x 0.1 m
CASES = {20_000: 64, 60_000: 128}  # voxels: beams


class Layer(NamedTuple):
    """One layer of the backbone."""

    c_in: int
    c_out: int
    stride: tuple[int, int, int] | None = None  # None: submanifold
    padding: tuple[int, int, int] = (1, 1, 1)
    kernel: tuple[int, int, int] = (3, 3, 3)
    book: str = ""


BACKBONE = [  # VoxelBackBone8x, as OpenPCDet's second.yaml has it
    Layer(4, 16, book="s1"),
    Layer(16, 16, book="s1"),
    Layer(16, 32, (2, 2, 2), book="d2"),
    Layer(32, 32, book="s2"),
    Layer(32, 32, book="s2"),
    Layer(32, 64, (2, 2, 2), book="d3"),
    Layer(64, 64, book="s3"),
    Layer(64, 64, book="s3"),
    Layer(64, 64, (2, 2, 2), (0, 1, 1), book="d4"),
    Layer(64, 64, book="s4"),
    Layer(64, 64, book="s4"),
    Layer(64, 128, (2, 1, 1), (0, 0, 0), (3, 1, 1), book="out"),
]


def scan(beams: int, azimuths: int) -> np.ndarray:
    """Points of a scan from 1.73 m over a flat road with 40 cars and two rows of houses; 2 cm noise."""
    rng = np.random.default_rng(0)
    elevation, azimuth = np.meshgrid(
        np.deg2rad(np.linspace(-24.8, 3.0, beams)), np.deg2rad(np.linspace(-45, 45, azimuths)), indexing="ij"
    )
    ray = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], -1
    ).reshape(-1, 3)
    with np.errstate(divide="ignore", invalid="ignore"):
        range_m = np.where(ray[:, 2] < 0, -1.73 / ray[:, 2], np.inf)
        for low, high in boxes(rng):
            first, second = low / ray, high / ray
            near, far = np.minimum(first, second).max(1), np.maximum(first, second).min(1)
            range_m = np.where((near <= far) & (near > 0) & (near < range_m), near, range_m)
    seen = range_m < 75
    return ray[seen] * (range_m[seen] + rng.normal(0, 0.02, seen.sum()))[:, None]


def boxes(rng: np.random.Generator) -> list[tuple[np.ndarray, np.ndarray]]:
    """Lower and upper corners of cars and houses."""
    corners = []
    for _ in range(40):
        centre = np.array([rng.uniform(5, 70), rng.uniform(-38, 38), -0.93])
        half = np.array([rng.uniform(3.5, 5), rng.uniform(1.6, 2), 1.6]) / 2
        corners.append((centre - half, centre + half))
    for x in range(0, 70, 12):
        for side in (-1, 1):
            y = side * rng.uniform(14, 20)
            low, high = sorted((y, y + 8 * side))
            end = x + rng.uniform(6, 11)
            corners.append((np.array([x, low, -1.73]), np.array([end, high, rng.uniform(1.3, 2.0)])))
    return corners


def voxels(points: np.ndarray) -> np.ndarray:
    """Keys of the occupied cells, ascending."""
    cell = np.floor((points - [0, -40, -3]) / [0.05, 0.05, 0.1]).astype(np.int64)
    cell = cell[((cell >= 0) & (cell < [SHAPE[1], SHAPE[2], 40])).all(1)]
    return np.unique((cell[:, 2] * SHAPE[1] + cell[:, 0]) * SHAPE[2] + cell[:, 1])


def case(count: int, beams: int) -> np.ndarray:
    """A scan fine enough for ``count`` voxels, cut to exactly so many at random."""
    azimuths, keys = 100, np.empty(0, np.int64)
    while len(keys) < count:
        azimuths = azimuths * 9 // 8
        keys = voxels(scan(beams, azimuths))
    return np.sort(np.random.default_rng(1).permutation(keys)[:count])


def weights() -> list[tuple[np.ndarray, np.ndarray]]:
    """Kernels (K, c_in, c_out) that keep the variance, and biases, of each layer."""
    rng, drawn = np.random.default_rng(2), []
    for layer in BACKBONE:
        size = int(np.prod(layer.kernel))
        scale = np.sqrt(2 / (layer.c_in * max(size // 3, 1)))
        kernel = rng.normal(0, scale, (size, layer.c_in, layer.c_out)).astype(np.float32)
        drawn.append((kernel, rng.normal(0, 0.1, layer.c_out).astype(np.float32)))
    return drawn


# --- the two implementations: each gives a function that makes one pass and returns (features, keys) -----------------


def ours(training: bool, dtype: str) -> Any:
    import torch
    from torch import nn

    from farfield.detectors.sparse import (
        SparseBlock,
        SparseConv,
        SparseSequential,
        SparseTensor,
        SubmanifoldConv,
    )

    layers = []
    for layer, (kernel, bias) in zip(BACKBONE, weights(), strict=True):
        conv: Any
        if layer.stride is None:
            conv = SubmanifoldConv(layer.c_in, layer.c_out, layer.kernel, not training, layer.book)
        else:
            conv = SparseConv(
                layer.c_in, layer.c_out, layer.kernel, layer.stride, layer.padding, not training, layer.book
            )
        with torch.no_grad():
            conv.weight.copy_(torch.from_numpy(kernel))
            if not training:
                conv.bias.copy_(torch.from_numpy(bias))
        norm = nn.BatchNorm1d(layer.c_out, eps=1e-3, momentum=0.01) if training else nn.Identity()
        layers.append(SparseBlock(conv, norm))
    network = SparseSequential(*layers).train(training).to(getattr(torch, dtype))

    def run(features: Any, keys: Any, shape: tuple[int, int, int] = SHAPE) -> tuple[Any, Any]:
        out = network(SparseTensor(features.to(getattr(torch, dtype)), keys, shape, 1))
        return out.features, out.keys

    run.network = network  # type: ignore[attr-defined]
    return run


def theirs(training: bool, dtype: str) -> Any:
    import spconv.pytorch as spconv
    import torch
    from spconv.pytorch import ops
    from torch import nn

    if dtype != "float32":
        raise ValueError("spconv has no bfloat16 on the CPU")
    ops.get_current_stream = lambda: 0  # it takes a CUDA stream, though there is no CUDA
    convs, biases, norms = nn.ModuleList(), [], nn.ModuleList()
    for layer, (kernel, bias) in zip(BACKBONE, weights(), strict=True):
        kind = spconv.SubMConv3d if layer.stride is None else spconv.SparseConv3d
        conv = kind(
            layer.c_in,
            layer.c_out,
            layer.kernel,
            stride=layer.stride or 1,
            padding=layer.padding,
            bias=False,
            indice_key=layer.book,
        )
        ordered = torch.from_numpy(kernel).view(*layer.kernel, layer.c_in, layer.c_out).permute(4, 0, 1, 2, 3)
        with torch.no_grad():
            conv.weight.copy_(ordered)
        convs.append(conv)
        biases.append(torch.from_numpy(bias))
        norms.append(nn.BatchNorm1d(layer.c_out, eps=1e-3, momentum=0.01))

    def run(features: Any, keys: Any, shape: tuple[int, int, int] = SHAPE) -> tuple[Any, Any]:
        place = torch.stack([keys * 0, keys // (shape[1] * shape[2]), keys // shape[2] % shape[1], keys % shape[2]], 1)
        sparse = spconv.SparseConvTensor(features, place.int().contiguous(), list(shape), 1)
        for conv, bias, norm in zip(convs, biases, norms, strict=True):
            sparse = conv(sparse)
            rows = norm(sparse.features) if training else sparse.features.add_(bias)
            sparse = sparse.replace_feature(rows.relu_())
        place = sparse.indices.long()
        _, nx, ny = sparse.spatial_shape
        return sparse.features, (place[:, 1] * nx + place[:, 2]) * ny + place[:, 3]

    run.network = convs  # type: ignore[attr-defined]
    return run


# --- a process that runs one implementation, a pass at a time --------------------------------------------------------


def serve(kind: str, dtype: str, threads: int, folder: Path) -> None:
    """Answer requests ``count mode`` on standard input with the milliseconds of one pass."""
    import torch

    from farfield.detectors.runtime import keep_freed_memory

    keep_freed_memory()
    torch.set_num_threads(threads)
    make = ours if kind == "ours" else theirs
    passes = {False: make(False, dtype), True: make(True, dtype)}
    data = {}
    for path in folder.glob("features_*.npy"):
        count = int(path.stem.removeprefix("features_"))
        keys = torch.from_numpy(np.load(folder / f"{count}.npy"))
        data[count] = (torch.from_numpy(np.load(path)), keys)
    print("ready", flush=True)
    for line in sys.stdin:
        count_text, mode = line.split()
        features, keys = data[int(count_text)]
        for _ in range(2):
            start = time.perf_counter()
            if mode == "train":
                with torch.autocast("cpu", torch.bfloat16, enabled=False):
                    out, _ = passes[True](features, keys)
                    out.backward(torch.ones_like(out))
            else:
                with torch.no_grad():
                    out, where = passes[False](features, keys)
            elapsed_ms = (time.perf_counter() - start) * 1e3
        passes[True].network.zero_grad(set_to_none=True)
        if mode == "save":
            order = where.argsort()
            np.savez(folder / f"{kind}_{dtype}_{threads}_{count_text}.npz", out[order].float().numpy(), where[order])
        print(json.dumps(elapsed_ms), flush=True)


class Runner:
    """The other end of :func:`serve`."""

    def __init__(self, kind: str, dtype: str, threads: int, folder: Path) -> None:
        self.name, self.kind, self.dtype, self.threads, self.folder = f"{kind} {dtype}", kind, dtype, threads, folder
        self.process = subprocess.Popen(
            child_command("--serve", kind, dtype, threads, folder),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "OMP_NUM_THREADS": str(threads)},
        )

    def wait(self) -> None:
        """Wait until the process has loaded everything, so that all can start at the same time."""
        if self._answer() != "ready":
            raise RuntimeError(f"{self.name} with {self.threads} threads did not start.")

    def _answer(self) -> str:
        assert self.process.stdout
        return self.process.stdout.readline().strip()

    def ask(self, count: int, mode: str) -> float:
        """Milliseconds of one pass."""
        assert self.process.stdin
        self.process.stdin.write(f"{count} {mode}\n")
        self.process.stdin.flush()
        return float(self._answer())

    def output(self, count: int) -> np.ndarray:
        """Features that a pass without training gives, in the order of the keys."""
        self.ask(count, "save")
        with np.load(self.folder / f"{self.kind}_{self.dtype}_{self.threads}_{count}.npz") as saved:
            return saved["arr_0"]

    def close(self) -> None:
        """End the process."""
        assert self.process.stdin
        self.process.stdin.close()
        self.process.wait()


# --- error against dense convolution ---------------------------------------------------------------------------------


def dense_errors() -> None:
    """Each layer and the whole backbone on a crop of the scan, against conv3d in double precision."""
    import torch
    from torch.nn.functional import conv3d

    shape, corner = (41, 96, 96), (0, 300, 750)
    cell = np.stack(np.unravel_index(case(60_000, 128), SHAPE), 1) - corner
    cell = cell[((cell >= 0) & (cell < shape)).all(1)]
    keys = torch.from_numpy(np.ravel_multi_index(tuple(cell.T), shape))
    features = torch.randn(len(keys), 4, generator=torch.Generator().manual_seed(0))
    network = ours(False, "float32").network
    from farfield.detectors.sparse import SparseTensor

    sparse = SparseTensor(features, keys, shape, 1)
    truth, mask = sparse.dense().double(), sparse.replace(torch.ones(len(keys), 1)).dense().double()
    layer_error = 0.0
    for layer, block, (kernel, bias) in zip(BACKBONE, network, weights(), strict=True):
        weight = torch.from_numpy(kernel).double().view(*layer.kernel, layer.c_in, layer.c_out).permute(4, 3, 0, 1, 2)
        step = {"stride": layer.stride or 1, "padding": layer.padding}
        entered = sparse.dense().double()
        if layer.stride is not None:
            mask = (conv3d(mask, torch.ones(1, 1, *layer.kernel).double(), **step) > 0).double()
        with torch.no_grad():
            sparse = block(sparse)
        one = conv3d(entered, weight, torch.from_numpy(bias).double(), **step).relu() * mask
        truth = conv3d(truth, weight, torch.from_numpy(bias).double(), **step).relu() * mask
        layer_error = max(layer_error, float((sparse.dense() - one).abs().max() / one.abs().max()))
    whole = float((sparse.dense() - truth).abs().max() / truth.abs().max())
    print(f"\nerror against dense conv3d in float64, relative to the largest output; {len(keys)} voxels in {shape}:")
    print(f"  worst single layer {layer_error:.1e}, whole backbone {whole:.1e}")


def report(rounds: int, cases: dict[int, int]) -> None:
    print(f"load     {os.getloadavg()[0]:.2f} before the first pass\n")
    dense_errors()
    threads = (2, 1) if cases == CASES else (1,)
    setups = [("ours", dtype, count) for count in threads for dtype in ("float32", "bfloat16")]
    if importlib.util.find_spec("spconv") is None:
        print("\nspconv cannot be imported here: its rows are left out.")
    else:
        setups += [("spconv", "float32", count) for count in threads]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for count, beams in cases.items():
            np.save(folder / f"{count}.npy", case(count, beams))
            features = np.random.default_rng(3).normal(size=(count, 4)).astype(np.float32)
            np.save(folder / f"features_{count}.npy", features)
        runners = [Runner(*setup, folder) for setup in setups]
        for runner in runners:
            runner.wait()
        for count in cases:
            compare(count, runners, rounds)
        for runner in runners:
            runner.close()
    print(f"\nload     {os.getloadavg()[0]:.2f} after the last pass (these processes included)")


def compare(count: int, runners: list[Runner], rounds: int) -> None:
    """One case: all runners take turns."""
    reference = {runner.threads: runner for runner in runners if runner.kind == "spconv"}.get(1)
    truth = (reference or runners[0]).output(count)
    print(f"\n{count:,} voxels in {SHAPE}; ms, best and median of {rounds}; rulebooks included")
    print(f"  {'':16s} {'threads':>7s} {'forward':>15s} {'forward+backward':>18s}   error of the output")
    times: dict[tuple[str, int, str], float] = {}
    for mode in ("forward", "train"):
        taken: dict[int, list[float]] = {number: [] for number in range(len(runners))}
        for turn in range(rounds + 1):
            for number, runner in enumerate(runners):
                if mode == "train" and runner.dtype != "float32":
                    continue
                elapsed_ms = runner.ask(count, mode)
                if turn:  # the first pass warms up
                    taken[number].append(elapsed_ms)
        for number, runner in enumerate(runners):
            if taken[number]:
                times[runner.name, runner.threads, mode] = min(taken[number])
                times[runner.name, runner.threads, mode + " median"] = float(np.median(taken[number]))
    for runner in runners:
        cells = []
        for mode in ("forward", "train"):
            best = times.get((runner.name, runner.threads, mode))
            median = times.get((runner.name, runner.threads, mode + " median"))
            cells.append(f"{best:7.1f} {median:7.1f}" if best is not None else "")
        error = np.abs(runner.output(count) - truth).max() / np.abs(truth).max()
        print(f"  {runner.name:16s} {runner.threads:7d} {cells[0]:>15s} {cells[1]:>18s}   {error:.1e}")
    if reference is None or ("spconv float32", 2, "forward") not in times:
        return
    theirs_ms = times["spconv float32", 2, "forward"]
    print(
        "  spconv's two threads take"
        f" {theirs_ms / times['ours float32', 2, 'forward']:.2f} times as long as ours forward in float32,"
        f" {theirs_ms / times['ours bfloat16', 2, 'forward']:.2f} times as ours in bfloat16,"
        f" {times['spconv float32', 2, 'train'] / times['ours float32', 2, 'train']:.2f} times forward and backward"
    )


def run_backbone(arguments: Sequence[str]) -> None:
    """SECOND's sparse backbone, side by side with spconv's CPU build: time, and error against dense convolution.

    Weights and voxels are the same for all; rulebooks are found anew at every pass and timed. Each implementation runs
    in a process of its own with its own number of threads; the processes take turns, pass by pass, each timed pass
    right after an untimed one, as in a stream of frames: the other processes have emptied the caches, and its threads
    sleep. spconv joins where it can be imported (``pip install --target somewhere spconv==2.3.8``, then
    ``PYTHONPATH=somewhere python benchmarks/sparse_convolution.py``).

    What spconv 2.3.8 needs on a CPU: one thread to be right (its scatter races with more), its stream call patched for
    the backward pass, contiguous int32 indices; it knows neither a bias nor bfloat16 there, so bias and ReLU follow in
    place.
    """
    parser = part_parser(run_backbone.__doc__)
    parser.add_argument("--rounds", type=int, default=25)
    parser.add_argument("--voxels", type=int, nargs="+", help="of a scan of 64 beams, in place of both cases")
    parser.add_argument("--serve", nargs=4, help=argparse.SUPPRESS)
    chosen = parser.parse_args(arguments)
    if chosen.serve:
        kind, dtype, threads, folder = chosen.serve
        serve(kind, dtype, int(threads), Path(folder))
    else:
        report(chosen.rounds, dict.fromkeys(chosen.voxels, 64) if chosen.voxels else CASES)


if __name__ == "__main__":
    raise SystemExit(
        run_parts(
            __doc__,
            {
                "backbone": Part(run_backbone, "--rounds 1 --voxels 2000"),
            },
        )
    )

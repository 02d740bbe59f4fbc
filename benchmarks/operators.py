"""Operators: rotated IoU, other ways to compute the detectors' layers, VoxelNet's middle layers."""

import copy
import json
import multiprocessing
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from _report import Part, part_parser, run_parts
from torch import Tensor
from torch.nn import functional

from farfield.detectors.inputs import cloud_tensor
from farfield.detectors.sparse import SparseTensor
from farfield.detectors.voxelnet.middle import MiddleLayers
from farfield.detectors.voxelnet.network import VoxelNet, VoxelNetConfig
from farfield.geometry.boxes import Boxes
from farfield.geometry.iou import paired_iou
from farfield.simulation import simulate_sequence

REQUIRED_PER_S, IOU_TOLERANCE = 500_000, 1e-9
SIZE_M = (4.5, 1.9, 1.6)


def overlapping_pairs(count: int) -> tuple[Boxes, Boxes]:
    """Vehicles anywhere to 250 m and detections of them: centres off by decimetres, sizes by a tenth, any heading."""
    rng = np.random.default_rng(7)
    centre_m = np.column_stack(
        [rng.uniform(0, 250, count), rng.uniform(-50, 50, count), rng.uniform(-1.5, -0.5, count)]
    )
    size_m = np.array(SIZE_M) * rng.uniform(0.8, 1.3, (count, 3))
    annotated = Boxes(centre_m=centre_m, size_m=size_m, yaw_rad=rng.uniform(-np.pi, np.pi, count))
    detected = Boxes(
        centre_m=centre_m + rng.normal(0, [0.3, 0.3, 0.1], (count, 3)),
        size_m=size_m * rng.uniform(0.9, 1.1, (count, 3)),
        yaw_rad=annotated.yaw_rad + rng.normal(0, 0.3, count) + np.pi * rng.integers(0, 2, count),
    )
    overlap = paired_iou(annotated, detected) > 0
    return annotated[overlap], detected[overlap]


def pairs_per_second(a: Boxes, b: Boxes, *, kind: str, threads: int, repeats: int) -> list[tuple[float, float]]:
    parts = [slice(start, start + len(a) // threads) for start in range(0, len(a), len(a) // threads)]
    halves = [(a[part], b[part]) for part in parts]
    rates = []
    with ThreadPoolExecutor(threads) as pool:
        for _ in range(repeats):
            start = time.perf_counter(), time.process_time()
            list(pool.map(lambda pair: paired_iou(*pair, kind=kind), halves))
            rates.append((len(a) / (time.perf_counter() - start[0]), len(a) / (time.process_time() - start[1])))
    return sorted(rates)


def far_boxes(size_m: tuple[float, float, float] = SIZE_M, *, count: int = 20_000) -> Boxes:
    """Boxes of one size 250 m away, in random directions with random headings, the four axis-parallel ones first."""
    rng = np.random.default_rng(11)
    azimuth_rad, yaw_rad = rng.uniform(-np.pi, np.pi, (2, count))
    yaw_rad[:4] = np.arange(4) * np.pi / 2
    centre_m = np.column_stack([250 * np.cos(azimuth_rad), 250 * np.sin(azimuth_rad), np.full(count, -1.0)])
    return Boxes(centre_m=centre_m, size_m=np.tile(size_m, (count, 1)), yaw_rad=yaw_rad)


def moved(
    boxes: Boxes, ahead_m: float = 0, left_m: float = 0, turn_rad: float = 0, size_m: tuple[float, ...] | None = None
) -> Boxes:
    cos, sin = np.cos(boxes.yaw_rad), np.sin(boxes.yaw_rad)
    offset = [ahead_m * cos - left_m * sin, ahead_m * sin + left_m * cos, np.zeros(len(boxes))]
    size = boxes.size_m if size_m is None else np.tile(size_m, (len(boxes), 1))
    return boxes.replace(
        centre_m=boxes.centre_m + np.column_stack(offset), yaw_rad=boxes.yaw_rad + turn_rad, size_m=size
    )


def analytic_cases() -> Iterator[tuple[str, Boxes, Boxes, float]]:
    """Name, boxes, their partners, exact IoU (the same in BEV and 3D, because the heights agree)."""
    length, width, height = SIZE_M
    car, square = far_boxes(), far_boxes((2.5, 2.5, 1.0))
    yield "coincident", car, car, 1.0
    yield "turned by pi", car, moved(car, turn_rad=np.pi), 1.0
    yield "square turned by pi/2", square, moved(square, turn_rad=np.pi / 2), 1.0
    yield "square turned by pi/4", square, moved(square, turn_rad=np.pi / 4), float(np.sqrt(0.5))
    yield "shared side edges", car, moved(car, ahead_m=1.7), (length - 1.7) / (length + 1.7)
    yield "shared side edges, turned by pi", car, moved(car, 1.7, turn_rad=np.pi), (length - 1.7) / (length + 1.7)
    yield "shared front edges", car, moved(car, left_m=0.6), (width - 0.6) / (width + 0.6)
    yield "nested, turned", car, moved(car, 0.3, -0.1, 0.2, (1.0, 0.8, height)), 0.8 / (length * width)
    yield "nested, shared corner", car, moved(car, 1.75, 0.45, 0, (1.0, 1.0, height)), 1 / (length * width)
    yield "crossed", car, moved(car, turn_rad=np.pi / 2), width**2 / (2 * length * width - width**2)
    yield "touching ends", car, moved(car, ahead_m=length), 0.0
    yield "touching sides", car, moved(car, left_m=width), 0.0
    yield "touching corners", car, moved(car, length, width), 0.0
    yield "far apart", car, moved(car, ahead_m=30.0), 0.0


def report(pairs: int, repeats: int) -> bool:
    a, b = overlapping_pairs(pairs)
    good = True
    lines = [f"{len(a)} overlapping pairs; million pairs per second, best and median of {repeats},"]
    lines += ["and per second of processor time in one core (free of what other programs take)"]
    for kind in ("bev", "3d"):
        for threads in (1, 2):
            rates = pairs_per_second(a, b, kind=kind, threads=threads, repeats=repeats)
            best, median, busy = rates[-1][0], rates[len(rates) // 2][0], max(rate for _, rate in rates)
            lines.append(f"  {kind:4} {threads} thread(s)  {best / 1e6:6.2f}  {median / 1e6:6.2f}  {busy / 1e6:6.2f}")
        good &= median >= REQUIRED_PER_S
    lines += ["", f"largest absolute error in IoU at 250 m, {len(far_boxes())} poses a case"]
    lines += [f"  {'case':32} bev       3d"]
    for name, first, second, expected in analytic_cases():
        errors = [float(np.abs(paired_iou(first, second, kind=kind) - expected).max()) for kind in ("bev", "3d")]
        lines.append(f"  {name:32} {errors[0]:.2e}  {errors[1]:.2e}")
        good &= max(errors) < IOU_TOLERANCE
    verdict = "met" if good else "NOT MET"
    lines += ["", f"required: {REQUIRED_PER_S} pairs per second, errors below {IOU_TOLERANCE}: {verdict}"]
    print("\n".join(lines))
    return good


def run_iou(arguments: Sequence[str]) -> int:
    """Rotated IoU in float64: overlapping pairs per second, and the error in analytic cases 250 m from the sensor.

        python benchmarks/operators.py iou [--pairs 400000] [--repeats 5]

    Boxes go in and IoU comes out (``paired_iou``), rejection of far pairs and heights included. Exit status 1 where an
    error reaches 1e-9 or two threads stay below 500,000 pairs per second.
    """
    parser = part_parser(run_iou.__doc__)
    parser.add_argument("--pairs", type=int, default=400_000)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args(arguments)
    return int(not report(options.pairs, options.repeats))


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


def run_layers(arguments: Sequence[str]) -> None:
    """What float32 could still win on this processor: other ways to compute the detectors' layers.

        python benchmarks/operators.py layers [--rounds 9]

    Sizes are those of PointPillars' blocks and head and of the sparse layers. All ways of a layer take turns in one
    process of one thread; the figure is the median, over rounds, of the ratio of processor times to what runs now:
    below 1 wins. Every way gives what runs now but for rounding, which is checked. Batch normalisation is folded in all
    of them.
    """
    parser = part_parser(run_layers.__doc__)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--first", type=int, default=0, help="number of the first layer")
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
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
    print("float32, one thread; ms of processor time and ratio to what runs now")
    for title, ways in list(layers.items())[options.first :]:
        print(title)
        with torch.no_grad():
            figures = compared(ways, options.rounds)
        for name, (ms, ratio) in figures.items():
            print(f"  {name:<30} {ms:8.2f} {ratio:8.2f}", flush=True)


VOXELNET_TOLERANCE = 1e-4
SMALL_SHAPE, SMALL_VOXELS = (10, 64, 48), 1500


def used_layers(seed: int = 1) -> MiddleLayers:
    """Published widths; norms with weights and statistics that are not the initial ones."""
    torch.manual_seed(seed)
    layers = MiddleLayers(128, (64, 64, 64), 10)
    for name, value in layers.state_dict().items():
        if "norm" in name and value.is_floating_point():
            value.uniform_(0.5, 1.5) if name.endswith(("weight", "var")) else value.normal_(std=0.5)
    return layers


def small_voxels() -> SparseTensor:
    generator = torch.Generator().manual_seed(2)
    keys = torch.randperm(2 * int(np.prod(SMALL_SHAPE)), generator=generator)[:SMALL_VOXELS].sort().values
    return SparseTensor(torch.rand(SMALL_VOXELS, 128, generator=generator), keys, SMALL_SHAPE, 2)


def small_run(layers: MiddleLayers, voxels: SparseTensor, mode: str, training: bool, dtype: torch.dtype) -> list[Any]:
    """Output, gradient of the voxels, of the weights, and running statistics after one pass, all float64."""
    layers = copy.deepcopy(layers).to(dtype).train(training)
    layers.mode = mode
    features = voxels.features.to(dtype, copy=True).requires_grad_()
    image = layers(SparseTensor(features, voxels.keys, voxels.shape, voxels.batch_size))
    (image * torch.linspace(-1, 1, image.numel()).view(image.shape).to(dtype)).sum().backward()
    weights = torch.cat([p.grad.flatten() for p in layers.parameters()])
    statistics = torch.cat([b.flatten() for name, b in layers.named_buffers() if "running" in name])
    return [part.detach().double() for part in (image, features.grad, weights, statistics)]


def small_comparison() -> tuple[list[str], float]:
    """Largest differences, gradients and statistics relative to the largest of their kind."""
    layers, voxels, worst = used_layers(), small_voxels(), 0.0
    lines = [f"  {'':34}{'output':>10}{'d voxels':>10}{'d weights':>10}{'statistics':>11}"]
    for training in (False, True):
        exact = small_run(layers, voxels, "dense", training, torch.float64)
        dense, sparse = (small_run(layers, voxels, mode, training, torch.float32) for mode in ("dense", "sparse"))
        for name, one, other in (
            ("sparse - dense", sparse, dense),
            ("sparse - dense float64", sparse, exact),
            ("dense - dense float64", dense, exact),
        ):
            scales = [1.0, *(max(1.0, float(part.abs().max())) for part in exact[1:])]
            gaps = [float((a - b).abs().max()) / s for a, b, s in zip(one, other, scales, strict=True)]
            lines.append(
                f"  {'training' if training else 'evaluation':11}{name:23}{gaps[0]:10.1e}{gaps[1]:10.1e}{gaps[2]:10.1e}"
                f"{gaps[3]:11.1e}"
            )
            worst = max(worst, *gaps) if name == "sparse - dense" else worst
    return lines, worst


def frame_voxels() -> tuple[SparseTensor, int]:
    """Voxels of one simulated frame at the published grid, with the features of an untrained encoder."""
    frame = next(iter(simulate_sequence("cirrus-sim", seed=7, sequence=0, frames=1)))
    cloud = cloud_tensor(frame.cloud(), VoxelNetConfig().columns)
    torch.manual_seed(0)
    with torch.no_grad():
        encoder = VoxelNet(VoxelNetConfig()).encoder.eval()
        return encoder([cloud]), len(cloud)


def full_run(mode: str, voxels: Path, image: Path, threads: int, repeats: int) -> None:
    """Run one mode in this process: save its image, print what it took."""
    torch.set_num_threads(threads)
    stored = torch.load(voxels, weights_only=True)
    sparse = SparseTensor(stored["features"], stored["keys"], (10, 1256, 504), 1)
    layers = used_layers().eval()
    layers.mode = mode
    before, seconds, out = _peak_gib(), [], torch.empty(0)
    with torch.no_grad():
        for _ in range(repeats):
            sparse.rulebooks.clear()
            start = time.perf_counter()
            out = layers(sparse)
            seconds.append(time.perf_counter() - start)
    taken = {"peak_gib": _peak_gib(), "before_gib": before, "seconds": min(seconds)}
    np.save(image, out.permute(0, 2, 3, 1).contiguous().numpy())
    image.with_suffix(".json").write_text(json.dumps(taken))


def _peak_gib() -> float:
    """Peak resident memory of this program; ``ru_maxrss`` would count the parent, which started it by a fork."""
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) / 2**20


def full_comparison(threads: int, repeats: int) -> tuple[list[str], float]:
    voxels, points = frame_voxels()
    lines = [f"1256 x 504 x 10 voxels, one simulated frame of {points} points, {len(voxels.keys)} voxels; float32,"]
    lines += [f"forward, {threads} threads, rulebooks built anew, best of {repeats} (dense: once)"]
    lines += [f"  {'':8}{'seconds':>8}{'peak memory GiB':>17}{'of which before':>17}"]
    with TemporaryDirectory() as folder:
        stored, images = Path(folder) / "voxels.pt", {}
        torch.save({"features": voxels.features, "keys": voxels.keys}, stored)
        for mode in ("sparse", "dense"):
            image = Path(folder) / f"{mode}.npy"
            arguments = (mode, stored, image, threads, repeats if mode == "sparse" else 1)
            process = multiprocessing.get_context("spawn").Process(target=full_run, args=arguments)
            process.start()
            process.join()
            if process.exitcode:
                raise SystemExit(f"the {mode} run ended with exit status {process.exitcode}: out of memory?")
            taken = json.loads(image.with_suffix(".json").read_text())
            lines.append(f"  {mode:8}{taken['seconds']:8.2f}{taken['peak_gib']:17.2f}{taken['before_gib']:17.2f}")
            images[mode] = np.load(image, mmap_mode="r")
        gap = max(float(np.abs(a - b).max()) for a, b in zip(images["sparse"][0], images["dense"][0], strict=True))
        largest = max(float(np.abs(a).max()) for a in images["dense"][0])
    lines.append(f"  largest difference of the output {gap:.1e}, largest output {largest:.1f}")
    return lines, gap


def run_voxelnet(arguments: Sequence[str]) -> int:
    """VoxelNet's middle layers, dense and sparse with the same weights: how far apart, how much memory, how long.

        python benchmarks/operators.py voxelnet [--repeats 3] [--threads 2]

    First at a small grid, in evaluation and in training, against the same layers in float64; then forward at the full
    1256 x 504 x 10 voxels of one simulated frame, each mode in a process of its own for its peak memory. The dense one
    takes about 6 GiB. Exit status 1 where the two modes differ by 1e-4 or more.
    """
    parser = part_parser(run_voxelnet.__doc__)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--small", action="store_true", help="only at the small grid")
    options = parser.parse_args(arguments)
    torch.set_num_threads(options.threads)
    small, small_gap = small_comparison()
    full, full_gap = ([], 0.0) if options.small else full_comparison(options.threads, options.repeats)
    met = max(small_gap, full_gap) < VOXELNET_TOLERANCE
    shape = " x ".join(map(str, SMALL_SHAPE))
    lines = [f"load     {os.getloadavg()[0]:.1f} (1 min)", ""]
    lines += [f"largest differences, {shape} cells, 2 frames, {SMALL_VOXELS} voxels; gradients and statistics"]
    lines += ["relative to the largest of their kind where that is above 1", *small, "", *full, ""]
    lines += [f"required: dense and sparse agree to {VOXELNET_TOLERANCE}: {'met' if met else 'NOT MET'}"]
    print("\n".join(lines))
    return int(not met)


if __name__ == "__main__":
    raise SystemExit(
        run_parts(
            __doc__,
            {
                "iou": Part(run_iou, "--pairs 4000 --repeats 1"),
                "layers": Part(run_layers, "--rounds 1 --first 4"),
                "voxelnet": Part(run_voxelnet, "--small --threads 1", exact=True),
            },
        )
    )

"""VoxelNet's middle layers, dense and sparse with the same weights: how far apart, how much memory, how long.

    python benchmarks/voxelnet_middle.py [--repeats 3] [--threads 2] [--output benchmarks/results/voxelnet_middle.txt]

First at a small grid, in evaluation and in training, against the same layers in float64; then forward at the full
1256 x 504 x 10 voxels of one simulated frame, each mode in a process of its own for its peak memory. The dense one
takes about 6 GiB. Exit status 1 where the two modes differ by 1e-4 or more.
"""

import argparse
import copy
import json
import multiprocessing
import os
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from _report import header

from farfield.detectors.inputs import cloud_tensor
from farfield.detectors.sparse import SparseTensor
from farfield.detectors.voxelnet.middle import MiddleLayers
from farfield.detectors.voxelnet.network import VoxelNet, VoxelNetConfig
from farfield.files.atomic import write_text
from farfield.simulation import simulate_sequence

TOLERANCE = 1e-4
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


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "results" / "voxelnet_middle.txt")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    small, small_gap = small_comparison()
    full, full_gap = full_comparison(arguments.threads, arguments.repeats)
    met = max(small_gap, full_gap) < TOLERANCE
    shape = " x ".join(map(str, SMALL_SHAPE))
    lines = [header(), f"load     {os.getloadavg()[0]:.1f} (1 min)", ""]
    lines += [f"largest differences, {shape} cells, 2 frames, {SMALL_VOXELS} voxels; gradients and statistics"]
    lines += ["relative to the largest of their kind where that is above 1", *small, "", *full, ""]
    lines += [f"required: dense and sparse agree to {TOLERANCE}: {'met' if met else 'NOT MET'}"]
    text = "\n".join(lines) + "\n"
    print(text, end="")
    write_text(arguments.output, text)
    return 0 if met else 1


if __name__ == "__main__":
    raise SystemExit(main())

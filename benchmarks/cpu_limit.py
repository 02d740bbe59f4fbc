"""The CPU's limit: from points to boxes by stage and runtime, on one machine in one run, beside each detector's floor.

``runtimes`` times torch in bf16 and fp32 and onnxruntime with one thread and with two; ``floors`` states the
multiplications of a frame and the bytes of weights and maps, and the time for them at this machine's measured rates.
"""

import os
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from _report import MissingError, Part, child_output, load_printed, part_parser, run_parts
from streaming import clouds

import farfield as ff

AIMS_MS: dict[str, tuple[float, ...]] = {
    "pointpillars-cirrus-sim": (40.0, 60.0),
    "second-cirrus-sim": (120.0,),
    "sparsecentre-cirrus-sim": (40.0,),
    "pointrcnn-cirrus-sim": (100.0,),
    "voxelnet-cirrus-sim": (200.0,),
}
"""By whichever runtime; of PointPillars in bf16 and in fp32."""
RUNTIMES = ("torch bf16", "torch fp32", "onnxruntime")


def runtimes(arguments: Sequence[str]) -> int:
    """Milliseconds by stage: reading, preparing, network, boxes; each runtime and number of threads in its process."""
    parser = part_parser(runtimes.__doc__)
    parser.add_argument("--points", type=int, default=60_000)
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--detectors", nargs="+", default=[*AIMS_MS])
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--keep", type=Path, help="folder of exported files; a temporary one unless given")
    parser.add_argument("--one", nargs=4, help="runtime, threads, weights, file: what the processes are told")
    options = parser.parse_args(arguments)
    if options.one:
        _timed(*options.one, points=options.points, repeats=options.repeats)
        return 0
    print(f"median ms of {options.repeats} frames of {options.points:,} points\n")
    with load_printed(), tempfile.TemporaryDirectory() as temporary:
        for weights in options.detectors:
            path = Path(options.keep or temporary) / f"{weights}.onnx"
            try:
                if not path.exists():
                    ff.export(weights, path)
            except ImportError as error:
                raise MissingError(str(error)) from error
            print(f"{weights}: aim {' and '.join(f'{aim:g}' for aim in AIMS_MS.get(weights, ()))} ms")
            for threads in options.threads:
                for runtime in RUNTIMES:
                    limits = {"OMP_NUM_THREADS": str(threads), "MKL_NUM_THREADS": str(threads)}
                    words = ("--points", options.points, "--repeats", options.repeats)
                    one = ("--one", runtime, threads, weights, path)
                    print(
                        f"  {runtime:<12} {threads} threads: {child_output(*words, *one, environment=limits).strip()}"
                    )
    return 0


def _timed(runtime: str, threads: str, weights: str, path: str, *, points: int, repeats: int) -> None:
    """Print the stages of one runtime."""
    cloud = next(clouds(1, points))
    if runtime == "onnxruntime":
        stages = _onnx_stages(ff.load_detector(path), cloud)
    else:
        import torch

        torch.set_num_threads(int(threads))
        detector = ff.load_detector(weights, device="cpu", precision=runtime.split()[1])
        stages = _torch_stages(detector, cloud)
    times = [_run(stages) for _ in range(repeats + 3)][3:]
    medians = {name: float(np.median([one[name] for one in times])) for name in times[0]}
    parts = ", ".join(f"{name} {ms:.1f}" for name, ms in medians.items())
    print(f"{sum(medians.values()):.1f} ms ({parts})")


def _run(stages: Mapping[str, Callable[[Any], Any]]) -> dict[str, float]:
    """Milliseconds of stages, each fed with what the one before gives."""
    value, times = None, {}
    for name, stage in stages.items():
        start = time.perf_counter()
        value = stage(value)
        times[name] = (time.perf_counter() - start) * 1000
    return times


def _onnx_stages(detector: Any, cloud: Any) -> dict[str, Callable[[Any], Any]]:
    reading = detector.record.reading
    spent = [0.0]

    def run(tensors: Any) -> Any:
        start = time.perf_counter()
        outputs = detector.run(tensors)
        spent[0] += time.perf_counter() - start
        return outputs

    return {
        "columns": lambda _: detector.points_of(cloud),
        "prepare": lambda points: (points, reading.inputs(points)),
        "network": lambda both: (both[0], reading.detect(both[0], run, both[1])),
        "boxes": lambda both: detector.finished(*both),
    }


def _torch_stages(detector: Any, cloud: Any) -> dict[str, Callable[[Any], Any]]:
    import torch

    from farfield.detectors import Inputs
    from farfield.detectors.inputs import cloud_tensor

    network = detector.network

    def encode(batch: Any) -> Any:
        with torch.no_grad():
            return network.encode(batch)

    def head(features: Any) -> Any:
        with torch.no_grad():
            return network.head(features, None)

    return {
        "columns": lambda _: Inputs({"points": [cloud_tensor(cloud, detector.columns)]}),
        "encode": encode,
        "head": head,
        "boxes": network.decode,
    }


def floors(arguments: Sequence[str]) -> int:
    """Multiplications of a frame and bytes of weights and maps, and the least time for them at this machine's rates."""
    parser = part_parser(floors.__doc__)
    parser.add_argument("--points", type=int, default=60_000)
    parser.add_argument("--size", type=int, default=2048, help="of the matrices that measure the rate")
    parser.add_argument("--detectors", nargs="+", default=[*AIMS_MS])
    options = parser.parse_args(arguments)
    import torch
    from torch.utils.flop_counter import FlopCounterMode

    rates = {name: _flops(options.size, dtype) for name, dtype in (("fp32", torch.float32), ("bf16", torch.bfloat16))}
    copied = torch.empty(options.size * options.size * 4)
    start = time.perf_counter()
    for _ in range(10):
        copied.clone()
    bytes_s = 10 * 2 * copied.nbytes / (time.perf_counter() - start)
    shown = ", ".join(f"{name} {rate / 1e9:.0f} GFLOP/s" for name, rate in rates.items())
    print(f"{os.cpu_count()} cores, {torch.get_num_threads()} threads: {shown}, memory {bytes_s / 1e9:.1f} GB/s\n")
    cloud = next(clouds(1, options.points))
    for weights in options.detectors:
        detector = ff.load_detector(weights, device="cpu", precision="fp32")
        moved = [sum(value.nbytes for value in detector.network.state_dict().values())]
        leaves = [module for module in detector.network.modules() if not list(module.children())]
        hooks = [module.register_forward_hook(partial(_note_bytes, moved)) for module in leaves]
        with FlopCounterMode(display=False) as counter:
            detector(cloud)
        for hook in hooks:
            hook.remove()
        work, data = counter.get_total_flops(), sum(moved)
        least = {name: 1000 * max(work / rate, data / bytes_s) for name, rate in rates.items()}
        text = ", ".join(f"{name} at least {ms:.0f} ms" for name, ms in least.items())
        print(f"{weights:<26} {work / 1e9:6.1f} GFLOP, {data / 1e6:6.0f} MB: {text}")
    return 0


def _note_bytes(moved: list[int], module: Any, inputs: Any, out: Any) -> None:
    """Note the bytes of a layer's map, written once and read once."""
    del module, inputs
    moved.append(2 * int(getattr(out, "nbytes", 0)))


def _flops(size: int, dtype: Any) -> float:
    """Operations a second of a product of two square matrices, the best of five."""
    import torch

    a = torch.randn(size, size).to(dtype)
    best = float("inf")
    for _ in range(5):
        start = time.perf_counter()
        a @ a
        best = min(best, time.perf_counter() - start)
    return 2 * size**3 / best


PARTS = {
    "runtimes": Part(runtimes, "--points 2000 --repeats 1 --threads 1 --detectors pointpillars-cirrus-sim"),
    "floors": Part(floors, "--points 2000 --size 128 --detectors pointpillars-cirrus-sim"),
}

if __name__ == "__main__":
    raise SystemExit(run_parts(__doc__, PARTS))

"""Float32 and bfloat16 on this processor, and as one without bfloat16 instructions would run them; what auto chooses.

usage: python benchmarks/cpu_precision.py [--points 60000] [--frames 6] [--rounds 3]

oneDNN, which multiplies for torch on a CPU, is told by ONEDNN_MAX_CPU_ISA which instructions it may use: AVX512_CORE
are those of processors with AVX-512 alone. Those without AVX-512 have nothing to choose. Numbers are the processor time
of one thread, so that other programs do not count; each kind is a process of its own, and kinds take turns.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from typing import Any

import numpy as np
from _report import header

KINDS = {"as it is": "", "AVX-512 alone": "AVX512_CORE"}
NAMES = tuple(f"{name}-cirrus-sim" for name in ("pointpillars", "second", "sparsecentre", "pointrcnn", "voxelnet"))


def measured(names: list[str], points: int, frames: int) -> dict[str, list[float]]:
    """Milliseconds of processor time a frame, by detector and number type; runs in a process of its own."""
    import torch
    from detector_speed import busy_cloud

    from farfield.detectors.runtime import Detector

    torch.set_num_threads(1)
    cloud, taken = busy_cloud(points, seed=1), {}
    for name in names:
        for precision in ("fp32", "bf16"):
            detector, times = Detector.load(name, precision=precision, device="cpu"), []
            for _ in range(frames + 1):
                began = time.process_time()
                detector(cloud)
                times.append(1e3 * (time.process_time() - began))
            taken[f"{name} {precision}"] = times[1:]
    return taken


def choices(names: list[str]) -> dict[str, str]:
    """What auto takes by detector, and why, where torch sees what oneDNN may use."""
    from farfield.detectors import DETECTORS
    from farfield.detectors.devices import chosen_precision, flags_of_cpu

    flags = {"": flags_of_cpu(), "AVX512_CORE": {"avx512": True}}[os.environ.get("ONEDNN_MAX_CPU_ISA", "")]
    networks = {name: DETECTORS[name.removesuffix("-cirrus-sim")].network_class for name in names}
    return {name: ": ".join(chosen_precision(network, flags)) for name, network in networks.items()}


def in_process(isa: str, options: argparse.Namespace, what: str = "--measured") -> dict[str, Any]:
    """The measurement, or the choices, under an instruction set."""
    words = [sys.executable, __file__, what, "--points", str(options.points), "--frames", str(options.frames)]
    environment = {**os.environ, **({"ONEDNN_MAX_CPU_ISA": isa} if isa else {})}
    done = subprocess.run([*words, "--detectors", *options.detectors], env=environment, check=True, capture_output=True)
    return json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--detectors", nargs="+", default=list(NAMES))
    parser.add_argument("--points", type=int, default=60_000)
    parser.add_argument("--frames", type=int, default=6, help="frames of a round")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--measured", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--chosen", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measured or options.chosen:
        inner = (
            measured(options.detectors, options.points, options.frames)
            if options.measured
            else choices(options.detectors)
        )
        print(json.dumps(inner))
        return
    print(header(), "\n", sep="")
    taken: dict[tuple[str, str], list[float]] = {}
    for _ in range(options.rounds):
        for kind, isa in KINDS.items():
            for key, times in in_process(isa, options).items():
                taken.setdefault((kind, key), []).extend(times)
    chosen = {kind: in_process(isa, options, "--chosen") for kind, isa in KINDS.items()}
    print(f"{options.points} points; ms of processor time a frame, one thread: median (least)")
    print(f"{'detector':<26} {'processor':<14} {'fp32':>14} {'bf16':>14}   auto takes")
    for name in options.detectors:
        for kind in KINDS:
            cells = [
                f"{np.median(times):7.0f} ({min(times):4.0f})"
                for times in (taken[kind, f"{name} {precision}"] for precision in ("fp32", "bf16"))
            ]
            print(f"{name:<26} {kind:<14} {cells[0]:>14} {cells[1]:>14}   {chosen[kind][name]}")


if __name__ == "__main__":
    main()

"""Simulating and writing whole frames: seconds and memory for both rigs.

    python benchmarks/simulated_writing.py [--frames 12] [--output benchmarks/results/simulated_writing.txt]

A Cirrus frame is both patterns, labels, camera and files; a K-Radar frame both Ousters, cube, sparse cloud, front
stereo, labels and files. One process: the median over frames, the world's making left out. Two processes: what the
command takes a frame, all included, worlds and start-up too. Exit status 1 over 0.8 s (Cirrus),
3.5 s (K-Radar) or 2.5 GB.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from _report import header

from farfield.files.atomic import write_text

LIMITS = {"cirrus-sim": 0.8, "kradar-sim": 3.5}
MEMORY_GB = 2.5


def one_process(preset: str, frames: int) -> str:
    """Seconds a frame and peak memory of this process; run in a process of its own."""
    from farfield.simulation import find_preset, simulate_frame
    from farfield.simulation.recording import write_whole

    chosen = find_preset(preset)
    seconds = []
    with tempfile.TemporaryDirectory() as folder:
        for sequence in (0, 1):
            for index in range(frames // 2 + 1):
                start = time.perf_counter()
                frame = simulate_frame(chosen, sequence=sequence, index=index)
                write_whole(chosen, frame, Path(folder), cache=False)
                seconds.append(time.perf_counter() - start)
    first, later = seconds[:: frames // 2 + 1], np.delete(seconds, [0, frames // 2 + 1])
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    return f"{np.median(later):.3f} {later.max():.3f} {max(first):.3f} {peak:.3f}"


def two_processes(preset: str, frames: int) -> float:
    """Seconds a frame of the whole command."""
    from farfield.simulation.recording import record

    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        record(preset, Path(folder) / "out", frames=2 * frames, sequences=2, workers=2)
        return (time.perf_counter() - start) / (2 * frames)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=12)
    parser.add_argument("--only", help="measure one preset in this process and print its four figures")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    if options.only:
        print(one_process(options.only, options.frames))
        return 0
    lines, late = [header(), ""], False
    for preset, limit in LIMITS.items():
        command = [sys.executable, __file__, "--only", preset, "--frames", str(options.frames)]
        subprocess.run(command, check=True, capture_output=True)  # compiles what is not compiled yet
        done = subprocess.run(command, check=True, capture_output=True, text=True, env=os.environ)
        median, worst, first, peak = (float(word) for word in done.stdout.split()[-4:])
        both = two_processes(preset, options.frames)
        lines += [
            f"{preset}, one process: median {median:.2f} s a frame, slowest {worst:.2f} s, with a sequence's world "
            f"{first:.2f} s; peak memory {peak:.2f} GB",
            f"{preset}, two processes, everything included: {both:.2f} s a frame (limit {limit:g} s)",
        ]
        late |= min(median, both) > limit or peak > MEMORY_GB
    text = "\n".join([*lines, ""])
    print(text)
    if options.output:
        write_text(options.output, text)
    return int(late)


if __name__ == "__main__":
    raise SystemExit(main())

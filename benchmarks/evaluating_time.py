"""CPU seconds of ``farfield evaluate`` with and without its page, beside the detector's own.

usage: python benchmarks/evaluating_time.py DATA [DATA ...] [--detector NAME] [--clouds NAMES] [--without FLAGS]

Each run is a process of its own, its workers' time included; wall time says little on a machine that others use too.
``--without`` are the flags that leave the page out, so that a version without ``--no-report`` can be timed as well:
``--without=--shown-frames=0``. "once more" is the same command again: nothing is detected anew.
"""

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from _report import header

DETECTING = """
import sys, time
from farfield.api import load_detector, open_dataset
detector, data, clouds = load_detector(sys.argv[1], device="cpu"), open_dataset(sys.argv[2]), sys.argv[3].split(",")
spent = 0.0
for frame in data:
    for cloud in clouds:
        frame.cloud(cloud)
        began = time.process_time()
        detector.with_cloud(cloud)(frame)
        spent += time.process_time() - began
print(f"{len(data)} {spent}")
"""


def cpu_s(command: list[str]) -> tuple[float, str]:
    """CPU seconds of a command with all its processes, and what it prints."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, done.stdout


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, nargs="+")
    parser.add_argument("--detector", default="pointpillars-cirrus-sim")
    parser.add_argument("--clouds", default="gaussian,uniform")
    parser.add_argument("--without", default="--no-report")
    options = parser.parse_args()
    print(header(), "\n", sep="")
    print("CPU seconds of all processes\n")
    heads = f"{'detector alone':>15} {'with page':>10} {'without':>8} {'once more':>10}"
    print(f"{'frames':>6} {'clouds':>18} {heads}  wall s")
    for data in options.data:
        given = [options.detector, str(data), options.clouds]
        frames, alone = cpu_s([sys.executable, "-c", DETECTING, *given])[1].split()
        spent, began = [], time.monotonic()
        with tempfile.TemporaryDirectory() as folder:
            base = [sys.executable, "-m", "farfield.cli", "evaluate", *given[:2], "--clouds", options.clouds]
            for flags, out in (([], "a"), ([options.without], "b"), ([], "a")):
                spent.append(cpu_s([*base, "--device", "cpu", "--out", str(Path(folder) / out), *flags])[0])
        wall = time.monotonic() - began
        cells = " ".join([f"{spent[0]:10.1f}", f"{spent[1]:8.1f}", f"{spent[2]:10.1f}"])
        print(f"{frames:>6} {options.clouds:>18} {float(alone):15.1f} {cells} {wall:7.0f}", flush=True)


if __name__ == "__main__":
    main()

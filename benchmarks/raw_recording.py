"""A raw recording of a simulated drive, synchronised: clocks that are found against those that are known.

A minute of the Cirrus car's raw streams (two LiDARs fired by the GPS' pulses, a camera and two IMUs that run freely,
GPS), each with a clock of its own, written as a ROS 2 bag, read back and matched as ``farfield sync`` does.

    python benchmarks/raw_recording.py --output benchmarks/results/raw_recording.txt
"""

import argparse
import json
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any

from _report import header, progress

from farfield.pages.sync_page import write_synchronised
from farfield.simulation.presets import find_preset
from farfield.simulation.recording.raw import record_streams
from farfield.sync.sources import recordings

SENSORS = ("gaussian", "uniform", "camera", "imu_front", "imu_rear", "gps")


def against_computer(truth: dict[str, Any], name: str, middle_ns: int) -> tuple[float, float]:
    """True drift in ppm and offset in ms of the computer's clock against a sensor's, the least delay included."""
    stream, computer = truth["streams"][name], truth["computer"]
    read_s = (middle_ns - truth["epoch_ns"]) / 1e9
    true_s = (read_s - stream["offset_ms"] / 1e3) / (1 + stream["drift_ppm"] * 1e-6)
    arrived_s = true_s + stream["least_delay_ms"] / 1e3
    logged_s = arrived_s * (1 + computer["drift_ppm"] * 1e-6) + computer["offset_ms"] / 1e3
    return ((1 + computer["drift_ppm"] * 1e-6) / (1 + stream["drift_ppm"] * 1e-6) - 1) * 1e6, (logged_s - read_s) * 1e3


def arrivals(found: dict[str, Any], truth: dict[str, Any]) -> list[str]:
    """Each clock against the computer's, from stamps and times of recording."""
    lines = ["the computer's clock against each sensor's, from stamps and times of recording of the same messages", ""]
    lines.append(
        "stream     messages  drift ppm: true   found    ± se   error   offset ms: true    found   error  includes"
    )
    for name in SENSORS:
        clock = found["arrivals"].get(f"/{name}")
        if clock is None:
            continue
        drift, offset = against_computer(truth, name, clock["middle_ns"])
        se = clock["drift_se_ppm"] if clock["drift_se_ppm"] is not None else float("nan")
        error, off = clock["drift_ppm"] - drift, clock["offset_ns"] / 1e6 - offset
        lines.append(
            f"{name:<11}{clock['pairs']:>8}{drift:>17.3f}{clock['drift_ppm']:>8.3f}{se:>8.3f}"
            f"{error:>8.3f}{offset:>18.3f}{clock['offset_ns'] / 1e6:>9.3f}{off:>8.3f}  {clock['offset_includes']}"
        )
    return lines


def between(found: dict[str, Any], truth: dict[str, Any]) -> list[str]:
    """One sensor against the other from matched stamps alone."""
    streams, own = truth["streams"], truth["streams"]["gaussian"]
    lines = ["", "each stream matched to /gaussian, from stamps alone", ""]
    lines.append("stream     pairs  worst ms  drift ppm: of the clocks   found   bound   what the stamps tell")
    for name in SENSORS[1:]:
        pair = found["pairs"][f"/{name}"]
        known = streams[name]["drift_ppm"] - own["drift_ppm"]
        clock, told = pair["clock"], "runs freely: its stamps follow its own rate, whatever that is"
        told = "the drift of its clock against the LiDAR's" if not streams[name]["free_running"] else told
        words = f"{'':>8}{'':>8}" if clock is None else f"{clock['drift_ppm']:>8.3f}{clock['bound_ppm']:>8.3f}"
        told = told if clock is not None else "nothing: too few, or no whole ratio of rates"
        lines.append(
            f"{name:<11}{pair['matched']:>5}{pair['residual']['worst_ms']:>10.3f}{known:>26.3f}{words}   {told}"
        )
    clock, other = found["pairs"]["/uniform"]["clock"], streams["uniform"]
    middle_s = (clock["middle_ns"] - truth["epoch_ns"]) / 1e9
    apart = other["offset_ms"] - own["offset_ms"] + other["phase_ms"]
    apart += (other["drift_ppm"] - own["drift_ppm"]) * middle_s * 1e-3
    error = (clock["offset_ns"] / 1e6 - apart + 50) % 100 - 50
    lines += [
        "",
        f"/uniform's stamps are truly {apart:.3f} ms later, up to periods of 100 ms; error {error:+.3f} ms",
    ]
    return lines


def main() -> None:
    """Measure, print, and write with ``--output``."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--output", type=Path)
    parser.add_argument("--sweeps", type=int, default=600)
    options = parser.parse_args()
    preset = find_preset("cirrus-sim-mini", duration_s=options.sweeps / 10 + 1)
    with tempfile.TemporaryDirectory() as folder:
        root, started = Path(folder), time.process_time()
        recorded = record_streams(
            preset,
            root / "raw",
            sweeps=options.sweeps,
            sequences=1,
            workers=1,
            progress=partial(progress, what="files"),
        )
        spent = time.process_time() - started
        size = sum(path.stat().st_size for path in recorded.bags[0].iterdir())
        started = time.process_time()
        write_synchronised(
            root / "sync", recordings(recorded.bags[0]), to="/gaussian", tolerance_ns=None, title="a raw recording"
        )
        read = time.process_time() - started
        found = json.loads((root / "sync" / "sync.json").read_text())["recordings"][0]
        truth = json.loads(recorded.truths[0].read_text())
    lines = [
        header(),
        "",
        f"{options.sweeps / 10:g} s of cirrus-sim-mini, {size / 1e6:.0f} MB: simulated and written",
    ]
    lines[-1] += f" in {spent:.0f} s of CPU, read, matched and drawn in {read:.1f} s"
    lines += ["", *arrivals(found, truth), *between(found, truth)]
    print("\n".join(lines))
    if options.output:
        options.output.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()

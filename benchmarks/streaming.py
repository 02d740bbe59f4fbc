"""Sweeps through ``ff.stream`` at the rate of a sensor: latency p50 and p99, dropped sweeps by rule, memory.

On a machine that does other work latency and drops are those of its load, which is printed; CPU is the stream's own.
"""

import tempfile
import time
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import psutil
from _report import MissingError, Part, load_printed, part_parser, run_parts

import farfield as ff
from farfield.frame import Cloud

WEIGHTS, GROWTH_MB = "pointpillars-cirrus-sim", 60.0


def clouds(count: int, points: int, seed: int = 4) -> Iterator[Cloud]:
    """Sweeps of a flat road with clutter, each another; as many points in each."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        ahead = 250 * rng.uniform(0.01, 1, points) ** 1.5
        across, height = rng.uniform(-0.3, 0.3, points) * ahead, rng.normal(-1.9, 0.05, points)
        yield Cloud(np.column_stack([ahead, across, height]).astype(np.float32))


def rates(arguments: Sequence[str]) -> int:
    """200 sweeps at 10 and at 20 Hz, oldest dropped: latency, drops that are said, and memory that stays."""
    parser = part_parser(rates.__doc__)
    parser.add_argument("--sweeps", type=int, default=200)
    parser.add_argument("--points", type=int, default=60_000)
    parser.add_argument("--rates", type=float, nargs="+", default=[10.0, 20.0])
    parser.add_argument("--detector", default=WEIGHTS)
    parser.add_argument("--keep", type=Path, help="folder of exported files; a temporary one unless given")
    options = parser.parse_args(arguments)
    missed = 0
    with load_printed(), tempfile.TemporaryDirectory() as temporary:
        detectors = {"torch": ff.load_detector(options.detector)}
        path = Path(options.keep or temporary) / f"{options.detector}.onnx"
        try:
            if not path.exists():
                ff.export(options.detector, path)
            detectors["onnxruntime"] = ff.load_detector(path)
        except ff.FarfieldError as error:
            if not isinstance(error, ImportError):
                raise
            raise MissingError(str(error)) from error
        print(f"{options.sweeps} sweeps of {options.points:,} points, {options.detector}; rule: the oldest is dropped")
        for name, detector in detectors.items():
            for rate_hz in options.rates:
                missed |= _one(name, detector, rate_hz, options.sweeps, options.points)
    return missed


def _one(name: str, detector: object, rate_hz: float, sweeps: int, points: int) -> int:
    ready = list(clouds(min(sweeps, 20), points))  # made before: a sensor's sweeps cost no processor
    source = (ready[number % len(ready)] for number in range(sweeps))
    process, memory_mb, before_s = psutil.Process(), list[float](), time.process_time()
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        stream = ff.stream(detector, source, rate_hz=rate_hz, drop="oldest")  # type: ignore[arg-type]
        for _ in stream:
            memory_mb.append(process.memory_info().rss / 1e6)
    warm = memory_mb[len(memory_mb) // 4 :]
    growth_mb = warm[-1] - warm[0] if warm else 0.0
    memory = f"memory {memory_mb[-1]:.0f} MB, {growth_mb:+.0f} MB since a quarter"
    cpu_ms = 1000 * (time.process_time() - before_s) / max(stream.report.detected, 1)
    print(f"{name:<12} {rate_hz:4g} Hz: {stream.report}; {memory}; {cpu_ms:.0f} ms of CPU for a sweep's boxes")
    print(f"{'':<12} said: {next((str(warning.message) for warning in told), 'nothing, since none was dropped')}")
    unsaid = stream.report.dropped > 0 and not told
    return int(unsaid or growth_mb > GROWTH_MB)


PARTS = {"rates": Part(rates, "--sweeps 4 --points 2000 --rates 5")}

if __name__ == "__main__":
    raise SystemExit(run_parts(__doc__, PARTS))

"""``farfield demo``."""

import time
from functools import partial
from pathlib import Path

from farfield.cli._progress import bar

_START_S, _FRAME_S = 15.0, 1.5  # two cores of an AMD EPYC: imports and the page; simulating and searching a frame


def seconds_of(frames: int) -> float:
    """About how long so many frames take on two cores."""
    return _START_S + _FRAME_S * frames


def run(*, out: Path = Path("farfield-demo"), sequences: int = 4, frames: int = 20, seed: int = 2026) -> int:
    """Simulate, detect, score and report: the main job from end to end, with no data and no GPU.

    examples:
      farfield demo
      farfield demo --frames 60 --sequences 6 --out my-demo

    Two-pattern LiDAR frames of roads that the detector has never seen are simulated and written as Cirrus files,
    checked by the doctor, searched for vehicles to 250 m with the bundled weights, scored with DDS and wDDS by range,
    and shown on one HTML page.

    Args:
        out: Folder for the frames and the report.
        sequences: Number of roads; highway and town take turns.
        frames: Number of frames in all.
        seed: Another seed gives other roads and traffic.
    """
    from farfield.cli import doctor, evaluate
    from farfield.recording import record

    began = time.monotonic()
    minutes = max(1, round(seconds_of(frames) / 60))
    about = f"{minutes} {'minute' if minutes == 1 else 'minutes'}"
    print(f"{frames} frames of {sequences} roads: about {about} on two cores\n", flush=True)
    data = out / f"simulated-{seed}-{sequences}x{frames}"
    print("1/3 simulating", flush=True)
    simulating = partial(bar, what="simulating", transient=True)
    record("cirrus-sim", data, frames=frames, sequences=sequences, seed=seed, progress=simulating, report=print)
    print("\n2/3 checking the files", flush=True)
    status = doctor.run(data)
    print("\n3/3 detecting, scoring, drawing", flush=True)
    evaluate.run("pointpillars-cirrus-sim", data, clouds="gaussian,uniform", out=out / "evaluation")
    print(f"done in {time.monotonic() - began:.0f} s")
    print(f"report: {(out / 'evaluation' / 'report.html').resolve()}")
    return status

"""How many frames a CPU second the tracker takes: filter, association, births and deaths, 30 tracks a frame.

Several drives run as one batch, one frame of each a step. Reading and writing are not in it.

    python benchmarks/tracking_speed.py
"""

import time

import numpy as np
from _report import header
from jaxtyping import Float

from farfield.tracking import PRESETS
from farfield.tracking.tracker import DetectionBatch, TrackEngine

TRACKS, STEPS = 30, 200


def frames(drives: int, rng: np.random.Generator) -> list[DetectionBatch]:
    """Detections of cars that drive side by side, 5 % missed."""
    n = drives * TRACKS
    place: Float[np.ndarray, "n 2"] = rng.uniform([0, -50], [200, 50], (n, 2))
    speed = rng.uniform(-1, 1, (n, 2)) * [1.5, 0.1]
    drive = np.repeat(np.arange(drives), TRACKS)
    steps = []
    for number in range(STEPS):
        kept = rng.random(n) > 0.05
        here = place + number * speed + rng.normal(0, 0.1, (n, 2))
        rows = np.column_stack([here, np.zeros(n), np.tile([4.2, 1.8, 1.5, 0.0], (n, 1))])
        m = int(kept.sum())
        seen = DetectionBatch(
            drive=drive[kept],
            rows=rows[kept],
            velocity_m_s=np.zeros((m, 2)),
            ray_m=here[kept],
            score=np.ones(m),
            label=np.zeros(m, dtype=np.int64),
            source=np.arange(m),
        )
        steps.append(seen)
    return steps


def main() -> None:
    """Print frames a CPU second by preset and number of drives."""
    print(header())
    print(f"one thread; {TRACKS} cars a frame")
    for name in ("ab3dmot-paper", "default", "centerpoint", "ab3dmot"):
        for drives in (1, 10, 50):
            steps = frames(drives, np.random.default_rng(0))
            engine = TrackEngine(PRESETS[name], drives=drives, labels=("car",))
            dt, running = np.full(drives, 0.1), np.ones(drives, dtype=bool)
            steps = steps if name != "ab3dmot" or drives < 50 else steps[:40]
            start = time.process_time()
            for seen in steps:
                engine.step(seen, dt, running)
            rate = len(steps) * drives / (time.process_time() - start)
            print(f"{name:14} {drives:3} drives: {rate:8,.0f} frames a CPU second, {len(engine.tracks)} tracks")


if __name__ == "__main__":
    main()

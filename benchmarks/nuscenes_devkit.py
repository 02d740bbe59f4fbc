"""Compare the ``nuscenes`` protocol with nuscenes-devkit 1.2.0: equal figures, and the time and memory of both.

    python benchmarks/nuscenes_devkit.py [--env FOLDER] [--repeats 3] [--frames 6000]

The devkit needs numpy < 2, so it gets an environment of its own (built at the first run). Both sides run in processes
of their own, in turns, and are timed from boxes in memory (EvalBoxes there, Boxes here) to the matches and the AP of
all four thresholds and the errors at 2 m. Both are single-threaded; the ratio is taken of processor time, which
another job on the machine disturbs less than it does the clock.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
import venv
from pathlib import Path
from typing import Any

import numpy as np

REQUIREMENTS = ("nuscenes-devkit==1.2.0", "numpy<2")
THRESHOLDS_M = (0.5, 1.0, 2.0, 4.0)
ERRORS = ("trans_err", "scale_err", "orient_err")
SHARED = Path(__file__).resolve().parents[2] / "shared" / "real" / "kitti_tracking"
COLUMNS = ("frame", "centre_m", "size_m", "yaw_rad", "score")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--env", type=Path, default=Path(tempfile.gettempdir()) / "farfield-nuscenes-devkit")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--frames", type=int, default=6000)
    parser.add_argument("--detections", type=Path, default=SHARED / "detections_pointrcnn_car")
    parser.add_argument("--labels", type=Path, default=SHARED / "label")
    parser.add_argument("--worker", choices=["devkit", "farfield"], help=argparse.SUPPRESS)
    parser.add_argument("scene", nargs="?", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.worker:
        print(json.dumps({"devkit": run_devkit, "farfield": run_farfield}[arguments.worker](arguments.scene)))
        return 0
    from _report import header

    print(header(), flush=True)
    python = devkit_python(arguments.env)
    passed = True
    with tempfile.TemporaryDirectory() as folder:
        scenes = {f"{arguments.frames} frames x 20 annotated x 50 predicted": random_scene(arguments.frames)}
        if arguments.labels.is_dir():
            scenes = {"PointRCNN on KITTI tracking": shared_scene(arguments.detections, arguments.labels)} | scenes
        for number, (name, scene) in enumerate(scenes.items()):
            path = Path(folder) / f"{number}.npz"
            np.savez(path, **scene)
            passed &= compare(name, path, python, arguments.repeats)
    return 0 if passed else 1


def devkit_python(env: Path) -> Path:
    """Build the devkit's environment unless it is there, and return its interpreter."""
    python = env / "bin" / "python"
    done = env / ".installed"
    if not done.exists():
        print(f"building {env.name} with {', '.join(REQUIREMENTS)}", flush=True)
        venv.create(env, with_pip=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", *REQUIREMENTS], check=True)
        done.touch()
    return python


def random_scene(frames: int, *, seed: int = 2026) -> dict[str, np.ndarray]:
    """20 annotated boxes a frame; 50 predictions: each box found about once, with errors, and false ones."""
    rng = np.random.default_rng(seed)
    annotated = {
        "frame": np.repeat(np.arange(frames), 20),
        "centre_m": rng.uniform([0, -50, -1], [250, 50, 1], (frames * 20, 3)),
        "size_m": rng.normal([4.5, 1.9, 1.7], [0.4, 0.1, 0.1], (frames * 20, 3)),
        "yaw_rad": rng.uniform(-np.pi, np.pi, frames * 20),
        "score": np.zeros(frames * 20),
    }
    source = (rng.integers(0, 20, (frames, 50)) + 20 * np.arange(frames)[:, None]).ravel()
    spread_m = rng.choice([0.3, 1.0, 10.0], (len(source), 1), p=[0.5, 0.25, 0.25])
    predicted = {
        "frame": annotated["frame"][source],
        "centre_m": annotated["centre_m"][source] + rng.normal(0, 1, (len(source), 3)) * spread_m,
        "size_m": annotated["size_m"][source] * rng.uniform(0.9, 1.1, (len(source), 3)),
        "yaw_rad": annotated["yaw_rad"][source] + rng.normal(0, 0.1, len(source)),
        "score": np.round(np.clip(rng.uniform(0.3, 1, len(source)) / np.sqrt(1 + spread_m[:, 0]), 0.001, 1), 4),
    }
    return pack(annotated, predicted, frames)


def shared_scene(detections: Path, labels: Path) -> dict[str, np.ndarray]:
    """Cars of the shared files; scores through a sigmoid, as the devkit wants them in (0, 1)."""
    from farfield.metrics.box_files import read
    from farfield.metrics.frames import flatten, frame_order

    found = read(detections, labels, format="kitti-tracking")
    keys = sorted(found.annotations, key=frame_order)
    sides = []
    for boxes, scored in ((found.annotated, False), (found.boxes, True)):
        present = [(number, boxes[key]) for number, key in enumerate(keys) if key in boxes]
        flat = flatten([part for _, part in present], scored=scored)
        car = flat.label == "Car"
        frame = np.repeat([number for number, _ in present], [len(part) for _, part in present])
        score = np.zeros(len(flat)) if flat.score is None else 1 / (1 + np.exp(-flat.score))
        values = (frame, flat.centre_m, flat.size_m, flat.yaw_rad, score)
        sides.append({name: value[car] for name, value in zip(COLUMNS, values, strict=True)})
    return pack(*sides, len(keys))


def pack(annotated: dict[str, np.ndarray], predicted: dict[str, np.ndarray], frames: int) -> dict[str, np.ndarray]:
    packed = {f"annotated_{name}": value for name, value in annotated.items()}
    return packed | {f"predicted_{name}": value for name, value in predicted.items()} | {"frames": np.array(frames)}


def unpack(path: Path, side: str) -> list[dict[str, np.ndarray]]:
    """The boxes of each frame."""
    with np.load(path, allow_pickle=False) as scene:
        columns = {name: scene[f"{side}_{name}"] for name in COLUMNS}
        cuts = np.searchsorted(columns["frame"], np.arange(1, int(scene["frames"])))
    parts = {name: np.split(value, cuts) for name, value in columns.items()}
    return [dict(zip(parts, values, strict=True)) for values in zip(*parts.values(), strict=True)]


class Stopwatch:
    """Clock and processor time since it was made."""

    def __init__(self) -> None:
        self.wall_s, self.cpu_s = time.perf_counter(), time.process_time()

    def times(self) -> dict[str, float]:
        """Seconds by the clock and of processor time."""
        return {"wall_s": time.perf_counter() - self.wall_s, "cpu_s": time.process_time() - self.cpu_s}


def measured(times: dict[str, float], ap: dict[float, float], errors: dict[str, float]) -> dict[str, Any]:
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {**times, "peak_mb": peak_mb, "figures": {f"AP {k}": v for k, v in ap.items()} | errors}


def run_devkit(path: Path) -> dict[str, Any]:
    from nuscenes.eval.common.data_classes import EvalBoxes
    from nuscenes.eval.common.utils import center_distance
    from nuscenes.eval.detection.algo import accumulate, calc_ap, calc_tp
    from nuscenes.eval.detection.data_classes import DetectionBox
    from pyquaternion import Quaternion

    def boxes(side: str) -> EvalBoxes:
        held = EvalBoxes()
        for number, frame in enumerate(unpack(path, side)):
            rows = zip(*(frame[name].tolist() for name in COLUMNS[1:]), strict=True)
            found = [
                DetectionBox(
                    sample_token=f"{number:06d}",
                    translation=tuple(centre),
                    size=(size[1], size[0], size[2]),
                    rotation=tuple(Quaternion(axis=(0, 0, 1), radians=yaw).elements),
                    velocity=(0.0, 0.0),
                    detection_name="car",
                    detection_score=score if side == "predicted" else -1.0,
                )
                for centre, size, yaw, score in rows
            ]
            held.add_boxes(f"{number:06d}", found)
        return held

    annotated, predicted = boxes("annotated"), boxes("predicted")
    watch = Stopwatch()
    data = {t: accumulate(annotated, predicted, "car", center_distance, t) for t in THRESHOLDS_M}
    ap = {t: float(calc_ap(data[t], 0.1, 0.1)) for t in THRESHOLDS_M}
    errors = {name: float(calc_tp(data[2.0], 0.1, name)) for name in ERRORS}
    return measured(watch.times(), ap, errors)


def run_farfield(path: Path) -> dict[str, Any]:
    from farfield.geometry.boxes import Boxes
    from farfield.metrics import Bootstrap, NuScenesSettings, evaluate_nuscenes

    def boxes(side: str) -> dict[tuple[str, str], Boxes]:
        held = {}
        for number, frame in enumerate(unpack(path, side)):
            values = {name: frame[name] for name in ("centre_m", "size_m", "yaw_rad")}
            score = frame["score"] if side == "predicted" else None
            held["", f"{number:06d}"] = Boxes(**values, label="car", score=score)
        return held

    annotated, predicted = boxes("annotated"), boxes("predicted")
    settings = NuScenesSettings(range_bins_m=(0.0, np.inf), bootstrap=Bootstrap(replicates=0))
    watch = Stopwatch()
    result = evaluate_nuscenes(predicted, annotated, settings)
    times = watch.times()
    figures = result.figures
    ap = {t: float(figures[f"ap/{t}"] or 0) for t in THRESHOLDS_M}
    return measured(times, ap, {name: float(figures[f"errors/{name}"] or 0) for name in ERRORS})


def compare(name: str, scene: Path, devkit: Path, repeats: int) -> bool:
    """Run both in turns, print their figures, and return whether they agree and the devkit takes 20 times as long."""
    runs: dict[str, list[dict[str, Any]]] = {"devkit": [], "farfield": []}
    for _ in range(repeats):
        for side, python in (("devkit", devkit), ("farfield", Path(sys.executable))):
            done = subprocess.run(
                [python, Path(__file__), "--worker", side, scene], check=True, capture_output=True, text=True
            )
            runs[side].append(json.loads(done.stdout.splitlines()[-1]))
    print(f"\n{name}")
    median: dict[str, dict[str, float]] = {}
    for side, found in runs.items():
        median[side] = {name: float(np.median([run[name] for run in found])) for name in ("cpu_s", "wall_s")}
        listed = ", ".join(f"{run['cpu_s']:.3f}" for run in found)
        times = f"processor time {median[side]['cpu_s']:8.3f} s ({listed}), clock {median[side]['wall_s']:8.3f} s"
        print(f"  {side:<9} {times}, peak RSS {found[0]['peak_mb']:6.0f} MB", flush=True)
    theirs, ours = (runs[side][0]["figures"] for side in ("devkit", "farfield"))
    for figure, value in theirs.items():
        difference = ours[figure] - value
        print(f"  {figure:<11} devkit {value:.12f}   farfield {ours[figure]:.12f}   difference {difference:+.1e}")
    worst = max(abs(ours[figure] - value) for figure, value in theirs.items())
    ratio = {name: median["devkit"][name] / median["farfield"][name] for name in ("cpu_s", "wall_s")}
    passed = worst < 1e-6 and ratio["cpu_s"] >= 20
    print(
        f"  the devkit takes {ratio['cpu_s']:.1f} times the processor time ({ratio['wall_s']:.1f} times by the clock)"
    )
    print(f"  largest difference {worst:.1e}: {'pass' if passed else 'FAIL'}", flush=True)
    return passed


if __name__ == "__main__":
    raise SystemExit(main())

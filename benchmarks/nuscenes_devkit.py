"""The ``nuscenes`` protocols beside nuscenes-devkit 1.2.0: equal figures, and the time of both.

The kit needs numpy < 2, so it gets an environment of its own, built at the first run. Its Python runs this file
too, with ``--worker``, and has no farfield.
"""

import json
import resource
import subprocess
import sys
import tempfile
import time
import venv
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import _nuscenes_task
import numpy as np

REQUIREMENTS = ("nuscenes-devkit==1.2.0", "motmetrics==1.4.0", "pandas<3", "numpy<2")
ENVIRONMENT = Path(tempfile.gettempdir()) / "farfield-nuscenes-devkit"
THRESHOLDS_M = (0.5, 1.0, 2.0, 4.0)
ERRORS = ("trans_err", "scale_err", "orient_err")
SHARED = Path(__file__).resolve().parents[2] / "shared" / "real" / "kitti_tracking"
COLUMNS = ("frame", "centre_m", "size_m", "yaw_rad", "score")


def run_detection(arguments: Sequence[str]) -> int:
    """Compare the ``nuscenes`` protocol with nuscenes-devkit 1.2.0: equal figures, and the time and memory of both.

        python benchmarks/nuscenes_devkit.py detection [--env FOLDER] [--repeats 3] [--frames 6000]

    Both sides run in processes of their own, in turns, and are timed from boxes in memory (EvalBoxes there, Boxes
    here) to the matches
    and the AP of all four thresholds and the errors at 2 m. Both are single-threaded; the ratio is taken of processor
    time, which another job on the machine disturbs less than it does the clock.
    """
    from _report import part_parser

    parser = part_parser(run_detection.__doc__)
    parser.add_argument("--env", type=Path, default=ENVIRONMENT, help="of the kit")
    parser.add_argument("--without-kit", action="store_true", help="only our side")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--frames", type=int, default=6000)
    parser.add_argument("--detections", type=Path, default=SHARED / "detections_pointrcnn_car")
    parser.add_argument("--labels", type=Path, default=SHARED / "label")
    options = parser.parse_args(arguments)
    python = None if options.without_kit else kit_python(options.env)
    passed = True
    with tempfile.TemporaryDirectory() as folder:
        scenes = {f"{options.frames} frames x 20 annotated x 50 predicted": detection_random_scene(options.frames)}
        if options.labels.is_dir():
            scenes = {"PointRCNN on KITTI tracking": shared_scene(options.detections, options.labels)} | scenes
        for number, (name, scene) in enumerate(scenes.items()):
            path = Path(folder) / f"{number}.npz"
            np.savez(path, **scene)
            passed &= detection_compare(name, path, python, options.repeats)
    return 0 if passed else 1


def kit_python(env: Path) -> Path:
    """Build the kit's environment unless it is there, and return its interpreter."""
    python = env / "bin" / "python"
    done = env / ".installed"
    if not done.exists():
        print(f"building {env.name} with {', '.join(REQUIREMENTS)}", flush=True)
        venv.create(env, with_pip=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", *REQUIREMENTS], check=True)
        done.touch()
    return python


def detection_random_scene(frames: int, *, seed: int = 2026) -> dict[str, np.ndarray]:
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


def detection_run_devkit(path: Path) -> dict[str, Any]:
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
    settings = NuScenesSettings(ties="later_first", range_bins_m=(0.0, np.inf), bootstrap=Bootstrap(replicates=0))
    watch = Stopwatch()
    result = evaluate_nuscenes(predicted, annotated, settings)
    times = watch.times()
    figures = result.figures
    ap = {t: float(figures[f"ap/{t}"] or 0) for t in THRESHOLDS_M}
    return measured(times, ap, {name: float(figures[f"errors/{name}"] or 0) for name in ERRORS})


def worker_output(python: Path, side: str, scene: Path) -> Any:
    """What one side gives in a process of its own."""
    command = [python, Path(__file__), "--worker", side, scene]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return json.loads(done.stdout.splitlines()[-1])


def detection_compare(name: str, scene: Path, kit: Path | None, repeats: int) -> bool:
    """Run both in turns, print their figures, and return whether they agree and the devkit takes 20 times as long."""
    pythons = {"farfield": Path(sys.executable)} if kit is None else {"devkit": kit, "farfield": Path(sys.executable)}
    runs: dict[str, list[dict[str, Any]]] = {side: [] for side in pythons}
    for _ in range(repeats):
        for side, python in pythons.items():
            runs[side].append(worker_output(python, side, scene))
    print(f"\n{name}")
    median: dict[str, dict[str, float]] = {}
    for side, found in runs.items():
        median[side] = {name: float(np.median([run[name] for run in found])) for name in ("cpu_s", "wall_s")}
        listed = ", ".join(f"{run['cpu_s']:.3f}" for run in found)
        times = f"processor time {median[side]['cpu_s']:8.3f} s ({listed}), clock {median[side]['wall_s']:8.3f} s"
        print(f"  {side:<9} {times}, peak RSS {found[0]['peak_mb']:6.0f} MB", flush=True)
    if kit is None:
        print(
            "".join(
                f"  {figure:<11} farfield {value:.12f}\n" for figure, value in runs["farfield"][0]["figures"].items()
            )
        )
        return True
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


KITTI = ("0003", "0017")  # the kit takes minutes for all ten sequences
_NAMES = {
    "AMOTA": "amota",
    "AMOTP": "amotp",
    "MOTA": "mota",
    "MOTP": "motp",
    "MOTAR": "motar",
    "recall": "recall",
    "TP": "tp",
    "FP": "fp",
    "FN": "fn",
    "IDS": "ids",
    "FRAG": "frag",
    "MT": "mt",
    "ML": "ml",
    "FAF": "faf",
    "TID": "tid",
    "LGD": "lgd",
}


def tracking_random_scene(seed: int = 7) -> Any:
    """Tracks of three drives that are missed, swapped, doubled and cut, with false ones."""
    from farfield.frame.annotation import Annotation
    from farfield.geometry.boxes import Boxes
    from farfield.metrics.detections import Detections

    rng = np.random.default_rng(seed)
    annotations, boxes = {}, {}
    for drive in range(3):
        start, speed = rng.uniform([0, -20], [60, 20], (12, 2)), rng.uniform(-1, 1, (12, 2)) * [1.5, 0.3]
        begin, end = rng.integers(0, 10, 12), rng.integers(20, 40, 12)
        score = rng.uniform(0.2, 1, 40)
        for frame in range(40):
            place = start + frame * speed
            present = np.flatnonzero((frame >= begin) & (frame < end) & (rng.random(12) < 0.95))
            found = present[rng.random(len(present)) < 0.85]
            name = np.where(rng.random(len(found)) < 0.04, (found + 1) % 12, found) + 12 * (frame // 17)
            name, first = np.unique(name, return_index=True)
            found = found[first]
            at = place[found] + rng.normal(0, 0.5, (len(found), 2))
            false = rng.uniform([0, -20], [60, 20], (int(rng.integers(0, 3)), 2))
            key = (f"{drive}", f"{frame:03d}")
            annotations[key] = Annotation(boxes=_boxes(Boxes, place[present], present, None))
            names = np.r_[name, 36 + np.arange(len(false))]
            boxes[key] = _boxes(Boxes, np.concatenate([at, false]), names, score[names])
    return Detections(boxes=boxes, annotations=annotations)


def _boxes(kind: Any, place: np.ndarray, names: np.ndarray, score: np.ndarray | None) -> Any:
    n = len(place)
    return kind(
        centre_m=np.column_stack([place, np.zeros(n)]),
        size_m=np.tile([4.0, 2.0, 1.5], (n, 1)),
        yaw_rad=np.zeros(n),
        label=["car"] * n,
        track_id=names.astype(np.int64),
        score=score,
    )


def kitti_scene() -> Any:
    """PointRCNN's cars tracked by the preset ``ab3dmot``; scores through a sigmoid."""
    from farfield.metrics.box_files import read
    from farfield.tracking import track

    found = read(SHARED / "detections_pointrcnn_car", SHARED / "label", format="kitti-tracking")
    chosen = {key: a for key, a in found.annotations.items() if key[0] in KITTI}
    found = replace(found, annotations=chosen, boxes={key: b for key, b in found.boxes.items() if key in chosen})
    found = track(found, "ab3dmot")
    squashed = {
        key: part if part.score is None else part.replace(score=1 / (1 + np.exp(-part.score)))
        for key, part in found.boxes.items()
    }
    return replace(found, boxes=squashed)


def packed(found: Any, label: str) -> dict[str, Any]:
    """The boxes of a class as lists by scene and frame."""
    from farfield.metrics.frames import frame_order

    frames = []
    for key in sorted(found.annotations, key=frame_order):
        sides = []
        for part in (found.annotations[key].boxes, found.boxes[key]):
            rows = np.flatnonzero(part.label == label)
            ids = [] if part.track_id is None else part.track_id[rows].tolist()
            scores = [-1.0] * len(rows) if part.score is None else part.score[rows].tolist()
            sides.append(list(zip(ids, part.centre_m[rows].tolist(), scores, strict=True)))
        frames.append([key[0], *sides])
    return {"frames": frames}


def tracking_run_devkit(path: Path) -> dict[str, Any]:
    """The kit's figures of a packed scene."""
    from nuscenes.eval.common.config import config_factory
    from nuscenes.eval.tracking.algo import TrackingEvaluation
    from nuscenes.eval.tracking.constants import AVG_METRIC_MAP, MOT_METRIC_MAP
    from nuscenes.eval.tracking.data_classes import TrackingBox, TrackingMetricData
    from nuscenes.eval.tracking.loaders import interpolate_tracks

    config = config_factory("tracking_nips_2019")
    sides: list[Any] = [defaultdict(lambda: defaultdict(list)) for _ in range(2)]
    for number, (scene, *parts) in enumerate(json.loads(path.read_text())["frames"]):
        for side, rows in zip(sides, parts, strict=True):
            side[scene][number] = [
                TrackingBox(
                    sample_token=str(number),
                    translation=tuple(centre),
                    size=(2.0, 4.0, 1.5),
                    rotation=(1.0, 0.0, 0.0, 0.0),
                    velocity=(0.0, 0.0),
                    tracking_id=str(name),
                    tracking_name="car",
                    tracking_score=score,
                )
                for name, centre, score in rows
            ]
    for scene, frames in sides[1].items():
        scores = defaultdict(list)
        for rows in frames.values():
            for box in rows:
                scores[box.tracking_id].append(box.tracking_score)
        for rows in frames.values():
            for box in rows:
                box.tracking_score = float(np.mean(scores[box.tracking_id]))
        del scene
    for side in sides:
        for scene in side:
            side[scene] = interpolate_tracks(side[scene])
    start = time.process_time()
    evaluation = TrackingEvaluation(
        *sides,
        "car",
        config.dist_fcn_callable,
        config.dist_th_tp,
        config.min_recall,
        num_thresholds=TrackingMetricData.nelem,
        metric_worst=config.metric_worst,
        verbose=False,
    )
    data = evaluation.accumulate()
    best = int(np.nanargmax(data.mota))
    out = {name: float(data.get_metric(name)[best]) for name in MOT_METRIC_MAP.values() if name}
    for name, source in AVG_METRIC_MAP.items():
        values = np.array(data.get_metric(source))
        out[name] = float(np.where(np.isnan(values), config.metric_worst[name], values).mean())
    return {"figures": out, "cpu_s": time.process_time() - start}


def run_tracking(arguments: Sequence[str]) -> int:
    """Compare the ``nuscenes-tracking`` protocol with nuscenes-devkit 1.2.0: figures and the time of both.

        python benchmarks/nuscenes_devkit.py tracking [--env FOLDER]

    The kit's loaders want nuScenes'
    own tables, so its tracks are filled by its own ``interpolate_tracks`` from boxes in memory, and evaluated by its
    own ``TrackingEvaluation`` with its own configuration.
    """
    from _report import part_parser

    parser = part_parser(run_tracking.__doc__)
    parser.add_argument("--env", type=Path, default=ENVIRONMENT, help="of the kit")
    parser.add_argument("--without-kit", action="store_true", help="only our side")
    parser.add_argument("--random", action="store_true", help="only the random scene")
    options = parser.parse_args(arguments)
    python = None if options.without_kit else kit_python(options.env)
    scenes = {"random tracks": (tracking_random_scene(), "car")}
    if SHARED.is_dir() and not options.random:
        scenes["ab3dmot on KITTI tracking"] = (kitti_scene(), "Car")
    return max(tracking_compare(name, found, label, python) for name, (found, label) in scenes.items())


def tracking_compare(name: str, found: Any, label: str, kit: Path | None) -> int:
    """Print both sides' figures; 1 where they differ by more than 1e-6."""
    theirs = None
    if kit is not None:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "scene.json"
            path.write_text(json.dumps(packed(found, label)))
            theirs = worker_output(kit, "tracking", path)
    start = time.process_time()
    ours = found.score("nuscenes-tracking", label=label).figures
    cpu_s = time.process_time() - start
    if theirs is None:
        print(f"\n{name}: ours {cpu_s:.2f} s of processor time")
        print("".join(f"  {mine:7} farfield {ours[f'tracking/{mine}']:.12g}\n" for mine in _NAMES), end="")
        return 0
    print(f"\n{name}: the kit {theirs['cpu_s']:.1f} s, ours {cpu_s:.2f} s of processor time")
    worst = 0.0
    for mine, kits in _NAMES.items():
        value, wanted = ours[f"tracking/{mine}"], theirs["figures"][kits]
        off = abs((np.nan if value is None else value) - wanted)
        worst = max(worst, np.inf if np.isnan(off) else off)
        print(f"  {mine:7} kit {wanted:.12g}   farfield {value:.12g}   difference {off:.1e}", flush=True)
    print(f"  largest difference {worst:.1e}: {'pass' if worst < 1e-6 else 'FAIL'}")
    return int(worst >= 1e-6)


def run_task(arguments: Sequence[str]) -> int:
    """Compare nuscenes-detection (all classes, five errors, NDS), boxes, points and written trees with the devkit.

    python benchmarks/nuscenes_devkit.py task [--env FOLDER]
    """
    return _nuscenes_task.run_task(arguments, kit_python, worker_output, ENVIRONMENT)


WORKERS = {
    "devkit": detection_run_devkit,
    "farfield": run_farfield,
    "tracking": tracking_run_devkit,
    "task": _nuscenes_task.run_kit,
}


if __name__ == "__main__":
    if sys.argv[1:2] == ["--worker"]:
        print(json.dumps(WORKERS[sys.argv[2]](Path(sys.argv[3]))))
    else:
        from _report import Part, run_parts

        parts = {
            "detection": Part(run_detection, "--without-kit --repeats 1 --frames 20"),
            "tracking": Part(run_tracking, "--without-kit --random"),
            "task": Part(run_task, "--without-kit --samples 6"),
        }
        raise SystemExit(run_parts(__doc__, parts))

"""Compare the ``nuscenes-tracking`` protocol with nuscenes-devkit 1.2.0: figures and the time of both.

    python benchmarks/nuscenes_tracking.py [--env FOLDER]

The kit needs numpy < 2, so it gets an environment of its own (built at the first run). Its loaders want nuScenes' own
tables, so its tracks are filled by its own ``interpolate_tracks`` from boxes in memory, and evaluated by its own
``TrackingEvaluation`` with its own configuration.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
import venv
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

REQUIREMENTS = ("nuscenes-devkit==1.2.0", "motmetrics==1.4.0", "pandas<3", "numpy<2")
SHARED = Path(__file__).resolve().parents[2] / "shared" / "real" / "kitti_tracking"
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


def random_scene(seed: int = 7) -> Any:
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


def run_devkit(path: Path) -> dict[str, Any]:
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


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--env", type=Path, default=Path(tempfile.gettempdir()) / "farfield-nuscenes-tracking")
    parser.add_argument("--worker", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.worker:
        print(json.dumps(run_devkit(arguments.worker)))
        return 0
    from _report import header

    print(header(), flush=True)
    python = arguments.env / "bin" / "python"
    if not (arguments.env / ".installed").exists():
        venv.create(arguments.env, with_pip=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", *REQUIREMENTS], check=True)
        (arguments.env / ".installed").touch()
    scenes = {"random tracks": (random_scene(), "car")}
    if SHARED.is_dir():
        scenes["ab3dmot on KITTI tracking"] = (kitti_scene(), "Car")
    return max(compare(name, found, label, python) for name, (found, label) in scenes.items())


def compare(name: str, found: Any, label: str, python: Path) -> int:
    """Print both sides' figures; 1 where they differ by more than 1e-6."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.json"
        path.write_text(json.dumps(packed(found, label)))
        command = [python, Path(__file__), "--worker", path]
        theirs = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()[-1])
    start = time.process_time()
    ours = found.score("nuscenes-tracking", label=label).figures
    cpu_s = time.process_time() - start
    print(f"\n{name}: the kit {theirs['cpu_s']:.1f} s, ours {cpu_s:.2f} s of processor time")
    worst = 0.0
    for mine, kits in _NAMES.items():
        value, wanted = ours[f"tracking/{mine}"], theirs["figures"][kits]
        off = abs((np.nan if value is None else value) - wanted)
        worst = max(worst, np.inf if np.isnan(off) else off)
        print(f"  {mine:7} kit {wanted:.12g}   farfield {value:.12g}   difference {off:.1e}", flush=True)
    print(f"  largest difference {worst:.1e}: {'pass' if worst < 1e-6 else 'FAIL'}")
    return int(worst >= 1e-6)


if __name__ == "__main__":
    sys.exit(main())

"""The protocols ``argoverse2``, ``waymo`` and ``waymo-let`` beside what their own tools give for the same boxes.

Argoverse 2's kit gets an environment of its own, built at the first run without its dependencies (torch with CUDA alone
has 6.4 GB) and with those few that its evaluation imports. Its Python runs this file too, with ``--worker``, and has no
farfield. Waymo's tool is C++ under Bazel: what it prints for its own test stands beside the project.
"""

import csv
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from _written_results import AV2_ABSENT, AV2_FIGURES, argoverse2_summary

KIT = "av2==0.3.6"
REQUIREMENTS = (
    *("numpy==2.4.6", "pandas==3.1.1", "polars==2.1.0", "scipy==1.17.1", "pyarrow==26.0.1", "joblib==1.6.0"),
    *("tqdm==4.70.1", "universal_pathlib==0.3.10", "opencv-python-headless==5.0.0.93", "pillow", "matplotlib", "numba"),
)
ENVIRONMENT = Path(tempfile.gettempdir()) / "farfield-av2"
CATEGORIES = ("REGULAR_VEHICLE", "PEDESTRIAN", "BOLLARD", "LARGE_VEHICLE", "BICYCLIST")
COLUMNS = ("frame", "category", "centre_m", "size_m", "yaw_rad", "score")
FRAMES_A_LOG = 150


def run_argoverse2(arguments: Sequence[str]) -> int:
    """Compare the protocol ``argoverse2`` with av2-api: its own fixtures, and random sweeps with the time of both.

        python benchmarks/published_protocols.py argoverse2 [--frames 10000] [--env FOLDER] [--jobs 2]

    The kit's ``evaluate`` is given pandas tables, ours boxes by frame; both are timed from there to all figures of all
    26 categories, the kit with as many processes as it is told. Its figures are taken before it rounds them.
    """
    from _report import part_parser

    parser = part_parser(run_argoverse2.__doc__)
    parser.add_argument("--env", type=Path, default=ENVIRONMENT, help="of the kit")
    parser.add_argument("--without-kit", action="store_true", help="only our side")
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes of the kit")
    options = parser.parse_args(arguments)
    missed = kit_fixtures()
    python = None if options.without_kit else kit_python(options.env)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.npz"
        np.savez(path, **random_sweeps(options.frames))
        print(f"\n{options.frames} sweeps x 24 annotated x 60 predicted boxes of {len(CATEGORIES)} categories")
        ours = worker(Path(sys.executable), "farfield", path, 1)
        print_times("farfield", ours)
        if python is None:
            print("".join(f"  {name:<4} farfield {value:.12f}\n" for name, value in ours["mean"].items()), end="")
            return missed
        theirs = worker(python, "kit", path, options.jobs)
    print_times("av2-api", theirs)
    for name, value in theirs["mean"].items():
        print(f"  {name:<4} av2-api {value:.12f}   farfield {ours['mean'][name]:.12f}")
    worst = max(
        abs(value - ours["categories"][label][name])
        for label, figures in theirs["categories"].items()
        for name, value in figures.items()
    )
    ratio = {name: theirs[name] / ours[name] for name in ("cpu_s", "wall_s")}
    print(f"  av2-api takes {ratio['cpu_s']:.1f} times the processor time ({ratio['wall_s']:.1f} times by the clock)")
    print(f"  largest difference of {len(theirs['categories'])} categories {worst:.1e}: {_verdict(worst)}")
    return missed or int(worst >= 1e-6)


def _verdict(worst: float) -> str:
    return "pass" if worst < 1e-6 else "FAIL"


def print_times(side: str, measured: Mapping[str, Any]) -> None:
    """Times and memory of one side."""
    times = f"processor time {measured['cpu_s']:8.3f} s, clock {measured['wall_s']:8.3f} s"
    print(f"  {side:<9} {times}, peak RSS {measured['peak_mb']:6.0f} MB", flush=True)


def kit_python(env: Path) -> Path:
    """Build the kit's environment unless it is there, and return its interpreter."""
    python, done = env / "bin" / "python", env / ".installed"
    if not done.exists():
        print(f"building {env.name} with {KIT} alone and {', '.join(REQUIREMENTS)}", flush=True)
        venv.create(env, with_pip=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", *REQUIREMENTS], check=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", "--no-deps", KIT], check=True)
        done.touch()
    return python


def kit_fixtures() -> int:
    """The kit's test data (argoverse/av2-api b7321d1, MIT) and what its tests expect of them, before rounding."""
    from farfield.metrics.argoverse2.evaluation import evaluate_argoverse2
    from farfield.metrics.argoverse2.settings import Argoverse2Settings
    from farfield.metrics.bootstrap import Bootstrap

    settings = Argoverse2Settings(classes=("REGULAR_VEHICLE",), bootstrap=Bootstrap(replicates=0))
    half = np.pi
    places = ((0, 0, 0, 0), (0, 2, 2, 0), (1, 0, 0, 0), (1, 2, 2, 0), (2, 0, 0, 0), (2, 2, 2, 0))  # sweep, x, y, z
    turns = (0, half, half, half, 0, half)
    labels = _kit_boxes([(*place, 2, yaw, 1) for place, yaw in zip(places, turns, strict=True)])
    off = [(*place, 2, yaw, 1) for place, yaw in zip(places, turns, strict=True)]
    off[0], off[2], off[5] = (0, 0, 0, 0.1, 2, 0, 1), (1, 0, 0, 0, 2.5, half, 1), (2, 2, 2, 0, 2, 0, 1)
    twice = [(0, 0, 0, 0, 2, 0, 0.9), (0, 2, 2, 0, 2, half, 0.9), (0, 2, 2, 0, 2, half, 1)]
    twice += [(*place, 2, yaw, 1) for place, yaw in zip(places[2:], turns[2:], strict=True)]
    expected = {
        "identity": (labels, {"ap": 1.0, "ate": 0.0, "ase": 0.0, "aoe": 0.0, "cds": 1.0}),
        "detections": (
            _kit_boxes(off),
            {"ap": 1.0, "ate": 0.1 / 6, "ase": 0.2 / 6, "aoe": np.pi / 6, "cds": 0.930555555556},
        ),
        "assignment": (_kit_boxes(twice), {"ap": 0.998585572843}),
    }
    labels = {key: part.replace(score=None) for key, part in labels.items()}
    worst = 0.0
    for name, (predictions, figures) in expected.items():
        ours = evaluate_argoverse2(predictions, labels, settings).figures
        apart = [abs((ours[f"ap/REGULAR_VEHICLE/{figure}"] or 0.0) - value) for figure, value in figures.items()]
        worst = max(worst, *apart)
        print(f"fixture {name:<11} {', '.join(figures)}: largest difference {max(apart):.1e}")
    print(f"fixtures of av2-api: {_verdict(worst)}")
    return int(worst >= 1e-6)


def _kit_boxes(rows: Sequence[Sequence[float]]) -> dict[tuple[str, str], Any]:
    """Boxes by sweep of rows sweep, x, y, z, length, yaw, score; all are 2 m wide and high."""
    from farfield.geometry.boxes import Boxes

    table = np.array(rows, dtype=np.float64)
    frames = {}
    for frame in np.unique(table[:, 0]).tolist():
        part = table[table[:, 0] == frame]
        size_m = np.column_stack([part[:, 4], np.full((len(part), 2), 2.0)])
        frames["log", f"{frame:g}"] = Boxes(
            centre_m=part[:, 1:4], size_m=size_m, yaw_rad=part[:, 5], label="REGULAR_VEHICLE", score=part[:, 6]
        )
    return frames


def random_sweeps(frames: int, *, seed: int = 2026) -> dict[str, np.ndarray]:
    """24 annotated boxes a sweep, some beyond 150 m; 60 predictions: each box found about twice, with errors."""
    rng = np.random.default_rng(seed)
    count = frames * 24
    annotated = {
        "frame": np.repeat(np.arange(frames), 24),
        "category": rng.choice(len(CATEGORIES), count, p=[0.5, 0.25, 0.15, 0.06, 0.04]),
        "centre_m": rng.uniform([-120, -120, -1], [120, 120, 1], (count, 3)),
        "size_m": rng.uniform([0.5, 0.5, 1], [6, 2.5, 2], (count, 3)),
        "yaw_rad": rng.uniform(-np.pi, np.pi, count),
        "score": rng.integers(0, 20, count).astype(float),  # points
    }
    source = (rng.integers(0, 24, (frames, 60)) + 24 * np.arange(frames)[:, None]).ravel()
    spread_m = rng.choice([0.3, 1.0, 10.0], (len(source), 1), p=[0.4, 0.3, 0.3])
    predicted = {
        "frame": annotated["frame"][source],
        "category": annotated["category"][source],
        "centre_m": annotated["centre_m"][source] + rng.normal(0, 1, (len(source), 3)) * spread_m,
        "size_m": annotated["size_m"][source] * rng.uniform(0.8, 1.2, (len(source), 3)),
        "yaw_rad": annotated["yaw_rad"][source] + rng.normal(0, 0.3, len(source)),
        "score": (rng.permutation(len(source)) + 1) / (len(source) + 1) / np.sqrt(1 + spread_m[:, 0]),
    }
    packed = {f"annotated_{name}": value for name, value in annotated.items()}
    return packed | {f"predicted_{name}": value for name, value in predicted.items()} | {"frames": np.array(frames)}


def worker(python: Path, side: str, scene: Path, jobs: int) -> Any:
    """What one side gives in a process of its own."""
    command = [python, Path(__file__), "--worker", side, scene, str(jobs)]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    return json.loads(done.stdout.splitlines()[-1])


def measured(start: tuple[float, float], categories: Mapping[str, Mapping[str, float]], mean: Any) -> dict[str, Any]:
    """Times since the start, those of processes that it waited for among them."""
    usage = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return {
        "wall_s": time.perf_counter() - start[0],
        "cpu_s": _cpu_s() - start[1],
        "peak_mb": sum(one.ru_maxrss for one in usage) / 1024,
        "categories": categories,
        "mean": mean,
    }


def _cpu_s() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def kit_side(path: Path, jobs: int) -> dict[str, Any]:
    """av2-api's figures, before it rounds them."""
    import pandas as pd

    tables = {}
    with np.load(path, allow_pickle=False) as scene:
        for side, last in (("annotated", "num_interior_pts"), ("predicted", "score")):
            column = {name: scene[f"{side}_{name}"] for name in COLUMNS}
            half = column["yaw_rad"] / 2
            zero = np.zeros(len(half))
            values = {name: column["centre_m"][:, axis] for axis, name in enumerate(("tx_m", "ty_m", "tz_m"))}
            sizes = ("length_m", "width_m", "height_m")
            values |= {name: column["size_m"][:, axis] for axis, name in enumerate(sizes)}
            values |= {"qw": np.cos(half), "qx": zero, "qy": zero, "qz": np.sin(half), last: column["score"]}
            values["log_id"] = np.array([f"{frame // FRAMES_A_LOG:06d}" for frame in column["frame"].tolist()])
            values["timestamp_ns"] = column["frame"].astype(np.int64)
            values["category"] = np.array(CATEGORIES)[column["category"]]
            tables[side] = pd.DataFrame(values)
    start = (time.perf_counter(), _cpu_s())
    rows = argoverse2_summary(tables["predicted"], tables["annotated"], jobs=jobs)
    mean = rows.pop("AVERAGE_METRICS")
    return measured(start, rows, mean)


def farfield_side(path: Path, jobs: int) -> dict[str, Any]:
    """Our figures; a category without annotation has those that the kit gives it."""
    from farfield.geometry.boxes import Boxes
    from farfield.metrics.argoverse2.evaluation import evaluate_argoverse2
    from farfield.metrics.argoverse2.settings import Argoverse2Settings
    from farfield.metrics.bootstrap import Bootstrap

    del jobs
    sides = {}
    with np.load(path, allow_pickle=False) as scene:
        frames = int(scene["frames"])
        for side in ("annotated", "predicted"):
            column = {name: scene[f"{side}_{name}"] for name in COLUMNS}
            cuts = np.searchsorted(column["frame"], np.arange(frames + 1))
            points = side == "annotated"
            boxes = Boxes(
                centre_m=column["centre_m"],
                size_m=column["size_m"],
                yaw_rad=column["yaw_rad"],
                label=np.array(CATEGORIES)[column["category"]],
                score=None if points else column["score"],
                point_count=column["score"].astype(np.int64) if points else None,
            )
            sides[side] = {
                (f"{frame // FRAMES_A_LOG:06d}", f"{frame}"): boxes[cuts[frame] : cuts[frame + 1]]
                for frame in range(frames)
            }
    settings = Argoverse2Settings(bootstrap=Bootstrap(replicates=0))
    start = (time.perf_counter(), _cpu_s())
    figures = evaluate_argoverse2(sides["predicted"], sides["annotated"], settings).figures
    rows: dict[str, dict[str, float]] = {}
    for label in (*settings.classes, "mean_of_all"):
        values = {name: figures[f"ap/{label}/{name}"] for name in AV2_FIGURES}
        rows[label] = {name: AV2_ABSENT[name] if value is None else value for name, value in values.items()}
    mean = rows.pop("mean_of_all")
    return measured(start, rows, mean)


# Waymo


def run_waymo(arguments: Sequence[str]) -> int:
    """Compare the protocols ``waymo`` and ``waymo-let`` with what Waymo's tools print for their own test.

        python benchmarks/published_protocols.py waymo [--frames 10000] [--objects FOLDER]

    LET needs boxes as the cameras see them, which stand in the test's files themselves (fake_ground_truths.bin and
    fake_predictions.bin of waymo-research/waymo-open-dataset, src/waymo_open_dataset/metrics/tools): --objects is where
    these are.
    """
    from _report import SHARED_REAL, part_parser

    parser = part_parser(run_waymo.__doc__)
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--objects", type=Path, default=SHARED_REAL / "waymo_metrics")
    options = parser.parse_args(arguments)
    missed = 0
    if (SHARED_REAL / "waymo_metrics").is_dir():
        missed = waymo_fixtures(SHARED_REAL / "waymo_metrics", options.objects)
    else:
        print("fixtures of Waymo: not beside the project")
    waymo_speed(options.frames)
    return missed


def waymo_fixtures(folder: Path, objects: Path) -> int:
    """Differences from what the tools print: 64 figures of AP and APH, 48 of LET."""
    from farfield.geometry.boxes import Boxes, wrap_angle_rad
    from farfield.metrics.bootstrap import Bootstrap
    from farfield.metrics.box_files import read
    from farfield.metrics.waymo.evaluation import gather_waymo, waymo_result
    from farfield.metrics.waymo.settings import WaymoSettings

    expected = json.loads((folder / "expected.json").read_text())
    settings = WaymoSettings(bootstrap=Bootstrap(replicates=0))
    annotated, predicted = (csv_boxes(folder / name) for name in ("ground_truths.csv", "predictions.csv"))
    truth = {key: annotated.get(key, (Boxes.empty(), {}))[0] for key in predicted}
    data = gather_waymo(
        {key: part for key, (part, _) in predicted.items()},
        {key: part.replace(score=None) for key, part in truth.items()},
        settings,
        annotation_details={key: details for key, (_, details) in annotated.items()},
    )
    start = time.process_time()
    apart = differences(waymo_result(data, settings, len(truth)), expected["detection"])
    cpu_s = time.process_time() - start
    equal = sum(value < 1e-6 for value in apart.values())
    print(f"Waymo's test: {equal} of {len(apart)} figures equal to 1e-6, {cpu_s:.3f} s of processor time")
    for name, value in apart.items():
        if value >= 1e-6:
            print(f"  {name:<44} {value:.6f} apart")
    box, detection = data.pair.T
    ours, theirs = data.frames.predicted, data.frames.annotated
    turned = np.abs(wrap_angle_rad(ours.boxes.yaw_rad[detection] - theirs.boxes.yaw_rad[box])) > 3.1
    lost = turned & (data.iou > 0.99) & (np.abs(ours.range_m[detection] - 34.42) < 0.01)
    lost &= np.abs(ours.score[detection] - 0.145) < 1e-3
    known = replace(data, iou=np.where(lost, 0.0, data.iou))
    worst = max(differences(waymo_result(known, settings, len(truth)), expected["detection"]).values())
    print(
        f"with the overlap of {int(lost.sum())} equal, turned pair at 34.42 m taken for 0, as Waymo's polygons have it:"
    )
    print(f"  largest difference of {len(apart)} figures {worst:.1e}: {_verdict(worst)}")
    files = [objects / name for name in ("fake_predictions.bin", "fake_ground_truths.bin")]
    if not all(path.is_file() for path in files):
        print("LET: not measured, the test's files are not there (--objects)")
        return int(worst >= 1e-6)
    result = read(*files, format="waymo").score("waymo-let", bootstrap=Bootstrap(replicates=0))
    apart = differences(result, expected["detection_let"])
    let = max(apart.values())
    print(f"LET: largest difference of {len(apart)} figures {let:.1e}: {_verdict(let)}")
    return int(max(worst, let) >= 1e-6)


def differences(result: Any, expected: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """By how much each figure differs from that of Waymo's tool."""
    ranges = {"[0, 30)": "0-30", "[30, 50)": "30-50", "[50, +inf)": "50-inf"}
    apart = {}
    for name, values in expected.items():
        words = name.removeprefix("OBJECT_TYPE_").removeprefix("RANGE_").removeprefix("TYPE_").split("_")
        figures = result.ranges[ranges[words[1]]] if name.startswith("RANGE") else result.figures
        for kind, value in values.items():
            figure = kind.removeprefix("LET-").removeprefix("m").lower()
            apart[f"{name} {kind}"] = abs((figures[f"ap/{words[0].lower()}/level_{words[-1]}/{figure}"] or 0.0) - value)
    return apart


def csv_boxes(path: Path) -> dict[tuple[str, str], tuple[Any, dict[str, np.ndarray]]]:
    """Boxes and levels by frame of the test's boxes as a table."""
    from farfield.geometry.boxes import Boxes
    from farfield.metrics.waymo.settings import WAYMO_CLASSES

    rows: dict[tuple[str, str], list[dict[str, str]]] = {}
    for row in csv.DictReader(path.read_text().splitlines()):
        rows.setdefault((row["context_name"], row["frame_timestamp_micros"]), []).append(row)
    frames = {}
    for key, frame in rows.items():
        column = {name: np.array([row[name] for row in frame]) for name in frame[0]}
        number = {name: values.astype(float) for name, values in column.items() if name not in ("context_name", "id")}
        boxes = Boxes(
            centre_m=np.column_stack([number[axis] for axis in "xyz"]),
            size_m=np.column_stack([number[name] for name in ("length", "width", "height")]),
            yaw_rad=number["heading"],
            label=[("unknown", *WAYMO_CLASSES)[int(kind)] for kind in number["type"]],
            score=number["score"],
            point_count=number["num_lidar_points"].astype(int),
        )
        frames[key] = (boxes, {"detection_level": number["detection_difficulty"]})
    return frames


def waymo_speed(frames: int) -> None:
    """The time of random frames with three classes."""
    from farfield.geometry.boxes import Boxes
    from farfield.metrics.bootstrap import Bootstrap
    from farfield.metrics.waymo.evaluation import evaluate_waymo
    from farfield.metrics.waymo.settings import WaymoLetSettings, WaymoSettings

    rng = np.random.default_rng(2026)
    annotations, predictions = {}, {}
    for frame in range(frames):
        truth = Boxes(
            centre_m=rng.uniform([-75, -75, -1], [75, 75, 1], (24, 3)),
            size_m=rng.uniform([1, 1, 1], [5, 2, 2], (24, 3)),
            yaw_rad=rng.uniform(-np.pi, np.pi, 24),
            label=rng.choice(["vehicle", "pedestrian", "cyclist"], 24),
            point_count=rng.integers(0, 40, 24),
        )
        source = rng.integers(0, 24, 60)
        key = (f"{frame // FRAMES_A_LOG}", f"{frame}")
        annotations[key] = truth
        predictions[key] = truth[source].replace(
            centre_m=truth.centre_m[source] + rng.normal(0, 0.2, (60, 3)), score=rng.random(60), point_count=None
        )
    print(f"\n{frames} frames x 24 annotated x 60 predicted boxes of 3 classes, 101 score cut-offs")
    for settings in (
        WaymoSettings(bootstrap=Bootstrap(replicates=0)),
        WaymoLetSettings(bootstrap=Bootstrap(replicates=0)),
    ):
        start = (time.perf_counter(), time.process_time())
        result = evaluate_waymo(predictions, annotations, settings)
        times = f"processor time {time.process_time() - start[1]:8.3f} s, clock {time.perf_counter() - start[0]:8.3f} s"
        print(f"  {result.protocol:<9} {times}; vehicle APH {result.figures['ap/vehicle/level_2/aph']:.6f}", flush=True)


# Files as predict writes them


def run_results(arguments: Sequence[str]) -> int:
    """Score what ``predict --to`` writes with the format's own tool and with ``farfield score``, and read it back.

        python benchmarks/published_protocols.py results --peer-python PYTHON [--kitti-r11 TOOL] [--kitti-r40 TOOL]

    PYTHON has nuscenes-devkit 1.2.0 and av2 0.3.6, installed without their dependencies, and what these import: numpy
    below 2, pyquaternion, matplotlib, tqdm, shapely, opencv-python-headless below 4.12, scikit-learn, cachetools,
    pandas, polars, pyarrow, joblib, scipy, universal_pathlib, numba. A TOOL is KITTI's evaluate_object_3d_offline,
    built with Boost's headers: of prclibo/kitti_eval (11 recalls) or asharakeh/kitti_native_evaluation (40). Both
    carry no licence, so that nobody here read them. Without a peer our figures stand alone.

    Of nuScenes and Argoverse 2 the detections are annotated boxes with errors, written by the writer of ``predict``;
    of real files also what the verb itself writes. PointRCNN's cars on KITTI are real detections.
    """
    import _written_results
    from _report import SHARED_REAL, part_parser

    return _written_results.run_results(arguments, part_parser(run_results.__doc__), SHARED_REAL)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--worker"]:
        workers = {"kit": kit_side, "farfield": farfield_side}
        print(json.dumps(workers[sys.argv[2]](Path(sys.argv[3]), int(sys.argv[4]))))
    else:
        from _report import Part, run_parts

        parts = {
            "argoverse2": Part(run_argoverse2, "--without-kit --frames 20"),
            "waymo": Part(run_waymo, "--frames 20"),
            "results": Part(run_results, "--random --samples 4 --frames 12", exact=True),
        }
        raise SystemExit(run_parts(__doc__, parts))

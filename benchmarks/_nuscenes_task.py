"""The detection task, boxes, points and written trees beside nuscenes-devkit: part ``task`` of nuscenes_devkit.py."""

import json
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from _nuscenes_tree import write_results, write_tree

SWEEPS = 3
LIMITS = {"score": 1e-9, "get_boxes": 1e-9, "velocity": 1e-9, "points": 1e-4, "lag": 1e-6}
CHANNELS = ("LIDAR_TOP", "RADAR_FRONT")


def kit_figures(kit: Any, results: str, split: str, folder: Path) -> dict[str, float]:
    """The devkit's figures of results, under our names.

    Args:
        kit: The devkit's tables.
        results: The result file.
        split: The split whose samples it holds.
        folder: Where the devkit may write.
    """
    from nuscenes.eval.common.config import config_factory
    from nuscenes.eval.detection.evaluate import DetectionEval

    evaluation = DetectionEval(kit, config_factory("detection_cvpr_2019"), results, split, str(folder), verbose=False)
    metrics = evaluation.evaluate()[0].serialize()
    figures: dict[str, float] = {"nds": metrics["nd_score"], "map": metrics["mean_ap"]}
    figures |= {f"errors/{name}": value for name, value in metrics["tp_errors"].items()}
    for label, by_limit in metrics["label_aps"].items():
        figures |= {f"ap/{label}/{float(limit)}": value for limit, value in by_limit.items()}
        figures |= {f"ap/{label}/mean": metrics["mean_dist_aps"][label]}
        errors = metrics["label_tp_errors"][label].items()
        figures |= {f"class_errors/{label}/{name}": value for name, value in errors if not np.isnan(value)}
    return figures


def run_kit(path: Path) -> dict[str, Any]:
    """What the devkit says of a tree: the score of results, all boxes and velocities, points of a few samples.

    Args:
        path: A JSON file that names the tree, its version and the results.
    """
    from nuscenes import NuScenes
    from nuscenes.utils.data_classes import LidarPointCloud, RadarPointCloud

    task = json.loads(path.read_text())
    start = time.process_time()
    kit = NuScenes(task["version"], task["root"], verbose=False)
    loaded_s = time.process_time() - start
    RadarPointCloud.disable_filters()
    out: dict[str, Any] = {"samples": [], "figures": {}, "loaded_s": loaded_s}
    if task["results"]:
        start = time.process_time()
        out["figures"] = kit_figures(kit, task["results"], "mini_val", path.parent / "kit")
        out["score_s"] = time.process_time() - start
    for sample in kit.sample:
        boxes = kit.get_boxes(sample["data"]["LIDAR_TOP"])
        entry: dict[str, Any] = {
            "token": sample["token"],
            "names": [box.name for box in boxes],
            "centre": [box.center.tolist() for box in boxes],
            "lwh": [box.wlh[[1, 0, 2]].tolist() for box in boxes],
            "axis": [box.orientation.rotation_matrix[:, 0].tolist() for box in boxes],
            "velocity": [kit.box_velocity(token).tolist() for token in sample["anns"]],
            "points": [kit.get("sample_annotation", token)["num_lidar_pts"] for token in sample["anns"]],
            "clouds": {},
        }
        for channel, kind in zip(CHANNELS, (LidarPointCloud, RadarPointCloud), strict=True):
            cloud, lag = kind.from_file_multisweep(kit, sample, channel, "LIDAR_TOP", SWEEPS, 0.0)
            entry["clouds"][channel] = [cloud.points[:3].T.tolist(), lag[0].tolist()]
        out["samples"].append(entry)
    return out


def run_task(
    arguments: Sequence[str], kit_python: Callable[[Path], Path], output: Callable[..., Any], env: Path
) -> int:
    """Compare the protocol nuscenes-detection, boxes and points with nuscenes-devkit 1.2.0 on the same files.

        python benchmarks/nuscenes_devkit.py task [--env FOLDER] [--samples 20]

    A tree of random objects is written by the published schema, with results for it. Both read these files: score,
    get_boxes, box_velocity, num_lidar_pts, and three sweeps of LiDAR and radar. Then the tree is converted by
    farfield convert --to nuscenes, and the devkit's reading of that tree is held against its reading of the source.
    """
    from _report import part_parser

    parser = part_parser(run_task.__doc__)
    parser.add_argument("--env", type=Path, default=env, help="of the kit")
    parser.add_argument("--without-kit", action="store_true", help="only our side")
    parser.add_argument("--samples", type=int, default=20)
    options = parser.parse_args(arguments)
    python = None if options.without_kit else kit_python(options.env)
    with tempfile.TemporaryDirectory() as folder:
        root, results, copy = (Path(folder) / name for name in ("tree", "results.json", "copy"))
        write_tree(root, samples=options.samples)
        write_results(root, results)
        ours, seconds = score_of(root, results)
        data = convert_tree(root, copy)
        print(f"\nrandom tree: {data} samples; ours {seconds:.2f} s of processor time to read and score")
        for name in ("nds", "map", "errors/vel_err", "errors/attr_err"):
            print(f"  {name:16} farfield {ours[name]:.12f}")
        if python is None:
            return 0
        source = {"root": str(root), "version": "v1.0-mini", "results": str(results)}
        theirs = output(python, "task", written(Path(folder) / "source.json", source))
        again = {"root": str(copy), "version": "v1.0-farfield", "results": ""}
        reread = output(python, "task", written(Path(folder) / "copy.json", again))
        print(f"  the kit takes {theirs['loaded_s']:.2f} s to load and {theirs['score_s']:.2f} s to score")
        differences = {"score": score_difference(ours, theirs["figures"]), **read_differences(root, theirs["samples"])}
        differences |= {f"written {name}": v for name, v in written_differences(root, copy, theirs, reread).items()}
    failed = 0
    for name, value in differences.items():
        limit = LIMITS[name.removeprefix("written ")]
        failed |= int(not value <= limit)
        print(
            f"  {name:18} largest difference {value:.1e} of at most {limit:g}: {'pass' if value <= limit else 'FAIL'}"
        )
    return failed


def written(path: Path, tree: dict[str, str]) -> Path:
    """A file that holds what a worker is to do."""
    path.write_text(json.dumps(tree))
    return path


def score_of(root: Path, results: Path) -> tuple[dict[str, Any], float]:
    """Our figures of the results, and the seconds they take."""
    from farfield.evaluation import read_detections
    from farfield.metrics import Bootstrap

    start = time.process_time()
    detections = read_detections(results, root, format="nuscenes")
    figures = dict(detections.score("nuscenes-detection", bootstrap=Bootstrap(replicates=0)).figures)
    return figures, time.process_time() - start


def convert_tree(root: Path, copy: Path) -> int:
    """Write a tree anew by our own writer, one process."""
    from farfield.datasets import open_dataset
    from farfield.datasets.convert import convert

    data = open_dataset(root)
    convert(data, copy, to="nuscenes")
    return len(data)


def score_difference(ours: dict[str, Any], theirs: dict[str, float]) -> float:
    """The largest difference of a figure; a class of which nothing is annotated counts as 0, its errors as 1."""
    absent = {name: 0.0 if name.startswith("ap/") else 1.0 for name in theirs}
    return max(abs((absent[name] if ours[name] is None else ours[name]) - value) for name, value in theirs.items())


def read_differences(root: Path, samples: list[dict[str, Any]]) -> dict[str, float]:
    """How far our boxes, velocities and points are from the devkit's; counts must be equal."""
    from farfield.datasets import open_dataset

    data = open_dataset(root, classes="original", sweeps=SWEEPS)
    worst = dict.fromkeys(("get_boxes", "velocity", "points", "lag"), 0.0)
    rows = {frame: row for row, frame in enumerate(data.frame_ids)}
    for sample in samples:
        frame = data[rows[sample["token"]]]
        boxes, pose = frame.boxes, frame.world_T_frame
        if boxes is None or pose is None or boxes.velocity_m_s is None or boxes.point_count is None:
            raise SystemExit(f"{frame}: expected boxes, velocities, counts and a pose")
        if sample["names"] != boxes.label.tolist() or sample["points"] != boxes.point_count.tolist():
            raise SystemExit(f"{frame}: other names or counts of points")
        centre = boxes.centre_m @ pose[:3, :3].T + pose[:3, 3]
        axis = np.array(sample["axis"]) @ pose[:3, :3]
        yaw = np.arctan2(axis[:, 1], axis[:, 0])
        turn = np.abs(np.exp(1j * yaw) - np.exp(1j * boxes.yaw_rad))
        size = np.abs(boxes.size_m - np.array(sample["lwh"]))
        parts = (np.abs(centre - np.array(sample["centre"])), size, turn)
        worst["get_boxes"] = max(worst["get_boxes"], *(float(part.max(initial=0)) for part in parts))
        velocity, theirs = boxes.velocity_m_s @ pose[:3, :3].T, np.array(sample["velocity"])
        known = np.isfinite(theirs)
        if (known != np.isfinite(velocity)).any():
            raise SystemExit(f"{frame}: velocities are known of other boxes")
        worst["velocity"] = max(worst["velocity"], float(np.abs(velocity - theirs)[known].max(initial=0)))
        top = frame.sensors["LIDAR_TOP"].frame_T_sensor
        for channel, (points, lag) in sample["clouds"].items():
            cloud = frame.clouds[channel]
            moved = np.array(points) @ top[:3, :3].T + top[:3, 3]
            worst["points"] = max(worst["points"], float(np.abs(cloud.points_m - moved).max()))
            worst["lag"] = max(worst["lag"], float(np.abs(cloud.extra["lag_s"] - lag).max()))
    return worst


def written_differences(root: Path, copy: Path, source: dict[str, Any], reread: dict[str, Any]) -> dict[str, float]:
    """How far the devkit's reading of our tree is from its reading of the source, key frames alone."""
    from farfield.datasets import open_dataset

    token_of = dict(zip(open_dataset(root).frame_ids, open_dataset(copy).frame_ids, strict=True))
    again = {sample["token"]: sample for sample in reread["samples"]}
    worst = {"get_boxes": 0.0, "points": 0.0}
    for sample in source["samples"]:
        other = again[token_of[sample["token"]]]
        order, other_order = (np.lexsort(np.round(entry["centre"], 5).T) for entry in (sample, other))
        for name in ("centre", "lwh", "axis"):
            both = np.array(sample[name])[order] - np.array(other[name])[other_order]
            worst["get_boxes"] = max(worst["get_boxes"], float(np.abs(both).max(initial=0)))
        if np.array(sample["points"])[order].tolist() != np.array(other["points"])[other_order].tolist():
            raise SystemExit(f"sample {sample['token']}: other counts of points")
        for channel, (points, _) in other["clouds"].items():
            key = np.array(sample["clouds"][channel][0])[: _key_count(other, channel)]
            worst["points"] = max(worst["points"], float(np.abs(key - np.array(points)[: len(key)]).max()))
    return worst


def _key_count(sample: dict[str, Any], channel: str) -> int:
    """Points of the key frame alone: those whose age is that of the first."""
    lag = np.array(sample["clouds"][channel][1])
    return int(np.count_nonzero(np.abs(lag - lag[0]) < 1e-4)) if len(lag) else 0

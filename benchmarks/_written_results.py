"""Files that ``predict --to`` writes, scored by the format's own tool and by ``farfield score``, and read back.

Part ``results`` of published_protocols.py. The peers' Python runs this file too, with a job as JSON, and has no
farfield: nuscenes-devkit's ``DetectionEval`` and av2's ``evaluate`` read the very files that ``farfield score`` reads.
KITTI's tool is a program of C++ that the caller has built; its source has no licence and was not read.
"""

import argparse
import contextlib
import io
import json
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

LIMITS = {"nuscenes": 1e-9, "argoverse2": 1e-6, "kitti": 1e-6}
"""KITTI's tool prints per cent with six digits and adds in single precision."""
DETECTOR = "pointpillars-cirrus-sim"
AV2_FIGURES = ("ap", "ate", "ase", "aoe", "cds")
AV2_ABSENT = {"ap": 0.0, "ate": 2.0, "ase": 1.0, "aoe": np.pi, "cds": 0.0}
"""What av2 counts for a category of which nothing is annotated."""
AV2_COLUMNS = ("tx_m", "ty_m", "tz_m", "length_m", "width_m", "height_m")
KITTI_LABELS = ("Car", "Pedestrian", "Cyclist")
KITTI_MEASURES = {
    **{"detection": "2d", "detection_AP": "2d", "orientation": "aos", "orientation_AOS": "aos"},
    **{"detection_ground": "bev", "detection_BEV_AP": "bev", "detection_3d": "3d", "detection_3D_AP": "3d"},
}
"""Our measures by the words of the two programs."""
MEASURES = ("2d", "aos", "bev", "3d")
DIFFICULTIES = ("easy", "moderate", "hard")
KITTI_CAMERA_PX = ((721.5377, 0.0, 609.5593), (0.0, 721.5377, 172.854), (0.0, 0.0, 1.0))

Figures = dict[str, float]


# The peers, in their own Python


def peer_nuscenes(job: Mapping[str, str]) -> Figures:
    """The figures of nuscenes-devkit's own DetectionEval."""
    from _nuscenes_task import kit_figures
    from nuscenes import NuScenes

    kit = NuScenes(job["version"], job["root"], verbose=False)
    return kit_figures(kit, job["results"], job["split"], Path(job["folder"]))


def peer_argoverse2(job: Mapping[str, str]) -> Figures:
    """The figures of av2's own evaluation of two feather files."""
    import pandas as pd

    rows = argoverse2_summary(*(pd.read_feather(job[side]) for side in ("predicted", "annotated")))
    return {f"{label}/{name}": value for label, values in rows.items() for name, value in values.items()}


def argoverse2_summary(predicted: Any, annotated: Any, *, jobs: int = 1) -> dict[str, Figures]:
    """av2's figures of two pandas tables before it rounds them, by category and of their mean (AVERAGE_METRICS).

    Args:
        predicted: Detections.
        annotated: Annotated boxes.
        jobs: Processes of the kit.
    """
    from av2.evaluation.detection import eval as kit
    from av2.evaluation.detection.utils import DetectionCfg

    kit.NUM_DECIMALS = 15
    _, _, summary = kit.evaluate(predicted, annotated, DetectionCfg(eval_only_roi_instances=False), n_jobs=jobs)
    return {label: {name: float(summary.loc[label, name.upper()]) for name in AV2_FIGURES} for label in summary.index}


PEERS: dict[str, Callable[[Mapping[str, str]], Figures]] = {"nuscenes": peer_nuscenes, "argoverse2": peer_argoverse2}


def peer_figures(python: Path, kind: str, job: Mapping[str, Any], folder: Path) -> Figures:
    """What a peer says in a process of its own."""
    path = folder / f"{kind}-job.json"
    path.write_text(json.dumps({name: str(value) for name, value in job.items()}))
    done = subprocess.run([python, Path(__file__), kind, path], check=False, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"the peer of {kind} ended with {done.returncode}:\n{done.stderr[-3000:]}")
    figures: Figures = json.loads(done.stdout.splitlines()[-1])
    return figures


def kitti_figures(tool: Path, annotated: Path, predicted: Path, folder: Path) -> Figures:
    """What KITTI's program prints of two folders of texts, as shares: ``Car/bev/easy``."""
    target = folder / "kitti-results"
    shutil.rmtree(target, ignore_errors=True)
    (target / "data").mkdir(parents=True)
    for path in predicted.glob("*.txt"):
        (target / "data" / path.name).write_bytes(path.read_bytes())
    done = subprocess.run([tool.resolve(), annotated, target], capture_output=True, text=True, cwd=folder, check=False)
    figures: Figures = {}
    row = re.compile(r"^(car|pedestrian|cyclist)_(\w+)(?: AP)?\s*: *([\d.]+) ([\d.]+) ([\d.]+)$", re.MULTILINE)
    for label, measure, *values in row.findall(done.stdout):
        if measure in KITTI_MEASURES:
            for difficulty, value in zip(DIFFICULTIES, values, strict=True):
                figures[f"{label.capitalize()}/{KITTI_MEASURES[measure]}/{difficulty}"] = float(value) / 100
    if not figures:
        raise SystemExit(f"{tool.name}: expected figures of AP, got\n{done.stdout[-1000:]}{done.stderr[-1000:]}")
    return figures


# Boxes that a detector might find


def imitated(boxes: Any, rng: np.random.Generator, *, digits: int = 15, most: int = 3, spreads: Any = None) -> Any:
    """Up to two boxes or more about each annotated one, with errors of all kinds; scores fall as places err.

    Args:
        boxes: Annotated boxes.
        rng: Randomness.
        digits: Digits of the scores: few make equal ones.
        most: One more than the largest number of boxes for one.
        spreads: Spreads of the errors of place, metres.
    """
    count = rng.integers(0, most, len(boxes))
    source = np.repeat(np.arange(len(boxes)), count)
    spread = rng.choice([0.1, 0.5, 1.5, 6.0] if spreads is None else spreads, len(source))
    shift = rng.normal(0, 1, (len(source), 3)) * spread[:, None] * [1.0, 1.0, 0.2]
    turned = np.where(rng.random(len(source)) < 0.05, np.pi, 0.0)
    velocity = boxes.velocity_m_s
    if velocity is not None:
        velocity = velocity[source] + rng.normal(0, 0.8, (len(source), velocity.shape[1]))
    found = boxes[source]
    return found.replace(
        centre_m=found.centre_m + shift,
        size_m=found.size_m * rng.uniform(0.85, 1.15, (len(source), 3)),
        yaw_rad=found.yaw_rad + rng.normal(0, 0.15, len(source)) + turned,
        velocity_m_s=velocity,
        score=np.round(rng.uniform(0.05, 1, len(source)) / (1 + np.linalg.norm(shift, axis=1)), digits),
        point_count=None,
        track_id=None,
    )


def write_as_predict(format: str, data: Any, boxes: Sequence[Any], out: Path, *, classes: Sequence[str]) -> list[str]:
    """Write boxes as ``farfield predict --to FORMAT`` does; what it loses and what it notes."""
    from farfield.datasets.result_files import ResultWriter

    writer = ResultWriter(format, data, data.keys, "lidar", classes, True)
    losses = writer.losses()
    writer.write(out, zip(data.keys, boxes, strict=True))
    return [*losses, *writer.notes]


def farfield_verb(*words: object) -> str:
    """Run a verb of the command line and give what it printed.

    Raises:
        SystemExit: If it failed.
    """
    from farfield.cli import main

    printed, errors = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(errors):
        status = main([str(word) for word in words])
    if status:
        listed = " ".join(map(str, words))
        raise SystemExit(f"farfield {listed}: status {status}\n{printed.getvalue()}{errors.getvalue()}")
    return printed.getvalue()


def score_verb(folder: Path, predictions: Path, labels: Path, *words: object) -> dict[str, Any]:
    """The JSON of ``farfield score``."""
    out = folder / "score.json"
    farfield_verb("score", predictions, labels, *words, "--replicates", 0, "--json", out)
    tree: dict[str, Any] = json.loads(out.read_text())
    return tree


def at(tree: Any, name: str) -> float | None:
    """The figure of a name such as ``ap/car/mean``."""
    for word in name.split("/"):
        tree = (tree or {}).get(word)
    return None if tree is None else float(tree)


# nuScenes


def nuscenes_scene(folder: Path, *, samples: int, digits: int = 15) -> dict[str, Any]:
    """A tree by the published schema (_nuscenes_tree.py) and results of imitated detections; the devkit's job.

    One sample has more boxes than the devkit takes, cars are found as ``vehicle``, trucks as ``large_vehicle``.
    """
    from _nuscenes_tree import NAMES, write_tree

    from farfield.datasets import open_dataset

    rng = np.random.default_rng(17)
    names = NAMES | {"vehicle.car": "vehicle", "vehicle.truck": "large_vehicle"}
    root = folder / "tree"
    write_tree(root, samples=samples)
    data = open_dataset(root, classes="original")
    found = []
    for row, frame in enumerate(data):
        truth = frame.boxes
        label = np.array([names.get(str(name), "") for name in truth.label])
        truth = truth[label != ""].replace(label=label[label != ""])
        found.append(imitated(truth, rng, digits=digits, most=60 if row == 1 else 3))
    written = folder / f"results-{digits}.json"
    write_as_predict("nuscenes", data, found, written, classes=[*dict.fromkeys(names.values())])
    return {
        "root": root, "version": "v1.0-mini", "results": written, "split": "mini_val", "folder": folder / "kit",
        "most": max(map(len, found)),
    }  # fmt: skip


def our_nuscenes(folder: Path, job: Mapping[str, Any], *words: object) -> Figures:
    """The figures of ``farfield score``; a class of which nothing is annotated counts as 0, its errors as 1."""
    task = ("--protocol", "nuscenes-detection", "--format", "nuscenes")
    tree = score_verb(folder, job["results"], job["root"], *task, *words)
    names = ["nds", "map", *(f"errors/{name}" for name in tree["errors"])]
    names += [f"ap/{label}/{limit}" for label, part in tree["ap"].items() for limit in part]
    names += [f"class_errors/{label}/{name}" for label, part in tree["class_errors"].items() for name in part]
    values = {name: at(tree, name) for name in names}
    return {
        name: (0.0 if name.startswith("ap/") else 1.0) if value is None else value for name, value in values.items()
    }


# Argoverse 2


def argoverse2_scene(folder: Path, *, frames: int) -> dict[str, Any]:
    """Two logs of random cuboids and a submission of imitated detections; av2's job."""
    from farfield.frame import Boxes

    rng = np.random.default_rng(29)
    names = ("REGULAR_VEHICLE", "PEDESTRIAN", "LARGE_VEHICLE", "BICYCLE", "BOLLARD", "STROLLER")
    annotated, found, keys = [], [], []
    for row in range(frames):
        count = 40
        truth = Boxes(
            centre_m=rng.uniform([-130, -130, -1], [130, 130, 2], (count, 3)),
            size_m=rng.uniform([0.5, 0.5, 1], [6, 2.5, 2], (count, 3)),
            yaw_rad=rng.uniform(-np.pi, np.pi, count),
            label=rng.choice(names, count, p=[0.5, 0.2, 0.1, 0.1, 0.05, 0.05]),
            point_count=rng.integers(0, 20, count),
        )
        keys.append((f"log-{row % 2}", f"{315_966_253_660_357_000 + 100_000_000 * row}"))
        annotated.append(truth)
        ours = np.where(truth.label == "REGULAR_VEHICLE", "vehicle", truth.label)  # written as its category again
        found.append(imitated(truth.replace(label=ours), rng, most=12 if row == 0 else 3))
    data = plain_frames(keys, reference="ego")
    predicted = folder / "random.feather"
    write_as_predict("argoverse2", data, found, predicted, classes=[*names, "vehicle"])
    labels = write_annotations(folder / "random-labels.feather", keys, annotated)
    return {"predicted": predicted, "annotated": labels}


def write_annotations(path: Path, keys: Sequence[tuple[str, str]], boxes: Sequence[Any]) -> Path:
    """A table of annotated cuboids with log_id, for either side."""
    import pyarrow
    from pyarrow import feather

    count = [len(part) for part in boxes]
    half = np.concatenate([part.yaw_rad for part in boxes]) / 2
    geometry = np.concatenate([np.column_stack([part.centre_m, part.size_m]) for part in boxes])
    columns: dict[str, Any] = dict(zip(AV2_COLUMNS, geometry.T, strict=True))
    columns |= {"qw": np.cos(half), "qx": 0 * half, "qy": 0 * half, "qz": np.sin(half)}
    columns |= {"num_interior_pts": np.concatenate([part.point_count for part in boxes])}
    columns |= {"log_id": np.repeat([log for log, _ in keys], count).tolist()}
    columns |= {"timestamp_ns": np.repeat([int(stamp) for _, stamp in keys], count)}
    columns |= {"category": np.concatenate([part.label for part in boxes]).tolist()}
    table = {name: np.ascontiguousarray(v) if isinstance(v, np.ndarray) else v for name, v in columns.items()}
    feather.write_feather(pyarrow.table(table), str(path), compression="uncompressed")
    return path


def plain_frames(keys: Sequence[tuple[str, str]], **changes: Any) -> Any:
    """Frames that have a name and what is told here."""
    from farfield.datasets import InMemory
    from farfield.frame import Cloud, Frame, Sensor

    whole: dict[str, Any] = {"sensors": {"lidar": Sensor(kind="lidar")}}
    whole |= {"clouds": {"lidar": Cloud(np.zeros((1, 3), np.float32))}, **changes}
    return InMemory([Frame(sequence=sequence, frame_id=frame, **whole) for sequence, frame in keys])


def our_argoverse2(folder: Path, job: Mapping[str, Any], labels: Path | None = None) -> Figures:
    """The figures of ``farfield score`` under av2's names."""
    form = ("--protocol", "argoverse2", "--format", "argoverse2")
    tree = score_verb(folder, job["predicted"], labels or job["annotated"], *form)
    labels_of_tree = [name for name, part in tree["ap"].items() if isinstance(part, Mapping) and "cds" in part]
    figures = {}
    for label in labels_of_tree:
        for name in AV2_FIGURES:
            value = at(tree, f"ap/{label}/{name}")
            figures[f"{label}/{name}"] = AV2_ABSENT[name] if value is None else value
    return figures | {f"AVERAGE_METRICS/{name}": figures[f"mean_of_all/{name}"] for name in AV2_FIGURES}


def real_log(folder: Path, log: Path) -> dict[str, Any]:
    """The cuboids of a real log, as av2's labels, and a submission of imitated detections of them."""
    from pyarrow import feather

    from farfield.frame import Boxes

    table = feather.read_table(str(log)).to_pydict()
    column = {name: np.array(values) for name, values in table.items()}
    present = column["category"] != "EGO_VEHICLE"
    column = {name: values[present] for name, values in column.items()}
    rng, keys, annotated, found = np.random.default_rng(31), [], [], []
    for stamp in np.unique(column["timestamp_ns"]).tolist():
        part = {name: values[column["timestamp_ns"] == stamp] for name, values in column.items()}
        boxes = Boxes(
            centre_m=np.column_stack([part[name] for name in AV2_COLUMNS[:3]]).astype(np.float64),
            size_m=np.column_stack([part[name] for name in AV2_COLUMNS[3:]]).astype(np.float64),
            yaw_rad=2 * np.arctan2(part["qz"], part["qw"]).astype(np.float64),
            label=part["category"].astype(np.str_),
            point_count=part["num_interior_pts"].astype(np.int64),
        )
        keys.append((log.parent.name, str(stamp)))
        annotated.append(boxes)
        found.append(imitated(boxes, rng))
    predicted = folder / "log.feather"
    names = np.unique(column["category"]).tolist()
    write_as_predict("argoverse2", plain_frames(keys, reference="ego"), found, predicted, classes=names)
    return {"predicted": predicted, "annotated": write_annotations(folder / "log-labels.feather", keys, annotated)}


# KITTI


def kitti_camera() -> Any:
    """KITTI's left colour camera, at the origin."""
    from farfield.frame import Camera

    return Camera(matrix=np.array(KITTI_CAMERA_PX), width_px=1242, height_px=375)


def kitti_scene(folder: Path, *, frames: int) -> dict[str, Path]:
    """Random objects ahead of KITTI's camera as its labels, and imitated detections as its results."""
    from farfield.datasets.kitti.boxes import objects_from_boxes
    from farfield.files.kitti import write_labels
    from farfield.frame import Boxes

    rng = np.random.default_rng(41)
    sizes = {"Car": (3.9, 1.6, 1.5), "Van": (5.0, 1.9, 2.1), "Pedestrian": (0.8, 0.6, 1.75)}
    sizes |= {"Person_sitting": (0.8, 0.6, 1.3), "Cyclist": (1.8, 0.6, 1.7)}
    labels, keys, found = folder / "label_2", [], []
    labels.mkdir(parents=True)
    for row in range(frames):
        label = rng.choice([*sizes], 9, p=[0.4, 0.1, 0.25, 0.05, 0.2])
        depth_m = rng.uniform(5, 55, 9)
        truth = Boxes(
            centre_m=np.column_stack([depth_m, depth_m * rng.uniform(-0.7, 0.7, 9), rng.uniform(-1, -0.6, 9)]),
            size_m=np.array([sizes[name] for name in label]) * rng.uniform(0.9, 1.1, (9, 3)),
            yaw_rad=rng.uniform(-np.pi, np.pi, 9),
            label=label,
        )
        objects = objects_from_boxes(truth, kitti_camera(), classes={})
        shown = objects.box_px[:, 2] > 0
        objects.occlusion[:] = rng.integers(0, 4, len(objects))
        path = labels / f"{row:06d}.txt"
        write_labels(path, objects[shown])
        left, top = rng.uniform(0, 1100), rng.uniform(100, 250)
        region = f"{left:.2f} {top:.2f} {left + 120:.2f} {top + 60:.2f}"
        with path.open("a") as handle:
            handle.write(f"DontCare -1 -1 -10 {region} -1 -1 -1 -1000 -1000 -1000 -10\n")
        keys.append(("", f"{row:06d}"))
        exact = rng.random(len(truth)) < 0.1  # boxes that a second run of the same detector would give again
        boxes = imitated(truth, rng, spreads=[0.02, 0.1, 0.3, 3.0])
        same = truth[exact & shown].replace(score=rng.uniform(0.3, 1, int((exact & shown).sum())))
        found.append(Boxes.concatenate([boxes, same]))
    return {"annotated": labels, "predicted": write_kitti_results(folder / "results", keys, found)}


def write_kitti_results(out: Path, keys: Sequence[tuple[str, str]], found: Sequence[Any]) -> Path:
    """Boxes as ``predict --to kitti`` writes them, those that the image shows: KITTI's rules need a 2D box."""
    data = plain_frames(keys, cameras={"image_2": kitti_camera()}, reference="velodyne")
    from farfield.geometry.cameras import image_boxes

    shown = [boxes[image_boxes(boxes, kitti_camera())[0][:, 2] > 0] for boxes in found]
    write_as_predict("kitti", data, shown, out, classes=KITTI_LABELS)
    return out


def real_kitti(folder: Path, shared: Path) -> dict[str, Path]:
    """The labels of ten real sequences as KITTI's object labels, and PointRCNN's cars of them through our writer."""
    from farfield.metrics.box_files import read_predictions

    labels = folder / "label_2"
    labels.mkdir(parents=True)
    boxes = read_predictions(shared / "detections_pointrcnn_car", format="kitti-tracking").boxes
    keys, found = [], []
    for number, path in enumerate(sorted((shared / "label").glob("*.txt"))):
        rows: dict[int, list[str]] = {}
        for line in path.read_text().splitlines():
            frame, _, *row = line.split(" ")
            if row[0] == "DontCare":  # tracking's is 1,000 m wide: seen from above it would excuse all false ones
                row[8:] = ["-1", "-1", "-1", "-1000", "-1000", "-1000", "-10"]
            rows.setdefault(int(frame), []).append(" ".join(row))
        for frame, lines in rows.items():
            stem = f"{number:02d}{frame:04d}"
            (labels / f"{stem}.txt").write_text("\n".join(lines) + "\n")
            keys.append(("", stem))
            found.append(boxes.get((path.stem, str(frame)), next(iter(boxes.values()))[:0]))
    return {"annotated": labels, "predicted": write_kitti_results(folder / "results", keys, found)}


def our_kitti(folder: Path, job: Mapping[str, Path], points: str, labels: Sequence[str] = KITTI_LABELS) -> Figures:
    """The figures of ``farfield score`` of each class, with 11 or 40 recalls (points ``r11`` or ``r40``).

    ``sampling=gaps`` leaves recalls without a threshold at 0, as KITTI's program does with fewer than 41 boxes.
    """
    figures: Figures = {}
    for label in labels:
        form = ("--protocol", "kitti", "--format", "kitti", "--label", label, "--options", "sampling=gaps")
        tree = score_verb(folder, job["predicted"], job["annotated"], *form)
        for measure in MEASURES:
            for difficulty in DIFFICULTIES:
                value = at(tree, f"ap/{measure}_{points}/{difficulty}")
                if value is not None:
                    figures[f"{label}/{measure}/{difficulty}"] = value
    return figures


# Read back


def back_scene() -> Iterator[tuple[str, Any, list[Any], tuple[str, ...]]]:
    """Each format with frames that it can name, boxes, and classes."""
    from farfield.frame import Boxes

    rng = np.random.default_rng(53)
    plain = [("drive", f"{row:06d}") for row in range(3)]
    stamps_ns = [("log", f"{315_966_253_660_357_000 + row * 10**8}") for row in range(3)]
    stamps_us = [("context", f"{1_550_083_467_346_370 + row * 10**5}") for row in range(3)]
    conditions = {"time": "day", "road": "urban", "weather": "fog"}
    frames: dict[str, tuple[Any, dict[str, Any], tuple[str, ...]]] = {
        "boxes-csv": (plain, {"reference": "velodyne"}, ("vehicle", "pedestrian")),
        "kitti": (plain, {"cameras": {"image_2": kitti_camera()}}, ("Car", "Pedestrian")),
        "argoverse2": (stamps_ns, {"reference": "ego"}, ("REGULAR_VEHICLE", "PEDESTRIAN")),
        "waymo": (stamps_us, {"reference": "vehicle"}, ("vehicle", "pedestrian", "sign")),
        "kradar": (plain, {"reference": "radar", "conditions": conditions}, ("Sedan", "Bus or Truck")),
        "openpcdet": (plain, {"cameras": {"image_2": kitti_camera()}}, ("Car", "Pedestrian")),
        "mmdetection3d": (plain, {"reference": "velodyne"}, ("vehicle", "pedestrian")),
    }
    for format, (keys, changes, classes) in frames.items():
        found = []
        for _ in keys:
            count = 12
            speed = rng.normal(0, 5, (count, 2)) if format in ("boxes-csv", "mmdetection3d") else None
            found.append(
                Boxes(
                    centre_m=rng.uniform([5, -20, -2], [90, 20, 2], (count, 3)),
                    size_m=rng.uniform([0.5, 0.4, 1], [12, 3, 4], (count, 3)),
                    yaw_rad=rng.uniform(-np.pi, np.pi, count),
                    label=rng.choice(classes, count),
                    score=rng.uniform(0.01, 1, count),
                    velocity_m_s=speed,
                )
            )
        yield format, plain_frames(keys, **changes), found, classes


def read_back(folder: Path) -> dict[str, dict[str, float]]:
    """The largest differences of boxes that each form has written and ``farfield score`` reads, by format."""
    from farfield.metrics.box_files import read_predictions

    suffix = {"boxes-csv": ".csv", "argoverse2": ".feather", "waymo": ".bin"}
    apart = {}
    for format, data, found, classes in back_scene():
        out = folder / f"{format}{suffix.get(format, '')}"
        write_as_predict(format, data, found, out, classes=classes)
        axes = {"axes": "exchanged"} if format == "kradar" else {}
        detections = read_predictions(out, format=format, **axes)
        apart[format] = differences([detections.boxes[key] for key in sorted(detections.boxes)], found)
    return apart | {"nuscenes": nuscenes_back(folder)}


def nuscenes_back(folder: Path) -> dict[str, float]:
    """The same of nuScenes' JSON beside its tree: written in the world, and read back to where the car stood."""
    from _nuscenes_tree import write_tree

    from farfield.datasets import open_dataset
    from farfield.evaluation import read_detections

    root, out, rng = folder / "back", folder / "back.json", np.random.default_rng(59)
    write_tree(root, samples=4)
    data = open_dataset(root, classes="original")
    tasks = ("car", "pedestrian", "bus")
    found = []
    for frame in data:
        boxes = imitated(frame.boxes, rng)
        speed = np.nan_to_num(boxes.velocity_m_s)
        found.append(boxes.replace(label=rng.choice(tasks, len(boxes)), velocity_m_s=speed))
    write_as_predict("nuscenes", data, found, out, classes=tasks)
    detections = read_detections(out, root, format="nuscenes")
    poses = [frame.world_T_frame for frame in data]
    return differences([detections.boxes[key] for key in data.keys], found, poses=poses)


def differences(back: Sequence[Any], written: Sequence[Any], *, poses: Sequence[Any] = ()) -> dict[str, float]:
    """The largest differences of places, sizes, headings, scores and velocities; classes and numbers must be equal.

    Args:
        back: Boxes as they were read, by frame.
        written: As they were written.
        poses: Where the read boxes are seen in the world's axes from the car, its pose at each frame.
    """
    columns = ("centre_m", "size_m", "score")
    worst = dict.fromkeys((*columns, "yaw_rad"), 0.0)
    for row, (boxes, own) in enumerate(zip(back, written, strict=True)):
        if poses:
            moved = own.transform(poses[row])
            own = moved.replace(centre_m=moved.centre_m - poses[row][:3, 3])
        if len(boxes) != len(own):
            raise SystemExit(f"{len(boxes)} boxes read back of {len(own)}")
        turn = np.abs(np.exp(1j * boxes.yaw_rad) - np.exp(1j * own.yaw_rad))
        parts = {"yaw_rad": turn, **{name: getattr(boxes, name) - getattr(own, name) for name in columns}}
        if own.velocity_m_s is not None and boxes.velocity_m_s is not None:
            parts["velocity_m_s"] = boxes.velocity_m_s[:, :2] - own.velocity_m_s[:, :2]
        for name, part in parts.items():
            worst[name] = max(worst.get(name, 0.0), float(np.abs(part).max(initial=0.0)))
    return worst


# The part


def compare(name: str, kind: str, theirs: Mapping[str, float], ours: Mapping[str, float], shown: Sequence[str]) -> int:
    """Print both sides' figures; 1 where they differ by more than the limit."""
    missing = sorted(set(theirs) - set(ours))
    if missing:
        raise SystemExit(f"{name}: no figures of ours for {', '.join(missing[:5])}")
    print(f"\n{name}")
    for figure in shown:
        if figure in theirs:
            apart = ours[figure] - theirs[figure]
            print(f"  {figure:<28} peer {theirs[figure]:.12f}   farfield {ours[figure]:.12f}   {apart:+.1e}")
    apart = {figure: abs(ours[figure] - value) for figure, value in theirs.items()}
    far = {figure: value for figure, value in apart.items() if not value <= LIMITS[kind]}  # one that is no number too
    for figure in far:
        print(f"  {figure:<28} peer {theirs[figure]:.12f}   farfield {ours[figure]:.12f}   apart")
    verdict = "FAIL" if far else "pass"
    most = max(apart.values())
    print(f"  {len(theirs)} figures, largest difference {most:.1e} of {LIMITS[kind]:g}: {verdict}", flush=True)
    return int(bool(far))


def show_ours(name: str, ours: Mapping[str, float], shown: Sequence[str]) -> int:
    """Print our figures alone."""
    print(f"\n{name}: no peer")
    print("".join(f"  {figure:<28} farfield {ours[figure]:.12f}\n" for figure in shown if figure in ours), end="")
    return 0


NUSCENES_SHOWN = (
    *("nds", "map", "errors/trans_err", "errors/scale_err", "errors/orient_err", "errors/vel_err", "errors/attr_err"),
)
AV2_SHOWN = tuple(f"AVERAGE_METRICS/{name}" for name in AV2_FIGURES)
KITTI_SHOWN = tuple(f"{label}/{measure}/moderate" for label in KITTI_LABELS for measure in MEASURES)


class Peers:
    """The tools of others that the caller has, and what they said."""

    def __init__(self, python: Path | None, tools: Mapping[str, Path]) -> None:
        self.python, self.tools = python, tools
        self.recorded: dict[str, Figures] = {}

    def held(self, name: str, kind: str, job: Mapping[str, Any], folder: Path, ours: Figures) -> int:
        """Hold our figures of a job against the peer's, or show them alone."""
        shown = NUSCENES_SHOWN if kind == "nuscenes" else AV2_SHOWN
        if self.python is None:
            return show_ours(name, ours, shown)
        self.recorded[name] = peer_figures(self.python, kind, job, folder)
        return compare(name, kind, self.recorded[name], ours, shown)


def run_results(arguments: Sequence[str], parser: argparse.ArgumentParser, shared: Path) -> int:
    """The part: see :func:`published_protocols.run_results`."""
    parser.add_argument("--peer-python", type=Path, help="a Python that has nuscenes-devkit and av2")
    parser.add_argument("--kitti-r11", type=Path, help="KITTI's program that averages 11 recalls")
    parser.add_argument("--kitti-r40", type=Path, help="and the one that averages 40")
    parser.add_argument("--samples", type=int, default=20, help="of each scene of the random tree")
    parser.add_argument("--frames", type=int, default=60, help="of the random sweeps and images")
    parser.add_argument("--random", action="store_true", help="only what needs no real files")
    parser.add_argument("--record", type=Path, help="write the peers' figures of the random scenes into this file")
    options = parser.parse_args(arguments)
    tools = {"r11": options.kitti_r11, "r40": options.kitti_r40}
    peers = Peers(options.peer_python, {name: path for name, path in tools.items() if path is not None})
    real = shared.is_dir() and not options.random
    missed = 0
    with tempfile.TemporaryDirectory() as base:
        folder = Path(base)
        missed |= results_nuscenes(folder, peers, options.samples)
        missed |= results_argoverse2(folder, peers, options.frames)
        missed |= results_kitti(folder, peers, options.frames, shared if real else None)
        if options.record is not None:
            options.record.write_text(json.dumps(peers.recorded, indent=0, sort_keys=True) + "\n")
        if real:
            missed |= results_real(folder, peers, shared)
        missed |= results_back(folder)
    return missed


def results_nuscenes(folder: Path, peers: Peers, samples: int) -> int:
    """Random scenes in nuScenes' schema, with scores that are all different, and with many that are equal."""
    job = nuscenes_scene(folder / "n", samples=samples)
    print(f"nuScenes: {2 * samples} samples; the largest has {job['most']} boxes, of which 500 at most are written")
    missed = peers.held("nuScenes, random scenes", "nuscenes", job, folder, our_nuscenes(folder, job))
    job = nuscenes_scene(folder / "t", samples=samples, digits=2)
    ours = our_nuscenes(folder, job, "--options", "ties=later_first")
    return missed | peers.held("nuScenes, scores of two digits (ties=later_first)", "nuscenes", job, folder, ours)


def results_argoverse2(folder: Path, peers: Peers, frames: int) -> int:
    """Random sweeps in two logs."""
    (folder / "a").mkdir()
    job = argoverse2_scene(folder / "a", frames=frames)
    return peers.held("Argoverse 2, random sweeps", "argoverse2", job, folder, our_argoverse2(folder, job))


def results_kitti(folder: Path, peers: Peers, frames: int, shared: Path | None) -> int:
    """Random objects, and PointRCNN's cars on real labels."""
    jobs = {"KITTI, random objects": (kitti_scene(folder / "k", frames=frames), KITTI_LABELS)}
    if shared is not None:
        jobs["KITTI, PointRCNN's cars"] = (real_kitti(folder / "p", shared / "kitti_tracking"), KITTI_LABELS[:1])
    missed = 0
    for name, (job, labels) in jobs.items():
        for points in ("r11", "r40"):
            ours, title = our_kitti(folder, job, points, labels), f"{name}, {points.upper()}"
            if points not in peers.tools:
                missed |= show_ours(title, ours, KITTI_SHOWN)
                continue
            theirs = kitti_figures(peers.tools[points], job["annotated"], job["predicted"], folder)
            theirs = {figure: value for figure, value in theirs.items() if figure.split("/")[0] in labels}
            peers.recorded[title] = theirs
            missed |= compare(title, "kitti", theirs, ours, KITTI_SHOWN)
    return missed


def results_real(folder: Path, peers: Peers, shared: Path) -> int:
    """What the verb ``predict`` itself writes of two real sweeps, and a real log of cuboids."""
    val, log = (
        shared / "argoverse2" / "val",
        next((shared / "argoverse2_tracks").glob("*/annotations_with_ego.feather")),
    )
    job = real_log(folder, log)
    missed = peers.held("Argoverse 2, a real log", "argoverse2", job, folder, our_argoverse2(folder, job))
    out, tree = folder / "predicted.feather", folder / "converted"
    farfield_verb("predict", DETECTOR, val, "--to", "argoverse2", "--out", out)
    job = {"predicted": out, "annotated": with_log(folder, val)}
    ours = our_argoverse2(folder, job, labels=val)
    missed |= peers.held(f"Argoverse 2, predict {DETECTOR}, two real sweeps", "argoverse2", job, folder, ours)
    farfield_verb("convert", val, tree, "--to", "nuscenes")
    results = folder / "predicted.json"
    farfield_verb("predict", DETECTOR, tree, "--to", "nuscenes", "--out", results)
    version = {"version": "v1.0-farfield", "split": "all", "folder": folder / "kit-real"}
    job = {"root": tree, "results": results, **version}
    name = f"nuScenes, predict {DETECTOR}, the same sweeps converted (ties=later_first: several boxes score alike)"
    ours = our_nuscenes(folder, job, "--options", "ties=later_first")
    return missed | peers.held(name, "nuscenes", job, folder, ours)


def with_log(folder: Path, val: Path) -> Path:
    """The annotations of a part's logs in one table with log_id, those of stamps that have a sweep."""
    import pyarrow
    from pyarrow import feather

    parts = []
    for path in sorted(val.glob("*/annotations.feather")):
        stamps = [int(sweep.stem) for sweep in (path.parent / "sensors" / "lidar").glob("*.feather")]
        table = feather.read_table(str(path))
        table = table.filter(pyarrow.array(np.isin(table["timestamp_ns"].to_numpy(), stamps)))
        parts.append(table.append_column("log_id", pyarrow.array([path.parent.name] * len(table))))
    out = folder / "val.feather"
    feather.write_feather(pyarrow.concat_tables(parts), str(out), compression="uncompressed")
    return out


def results_back(folder: Path) -> int:
    """The largest difference of each column of each format."""
    print("\nread back by farfield score: the largest difference of a box")
    missed = 0
    for format, worst in read_back(folder).items():
        limit = {"waymo": 1e-7}.get(format, 0.0)  # scores of single precision
        held = worst["score"] <= limit and all(value <= 1e-9 for name, value in worst.items() if name != "score")
        missed |= int(not held)
        listed = ", ".join(f"{name} {value:.1e}" for name, value in worst.items())
        print(f"  {format:<13} {listed}: {'pass' if held else 'FAIL'}")
    return missed


if __name__ == "__main__":
    print(json.dumps(PEERS[sys.argv[1]](json.loads(Path(sys.argv[2]).read_text()))))

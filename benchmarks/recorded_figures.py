"""Figures that a rearrangement of the code must not change, recorded and compared to the last digit.

    python benchmarks/recorded_figures.py record FILE.json [--work FOLDER]
    python benchmarks/recorded_figures.py compare FILE.json [--work FOLDER]

Only the command line is used, so that the same script runs before and after: scores of real detections (KITTI tracking,
K-Radar's parity fixtures), counts of K-Radar's real labels, the five shipped weights on ten frames of the frozen split
and on real frames, and the losses of twelve training steps of a small form of each detector. Record and compare on one
machine: another processor rounds otherwise. Real data that are absent are left out and named.
"""

import argparse
import csv
import json
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path
from typing import Any

import yaml
from _report import ROOT, SHARED_REAL, header

WEIGHTS = ("pointpillars", "pointrcnn", "second", "sparsecentre", "voxelnet")
SMALL_GRID = {"range_m": 64.0, "half_width_m": 20.0}
RADAR = {
    "grid": {**SMALL_GRID, "z_min_m": -3.0, "z_max_m": 1.0, "cell_m": [1.0, 1.0, 1.0]},
    "anchors": {"vehicle": {"size_m": [4.2, 2.1, 2.0], "z_m": -1.0, "positive_iou": 0.5, "negative_iou": 0.2}},
    "neck_width": 32,
}
LEVELS = [
    {"centres": 512, "radii_m": [0.5, 1.5], "limits": [16, 32], "widths": [[16, 32], [16, 32]]},
    {"centres": 128, "radii_m": [1.5, 4.0], "limits": [16, 32], "widths": [[32, 48], [32, 48]]},
]
DETECTORS: dict[str, dict[str, Any]] = {
    "pointpillars": {"grid": {**SMALL_GRID, "cell_m": 0.5}, "widths": [16, 32, 32], "neck_width": 32, "out_stride": 2},
    "pointrcnn": {
        "window": SMALL_GRID,
        "points": 2048,
        "bands": {"edges_m": [0.0, 30.0, 64.0], "shares": [0.5, 0.5]},
        "backbone": {"levels": LEVELS, "propagation": [[64], [64]]},
        "proposals": {"threshold": 0.0, "bands": {"edges_m": [0.0, 30.0, 64.0], "shares": [0.5, 0.5]}},
    },
    "second": {
        "grid": {**SMALL_GRID, "cell_m": [0.2, 0.2, 0.45]},
        "middle_widths": [8, 8, 16, 16],
        "widths": [64, 64],
        "depths": [0, 0],
    },
    "sparsecentre": {
        "grid": {**SMALL_GRID, "z_min_m": -4.0, "z_max_m": 4.0, "cell_m": [0.4, 0.4, 0.5]},
        "widths": [16, 32],
        "depths": [0, 1],
        "pyramid_widths": [32, 32, 32],
    },
    "voxelnet": {
        "grid": {**SMALL_GRID, "z_min_m": -3.0, "z_max_m": 1.0, "cell_m": [0.5, 0.5, 0.8]},
        "vfe_widths": [8, 16],
        "voxel_channels": 16,
        "middle_widths": [16, 16, 16],
        "widths": [16, 32, 32],
        "depths": [1, 2, 2],
        "neck_width": 32,
    },
    "rtn": {**RADAR, "planes": 16, "depths": [1, 1, 1], "strides": [1, 2, 2], "proposals": "anchors"},
    "rtnh": {**RADAR, "cell_channels": 16, "widths": [16, 16, 32], "proposals": "anchors"},
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("what", choices=["record", "compare"])
    parser.add_argument("file", type=Path)
    parser.add_argument("--work", type=Path, help="where data and runs are kept; a temporary folder unless given")
    parser.add_argument("--parts", nargs="+", default=list(PARTS), choices=list(PARTS))
    options = parser.parse_args()
    print(header(), flush=True)
    work = options.work or Path(tempfile.mkdtemp(prefix="farfield-figures-"))
    work.mkdir(parents=True, exist_ok=True)
    figures: dict[str, Any] = {}
    for part in options.parts:
        for name, tree in PARTS[part](work).items():
            figures[f"{part}: {name}"] = tree
            print(f"  {part}: {name}", flush=True)
    if options.what == "record":
        options.file.write_text(json.dumps({"header": header().splitlines(), "figures": figures}, indent=1) + "\n")
        print(f"recorded {len(figures)} trees, {sum(map(leaves, figures.values()))} values: {options.file}")
        return 0
    before = json.loads(options.file.read_text())["figures"]
    chosen = {name: tree for name, tree in before.items() if name.partition(":")[0] in options.parts}
    return int(not compare(chosen, figures))


def compare(before: dict[str, Any], after: dict[str, Any]) -> bool:
    """Print what differs; True if nothing does."""
    same = True
    for name in dict.fromkeys([*before, *after]):
        lines = list(differences(before.get(name), after.get(name)))
        same &= not lines
        print(f"{name}: {'equal' if not lines else f'{len(lines)} DIFFER'}, {leaves(after.get(name))} values")
        print("".join(f"    {line}\n" for line in lines[:6]), end="")
    return same


def differences(a: Any, b: Any, where: str = "") -> Any:
    """One line for each value that is not the same, whatever the order of keys."""
    if isinstance(a, dict) and isinstance(b, dict):
        for key in dict.fromkeys([*a, *b]):
            yield from differences(a.get(key, "absent"), b.get(key, "absent"), f"{where}/{key}")
    elif isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        for index, (x, y) in enumerate(zip(a, b, strict=True)):
            yield from differences(x, y, f"{where}/{index}")
    elif a != b:
        yield f"{where}: {str(a)[:60]} -> {str(b)[:60]}"


def leaves(tree: Any) -> int:
    if isinstance(tree, dict | list):
        return sum(map(leaves, tree.values() if isinstance(tree, dict) else tree))
    return 1


def farfield(*words: object) -> None:
    """Run a verb in a process of its own, on one thread."""
    one = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "farfield.cli", *map(str, words)]
    done = subprocess.run(command, env={**os.environ, **one}, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}\n{done.stdout}\n{done.stderr}")


def scores(work: Path) -> dict[str, Any]:
    found: dict[str, Any] = {}
    out = work / "score.json"
    kitti = SHARED_REAL / "kitti_tracking"
    if kitti.is_dir():
        sides = (kitti / "detections_pointrcnn_car", kitti / "label")
        for protocol in ("dds", "nuscenes", "kitti"):
            flags = ("--format", "kitti-tracking", "--label", "Car", "--protocol", protocol)
            farfield("score", *sides, *flags, "--replicates", 20, "--json", out)
            found[f"kitti_tracking {protocol}"] = json.loads(out.read_text())
    kradar = SHARED_REAL / "kradar" / "evaluation"
    for stem in ("iso", "long") if kradar.is_dir() else ():
        sides = tuple(as_boxes_csv(kradar / f"boxes_{stem}.csv", kind, work) for kind in ("pred", "gt"))
        variants = list(json.loads((kradar / f"expected_{stem}.json").read_text())["variants"])
        for protocol in ("kradar", *(f"kradar-compat:{name}" for name in variants)):
            flags = ("--protocol", protocol, "--conditions", "published", "--replicates", 20)
            farfield("score", *sides, *flags, "--json", out)
            found[f"kradar {stem} {protocol}"] = json.loads(out.read_text())
    return found


def as_boxes_csv(path: Path, kind: str, work: Path) -> Path:
    """One side of a parity fixture in the columns of ``farfield score``."""
    target = work / f"{path.stem}_{kind}.csv"
    with path.open(newline="") as source, target.open("w", newline="") as handle:
        writer = csv.writer(handle)
        writer.writerow(["sequence", "frame", "label", "x", "y", "z", "l", "w", "h", "yaw_rad", "score"])
        for row in csv.DictReader(source):
            if row["kind"] == kind:
                score = row["score"] if kind == "pred" else ""
                place = (row[name] for name in ("x", "y", "z", "l", "w", "h", "yaw_rad"))
                writer.writerow([row["seq"], row["stem"], row["cls"], *place, score])
    return target


def counts(work: Path) -> dict[str, Any]:
    archive = SHARED_REAL / "kradar" / "labels_v2_1.tar.gz"
    if not archive.is_file():
        return {}
    folder = work / "kradar-labels"
    if not folder.is_dir():
        with tarfile.open(archive) as file:
            file.extractall(folder, filter="data")
    root = next(iter(sorted(folder.iterdir()))) if len(list(folder.iterdir())) == 1 else folder
    farfield("stats", root, "--sweeps", 0, "--out", work / "stats")
    return {"labels v2.1": json.loads((work / "stats" / "statistics.json").read_text())}


def weights(work: Path) -> dict[str, Any]:
    frozen = work / "frozen"
    farfield("simulate", "cirrus-sim-val-v2", frozen, "--frames", 10)
    data: dict[str, tuple[Path, tuple[object, ...]]] = {"frozen": (frozen / "Cirrus_dataset1", ())}
    luminar = SHARED_REAL / "cirrus_layout" / "Cirrus_dataset1"
    if luminar.is_dir():
        data |= {"luminar": (luminar, ()), "luminar turned": (luminar, ("--rotate-deg", 180))}
    if (SHARED_REAL / "kitti").is_dir():
        data["kitti"] = (SHARED_REAL / "kitti", ())
    found: dict[str, Any] = {}
    for name in WEIGHTS:
        for place, (root, flags) in data.items() if name == "pointpillars" else [("frozen", data["frozen"])]:
            for protocol in ("dds", "nuscenes", "kitti") if (name, place) == ("pointpillars", "frozen") else ("dds",):
                found[f"{name} {place} {protocol}"] = evaluated(
                    f"{name}-cirrus-sim", root, work, "--protocol", protocol, *flags
                )
    return found


def evaluated(detector: object, root: Path, work: Path, *flags: object) -> Any:
    """Results and objects of ``farfield evaluate``, without its times and versions."""
    out = work / "evaluation"
    shutil.rmtree(out, ignore_errors=True)
    farfield("evaluate", detector, root, "--precision", "fp32", "--out", out, *flags)
    tree = json.loads((out / "evaluation.json").read_text())
    return {key: tree[key] for key in ("results", "objects") if key in tree}


def losses(work: Path) -> dict[str, Any]:
    found: dict[str, Any] = {}
    cirrus, kradar = work / "mini-cirrus", work / "mini-kradar"
    farfield("simulate", "cirrus-sim-mini", cirrus)
    farfield("simulate", "kradar-sim-mini", kradar, "--sensors", "os2-64,sparse")
    for name, settings in DETECTORS.items():
        radar = name in ("rtn", "rtnh")
        clouds = ["radar"] if radar else ["gaussian", "uniform"]
        data: dict[str, Any] = {"path": str(kradar if radar else cirrus / "Cirrus_dataset1"), "clouds": clouds}
        if radar:
            data["options"] = {"reference": "radar"}
        pasted = {} if radar else {"pasted": {"vehicle": 4}, "thinning": 0.3, "bank_frames": 3}
        training = {"steps": 12, "batch_size": 2, "precision": "fp32", "threads": 1, "workers": 0}
        tree = {
            "name": name,
            "data": data,
            "detector": {"name": name, **settings},
            "augmentation": {"height_m": 0.2, **pasted},
            "training": {**training, "log_every_steps": 1, "far_sampling": 0.5, "far_from_m": 40.0},
        }
        (work / f"{name}.yaml").write_text(yaml.safe_dump(tree))
        shutil.rmtree(work / "runs" / name, ignore_errors=True)
        farfield("train", work / f"{name}.yaml", "--out", work / "runs")
        lines = (work / "runs" / name / "log.jsonl").read_text().splitlines()
        rows = [json.loads(line) for line in lines]
        found[name] = [{key: value for key, value in row.items() if key != "time"} for row in rows]
        if radar:
            found[f"{name} scored"] = evaluated(work / "runs" / name, kradar, work)["results"]
    return found


PARTS = {"scores": scores, "counts": counts, "weights": weights, "losses": losses}

if __name__ == "__main__":
    os.chdir(ROOT)
    sys.exit(main())

"""Real radar frames of three makes in one form: fifty steps on RADIATE's turns, then on Astyx' and View-of-Delft's.

The frames are so few that what is learnt from is all there is: nothing is claimed of accuracy, and the table says how
wide the interval of a recall would be. A second run goes on where the first ended.

    python benchmarks/transfer_real.py [--real SHARED_REAL] [--work FOLDER] [--output FILE]
"""

import argparse
import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from _report import SHARED_REAL, header

from farfield.datasets import Dataset, open_dataset
from farfield.datasets.maps import CommonRadar
from farfield.detectors.runtime import Detector
from farfield.evaluation import detect
from farfield.experiments.plan import Plan
from farfield.experiments.schema import experiment_of
from farfield.files.atomic import write_text
from farfield.metrics.detections import Detections
from farfield.training.method import LABELLED

FORMS: dict[str, dict[str, Any]] = {
    "radiate": {
        "column": "strength",
        "unit": "db",
        "db_per_one": 127.5,
        "doppler": False,
        "height": False,
        "cell_m": 0.4,
    },
    "astyx": {"column": "magnitude_db", "unit": "db"},
    "view_of_delft": {"column": "rcs_dbsm", "unit": "db"},
}
OPTIONS: dict[str, dict[str, Any]] = {"radiate": {"radar_share": 0.05}}
RANGE_M, HALF_WIDTH_M = 64.0, 16.0
ANCHORS = {
    "vehicle": {"size_m": [4.4, 2.0, 1.8], "z_m": -0.6, "positive_iou": 0.45, "negative_iou": 0.2},
    "bicycle": {"size_m": [1.9, 0.8, 1.7], "z_m": -0.6, "positive_iou": 0.4, "negative_iou": 0.2},
    "pedestrian": {"size_m": [0.8, 0.8, 1.7], "z_m": -0.6, "positive_iou": 0.35, "negative_iou": 0.15},
}
STEPS = 50
FEWEST_OBJECTS, FEWEST_FRAMES = 100, 30
"""From which an AP is worth printing: a recall of one half is known to 0.1, if frames differ."""
Z_95 = 1.96


def seen(root: Path, name: str) -> Dataset:
    """A data set's frames in the common form, its floor taken from all of them."""
    data = open_dataset(root / name, **OPTIONS.get(name, {}))
    form = CommonRadar(**{"floor_db": (0.0,), **FORMS[name]}).fitted(data[index] for index in range(len(data)))
    return data.mapped(form)


def plan(data: Dataset, folder: Path, start: dict[str, Any] | None) -> Plan:
    """A training of fifty steps."""
    grid = {
        "range_m": RANGE_M,
        "half_width_m": HALF_WIDTH_M,
        "z_min_m": -6.0,
        "z_max_m": 8.0,
        "cell_m": [0.8, 0.8, 14.0],
    }
    network = {"name": "rtn", "grid": grid, "planes": 8, "depths": [1, 1], "strides": [2, 2], "neck_width": 16}
    training = {"steps": STEPS, "batch_size": 1, "min_points": 0, "threads": 1, "workers": 0, "unannotated": "skip"}
    tree = {
        "name": folder.name,
        "data": {"path": "given", "clouds": ["radar"]},
        "detector": {**network, "use_doppler": True, "use_flags": True, "proposals": "anchors", "anchors": ANCHORS},
        "training": {**training, "precision": "fp32", **({} if start is None else {"start": start})},
    }
    return Plan(experiment_of(tree), folder, data={LABELLED: data})


def objects(found: Detections) -> dict[str, int]:
    """Objects of the network's classes in its grid, by class."""
    counted = dict.fromkeys(ANCHORS, 0)
    for annotation in found.annotations.values():
        ahead, left = annotation.boxes.centre_m[:, :2].T
        for label in annotation.boxes.label[(ahead > 0) & (ahead < RANGE_M) & (np.abs(left) < HALF_WIDTH_M)]:
            if str(label) in counted:
                counted[str(label)] += 1
    return counted


def worth(count: int, frames: int) -> str:
    """What may be said of so many objects of a class: Wilson's interval of a recall of one half, at 95 %."""
    if count >= FEWEST_OBJECTS and frames >= FEWEST_FRAMES:
        return f"{count}"
    if not count:
        return "none"
    known = Z_95 * np.sqrt(0.25 / count + Z_95**2 / (4 * count**2)) / (1 + Z_95**2 / count)
    return f"{count} in {frames} frames: n too small for AP, a recall of 0.5 +-{known:.2f} at best"


def row(name: str, data: Dataset, folder: Path, start: dict[str, Any] | None) -> list[str]:
    """Train or go on, detect, and say what was met."""
    weights = plan(data, folder, start).run()
    losses = [json.loads(line)["loss"] for line in (folder / "log.jsonl").read_text(encoding="utf-8").splitlines()]
    found = detect(Detector.load(weights), data, cloud="radar", annotated_only=True)
    points = int(np.median([len(data[index].cloud("radar")) for index in range(len(data))]))
    boxes = sum(len(each) for each in found.boxes.values())
    said = [f"{label} {worth(count, len(data))}" for label, count in objects(found).items()]
    return [
        f"{name:<14}{len(data):7d}{points:8d}{STEPS:7d}{np.mean(losses[:10]):11.3f}{np.mean(losses[-10:]):9.3f}{boxes:8d}"
        f"   {said[0]}",
        *(f"{'':<67}{each}" for each in said[1:]),
    ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--real", type=Path, default=SHARED_REAL)
    parser.add_argument("--work", type=Path, help="keeps the runs; a temporary folder otherwise")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    with TemporaryDirectory() as temporary:
        work = options.work or Path(temporary)
        lines = [
            header(),
            "one network; the other two go on from RADIATE's weights, all of them taken; boxes on what was learnt from",
            "",
            f"{'':<14}{'frames':>7}{'points':>8}{'steps':>7}{'loss first':>11}{'last ten':>9}{'boxes':>8}   objects",
            *row("radiate", seen(options.real, "radiate"), work / "radiate", None),
        ]
        for name in ("astyx", "view_of_delft"):
            lines += row(name, seen(options.real, name), work / name, {"weights": str(work / "radiate")})
    print("\n".join(lines))
    if options.output:
        write_text(options.output, "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()

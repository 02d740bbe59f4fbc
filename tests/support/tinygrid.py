"""The grids with budgets of minutes: some of their runs, tiny networks and frames. Too small to say anything."""

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from farfield import papers
from farfield.cli import main
from farfield.papers import ExperimentGrid, Reproduction, load_grid, reproducing
from farfield.papers.grid import BudgetSettings

RUNS = ("device_a", "gaussian", "uniform", "range", "device_pretrained")
SCALE = {"range_m": 64.0, "half_width_m": 16.0, "cell_m": 0.5}
PATTERNS = "gaussian,uniform"
MINI = {
    "words": "a test",
    "seeds": 2,
    "steps": 4,
    "least_steps": 4,
    "batch": 1,
    "training": {"average_decay": 0.5, "precision": "fp32", "checkpoint_every_s": 0.01},
    "sets": {
        "train": {"preset": "cirrus-sim-mini", "sequences": 2, "frames": 3, "seed": 1, "sensors": PATTERNS},
        "val": {"preset": "cirrus-sim-mini", "sequences": 2, "frames": 2, "seed": 2, "sensors": PATTERNS},
        "device": {"preset": "kitti-sim-mini", "sequences": 2, "frames": 2, "seed": 3, "sensors": "lidar"},
    },
    "score": {
        "protocol": "dds",
        "settings": {"label": "vehicle", "window_m": (0.0, 64.0, -16.0, 16.0)},
        "bins_m": {"I": {"near": (0, 20), "mid": (20, 40), "far": (40, 64)}, "III": {"near": (0, 32), "far": (32, 64)}},
    },
    "method": {"range": {"near_m": (0.0, 32.0), "far_m": (32.0, 64.0), "half_width_m": 16.0, "min_range_m": 2.0}},
    "networks": {
        "grid": {
            "name": "pointpillars",
            "positions": "relative",
            "grid": SCALE,
            "pillar_channels": 8,
            "widths": (8, 8, 8),
            "depths": (0, 0, 0),
            "neck_width": 8,
            "anchors": {"vehicle": {"size_m": (4.6, 1.95, 1.7), "z_m": -1.15}},
        }
    },
    "replicates": 20,
}


CORRIDOR = {"range_m": 72.0, "half_width_m": 6.4, "z_min_m": -2.0, "z_max_m": 6.0}
ROADS = {"preset": "kradar-sim-mini", "sequences": 2, "frames": 1}
KRADAR_MINI = {
    "words": "a test",
    "seeds": 1,
    "steps": 2,
    "least_steps": 2,
    "batch": 1,
    "without": ["rtn_resnet50", "rtn_resnext101", "rtn_mean"],
    "training": {"precision": "fp32"},
    "statistics_on": ["normal"],
    "sets": {
        "train": {**ROADS, "seed": 1, "sensors": "os2-64,cells"},
        "val": {**ROADS, "seed": 2, "sensors": "os2-64,cells"},
        "normal": {**ROADS, "sequences": 1, "seed": 3, "sensors": "os2-64", "weather": "normal"},
    },
    "score": {"protocol": "kradar", "settings": {"region": "narrow", "classes": ["vehicle"], "ious": [0.3]}},
    "networks": {
        "rtnh": {
            "name": "rtnh",
            "cell_channels": 4,
            "widths": [4, 4, 4],
            "neck_width": 8,
            "grid": {**CORRIDOR, "cell_m": [0.8, 0.8, 0.8]},
            "proposals": "anchors",
            "score_threshold": 0.05,
        },
        "pointpillars": {
            "name": "pointpillars",
            "grid": {**CORRIDOR, "cell_m": 0.8},
            "pillar_channels": 8,
            "widths": [8, 8, 8],
            "depths": [0, 0, 0],
            "neck_width": 8,
            "anchors": {"vehicle": {"size_m": [4.2, 2.1, 2.0], "z_m": 0.0}},
            "score_threshold": 0.05,
        },
    },
    "replicates": 20,
}


def tiny_grid() -> ExperimentGrid:
    """The shipped grid whose laptop budget is tiny and leaves out all but some runs."""
    whole = load_grid("cirrus")
    mini = BudgetSettings.model_validate({**MINI, "without": [name for name in whole.runs if name not in RUNS]})
    return whole.model_copy(update={"budgets": {"laptop": mini}})


@dataclass(frozen=True, kw_only=True)
class QuicklyMeasured(Reproduction):
    """One whose plan rests on two steps of each kind of run."""

    measured_steps: int = 2


def tiny(out: Path, workers: int = 1, engine: str = "local") -> Reproduction:
    """A reproduction of it in a folder."""
    shipped = Reproduction.of("cirrus", out=out)
    where = {"workers": workers, "engine": engine}
    return Reproduction(grid=tiny_grid(), claims=shipped.claims, out=out, measured_steps=2, **where)


def tiny_kradar(out: Path, **options: Any) -> Reproduction:
    """A reproduction of K-Radar's grid: RTNH and PointPillars alone, on two roads."""
    shipped = Reproduction.of("kradar", out=out)
    mini = BudgetSettings.model_validate(KRADAR_MINI)
    grid = load_grid("kradar").model_copy(update={"budgets": {"laptop": mini}})
    return Reproduction(grid=grid, claims=shipped.claims, out=out, workers=1, measured_steps=2, **options)


if __name__ == "__main__":
    if sys.argv[1] == "reproduce":  # the verb itself, as benchmarks/interruptions.py ends it
        reproducing.load_grid = {"cirrus": tiny_grid()}.__getitem__
        papers.Reproduction = QuicklyMeasured
        raise SystemExit(main())
    tiny(Path(sys.argv[1]), int(sys.argv[2]), *sys.argv[3:]).run()
    print(json.dumps("done"))

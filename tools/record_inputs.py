"""Files that commands of the record take: own clouds, stamps, pictures of a board, experiments, a checkpoint.

    python record_inputs.py KIND

writes them into the present folder, the same ones each time.
"""

import csv
import json
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

HEAD = "sequence,frame,label,x,y,z,l,w,h,yaw_rad,score\n"


def clouds() -> None:
    """A folder of sweeps with a thing in them that moves ahead, and boxes round it."""
    rng = np.random.default_rng(7)
    folder = Path("own")
    folder.mkdir()
    rows, found = [], []
    for number in range(4):
        ground = rng.uniform([2, -25, -1.7, 0], [70, 25, -1.6, 1], (6000, 4))
        thing = rng.uniform([18 + number, 0.1, -1.5, 0], [22.4 + number, 1.9, 0.1, 1], (400, 4))
        walls = np.concatenate([rng.uniform([2, y, -1.7, 0], [70, y + 0.1, 3, 1], (2000, 4)) for y in (-15, 14)])
        np.save(folder / f"{number:03d}.npy", np.concatenate([ground, thing, walls]).astype(np.float32))
        rows.append(f"own,{number:03d},vehicle,{20.2 + number},1.0,-0.7,4.4,1.8,1.6,0.0,\n")
        found.append(f"own,{number:03d},vehicle,{20.3 + number},1.1,-0.7,4.3,1.8,1.5,0.02,0.{9 - number}\n")
        found.append(f"own,{number:03d},pedestrian,{30.0 + 2 * number},-6.0,-0.8,0.8,0.7,1.7,1.0,0.4\n")
    Path("own-labels.csv").write_text(HEAD + "".join(rows))
    Path("own-found.csv").write_text(HEAD + "".join(found))


def stamps() -> None:
    """Three streams of stamps with a late and drifting camera, and a clock's log."""
    rng, start = np.random.default_rng(0), 1_500_000_000_000_000_000
    folder = Path("rig")
    folder.mkdir()
    np.savetxt(
        folder / "lidar.txt", start + np.arange(300) * 100_000_000 + rng.integers(-500_000, 500_000, 300), fmt="%d"
    )
    at = np.arange(900) * 33_333_333
    late = start + 4_000_000 + at + np.round(at * 40e-6).astype(np.int64) + rng.integers(-500_000, 500_000, 900)
    rows = [f"{k},{t // 10**9}.{t % 10**9:09d}" for k, t in enumerate(np.delete(late, [30, 31, 400]).tolist())]
    (folder / "camera.csv").write_text("frame,time_s\n" + "\n".join(rows) + "\n")
    np.savetxt(folder / "gps.txt", start + 86_400_000_000_000 + np.arange(60) * 10**9, fmt="%d")
    log = [f"ptp4l[{k}.5]: master offset {v} s2 freq -2500 path delay 560" for k, v in enumerate((-3, 4, 5, 4))]
    (folder / "ptp4l.log").write_text("\n".join(log))


def board() -> None:
    """Pictures of the board that ``calibrate board --draw`` wrote, seen by a camera that is known."""
    import cv2
    from PIL import Image

    drawn = np.asarray(Image.open("board.png").convert("L"))
    height, width = drawn.shape
    matrix = np.array([[900.0, 0, 640], [0, 900.0, 400], [0, 0, 1]])
    metres = 0.36 / width
    turns = [(0, 0), (25, 0), (-25, 5), (0, 30), (5, -30), (20, 20), (-18, 22), (15, -25)]
    Path("pictures").mkdir()
    for number, (about_x, about_y) in enumerate(turns):
        turned, _ = cv2.Rodrigues(np.radians([about_x, about_y, 3.0 * number]))
        corners = np.array([[0, 0, 0], [width, 0, 0], [width, height, 0], [0, height, 0]], float)
        there = (corners - [width / 2, height / 2, 0]) * metres @ turned.T + [0.02 * (number - 4), 0.01, 0.55]
        seen = there @ matrix.T
        pixels = (seen[:, :2] / seen[:, 2:]).astype(np.float32)
        homography = cv2.getPerspectiveTransform(corners[:, :2].astype(np.float32), pixels)
        picture = cv2.warpPerspective(drawn, homography, (1280, 800), flags=cv2.INTER_AREA, borderValue=(160,))
        Image.fromarray(picture).save(f"pictures/{number}.png")


def photos() -> None:
    """Two small pictures, for a studio's films."""
    from PIL import Image

    Path("photos").mkdir()
    for number in range(2):
        shade = np.add.outer(np.arange(48), np.arange(64)) * (number + 1) % 256
        Image.fromarray(np.stack([shade, shade.T[:48, :48].mean() + 0 * shade, 255 - shade], -1).astype(np.uint8)).save(
            f"photos/{number}.png"
        )


def kit() -> None:
    """The boxes of K-Radar's kit as the files that ``score`` reads; ``real/kradar/evaluation`` has them."""
    head = ["sequence", "frame", "label", "x", "y", "z", "l", "w", "h", "yaw_rad", "score"]
    names = {"sed": "vehicle", "bus": "large_vehicle"}
    for which in ("iso", "long"):
        rows: dict[str, list[list[str]]] = {"gt": [], "pred": []}
        with Path(f"real/kradar/evaluation/boxes_{which}.csv").open(newline="") as file:
            for row in csv.DictReader(file):
                box = [row[name] for name in head[3:10]]
                score = row["score"] if row["kind"] == "pred" else ""
                rows[row["kind"]].append([row["seq"], row["stem"], names.get(row["cls"], row["cls"]), *box, score])
        for kind, found in rows.items():
            with Path(f"{which}-{kind}.csv").open("w", newline="") as file:
                csv.writer(file).writerows([head, *found])


_PILLARS = {"grid": {"range_m": 64.0, "half_width_m": 20.0, "cell_m": 0.5}}
_CELLS = {
    "grid": {"range_m": 64.0, "half_width_m": 20.0, "z_min_m": -3.0, "z_max_m": 1.0, "cell_m": [1.0, 1.0, 1.0]},
    "anchors": {"vehicle": {"size_m": [4.2, 2.1, 2.0], "z_m": -1.0, "positive_iou": 0.5, "negative_iou": 0.2}},
    "proposals": "anchors",
}


def _level(centres: int, radii_m: list[float], *widths: list[int]) -> dict[str, Any]:
    return {"centres": centres, "radii_m": radii_m, "limits": [16, 32], "widths": widths}


def _grid(low: float, high: float, *cell_m: float) -> dict[str, Any]:
    return {"range_m": 64.0, "half_width_m": 20.0, "z_min_m": low, "z_max_m": high, "cell_m": list(cell_m)}


DETECTORS: dict[str, dict[str, Any]] = {
    "pointpillars": {**_PILLARS, "widths": [16, 32, 32], "neck_width": 32, "out_stride": 2},
    "pointrcnn": {
        "grid": {"range_m": 64.0, "half_width_m": 20.0},
        "sizes_m": {"vehicle": [4.6, 1.95, 1.7], "pedestrian": [0.75, 0.7, 1.75]},
        "points": 2048,
        "bands": {"edges_m": [0.0, 30.0, 64.0], "shares": [0.5, 0.5]},
        "backbone": {
            "levels": [_level(512, [0.5, 1.5], [16, 32], [16, 32]), _level(128, [1.5, 4.0], [32, 48], [32, 48])],
            "propagation": [[64], [64]],
        },
        "head_width": 64,
        "proposals": {
            "threshold": 0.0,
            "candidates": 256,
            "training_count": 64,
            "count": 48,
            "bands": {"edges_m": [0.0, 30.0, 64.0], "shares": [0.5, 0.5]},
        },
        "refinement": {"points": 64, "match": {"drawn": 48}},
    },
    "rtn": {**_CELLS, "planes": 16, "depths": [1, 1, 1], "strides": [1, 2, 2], "neck_width": 32},
    "rtnh": {**_CELLS, "cell_channels": 16, "widths": [16, 16, 32], "neck_width": 32},
    "second": {
        "grid": {"range_m": 64.0, "half_width_m": 20.0, "cell_m": [0.25, 0.25, 0.45]},
        **{"middle_widths": [8, 8, 16, 16], "middle_out": 32, "widths": [64, 64], "depths": [0, 0]},
        **{"neck_width": 64, "matching": "iou"},
    },
    "sparsecentre": {
        "grid": _grid(-4.0, 4.0, 0.4, 0.4, 0.5),
        **{"classes": ["vehicle", "pedestrian"], "widths": [16, 32], "depths": [0, 1], "pyramid_widths": [32, 32, 32]},
    },
    "voxelnet": {
        "grid": _grid(-3.0, 1.0, 0.5, 0.5, 0.8),
        **{"vfe_widths": [8, 16], "voxel_channels": 16, "middle_widths": [16, 16, 16], "widths": [16, 32, 32]},
        **{"depths": [1, 2, 2], "neck_width": 32},
    },
}
"""A small network of every detector, which one core trains in seconds."""

_TRAINING = {"batch_size": 2, "precision": "fp32", "threads": 1, "workers": 0, "log_every_steps": 1}
_CIRRUS = {"path": "cirrus", "clouds": ["gaussian"]}
_RADAR = {"path": "kradar", "clouds": ["radar"], "options": {"reference": "radar", "radar_rate": 0.1}}
_BOTH = {"clouds": ["gaussian", "uniform"]}
_WEATHER = {"probability": 0.5, "kinds": ["fog", "rain", "snow", "ice"], "sensor": "luminar-h2"}

METHODS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "range": ({"name": "range", "near_m": [0, 30], "far_m": [30, 64], "local": {"warmup": 0, "near_points": 1}}, {}),
    "paired": ({"name": "pattern", "loss": "paired"}, {"labelled": _BOTH}),
    "unpaired": ({"name": "pattern"}, {"labelled": _BOTH}),
    "device": ({"name": "device", "norm": "per_domain"}, {"source": {}, "target": {"clouds": ["uniform"]}}),
    "teacher": (
        {"name": "teacher", "start": "runs/pointpillars", "positive": 0.05, "negative": 0.01, "patience": 50},
        {"source": {}, "target": {"clouds": ["uniform"]}},
    ),
    "continued": ({"name": "continued", "start": "runs/pointpillars"}, {}),
}
"""Settings and streams of every method."""


def experiments() -> None:
    """A tiny training of every detector and of every method."""
    for name, settings in DETECTORS.items():
        data = _RADAR if name in ("rtn", "rtnh") else _CIRRUS
        _write(name, data, settings | {"name": name}, {"steps": 12, "checkpoint_every_s": 3600})
    small = DETECTORS["pointpillars"] | {"name": "pointpillars"}
    weather = {"augmentation": {"pasted": {"vehicle": 2}, "thinning": 0.5, "height_m": 0.3, "weather": _WEATHER}}
    _write(
        "augmented", {**_CIRRUS, **_BOTH}, small, {"steps": 8, "validation": {"every_steps": 4, "frames": 2}}, **weather
    )
    for name, (method, streams) in METHODS.items():
        data = {key: _CIRRUS | value for key, value in streams.items()} or _CIRRUS
        for detector in ("pointpillars", "sparsecentre") if name != "teacher" else ("pointpillars",):
            suffix = "" if detector == "pointpillars" else f"-{detector}"
            start = {"start": f"runs/{detector}"} if "start" in method else {}
            settings = DETECTORS[detector] | {"name": detector}
            settings |= {"score_threshold": 0.01} if name == "teacher" else {}
            _write(f"{name}{suffix}", data, settings, {"steps": 4}, method=method | start)


def _write(name: str, data: Any, detector: Any, training: Mapping[str, Any], **more: Any) -> None:
    tree = {"name": name, "data": data, "detector": detector, "training": {**_TRAINING, **training}, **more}
    Path(f"{name}.yaml").write_text(json.dumps(tree, indent=1))  # JSON is YAML


def checkpoint() -> None:
    """A PointPillars as OpenPCDet saves it, its weights drawn at random, and the settings that go with it."""
    import torch

    generator = torch.Generator().manual_seed(0)
    state: dict[str, Any] = {"global_step": torch.tensor([12])}
    for name, shape in _shapes():
        drawn = torch.rand(shape, generator=generator)
        state[name] = drawn + 0.5 if name.endswith("running_var") else 0.3 * (drawn - 0.5)
    torch.save({"model_state": state}, "theirs.pth")
    torch.save({"model_state": {**state, "roi_head.fc.weight": torch.zeros(2)}}, "more.pth")
    grid = "{range_m: 19.2, half_width_m: 6.4, z_min_m: -3.0, z_max_m: 1.0, cell_m: 0.4}"
    Path("mine.yaml").write_text(f"grid: {grid}\nscore_threshold: 0.07\n")


def _shapes() -> Iterator[tuple[str, tuple[int, ...]]]:
    yield "vfe.pfn_layers.0.linear.weight", (8, 10)
    yield from _norm("vfe.pfn_layers.0.norm", 8)
    before = 8
    for block, (width, depth, up) in enumerate([(8, 1, 1), (12, 2, 2), (16, 1, 4)]):
        for layer in range(depth + 1):
            yield f"backbone_2d.blocks.{block}.{3 * layer + 1}.weight", (width, before, 3, 3)
            yield from _norm(f"backbone_2d.blocks.{block}.{3 * layer + 2}", width)
            before = width
        yield f"backbone_2d.deblocks.{block}.0.weight", (width, 10, up, up)
        yield from _norm(f"backbone_2d.deblocks.{block}.1", 10)
    for name, numbers in (("conv_cls", 18), ("conv_box", 42), ("conv_dir_cls", 12)):
        yield f"dense_head.{name}.weight", (numbers, 30, 1, 1)
        yield f"dense_head.{name}.bias", (numbers,)


def _norm(name: str, width: int) -> Iterator[tuple[str, tuple[int, ...]]]:
    yield from ((f"{name}.{part}", (width,)) for part in ("weight", "bias", "running_mean", "running_var"))


KINDS: dict[str, Callable[[], None]] = {
    each.__name__: each for each in (clouds, stamps, board, photos, kit, experiments, checkpoint)
}

if __name__ == "__main__":
    KINDS[sys.argv[1]]()

"""How often the doctor finds a planted error of a camera's calibration, and that it claims none on correct data.

Simulates twenty K-Radar drives by day, each 24 frames in four runs of six with pictures, plants errors of 0.1 to 2
degrees about, or 2 to 40 cm along, a random axis, and counts the claims. ``radar_calibration.py`` does so for the
radar. Drives are kept in --data and checks in its journal, so that a second run goes on.

    python benchmarks/calibration_doctor.py --output benchmarks/results/calibration_doctor.txt
"""

import argparse
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from _report import header, progress

from farfield.calibration.camera_edges import SIGMAS_PX, EdgeViews, move_camera
from farfield.calibration.checking import check_camera
from farfield.datasets import open_dataset
from farfield.datasets.base import Dataset
from farfield.datasets.kradar.writer import KRadarWriter
from farfield.geometry.cameras import Camera
from farfield.inspection.doctor.calibration import camera_views
from farfield.simulation import find_preset, simulate_frame

ROADS = ("urban", "suburban", "highway")
SETS = 20
RUNS = (30, 100, 170, 240)
LENGTH = 6
PICTURES = (0, 3, 5)
ERRORS = (  # those with a figure to meet first
    ("correct", 0.0),
    ("deg", 1.0),
    ("cm", 20.0),
    ("cm", 40.0),
    ("deg", 2.0),
    ("deg", 0.5),
    ("cm", 10.0),
    ("deg", 0.2),
    ("cm", 5.0),
    ("deg", 0.1),
    ("cm", 2.0),
    ("drift deg", 1.0),
    ("drift cm", 20.0),
)


def simulate_set(folder: Path, number: int) -> Path:
    """One drive as a K-Radar; frames that are there are kept."""
    preset = find_preset("kradar-sim", road=ROADS[number % 3], time="day", weather="normal", duration_s=30.0)
    writer = KRadarWriter(folder / f"{number:02d}")
    if (writer.root / "done").exists():
        return writer.root
    for start in RUNS:
        for step in range(LENGTH):
            sensors = ("os2-64", "sparse", *(("cam-front",) if step in PICTURES else ()))
            frame = simulate_frame(preset, seed=1000 + number, sequence=0, index=start + step, sensors=sensors)
            if not writer.paths(frame)["record"].exists():
                writer.write(frame)
    writer.finish()
    (writer.root / "done").touch()
    return writer.root


def planted_camera(camera: Camera, kind: str, size: float, rng: np.random.Generator) -> Camera:
    """The camera turned about, or shifted along, a random axis."""
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    delta = np.zeros(6)
    delta[slice(0, 3) if kind.endswith("deg") else slice(3, 6)] = axis
    return move_camera(camera, delta * (np.radians(size) if kind.endswith("deg") else size / 100))


def drifted(camera: Camera, views: EdgeViews, kind: str, size: float, rng: np.random.Generator) -> EdgeViews:
    """The LiDAR's edges of the second half of the drive as they are seen after the camera has moved."""
    late = views.frame >= views.count // 2
    away = planted_camera(camera, kind, size, rng)
    step = np.linalg.inv(away.camera_T_lidar) @ camera.camera_T_lidar
    points = views.points_m.copy()
    points[late] = points[late] @ step[:3, :3].T + step[:3, 3]
    return replace(views, points_m=points)


def kept_views(root: Path, data: Dataset) -> tuple[Camera, EdgeViews]:
    """The camera and the edges of a drive, found once."""
    path = root / "views.npz"
    camera = data[0].cameras["cam-front"]
    if not path.exists():
        camera, views = camera_views(data, range(len(data)), "cam-front")
        levels = {f"level{number}": level for number, level in enumerate(views.levels)}
        size = np.array([camera.width_px, camera.height_px])
        columns = {name: value for name, value in vars(views).items() if name != "levels"}
        np.savez(path.with_name("part.npz"), **levels, **columns, size=size)
        path.with_name("part.npz").rename(path)
    with np.load(path) as known:
        width, height = (int(each) for each in known["size"])
        levels = tuple(known[f"level{number}"] for number in range(len(SIGMAS_PX)))
        columns = {name: known[name] for name in ("points_m", "frame", "axis", "weight")}
    return replace(camera, width_px=width, height_px=height), EdgeViews(levels=levels, **columns)


def check_set(root: Path, number: int, done: set[tuple[int, str, str, float]], kinds: int) -> Iterator[dict[str, Any]]:
    """All checks of one drive that are not in the journal."""
    data, wanted = open_dataset(root), [each for each in ERRORS[:kinds] if (number, "camera", *each) not in done]
    if not wanted:
        return
    camera, views = kept_views(root, data)
    for kind, size in wanted:
        rng = np.random.default_rng((number, int(10 * size), len(kind)))
        if "drift" in kind:
            found = check_camera(camera, drifted(camera, views, kind, size, rng))
        else:
            found = check_camera(planted_camera(camera, kind, size, rng), views)
        yield {"set": number, "sensor": "camera", "kind": kind, "size": size, **vars(found)}


def _in_order(error: tuple[str, float]) -> tuple[int, float]:
    return ["correct", "deg", "cm", "drift deg", "drift cm"].index(error[0]), error[1]


def table(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Claims by error."""
    yield f"{'error':>16}{'sets':>6}{'off':>7}{'moved':>7}{'not told':>10}   median: deg    cm    px  evidence"
    for kind, size in sorted(ERRORS, key=_in_order):
        own = [row for row in rows if (row["kind"], row["size"]) == (kind, size)]
        if own:
            verdicts = [row["verdict"] for row in own]
            counts = [verdicts.count(word) for word in ("off", "moved", "not told")]
            turn, cm, px, sure = (np.median([row[key] for row in own]) for key in ("degrees", "cm", "px", "evidence"))
            what = kind if kind == "correct" else f"{kind} {size:g}"
            yield (
                f"{what:>16}{len(own):6d}{counts[0]:7d}{counts[1]:7d}{counts[2]:10d}"
                f"   {turn:11.2f}{cm:6.1f}{px:6.1f}{sure:10.1f}"
            )


def draw(rows: list[dict[str, Any]], path: Path, sensor: str = "camera") -> None:
    """Picture of a sensor's rows: the share that is claimed over the planted error, with Wilson's intervals."""
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(1, 2, figsize=(9, 3.4), sharey=True, layout="constrained")
    rows = [row for row in rows if row["sensor"] == sensor]
    right = [row for row in rows if row["kind"] == "correct"]
    for panel, (kind, unit, asked) in zip(panels, (("deg", "degrees", 1.0), ("cm", "centimetres", 20.0)), strict=True):
        sizes = sorted({row["size"] for row in rows if row["kind"] == kind})
        own = [right, *([row for row in rows if (row["kind"], row["size"]) == (kind, size)] for size in sizes)]
        shares = np.array([np.mean([row["verdict"] in ("off", "moved") for row in each]) for each in own])
        count, z = np.array([len(each) for each in own]), 1.96
        middle = (shares + z**2 / (2 * count)) / (1 + z**2 / count)
        half = z * np.sqrt(shares * (1 - shares) / count + z**2 / (4 * count**2)) / (1 + z**2 / count)
        low, high = shares - (middle - half), middle + half - shares
        at = np.arange(len(own))
        panel.errorbar(at, 100 * shares, 100 * np.maximum([low, high], 0), fmt="o-", capsize=3, color="#1f6fb4")
        panel.axvline(1 + sizes.index(asked), color="#999999", linestyle=":")
        panel.text(
            0.95 + sizes.index(asked), 50, "asked: always from here", rotation=90, ha="right", va="center", size=8
        )
        panel.set_xticks(at, ["right", *(f"{size:g}" for size in sizes)])
        panel.set_xlabel(f"planted error of the {sensor}, {unit}")
        panel.grid(axis="y", alpha=0.3)
    panels[0].set_ylabel(f"claimed, % of {len(right)} data sets")
    figure.savefig(path, dpi=110)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("data/calibration_doctor"))
    parser.add_argument("--output", type=Path)
    parser.add_argument("--picture", type=Path, help="of the camera's rows: where its PNG goes")
    parser.add_argument("--sets", type=int, default=SETS)
    parser.add_argument("--kinds", type=int, default=len(ERRORS), help="of the errors, the first so many")
    options = parser.parse_args()
    journal = options.data / "checks.jsonl"
    journal.parent.mkdir(parents=True, exist_ok=True)
    rows = [json.loads(line) for line in journal.read_text().splitlines()] if journal.exists() else []
    for number in progress(range(options.sets), "drives"):
        root = simulate_set(options.data, number)
        done = {(row["set"], row["sensor"], row["kind"], row["size"]) for row in rows}
        for row in check_set(root, number, done, options.kinds):
            rows.append(row)
            with journal.open("a") as file:
                file.write(json.dumps(row) + "\n")
        lines = [
            header(),
            f"{number + 1} drives, 24 frames and 12 pictures each; kradar-sim by day",
            "",
            *table(rows),
        ]
        if options.output:
            options.output.write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))
    if options.picture:
        draw(rows, options.picture)


if __name__ == "__main__":
    main()
